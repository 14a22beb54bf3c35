"""A stand-in for an installed ROS 2, made of the message definitions of the package rosbags.

`install` makes `rclpy` and the packages of messages importable. Messages check the types of their fields as those of
ROS do, and a publisher keeps what it gets as CDR, as it would go to other nodes. A byte is of type bytes here, as it is
in ROS, and an int in rosbags.
"""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
PACKAGES = ("builtin_interfaces", "std_msgs", "geometry_msgs", "tf2_msgs", "diagnostic_msgs")
PRIMITIVES = {"float64": float, "string": str, "int32": int, "uint32": int, "byte": bytes}


def message_class(name):
    """A class for a message as ROS generates them: fields by keyword only, each of its type and no other."""
    definition = STORE.get_msgdef(name)
    fields = dict(definition.fields)

    class Message:
        NAME = name

        def __init__(self, **given):
            assert set(given) <= set(fields), f"{name} has no {set(given) - set(fields)}"
            for field, value in given.items():
                check(fields[field], value)
                setattr(self, field, value)

    for constant in ("OK", "WARN", "ERROR", "STALE"):
        if hasattr(definition.cls, constant):
            setattr(Message, constant, bytes([getattr(definition.cls, constant)]))
    return Message


def check(kind, value):
    """Refuse a value that the field of a message of ROS would not take."""
    node, what = kind
    if node.name == "BASE":
        assert type(value) is PRIMITIVES[what[0]], f"{value!r} is no {what[0]}"
    elif node.name == "NAME":
        assert what == value.NAME
    elif node.name == "ARRAY":
        assert isinstance(value, np.ndarray)
        assert value.dtype == np.float64
        assert value.shape == (what[1],)
    else:
        assert isinstance(value, list)
        for one in value:
            check(what[0], one)


def as_rosbags(message):
    """The same message of the classes of rosbags."""
    values = {}
    for field, (node, what) in STORE.get_msgdef(message.NAME).fields:
        value = getattr(message, field)
        if node.name == "NAME":
            value = as_rosbags(value)
        elif node.name == "SEQUENCE":
            value = [as_rosbags(one) for one in value]
        elif node.name == "BASE" and what[0] == "byte":
            value = value[0]
        values[field] = value
    return STORE.types[message.NAME](**values)


class Context:
    """A context as rclpy has it: it is initialized once, has nodes while it is up, and ends with all of them."""

    def __init__(self):
        self.state, self.nodes = "new", []

    def init(self, args=None, *, initialize_logging=True, domain_id=None):
        assert (self.state, args) == ("new", []), "Context.init() must only be called once"
        self.state = "up"

    def ok(self):
        return self.state == "up"

    def shutdown(self):
        assert self.ok(), "Context must be initialized before it can be shutdown"
        self.state = "down"
        for node in self.nodes:
            node.destroyed = True

    def try_shutdown(self):
        if self.ok():
            self.shutdown()


class Node:
    """A node whose publishers keep CDR by topic, and which is worth nothing once its context is down."""

    def __init__(self, name, context):
        assert name.isidentifier(), f"{name} is no name of a node"
        assert context.ok(), "the context is not initialized, or down"
        self.name, self.context = name, context
        self.published, self.destroyed = [], False
        context.nodes.append(self)

    def create_publisher(self, message_type, topic, depth):
        assert isinstance(depth, int)

        def publish(message):
            assert not self.destroyed, "publisher's context is invalid"
            assert type(message).NAME == message_type.NAME
            cdr = bytes(STORE.serialize_cdr(as_rosbags(message), message.NAME))
            self.published.append((topic, message.NAME, cdr))

        return SimpleNamespace(publish=publish)

    def destroy_node(self):
        self.destroyed = True

    def of(self, topic):
        """Every message of a topic, as rosbags reads its CDR."""
        return [STORE.deserialize_cdr(cdr, name) for published, name, cdr in self.published if published == topic]


def install(monkeypatch):
    """Make ROS importable; return the module `rclpy`, whose `nodes` are those that were made."""
    classes = {}
    for name in STORE.types:
        package, _, what = name.split("/")
        if package in PACKAGES:
            classes.setdefault(package, {})[what] = message_class(name)
    for package, found in classes.items():
        module = ModuleType(f"{package}.msg")
        vars(module).update(found)
        monkeypatch.setitem(sys.modules, package, ModuleType(package))
        monkeypatch.setitem(sys.modules, f"{package}.msg", module)
    rclpy, contexts = ModuleType("rclpy"), ModuleType("rclpy.context")
    contexts.Context, rclpy.nodes, default = Context, [], Context()

    def init(*, args=None, context=None):
        (default if context is None else context).init(args)

    def create_node(name, *, context=None, start_parameter_services):
        assert start_parameter_services is False
        rclpy.nodes.append(Node(name, default if context is None else context))
        return rclpy.nodes[-1]

    def shutdown(*, context=None):
        (default if context is None else context).shutdown()

    rclpy.ok, rclpy.init, rclpy.create_node, rclpy.shutdown = default.ok, init, create_node, shutdown
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    monkeypatch.setitem(sys.modules, "rclpy.context", contexts)
    return rclpy

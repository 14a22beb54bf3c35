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


class Node:
    """A node whose publishers keep CDR by topic."""

    def __init__(self):
        self.published, self.destroyed = [], False

    def create_publisher(self, message_type, topic, depth):
        assert isinstance(depth, int)

        def publish(message):
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
    rclpy, signals = ModuleType("rclpy"), ModuleType("rclpy.signals")
    signals.SignalHandlerOptions = SimpleNamespace(NO="no handlers")
    rclpy.nodes, rclpy.running = [], False

    def init(*, args, signal_handler_options):
        assert (args, signal_handler_options) == ([], "no handlers")
        rclpy.running = True

    def create_node(name, *, start_parameter_services):
        assert (name, start_parameter_services, rclpy.running) == ("goldfield", False, True)
        rclpy.nodes.append(Node())
        return rclpy.nodes[-1]

    def shutdown():
        rclpy.running = False

    rclpy.ok, rclpy.init, rclpy.create_node, rclpy.shutdown = lambda: rclpy.running, init, create_node, shutdown
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    monkeypatch.setitem(sys.modules, "rclpy.signals", signals)
    return rclpy

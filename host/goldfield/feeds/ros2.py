"""A node of ROS 2 that publishes poses, transforms and diagnostics; it needs a shell in which ROS 2 is set up.

``ros2:goldfield`` publishes ``goldfield/pose``, ``/tf`` and once a second ``/diagnostics``. ``?map=`` and ``?sensor=``
name the frames otherwise; ``?tf=no`` leaves ``/tf`` out, for a robot whose sensor frame has another parent already.

Each feed has a context of its own: rclpy shuts a context down as a whole, so that a shared one would end with the first
of several feeds, and take the nodes of a program that uses goldfield along.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from goldfield.feeds.address import Address
from goldfield.feeds.feed import Feed, Setting
from goldfield.feeds.ros2_messages import DIAGNOSTICS, POSE, TRANSFORMS, Frames, Messages
from goldfield.feeds.stamped import StampedPose

DIAGNOSTICS_EVERY_S = 1.0
"""Time from one message of diagnostics to the next, by the stamps."""
DEPTH = 100
"""Messages that a publisher keeps for subscribers: the depth of ROS's own broadcaster of transforms."""


def open_feed(address: Address, setting: Setting) -> Feed:
    """Return the feed of a new node; `UserError` if there is no ROS 2, or an option has no meaning."""
    transforms = _yes_or_no(address)
    frames = Frames(address.options.get("map") or Frames.map, address.options.get("sensor") or Frames.sensor)
    try:
        import rclpy  # a ROS 2 installation has it; PyPI does not
        from rclpy.context import Context
    except ImportError as error:
        said = f"needs ROS 2 ({error}): run 'source /opt/ros/DISTRIBUTION/setup.bash' first, with its own Python"
        raise address.wrong(said) from None
    context = Context()
    context.init(args=[])  # not by rclpy.init, which may take the signals: Ctrl-C ends the run, with its summary
    try:
        node = rclpy.create_node(node_name(address.path), context=context, start_parameter_services=False)
        return Ros2Feed(address, setting, node, Messages(message_class, frames), transforms=transforms, context=context)
    except BaseException:
        context.try_shutdown()
        raise


def node_name(prefix: str) -> str:
    """Return the name of a node, of which ROS wants each but once, by the beginning of its topics.

    Examples
    --------
    >>> node_name("robot/goldfield")
    'robot_goldfield'
    """
    return prefix.replace("/", "_")


def message_class(name: str) -> Any:
    """Return the class of a message of the ROS that is installed, by its name, as ``geometry_msgs/msg/Pose``."""
    package, kind, what = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), what)


class Ros2Feed:
    """Publishes through a node.

    Parameters
    ----------
    address : Address
    setting : Setting
    node : rclpy.node.Node
    messages : Messages
    transforms : bool
        Whether it publishes on ``/tf``.
    context : rclpy.context.Context
        That of the node alone.
    """

    whole = False
    dropped = 0

    def __init__(
        self,
        address: Address,
        setting: Setting,
        node: Any,
        messages: Messages,
        *,
        transforms: bool,
        context: Any,
    ) -> None:
        self._node = node
        self._messages = messages
        self._context = context
        self._site = setting.site.name
        self._clock = setting.clock
        prefix = f"/{address.path}" if address.url.startswith("ros2:/") else address.path
        self._pose = node.create_publisher(message_class(POSE), f"{prefix}/pose", DEPTH)
        self._transforms = node.create_publisher(message_class(TRANSFORMS), "/tf", DEPTH) if transforms else None
        self._diagnostics = node.create_publisher(message_class(DIAGNOSTICS), "/diagnostics", DEPTH)
        self._told_s = float("-inf")

    def write(self, stamped: StampedPose, /) -> None:
        """Publish a pose, if it is usable, and perhaps the diagnostics, which tell of those that are not, too."""
        if stamped.usable:
            self._pose.publish(self._messages.pose(stamped))
            if self._transforms is not None:
                self._transforms.publish(self._messages.transforms(stamped))
        if abs(stamped.unix_s - self._told_s) >= DIAGNOSTICS_EVERY_S:  # a clock may be set back
            self._told_s = stamped.unix_s
            self._diagnostics.publish(self._messages.diagnostics(stamped, self._site, self._clock()))

    def close(self) -> None:
        """Let go of the node and its context, which a program that is shutting down may have ended already."""
        self._node.destroy_node()
        self._context.try_shutdown()


def _yes_or_no(address: Address) -> bool:
    text = address.options.get("tf", "yes")
    if text not in ("yes", "no"):
        raise address.wrong(f"tf={text} is neither yes nor no")
    return text == "yes"

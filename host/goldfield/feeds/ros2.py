"""A node of ROS 2 that publishes poses, transforms and diagnostics; it needs a shell in which ROS 2 is set up.

``ros2:goldfield`` publishes ``goldfield/pose``, ``/tf`` and once a second ``/diagnostics``. ``?map=`` and ``?sensor=``
name the frames otherwise; ``?tf=no`` leaves ``/tf`` out, for a robot whose sensor frame has another parent already.
"""

from __future__ import annotations

from collections.abc import Callable
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
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        said = f"needs ROS 2 ({error}): run 'source /opt/ros/DISTRIBUTION/setup.bash' first, with its own Python"
        raise address.wrong(said) from None
    if not rclpy.ok():
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)  # Ctrl-C ends the run, with its summary
    node = rclpy.create_node("goldfield", start_parameter_services=False)
    return Ros2Feed(address, setting, node, Messages(message_class, frames), transforms=transforms, end=rclpy.shutdown)


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
    end : callable
        Called at the end, after the node was destroyed.
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
        end: Callable[[], None],
    ) -> None:
        self._node = node
        self._messages = messages
        self._end = end
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
        """Let go of the node."""
        self._node.destroy_node()
        self._end()


def _yes_or_no(address: Address) -> bool:
    text = address.options.get("tf", "yes")
    if text not in ("yes", "no"):
        raise address.wrong(f"tf={text} is neither yes nor no")
    return text == "yes"

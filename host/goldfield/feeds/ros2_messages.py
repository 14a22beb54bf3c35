"""Poses as messages of ROS 2, built of whatever classes there are: those of an installed ROS, or others alike.

Frames and covariances are those of `goldfield.view.rep103`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from goldfield.feeds.stamped import StampedPose
from goldfield.link.ros_frame import NANOSECONDS, nanoseconds
from goldfield.types import FloatArray, Pose, Status
from goldfield.view.rep103 import MAP, SENSOR, covariance_of

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
STATUS = "diagnostic_msgs/msg/DiagnosticStatus"

LEVELS: Mapping[Status, str] = {
    Status.OK: "OK",
    Status.UNVERIFIED: "WARN",
    Status.WEAK: "WARN",
    Status.AMBIGUOUS: "WARN",
    Status.INCONSISTENT: "ERROR",
    Status.FAILED: "ERROR",
}
"""The level of each status, by its name in `STATUS`."""

Classes = Callable[[str], Any]
"""Returns the class of a message by its name, as ``geometry_msgs/msg/Pose``; it takes its fields by keyword."""


@dataclass(frozen=True)
class Frames:
    """The names of the two frames.

    Attributes
    ----------
    map : str
        The site's frame.
    sensor : str
        The board's frame.
    """

    map: str = MAP
    sensor: str = SENSOR


class Messages:
    """Builds messages of one set of classes.

    Parameters
    ----------
    classes : callable
    frames : Frames
    """

    def __init__(self, classes: Classes, frames: Frames) -> None:
        self._classes = classes
        self._frames = frames

    def pose(self, stamped: StampedPose) -> Any:
        """Return a usable pose with its covariance (`POSE`)."""
        pose = stamped.pose
        place = self._made(
            "geometry_msgs/msg/Pose",
            position=self._vector("geometry_msgs/msg/Point", pose.position_m),
            orientation=self._quaternion(pose.orientation_xyzw),
        )
        covariance = covariance_of(pose).ravel()
        with_covariance = self._made("geometry_msgs/msg/PoseWithCovariance", pose=place, covariance=covariance)
        return self._made(POSE, header=self._header(stamped, self._frames.map), pose=with_covariance)

    def transforms(self, stamped: StampedPose) -> Any:
        """Return the sensor's frame in the site's, of a usable pose (`TRANSFORMS`)."""
        pose = stamped.pose
        transform = self._made(
            "geometry_msgs/msg/Transform",
            translation=self._vector("geometry_msgs/msg/Vector3", pose.position_m),
            rotation=self._quaternion(pose.orientation_xyzw),
        )
        frame = self._made(
            "geometry_msgs/msg/TransformStamped",
            header=self._header(stamped, self._frames.map),
            child_frame_id=self._frames.sensor,
            transform=transform,
        )
        return self._made(TRANSFORMS, transforms=[frame])

    def diagnostics(self, stamped: StampedPose, name: str, now_s: float) -> Any:
        """Return how the pose and each beacon are (`DIAGNOSTICS`), of a pose whose time is known.

        Parameters
        ----------
        stamped : StampedPose
        name : str
            The site's name, for ``hardware_id``.
        now_s : float
            The time by the wall clock, s since 1970.
        """
        statuses = [self._pose_status(stamped, name, now_s)]
        statuses += [self._beacon_status(stamped.pose, beacon, name) for beacon in beacons_of(stamped.pose)]
        return self._made(DIAGNOSTICS, header=self._header(stamped, ""), status=statuses)

    def _pose_status(self, stamped: StampedPose, name: str, now_s: float) -> Any:
        pose = stamped.pose
        values = {
            "status": pose.status.value,
            "residual": _text(pose.residual),
            "protection_m": _text(pose.protection_m),
            "used": " ".join(pose.used),
            "lost": str(stamped.line.lost),
            "latency_s": _text(stamped.latency_s(now_s)),
        }
        said = pose.reason or pose.status.value
        return self._status(LEVELS[pose.status], "goldfield: pose", said, name, values)

    def _beacon_status(self, pose: Pose, beacon: str, name: str) -> Any:
        said = [finding.text for finding in pose.findings if beacon in finding.beacons]
        used = beacon in pose.used
        level = "OK" if used and not said else "WARN"
        text = "; ".join(said) or ("used" if used else "left out")
        values = {"residual": _text(pose.residuals.get(beacon, math.nan))}
        return self._status(level, f"goldfield: beacon {beacon}", text, name, values)

    def _status(self, level: str, name: str, message: str, hardware: str, values: Mapping[str, str]) -> Any:
        pairs = [self._made("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
        return self._made(
            STATUS,
            level=getattr(self._classes(STATUS), level),  # a byte, which ROS and others have as different types
            name=name,
            message=message,
            hardware_id=hardware,
            values=pairs,
        )

    def _header(self, stamped: StampedPose, frame: str) -> Any:
        seconds, rest = divmod(nanoseconds(stamped.unix_s), NANOSECONDS)
        stamp = self._made("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        return self._made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _vector(self, name: str, values: FloatArray) -> Any:
        x, y, z = values.tolist()
        return self._made(name, x=x, y=y, z=z)

    def _quaternion(self, xyzw: FloatArray) -> Any:
        x, y, z, w = xyzw.tolist()
        return self._made("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _made(self, kind: str, /, **fields: Any) -> Any:
        return self._classes(kind)(**fields)


def beacons_of(pose: Pose) -> list[str]:
    """Return the ids of all beacons that a pose tells of, in order."""
    return sorted({*pose.used, *pose.excluded, *pose.residuals})


def _text(value: float) -> str:
    """Return a number in a few digits; empty if it is not known."""
    return "" if math.isnan(value) else f"{value:.6g}"

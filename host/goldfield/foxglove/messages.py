"""Poses as messages of Foxglove's schemas, in the frames of REP 105: ``sensor``, the board, in ``map``, the site."""

from __future__ import annotations

from typing import Any

import numpy as np
from foxglove.messages import (
    FoxgloveMessage,
    FrameTransform,
    FrameTransforms,
    KeyValuePair,
    Log,
    LogLevel,
    Odometry,
    PoseInFrame,
    Quaternion,
    Timestamp,
    Vector3,
)
from foxglove.messages import Pose as FoxglovePose

from goldfield.foxglove.topics import COVARIANCE, POSE, TRANSFORMS
from goldfield.link.ros_frame import NANOSECONDS, nanoseconds
from goldfield.types import FloatArray, Pose, Status
from goldfield.view.records import number
from goldfield.view.rep103 import MAP, SENSOR, covariance_of

LEVELS = {
    Status.OK: LogLevel.Info,
    Status.UNVERIFIED: LogLevel.Warning,
    Status.WEAK: LogLevel.Warning,
    Status.AMBIGUOUS: LogLevel.Warning,
    Status.INCONSISTENT: LogLevel.Error,
    Status.FAILED: LogLevel.Error,
}
"""How loud the reason of a pose is told, by its status."""


def timestamp(unix_s: float) -> Timestamp:
    """Return a time of the wall clock, s since 1970, as Foxglove has it."""
    return Timestamp(*divmod(nanoseconds(unix_s), NANOSECONDS))


def pose_messages(pose: Pose, unix_s: float) -> list[tuple[str, FoxgloveMessage]]:
    """Return the messages of a pose, each with its topic: pose, pose with covariance, and transform.

    Parameters
    ----------
    pose : Pose
    unix_s : float
        Time for which it is valid, by the wall clock (`goldfield.view.unix_time`).

    Returns
    -------
    list of (str, message)
        Empty for a pose that failed: Foxglove has none without a place. `log_message` tells why.
    """
    if not located(pose):
        return []
    stamp, place = timestamp(unix_s), placed(pose)
    covariance = covariance_of(pose).ravel().tolist()
    odometry = Odometry(
        timestamp=stamp,
        frame_id=MAP,
        body_frame_id=SENSOR,
        pose=place,
        pose_covariance=covariance,
        metadata=[KeyValuePair(key="status", value=pose.status.value)],
    )
    return [
        (TRANSFORMS, FrameTransforms(transforms=[transform(pose, unix_s)])),
        (POSE, PoseInFrame(timestamp=stamp, frame_id=MAP, pose=place)),
        (COVARIANCE, odometry),
    ]


def transform(pose: Pose, unix_s: float) -> FrameTransform:
    """Return the sensor's frame in the site's, of a pose that has a place."""
    x, y, z = pose.position_m.tolist()
    return FrameTransform(
        timestamp=timestamp(unix_s),
        parent_frame_id=MAP,
        child_frame_id=SENSOR,
        translation=Vector3(x=x, y=y, z=z),
        rotation=_quaternion(pose.orientation_xyzw),
    )


def placed(pose: Pose) -> FoxglovePose:
    """Return a pose's place and attitude."""
    x, y, z = pose.position_m.tolist()
    return FoxglovePose(position=Vector3(x=x, y=y, z=z), orientation=_quaternion(pose.orientation_xyzw))


def located(pose: Pose) -> bool:
    """Tell whether a pose has a place."""
    return bool(np.isfinite(pose.position_m).all() and np.isfinite(pose.orientation_xyzw).all())


def log_message(pose: Pose, unix_s: float, name: str = "goldfield") -> Log:
    """Return what a pose says of itself, in words; `LEVELS` tells how loud."""
    said = pose.status.value if pose.reason is None else f"{pose.status.value}: {pose.reason}"
    return Log(timestamp=timestamp(unix_s), level=LEVELS[pose.status], message=said, name=name)


def times(unix_s: float, now_s: float) -> dict[str, Any]:
    """Return the keys that a line has beside those of ``goldfield run --json``.

    ``unix_s``, the time of the measurement by the wall clock, and ``latency_s``, how old the pose was at ``now_s``;
    None where nothing tells it.
    """
    return {"unix_s": number(unix_s), "latency_s": number(now_s - unix_s)}


def _quaternion(xyzw: FloatArray) -> Quaternion:
    x, y, z, w = xyzw.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)

"""What goes on from one pose of a source to the next: the sign of the quaternion, and the time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from goldfield.types import FloatArray, Pose

FIRST_XYZW: FloatArray = np.array([0.0, 0.0, 0.0, 1.0])
"""The quaternion to which the first pose is nearer: no turn."""


class Hemisphere:
    """Gives the quaternions of successive poses their signs, so that an attitude that changes little looks so.

    A quaternion and its negative are the same attitude. The first pose gets w >= 0; each later one gets the sign with
    which it is nearer to the one before, and its alternative that with which it is nearer to the pose.
    """

    def __init__(self) -> None:
        self._last: FloatArray | None = None

    def follow(self, pose: Pose) -> Pose:
        """Return the next pose with its sign; one that failed has none and is returned as it is."""
        if not np.isfinite(pose.orientation_xyzw).all():
            return pose
        signed = self.nearest(pose)
        self._last = signed.orientation_xyzw
        if signed.alternative is None:
            return signed
        return replace(signed, alternative=_nearer(signed.alternative, signed.orientation_xyzw))

    def nearest(self, pose: Pose) -> Pose:
        """Return a pose with the sign nearer to the last pose that was followed, which stays the last one."""
        return _nearer(pose, FIRST_XYZW if self._last is None else self._last)


def time_break(last_s: float, now_s: float) -> str | None:
    """Say in what way the time does not go on from an epoch to the next; None if it does, or if one is not known.

    Examples
    --------
    >>> time_break(3.1, 0.05)
    'the time went back from 3.10 s to 0.05 s'
    >>> time_break(3.1, 3.1)
    'the time stands still at 3.10 s'
    >>> time_break(3.1, 3.2) is None
    True
    """
    if not (math.isfinite(last_s) and math.isfinite(now_s)) or now_s > last_s:
        return None
    if now_s == last_s:
        return f"the time stands still at {now_s:.2f} s"
    return f"the time went back from {last_s:.2f} s to {now_s:.2f} s"


def joined(*reasons: str | None) -> str | None:
    """Return several reasons as one text; None if there is none.

    Examples
    --------
    >>> joined(None, "b2 was left out", "the time stands still")
    'b2 was left out; the time stands still'
    """
    return "; ".join(reason for reason in reasons if reason) or None


def _nearer(pose: Pose, to_xyzw: FloatArray) -> Pose:
    if float(pose.orientation_xyzw @ to_xyzw) >= 0.0:
        return pose
    return replace(pose, orientation_xyzw=-pose.orientation_xyzw)

"""While a sensor is not as it should be, what single epochs leave out is not believed until others agree."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from goldfield.track.continuity import joined
from goldfield.types import Pose, Status

LATEST = 10
"""So many of the latest epochs are remembered."""
UNEXPLAINED = 3
"""From so many inconsistent ones among them on, something is wrong that is no beacon."""
AGREEING = 2
"""So many epochs in a row before must then have left out the same."""
WHY = f"no pose fitted in {UNEXPLAINED} or more of the latest {LATEST} epochs: what is left out is to be confirmed"


class Confirmation:
    """Holds back poses that rest on beacons which a single epoch has chosen.

    The fields of a sensor that fails, by a bit of its converter, say, fit none of the explanations in most epochs. In
    some they fit once a beacon or two are left out, for there are many ways to choose them: 8 beacons have 36. Such a
    pose is off, and its chi-square does not tell. One epoch cannot know; the ones before do.
    """

    def __init__(self) -> None:
        self._inconsistent: deque[bool] = deque(maxlen=LATEST)
        self._left_out: deque[frozenset[str]] = deque(maxlen=AGREEING)

    def follow(self, pose: Pose) -> Pose:
        """Return the next pose of a sensor, ``inconsistent`` if what it leaves out is not confirmed yet."""
        left_out = frozenset(pose.excluded)
        doubted = sum(self._inconsistent) >= UNEXPLAINED and list(self._left_out) != [left_out] * AGREEING
        self._inconsistent.append(pose.status is Status.INCONSISTENT)
        self._left_out.append(left_out)
        if not (doubted and left_out and pose.status in (Status.OK, Status.UNVERIFIED)):
            return pose
        return replace(pose, status=Status.INCONSISTENT, reason=joined(pose.reason, WHY))

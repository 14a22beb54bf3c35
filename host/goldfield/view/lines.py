"""One line for every pose: what ``goldfield run`` prints, and what recordings and feeds carry of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from goldfield.sensor.pipeline import Epoch, Fix
from goldfield.types import Pose
from goldfield.view.records import pose_record


@dataclass(frozen=True, eq=False)
class Line:
    """A pose, and what arrived since the one before.

    Attributes
    ----------
    pose : Pose
    epoch : Epoch or None
        The latest cycle whose report came since the line before: that of the pose, unless poses come at a rate.
    lost : int
        Messages that were lost of all these cycles.
    arrived_s, taken_cpu_s : float
        As in `Epoch` and `Fix`.
    """

    pose: Pose
    epoch: Epoch | None
    lost: int
    arrived_s: float = math.nan
    taken_cpu_s: float = math.nan


class Lines:
    """Makes lines of what a sensor's stream yields.

    Attributes
    ----------
    lost : int
        Messages that were lost of cycles behind the latest line.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._epoch: Epoch | None = None

    def take(self, item: Epoch | Fix) -> Line | None:
        """Return the line of an item; a cycle whose pose is none of those at a rate is told of in the next line."""
        if isinstance(item, Epoch):
            self._epoch = item
            self.lost += item.lost
            if item.at_rate:
                return None
        line = Line(item.pose, self._epoch, self.lost, item.arrived_s, item.taken_cpu_s)
        self._epoch, self.lost = None, 0
        return line


def line_record(line: Line) -> dict[str, Any]:
    """Return a line under the keys of ``goldfield run --json``; what is not known is None."""
    report = None if line.epoch is None else line.epoch.report
    return pose_record(line.pose) | {
        "lost": line.lost,
        "chips": None if report is None else report.chips,
        "saturated": None if report is None else report.saturated,
        "locked": None if report is None else report.locked,
    }

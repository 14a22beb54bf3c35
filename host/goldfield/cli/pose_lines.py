"""Poses as lines on stdout, a table or JSON, with errors against the simulator's truth if there is one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from goldfield.cli.output import json_line, number, pose_record
from goldfield.errors import tell
from goldfield.sensor.pipeline import Epoch, Fix
from goldfield.types import Pose
from goldfield.view.summary import Summary
from goldfield.view.terminal import PoseTable
from goldfield.view.truth import NO_ERROR, PoseError, Truth


@dataclass(frozen=True, eq=False)
class Line:
    """What a line tells.

    Attributes
    ----------
    pose : Pose
    epoch : Epoch or None
        The latest cycle whose report came since the line before: that of the pose, unless poses come at a rate.
    lost : int
        Messages that were lost of all these cycles.
    error : PoseError
    """

    pose: Pose
    epoch: Epoch | None
    lost: int
    error: PoseError = NO_ERROR


LATE_S = 1.0
"""A line that is later is told of, once."""

LineOf = Callable[[Line], str]


class PoseLines:
    """Prints a line for every pose, flushed at once, and counts it in a summary.

    Parameters
    ----------
    line_of : callable
        Makes the line: `table_line` or `json_record_line`.
    summary : Summary
    truth : Truth or None
        The truth that poses are compared with; it is closed at the end.
    live : bool
        Whether the poses are made as messages arrive: then the summary gets their latency, unless the lines wait for
        the truth.
    """

    def __init__(self, line_of: LineOf, summary: Summary, truth: Truth | None, *, live: bool = False) -> None:
        self._line_of = line_of
        self._summary = summary
        self._truth = truth
        self._timed = live and truth is None
        self._epoch: Epoch | None = None
        self._lost = 0
        self._clocked = False
        self._told = False

    def write(self, item: Epoch | Fix) -> None:
        """Print a pose; a cycle whose pose is none of those at a rate is told of in the next line."""
        if isinstance(item, Epoch):
            self._epoch = item
            self._lost += item.lost
            if self._truth is not None:
                self._truth.follow(item.report.cycle, item.report.time_s)
                self._clocked = True
            if item.at_rate:
                return
        line = Line(item.pose, self._epoch, self._lost)
        self._epoch, self._lost = None, 0
        if self._truth is not None and (self._clocked or isinstance(item, Epoch)):
            line = replace(line, error=self._truth.error_of(item.pose))
        self._summary.add(item.pose, line.error, line.lost)
        print(self._line_of(line), flush=True)
        if self._timed and math.isfinite(item.arrived_s):
            late_s = time.time() - item.arrived_s
            self._summary.latency.add(late_s)
            if late_s > LATE_S and not self._told:
                self._told = True
                tell(f"the lines are more than {LATE_S:g} s late: this machine is too slow for so many poses")

    def close(self) -> None:
        """Close the truth; messages lost behind the last line are counted."""
        self._summary.lost_messages += self._lost
        if self._truth is not None:
            self._truth.close()


def table_line(*, truth: bool, times: bool = False) -> LineOf:
    """Return what makes lines of a table, with errors against the truth or without; ``times`` in place of epochs."""
    table = PoseTable(truth=truth, times=times)

    def line(told: Line) -> str:
        notes = () if told.epoch is None else told.epoch.notes
        return table.line(told.pose, told.error, told.lost, ", ".join(notes))

    return line


def json_record_line(*, truth: bool) -> LineOf:
    """Return what makes lines of JSON, with errors against the truth or without."""

    def line(told: Line) -> str:
        report = None if told.epoch is None else told.epoch.report
        record = pose_record(told.pose) | {
            "lost": told.lost,
            "chips": None if report is None else report.chips,
            "saturated": None if report is None else report.saturated,
            "locked": None if report is None else report.locked,
        }
        if truth:
            record |= {
                "position_error_m": number(told.error.position_m),
                "attitude_error_rad": number(told.error.attitude_rad),
            }
        return json_line(record)

    return line

"""Poses as lines on stdout, a table or JSON, with errors against the simulator's truth if there is one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from goldfield.cli.output import json_line, number
from goldfield.errors import tell
from goldfield.sensor.pipeline import Epoch, Fix
from goldfield.view.lines import Line, Lines, line_record
from goldfield.view.summary import Summary
from goldfield.view.terminal import PoseTable
from goldfield.view.truth import NO_ERROR, PoseError, Truth

LATE_S = 1.0
"""A line that is later is told of, once."""

LineOf = Callable[[Line, PoseError], str]


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
        self._lines = Lines()
        self._clocked = False
        self._told = False

    def write(self, item: Epoch | Fix) -> None:
        """Print a pose; a cycle whose pose is none of those at a rate is told of in the next line."""
        if isinstance(item, Epoch) and self._truth is not None:
            self._truth.follow(item.report.cycle, item.report.time_s)
            self._clocked = True
        line = self._lines.take(item)
        if line is None:
            return
        error = NO_ERROR
        if self._truth is not None and (self._clocked or isinstance(item, Epoch)):
            error = self._truth.error_of(item.pose)
        self._summary.add(item.pose, error, line.lost)
        print(self._line_of(line, error), flush=True)
        if self._timed and math.isfinite(line.arrived_s):
            late_s = time.time() - line.arrived_s
            self._summary.latency.add(late_s, time.process_time() - line.taken_cpu_s)
            if late_s > LATE_S and not self._told:
                self._told = True
                tell(f"the lines are more than {LATE_S:g} s late: this machine is too slow for so many poses")

    def close(self) -> None:
        """Close the truth; messages lost behind the last line are counted."""
        self._summary.lost_messages += self._lines.lost
        if self._truth is not None:
            self._truth.close()


def table_line(*, truth: bool, times: bool = False) -> LineOf:
    """Return what makes lines of a table, with errors against the truth or without; ``times`` in place of epochs."""
    table = PoseTable(truth=truth, times=times)

    def line(told: Line, error: PoseError = NO_ERROR) -> str:
        notes = () if told.epoch is None else told.epoch.notes
        return table.line(told.pose, error, told.lost, ", ".join(notes))

    return line


def json_record_line(*, truth: bool) -> LineOf:
    """Return what makes lines of JSON, with errors against the truth or without."""

    def line(told: Line, error: PoseError = NO_ERROR) -> str:
        record = line_record(told)
        if truth:
            record |= {
                "position_error_m": number(error.position_m),
                "attitude_error_rad": number(error.attitude_rad),
            }
        return json_line(record)

    return line

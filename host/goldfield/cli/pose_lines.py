"""Epochs as lines on stdout, a table or JSON, with errors against the simulator's truth if there is one."""

from __future__ import annotations

from collections.abc import Callable

from goldfield.cli.output import json_line, number, pose_record
from goldfield.sensor.pipeline import Epoch
from goldfield.view.summary import Summary
from goldfield.view.terminal import PoseTable
from goldfield.view.truth import NO_ERROR, PoseError, Truth

LineOf = Callable[[Epoch, PoseError], str]


class PoseLines:
    """Prints a line for every epoch, flushed at once, and counts it in a summary.

    Parameters
    ----------
    line_of : callable
        Makes the line: `table_line` or `json_record_line`.
    summary : Summary
    truth : Truth or None
        The truth that poses are compared with; it is closed at the end.
    """

    def __init__(self, line_of: LineOf, summary: Summary, truth: Truth | None) -> None:
        self._line_of = line_of
        self._summary = summary
        self._truth = truth

    def write(self, epoch: Epoch) -> None:
        """Print an epoch."""
        error = NO_ERROR if self._truth is None else self._truth.error_of(epoch.pose)
        self._summary.add(epoch.pose, error, epoch.lost)
        print(self._line_of(epoch, error), flush=True)

    def close(self) -> None:
        """Close the truth."""
        if self._truth is not None:
            self._truth.close()


def table_line(truth: bool) -> LineOf:
    """Return what makes lines of a table, with errors against the truth or without."""
    table = PoseTable(truth=truth)
    return lambda epoch, error: table.line(epoch.pose, error, epoch.lost, ", ".join(epoch.notes))


def json_record_line(truth: bool) -> LineOf:
    """Return what makes lines of JSON, with errors against the truth or without."""

    def line(epoch: Epoch, error: PoseError) -> str:
        report = epoch.report
        record = pose_record(epoch.pose) | {
            "lost": epoch.lost,
            "chips": report.chips,
            "saturated": report.saturated,
            "locked": report.locked,
        }
        if truth:
            record |= {
                "position_error_m": number(error.position_m),
                "attitude_error_rad": number(error.attitude_rad),
            }
        return json_line(record)

    return line

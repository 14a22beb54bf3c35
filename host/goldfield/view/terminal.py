"""Poses as the lines of a table that fits 80 columns."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass

import numpy as np

from goldfield.locate.rotations import matrix_of
from goldfield.types import FloatArray, Pose, Status
from goldfield.view.truth import NO_ERROR, PoseError

HEADER_EVERY = 25
"""Lines from one header to the next."""

WIDTH = 80
"""Columns of a terminal that was never widened; what does not fit beside a pose goes below it."""

TIME = 9
"""Columns of a time, s: milliseconds up to a day."""

INDENT = " " * 8
"""Before what goes below a pose."""


@dataclass
class PoseTable:
    """Makes a line of each pose; the header comes again now and then.

    The columns are the cycle's number, the position in metres, roll, pitch and yaw in degrees, the standard deviation
    of the position in centimetres, the number of beacons used, the protection level in centimetres, and the status with
    the beacons that were left out. With the truth, errors in centimetres and degrees take the place of that number and
    of the angles' decimals. Below a pose stands its reason, when it is another than that of the pose before.

    Parameters
    ----------
    truth : bool
        Show errors against the truth; a status longer than ``unverified`` then passes `WIDTH`.
    times : bool
        Show the time for which the pose is valid in place of the cycle's number and of the number of beacons.
    """

    truth: bool = False
    times: bool = False
    _lines: int = 0
    _reason: str | None = None

    def line(self, pose: Pose, error: PoseError = NO_ERROR, lost: int = 0, note: str = "") -> str:
        """Return the pose's lines, after the header if that is due; messages lost and the note come last."""
        header = [self.header()] if self._lines % HEADER_EVERY == 0 else []
        self._lines += 1
        angles = np.full(3, np.nan) if pose.status is Status.FAILED else roll_pitch_yaw_deg(pose.orientation_xyzw)
        columns = [_cell(pose.time_s, TIME, 3) if self.times else f"{pose.epoch:6d}"]
        columns += [_cell(value, 7, 3) for value in pose.position_m]
        columns += [_cell(value, 5, 0) if self.truth else _cell(value, 6, 1) for value in angles]
        columns.append(_cell(position_sd_m(pose) * 100.0, 5, 1))
        if self.truth:
            columns += [_cell(error.position_m * 100.0, 5, 2), _cell(math.degrees(error.attitude_rad), 5, 2)]
        elif not self.times:
            columns.append(f"{len(pose.used):2d}")
        columns.append(_cell(pose.protection_m * 100.0, 5, 1))
        said = [pose.status.value]
        said += [f"no {' '.join(pose.excluded)}"] if pose.excluded and pose.used else []
        said += [f"{lost} lost"] if lost else []
        said += [note] if note else []
        below = [pose.reason] if pose.reason is not None and pose.reason != self._reason else []
        self._reason = pose.reason
        return "\n".join(
            [*header, *_beside(" ".join(columns) + "  ", said), *(line for text in below for line in _below(text))]
        )

    def header(self) -> str:
        """Return the line over the columns."""
        angles = f"{'roll':>5} {'pitch':>5} {'yaw':>5}" if self.truth else f"{'roll':>6} {'pitch':>6} {'yaw':>6}"
        first = f"{'t s':>{TIME}}" if self.times else f"{'epoch':>6}"
        more = f"{'e cm':>5} {'e deg':>5} " if self.truth else "" if self.times else f"{'n':>2} "
        return f"{first} {'x m':>7} {'y m':>7} {'z m':>7} {angles} {'sd cm':>5} {more}{'pl cm':>5}  status"


def position_sd_m(pose: Pose) -> float:
    """Return the standard deviation of the position, the root of the sum over the axes; NaN if it is not known."""
    return float(np.sqrt(np.trace(pose.position_cov_m2)))


def _beside(columns: str, said: list[str]) -> list[str]:
    """Put what is said beside the columns as far as it fits, the rest below; the status, which is first, is beside."""
    line, rest = columns + said[0], said[1:]
    while rest and len(line) + 2 + len(rest[0]) <= WIDTH:
        line += ", " + rest.pop(0)
    return [line, *(_below(", ".join(rest)) if rest else [])]


def _below(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT)


def roll_pitch_yaw_deg(orientation_xyzw: FloatArray) -> FloatArray:
    """Return roll, pitch and yaw, shape (3,), degrees, of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    r = matrix_of(orientation_xyzw)
    pitch = math.asin(max(-1.0, min(1.0, -r[2, 0])))
    return np.degrees([math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])])


def _cell(value: float, width: int, decimals: int) -> str:
    """Return a number in its column, a dash if there is none; a large one with fewer decimals, or with an exponent."""
    if not math.isfinite(value):
        return f"{'-':>{width}}"
    shown = (f"{value:{width}.{places}f}" for places in range(decimals, -1, -1))
    return next((text for text in shown if len(text) <= width), f"{value:{width}.0e}")

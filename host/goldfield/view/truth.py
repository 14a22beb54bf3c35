"""The simulator's truth beside the poses: a file of JSON lines that may still be growing.

Each line: ``{"cycle", "t_s", "position_m", "orientation_xyzw"}`` of the middle of a cycle, matched by the cycle's
number modulo 2^20; of a sensor that moves also ``"course"``, rows of ``[t_s, x, y, z, qx, qy, qz, qw]`` from the begin
of the cycle to its end, between which straight lines are drawn.
"""

from __future__ import annotations

import json
import math
import os
import stat
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from goldfield.errors import UserError
from goldfield.files.inputs import name_of, open_input, reason_of
from goldfield.link.reports import CYCLE_MODULUS
from goldfield.types import FloatArray, Pose

POLL_S = 0.01
SAME_TIME_S = 1e-5
"""Times of the truth and of a sensor's clock, which counts microseconds, that differ by less are one time."""
LONGEST_READ = 1 << 20
"""Bytes that are read at once, and of a line at most: /dev/zero has no end."""


@dataclass(frozen=True, eq=False)
class PoseError:
    """Distance of a pose from the truth.

    Attributes
    ----------
    position_m, attitude_rad : float
        Distance, and angle of the rotation between the two attitudes; NaN where either is not known.
    """

    position_m: float
    attitude_rad: float


NO_ERROR = PoseError(math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class _Cycle:
    """What the truth says of a cycle: its middle, and its course, shape (n, 8), if the sensor moved."""

    time_s: float
    position_m: FloatArray
    orientation_xyzw: FloatArray
    course: FloatArray | None

    def at(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Return position and quaternion at a time of the truth; without a course they are those of the middle."""
        if self.course is None or abs(time_s - self.time_s) < SAME_TIME_S:
            return self.position_m, self.orientation_xyzw
        after = int(np.clip(np.searchsorted(self.course[:, 0], time_s), 1, len(self.course) - 1))
        before, behind = self.course[after - 1], self.course[after]
        behind = np.concatenate([behind[:4], behind[4:] if behind[4:] @ before[4:] >= 0.0 else -behind[4:]])
        share = (time_s - before[0]) / (behind[0] - before[0])
        there = before + share * (behind - before)
        return there[1:4], there[4:]


class Truth:
    """Reads the truth of cycles as it is written.

    Parameters
    ----------
    path : path
        ``-`` is stdin.
    wait_s : float
        Longest wait for a cycle's line (and for the file), seconds; it is halved after each line that did not come.

    Raises
    ------
    UserError
        If the file does not appear, or a line is not as it must be.
    """

    def __init__(self, path: str | Path, wait_s: float = 1.0) -> None:
        self._path = Path(name_of(path))
        self._wait_s = wait_s
        self._cycles: dict[int, _Cycle] = {}
        self._clock: tuple[int, float] | None = None
        self._pending = b""
        self._line = 0
        deadline = time.monotonic() + wait_s
        while True:
            try:
                self._file = open_input(path, "truth file")
                break
            except UserError as error:
                if not isinstance(error.__cause__, FileNotFoundError) or time.monotonic() > deadline:
                    raise
                time.sleep(POLL_S)
        if stat.S_ISFIFO(os.fstat(self._file.fileno()).st_mode):
            os.set_blocking(self._file.fileno(), False)  # a pipe that has nothing yet is a file that will grow

    def follow(self, cycle: int, time_s: float) -> None:
        """Learn the time of the middle of a cycle on the sensor's clock; NaN tells nothing."""
        if math.isfinite(time_s):
            self._clock = cycle % CYCLE_MODULUS, time_s

    def error_of(self, pose: Pose) -> PoseError:
        """Compare a pose with the truth at its time, by the clock of `follow`, else at the middle of its cycle.

        NaN if the truth does not come in time.
        """
        truth = self._of_cycle(pose.epoch % CYCLE_MODULUS)
        if truth is None:
            return NO_ERROR
        time_s = truth.time_s
        known = None if self._clock is None else self._of_cycle(self._clock[0])
        if known is not None and self._clock is not None and math.isfinite(pose.time_s):
            time_s = known.time_s + pose.time_s - self._clock[1]
        position, orientation = truth.at(time_s)
        return PoseError(
            float(np.linalg.norm(pose.position_m - position)), rotation_angle(pose.orientation_xyzw, orientation)
        )

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _of_cycle(self, cycle: int) -> _Cycle | None:
        deadline = time.monotonic() + self._wait_s
        while True:
            self._read()
            if cycle in self._cycles:
                return self._cycles[cycle]
            if time.monotonic() > deadline:
                self._wait_s /= 2.0  # a file that lacks one cycle may lack many: do not wait for each
                return None
            time.sleep(POLL_S)

    def _read(self) -> None:
        """Read what has been written since."""
        while self._read_some() == LONGEST_READ:
            pass

    def _read_some(self) -> int:
        try:
            new = self._file.read(LONGEST_READ) or b""
        except OSError as error:
            raise UserError(f"{self._path}: the truth file cannot be read: {reason_of(error)}") from error
        *lines, self._pending = (self._pending + new).split(b"\n")
        if len(self._pending) > LONGEST_READ:
            raise UserError(f"{self._path}:{self._line + 1}: is a line that no truth file has: check the path")
        for line in lines:
            self._line += 1
            if line.strip():
                self._enter(line)
        return len(new)

    def _enter(self, line: bytes) -> None:
        try:
            record = json.loads(line)
            cycle = int(record["cycle"]) % CYCLE_MODULUS
            position = np.array(record["position_m"], dtype=np.float64).reshape(3)
            orientation = np.array(record["orientation_xyzw"], dtype=np.float64).reshape(4)
            time_s = float(record["t_s"])
            course = record.get("course")
            rows = None if course is None else np.array(course, dtype=np.float64).reshape(-1, 8)
            if rows is not None and not (len(rows) > 1 and (np.diff(rows[:, 0]) > 0.0).all()):
                raise ValueError("a course has two rows at least, in the order of time")
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise UserError(
                f"{self._path}:{self._line}: is no line of truth "
                '{"cycle", "t_s", "position_m": [3], "orientation_xyzw": [4]}'
            ) from error
        self._cycles[cycle] = _Cycle(time_s, position, orientation, rows)


def rotation_angle(first_xyzw: FloatArray, second_xyzw: FloatArray) -> float:
    """Return the angle of the rotation from one attitude to the other, rad, 0..pi.

    From the quaternion of the difference, 2 atan2(|vector|, |scalar|): exact for small angles, where acos is not.

    Examples
    --------
    >>> round(rotation_angle(np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0, 0.0])), 6)
    3.141593
    """
    a, b = first_xyzw / np.linalg.norm(first_xyzw), second_xyzw / np.linalg.norm(second_xyzw)
    vector = a[3] * b[:3] - b[3] * a[:3] - np.cross(a[:3], b[:3])
    return 2.0 * math.atan2(float(np.linalg.norm(vector)), abs(float(a @ b)))

"""The simulator's truth beside the poses: a file of JSON lines that may still be growing.

Each line: ``{"cycle", "t_s", "position_m", "orientation_xyzw"}``; matched by the cycle's number modulo 2^20.
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
        self._cycles: dict[int, tuple[FloatArray, FloatArray]] = {}
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

    def error_of(self, pose: Pose) -> PoseError:
        """Compare a pose with the truth of its cycle; NaN if that does not come in time."""
        truth = self._of_cycle(pose.epoch % CYCLE_MODULUS)
        if truth is None:
            return NO_ERROR
        position, orientation = truth
        return PoseError(
            float(np.linalg.norm(pose.position_m - position)), rotation_angle(pose.orientation_xyzw, orientation)
        )

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _of_cycle(self, cycle: int) -> tuple[FloatArray, FloatArray] | None:
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
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise UserError(
                f"{self._path}:{self._line}: is no line of truth "
                '{"cycle", "t_s", "position_m": [3], "orientation_xyzw": [4]}'
            ) from error
        self._cycles[cycle] = position, orientation


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

"""Calibrations that are kept beside the boards: a TOML file with a table for each sensor, by its unique id.

A board holds what it was told until its next reset; the file remembers which board it was, so that the same values go
to the same sensor again, whatever its node or port is by then.
"""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from goldfield.errors import UserError
from goldfield.files.outputs import write_file
from goldfield.files.toml_table import Table, read_table
from goldfield.types import FloatArray

UNIQUE_ID = re.compile(r"[0-9a-f]{24}")
KEYS = ("unique_id", "axes", "offset_T", "gain_sd", "axis_sd_rad", "zero", "calibration")


@dataclass(frozen=True, eq=False)
class KeptSensor:
    """The calibration of one board.

    Attributes
    ----------
    unique_id : str
        That of its processor, 24 hexadecimal digits.
    axes : ndarray, shape (3, 3)
        What the board read before, as the matrix of `goldfield.calibration.sensor.SensorCalibration`.
    offset_T : ndarray, shape (3,)
        What it read before where there is no field; NaN where it is not known.
    gain_sd, axis_sd_rad : float
    zero, calibration : ndarray, shape (3,) and (3, 3), or None
        The board's parameters that correct both; None: they were not read from the board.
    """

    unique_id: str
    axes: FloatArray
    offset_T: FloatArray
    gain_sd: float
    axis_sd_rad: float
    zero: FloatArray | None = None
    calibration: FloatArray | None = None


def corrected(
    zero: FloatArray, matrix: FloatArray, axes: FloatArray, offset_T: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Return a board's zero and matrix, B = matrix (counts - zero), so that it reads the field itself.

    Parameters
    ----------
    zero, matrix : ndarray, shape (3,) and (3, 3)
        With which it read ``axes @ B + offset_T``.

    Examples
    --------
    A sensor whose x reads 2 % too much, and 1 uT where there is no field:

    >>> axes, offset_T = np.diag([1.02, 1.0, 1.0]), np.array([1e-6, 0.0, 0.0])
    >>> zero, matrix = corrected(np.full(3, 2048.0), 1e-7 * np.eye(3), axes, offset_T)
    >>> zero.round(6).tolist(), (1e7 * matrix[0]).round(6).tolist()
    ([2058.0, 2048.0, 2048.0], [0.980392, 0.0, 0.0])
    """
    shift = np.zeros(3) if offset_T is None else np.linalg.solve(matrix, np.nan_to_num(offset_T))
    return zero + shift, np.asarray(np.linalg.solve(axes, matrix))


def load_kept(path: Path) -> dict[str, KeptSensor]:
    """Return the sensors of a file by their unique ids.

    Raises
    ------
    UserError
        With file, line and key of whatever is wrong.
    """
    root = read_table(path, "file of sensors")
    root.allow("sensor")
    found: dict[str, KeptSensor] = {}
    for table in root.tables("sensor"):
        kept = _kept(table)
        if kept.unique_id in found:
            raise table.error("unique_id", f"is {kept.unique_id}, which an earlier [[sensor]] already has: remove one")
        found[kept.unique_id] = kept
    return found


def kept_before(path: Path) -> dict[str, KeptSensor]:
    """Return what a file keeps already; nothing if it is empty or not there."""
    return load_kept(path) if path.exists() and path.stat().st_size else {}


def keep(path: Path, kept: KeptSensor) -> None:
    """Write a sensor to a file, in place of what that says of the same board; other sensors stay.

    Several boards may be calibrated at once: their folder is locked meanwhile, so that each finds what the others kept.
    """
    with _one_at_a_time(path.absolute().parent):
        sensors = kept_before(path)
        sensors[kept.unique_id] = kept
        write_file(path, _text(sensors.values()).encode(), "the file of sensors", force=True)


@contextmanager
def _one_at_a_time(folder: Path) -> Iterator[None]:
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:  # a folder that cannot be read: what is wrong is told when the file is written
        yield
        return
    try:
        with suppress(OSError):  # some network folders have no locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def checked_id(text: str) -> str:
    """Return a unique id in lower case; UserError if it is none."""
    lowered = text.lower()
    if not UNIQUE_ID.fullmatch(lowered):
        raise UserError(f"'{text}' is no unique id: 24 hexadecimal digits, as goldfield nodes tells them")
    return lowered


def _kept(table: Table) -> KeptSensor:
    table.allow(*KEYS)
    unique_id = table.text("unique_id")
    if not UNIQUE_ID.fullmatch(unique_id):
        raise table.error("unique_id", f'is "{unique_id}"; it has 24 hexadecimal digits')
    given = "calibration" in table
    return KeptSensor(
        unique_id,
        _matrix(table, "axes"),
        table.vector("offset_T") if "offset_T" in table else np.full(3, np.nan),
        table.number("gain_sd"),
        table.number("axis_sd_rad"),
        table.vector("zero") if given else None,
        _matrix(table, "calibration") if given else None,
    )


def _matrix(table: Table, key: str) -> FloatArray:
    matrix = table.vectors(key)
    if matrix.shape != (3, 3) or np.linalg.matrix_rank(matrix) < 3:
        raise table.error(key, "must be three rows of three numbers that are not in one plane")
    return matrix


def _text(sensors: Iterable[KeptSensor]) -> str:
    lines = ["# Sensors as goldfield calibrate found them; goldfield calibrate restore gives a board its values again."]
    for kept in sensors:
        lines += ["", "[[sensor]]", f'unique_id = "{kept.unique_id}"', f"axes = {_rows(kept.axes)}"]
        if np.isfinite(kept.offset_T).all():
            lines.append(f"offset_T = {kept.offset_T.tolist()}")
        lines += [f"gain_sd = {kept.gain_sd!r}", f"axis_sd_rad = {kept.axis_sd_rad!r}"]
        if kept.zero is not None and kept.calibration is not None:
            lines += [f"zero = {kept.zero.tolist()}", f"calibration = {_rows(kept.calibration)}"]
    return "\n".join(lines) + "\n"


def _rows(matrix: FloatArray) -> str:
    return f"[{', '.join(str(row) for row in matrix.tolist())}]"

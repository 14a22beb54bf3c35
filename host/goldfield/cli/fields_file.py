"""Separated fields as the table that ``goldfield locate`` reads."""

from __future__ import annotations

import csv
import math
from pathlib import Path

from goldfield.errors import UserError
from goldfield.types import Fields

COLUMNS = ("epoch", "t_s", "beacon", "bx_T", "by_T", "bz_T")
SIGMA_COLUMN = "sigma_T"


class FieldsWriter:
    """Appends the fields of epochs, each line at once; an axis that was not measured is an empty cell.

    Raises
    ------
    UserError
        If the file cannot be made or written.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        try:
            self._file = self._path.open("w", encoding="utf-8", newline="", buffering=1)
        except OSError as error:
            raise self._failure(error) from error
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._write([*COLUMNS, SIGMA_COLUMN])

    def write(self, fields: Fields) -> None:
        """Append one epoch; without a known time it is left out, since the table needs one."""
        if not math.isfinite(fields.time_s):
            return
        for beacon, field, sigma in zip(fields.beacons, fields.field_T, fields.sigma_T, strict=True):
            components = [repr(float(value)) if math.isfinite(value) else "" for value in field]
            self._write([str(fields.epoch), repr(float(fields.time_s)), beacon, *components, repr(float(sigma))])

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, cells: list[str]) -> None:
        try:
            self._rows.writerow(cells)
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> UserError:
        return UserError(f"{self._path}: the fields cannot be written: {error.strerror}")

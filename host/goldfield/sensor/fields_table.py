"""Separated fields as a CSV table: ``epoch,t_s,beacon,bx_T,by_T,bz_T[,sigma_T]``, one row a beacon of an epoch."""

from __future__ import annotations

import csv
import errno
import io
import math
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from goldfield.errors import UserError
from goldfield.files.csv_table import Row, read_groups
from goldfield.site import Site
from goldfield.types import Fields

COLUMNS = ("epoch", "t_s", "beacon", "bx_T", "by_T", "bz_T")
SIGMA_COLUMN = "sigma_T"


def read_fields(site: Site, path: str | Path) -> Iterator[Fields]:
    """Yield the epochs of a table of fields.

    Parameters
    ----------
    site : Site
        Knows the beacons; where the table has no ``sigma_T`` its noise per sample tells that of a field.
    path : path
        A CSV file with the columns ``epoch,t_s,beacon,bx_T,by_T,bz_T`` and perhaps ``sigma_T``: fields in the sensor's
        frame, tesla. An empty cell is an axis that was not measured. The rows of an epoch follow each other.

    Yields
    ------
    Fields

    Raises
    ------
    UserError
        With file, line and column of whatever is wrong.

    Examples
    --------
    In ``docs/examples``:

    >>> import goldfield
    >>> site = goldfield.load_site("room.toml")
    >>> epochs = list(goldfield.read_fields(site, "fields.csv"))
    >>> len(epochs), epochs[0].beacons[:2], epochs[0].field_T.shape
    (10, ('b1', 'b2'), (8, 3))
    """
    for rows in read_groups(path, "epoch", COLUMNS, (SIGMA_COLUMN,)):
        yield _fields(site, rows)


class FieldsWriter:
    """Writes the fields of epochs to a table, each epoch at once and whole: what a full disk tears off is cut away.

    Parameters
    ----------
    path : path
        A new file, or one that is overwritten.

    Raises
    ------
    UserError
        If the file cannot be made or written.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        try:
            self._file = self._path.open("wb", buffering=0)
        except OSError as error:
            raise self._failure(error) from error
        self._size = 0
        self._write([[*COLUMNS, SIGMA_COLUMN]])

    def write(self, fields: Fields) -> None:
        """Append one epoch; without a known time it is left out, since the table needs one."""
        if not math.isfinite(fields.time_s):
            return
        rows = []
        for beacon, field, sigma in zip(fields.beacons, fields.field_T, fields.sigma_T, strict=True):
            components = [repr(float(value)) if math.isfinite(value) else "" for value in field]
            rows.append([str(fields.epoch), repr(float(fields.time_s)), beacon, *components, repr(float(sigma))])
        self._write(rows)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, rows: list[list[str]]) -> None:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        data = text.getvalue().encode()
        try:
            if self._file.write(data) != len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            with suppress(OSError):  # a device such as /dev/full cannot be cut
                self._file.truncate(self._size)
            raise self._failure(error) from error
        self._size += len(data)

    def _failure(self, error: OSError) -> UserError:
        return UserError(f"{self._path}: the fields cannot be written: {error.strerror}")


def _fields(site: Site, rows: list[Row]) -> Fields:
    """Check and join the rows of one epoch."""
    default_sigma = site.sensor.noise_T / math.sqrt(site.chips)
    known = [beacon.id for beacon in site.beacons]
    time_s = rows[0].number("t_s")
    beacons: list[str] = []
    field, sigma = np.empty((len(rows), 3)), np.empty(len(rows))
    for place, row in enumerate(rows):
        if row.number("t_s") != time_s:
            raise row.error("t_s", f"differs from the {time_s:g} of the same epoch's first row (line {rows[0].line})")
        beacon = row.text("beacon")
        if beacon not in known:
            raise row.error("beacon", f"{beacon!r} is not in the site {site.name!r}: it has {', '.join(known[:10])}")
        if beacon in beacons:
            raise row.error("beacon", f"{beacon!r} comes twice in the epoch")
        beacons.append(beacon)
        field[place] = [row.field(column) for column in COLUMNS[3:]]
        if row.cells.get(SIGMA_COLUMN, "").strip():
            sigma[place] = row.number(SIGMA_COLUMN)
            if not 0.0 < sigma[place] < 1.0:
                raise row.error(SIGMA_COLUMN, f"is {sigma[place]:g}; it must be greater than zero and below 1 T")
        else:
            sigma[place] = default_sigma
    return Fields(rows[0].whole("epoch"), time_s, tuple(beacons), field, sigma)

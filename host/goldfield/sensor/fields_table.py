"""Separated fields as a CSV table: ``epoch,t_s,beacon,bx_T,by_T,bz_T[,sigma_T]``, one row a beacon of an epoch."""

from __future__ import annotations

import csv
import io
import math
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from goldfield.errors import UserError
from goldfield.files.csv_table import Plausibility, Row, read_table
from goldfield.files.inputs import name_of
from goldfield.files.outputs import OutputFile
from goldfield.site import Site
from goldfield.types import Fields

COLUMNS = ("epoch", "t_s", "beacon", "bx_T", "by_T", "bz_T")
SIGMA_COLUMN = "sigma_T"

LEAST_SIGMA_T, LARGEST_SIGMA_T = 1e-18, 1e-3
"""What a sigma lies between, T: smaller ones have no finite weight, larger ones are in another unit."""

REMEMBERED = 100_000
"""Epochs among which rows that are out of order are looked for."""


def read_fields(site: Site, path: str | Path) -> Iterator[Fields]:
    """Yield the epochs of a table of fields.

    Parameters
    ----------
    site : Site
        Knows the beacons; where the table has no ``sigma_T`` its noise per sample tells that of a field.
    path : path
        A CSV file with the columns ``epoch,t_s,beacon,bx_T,by_T,bz_T`` and perhaps ``sigma_T``: fields in the sensor's
        frame, tesla. An empty cell is an axis that was not measured. The rows of an epoch follow each other. An epoch's
        number may come again later, as after a restart of the sensor. ``-`` is stdin.

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
    plausibility = Plausibility()
    for rows in _epochs(path):
        yield _fields(site, rows)
        for row in rows:
            plausibility.check(row, COLUMNS[3:])


class FieldsWriter:
    """Writes the fields of epochs to a table that `read_fields` reads, each epoch whole.

    Parameters
    ----------
    path : path
        ``-`` is stdout.
    live, force : bool
        As for `OutputFile`: a live table grows epoch by epoch, another one is in its place after `close`.

    Raises
    ------
    UserError
        If the file cannot be made, or holds something already.
    SystemFailure
        If it cannot be written.
    """

    def __init__(self, path: str | Path, *, live: bool = True, force: bool = False) -> None:
        self._file = OutputFile(path, "the fields", live=live, force=force)
        self._header = _lines([[*COLUMNS, SIGMA_COLUMN]])
        if not force:
            self._write(b"")

    def write(self, fields: Fields) -> None:
        """Append one epoch; without a known time it is left out, since the table needs one, as is an endless sigma."""
        if not math.isfinite(fields.time_s):
            return
        rows = []
        for beacon, field, sigma in zip(fields.beacons, fields.field_T, fields.sigma_T, strict=True):
            if LEAST_SIGMA_T < sigma < LARGEST_SIGMA_T:
                components = [repr(float(value)) if math.isfinite(value) else "" for value in field]
                rows.append([str(fields.epoch), repr(float(fields.time_s)), beacon, *components, repr(float(sigma))])
        if rows:
            self._write(_lines(rows))

    def close(self) -> None:
        """Close the file and keep it."""
        self._file.close()

    def __enter__(self) -> Self:
        """Return the writer itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Keep the file, or discard it after an error."""
        self._file.__exit__(kind, error, trace)

    def _write(self, lines: bytes) -> None:
        header, self._header = self._header, b""
        self._file.write(header + lines)


def _lines(rows: list[list[str]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def _epochs(path: str | Path) -> Iterator[list[Row]]:
    """Yield the rows of each epoch.

    A sensor that restarts counts from 0 again, and its number of twenty bits wraps: that an epoch comes again is no
    fault, unless it is the one of before, at the same time with other beacons: then the rows are out of order.
    """
    rows: list[Row] = []
    seen: OrderedDict[tuple[int, str], frozenset[str]] = OrderedDict()
    for row in read_table(path, COLUMNS, (SIGMA_COLUMN,)):
        if rows and _begins_another(rows, row):
            _check_order(seen, rows)
            yield rows
            rows = []
        rows.append(row)
    if not rows:
        raise UserError(f"{name_of(path)}: has a header but no rows")
    _check_order(seen, rows)
    yield rows


def _begins_another(rows: list[Row], row: Row) -> bool:
    """Tell whether a row belongs to another epoch than the rows before it; a restart may come to the same number."""
    if row.whole("epoch") != rows[0].whole("epoch"):
        return True
    return row.cells["t_s"] != rows[0].cells["t_s"] and row.cells["beacon"] in {r.cells["beacon"] for r in rows}


def _check_order(seen: OrderedDict[tuple[int, str], frozenset[str]], rows: list[Row]) -> None:
    key = rows[0].whole("epoch"), rows[0].cells["t_s"]
    beacons = frozenset(row.cells["beacon"] for row in rows)
    if key in seen and not seen[key] & beacons:
        raise rows[0].error("epoch", f"{key[0]} comes again after another one: sort the rows by epoch")
    seen[key] = beacons
    if len(seen) > REMEMBERED:
        seen.popitem(last=False)


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
            more = "" if len(known) <= 10 else f" and {len(known) - 10} more"
            raise row.error(
                "beacon", f"{beacon!r} is not in the site {site.name!r}: it has {', '.join(known[:10])}{more}"
            )
        if beacon in beacons:
            raise row.error("beacon", f"{beacon!r} comes twice in the epoch")
        beacons.append(beacon)
        field[place] = [row.field(column) for column in COLUMNS[3:]]
        if row.cells.get(SIGMA_COLUMN, "").strip():
            sigma[place] = row.number(SIGMA_COLUMN)
            if not LEAST_SIGMA_T < sigma[place] < LARGEST_SIGMA_T:
                hint = f" (in nanotesla it would be {sigma[place] * 1e-9:g} T)" if sigma[place] > 0.0 else ""
                raise row.error(
                    SIGMA_COLUMN,
                    f"is {sigma[place]:g}; it must be greater than zero and below {LARGEST_SIGMA_T:g} T{hint}",
                )
        else:
            sigma[place] = default_sigma
    return Fields(rows[0].whole("epoch"), time_s, tuple(beacons), field, sigma)

"""Raw samples as the table that ``goldfield samples`` writes: one row a chip, with or without the sensor's place."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from goldfield.errors import UserError, counted, tell
from goldfield.files.csv_table import Plausibility, Row, read_table
from goldfield.files.inputs import name_of
from goldfield.site import Site
from goldfield.types import FloatArray

COLUMNS = ("chip", "bx_T", "by_T", "bz_T")
PLACE = ("x_m", "y_m", "z_m")
REFERENCE = "reference"
LARGEST_REFERENCE = 1e100
"""Largest value of the reference channel, in any unit; its squares stay finite."""


@dataclass(frozen=True, eq=False)
class ChipCycle:
    """A cycle of samples.

    Attributes
    ----------
    samples_T : ndarray, shape (N, 3)
        One row a chip; NaN where a sample is missing.
    place_m : ndarray, shape (3,), or None
        Where the table says the sensor stood.
    reference : ndarray, shape (N,), or None
        The channel that recorded the currents, if the table has one.
    """

    samples_T: FloatArray
    place_m: FloatArray | None
    reference: FloatArray | None = None


def read_cycles(site: Site, path: str) -> Iterator[ChipCycle]:
    """Yield the cycles of a table.

    Raises
    ------
    UserError
        With file, line and column of whatever is wrong, and if there is no whole cycle.
    """
    samples, reference = np.empty((site.chips, 3)), np.empty(site.chips)
    place: FloatArray | None = None
    count = 0
    plausibility = Plausibility()
    for row in read_table(path, COLUMNS, (*PLACE, REFERENCE)):
        chip = row.whole("chip")
        expected = count % site.chips
        if chip not in (expected, count):
            raise row.error("chip", f"is {chip} where {expected} follows: give every chip in order from chip 0")
        samples[expected] = [row.field(column) for column in COLUMNS[1:]]
        plausibility.check(row, COLUMNS[1:])
        if REFERENCE in row.cells:
            reference[expected] = _reference(row)
        here = place_of(row)
        if expected and here is not None and place is not None and (here != place).any():
            raise row.error(PLACE[0], "to z_m differ from the row before: one place a cycle")
        place = here
        count += 1
        if count % site.chips == 0:
            yield ChipCycle(samples, place, reference if REFERENCE in row.cells else None)
    cycles, rest = divmod(count, site.chips)
    if cycles == 0:
        length = f"degree {site.degree}" if site.degree else "samples"
        raise UserError(f"{name_of(path)}: has {counted(count, 'chips')}, fewer than a cycle's {site.chips} ({length})")
    if rest:
        tell(f"{name_of(path)}: is no whole number of cycles: at its end {counted(rest, 'chips were left out')}")


def place_of(row: Row) -> FloatArray | None:
    """Return the place of a row, shape (3,); None if the table has no places.

    Raises
    ------
    UserError
        If it has only some of the columns.
    """
    given = [column for column in PLACE if column in row.cells]
    if not given:
        return None
    if len(given) < len(PLACE):
        raise UserError(f"{row.path}: has {','.join(given)} but not all of {','.join(PLACE)}")
    return np.array([row.number(column) for column in PLACE])


def _reference(row: Row) -> float:
    """Return a value of the reference channel, in any unit, such as counts of a converter; NaN if the cell is empty."""
    if not row.cells[REFERENCE].strip() or row.cells[REFERENCE].strip().lower() == "nan":
        return math.nan
    value = row.number(REFERENCE)
    if abs(value) > LARGEST_REFERENCE:
        raise row.error(REFERENCE, f"is {value:g}, beyond {LARGEST_REFERENCE:g}: give it in a larger unit")
    return value

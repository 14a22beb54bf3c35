"""Plain text tables of the integrity figures: one line a row, printed when it is measured; progress on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tests.bench.integrity_outcome import STATUSES, Outcome

Row = TypeVar("Row")
Cell = str | int | float


@dataclass(frozen=True)
class Column:
    """A column: its heading, width, and digits after the point of its numbers; a width below 0 aligns to the left."""

    heading: str
    width: int = 6
    digits: int = 0

    def cell(self, value: Cell) -> str:
        if isinstance(value, str):
            text = value
        elif isinstance(value, float) and not np.isfinite(value):
            text = "inf" if np.isinf(value) else "-"
        elif isinstance(value, float) and abs(value) >= 10.0 ** (abs(self.width) - self.digits - 2):
            text = f"{value:.0e}"
        else:
            text = f"{value:.{self.digits}f}"
        return text.ljust(-self.width) if self.width < 0 else text.rjust(self.width)


POSES = Column("poses", 6)
STATUS_COLUMNS = tuple(Column(name[:5], 5) for name in STATUSES)
WRONG_COLUMNS = (Column("nees>8"), Column(">5cm"), Column(">PL", 5), Column("max m", 7, 3))
STATUS_NOTE = """\
poses by status (unver: unverified, incon: inconsistent); of `ok`: normalised error squared per axis
above 8, error above 5 cm, largest error; >PL: `ok` or `unverified`, error above protection_m"""


class Table:
    """Prints a title, notes and headings at once, then rows as they come."""

    def __init__(self, title: str, note: str, columns: Sequence[Column]) -> None:
        self._columns = tuple(columns)
        print(f"\n{title}\n{note}")
        print(" ".join(column.cell(column.heading) for column in self._columns), flush=True)

    def row(self, *cells: Cell) -> None:
        """Print a row."""
        line = " ".join(column.cell(value) for column, value in zip(self._columns, cells, strict=True))
        print(line.rstrip(), flush=True)


def status_cells(outcome: Outcome) -> list[Cell]:
    """Return the cells of `POSES` and `STATUS_COLUMNS`."""
    return [len(outcome), *outcome.counts().values()]


def wrong_cells(outcome: Outcome) -> list[Cell]:
    """Return the cells of `WRONG_COLUMNS`."""
    return [
        int(outcome.wrong_by_covariance.sum()),
        int(outcome.wrong_by_distance.sum()),
        int(outcome.unprotected.sum()),
        largest(outcome.error_m[outcome.ok]),
    ]


def largest(values: np.ndarray) -> float:
    """Return the largest finite value, NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else float("nan")


def median(values: np.ndarray) -> float:
    """Return the median, infinite values counted, NaN if there is no number."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if len(known) else float("nan")


def root_mean_square(values: np.ndarray) -> float:
    """Return the root of the mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def progress(rows: Iterable[Row], what: str) -> Iterator[Row]:
    """Yield the rows and say on stderr how far the work is."""
    some, began = list(rows), time.monotonic()
    for number, row in enumerate(some):
        print(f"{what}: {number} of {len(some)}, {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
        yield row


_SAY_EVERY_S = 10.0
_said = {"at": 0.0}


def within(what: str, done: int, of: int) -> None:
    """Say on stderr how far the work of one row is, every 10 s at most."""
    now = time.monotonic()
    if now - _said["at"] > _SAY_EVERY_S:
        _said["at"] = now
        print(f"{what}: {done} of {of}", file=sys.stderr, flush=True)

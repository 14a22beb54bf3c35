"""CSV tables with every cell checked: an error names file, line and column."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from goldfield.errors import UserError, counted, printable, tell
from goldfield.files.inputs import name_of, open_input, reason_of

LARGEST = 1e6
"""Beyond any field in tesla, time in seconds excepted; keeps squares and sums of what is read finite."""

UNLIKELY_T = 0.01
"""Beyond any field that a sensor of magnetic fields measures, T: its column is in another unit."""

MILLIGAUSS_T = 1e-7

LONGEST_LINE = 100_000
"""Characters; a longer line is none of a table."""


@dataclass(frozen=True)
class Row:
    """A line of a table.

    Attributes
    ----------
    path : Path
    line : int
        Number of the line in the file, from 1.
    cells : dict of str to str
        The row's text by the name of its column.
    """

    path: Path
    line: int
    cells: dict[str, str]

    def error(self, column: str, complaint: str) -> UserError:
        """Return an error "file:line: column complaint" to raise."""
        return UserError(f"{self.path}:{self.line}: {column} {complaint}")

    def text(self, column: str) -> str:
        """Return a cell that must not be empty."""
        value = self.cells[column].strip()
        if not value:
            raise self.error(column, "is empty")
        return value

    def whole(self, column: str) -> int:
        """Return a whole number of at least 0."""
        text = self.text(column)
        if not (text.isascii() and text.isdigit() and len(text) <= 18):
            raise self.error(column, f"is {shown(text)}, not a whole number of at least 0")
        return int(text)

    def number(self, column: str) -> float:
        """Return a finite number."""
        value = self._number(self.text(column), column)
        if math.isnan(value):
            raise self.error(column, "is not a number")
        return value

    def field(self, column: str) -> float:
        """Return a field in tesla; NaN if the cell is empty or says nan: not measured."""
        text = self.cells[column].strip()
        value = self._number(text, column) if text else math.nan
        if abs(value) > LARGEST:
            raise self.error(column, f"is {shown(text)} tesla, beyond any field")
        return value

    def doubt(self, column: str) -> str | None:
        """Return a sentence on a field that no sensor measures, None if it is likely."""
        text = self.cells[column].strip()
        value = abs(float(text)) if text else 0.0
        if not value > UNLIKELY_T:
            return None
        return str(
            self.error(
                column,
                f"is {value:g} T, more than a sensor measures: give tesla (in milligauss it would be "
                f"{value * MILLIGAUSS_T:g} T, in nanotesla {value * 1e-9:g} T)",
            )
        )

    def _number(self, text: str, column: str) -> float:
        try:
            value = float(text)
        except ValueError as error:
            raise self.error(column, f"is {shown(text)}, not a number") from error
        if math.isinf(value):
            raise self.error(column, f"is {shown(text)}: give a finite number")
        return value


class Plausibility:
    """Tells, once a table, of a field in its columns that is in another unit than tesla."""

    def __init__(self) -> None:
        self._told = False

    def check(self, row: Row, columns: Iterable[str]) -> None:
        """Look at the fields of a row; `Row.field` has checked that they are numbers."""
        for column in columns:
            if not self._told and (doubt := row.doubt(column)) is not None:
                tell(doubt)
                self._told = True


def shown(text: str) -> str:
    """Quote a text for a message, cut and without control characters."""
    return f'"{printable(text[:40])}..."' if len(text) > 40 else f'"{printable(text)}"'


def read_table(path: str | Path, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> Iterator[Row]:
    """Yield the rows of a CSV file with a header line; columns may come in any order, empty lines are skipped.

    Raises
    ------
    UserError
        If the file is missing, empty, no text, or has other columns.
    """
    name = Path(name_of(path))
    try:
        with io.TextIOWrapper(open_input(path, "CSV file"), encoding="utf-8-sig", newline="\n") as file:
            yield from _rows(name, file, required, optional)
    except OSError as error:
        raise UserError(f"{name}: cannot be read: {reason_of(error)}") from error
    except UnicodeDecodeError as error:
        raise UserError(
            f"{name}: is no text (byte {error.object[error.start]:#04x} is not UTF-8): give a CSV file"
        ) from error


def read_groups(
    path: str | Path, key: str, required: tuple[str, ...], optional: tuple[str, ...] = ()
) -> Iterator[list[Row]]:
    """Yield the rows of `read_table` in groups of successive rows with the same whole number in the column key.

    Raises
    ------
    UserError
        As for `read_table`; also if there are no rows, or if a group comes again after another one.
    """
    rows: list[Row] = []
    seen: set[int] = set()
    for row in read_table(path, required, optional):
        number = row.whole(key)
        if rows and number != rows[0].whole(key):
            yield rows
            rows = []
        if not rows:
            if number in seen:
                raise row.error(key, f"{number} comes again after another one: sort the rows by {key}")
            seen.add(number)
        rows.append(row)
    if not rows:
        raise UserError(f"{path}: has a header but no rows")
    yield rows


def _rows(path: Path, file: TextIO, required: tuple[str, ...], optional: tuple[str, ...]) -> Iterator[Row]:
    lines = _lines(path, file)
    line, header = next(lines, (1, []))
    columns = [name.strip() for name in header]
    wanted = ",".join(required) + "".join(f"[,{name}]" for name in optional)
    if not columns:
        raise UserError(f"{path}: is empty: give a CSV file with the columns {wanted}")
    for name in columns:
        if name not in required + optional:
            raise UserError(f"{path}:{line}: {shown(name)} is no column of this table: its columns are {wanted}")
        if columns.count(name) > 1:
            raise UserError(f"{path}:{line}: the column {name} comes twice: its columns are {wanted}")
    for name in required:
        if name not in columns:
            raise UserError(f"{path}:{line}: the column {name} is missing: its columns are {wanted}")
    for line, cells in lines:
        if len(cells) != len(columns):
            raise UserError(f"{path}:{line}: has {counted(len(cells), 'cells')} where the header has {len(columns)}")
        yield Row(path, line, dict(zip(columns, cells, strict=True)))


def _lines(path: Path, file: TextIO) -> Iterator[tuple[int, list[str]]]:
    """Yield the lines that are not empty with their numbers."""
    reader = csv.reader(_bounded(path, file), strict=True)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield reader.line_num, cells
    except csv.Error as error:
        why = "a carriage return stands within a line" if "new-line" in str(error) else error
        raise UserError(f"{path}:{reader.line_num}: is no CSV: {why}") from error


def _bounded(path: Path, file: TextIO) -> Iterator[str]:
    """Yield the lines, which end at a line feed only; one without an end, as of /dev/zero, must not fill the memory."""
    for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE + 1), ""), start=1):
        if len(line) > LONGEST_LINE:
            raise UserError(f"{path}:{number}: is a line of more than {LONGEST_LINE} characters: give a CSV file")
        yield line

"""Checked access to a parsed TOML table: each wrong value becomes one sentence with file, line, table and key."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from datetime import date, time
from pathlib import Path
from typing import Any

import numpy as np

from goldfield.errors import UserError, printable
from goldfield.files.inputs import name_of, read_bounded
from goldfield.types import FloatArray

LARGEST = 1e30
"""Beyond any quantity here; squares and cubes of smaller numbers do not overflow."""

LARGEST_WHOLE = 10**18
"""Beyond any count, index or seed here."""

LARGEST_FILE = 4_000_000
"""Bytes; what is larger takes longer than seconds to read."""

CLOSE = 0.6
"""Likeness from which on a known key may be what was meant by an unknown one, of 0 to 1 (difflib)."""


def read_text(path: Path, what: str) -> str:
    """Read a text file of at most `LARGEST_FILE` bytes; ``-`` is stdin.

    Raises
    ------
    UserError
        If it is missing, a directory, unreadable, too large, empty or no UTF-8 text.
    """
    raw, name = read_bounded(path, what, LARGEST_FILE), name_of(path)
    if not raw.strip():
        raise UserError(f"{name}: the {what} is empty")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise UserError(f"{name}:{line}: is no text (byte {error.start} is not UTF-8): give a {what}") from error
    if "\0" in text:
        line = text[: text.index("\0")].count("\n") + 1
        raise UserError(f"{name}:{line}: is no text (it holds a zero byte): give a {what}")
    return text


def read_table(path: Path, what: str) -> Table:
    """Read a TOML file, or with ``-`` stdin.

    Raises
    ------
    UserError
        If the file cannot be read (`read_text`) or is no TOML.
    """
    return parse_table(read_text(path, what), name_of(path), what)


def parse_table(text: str, name: str, what: str) -> Table:
    """Parse the text of a TOML file.

    Parameters
    ----------
    text : str
    name : str
        What messages call the file.
    what : str
        What kind of file it is, for messages.

    Raises
    ------
    UserError
        If it is no TOML.
    """
    try:
        # A line of TOML ends at a line feed, and nowhere else: str.splitlines knows ten other ends.
        return Table(tomllib.loads(text), path=Path(name), lines=text.split("\n"))
    except RecursionError as error:
        raise UserError(f"{name}: is nested too deeply for a {what}") from error
    except ValueError as error:  # TOMLDecodeError is one, a number of thousands of digits another
        raise UserError(f"{name}: is no valid TOML: {error}") from error


class Table:
    """A table of a TOML document that knows where it stands.

    Parameters
    ----------
    values : mapping
        The keys and values as tomllib parsed them.
    path : Path
        The file, for messages.
    lines : sequence of str
        The file's lines; tomllib keeps no positions, so lines are found by search.
    name : str
        What messages call the table, such as ``[site]`` or ``[[beacon]] 2``; empty for the document.
    header_line : int
        Line of the table's header, from 1; 0: unknown or the document.
    """

    def __init__(
        self, values: Mapping[str, Any], *, path: Path, lines: Sequence[str], name: str = "", header_line: int = 0
    ) -> None:
        self._values = values
        self._path = path
        self._lines = lines
        self._name = name
        self._header_line = header_line

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def error(self, key: str, complaint: str) -> UserError:
        """Return an error "file:line: table: key complaint" to raise."""
        line = self._line_of(key)
        place = f"{self._path}:{line}" if line else f"{self._path}"
        table = f"{self._name}: " if self._name else ""
        return UserError(f"{place}: {table}{key} {complaint}")

    def allow(self, *keys: str) -> None:
        """Refuse any other key, naming the known one that is like it, or all of them."""
        for key in self._values:
            if key in keys:
                continue
            folded = {known.lower(): known for known in keys}
            near = difflib.get_close_matches(key.lower(), list(folded), n=1, cutoff=CLOSE)
            known = f'did you mean "{folded[near[0]]}"?' if near else f"the keys here are {', '.join(keys)}"
            raise self.error(key, f"is no known key; {known}")

    def table(self, key: str) -> Table:
        """Return a required table."""
        value = self._required(key)
        if not isinstance(value, dict):
            raise self.error(key, f"must be a table, not {_kind(value)}")
        name = f"{self._name}: {key}" if self._name.startswith("[[") else f"[{self._inner(key)}]"
        return Table(value, path=self._path, lines=self._lines, name=name, header_line=self._line_of(key))

    def tables(self, key: str) -> list[Table]:
        """Return a required array of at least one table."""
        value = self._required(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, dict) for item in value):
            raise self.error(key, f"must be one or more tables [[{key}]], not {_kind(value)}")
        header = re.compile(rf"\s*\[\[\s*{re.escape(key)}\s*\]\]")
        headers = [number for number, line in enumerate(self._lines, start=1) if header.match(line)]
        if self._name:  # inline tables of a table: they stand where the key does
            headers = []
        headers += [self._line_of(key) if self._name else 0] * (len(value) - len(headers))
        names = f"{self._name}: {key}" if self._name else f"[[{key}]]"
        return [
            Table(item, path=self._path, lines=self._lines, name=f"{names} {count}", header_line=line)
            for count, (item, line) in enumerate(zip(value, headers, strict=False), start=1)
        ]

    def text(self, key: str) -> str:
        """Return a required string that is not empty."""
        value = self._required(key)
        if not isinstance(value, str) or not value.strip():
            raise self.error(key, f"must be a text in quotes, not {_kind(value)}")
        return value

    def texts(self, key: str) -> list[str]:
        """Return a required list of strings, at least one."""
        value = self._required(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, str) for item in value):
            raise self.error(key, f"must be a list of texts in quotes, not {_kind(value)}")
        return value

    def label(self, key: str) -> str:
        """Return a required name: a text without control characters and outer spaces, or a whole number as a text."""
        value = self._required(key)
        if isinstance(value, int) and not isinstance(value, bool):
            return str(self.integer(key))
        text = self.text(key)
        if not text.isprintable() or text != text.strip():
            raise self.error(
                key, f'is "{printable(text[:40])}": leave out control characters, and spaces at its begin and end'
            )
        return text

    def labels(self, key: str) -> list[str]:
        """Return a required list of at least one name, each a text or a whole number."""
        value = self._required(key)
        if not isinstance(value, list) or not value:
            raise self.error(key, f"must be a list of names, not {_kind(value)}")
        return [
            Table(
                {key: item}, path=self._path, lines=self._lines, name=self._name, header_line=self._header_line
            ).label(key)
            for item in value
        ]

    def integer(self, key: str) -> int:
        """Return a required whole number of at most 18 digits."""
        value = self._required(key)
        if not isinstance(value, int) or isinstance(value, bool) or abs(value) >= LARGEST_WHOLE:
            raise self.error(key, f"must be a whole number, not {_kind(value)}")
        return value

    def number(self, key: str) -> float:
        """Return a required finite number."""
        value = self._required(key)
        if not _is_number(value):
            raise self.error(key, f"must be a finite number, not {_kind(value)}")
        return float(value)

    def positive(self, key: str) -> float:
        """Return a required finite number above zero."""
        value = self.number(key)
        if value <= 0.0:
            raise self.error(key, f"is {value:g}; it must be greater than zero")
        return value

    def flag(self, key: str) -> bool:
        """Return a required true or false."""
        value = self._required(key)
        if not isinstance(value, bool):
            raise self.error(key, f"must be true or false, not {_kind(value)}")
        return value

    def numbers(self, key: str) -> FloatArray:
        """Return a required list of finite numbers, shape (n,), at least one."""
        value = self._required(key)
        if not isinstance(value, list) or not value or not all(_is_number(item) for item in value):
            raise self.error(key, f"must be a list of finite numbers, not {_kind(value)}")
        return np.array(value, dtype=np.float64)

    def is_list(self, key: str) -> bool:
        """Tell whether the value of a key, if there is one, is a list."""
        return isinstance(self._values.get(key), list)

    def vector(self, key: str) -> FloatArray:
        """Return a required vector, shape (3,)."""
        value = self._required(key)
        if not _is_vector(value):
            raise self.error(key, f"must be three finite numbers [x, y, z], not {_kind(value)}")
        return np.array(value, dtype=np.float64)

    def direction(self, key: str) -> FloatArray:
        """Return a required vector, shape (3,), scaled to length 1."""
        value = self.vector(key)
        largest = float(np.max(np.abs(value)))
        if largest == 0.0:
            raise self.error(key, "is the zero vector, which has no direction")
        value = value / largest
        return np.asarray(value / np.linalg.norm(value), dtype=np.float64)

    def vectors(self, key: str) -> FloatArray:
        """Return a required list of vectors, shape (n, 3)."""
        value = self._required(key)
        if not isinstance(value, list) or not value or not all(_is_vector(item) for item in value):
            raise self.error(key, f"must be a list of points [[x, y, z], ...], not {_kind(value)}")
        return np.array(value, dtype=np.float64)

    def _required(self, key: str) -> Any:
        if key not in self._values:
            raise self.error(key, "is missing")
        return self._values[key]

    def _inner(self, key: str) -> str:
        return f"{self._name.strip('[]')}.{key}" if self._name else key

    def _line_of(self, key: str) -> int:
        """Return the line of a key of this table, else of the table's header; 0 if neither is found."""
        name = rf"""["']?{re.escape(key)}["']?"""
        pattern = re.compile(rf"(?:\s*|.*[{{,]\s*){name}\s*=|\s*\[\[?\s*(?:.*\.)?{name}\s*\]")
        first = max(self._header_line, 1)
        for number, line in enumerate(self._lines[first - 1 :], start=first):
            if pattern.match(line):
                return number
            if self._header_line and number > first and re.match(r"\s*\[\[?\s*[A-Za-z_\"']", line):
                break
        return self._header_line


def _is_number(value: object) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return abs(value) < LARGEST  # also false for NaN


def _is_vector(value: object) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(_is_number(item) for item in value)


def _kind(value: object) -> str:
    if isinstance(value, str):
        return f'the text "{printable(value)}"' if len(value) <= 40 else "a long text"
    if isinstance(value, bool):
        return "true or false"
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, int) and abs(value) >= LARGEST_WHOLE:
        return "one of more than 18 digits"
    if isinstance(value, date | time):  # a datetime is a date, too
        return f"the date or time {value}"
    shown = repr(value)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."

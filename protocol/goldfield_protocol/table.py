"""The tables of parameters and counters, as ``parameters.toml`` has them, and the check of a value against its range.

A board checks values as 32 bits; `Parameter.bits` does the very same, so that it refuses what a board refuses and
nothing else.
"""

from __future__ import annotations

import difflib
import math
import struct
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from importlib import resources
from numbers import Integral, Real
from typing import Any

ROLES = {"beacon": 0, "sensor": 1, "anchor": 3}
"""Number of each role of a board in ``HEARTBEAT``."""


class Kind(IntEnum):
    """How the 32 bits of a value are read."""

    UNSIGNED = 0
    SIGNED = 1
    FLOAT = 2


_FORMAT = {Kind.UNSIGNED: "<I", Kind.SIGNED: "<i", Kind.FLOAT: "<f"}
_WHOLE = {Kind.UNSIGNED: (0, 2**32 - 1), Kind.SIGNED: (-(2**31), 2**31 - 1)}


class ParameterError(ValueError):
    """A parameter or a page is not valid; the message is a sentence for the user."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a board: a scalar, an array, or rows of an array.

    Parameters
    ----------
    first : int
        Id of the first element.
    name : str
    kind : Kind
        Kind of each element.
    units : tuple of str
        Unit of each element of a row, empty for a plain number.
    low, high : float
        Allowed range of each element, both included.
    default : tuple of int or float
        Value of each element of a row in a board without a parameter page.
    roles : tuple of str
        Boards that use the parameter.
    at_start : bool
        True if a change acts after the next reset only.
    text : str
        A sentence that says what the parameter does.
    group, rows, stride : int
        Elements of a row, number of rows, and ids from one row to the next.
    exact : bool
        True if an array must be given whole (a matrix), False if fewer elements are allowed (a list).
    excluded : int or None
        A value of the range that is refused all the same.
    secret : bool
        A board tells only whether the parameter is set.
    """

    first: int
    name: str
    kind: Kind
    units: tuple[str, ...]
    low: int | float
    high: int | float
    default: tuple[int | float, ...]
    roles: tuple[str, ...]
    at_start: bool
    text: str
    group: int = 1
    rows: int = 1
    stride: int = 0
    exact: bool = False
    excluded: int | None = None
    secret: bool = False

    @property
    def count(self) -> int:
        """Number of elements in all rows."""
        return self.group * self.rows

    @property
    def unit(self) -> str:
        """Unit as a board tells it: one for all elements, or those of a row with commas between them."""
        return self.units[0] if len(set(self.units)) == 1 else ",".join(self.units)

    @property
    def range_text(self) -> str:
        """Range for a message, such as ``0 to 15.9 A``."""
        units = set(self.units)
        unit = f" {self.units[0]}" if len(units) == 1 and self.units[0] else ""
        but = "" if self.excluded is None else f" and not {self.excluded}"
        return f"{self.low:.7g} to {self.high:.7g}{unit}{but}"

    def identifier(self, element: int) -> int:
        """Return the id of an element."""
        return self.first + element // self.group * self.stride + element % self.group

    def label(self, element: int) -> str:
        """Return the name of an element for a message: ``amplitude``, ``code_list[3]`` or ``beacons[2][6]``."""
        if self.count == 1:
            return self.name
        row, column = divmod(element, self.group)
        return f"{self.name}[{row}][{column}]" if self.rows > 1 else f"{self.name}[{column}]"

    def bits(self, value: object, element: int = 0) -> bytes:
        """Return the four bytes of a value as they lie in a page, if a board takes it.

        Parameters
        ----------
        value : int or float
            The value in SI units; a float is rounded to single precision before it is compared with the range, as a
            board does it.
        element : int
            Which element of an array it is, for the message.

        Raises
        ------
        ParameterError
            If the value is not a number of this kind or a board refuses it.

        Examples
        --------
        >>> PARAMETERS["amplitude"].bits(10).hex()
        '00002041'
        >>> PARAMETERS["amplitude"].bits(100)
        Traceback (most recent call last):
        goldfield_protocol.table.ParameterError: amplitude is 100 A; it must be 0 to 15.9 A
        """
        label, unit = self.label(element), self.units[element % self.group]
        if not isinstance(value, Real) or isinstance(value, bool):
            raise ParameterError(f"{label} is {value!r}; it must be a number, {self.range_text}")
        plain = int(value) if isinstance(value, Integral) else float(value)
        shown = f"{plain:.9g} {unit}".rstrip() if isinstance(plain, float) else f"{plain} {unit}".rstrip()
        if self.kind is not Kind.FLOAT and not (math.isfinite(plain) and plain == int(plain)):
            raise ParameterError(f"{label} is {shown}; it must be a whole number, {self.range_text}")
        number, low, high = (_stored(self.kind, v) for v in (plain, self.low, self.high))
        if not low <= number <= high or number == self.excluded:
            raise ParameterError(f"{label} is {shown}; it must be {self.range_text}")
        return self.pack(number)

    def pack(self, value: int | float) -> bytes:
        """Return the four bytes of a number, which is not checked."""
        return struct.pack(_FORMAT[self.kind], value)

    def value(self, raw: bytes) -> int | float:
        """Return the number that four bytes hold."""
        number: int | float = struct.unpack(_FORMAT[self.kind], raw)[0]
        return number


@dataclass(frozen=True)
class Counter:
    """One counter of events on a board.

    Parameters
    ----------
    index : int
        Index of its COUNTER message.
    identifier : str
        Name in the firmware.
    name : str
        Name that stands behind a number: "3 late chip blocks".
    roles : tuple of str
        Boards on which it can count.
    text : str
        A sentence that says what is counted.
    """

    index: int
    identifier: str
    name: str
    roles: tuple[str, ...]
    text: str


def _stored(kind: Kind, value: int | float) -> int | float:
    """Return a number as 32 bits hold it; what they cannot hold is infinite."""
    if kind is not Kind.FLOAT:
        whole, (least, most) = int(value), _WHOLE[kind]
        return whole if least <= whole <= most else math.copysign(math.inf, value)
    try:
        single: float = struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return math.inf if value > 0 else -math.inf
    return single


def _per_element(entry: Any, elements: int) -> tuple[Any, ...]:
    return tuple(entry) if isinstance(entry, list) else (entry,) * elements


def _parameter(row: Mapping[str, Any]) -> Parameter:
    elements = row.get("elements", 1)
    return Parameter(
        first=row["id"],
        name=row["name"],
        kind=Kind[row["kind"].upper()],
        units=_per_element(row["unit"], elements),
        low=row["range"][0],
        high=row["range"][1],
        default=_per_element(row["default"], elements),
        roles=tuple(row["roles"]),
        at_start={"at start": True, "at once": False}[row["read"]],
        text=row["text"],
        group=elements,
        rows=row.get("rows", 1),
        stride=row.get("stride", 0),
        exact=row.get("whole", False),
        excluded=row.get("excluded"),
        secret=row.get("secret", False),
    )


def _load() -> tuple[Mapping[str, Parameter], tuple[Counter, ...]]:
    file = resources.files("goldfield_protocol") / "parameters.toml"
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    parameters = {row["name"]: _parameter(row) for row in tables["parameter"]}
    counters = (
        Counter(row["index"], row["id"], row["name"], tuple(row["roles"]), row["text"]) for row in tables["counter"]
    )
    return parameters, tuple(counters)


PARAMETERS, COUNTERS = _load()
"""Every parameter by its name, in the order of their ids, and every counter at its index."""

_ELEMENTS = {p.identifier(i): (p, i) for p in PARAMETERS.values() for i in range(p.count)}


def find(name: str) -> Parameter:
    """Return the parameter of a name; `ParameterError` names the nearest one if there is none."""
    if name in PARAMETERS:
        return PARAMETERS[name]
    near = difflib.get_close_matches(name.lower(), PARAMETERS, n=1, cutoff=0)
    raise ParameterError(f"there is no parameter '{name}'; the nearest is '{near[0]}'")


def find_id(identifier: int) -> tuple[Parameter, int] | None:
    """Return the parameter that has an id and the element that it is; None if no parameter has it."""
    return _ELEMENTS.get(identifier)


def label_of(identifier: int) -> str:
    """Return the name of an id for a message; an id that no parameter has is told as a number.

    Examples
    --------
    >>> label_of(2), label_of(259), label_of(200)
    ('amplitude', 'code_list[3]', '200')
    """
    found = find_id(identifier)
    return str(identifier) if found is None else found[0].label(found[1])


def counter_name(index: int) -> str:
    """Return the name of a counter for a message, also of one that this table does not have.

    Examples
    --------
    >>> counter_name(5), counter_name(99)
    ('late chip blocks', 'of counter 99')
    """
    return COUNTERS[index].name if index < len(COUNTERS) else f"of counter {index}"

"""The parameter page of a board (flash sector 11, 0x080E0000): build it from names and values, and read it back.

The layout and the list of parameters are those of ``framing.md``.

``python -m goldfield_protocol.parameters node=7 code=3 code_list=3,17,40 -o page.bin`` writes a page;
``python -m goldfield_protocol.parameters --show page.bin`` prints one.
"""

from __future__ import annotations

import argparse
import difflib
import math
import struct
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

from goldfield_protocol.framing import crc16

MAGIC = 0x31504647
PAGE_BYTES = 8192
PAGE_ADDRESS = 0x080E0000
_HEADER = struct.Struct("<IHH")
_ENTRY = struct.Struct("<HH4s")
CAPACITY = (PAGE_BYTES - _HEADER.size) // _ENTRY.size
"""Most entries that a page holds."""

Value = int | float | Sequence[int] | Sequence[float]


class Kind(IntEnum):
    """How the four bytes of a value are read."""

    UNSIGNED = 0
    SIGNED = 1
    FLOAT = 2


_FORMAT = {Kind.UNSIGNED: "<I", Kind.SIGNED: "<i", Kind.FLOAT: "<f"}


class ParameterError(ValueError):
    """A parameter or a page that is not valid; the message is a sentence for the user."""


@dataclass(frozen=True)
class Parameter:
    """One row of the table in ``framing.md``.

    Parameters
    ----------
    first : int
        Id of the first element.
    kind : Kind
        Type of each element.
    count : int
        Number of elements; a scalar has one.
    low, high : float
        Allowed range of each element, both included.
    excluded : tuple of int
        Values between the two that are not allowed.
    exact : bool
        True if an array must be given whole (a matrix); False if fewer elements are allowed (a list).
    group, stride : int
        A table's ids: rows of ``group`` elements, each row ``stride`` ids after the one before. Whole rows only.
    """

    first: int
    kind: Kind
    count: int = 1
    low: float = -math.inf
    high: float = math.inf
    excluded: tuple[int, ...] = ()
    exact: bool = False
    group: int = 1
    stride: int = 1

    def identifier(self, element: int) -> int:
        """Return the id of an element."""
        return self.first + element // self.group * self.stride + element % self.group


PARAMETERS: Mapping[str, Parameter] = {
    "node": Parameter(0, Kind.UNSIGNED, low=1, high=4095),
    "code": Parameter(1, Kind.UNSIGNED, low=0, high=2048),
    "amplitude": Parameter(2, Kind.FLOAT, low=0),
    "sync_master": Parameter(3, Kind.UNSIGNED, low=0, high=1),
    "stream": Parameter(4, Kind.UNSIGNED, low=0, high=1),
    "code_count": Parameter(5, Kind.UNSIGNED, low=0, high=64),
    "open_coil": Parameter(6, Kind.FLOAT, low=0, high=1),
    "over_current": Parameter(7, Kind.FLOAT, low=0),
    "zero_x": Parameter(8, Kind.FLOAT),
    "zero_y": Parameter(9, Kind.FLOAT),
    "zero_z": Parameter(10, Kind.FLOAT),
    "pose": Parameter(11, Kind.UNSIGNED, low=0, high=1),
    "noise": Parameter(12, Kind.FLOAT, low=0, high=1),
    "waveform": Parameter(13, Kind.UNSIGNED, low=0, high=4),
    "slots": Parameter(14, Kind.UNSIGNED, low=1, high=2047),
    "slot": Parameter(15, Kind.UNSIGNED, low=0, high=2046),
    "calibration": Parameter(16, Kind.FLOAT, count=9, exact=True),
    "periods": Parameter(25, Kind.UNSIGNED, low=1, high=1023),
    "sync_source": Parameter(26, Kind.UNSIGNED, low=0, high=2),
    "parts": Parameter(27, Kind.UNSIGNED, low=1, high=3),
    "degree": Parameter(28, Kind.UNSIGNED, low=5, high=11, excluded=(8,)),
    "half_space": Parameter(32, Kind.FLOAT, count=6, low=-1e6, high=1e6, exact=True),
    "code_list": Parameter(256, Kind.UNSIGNED, count=64, low=0, high=2048),
    "codes": Parameter(320, Kind.UNSIGNED, count=16, low=0, high=2048, group=4, stride=8),
    "beacons": Parameter(512, Kind.FLOAT, count=512, low=-1e6, high=1e6, group=8, stride=16),
}
"""Every parameter by its name."""


def _find(name: str) -> Parameter:
    if name in PARAMETERS:
        return PARAMETERS[name]
    near = difflib.get_close_matches(name, PARAMETERS, n=1, cutoff=0)
    raise ParameterError(f"there is no parameter '{name}'; the nearest is '{near[0]}'")


def _pack(name: str, parameter: Parameter, value: int | float) -> bytes:
    if isinstance(value, bool) or not math.isfinite(value):
        raise ParameterError(f"parameter '{name}' is {value}; it must be a finite number")
    if not parameter.low <= value <= parameter.high:
        raise ParameterError(f"parameter '{name}' is {value:g}; it must lie in {parameter.low:g} to {parameter.high:g}")
    if parameter.kind is not Kind.FLOAT and value != int(value):
        raise ParameterError(f"parameter '{name}' is {value:g}; it must be a whole number")
    if value in parameter.excluded:
        raise ParameterError(
            f"parameter '{name}' is {value:g}; of {parameter.low:g} to {parameter.high:g} that is not allowed"
        )
    try:
        return struct.pack(_FORMAT[parameter.kind], value if parameter.kind is Kind.FLOAT else int(value))
    except (struct.error, OverflowError):
        raise ParameterError(f"parameter '{name}' is {value:g}; that does not fit 32 bits") from None


def build_page(values: Mapping[str, Value]) -> bytes:
    """Build the parameter page.

    Parameters
    ----------
    values : mapping of str to number or sequence of numbers
        Names of `PARAMETERS` with their values: a number, or for ``calibration`` (nine, row by row, T per count),
        ``half_space`` (point and normal), ``code_list`` (up to 64), ``codes`` (four a code) and ``beacons`` (eight a
        beacon) a sequence.
        What is not named keeps the firmware's default.

    Returns
    -------
    bytes
        `PAGE_BYTES` bytes, padded with 0xFF as erased flash is.

    Raises
    ------
    ParameterError
        Unknown name, wrong number of elements, value out of range or not a whole number.

    Examples
    --------
    >>> build_page({"node": 7})[:16].hex()
    '47465031010013600000000007000000'
    """
    entries = []
    for name, value in values.items():
        parameter = _find(name)
        elements = list(value) if isinstance(value, Sequence) else [value]
        if len(elements) > parameter.count or (parameter.exact and len(elements) != parameter.count):
            bound = "" if parameter.exact or parameter.count == 1 else "at most "
            raise ParameterError(f"parameter '{name}' got {len(elements)} values; it takes {bound}{parameter.count}")
        if len(elements) % parameter.group:
            raise ParameterError(f"parameter '{name}' got {len(elements)} values; it takes {parameter.group} a row")
        entries += [
            (parameter.identifier(i), parameter.kind, _pack(name, parameter, element))
            for i, element in enumerate(elements)
        ]
    body = b"".join(_ENTRY.pack(*entry) for entry in sorted(entries))
    page = _HEADER.pack(MAGIC, len(entries), crc16(body)) + body
    return page.ljust(PAGE_BYTES, b"\xff")


def parse_page(page: bytes) -> dict[str, int | float | list[int | float]]:
    """Read a parameter page back into names and values; `build_page` inverts this.

    Parameters
    ----------
    page : bytes
        A page, with or without padding behind its entries.

    Returns
    -------
    dict
        Values by name; arrays are lists.

    Raises
    ------
    ParameterError
        No magic (erased flash, for example), too short, wrong CRC, or an entry that ``framing.md`` does not know.
    """
    if len(page) < _HEADER.size:
        raise ParameterError(f"a page of {len(page)} bytes is shorter than its header of {_HEADER.size}")
    magic, count, crc = _HEADER.unpack_from(page)
    if magic != MAGIC:
        raise ParameterError(f"the page starts with {magic:#010x} and not with {MAGIC:#010x}: it holds no parameters")
    body = page[_HEADER.size : _HEADER.size + count * _ENTRY.size]
    if count > CAPACITY or len(body) < count * _ENTRY.size:
        raise ParameterError(f"the page claims {count} entries; there is room for {len(body) // _ENTRY.size}")
    if crc16(body) != crc:
        raise ParameterError(f"the page's CRC is {crc:#06x}; its entries give {crc16(body):#06x}")
    names = {p.identifier(i): (name, p) for name, p in PARAMETERS.items() for i in range(p.count)}
    result: dict[str, int | float | list[int | float]] = {}
    for identifier, kind, raw in _ENTRY.iter_unpack(body):
        if identifier not in names or names[identifier][1].kind != kind:
            raise ParameterError(f"the page holds an entry of id {identifier} and kind {kind}, which is no parameter")
        name, parameter = names[identifier]
        (value,) = struct.unpack(_FORMAT[parameter.kind], raw)
        if parameter.count == 1:
            result[name] = value
            continue
        elements = result.setdefault(name, [])
        assert isinstance(elements, list)
        if identifier != parameter.identifier(len(elements)):
            raise ParameterError(f"element {len(elements)} of parameter '{name}' is missing in the page")
        elements.append(value)
    return result


def parse_assignment(text: str) -> tuple[str, Value]:
    """Split ``name=value`` or ``name=value,value,...``.

    Raises
    ------
    ParameterError
        No ``=``, an unknown name, or something that is not a number.
    """
    name, separator, right = text.partition("=")
    if not separator:
        raise ParameterError(f"'{text}' is no assignment; write name=value")
    kind = _find(name).kind
    try:
        elements = [float(v) if kind is Kind.FLOAT else int(v, 0) for v in right.split(",")]
    except ValueError:
        wanted = "numbers" if kind is Kind.FLOAT else "whole numbers"
        raise ParameterError(f"'{right}' of parameter '{name}' is not a comma-separated list of {wanted}") from None
    return name, elements[0] if len(elements) == 1 else elements


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code (2: bad input)."""
    parser = argparse.ArgumentParser(
        prog="goldfield_protocol.parameters", description="Write or show a parameter page."
    )
    parser.add_argument("assignments", nargs="*", metavar="name=value", help=", ".join(PARAMETERS))
    parser.add_argument("-o", "--output", type=Path, help="file to write")
    parser.add_argument("--show", type=Path, metavar="PAGE", help="print the values of a page instead")
    options = parser.parse_args(arguments)
    try:
        if options.show is not None:
            for name, value in parse_page(options.show.read_bytes()).items():
                print(f"{name}={','.join(map(str, value)) if isinstance(value, list) else value}")
            return 0
        if options.output is None:
            raise ParameterError("say with -o which file to write")
        options.output.write_bytes(build_page(dict(parse_assignment(text) for text in options.assignments)))
    except (ParameterError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

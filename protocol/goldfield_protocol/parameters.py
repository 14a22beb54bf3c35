"""The parameter page of a board (flash sector 11, 0x080E0000): build it from names and values, and read it back.

The parameters are those of ``parameters.toml``; ``framing.md`` has the layout of the page.

``python -m goldfield_protocol.parameters node=7 code=3 code_list=3,17,40 -o page.bin`` writes a page;
``python -m goldfield_protocol.parameters --show page.bin`` prints one.
"""

from __future__ import annotations

import argparse
import struct
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from goldfield_protocol.framing import crc16
from goldfield_protocol.table import (
    COUNTERS,
    PARAMETERS,
    Counter,
    Kind,
    Parameter,
    ParameterError,
    counter_name,
    find,
    find_id,
    label_of,
)

__all__ = [
    "CAPACITY",
    "COUNTERS",
    "MAGIC",
    "PAGE_ADDRESS",
    "PAGE_BYTES",
    "PARAMETERS",
    "Counter",
    "Kind",
    "Parameter",
    "ParameterError",
    "Value",
    "build_page",
    "counter_name",
    "find_id",
    "label_of",
    "main",
    "parse_assignment",
    "parse_page",
]

MAGIC = 0x31504647
PAGE_BYTES = 8192
PAGE_ADDRESS = 0x080E0000
_HEADER = struct.Struct("<IHH")
_ENTRY = struct.Struct("<HH4s")
CAPACITY = (PAGE_BYTES - _HEADER.size) // _ENTRY.size
"""Most entries that a page holds."""

Value = int | float | Sequence[int] | Sequence[float]


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
        Unknown name, wrong number of elements, or a value that a board refuses.

    Examples
    --------
    >>> build_page({"node": 7})[:16].hex()
    '47465031010013600000000007000000'
    """
    entries = []
    for name, value in values.items():
        parameter = find(name)
        elements = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else [value]
        if len(elements) > parameter.count or (parameter.exact and len(elements) != parameter.count):
            bound = "" if parameter.exact or parameter.count == 1 else "at most "
            raise ParameterError(f"parameter '{name}' got {len(elements)} values; it takes {bound}{parameter.count}")
        if parameter.rows > 1 and len(elements) % parameter.group:
            raise ParameterError(f"parameter '{name}' got {len(elements)} values; it takes {parameter.group} a row")
        entries += [
            (parameter.identifier(i), parameter.kind, parameter.bits(element, i)) for i, element in enumerate(elements)
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
        No magic (erased flash, for example), too short, wrong CRC, or an entry that ``parameters.toml`` does not know.
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
    result: dict[str, int | float | list[int | float]] = {}
    for identifier, kind, raw in _ENTRY.iter_unpack(body):
        found = find_id(identifier)
        if found is None or found[0].kind != kind:
            raise ParameterError(f"the page holds an entry of id {identifier} and kind {kind}, which is no parameter")
        parameter, value = found[0], found[0].value(raw)
        name = parameter.name
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
    kind = find(name).kind
    try:
        elements = [float(v) if kind is Kind.FLOAT else int(v, 0) for v in right.split(",")]
    except ValueError:
        wanted = "numbers" if kind is Kind.FLOAT else "whole numbers"
        raise ParameterError(f"'{right}' of parameter '{name}' is not a comma-separated list of {wanted}") from None
    return name, elements[0] if len(elements) == 1 else elements


def _values(assignments: Sequence[str]) -> dict[str, Value]:
    """Return the values by name; `ParameterError` if a name comes twice."""
    values: dict[str, Value] = {}
    for name, value in map(parse_assignment, assignments):
        if name in values:
            raise ParameterError(f"parameter '{name}' is given twice")
        values[name] = value
    return values


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
        options.output.write_bytes(build_page(_values(options.assignments)))
    except (ParameterError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Parameters as a user writes them, ``amplitude``, ``code_list[3]`` or ``beacons[2][6]``, and their values as text."""

from __future__ import annotations

import re
from collections.abc import Sequence

from goldfield.errors import UserError
from goldfield.link.requests import Value
from goldfield_protocol.parameters import Kind, Parameter, ParameterError
from goldfield_protocol.table import find

NAME = re.compile(r"([A-Za-z_0-9]+)((?:\[\d{1,3}\]){0,2})")


def elements_of(text: str) -> tuple[Parameter, range]:
    """Return the parameter that a name means, and the elements of it: all of an array, or of one row.

    Raises
    ------
    UserError
        If there is no such parameter or element.

    Examples
    --------
    >>> parameter, elements = elements_of("beacons[2]")
    >>> parameter.name, elements
    ('beacons', range(16, 24))
    """
    match = NAME.fullmatch(text)
    if match is None:
        raise UserError(f"'{text}' is no parameter: write a name of docs/parameters.md, as amplitude or code_list[3]")
    try:
        parameter = find(match[1])
    except ParameterError as error:
        raise UserError(str(error)) from error
    places = [int(place) for place in re.findall(r"\d+", match[2])]
    if len(places) > (parameter.rows > 1) + (parameter.group > 1):
        raise UserError(f"'{text}': {parameter.name} has no elements of elements: write {_shape(parameter)}")
    sizes = [size for size in (parameter.rows, parameter.group) if size > 1]
    if any(place >= size for place, size in zip(places, sizes, strict=False)):
        raise UserError(f"'{text}': there is no such element: write {_shape(parameter)}")
    begin, length = 0, parameter.count
    for place, size in zip(places, sizes, strict=False):
        length //= size
        begin += place * length
    return parameter, range(begin, begin + length)


def _shape(parameter: Parameter) -> str:
    sizes = [size for size in (parameter.rows, parameter.group) if size > 1]
    return parameter.name + "".join(f"[0..{size - 1}]" for size in sizes)


def parsed(parameter: Parameter, element: int, text: str) -> Value:
    """Return the value that a text gives to an element, checked as a board checks it.

    Raises
    ------
    UserError
        If the text is no number of the parameter's kind or range.
    """
    try:
        value: Value = float(text) if parameter.kind is Kind.FLOAT else int(text, 0)
    except ValueError:
        wanted = "a number" if parameter.kind is Kind.FLOAT else "a whole number"
        raise UserError(f"{parameter.label(element)} = '{text}': must be {wanted}, {parameter.range_text}") from None
    try:
        return parameter.value(parameter.bits(value, element))
    except ParameterError as error:
        raise UserError(str(error)) from error


def shown(parameter: Parameter, elements: Sequence[int], values: Sequence[Value | None]) -> str:
    """Return values with their unit, as ``8 A`` or ``2, 3, 4``."""
    units = {parameter.units[element % parameter.group] for element in elements}
    unit = f" {units.pop()}" if len(units) == 1 else ""
    said = ", ".join("-" if value is None else f"{value:.7g}" for value in values)
    return f"{said}{unit}".rstrip()

"""What instrumented Python asks at run time: which mutant it is to be, or, while tracing, which would differ.

Functions take the operands of a place, so that each is computed once. `mutant` selects one change, 0 none. While
`tracing`, nothing changes, and the sets tell what was reached, what can be told apart from what is right at all (a
real number has no neighbour, say), and what differed.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np

mutant = 0
tracing = False
reached: set[int] = set()
applicable: set[int] = set()
infected: set[int] = set()

OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "//": operator.floordiv,
    "%": operator.mod,
    "**": operator.pow,
    "&": operator.and_,
    "|": operator.or_,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
OTHER = {"+": "-", "-": "+", "*": "/", "/": "*", "//": "*", "%": "*", "**": "*", "&": "|", "|": "&"}
BOUNDARY = {"<": "<=", "<=": "<", ">": ">=", ">=": ">"}
FARTHER = {"<": -1, "<=": 1, ">": 1, ">=": -1}
"""Where a constant on the right of a comparison goes."""
TRUE, FALSE, EQUAL, STEP, MORE, LESS = range(6)
"""Places of a comparison's changes among its numbers."""


def on(number: int) -> bool:
    """Whether a place is to take its other way."""
    if tracing:
        reached.add(number)
        applicable.add(number)
        infected.add(number)
        return False
    return number == mutant


def _differs(one: Any, other: Any) -> bool:
    try:
        return not np.array_equal(one, other, equal_nan=True)
    except TypeError:
        return bool(np.any(one != other))


def _value(value: Any, numbers: tuple[int, ...], alternative: Callable[[int], Any]) -> Any:
    """Return a value or what the selected of its changes makes of it; `alternative` gives None if there is none."""
    if tracing:
        for place, number in enumerate(numbers):
            if number == 0:
                continue
            reached.add(number)
            if number in infected:
                continue
            with np.errstate(all="ignore"):
                try:
                    other = alternative(place)
                    differs = other is not None and _differs(value, other)
                except (ArithmeticError, TypeError, ValueError):
                    other, differs = 0, True
            if other is not None:
                applicable.add(number)
            if differs:
                infected.add(number)
        return value
    if mutant and mutant in numbers:
        other = alternative(numbers.index(mutant))
        return value if other is None else other
    return value


def binary(number: int, sign: str, left: Any, right: Any) -> Any:
    """Return what an operator of arithmetic makes of its operands."""
    if isinstance(left, str | bytes | list | tuple | set | frozenset | dict):
        return OPERATIONS[sign](left, right)
    return _value(OPERATIONS[sign](left, right), (number,), lambda _: OPERATIONS[OTHER[sign]](left, right))


def _is_real(value: Any) -> bool:
    return isinstance(value, float) or getattr(getattr(value, "dtype", None), "kind", "") in ("f", "c")


def compare(numbers: tuple[int, ...], sign: str, left: Any, right: Any, constant: str, zero: bool) -> Any:
    """Return what a comparison says; `constant` is "left" or "right" if that operand is one, `zero` whether it is 0."""
    value = OPERATIONS[sign](left, right)

    def alternative(place: int) -> Any:
        if place in (TRUE, FALSE):
            return np.full_like(value, place == TRUE) if isinstance(value, np.ndarray) else place == TRUE
        real = _is_real(left) or _is_real(right)
        if place == EQUAL:
            return None if real and not zero else OPERATIONS[BOUNDARY[sign]](left, right)
        if real == (place == STEP):
            return None
        factor = {MORE: 1.1, LESS: 0.9}.get(place, 1)
        step = 0 if place != STEP else FARTHER[sign] if constant == "right" else -FARTHER[sign]
        if constant == "left":
            return OPERATIONS[sign](left * factor + step, right)
        return OPERATIONS[sign](left, right * factor + step)

    return _value(value, numbers, alternative)


def truth(numbers: tuple[int, ...], value: Any) -> Any:
    """Return a condition that nothing compares."""
    return _value(bool(value), numbers, lambda place: place == TRUE) if not isinstance(value, np.ndarray) else value


def constant(number: int, value: Any) -> Any:
    """Return a constant."""
    if isinstance(value, bool):
        return _value(value, (number,), lambda _: not value)
    return _value(value, (number,), lambda _: value * 1.1 if isinstance(value, float) and value else value + 1)


def negated(number: int, value: Any) -> Any:
    """Return a number's negative."""
    return _value(-value, (number,), lambda _: value)

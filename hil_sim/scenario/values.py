"""Values of scenario tables with a default or a range, for all that read them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from goldfield.files.toml_table import Table
from goldfield.site.reading import LEAST_DEVIATION

FloatArray = NDArray[np.float64]

ZERO = np.zeros(3)


def number(table: Table, key: str, default: float) -> float:
    """Return a number, or the default."""
    return table.number(key) if key in table else default


def positive(table: Table, key: str, default: float, most: float = math.inf) -> float:
    """Return a number above zero and at most ``most``, or the default."""
    return _at_most(table, key, table.positive(key), most) if key in table else default


def not_negative(table: Table, key: str, default: float, most: float = math.inf) -> float:
    """Return a number that is zero or more and at most ``most``, or the default."""
    value = number(table, key, default)
    if value < 0.0:
        raise table.error(key, f"is {value:g}; it must not be negative")
    return _at_most(table, key, value, most)


def _at_most(table: Table, key: str, value: float, most: float) -> float:
    if value > most:
        raise table.error(key, f"is {value:g}; at most {most:g} are possible")
    return value


def deviation(table: Table, key: str, limit: float) -> float:
    """Return a standard deviation below a limit, or 0."""
    value = number(table, key, 0.0)
    if not 0.0 <= value < limit:
        raise table.error(key, f"is {value:g}; it is a standard deviation, from 0 to below {limit:g}")
    if 0.0 < value < LEAST_DEVIATION:
        raise table.error(key, f"is {value:g}; nothing is known so well: write 0 for what is exact")
    return value


def vector(table: Table, key: str) -> FloatArray:
    """Return a vector, shape (3,), or zero."""
    return table.vector(key) if key in table else ZERO


def between(table: Table, key: str, low: int, high: int) -> int:
    """Return a whole number of a range, both ends included."""
    value = table.integer(key)
    if not low <= value <= high:
        raise table.error(key, f"is {value}; it must lie in {low} to {high}")
    return value


def seed_of(table: Table, default: int | None = None) -> int:
    """Return the seed of a table, or the default if there is one."""
    if default is not None and "seed" not in table:
        return default
    seed = table.integer("seed")
    if not 0 <= seed < 1 << 63:
        raise table.error("seed", "must lie in 0 to 2^63 - 1")
    return seed

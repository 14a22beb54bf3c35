"""What an optimisation may change and what it is to reach, as a TOML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from goldfield.files.toml_table import Table, read_table
from goldfield.types import FloatArray

FREE = ("position", "axis", "current")
FIGURES = {"p95": 0.95, "worst": 1.0}
LEAST_POWER, MOST_POWER = 1e-4, 1e4
"""Between which ``power`` lies: all currents a hundred times smaller or larger than those of the start."""
KEYS = ("free", "figure", "target_m", "power", "most_current_A")


@dataclass(frozen=True, eq=False)
class Region:
    """A box, with faces along the axes, in which beacons may be: a ceiling if it is flat.

    Attributes
    ----------
    low_m, high_m : ndarray, shape (3,)
    """

    low_m: FloatArray
    high_m: FloatArray

    def contains(self, place_m: FloatArray) -> bool:
        """Tell whether a place, shape (3,), is in the box, to a micrometre."""
        return bool(((place_m >= self.low_m - 1e-6) & (place_m <= self.high_m + 1e-6)).all())


@dataclass(frozen=True, eq=False)
class Wishes:
    """What an optimisation may change and what it is to reach.

    Attributes
    ----------
    free : tuple of str
        What may change, of `FREE`.
    figure : str
        What is to become small: the position bound that 95 % of the points keep ("p95"), or the worst.
    target_m : float or None
        It is enough that the figure is no larger.
    power : float
        Largest sum of the squares of the currents, over that of the start.
    most_current_A : float
        Largest current of a beacon, infinite for none.
    regions : tuple of Region
        Where beacons may be.
    """

    free: tuple[str, ...]
    figure: str
    target_m: float | None
    power: float
    most_current_A: float
    regions: tuple[Region, ...]


def load(path: str | Path) -> Wishes:
    """Read the file.

    The table ``[optimise]`` has, all optional, ``free``, a list of ``"position"`` (the default), ``"axis"`` and
    ``"current"``; ``figure``, ``"p95"`` (the default) or ``"worst"``; ``target_m``; ``power``, 1 by default; and
    ``most_current_A``. Each table ``[[region]]`` has ``low_m`` and ``high_m``, two corners of a box.

    Raises
    ------
    UserError
        If the file cannot be read or a value is missing, unknown or out of range; the sentence names file and key.
    """
    root = read_table(Path(path), "optimisation file")
    root.allow("optimise", "region")
    table = root.table("optimise")
    table.allow(*KEYS)
    figure = table.text("figure") if "figure" in table else "p95"
    if figure not in FIGURES:
        raise table.error("figure", f'is "{figure}": it must be {" or ".join(FIGURES)}')
    power = table.positive("power") if "power" in table else 1.0
    if not LEAST_POWER <= power <= MOST_POWER:
        raise table.error(
            "power", f"is {power:g}: give the sum of the squared currents over that of the start, 1e-4 to 1e4"
        )
    return Wishes(
        free=_free(table),
        figure=figure,
        target_m=table.positive("target_m") if "target_m" in table else None,
        power=power,
        most_current_A=table.positive("most_current_A") if "most_current_A" in table else np.inf,
        regions=tuple(_region(region) for region in root.tables("region")),
    )


def _free(table: Table) -> tuple[str, ...]:
    words = table.texts("free") if "free" in table else ["position"]
    for word in words:
        if word not in FREE:
            raise table.error("free", f'has "{word}": what may be free is {", ".join(FREE)}')
    return tuple(word for word in FREE if word in words)


def _region(table: Table) -> Region:
    table.allow("low_m", "high_m")
    low, high = table.vector("low_m"), table.vector("high_m")
    if (high < low).any():
        raise table.error("high_m", "is below low_m: give the lower corner as low_m")
    return Region(low, high)

"""Sheets of metal: thin squares that no flux passes, each as a grid of square current loops.

The eddy currents of a sheet of some tenths of a metre die out in milliseconds (1 mm of aluminium, 0.3 m: 4 ms), and a
chip lasts a tenth of one: within a chip the sheet is as good as a perfect conductor, and the field through the middle
of each cell vanishes. The outer wires lie a quarter of a cell inside the rim, which makes the moment that a uniform
field induces right to 1 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import magpylib
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

magnets: Any = magpylib  # it carries no types

CELLS = 12
"""Cells along a side of a sheet."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """A square sheet of metal; two of its sides are level.

    Attributes
    ----------
    centre_m, normal : ndarray, shape (3,)
        Its middle and the unit vector at right angles to it, in the site's frame.
    side_m : float
    """

    centre_m: FloatArray
    normal: FloatArray
    side_m: float

    def cells(self) -> FloatArray:
        """Return the corners of the cells, right-handed around the normal and closed, shape (n, 5, 3)."""
        level = np.array([0.0, 0.0, 1.0]) if abs(self.normal[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
        across = np.cross(level, self.normal)
        across /= np.linalg.norm(across)
        axes = np.stack([across, np.cross(self.normal, across)])
        pitch_m = self.side_m / (CELLS + 0.5)
        middles = (np.arange(CELLS) - 0.5 * (CELLS - 1)) * pitch_m
        x, y = (grid.ravel() for grid in np.meshgrid(middles, middles))
        square = 0.5 * pitch_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
        return np.asarray(self.centre_m + (np.stack([x, y], axis=1)[:, None] + square) @ axes)

    def fields(self, positions_m: FloatArray) -> FloatArray:
        """Return B of each cell as a loop of one ampere; see `hil_sim.world.metal.Body`."""
        loops = [magnets.current.Polyline(vertices=loop, current=1.0) for loop in self.cells()]
        return np.asarray(magnets.getB(loops, positions_m, squeeze=False)).reshape(len(loops), len(positions_m), 3)

    def conditions(self) -> tuple[FloatArray, FloatArray]:
        """Return the middles of the cells, and the normal; see `hil_sim.world.metal.Body`."""
        middles = self.cells()[:, :4].mean(axis=1)
        return middles, np.tile(self.normal, (len(middles), 1))

"""Sheets of metal among coils: thin squares that no flux passes, each as a grid of square current loops.

The eddy currents of a sheet of some tenths of a metre die out in milliseconds (1 mm of aluminium, 0.3 m: 4 ms), and a
chip lasts a tenth of one: within a chip the sheet is as good as a perfect conductor. The currents i of the cells follow
from M i = -B, where B is the coil's field through the middles of the cells, and M i that of the cells themselves. The
earth's field passes. The outer wires lie a quarter of a cell inside the rim, which makes the moment that a uniform
field induces right to 1 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import magpylib
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

magnets: Any = magpylib  # it carries no types

CELLS = 12
"""Cells along a side of a sheet."""


class Source(Protocol):
    """Anything with a field in proportion to one current."""

    def field_per_ampere(self, positions_m: FloatArray) -> FloatArray:
        """Return B of one ampere, shape (n, 3), tesla, site's frame, at positions of shape (n, 3)."""
        ...


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


class Metal:
    """All sheets together; each feels the others.

    Parameters
    ----------
    sheets : sequence of Sheet
        At least one.
    """

    def __init__(self, sheets: Sequence[Sheet]) -> None:
        corners = np.concatenate([sheet.cells() for sheet in sheets])
        self._loops = [magnets.current.Polyline(vertices=loop, current=1.0) for loop in corners]
        self._middle_m = corners[:, :4].mean(axis=1)
        self._normal = np.repeat([sheet.normal for sheet in sheets], CELLS**2, axis=0)
        through = np.einsum("jic,ic->ij", self._field(self._middle_m), self._normal)
        self._inverse = np.linalg.inv(through)

    def currents(self, source: Source) -> FloatArray:
        """Return the current of each cell for one ampere in a source."""
        through = (source.field_per_ampere(self._middle_m) * self._normal).sum(axis=1)
        return np.asarray(-self._inverse @ through)

    def field(self, currents: FloatArray, positions_m: FloatArray) -> FloatArray:
        """Return B, shape (n, 3), tesla, of currents in the cells."""
        return np.asarray(np.einsum("j,jnc->nc", currents, self._field(positions_m)))

    def _field(self, positions_m: FloatArray) -> FloatArray:
        """Return B of each cell at each position, shape (cells, n, 3), for one ampere."""
        return np.asarray(magnets.getB(self._loops, positions_m, squeeze=False)).reshape(-1, len(positions_m), 3)


class BesideMetal:
    """A source and what the metal beside it adds to its field."""

    def __init__(self, source: Source, metal: Metal) -> None:
        self._source, self._metal = source, metal
        self._currents = metal.currents(source)

    def field_per_ampere(self, positions_m: FloatArray) -> FloatArray:
        """See `Source.field_per_ampere`."""
        added = self._metal.field(self._currents, positions_m)
        return np.asarray(self._source.field_per_ampere(positions_m) + added)

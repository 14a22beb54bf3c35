"""The points of a plan: a regular grid in a box, divided into tiles that are computed one by one."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from goldfield.errors import UserError, option
from goldfield.types import FloatArray

TILE_POINTS = 256
"""Points of a tile, about: few enough that their neighbours are nearly the same and their matrices stay in the cache,
enough to hide the interpreter."""

MOST_POINTS = 20_000_000
"""Largest grid: its maps take about 120 bytes a point, and the computation hours."""

Tile = tuple[slice, slice, slice]


@dataclass(frozen=True, eq=False)
class Grid:
    """A regular grid of points in the site's frame.

    Attributes
    ----------
    x_m, y_m, z_m : ndarray, shapes (nx,), (ny,), (nz,)
        Ascending coordinates.
    """

    x_m: FloatArray
    y_m: FloatArray
    z_m: FloatArray

    @classmethod
    def of_box(cls, low_m: FloatArray, high_m: FloatArray, step_m: float) -> Grid:
        """Return the points from one corner of a box on, a step apart, up to the other corner.

        An axis along which the corners agree has one point.

        Raises
        ------
        UserError
            If corners or step are none, the corners are the wrong way round, or there are more than `MOST_POINTS`.

        Examples
        --------
        >>> Grid.of_box(np.zeros(3), np.array([1.0, 0.5, 0.0]), 0.25).shape
        (5, 3, 1)
        """
        low_m, high_m = np.asarray(low_m, dtype=np.float64), np.asarray(high_m, dtype=np.float64)
        if low_m.shape != (3,) or high_m.shape != (3,) or not np.isfinite([low_m, high_m]).all():
            raise UserError(f"{option('box')} needs two corners of three finite coordinates each")
        if not step_m > 0.0:
            raise UserError(f"{option('step', f'{step_m:g}')} is no distance greater than zero")
        if (high_m < low_m).any():
            axis = "xyz"[int((high_m < low_m).argmax())]
            raise UserError(f"{option('box')} has its second corner below its first in {axis}: give x0 y0 z0 x1 y1 z1")
        count = np.floor((high_m - low_m) / step_m + 1e-9) + 1.0
        points = float(count[0]) * float(count[1]) * float(count[2])  # infinite without a word where it overflows
        if points > MOST_POINTS:
            raise UserError(
                f"{option('step', f'{step_m:g}')} makes {points:.3g} points in the box: at most {MOST_POINTS} "
                "are computed; give a larger step"
            )
        return cls(*(low + step_m * np.arange(int(n)) for low, n in zip(low_m, count, strict=True)))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of points along x, y and z."""
        return len(self.x_m), len(self.y_m), len(self.z_m)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.x_m) * len(self.y_m) * len(self.z_m)

    def points(self, tile: Tile) -> FloatArray:
        """Return the points of a tile, shape (e, 3), z fastest."""
        axes = (self.x_m[tile[0]], self.y_m[tile[1]], self.z_m[tile[2]])
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    def tiles(self) -> list[Tile]:
        """Divide the grid into compact tiles, which depend on nothing but the grid."""
        edge = [1, 1, 1]
        while edge[0] * edge[1] * edge[2] < TILE_POINTS:
            open_axes = [k for k in range(3) if edge[k] < self.shape[k]]
            if not open_axes:
                break
            edge[min(open_axes, key=edge.__getitem__)] *= 2
        starts = (range(0, n, e) for n, e in zip(self.shape, edge, strict=True))
        return [(slice(i, i + edge[0]), slice(j, j + edge[1]), slice(k, k + edge[2])) for i, j, k in product(*starts)]


def extent(x_m: FloatArray, y_m: FloatArray) -> tuple[float, float, float, float]:
    """Return the edges x0, x1, y0, y1 of the cells around a grid's points, m; a single one has a cell of a metre."""
    (x0, x1), (y0, y1) = _edges(x_m), _edges(y_m)
    return x0, x1, y0, y1


def _edges(axis_m: FloatArray) -> tuple[float, float]:
    half = 0.5 * (axis_m[1] - axis_m[0]) if len(axis_m) > 1 else 0.5
    return float(axis_m[0] - half), float(axis_m[-1] + half)

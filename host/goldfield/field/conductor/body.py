"""Conducting bodies: a material, and a closed surface of triangles around a centre."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.constants import mu_0

from goldfield.errors import UserError, counted
from goldfield.types import FloatArray

PIECES = 12
"""Each edge of the surface is cut into so many: a cube's field is within 2 % then (tests)."""


@dataclass(frozen=True)
class Material:
    """A homogeneous, isotropic, linear material.

    Attributes
    ----------
    conductivity_S_m : float
        May be infinite: a perfect conductor, whatever the frequency.
    relative_permeability : float
    """

    conductivity_S_m: float
    relative_permeability: float = 1.0

    def __post_init__(self) -> None:
        if not self.conductivity_S_m > 0.0:
            raise UserError(f"a conductor's conductivity is {self.conductivity_S_m:g} S/m: give one greater than zero")
        if not 1.0 <= self.relative_permeability < math.inf:
            raise UserError(f"a relative permeability is {self.relative_permeability:g}: give a finite one from 1 up")

    def skin_depth_m(self, frequency_Hz: float) -> float:
        """Return sqrt(2/(omega mu sigma))."""
        if not frequency_Hz > 0.0:
            raise UserError(f"the frequency is {frequency_Hz:g} Hz: eddy currents need one greater than zero")
        permeability = self.relative_permeability * mu_0
        return math.sqrt(1.0 / (math.pi * frequency_Hz * permeability * self.conductivity_S_m))


@dataclass(frozen=True, eq=False)
class Body:
    """A body that is star-shaped around its centre.

    Attributes
    ----------
    material : Material
    centre_m : ndarray, shape (3,)
    corner_m : ndarray, shape (v, 3)
        Corners of the surface's triangles.
    triangles : ndarray of int, shape (t, 3)
        Their corners, right-handed around the outward normal.
    size_m : float
        Radius of the largest ball inside it.
    """

    material: Material
    centre_m: FloatArray
    corner_m: FloatArray
    triangles: NDArray[np.intp]
    size_m: float

    @cached_property
    def sides(self) -> FloatArray:
        """Sides of each triangle, shape (t, 3, 3): side i lies opposite corner i and runs from i + 1 to i + 2."""
        corner = self.corner_m[self.triangles]
        return np.asarray(np.roll(corner, -2, axis=1) - np.roll(corner, -1, axis=1))

    @cached_property
    def area_m2(self) -> FloatArray:
        """Area vectors, outward, shape (t, 3)."""
        return np.asarray(0.5 * np.cross(self.sides[:, 0], self.sides[:, 1]))

    @cached_property
    def middle_m(self) -> FloatArray:
        """Centroids of the triangles, shape (t, 3)."""
        return np.asarray(self.corner_m[self.triangles].mean(axis=1))

    @cached_property
    def patch_m2(self) -> FloatArray:
        """Area of the triangles around each corner over three, shape (v,)."""
        area = np.linalg.norm(self.area_m2, axis=1)
        share = np.repeat(area / 3.0, 3)
        return np.asarray(np.bincount(self.triangles.ravel(), share, len(self.corner_m)), dtype=np.float64)

    @property
    def volume_m3(self) -> float:
        """Volume inside the triangles."""
        return float(((self.middle_m - self.centre_m) * self.area_m2).sum() / 3.0)

    def voxels(self, layers: int) -> tuple[FloatArray, FloatArray]:
        """Cut the cones from the centre to the triangles into layers (Gauss-Legendre nodes).

        A voxel stands at its layer's root mean square distance from the centre, not at its middle: so the moments of
        currents, which are mostly circular, come out right with few voxels.

        Returns
        -------
        position_m : ndarray, shape (n, 3)
        volume_m3 : ndarray, shape (n,)
        """
        node, weight = np.polynomial.legendre.leggauss(layers)
        depth, weight = 0.5 * (node + 1.0), 0.5 * weight
        arm = self.middle_m - self.centre_m
        cone = (arm * self.area_m2).sum(axis=1)
        spread = (self.sides**2).sum(axis=(1, 2)) / 36.0  # of a triangle's points around its centroid, mean square
        arm = arm * np.sqrt(1.0 + spread / (arm * arm).sum(axis=1))[:, None]
        position = self.centre_m + depth[:, None, None] * arm
        return position.reshape(-1, 3), np.asarray(np.outer(weight * depth**2, cone).ravel())


def cuboid(centre_m: FloatArray, edges_m: FloatArray, material: Material, pieces: int = PIECES) -> Body:
    """Return a box with edges along the axes, each edge cut into pieces, finer towards its ends."""
    edges = np.asarray(edges_m, dtype=float)
    if edges.shape != (3,) or not (edges > 0.0).all():
        raise UserError(f"a box's edges are {edges_m}: give three lengths greater than zero")
    corner, triangles = _cube(pieces)
    graded = 0.7 * np.sin(0.5 * np.pi * corner) + 0.3 * corner
    centre = np.asarray(centre_m, dtype=float)
    return Body(material, centre, centre + 0.5 * edges * graded, triangles, 0.5 * float(edges.min()))


def ball(centre_m: FloatArray, radius_m: float, material: Material, pieces: int = PIECES) -> Body:
    """Return a ball, its surface a cube's blown up; the triangles enclose the volume of the true ball."""
    if not radius_m > 0.0:
        raise UserError(f"a ball's radius is {radius_m:g} m: give one greater than zero")
    corner, triangles = _cube(pieces)
    corner = np.tan(0.25 * np.pi * corner)
    corner /= np.linalg.norm(corner, axis=1)[:, None]
    facets = Body(material, np.zeros(3), corner, triangles, 1.0)
    corner *= radius_m * (4.0 / 3.0 * math.pi / facets.volume_m3) ** (1.0 / 3.0)
    return Body(material, np.asarray(centre_m, dtype=float), centre_m + corner, triangles, radius_m)


def _cube(pieces: int) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the corners on the surface of the cube from -1 to 1 and triangles, outward."""
    if pieces < 2:
        raise UserError(f"an edge is cut into {counted(pieces, 'pieces')}: give at least 2")
    index: dict[tuple[int, int, int], int] = {}
    triangles = []
    for axis in range(3):
        for side in (0, pieces):
            for i in range(pieces):
                for j in range(pieces):
                    square = []
                    for a, b in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)):
                        place = [0, 0, 0]
                        place[axis], place[(axis + 1) % 3], place[(axis + 2) % 3] = side, a, b
                        square.append(index.setdefault((place[0], place[1], place[2]), len(index)))
                    if side == 0:
                        square.reverse()
                    first = 0 if (2 * i < pieces) == (2 * j < pieces) else 1  # diagonals symmetric about the middle
                    p, q, r, s = square[first:] + square[:first]
                    triangles += [(p, q, r), (p, r, s)]
    corner = 2.0 * np.array(list(index), dtype=float) / pieces - 1.0
    return corner, np.array(triangles, dtype=np.intp)

"""Perfectly conducting and magnetostatically permeable bodies near dipoles, by boundary elements.

Surface charges Q on flat triangles stand for the body: H = H_0 - grad sum Q_j G. Let F_ij be the part of the flux of a
charge on triangle j that leaves through triangle i: solid angle over 4 pi, seen from the centroid. With the body's mu_r
(0: perfect conductor, no flux enters) continuity of B_n is

    (1/2) (mu_r + 1)/(mu_r - 1) Q_i - sum_j F_ij Q_j = flux of H_0 through triangle i.

Two things make or break the accuracy. Gauss's law sets the diagonal: half of each charge's flux leaves the body, so
each column of F sums to 1/2. And a body has no net charge, but at large mu_r the system barely resists one: it is
projected out.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve
from scipy.spatial import ConvexHull

FloatArray = NDArray[np.float64]
PERFECT_CONDUCTOR = 0.0
"""The relative permeability that stands for a perfect conductor."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed surface of triangles.

    Attributes
    ----------
    corner_m : ndarray, shape (t, 3, 3)
        Corners of each triangle, right-handed around the outward normal.
    """

    corner_m: FloatArray


def cube_surface(centre_m: FloatArray, edge_m: float, pieces: int = 10) -> Surface:
    """Return a cube's surface; each edge is cut into pieces that get finer towards its ends."""
    mark = -np.cos(np.pi * np.arange(pieces + 1) / pieces)
    squares = []
    for a0, a1 in itertools.pairwise(mark):
        for b0, b1 in itertools.pairwise(mark):
            squares.append([(1.0, a0, b0), (1.0, a1, b0), (1.0, a1, b1)])
            squares.append([(1.0, a0, b0), (1.0, a1, b1), (1.0, a0, b1)])
    face = np.array(squares)
    faces = []
    for shift in range(3):
        turned = np.roll(face, shift, axis=2)
        faces += [turned, -turned[:, ::-1]]
    return Surface(np.asarray(centre_m, dtype=float) + 0.5 * edge_m * np.concatenate(faces))


def sphere_surface(centre_m: FloatArray, radius_m: float, points: int = 700) -> Surface:
    """Return a sphere's surface, triangulated between points of a golden spiral; it encloses the true volume."""
    place = np.arange(points) + 0.5
    height, turn = 1.0 - 2.0 * place / points, place * math.pi * (3.0 - math.sqrt(5.0))
    wide = np.sqrt(1.0 - height**2)
    point = np.stack([wide * np.cos(turn), wide * np.sin(turn), height], axis=1)
    hull = ConvexHull(point)
    corner = point[hull.simplices]
    inward = (np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) * corner[:, 0]).sum(axis=1) < 0.0
    corner[inward] = corner[inward][:, ::-1]
    corner *= (4.0 / 3.0 * math.pi / hull.volume) ** (1.0 / 3.0)
    return Surface(np.asarray(centre_m, dtype=float) + radius_m * corner)


class BoundaryElements:
    """A body, ready for any dipoles outside it.

    Parameters
    ----------
    surface : Surface
    relative_permeability : float
        0 for a perfect conductor (`PERFECT_CONDUCTOR`), else other than 1.
    """

    def __init__(self, surface: Surface, relative_permeability: float) -> None:
        corner = surface.corner_m
        self._corner, self._middle = corner, corner.mean(axis=1)
        count = len(corner)
        flux = _solid_angle(corner[:, None], self._middle[None]) / (4.0 * math.pi)
        np.fill_diagonal(flux, 0.0)
        np.fill_diagonal(flux, 0.5 - flux.sum(axis=0))
        contrast = (relative_permeability + 1.0) / (relative_permeability - 1.0)
        system = 0.5 * contrast * np.eye(count) - flux
        # With the net charge tied to an unknown of its own, whose value is the flux that the charges cannot carry.
        area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
        bordered = np.ones((count + 1, count + 1))
        bordered[:count, :count], bordered[:count, count], bordered[count, count] = system, area / area.mean(), 0.0
        self._factors = lu_factor(bordered)
        # A charge acts from four points of its triangle.
        halves = 0.5 * (corner + np.roll(corner, -1, axis=1))
        inner = [halves.mean(axis=1)]
        inner += [(corner[:, i] + halves[:, i] + halves[:, i - 1]) / 3.0 for i in range(3)]
        self._points = np.stack(inner, axis=1)

    def secondary(self, point_m: FloatArray, source_m: FloatArray, moment_A_m2: FloatArray) -> FloatArray:
        """Return the field that the body adds at points outside.

        Parameters
        ----------
        point_m : ndarray, shape (p, 3)
        source_m, moment_A_m2 : ndarray, shape (3,)
            A dipole.

        Returns
        -------
        field_A_m : ndarray, shape (p, 3)
        """
        applied = np.append(_dipole_flux(self._corner, source_m, moment_A_m2), 0.0)
        charge = lu_solve(self._factors, applied)[:-1]
        field = np.empty((len(point_m), 3))
        for place, point in enumerate(point_m):
            offset = point - self._points
            each = offset / (np.linalg.norm(offset, axis=2, keepdims=True) ** 3)
            field[place] = charge @ each.mean(axis=1) / (4.0 * math.pi)
        return field


def _solid_angle(corner_m: FloatArray, point_m: FloatArray) -> FloatArray:
    """Solid angle of triangles, positive where the normal points away from the point (van Oosterom & Strackee)."""
    r = corner_m - point_m[..., None, :]
    length = np.linalg.norm(r, axis=-1)
    a, b, c = r[..., 0, :], r[..., 1, :], r[..., 2, :]
    triple = (a * np.cross(b, c)).sum(axis=-1)
    sums = length.prod(axis=-1) + (a * b).sum(axis=-1) * length[..., 2]
    sums += (b * c).sum(axis=-1) * length[..., 0] + (c * a).sum(axis=-1) * length[..., 1]
    return np.asarray(2.0 * np.arctan2(triple, sums))


def _dipole_flux(corner_m: FloatArray, source_m: FloatArray, moment_A_m2: FloatArray) -> FloatArray:
    """Flux of a dipole's H through triangles: the circulation of its vector potential, exact.

    Along a side from P to Q, with a = P - d, b = Q - d: int m x r/(4 pi r^3) . dl = m . (a x b)(|a| + |b|)
    / (4 pi |a| |b| (|a| |b| + a.b)).
    """
    start = corner_m - source_m
    end = np.roll(start, -1, axis=1)
    length_a, length_b = np.linalg.norm(start, axis=2), np.linalg.norm(end, axis=2)
    product = length_a * length_b
    across = np.cross(start, end) @ moment_A_m2
    side = across * (length_a + length_b) / (product * (product + (start * end).sum(axis=2)))
    return np.asarray(side.sum(axis=1) / (4.0 * math.pi))

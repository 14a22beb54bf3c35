"""Integrals of potentials over the triangles of a closed surface, in closed form.

Solid angle: van Oosterom & Strackee 1983; linear double layer: de Munck 1992; uniform single layer: Wilton et al. 1984.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from goldfield.field.conductor.body import Body
from goldfield.types import FloatArray


@lru_cache(maxsize=1)
def layer_matrices(body: Body) -> tuple[FloatArray, FloatArray]:
    """Potentials at the surface's corners; the last body's are kept, for its responses at several frequencies.

    Returns
    -------
    double : ndarray, shape (v, v)
        Just outside the surface, of a double layer that is linear on the triangles: phi = int f dG/dn dy. The diagonal
        follows from Gauss's law: a constant double layer has no potential outside.
    single : ndarray, shape (v, v)
        Potential of a charge of one at a corner, spread evenly over the triangles around it: phi = int q G dy, 1/m.
    """
    point, triangles = body.corner_m, body.triangles
    corner = body.corner_m[triangles]
    area = np.linalg.norm(body.area_m2, axis=1)
    normal = body.area_m2 / area[:, None]
    sides = body.sides
    length = np.linalg.norm(sides, axis=2)
    unit = sides / length[..., None]

    y = corner[None] - point[:, None, None]  # (v, t, 3, 3)
    distance = np.linalg.norm(y, axis=-1)
    height = np.einsum("vtc,tc->vt", y[:, :, 0], normal)  # of the plane over the point, along the normal
    start = np.roll(y, -1, axis=2)
    start_distance, end_distance = np.roll(distance, -1, axis=2), np.roll(distance, -2, axis=2)
    # ln((|end| + end.u)/(|start| + start.u)), in the form without cancellation: ln((a + b + l)/(a + b - l))
    both = start_distance + end_distance
    touching = both - length < 1e-9 * length  # the point lies on the side: the factor that multiplies vanishes
    logarithm = np.where(touching, 0.0, np.log((both + length) / np.where(touching, length, both - length)))

    product = distance.prod(axis=2)
    sums = product.copy()
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        sums += distance[:, :, i] * (y[:, :, j] * y[:, :, k]).sum(axis=-1)
    flat = np.abs(height) < 1e-9 * np.sqrt(area)
    solid = np.where(flat, 0.0, 2.0 * np.arctan2(2.0 * area * height, sums))

    # Distance of the point's foot from each side, inward positive.
    inward = np.cross(normal[:, None], unit)
    foot = -np.einsum("vtsc,tsc->vts", start, inward)
    potential = (foot * logarithm).sum(axis=2) - np.abs(height) * np.abs(solid)

    # Linear double layer: weight of corner i = barycentric coordinate of the foot times solid angle + edge terms.
    barycentric = foot * length / (2.0 * area[:, None])
    along = (logarithm[..., None] * unit).sum(axis=2)  # (v, t, 3)
    edge = np.einsum("vtc,tsc->vts", along, sides) / (2.0 * area[:, None])
    weight = barycentric * solid[..., None] + np.where(flat, 0.0, height)[..., None] * edge

    count = len(point)
    double = np.zeros((count, count))
    spread = np.zeros((len(triangles), count))
    patch = np.zeros(count)
    for i in range(3):
        np.add.at(double.T, triangles[:, i], -weight[:, :, i].T / (4.0 * np.pi))
        np.add.at(patch, triangles[:, i], area)
        spread[np.arange(len(triangles)), triangles[:, i]] = 1.0
    np.fill_diagonal(double, 0.0)
    np.fill_diagonal(double, -double.sum(axis=1))
    return double, potential @ (spread / patch) / (4.0 * np.pi)


def slope_matrix(body: Body) -> FloatArray:
    """Return the gradient on each triangle of a function that is linear on it, by its corners, shape (t, 3, 3)."""
    double_area = 2.0 * np.linalg.norm(body.area_m2, axis=1)
    normal = 2.0 * body.area_m2 / double_area[:, None]
    return np.asarray(np.cross(normal[:, None], body.sides) / double_area[:, None, None])


def stiffness(body: Body) -> FloatArray:
    """Return int grad N_i . grad N_j dy over the surface, shape (v, v)."""
    slope = slope_matrix(body)
    local = np.einsum("tic,tjc,t->tij", slope, slope, np.linalg.norm(body.area_m2, axis=1))
    result = np.zeros((len(body.corner_m),) * 2)
    for i in range(3):
        for j in range(3):
            np.add.at(result, (body.triangles[:, i], body.triangles[:, j]), local[:, i, j])
    return result

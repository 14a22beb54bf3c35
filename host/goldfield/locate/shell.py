"""Starts without magnitudes' blind spots: every direction around the strongest beacon, the attitude profiled out.

The strongest beacon's magnitude fixes the distance in each direction, |B| = k sqrt(1 + 3 cos^2 theta)/r^3, so the unknown position is a
point of a shell around it: a two-dimensional search for any geometry, however large the site. At each point the best attitude
has a closed form, so the loss is a function of the direction alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.field.constants import MU0_OVER_4PI
from goldfield.locate.wahba import wahba, wahba_loss
from goldfield.poses import FloatArray
from goldfield.site import HalfSpace

COARSENESS = 0.3
"""Relative error of the fields between neighbouring candidates, as a weight: the shell must not miss a narrow valley."""


def directions(count: int) -> FloatArray:
    """Evenly spread unit vectors, shape (count, 3): Fibonacci's spiral."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * index
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def shell(
    model: FieldModel, field_T: FloatArray, sigma_T: FloatArray, unit: FloatArray, half_space: HalfSpace | None = None
) -> FloatArray:
    """Candidate positions around the strongest beacon, shape (m, 3), m = three distances a direction.

    Parameters
    ----------
    field_T, sigma_T : ndarray, shapes (n, 3) and (n,)
        Of one epoch; NaN where not measured.
    unit : ndarray, shape (d, 3)
        Directions, see `directions`.
    half_space : HalfSpace, optional
        Leaves out candidates on the other side.
    """
    measured = np.isfinite(field_T)
    axes = measured.sum(axis=1)
    # A sensor with fewer axes sees less of the field: correct on average.
    magnitude = np.sqrt((np.where(measured, field_T, 0.0) ** 2).sum(axis=1) * 3.0 / np.maximum(axes, 1))
    strongest = int(np.argmax(magnitude))
    moment = model.moment_A_m2[strongest]
    k = MU0_OVER_4PI * np.linalg.norm(moment)
    cosine = unit @ (moment / np.linalg.norm(moment))
    distance = np.cbrt(k * np.sqrt(1.0 + 3.0 * cosine**2) / magnitude[strongest])
    factors = np.array([0.8, 1.0, 1.25]) if axes[strongest] == 3 else np.array([0.5, 0.7, 0.9, 1.1])
    offset = (factors[:, None] * distance)[:, :, None] * unit
    position = model.centre_m[strongest] + offset.reshape(-1, 3)
    if half_space is not None:
        position = position[(position - half_space.point_m) @ half_space.normal >= 0.0]
    return np.asarray(position)


def profiled_loss(model: FieldModel, field_T: FloatArray, sigma_T: FloatArray, position_m: FloatArray) -> FloatArray:
    """Loss at each candidate position, shape (m,), with the best attitude there.

    Three measured axes: Wahba's loss. Fewer: the components are linear in the sensor's axes, b_i = s . B_i(p), so each s follows by
    linear least squares with |s| = 1; the axes' right angle is left to the fit.

    Parameters
    ----------
    field_T, sigma_T : ndarray, shapes (n, 3) and (n,)
    position_m : ndarray, shape (m, 3)
    """
    field = model.field(position_m)
    measured, filled, weight = _coarse(field_T, sigma_T)
    if _complete(measured):
        return wahba_loss(field, filled[None], weight[None])
    loss = np.zeros(len(position_m))
    for axis in np.flatnonzero(measured.any(axis=0)):
        rows = measured[:, axis]
        loss += unit_vector_fit(field[:, rows], filled[rows, axis], weight[rows])[1]
    return loss


def profiled_attitude(
    model: FieldModel, field_T: FloatArray, sigma_T: FloatArray, position_m: FloatArray
) -> FloatArray:
    """Best attitude at each candidate position, shape (m, 3, 3); arguments as `profiled_loss`."""
    field = model.field(position_m)
    measured, filled, weight = _coarse(field_T, sigma_T)
    if _complete(measured):
        return wahba(field, filled[None], weight[None])
    columns = np.zeros((len(position_m), 3, 3))
    for axis in np.flatnonzero(measured.any(axis=0)):
        rows = measured[:, axis]
        columns[:, :, axis] = unit_vector_fit(field[:, rows], filled[rows, axis], weight[rows])[0]
    return _completed(columns)


def _coarse(field_T: FloatArray, sigma_T: FloatArray) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
    measured = np.isfinite(field_T)
    filled = np.where(measured, field_T, 0.0)
    scale = COARSENESS * np.sqrt((filled**2).sum(axis=1))
    return measured, filled, np.where(measured.any(axis=1), 1.0 / (sigma_T**2 + scale**2), 0.0)


def _complete(measured: NDArray[np.bool_]) -> bool:
    return bool((measured.all(axis=1) == measured.any(axis=1)).all())


def unit_vector_fit(field: FloatArray, value: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vector s that minimises sum_i w_i (b_i - s . B_i)^2, and that sum.

    Lagrange: (A + mu I) s = c with |s| = 1; mu by Newton on 1/|s(mu)| - 1, which is nearly linear (More and Sorensen).

    Parameters
    ----------
    field : ndarray, shape (m, n, 3)
    value, weight : ndarray, shape (n,)

    Returns
    -------
    direction : ndarray, shape (m, 3)
    misfit : ndarray, shape (m,)
    """
    weighted = field * weight[:, None]
    eigenvalue, vector = np.linalg.eigh(weighted.swapaxes(1, 2) @ field)
    c = np.einsum("mnc,n->mc", weighted, value)
    along = np.einsum("mck,mc->mk", vector, c)
    size = np.linalg.norm(c, axis=1)
    lowest = eigenvalue[:, 0]
    floor = 1e-12 * eigenvalue[:, 2] + 1e-300
    mu = np.maximum(-lowest + np.abs(along[:, 0]), -lowest + floor)  # |s| >= 1 here, so Newton climbs from one side
    for _ in range(12):
        parts = along / (eigenvalue + mu[:, None])
        norm = np.sqrt((parts**2).sum(axis=1)) + 1e-300
        slope = (parts**2 / (eigenvalue + mu[:, None])).sum(axis=1) / norm**3
        mu = np.clip(mu + (1.0 - 1.0 / norm) / (slope + 1e-300), -lowest + floor, -lowest + size + floor)
    parts = along / (eigenvalue + mu[:, None])
    direction = np.einsum("mck,mk->mc", vector, parts)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True) + 1e-300
    error = value - np.einsum("mnc,mc->mn", field, direction)
    return direction, np.asarray((error**2) @ weight)


def best_apart(position_m: FloatArray, loss: FloatArray, count: int, apart_m: FloatArray) -> NDArray[np.intp]:
    """Indices of the lowest losses, at most ``count``, each further than ``apart_m``, shape (m,), from the better ones."""
    left = np.where(np.isfinite(loss), loss, np.inf)
    kept: list[int] = []
    while len(kept) < count and left.min(initial=np.inf) < np.inf:
        best = int(np.argmin(left))
        kept.append(best)
        left[np.linalg.norm(position_m - position_m[best], axis=1) <= apart_m[best]] = np.inf
        left[best] = np.inf
    return np.array(kept, dtype=np.intp)


def _completed(columns: FloatArray) -> FloatArray:
    """Rotations, shape (m, 3, 3), whose columns are as near as can be to those given; columns of zeros are free."""
    u, _, vt = np.linalg.svd(columns)
    vt = vt.copy()
    vt[:, 2] *= np.linalg.det(u @ vt)[:, None]
    return np.asarray(u @ vt)

"""A start for any geometry and any sensor: the surroundings of the strongest beacon, the attitude profiled out.

The strongest beacon's magnitude nearly fixes the distance in each direction, |B| = k sqrt(1 + 3 cos^2 theta)/r^3, so
the unknown position is on a thin shell around it: little more than a two-dimensional search, however large the site.
At each point the best attitude has a closed form, which leaves a loss that depends on the position alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate.wahba import wahba, wahba_loss
from goldfield.types import FloatArray

COARSENESS = 0.3
"""Relative change of the fields between neighbouring candidates, used as an error: no narrow valley may be missed."""

DIRECTIONS = 300
DISTANCE_RATIO = 1.25
"""Ratio of the distances of neighbouring points on a ray."""

FULL_WINDOW = (0.6, 1.7)
"""A point is a candidate if the strongest beacon's field there, over the measured one, lies between these."""

PARTIAL_WINDOW = (0.9, 30.0)
"""The same for a sensor with one or two axes, which sees no more of the field than there is, but perhaps much less."""


class Shell:
    """Points around each beacon with the fields of all beacons there, computed when first needed.

    Parameters
    ----------
    model : FieldModel
        n coils.
    whole : Shell, optional
        Shell of coils of which these are some, given by their ``rows``: its fields are used again, since those of a
        site with many coils take longer than the search.
    """

    def __init__(self, model: FieldModel, whole: Shell | None = None, rows: NDArray[np.intp] | None = None) -> None:
        self._model, self._whole = model, whole
        self._rows = np.arange(len(model)) if rows is None else rows
        self._known: dict[int, tuple[FloatArray, FloatArray]] = {}

    def candidates(self, field_T: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions, shape (m, 3), where the strongest beacon is about as strong as measured, and all fields there.

        Parameters
        ----------
        field_T : ndarray, shape (n, 3)
            Fields of one epoch; NaN where not measured.

        Returns
        -------
        position_m : ndarray, shape (m, 3)
        field_T : ndarray, shape (m, n, 3)
        """
        measured = np.isfinite(field_T)
        magnitude = np.sqrt((np.where(measured, field_T, 0.0) ** 2).sum(axis=1))
        strongest = int(np.argmax(magnitude))
        low, high = FULL_WINDOW if measured[strongest].all() else PARTIAL_WINDOW
        position, field = self._around(strongest)
        ratio = np.linalg.norm(field[:, strongest], axis=1) / max(float(magnitude[strongest]), 1e-30)
        chosen = (ratio > low) & (ratio < high)
        return position[chosen], field[chosen]

    def _around(self, beacon: int) -> tuple[FloatArray, FloatArray]:
        if self._whole is not None:
            position, field = self._whole._around(int(self._rows[beacon]))
            return position, field[:, self._rows]
        if beacon not in self._known:
            centre = self._model.centre_m
            nearest = 0.5 * float(self._model.reach_m[beacon])
            furthest = max(3.0 * float(np.linalg.norm(centre - centre[beacon], axis=1).max()), 20.0 * nearest)
            count = 1 + int(np.ceil(np.log(furthest / nearest) / np.log(DISTANCE_RATIO)))
            distance = nearest * DISTANCE_RATIO ** np.arange(count)
            position = (centre[beacon] + distance[:, None, None] * directions(DIRECTIONS)).reshape(-1, 3)
            parts = np.array_split(position, max(len(position) // 512, 1))  # the wires' segments need the memory
            self._known[beacon] = position, np.concatenate([self._model.field(part) for part in parts])
        return self._known[beacon]


def directions(count: int) -> FloatArray:
    """Return evenly spread unit vectors, shape (count, 3): Fibonacci's spiral."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * index
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def profiled_loss(modelled_T: FloatArray, field_T: FloatArray, sigma_T: FloatArray) -> FloatArray:
    """Loss at each candidate position, shape (m,), with the best attitude there.

    Three measured axes: Wahba's loss. Fewer: the components are linear in the sensor's axes, b_i = s . B_i(p), so
    each s follows by linear least squares with |s| = 1; the axes' right angle is left to the fit.

    Parameters
    ----------
    modelled_T : ndarray, shape (m, n, 3)
        Fields at the candidates.
    field_T, sigma_T : ndarray, shapes (n, 3) and (n,)
        Measured; NaN where not.
    """
    measured, filled, weight = _coarse(field_T, sigma_T)
    if _complete(measured):
        return wahba_loss(modelled_T, filled[None], weight[None])
    loss = np.zeros(len(modelled_T))
    for axis in np.flatnonzero(measured.any(axis=0)):
        rows = measured[:, axis]
        loss += unit_vector_fit(modelled_T[:, rows], filled[rows, axis], weight[rows])[1]
    return loss


def profiled_attitude(modelled_T: FloatArray, field_T: FloatArray, sigma_T: FloatArray) -> FloatArray:
    """Best attitude at each candidate position, shape (m, 3, 3); arguments as `profiled_loss`."""
    measured, filled, weight = _coarse(field_T, sigma_T)
    if _complete(measured):
        return wahba(modelled_T, filled[None], weight[None])
    columns = np.zeros((len(modelled_T), 3, 3))
    for axis in np.flatnonzero(measured.any(axis=0)):
        rows = measured[:, axis]
        columns[:, :, axis] = unit_vector_fit(modelled_T[:, rows], filled[rows, axis], weight[rows])[0]
    return _completed(columns)


def _coarse(field_T: FloatArray, sigma_T: FloatArray) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
    measured = np.isfinite(field_T)
    filled = np.where(measured, field_T, 0.0)
    scale = COARSENESS * np.sqrt((filled**2).sum(axis=1))
    return measured, filled, np.where(measured.any(axis=1), 1.0 / (sigma_T**2 + scale**2), 0.0)


def _complete(measured: NDArray[np.bool_]) -> bool:
    return bool((measured.all(axis=1) == measured.any(axis=1)).all())


def unit_vector_fit(field: FloatArray, value: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the unit vector s that minimises sum_i w_i (b_i - s . B_i)^2, and that sum.

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
    along = np.einsum("mck,mc->mk", vector, np.einsum("mnc,n->mc", weighted, value))
    lowest = eigenvalue[:, 0]
    least = -lowest + 1e-12 * eigenvalue[:, 2] + np.finfo(float).tiny
    mu = np.maximum(-lowest + np.abs(along[:, 0]), least)  # |s| >= 1 here, so Newton climbs from one side
    for _ in range(12):
        parts = along / (eigenvalue + mu[:, None])
        square = (parts**2).sum(axis=1)
        slope = (parts**2 / (eigenvalue + mu[:, None])).sum(axis=1)
        mu = np.maximum(mu + (np.sqrt(square) - 1.0) * square / np.maximum(slope, np.finfo(float).tiny), least)
    parts = along / (eigenvalue + mu[:, None])
    # Where nothing tells of the direction of the lowest eigenvalue, what is left of the length lies along it.
    rest = np.sqrt(np.maximum(1.0 - (parts[:, 1:] ** 2).sum(axis=1), 0.0))
    parts[:, 0] = np.copysign(rest, parts[:, 0])
    direction = np.einsum("mck,mk->mc", vector, parts)
    error = value - np.einsum("mnc,mc->mn", field, direction)
    return direction, np.asarray((error**2) @ weight)


def best_apart(position_m: FloatArray, loss: FloatArray, count: int, apart_m: FloatArray) -> NDArray[np.intp]:
    """Return indices of the lowest losses, at most ``count``, each further than ``apart_m`` from the better ones."""
    left = np.where(np.isfinite(loss), loss, np.inf)
    kept: list[int] = []
    while len(kept) < count and left.min(initial=np.inf) < np.inf:
        best = int(np.argmin(left))
        kept.append(best)
        left[np.linalg.norm(position_m - position_m[best], axis=1) <= apart_m[best]] = np.inf
    return np.array(kept, dtype=np.intp)


def _completed(columns: FloatArray) -> FloatArray:
    """Rotations, shape (m, 3, 3), whose columns are as near as can be to those given; columns of zeros are free."""
    u, _, vt = np.linalg.svd(columns)
    vt = vt.copy()
    vt[:, 2] *= np.linalg.det(u @ vt)[:, None]
    return np.asarray(u @ vt)

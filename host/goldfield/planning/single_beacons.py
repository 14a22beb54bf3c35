"""What a single beacon means for the position: its part in it, and what its fault could hide.

The estimate is the sum of what each beacon contributes, K A_i' C_i^-1 y_i with K the joint covariance, so the beacon's
part in the variance of the position is |U_i|^2, U_i = C_i^-1/2 A_i K[:, place]. The covariance of what the position
without the beacon has more than that with it is U_i' G_i^-1 U_i with G_i = 1 - C_i^-1/2 A_i K A_i' C_i^-1/2, what is
left of its residuals' covariance: the separation of `goldfield.locate.fault_statistics`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield.locate.fault_statistics import DETECTABLE
from goldfield.locate.protection import level_of
from goldfield.types import FloatArray

LONGEST = 3.3
"""A normal vector of a total mean square v is longer than this times the root of v with less than the probability of
`MISSED_DETECTION`, however it is spread over the axes: along one axis it reaches 3.29."""

FEWEST = 4
"""Beacons whose radii are computed first: mostly no other can have a larger one."""


def contributions(columns: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what beacons contribute to the position.

    Parameters
    ----------
    columns : ndarray, shape (e, n, 3, k)
        Whitened.
    covariance : ndarray, shape (e, k, k)
        Joint covariance of pose and distortion.

    Returns
    -------
    influence : ndarray, shape (e, n, 3, k)
        C_i^-1/2 A_i K.
    weight : ndarray, shape (e, n)
        Variance of the position that comes from each beacon, m^2.
    """
    influence = (columns.reshape(len(columns), -1, columns.shape[-1]) @ covariance).reshape(columns.shape)
    place = influence[..., :3]
    return influence, np.einsum("enck,enck->en", place, place)


def best_of(weight: FloatArray, count: int) -> NDArray[np.intp]:
    """Return the columns of the beacons with the largest parts, shape (e, min(count, n)), the largest first."""
    return np.argsort(-weight, axis=1, kind="stable")[:, :count]


def protection(
    columns: FloatArray, influence: FloatArray, weight: FloatArray, position_cov_m2: FloatArray
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the protection level of a typical epoch, shape (e,), and the column of the beacon that sets it.

    It is the locator's own, for separations of one standard deviation along their worst axes, which is what noise
    makes of them. Beacons that cannot set it are left out of the computation.

    Parameters
    ----------
    columns, influence, weight : ndarray
        See `contributions`.
    position_cov_m2 : ndarray, shape (e, 3, 3)
    """
    left = 1.0 - np.einsum("enck,enck->en", influence, columns)  # at most the least eigenvalue of G
    most = np.where(left > 0.0, weight / np.maximum(left, 1e-300), np.inf)  # at least the separation's variance
    order = np.argsort(-most, axis=1, kind="stable")
    noise = np.einsum("ekk->e", position_cov_m2)
    count = min(FEWEST, weight.shape[1])
    while True:
        chosen = order[:, :count]
        level, worst = _level(_of(chosen, columns), _of(chosen, influence), position_cov_m2)
        if count == weight.shape[1]:
            break
        following = np.take_along_axis(most, order[:, count : count + 1], axis=1)[:, 0]
        if not (LONGEST * np.sqrt(noise + 2.0 * following) > level).any():
            break
        count = min(2 * count, weight.shape[1])
    return level, np.take_along_axis(chosen, worst[:, None], axis=1)[:, 0]


def _of(chosen: NDArray[np.intp], table: FloatArray) -> FloatArray:
    """Return the rows of some beacons, shape (e, m), of a table, shape (e, n, 3, k)."""
    return np.take_along_axis(table, chosen[:, :, None, None], axis=1)


def _level(
    column: FloatArray, influence: FloatArray, position_cov_m2: FloatArray
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the level that some beacons set, and which of them."""
    gain, vector = np.linalg.eigh(np.eye(3) - influence @ column.swapaxes(2, 3))
    seen = gain > DETECTABLE
    move = influence[..., :3].swapaxes(2, 3) @ vector  # position by the independent parts of the residuals
    move = np.where(seen[:, :, None, :], move / np.sqrt(np.where(seen, gain, 1.0))[:, :, None, :], 0.0)
    separation_cov = move @ move.swapaxes(2, 3)
    variance, axis = np.linalg.eigh(separation_cov)
    separation = np.sqrt(np.maximum(variance[..., 2:], 0.0)) * axis[..., 2]
    return level_of(separation, separation_cov, np.asarray(~seen.all(axis=2)), position_cov_m2)

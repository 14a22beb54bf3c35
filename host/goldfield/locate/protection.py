"""Protection level: a radius that the position error exceeds only rarely, whatever fault one beacon has.

The method is solution separation (Brown and McBurney, 1988; Blanch et al., 2015), with what the epoch has measured in
place of the worst that the alarm lets pass. If beacon i has a fault of any kind and size, the position without it is
right within its own covariance, and the error of the position is d plus that of the position without the beacon, where
d, the separation of the two, is known. So the error is beyond the radius that a normal vector of mean d and the
covariance P_i without the beacon exceeds with a probability of `MISSED_DETECTION` no oftener than that. The level is
the greatest of these radii and of the one that the noise of a sound epoch exceeds with `SOUND_RISK`. It holds for one
faulty beacon, as in aviation, and says nothing of two that fail together.

No level that holds for a fault of any size can be far below three standard deviations of the worst P_i: a fault of
three may by chance of the noise leave residuals of nothing at all.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from goldfield.locate.chances import ndtri
from goldfield.locate.fault_statistics import FaultStatistics
from goldfield.locate.fit import Measurements
from goldfield.types import FloatArray

INTEGRITY_RISK = 1e-7
"""Permitted probability of an epoch with an error beyond the level, of a fault and of noise alone, each."""

FAULT_PRIOR = 1e-4
"""Assumed probability that a beacon is at fault and nothing has told yet."""

MISSED_DETECTION = INTEGRITY_RISK / FAULT_PRIOR
"""Permitted probability of an error beyond the level in an epoch with a fault, the worst that there is."""

SOUND_RISK = INTEGRITY_RISK
"""Permitted probability of an error beyond the level in an epoch without a fault."""


def radius_m(mean_m: FloatArray, covariance_m2: FloatArray, risk: FloatArray) -> FloatArray:
    """Return the length that normal vectors exceed with a probability of ``risk``.

    The square of the length has the first three cumulants of a chi-square that is scaled and shifted (Imhof, 1961),
    whose quantile is by Wilson and Hilferty (1931). At a risk of 1e-3 the true one is .7 to 1.07 times as large, at
    1e-7 below half.

    Parameters
    ----------
    mean_m : ndarray, shape (..., 3)
    covariance_m2 : ndarray, shape (..., 3, 3)
    risk : ndarray, broadcast to shape (...)

    Returns
    -------
    radius_m : ndarray, shape (...)
    """
    return _radius_m(mean_m, covariance_m2, ndtri(risk))


def _radius_m(mean_m: FloatArray, covariance_m2: FloatArray, quantile: FloatArray) -> FloatArray:
    """Compute `radius_m`; the normal variable is below the quantile with the permitted probability."""
    size = np.einsum("...kk", covariance_m2) + np.einsum("...k,...k", mean_m, mean_m)
    spread = covariance_m2 / size[..., None, None]
    square = spread @ spread
    outer = 3.0 * (mean_m[..., :, None] * mean_m[..., None, :] / size[..., None, None])
    second = np.einsum("...kl,...kl", spread, spread + outer * (2.0 / 3.0))
    third = np.einsum("...kl,...kl", square, spread + outer)
    freedom = second**3 / third**2
    part = 2.0 / (9.0 * freedom)
    value = freedom * (1.0 - part - quantile * np.sqrt(part)) ** 3
    return np.asarray(np.sqrt(size * (1.0 + np.sqrt(second / freedom) * (value - freedom))))


@cache
def _quantiles(beacons: int) -> FloatArray:
    """Return the quantiles of the permitted risks: of each beacon's fault, and last of a sound epoch."""
    return ndtri(np.append(np.full(beacons, MISSED_DETECTION), SOUND_RISK))


def level_of(
    separation_m: FloatArray,
    separation_cov_m2: FloatArray,
    hidden: NDArray[np.bool_],
    position_cov_m2: FloatArray,
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Compute the protection levels of e positions.

    Parameters
    ----------
    separation_m, separation_cov_m2 : ndarray, shapes (e, n, 3) and (e, n, 3, 3)
        Positions less those without each of n beacons, and the covariances of that.
    hidden : ndarray of bool, shape (e, n)
        Whether some fault of the beacon cannot show in the residuals.
    position_cov_m2 : ndarray, shape (e, 3, 3)

    Returns
    -------
    level_m : ndarray, shape (e,)
        Infinite where a fault of some beacon cannot show.
    beacon : ndarray of int, shape (e,)
        The beacon whose fault could hide the most.
    """
    count, beacons = hidden.shape
    mean, covariance = np.zeros((count, beacons + 1, 3)), np.empty((count, beacons + 1, 3, 3))
    mean[:, :-1], covariance[:] = separation_m, position_cov_m2[:, None]
    covariance[:, :-1] += separation_cov_m2
    radius = _radius_m(mean, covariance, _quantiles(beacons))  # the last row is the noise of a sound epoch
    radius[:, :-1][hidden] = np.inf
    return radius.max(axis=1), radius[:, :-1].argmax(axis=1)


def protection_level(
    measurements: Measurements, statistics: FaultStatistics, position_cov_m2: FloatArray
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Compute the protection levels of fitted poses: see `level_of`.

    Parameters
    ----------
    measurements : Measurements
        e epochs.
    statistics : FaultStatistics
        Those of their poses.
    position_cov_m2 : ndarray, shape (e, 3, 3)
        Covariance of the positions.
    """
    hidden = statistics.freedom < measurements.measured.sum(axis=2)
    return level_of(statistics.separation_m, statistics.separation_cov_m2, hidden, position_cov_m2)

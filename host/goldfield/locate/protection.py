"""Protection level: the position error that the fault of one beacon can hide.

A fault of beacon i that adds lambda to the cost moves the position by at most slope_i sqrt(lambda). It goes unnoticed
with a probability below `MISSED_DETECTION` if sqrt(lambda) is the root of the alarm's limit and a normal quantile
more; the noise of the position comes on top:

    PL = max_i slope_i (sqrt(limit) + z) + sqrt(chi-square of the missed detection, 3) sqrt(largest variance).

It holds for one faulty beacon, as in aviation, and says nothing of two that fail together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from goldfield.locate.fault_statistics import FaultStatistics, limits_of
from goldfield.locate.fit import Measurements
from goldfield.types import FloatArray

MISSED_DETECTION = 1e-3
"""Rate of faults at the edge of the protection level that stay undetected; also that of noise beyond its part."""

_QUANTILE = float(np.sqrt(chdtri(1.0, 2.0 * MISSED_DETECTION)))
_NOISE = float(np.sqrt(chdtri(3.0, MISSED_DETECTION)))


def protection_level(
    measurements: Measurements, statistics: FaultStatistics, position_cov_m2: FloatArray
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Compute the radius that the position error exceeds undetected only rarely.

    Parameters
    ----------
    measurements : Measurements
        e epochs.
    statistics : FaultStatistics
        Those of their poses.
    position_cov_m2 : ndarray, shape (e, 3, 3)
        Covariance of the positions.

    Returns
    -------
    level_m : ndarray, shape (e,)
        Infinite where a fault of some beacon cannot show in the residuals.
    beacon : ndarray of int, shape (e,)
        The beacon whose fault could hide the most.
    """
    single = limits_of(measurements.known.shape[1]).single
    threshold = single[measurements.known.sum(axis=1)[:, None], np.maximum(statistics.freedom, 1)]
    hidden = statistics.slope * (np.sqrt(threshold) + _QUANTILE)
    noise = np.sqrt(np.linalg.eigvalsh(position_cov_m2)[:, -1]) * _NOISE
    return np.asarray(hidden.max(axis=1) + noise), hidden.argmax(axis=1)

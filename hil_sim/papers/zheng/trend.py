"""Slopes of repeated runs over time, and whether their mean differs from zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from goldfield.types import FloatArray

DAY_S = 86400.0


def slope_per_day(time_s: FloatArray, value: FloatArray) -> float:
    """Return the slope of a series beside a daily cycle, by least squares, in its unit a day.

    Parameters
    ----------
    time_s : ndarray, shape (t,)
        The times span more than a day: else the daily cycle and the slope are one.
    value : ndarray, shape (t,)
    """
    day = (time_s - time_s.mean()) / DAY_S
    columns = np.stack([np.ones_like(day), day, np.cos(2.0 * np.pi * day), np.sin(2.0 * np.pi * day)], axis=1)
    return float(np.linalg.lstsq(columns, value, rcond=None)[0][1])


@dataclass(frozen=True)
class Trend:
    """The mean slope of independent runs.

    The errors of one run resemble their predecessors for hours, so that the residuals of one straight line tell too
    small an uncertainty (Newey and West's remedy was tried: after 48 h it is still too small 1.8-fold). The spread
    over runs assumes nothing.

    Attributes
    ----------
    per_day : float
        Mean of the slopes over the runs.
    sigma_per_day : float
        Standard deviation of that mean.
    one_run_per_day : float
        Standard deviation of a single run's slope.
    limit_per_day : float
        Half the 95 % interval of the mean (Student's t).
    """

    per_day: float
    sigma_per_day: float
    one_run_per_day: float
    limit_per_day: float

    @property
    def consistent_with_zero(self) -> bool:
        """Whether zero lies within the 95 % interval."""
        return abs(self.per_day) <= self.limit_per_day


def trend(slopes: FloatArray) -> Trend:
    """Return the mean slope of at least two runs, shape (n,), and its uncertainty."""
    spread = float(np.std(slopes, ddof=1))
    sigma = spread / float(np.sqrt(len(slopes)))
    return Trend(float(np.mean(slopes)), sigma, spread, float(student.ppf(0.975, len(slopes) - 1)) * sigma)

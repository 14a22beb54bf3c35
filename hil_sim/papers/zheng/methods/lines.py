"""Straight lines ln B = k ln r + b between received strength and range (Zheng et al. 2022, eqn 15).

A dipole gives k = -3 and a b that moves with the direction by up to ln 1.58: the line is an approximation, the better
the smaller the region that it is fitted in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.types import FloatArray

NANOTESLA = 1e-9
"""Unit of B in the lines, as in the paper: b is ln of the nanotesla at 1 m."""


@dataclass(frozen=True, eq=False)
class Lines:
    """One line for each of n beacons, or for each of e epochs and n beacons.

    Attributes
    ----------
    slope, intercept : ndarray, shape (n,) or (e, n)
        Values of k and of b.
    """

    slope: FloatArray
    intercept: FloatArray

    def ranges(self, strength_T: FloatArray) -> FloatArray:
        """Return the ranges r = exp((ln B - b)/k) in metres, shape (e, n), from strengths of the same shape."""
        return np.asarray(np.exp((np.log(strength_T / NANOTESLA) - self.intercept) / self.slope))


def fit_lines(range_m: FloatArray, strength_T: FloatArray) -> Lines:
    """Return the least-squares line of each beacon.

    Parameters
    ----------
    range_m, strength_T : ndarray, shape (p, n)
        Range and strength of n beacons at p points. A beacon with less than two different ranges has a line that is
        not finite.
    """
    x, y = np.log(range_m), np.log(strength_T / NANOTESLA)
    dx, dy = x - x.mean(axis=0), y - y.mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (dx * dy).sum(axis=0) / (dx * dx).sum(axis=0)
    return Lines(slope, y.mean(axis=0) - slope * x.mean(axis=0))

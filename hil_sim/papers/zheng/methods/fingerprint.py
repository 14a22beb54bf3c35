"""Positions from received strengths and a map of fingerprints: the three algorithms of Zheng et al. 2022, 3.3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.types import FloatArray
from hil_sim.papers.zheng.methods.lines import NANOTESLA, Lines, fit_lines
from hil_sim.papers.zheng.methods.trilateration import trilaterate

NEIGHBOURS = 4
"""Number of nearest fingerprints, n of eqns 27 to 29."""
REGION_M = 2.0
"""Side of the square regions R that each have lines of their own (2.3 of the paper)."""
LEAST_IN_REGION = 4
"""Fewer fingerprints than this make no line: the region then uses the global one."""


@dataclass(frozen=True, eq=False)
class FingerprintMap:
    """Strengths measured at known points.

    Attributes
    ----------
    beacons : tuple of str
    position_m : ndarray, shape (p, 3)
    strength_T : ndarray, shape (p, n)
        Root mean square of |B| over a turn (`field.rotating.rms_strength`), one column a beacon.
    """

    beacons: tuple[str, ...]
    position_m: FloatArray
    strength_T: FloatArray

    def without(self, point: int) -> FingerprintMap:
        """Return the map without one point: for leave-one-out tests."""
        keep = np.arange(len(self.position_m)) != point
        return FingerprintMap(self.beacons, self.position_m[keep], self.strength_T[keep])

    def nearest(
        self, strength_T: FloatArray, count: int = NEIGHBOURS, *, logarithmic: bool = False
    ) -> tuple[NDArray[np.intp], FloatArray]:
        """Return the nearest fingerprints by the Euclidean distance of strengths (eqns 25 to 27).

        Parameters
        ----------
        strength_T : ndarray, shape (e, n)
        logarithmic : bool
            Take the distance of the strengths' logarithms. As printed the strongest beacon alone decides; the paper's
            Table 1 lists logarithms, and its error of 0.114 m is near that of the logarithms here.

        Returns
        -------
        point : ndarray of int, shape (e, c)
            The nearest first; c is the count, or all points if there are fewer.
        distance : ndarray, shape (e, c)
            Distance of the strengths in T, or of their logarithms without unit.
        """
        scale = np.log if logarithmic else np.asarray
        distance = np.linalg.norm(scale(strength_T)[:, None, :] - scale(self.strength_T), axis=2)
        point = np.argsort(distance, axis=1, kind="stable")[:, :count]
        return point, np.take_along_axis(distance, point, axis=1)


def nearest_neighbours(
    fingerprints: FingerprintMap, strength_T: FloatArray, *, logarithmic: bool = False
) -> FloatArray:
    """Return positions by algorithm 2, shape (e, 3): the mean of the nearest points.

    The weights are 1/distance of strengths (eqn 27). The result is never outside the convex hull of the
    fingerprints, and blind to what a strength means.
    """
    point, distance = fingerprints.nearest(strength_T, logarithmic=logarithmic)
    weight = 1.0 / np.maximum(distance, 1e-30)
    weight /= weight.sum(axis=1, keepdims=True)
    return np.asarray((weight[:, :, None] * fingerprints.position_m[point]).sum(axis=1))


class LineLocator:
    """Algorithms 1 and 3: ranges by lines, then trilateration.

    Parameters
    ----------
    beacon_m : ndarray, shape (n, 3)
        Places of the map's beacons.
    fingerprints : FingerprintMap
    up : ndarray, shape (3,), optional
        Side where the sensor is, as in `trilaterate`.
    """

    def __init__(self, beacon_m: FloatArray, fingerprints: FingerprintMap, up: FloatArray | None = None) -> None:
        self._beacon_m, self._map, self._up = beacon_m, fingerprints, up
        self._range_m = np.linalg.norm(fingerprints.position_m[:, None] - beacon_m, axis=2)
        self.lines = fit_lines(self._range_m, fingerprints.strength_T)
        """The line of each beacon over the whole map."""
        self._square = np.floor(fingerprints.position_m[:, :2] / REGION_M + 1e-9).astype(int)
        regions, self._region = np.unique(self._square, axis=0, return_inverse=True)
        fitted = [self._region_lines(region) for region in range(len(regions))]
        self._slopes = np.stack([lines.slope for lines in fitted])
        self._intercepts = np.stack([lines.intercept for lines in fitted])

    def by_global_lines(self, strength_T: FloatArray, z_m: FloatArray | None = None) -> FloatArray:
        """Return positions by algorithm 1, shape (e, 3), from strengths, shape (e, n): a line a beacon."""
        return trilaterate(self._beacon_m, self.lines.ranges(strength_T), self._up, z_m)

    def by_region_lines(self, strength_T: FloatArray, z_m: FloatArray | None = None) -> FloatArray:
        """Return the same with the lines of the square region that the nearest fingerprint lies in (paper, 2.3)."""
        region = self._region[self._map.nearest(strength_T, 1)[0][:, 0]]
        lines = Lines(self._slopes[region], self._intercepts[region])
        return trilaterate(self._beacon_m, lines.ranges(strength_T), self._up, z_m)

    def by_local_lines(
        self,
        strength_T: FloatArray,
        z_m: FloatArray | None = None,
        slope: FloatArray | None = None,
        *,
        logarithmic: bool = False,
    ) -> FloatArray:
        """Return positions by algorithm 3 as intended, shape (e, 3): the line through the nearest fingerprints.

        Each of the nearest fingerprints j gives a b of its own for each beacon, b_ij = ln F_ij - k_i ln |P_j - M_i|;
        the range is r_i = exp((ln B_i - mean_j b_ij)/k_i), and eqn 17 gives the position. Eqn 28 as printed leaves the
        fingerprint's own line out of the difference and yields 20 m where it must yield 0.

        Parameters
        ----------
        strength_T : ndarray, shape (e, n)
        z_m : ndarray, shape (e,), optional
            Known heights.
        slope : ndarray, shape (n,), optional
            Slopes k; by default those of the lines over the whole map.
        logarithmic : bool
            Kind of distance, as in `FingerprintMap.nearest`.
        """
        k = self.lines.slope if slope is None else slope
        point, _ = self._map.nearest(strength_T, logarithmic=logarithmic)
        log_strength = np.log(self._map.strength_T / NANOTESLA)
        intercept = (log_strength - k * np.log(self._range_m))[point].mean(axis=1)
        return trilaterate(self._beacon_m, Lines(k, intercept).ranges(strength_T), self._up, z_m)

    def _region_lines(self, region: int) -> Lines:
        members = self._region == region
        if members.sum() < LEAST_IN_REGION:
            return self.lines
        return fit_lines(self._range_m[members], self._map.strength_T[members])

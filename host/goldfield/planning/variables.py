"""The variables of a refinement: what is free of each beacon as one vector, with its bounds and the power's limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import Bounds, NonlinearConstraint

from goldfield.planning.optimise_file import Wishes
from goldfield.site import Beacon, Site
from goldfield.types import FloatArray

LEAST_CURRENT = 0.02
"""Least part of its current that a beacon keeps: the site file allows none without."""

LONGEST_AXIS = 2.0
"""Bound on the components of an axis before it is scaled to length 1."""


class Variables:
    """Turns beacons into a vector and back.

    A beacon has its place, m, in the region where it starts; its axis, of any length; and its current over that of the
    start: what of these is free.

    Parameters
    ----------
    site : Site
        The point where the vector starts.
    wishes : Wishes
    power_A2 : float
        Largest sum of the squares of the currents.

    Attributes
    ----------
    start : ndarray, shape (m,)
    bounds : scipy.optimize.Bounds
    constraints : list of scipy.optimize.NonlinearConstraint
    """

    def __init__(self, site: Site, wishes: Wishes, power_A2: float) -> None:
        self._beacons = site.beacons
        self._columns = [
            column
            for word, columns in (("position", (0, 1, 2)), ("axis", (3, 4, 5)), ("current", (6,)))
            if word in wishes.free
            for column in columns
        ]
        self._current = np.array([abs(beacon.current_A) for beacon in site.beacons])
        self._power_A2 = power_A2
        whole = np.array([[*beacon.position_m, *beacon.axis, 1.0] for beacon in site.beacons])
        low, high = np.empty_like(whole), np.empty_like(whole)
        for row, beacon in enumerate(site.beacons):
            region = next(region for region in wishes.regions if region.contains(beacon.position_m))
            low[row, :3], high[row, :3] = region.low_m, region.high_m
        low[:, 3:6], high[:, 3:6] = -LONGEST_AXIS, LONGEST_AXIS
        low[:, 6] = LEAST_CURRENT
        high[:, 6] = np.minimum(wishes.most_current_A, np.sqrt(power_A2)) / self._current
        self._whole = whole
        self._low, self._high = (side[:, self._columns].ravel() for side in (low, high))
        self.start = self.kept(whole[:, self._columns].ravel())
        self.bounds = Bounds(self._low, self._high)
        self.constraints = [NonlinearConstraint(self._power, -np.inf, 1.0, jac=self._power_slope)]
        if "current" not in wishes.free:
            self.constraints = []

    def beacons(self, x: FloatArray) -> list[Beacon]:
        """Return the beacons of a vector."""
        rows = self._rows(x)
        return [
            replace(
                beacon,
                position_m=row[:3],
                axis=row[3:6] / np.linalg.norm(row[3:6]),
                current_A=float(beacon.current_A * row[6]),
            )
            for beacon, row in zip(self._beacons, rows, strict=True)
        ]

    def gradient(self, x: FloatArray, gradient: FloatArray) -> FloatArray:
        """Return the derivatives by the vector, from those of `Objective.with_gradient`, shape (n, 7)."""
        rows = self._rows(x)
        scaled = gradient.copy()
        scaled[:, 3:6] /= np.linalg.norm(rows[:, 3:6], axis=1, keepdims=True)
        scaled[:, 6] /= rows[:, 6]
        return scaled[:, self._columns].ravel()

    def kept(self, x: FloatArray) -> FloatArray:
        """Return the vector with every constraint kept to the last digit."""
        x = np.clip(x, self._low, self._high)
        if 6 in self._columns:
            part = self._rows(x)[:, 6]
            over = np.sqrt(max(1.0, float(((part * self._current) ** 2).sum()) / self._power_A2))
            x.reshape(len(self._beacons), -1)[:, -1] = part / over
        return x

    def _rows(self, x: FloatArray) -> FloatArray:
        rows = self._whole.copy()
        rows[:, self._columns] = x.reshape(len(rows), -1)
        return rows

    def _power(self, x: FloatArray) -> FloatArray:
        return np.array([((self._rows(x)[:, 6] * self._current) ** 2).sum() / self._power_A2])

    def _power_slope(self, x: FloatArray) -> FloatArray:
        slope = np.zeros_like(self._whole)
        slope[:, 6] = 2.0 * self._rows(x)[:, 6] * self._current**2 / self._power_A2
        return slope[:, self._columns].reshape(1, -1)

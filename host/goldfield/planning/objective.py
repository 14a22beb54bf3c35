"""What an optimisation makes small: a smooth stand-in for the worst position bound, with its gradient.

The bound at a point is s = sqrt(tr P), P the place's block of the joint covariance K of M = sum_i M_i. The objective is
the power mean (mean s^q)^(1/q) over the points, which a large q brings near the worst. A beacon's parameters change its
own M_i alone, and ds = -d|C^-1/2 A V|^2 / (2 s) with V = K[:, place]: so the gradient needs K once, and every beacon's
columns at both sides of each of its parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate.site_errors import errors_of
from goldfield.planning.images import Neighbourhood
from goldfield.planning.information import ORIENTATIONS, gram, joint_covariance, turned_distortions
from goldfield.planning.tile import noise_of
from goldfield.site import Beacon, Site
from goldfield.types import FloatArray

EXPONENTS = (8.0, 40.0)
"""q of one refinement after another: the first reaches far, the second is near the worst."""

DIFFERENCE = 1e-4
"""Half a step of the differences, in m, rad-like units of an axis, and parts of the current."""


class Objective:
    """The objective of beacons like a site's at some points.

    Parameters
    ----------
    site : Site
        Sensor, noise and what is known of the beacons; all coils circular.
    point_m : ndarray, shape (e, 3)
    exponent : float
        q.
    """

    def __init__(self, site: Site, point_m: FloatArray, exponent: float = EXPONENTS[0]) -> None:
        self._exponent = exponent
        self._site, self._point = site, point_m
        self._sigma = noise_of(site)
        errors = errors_of(site.beacons, site.sensor)
        inexact = errors is not None and (errors.gain_sd > 0.0 or errors.sensor_axis_sd_rad > 0.0)
        self._distortion = turned_distortions(errors, ORIENTATIONS[0]) if errors is not None and inexact else None

    def columns(self, beacons: Sequence[Beacon], sigma_T: FloatArray) -> FloatArray:
        """Return the whitened columns of beacons, shape (e, n, 3, k)."""
        errors = errors_of(tuple(beacons), self._site.sensor)
        near = Neighbourhood(FieldModel(beacons), sigma_T, errors, self._distortion, None)
        return near.columns(self._point)[1]

    def bounds(self, information: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the position bounds, shape (e,), and the places' columns of K, (e, k, 3), from M, (e, k, k)."""
        joint = joint_covariance(information, self._distortion)
        variance = np.einsum("ekk->e", joint.covariance[:, :3, :3] + joint.free[:, :3, :3])
        return np.sqrt(variance), joint.covariance[:, :, :3]

    def of_information(self, information: FloatArray) -> FloatArray:
        """Return the objective of M, shape (..., e, k, k): shape (...)."""
        size = information.shape
        bound = self.bounds(information.reshape(-1, *size[-2:]))[0].reshape(size[:-2])
        return power_mean(bound, self._exponent)

    @np.errstate(all="ignore")  # inside a coil
    def with_gradient(self, beacons: Sequence[Beacon]) -> tuple[float, FloatArray]:
        """Return the objective and its derivatives by place, axis and part of the current, shape (n, 7)."""
        bound, place = self.bounds(gram(self.columns(beacons, self._sigma)))
        value = float(power_mean(bound, self._exponent))
        weight = (bound / value) ** (self._exponent - 2.0) / (value * len(bound))
        gradient = np.empty((len(beacons), 7))
        for parameter in range(7):
            sides = [self._told(beacons, parameter, side * DIFFERENCE, place, weight) for side in (1.0, -1.0)]
            gradient[:, parameter] = -0.5 * (sides[0] - sides[1]) / (2.0 * DIFFERENCE)
        return value, gradient

    def _told(
        self, beacons: Sequence[Beacon], parameter: int, step: float, place: FloatArray, weight: FloatArray
    ) -> FloatArray:
        """Return the weighted sums of |C^-1/2 A V|^2 over the points, shape (n,), with every beacon a step away."""
        column = self.columns([moved(one, parameter, step) for one in beacons], self._sigma)
        flat = column.reshape(len(column), -1, column.shape[-1]) @ place
        return np.asarray(np.einsum("e,enck->n", weight, flat.reshape(*column.shape[:3], 3) ** 2))


def power_mean(bound: FloatArray, exponent: float) -> FloatArray:
    """Return the power mean of bounds, shape (..., e), over the points: shape (...)."""
    largest = bound.max(axis=-1, keepdims=True)
    return np.asarray(largest[..., 0] * np.mean((bound / largest) ** exponent, axis=-1) ** (1.0 / exponent))


def moved(beacon: Beacon, parameter: int, step: float) -> Beacon:
    """Return a beacon with its place (0 to 2), axis (3 to 5) or current (6, as a part) changed."""
    unit = np.eye(3)[parameter % 3]
    if parameter < 3:
        return replace(beacon, position_m=beacon.position_m + step * unit)
    if parameter < 6:
        axis = beacon.axis + step * unit
        return replace(beacon, axis=axis / np.linalg.norm(axis))
    return replace(beacon, current_A=beacon.current_A * (1.0 + step))

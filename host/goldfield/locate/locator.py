"""From the fields of an epoch to a pose, with no prior: start, fit, check."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from goldfield.field import FieldModel
from goldfield.locate.fit import Fit, Measurements, fit_pose
from goldfield.locate.rotations import quaternion
from goldfield.locate.shell import best_apart, directions, profiled, shell
from goldfield.locate.starts import log_magnitudes, simple_magnitudes
from goldfield.locate.wahba import wahba
from goldfield.poses import Fields, Pose, Status
from goldfield.site import Site

ROBUST_MODEL_ERROR = 0.03
"""Model error of the first fit: wide enough to converge from the starts, narrow enough to end in the right valley."""

SUSPECT = 1e-5
"""A residual less likely than this makes the locator look further."""


class Locator:
    """Locates a sensor on a site; keeps what does not change between epochs.

    Parameters
    ----------
    site : Site
    """

    def __init__(self, site: Site) -> None:
        self.site = site
        self.model = FieldModel(site.beacons)
        self._row = {beacon.id: index for index, beacon in enumerate(site.beacons)}
        self._directions = directions(400)

    def locate(self, fields: Fields) -> Pose:
        """Locate one epoch; never raises for bad data: then the status says ``failed``."""
        rows = [self._row[name] for name in fields.beacons if name in self._row]
        field = np.full((1, len(self.model), 3), np.nan)
        sigma = np.full((1, len(self.model)), 1.0)
        given = [i for i, name in enumerate(fields.beacons) if name in self._row]
        field[0, rows] = fields.field_T[given]
        sigma[0, rows] = fields.sigma_T[given]
        measurements = Measurements(field, sigma)
        used = tuple(b.id for b, known in zip(self.site.beacons, measurements.known[0], strict=True) if known)
        axes = int(measurements.measured[0].any(axis=0).sum())
        unknowns = 5 if axes == 1 else 6
        if measurements.count[0] < unknowns or len(used) < 3:
            return _failed(fields, used)
        fit = self.fit(measurements)
        freedom = int(measurements.count[0]) - unknowns
        cost = float(fit.cost[0])
        if not np.isfinite(cost):
            return _failed(fields, used)
        covariance = np.linalg.pinv(fit.information[0], hermitian=True)
        status = Status.OK
        if freedom > 0 and chi2.sf(cost, freedom) < SUSPECT:
            status = Status.INCONSISTENT
        return Pose(
            epoch=fields.epoch,
            time_s=fields.time_s,
            position_m=fit.position_m[0],
            orientation_xyzw=quaternion(fit.rotation[0]),
            position_cov_m2=covariance[:3, :3],
            attitude_cov_rad2=covariance[3:, 3:],
            residual=float(np.sqrt(cost / freedom)) if freedom > 0 else 0.0,
            status=status,
            used=used,
        )

    def fit(self, measurements: Measurements) -> Fit:
        """Fit the poses of e epochs with no prior."""
        fit = self._from_magnitudes(measurements) if measurements.complete else None
        freedom = np.maximum(measurements.count - 6, 1)
        if fit is None:
            return _joined([self._from_shell(measurements.take(np.array([e]))) for e in range(len(measurements))])
        wrong = ~(chi2.sf(fit.cost, freedom) > SUSPECT)
        if self.site.half_space is not None:
            wrong |= (fit.position_m - self.site.half_space.point_m) @ self.site.half_space.normal < 0.0
        parts = [fit.take(np.array([e])) for e in range(len(measurements))] if wrong.any() else []
        for e in np.flatnonzero(wrong):
            other = self._from_shell(measurements.take(np.array([e])))
            outside = bool(
                self.site.half_space is not None and not self.site.half_space.contains(fit.position_m[e])
            )
            if outside or not fit.cost[e] <= other.cost[0]:
                parts[e] = other
        return _joined(parts) if parts else fit

    def _from_magnitudes(self, measurements: Measurements) -> Fit:
        """1.5k/r^3 -> log|B| -> Wahba -> fit with model error -> fit."""
        magnitude, sigma, known = measurements.magnitude_T, measurements.sigma_T, measurements.known
        position = simple_magnitudes(self.model, magnitude, sigma, known)
        position = log_magnitudes(self.model, magnitude, sigma, known, position)
        weight = measurements.inverse_sigma(ROBUST_MODEL_ERROR)[:, 0] ** 2
        rotation = wahba(self.model.field(position), measurements.filled_T, weight)
        return self._refined(measurements, position, rotation)

    def _from_shell(self, measurements: Measurements) -> Fit:
        """Search the shell of one epoch, fit its best candidates, keep the best."""
        field, sigma = measurements.field_T[0], measurements.sigma_T[0]
        position = shell(self.model, field, sigma, self._directions, self.site.half_space)
        loss, rotation = profiled(self.model, field, sigma, position)
        apart = 0.25 * np.linalg.norm(position[:, None] - self.model.centre_m, axis=2).min(axis=1)
        best = best_apart(position, loss, 8, apart)
        repeated = measurements.take(np.zeros(len(best), dtype=np.intp))
        fit = self._refined(repeated, position[best], rotation[best])
        cost = np.where(np.isfinite(fit.cost), fit.cost, np.inf)
        if self.site.half_space is not None:
            inside = (fit.position_m - self.site.half_space.point_m) @ self.site.half_space.normal >= 0.0
            cost = np.where(inside, cost, np.inf) if inside.any() else cost
        return fit.take(np.array([int(np.argmin(cost))]))

    def _refined(self, measurements: Measurements, position: NDArray[np.float64], rotation: NDArray[np.float64]) -> Fit:
        rough = fit_pose(self.model, measurements, position, rotation, model_error=ROBUST_MODEL_ERROR)
        return fit_pose(self.model, measurements, rough.position_m, rough.rotation)


@lru_cache(maxsize=8)
def _locator(site: Site) -> Locator:
    return Locator(site)


def locate(site: Site, fields: Fields) -> Pose:
    """Locate the sensor of one epoch on a site, with no prior.

    Parameters
    ----------
    site : Site
    fields : Fields

    Returns
    -------
    Pose
        Always: what could not be located has status ``failed`` and NaN as position.
    """
    return _locator(site).locate(fields)


def _joined(fits: list[Fit]) -> Fit:
    return Fit(
        np.concatenate([fit.position_m for fit in fits]),
        np.concatenate([fit.rotation for fit in fits]),
        np.concatenate([fit.cost for fit in fits]),
        np.concatenate([fit.information for fit in fits]),
        np.concatenate([fit.converged for fit in fits]),
    )


def _failed(fields: Fields, used: tuple[str, ...]) -> Pose:
    nowhere = np.full((3, 3), np.nan)
    return Pose(
        epoch=fields.epoch,
        time_s=fields.time_s,
        position_m=np.full(3, np.nan),
        orientation_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        position_cov_m2=nowhere,
        attitude_cov_rad2=nowhere.copy(),
        residual=float("nan"),
        status=Status.FAILED,
        used=used,
    )

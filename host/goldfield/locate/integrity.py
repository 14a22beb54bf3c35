"""Trust in a pose: tests of the residual, exclusion of beacons that are not as the site says, protection level.

As in receiver-autonomous integrity monitoring. If model and noise are right the cost is chi-square with as many degrees
of freedom as there are components beyond the unknowns. A fault of one beacon shows with more power in the part of the
cost that leaving it out would take away, r_i' S_ii^-1 r_i, chi-square with three degrees, where r_i are the beacon's
residuals and S = I - A P A' their covariance; and a fault of its strength (current, polarity, dead) in the part along
its field a_i, (a_i' r_i)^2/(a_i' S_ii a_i), with one. The three tests share the permitted rate of false alarms.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, gammaincc

from goldfield.locate import kernel
from goldfield.locate.constellation import Constellation, Solutions
from goldfield.locate.fit import Fit, Measurements, whitened_jacobian, whitened_residual
from goldfield.locate.uncertainty import UNOBSERVABLE, root_covariance
from goldfield.locate.whitening import Whitening
from goldfield.types import FloatArray

FALSE_ALARM = 7e-4
"""Permitted rate of epochs with nothing wrong that are taken for faulty."""

SHARES = (0.1, 0.6, 0.3)
"""Parts of it for the whole cost, for single beacons, and for their strengths: single faults are what happens."""

MISSED_DETECTION = 1e-3
"""Rate of faults at the edge of the protection level that stay undetected."""

BLAME = 1e-6
"""A beacon is left out only if a cost as large as it takes away is less likely than this. An alarm with less evidence
is most often noise, and then the pose with all beacons is the better one: it is kept and called inconsistent."""

LEAST_BEACONS = 4
"""Beacons that must remain: three leave too little to tell that the rest is sound."""

DETECTABLE = 1e-6
"""Part of a beacon's variance that must show in the residuals for a fault of it to be detectable at all."""


def alarm(constellation: Constellation, measurements: Measurements, fit: Fit) -> NDArray[np.bool_]:
    """Tell which of e fitted epochs do not agree with the site; shape (e,)."""
    drop, freedom, scale = fault_statistics(constellation, measurements, fit)
    of_whole, of_single, of_strength = _limits(measurements.known.shape[1])
    heard = measurements.known.sum(axis=1)
    wrong = fit.cost > of_whole[np.maximum(measurements.freedom, 0)]
    wrong |= (drop > of_single[heard[:, None], freedom]).any(axis=1)
    wrong |= scale.max(axis=1) > of_strength[heard]
    return np.asarray(wrong)


@cache
def _limits(beacons: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Chi-squares that sound epochs exceed at the permitted rates; infinite with no degree of freedom.

    The first is the limit of the whole cost by its freedom, the second that of one beacon by the number of beacons
    heard and its freedom, the third that of a beacon's strength by the number heard.
    """
    whole, single, strength = (share * FALSE_ALARM for share in SHARES)
    heard = np.maximum(np.arange(beacons + 1), 1)
    of_whole = np.append(np.inf, chdtri(np.arange(1.0, 3 * beacons + 1), whole))
    of_single = chdtri(np.array([1.0, 1.0, 2.0, 3.0]), single / heard[:, None])
    of_single[:, 0] = np.inf
    return np.asarray(of_whole), np.asarray(of_single), np.asarray(chdtri(1.0, strength / heard))


def fault_statistics(
    constellation: Constellation, measurements: Measurements, fit: Fit
) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
    """Statistics of each beacon's faults, linear around the fit.

    Returns
    -------
    drop : ndarray, shape (e, n)
        Part of the cost that leaving out the beacon would take away; 0 where no fault of it can show.
    freedom : ndarray of int, shape (e, n)
        Its degrees of freedom.
    scale : ndarray, shape (e, n)
        Part of the cost that another strength of the beacon takes away; one degree of freedom, 0 where it cannot show.
    """
    model = constellation.model
    quick = kernel.of(model)
    if quick is not None:
        return quick.faults(
            measurements.field_T,
            measurements.noise_T,
            fit.position_m,
            fit.rotation,
            errors=measurements.errors,
            least_eigenvalue=UNOBSERVABLE,
            least_share=DETECTABLE,
        )
    whitening = measurements.whitening(model, fit.position_m, fit.rotation)
    residual, modelled = whitened_residual(model, measurements, fit, whitening)
    gain, seen, vector = _redundancy(constellation, whitening, fit)
    along = np.einsum("enck,enc->enk", vector, whitening.by_beacon(residual[:, None])[..., 0])
    drop = np.where(seen, along**2 / np.where(seen, gain, 1.0), 0.0).sum(axis=2)
    strength = np.einsum("enck,enc->enk", vector, whitening.alone(modelled))
    shown = (strength**2 * gain).sum(axis=2)
    visible = shown > DETECTABLE * (strength**2).sum(axis=2)
    scale = np.where(visible, (strength * along).sum(axis=2) ** 2 / np.where(visible, shown, 1.0), 0.0)
    return drop, seen.sum(axis=2), scale


def exclude(
    constellation: Constellation, measurements: Measurements, cost: float
) -> tuple[Solutions, NDArray[np.intp]] | None:
    """Find the beacons of one inconsistent epoch without which it is consistent.

    Leaves out one beacon after another, each time the one without which the rest agrees best, until the tests pass.

    Parameters
    ----------
    cost : float
        Cost of the pose with all beacons.

    Returns
    -------
    solutions : Solutions
        Poses from the remaining beacons.
    excluded : ndarray of int
        Rows of the constellation.
    None if no set of at least `LEAST_BEACONS` beacons agrees, or if it has nothing left to be tested with.
    """
    rows = np.arange(len(constellation.model))
    while len(rows) > LEAST_BEACONS:
        best_row, best_cost = -1, np.inf
        for row, without in zip(rows, _costs_without_each(constellation, measurements, rows), strict=True):
            if without < best_cost:
                best_row, best_cost = int(row), without
        if best_row < 0 or len(rows) * gammaincc(1.5, max(cost - best_cost, 0.0) / 2.0) > BLAME:
            return None
        cost = best_cost
        rows = rows[rows != best_row]
        rest, rest_measurements = constellation.subset(rows), measurements.of_beacons(rows)
        if rest_measurements.freedom[0] < 3:
            return None
        solutions = rest.solve(rest_measurements)
        if np.isfinite(solutions.best.cost[0]) and not alarm(rest, rest_measurements, solutions.best)[0]:
            return solutions, np.setdiff1d(np.arange(len(constellation.model)), rows)
    return None


def protection_level(constellation: Constellation, measurements: Measurements, fit: Fit) -> FloatArray:
    """Radius, shape (e,), m, that the position error exceeds undetected with the probability `MISSED_DETECTION` only.

    The largest over the beacons of slope times the least fault that is sure to be detected, and the noise on top. The
    slope of a beacon is the position error over the root of the cost that its worst fault adds. Infinite if a fault
    of some beacon cannot show in the residuals.
    """
    whitening = measurements.whitening(constellation.model, fit.position_m, fit.rotation)
    jacobian = whitened_jacobian(constellation.model, fit.position_m, fit.rotation, whitening)
    root, _ = root_covariance(fit.information)
    gain, seen, vector = _redundancy(constellation, whitening, fit)
    influence = root[:, :3] @ (root.swapaxes(1, 2) @ jacobian)  # (e, 3, 3n): whitened component -> position
    influence = whitening.by_beacon(influence)  # (e, n, c, 3)
    shown = np.einsum("encp,enck->enpk", influence, vector) / np.sqrt(np.where(seen, gain, 1.0))[:, :, None, :]
    slope = np.linalg.svd(np.where(seen[:, :, None, :], shown, 0.0), compute_uv=False)[..., 0]
    measured = measurements.measured.sum(axis=2)
    slope = np.where(seen.sum(axis=2) < measured, np.inf, slope).max(axis=1)
    beacons = np.maximum(measurements.known.sum(axis=1), 1)
    threshold = np.sqrt(chdtri(3.0, SHARES[1] * FALSE_ALARM / beacons))
    sure = threshold + np.sqrt(chdtri(1.0, 2.0 * MISSED_DETECTION))
    largest = np.sqrt(np.linalg.eigvalsh(root[:, :3] @ root[:, :3].swapaxes(1, 2))[:, -1])
    return np.asarray(slope * sure + largest * np.sqrt(chdtri(3.0, MISSED_DETECTION)))


def _redundancy(
    constellation: Constellation, whitening: Whitening, fit: Fit
) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
    """Decompose the residuals' covariance of each beacon.

    Eigenvalues, shape (e, n, 3); which of them let a fault show; eigenvectors, shape (e, n, 3, 3).
    """
    jacobian = whitened_jacobian(constellation.model, fit.position_m, fit.rotation, whitening)
    root, _ = root_covariance(fit.information)
    tangent = whitening.by_beacon(root.swapaxes(1, 2) @ jacobian)  # (e, n, c, 6)
    gain, vector = np.linalg.eigh(whitening.gram - tangent @ tangent.swapaxes(2, 3))
    return gain, gain > DETECTABLE, vector


def _costs_without_each(
    constellation: Constellation, measurements: Measurements, rows: NDArray[np.intp]
) -> list[float]:
    """Cost of the best pose without each of these beacons in turn."""
    rest = constellation.subset(rows)
    count = len(rows)
    repeated = measurements.of_beacons(rows).take(np.zeros(count, dtype=np.intp))
    thinned = repeated.without(np.eye(count, dtype=bool))
    if thinned.complete:
        return [float(cost) for cost in rest.from_magnitudes(thinned).cost]
    costs = []
    for left_out in range(count):
        others = np.delete(rows, left_out)
        found = constellation.subset(others).from_shell(measurements.of_beacons(others))
        costs.append(float(found.cost[0]))
    return costs

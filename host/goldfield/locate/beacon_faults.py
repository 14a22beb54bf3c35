"""What is wrong with one beacon, told from its field at the pose that the others give.

The prediction h = R'B(p) has the covariance of the pose's error, J P J'; with it the simplest explanation that the
beacon's three components admit is named: no field, the reversed field, a multiple of it, or another place.
"""

from __future__ import annotations

import math

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate import kernel, sentences
from goldfield.locate.chances import gammaincc
from goldfield.locate.fit import Fit, Measurements, sensor_jacobian
from goldfield.locate.uncertainty import gauss_newton_covariance
from goldfield.types import Explanation, Finding, FloatArray

ADMITTED = 1e-3
"""An explanation of a beacon's field is admitted if its misfit is not less likely than this."""

WELL_DETERMINED = 0.2
"""A new place is told if its standard deviation is below this part of the way to it."""

STEPS = 50
"""The most steps of the search for the place."""


def beacon_finding(
    model: FieldModel, measurements: Measurements, fit: Fit, row: int, name: str
) -> tuple[Finding, float]:
    """Name what is wrong with a beacon that was left out of the pose of one epoch.

    Parameters
    ----------
    model : FieldModel
        All beacons.
    measurements : Measurements
        One epoch, all beacons.
    fit : Fit
        The pose from the others, with its information.
    row : int
        The beacon.
    name : str
        Its id.

    Returns
    -------
    finding : Finding
    residual : float
        The beacon's normalised residual at this pose.
    """
    heard = np.flatnonzero(measurements.measured[0, row])
    weight = 1.0 / measurements.sigma_T[0, row]
    jacobian, read = sensor_jacobian(model, fit.position_m, fit.rotation, measurements.levers)
    measured, modelled = weight * measurements.field_T[0, row, heard], weight * read[0, heard, row]
    pose_covariance = gauss_newton_covariance(fit.information)[0]
    slope = weight * jacobian[0, :, heard, row]
    spread = slope @ pose_covariance @ slope.T
    # Along the principal axes of the spread every sum is one of its parts. On the beacon's wire nothing is a number.
    variance, axes = np.linalg.eigh(spread if np.isfinite(spread).all() else np.zeros_like(spread))
    # Where the others hardly tell the pose, the rounding of a large variance takes a small one below 0.
    columns = (measured @ axes, modelled @ axes, np.maximum(variance, 0.0))
    parts = list(zip(*(column.tolist() for column in columns), strict=True))
    freedom = len(heard)

    def misfit(factor: float) -> float:
        errors = [(given - factor * told, variance) for given, told, variance in parts]
        return float(sum(error * error / (1.0 + factor * factor * variance) for error, variance in errors))

    def admitted(cost: float, degrees: int) -> bool:
        return degrees > 0 and float(gammaincc(degrees / 2.0, cost / 2.0)) > ADMITTED

    residual = math.sqrt(misfit(1.0) / freedom)
    if admitted(misfit(0.0), freedom):
        return Finding(Explanation.DEAD, (name,), sentences.dead(name), factor=0.0), residual
    if admitted(misfit(-1.0), freedom):
        return Finding(Explanation.REVERSED, (name,), sentences.turned_round(name), factor=-1.0), residual
    factor = _factor(parts)
    if admitted(misfit(factor), freedom - 1):
        return Finding(Explanation.CURRENT, (name,), sentences.current(name, factor), factor=factor), residual
    place = _place(model, measurements, fit, pose_covariance, row) if freedom == 3 else None
    if place is not None:
        distance = float(np.linalg.norm(place - model.centre_m[row]))
        return Finding(Explanation.MOVED, (name,), sentences.moved(name, place, distance), position_m=place), residual
    return Finding(Explanation.BEACON, (name,), sentences.other(name, residual)), residual


def _factor(parts: list[tuple[float, float, float]]) -> float:
    """Return the factor of the modelled components by generalised least squares; its square is in the covariance.

    The parts are measured and modelled components along the axes of the modelled ones' spread, and its variances.
    """
    factor = 1.0
    for _ in range(3):
        weighted = [(given, told, told / (1.0 + factor * factor * variance)) for given, told, variance in parts]
        along, square = (sum(part[k] * part[2] for part in weighted) for k in range(2))
        factor = along / max(square, 1e-300)
    return factor


def _place(
    model: FieldModel, measurements: Measurements, fit: Fit, pose_covariance: FloatArray, row: int
) -> FloatArray | None:
    """Place, shape (3,), from which the beacon makes the field that was measured; None if it is not well determined.

    Only the way from the beacon to the sensor counts, so that the beacon moved by d is the sensor moved by -d. The
    pose's error and the noise decide how well the place is known.
    """
    target = fit.rotation[0] @ measurements.filled_T[0, row]
    position = fit.position_m[0].copy()
    reach = float(np.linalg.norm(position - model.centre_m[row]))
    size = float(np.linalg.norm(target))
    for _ in range(STEPS):
        field, gradient = (part[..., row] for part in kernel.evaluate(model, position))
        if not np.isfinite(gradient).all():
            return None  # on the wire
        step = np.linalg.lstsq(gradient, target - field, rcond=1e-6)[0]
        length = float(np.linalg.norm(step))
        nearest = float(np.linalg.norm(position - model.centre_m[row]))
        position = position + step * min(1.0, 0.2 * nearest / max(length, 1e-300))
        if length < 1e-6 * nearest:
            break
    else:
        return None
    field, gradient = (part[..., row] for part in kernel.evaluate(model, position))
    if not np.linalg.norm(target - field) < 1e-6 * size:
        return None
    inverse = np.linalg.inv(gradient)
    # The place is p - x with B(x) = R b: p, the turn of b, and the noise of b.
    turn = np.array([[0, target[2], -target[1]], [-target[2], 0, target[0]], [target[1], -target[0], 0]])
    slope = np.hstack([np.eye(3), -inverse @ turn])
    covariance = slope @ pose_covariance @ slope.T + measurements.sigma_T[0, row] ** 2 * inverse @ inverse.T
    moved = fit.position_m[0] - position
    deviation = float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
    way = float(np.linalg.norm(moved))
    if not (deviation < WELL_DETERMINED * way and way < reach):
        return None
    return np.asarray(model.centre_m[row] + moved)

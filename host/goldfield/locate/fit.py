"""The full fit: position and attitude to the measured components, for many epochs at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.least_squares import Evaluate, State, minimise
from goldfield.locate.rotations import orthonormal, turned
from goldfield.types import FloatArray


@dataclass(frozen=True)
class Fit:
    """Poses of e epochs (or e candidates).

    Attributes
    ----------
    position_m : ndarray, shape (e, 3)
    rotation : ndarray, shape (e, 3, 3)
        ``B_site = R B_sensor``.
    cost : ndarray, shape (e,)
        Sum of squared residuals over their standard deviations.
    information : ndarray, shape (e, 6, 6)
        Gauss-Newton information of position (m) and of a small rotation in the site's frame (rad).
    converged : ndarray of bool, shape (e,)
    """

    position_m: FloatArray
    rotation: FloatArray
    cost: FloatArray
    information: FloatArray
    converged: NDArray[np.bool_]

    def take(self, rows: NDArray[np.intp]) -> Fit:
        """Return some of the poses."""
        return Fit(*(part[rows] for part in self._parts()))

    def put(self, rows: NDArray[np.intp], other: Fit) -> None:
        """Replace some of the poses, in place."""
        for mine, new in zip(self._parts(), other._parts(), strict=True):
            mine[rows] = new

    def _parts(self) -> tuple[NDArray[Any], ...]:
        return self.position_m, self.rotation, self.cost, self.information, self.converged


def stacked(fits: Sequence[Fit]) -> Fit:
    """Put poses one after another."""
    return Fit(*(np.concatenate(parts) for parts in zip(*(fit._parts() for fit in fits), strict=True)))


class Measurements:
    """Measured fields of e epochs with their standard deviations, ready for fitting.

    Parameters
    ----------
    field_T : ndarray, shape (e, n, 3)
        Fields in the sensor's frame, one row a beacon of the model; NaN where nothing was measured.
    sigma_T : ndarray, shape (e, n)
        Standard deviation of each component.
    """

    def __init__(self, field_T: FloatArray, sigma_T: FloatArray) -> None:
        self.field_T = field_T
        self.sigma_T = sigma_T

    def __len__(self) -> int:
        """Return the number of epochs."""
        return len(self.field_T)

    @cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Mask of the components that are known, shape (e, n, 3)."""
        return np.isfinite(self.field_T)

    @cached_property
    def known(self) -> NDArray[np.bool_]:
        """Mask of the beacons that are known by any component, shape (e, n)."""
        return np.asarray(self.measured.any(axis=2))

    @cached_property
    def complete(self) -> bool:
        """True if each beacon's field is known with all components or not at all."""
        return bool((self.measured == self.known[:, :, None]).all())

    @cached_property
    def filled_T(self) -> FloatArray:
        """The fields with 0 for what was not measured, shape (e, n, 3)."""
        return np.where(self.measured, self.field_T, 0.0)

    @cached_property
    def magnitude_T(self) -> FloatArray:
        """Magnitudes of the measured components, shape (e, n)."""
        return np.asarray(np.sqrt((self.filled_T**2).sum(axis=2)))

    @cached_property
    def count(self) -> NDArray[np.intp]:
        """Number of measured components, shape (e,)."""
        return np.asarray(self.measured.sum(axis=(1, 2)))

    @cached_property
    def axes(self) -> NDArray[np.intp]:
        """Number of axes that the sensor has or that worked, shape (e,)."""
        return np.asarray(self.measured.any(axis=1).sum(axis=1))

    @cached_property
    def unknowns(self) -> NDArray[np.intp]:
        """Number of unknowns, shape (e,): 6, or 5 for a sensor with one axis, whose turn about it is free."""
        return np.where(self.axes == 1, 5, 6)

    @cached_property
    def freedom(self) -> NDArray[np.intp]:
        """Degrees of freedom, components minus unknowns, shape (e,)."""
        return np.asarray(self.count - self.unknowns)

    def inverse_sigma(self, model_error: float = 0.0) -> FloatArray:
        """Return the square root of each component's weight, shape (e, 3, n); 0 if not measured.

        It is 1/sqrt(sigma^2 + (model_error |B|)^2) for each measured component.
        """
        sigma = np.sqrt(self.sigma_T**2 + (model_error * self.magnitude_T) ** 2)
        return np.where(self.measured, 1.0 / sigma[:, :, None], 0.0).swapaxes(1, 2)

    def take(self, rows: NDArray[np.intp]) -> Measurements:
        """Return some of the epochs, also repeated ones."""
        if len(rows) == len(self) and (rows == np.arange(len(self))).all():
            return self
        return Measurements(self.field_T[rows], self.sigma_T[rows])

    def of_beacons(self, rows: NDArray[np.intp]) -> Measurements:
        """Return the same epochs with only some of the beacons."""
        return Measurements(self.field_T[:, rows], self.sigma_T[:, rows])

    def without(self, beacons: NDArray[np.bool_]) -> Measurements:
        """Return the same epochs without some beacons, mask of shape (e, n)."""
        return Measurements(np.where(beacons[:, :, None], np.nan, self.field_T), self.sigma_T)


def fit_pose(
    model: FieldModel,
    measurements: Measurements,
    position_m: FloatArray,
    rotation: FloatArray,
    *,
    model_error: float = 0.0,
    iterations: int = 120,
    tolerance: float = 1e-6,
) -> Fit:
    """Fit position and attitude to the measured components by least squares, from a start near by.

    The kernel in C does it where it is built and knows the coils; the NumPy code computes the same.

    Parameters
    ----------
    model : FieldModel
        The n beacons.
    measurements : Measurements
        The e epochs.
    position_m : ndarray, shape (e, 3)
        Positions to start from, m.
    rotation : ndarray, shape (e, 3, 3)
        Attitudes to start from, ``B_site = R B_sensor``.
    model_error : float
        Relative error of the model: the variance of a component is sigma^2 + (model_error |B|)^2 with the measured
        |B|. A few per cent widen the basin of convergence (strong, curved beacons no longer dominate); the last fit
        takes what is believed of the site.
    iterations : int
        The most evaluations of the model in an epoch; see `least_squares.minimise`.
    tolerance : float
        An epoch ends when its next step promises to lower the cost by less; see `least_squares.minimise`.

    Returns
    -------
    Fit
        The poses where the iteration ended; ``converged`` tells which ended by the tolerance.
    """
    quick = kernel.of(model)
    if quick is not None:
        return Fit(
            *quick.fit(
                measurements.field_T,
                measurements.sigma_T,
                position_m,
                rotation,
                model_error=model_error,
                iterations=iterations,
                tolerance=tolerance,
            )
        )
    evaluate = _weighted_misfit(model, measurements, model_error)
    end = minimise(evaluate, _retract, (position_m, rotation), iterations=iterations, tolerance=tolerance)
    position, attitude = end.state
    return Fit(position, orthonormal(attitude), end.cost, end.normal, end.converged)


def _weighted_misfit(model: FieldModel, measurements: Measurements, model_error: float) -> Evaluate:
    """Return the residuals and Jacobian of a pose as `least_squares.minimise` asks for them.

    With h(p, R) = R' B(p), dh = R' (G dp + B x d_theta), where exp([d_theta]x) R is the turned attitude. Complete
    fields are compared in the site's frame, which leaves the Jacobian unturned: their three components have one
    standard deviation, so that the cost is the same. Others are compared in the sensor's frame.
    """
    weight = measurements.inverse_sigma(model_error)
    measured = measurements.filled_T.swapaxes(1, 2)
    complete = measurements.complete

    def evaluate(state: State, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        position, attitude = state
        whole = len(rows) == len(measured)
        w, b = (weight, measured) if whole else (weight[rows], measured[rows])
        jacobian, field = pose_jacobian(model, position)
        if complete:
            residual = attitude @ b - field
        else:
            back = attitude.swapaxes(1, 2)
            residual = b - back @ field
            jacobian = back[:, None] @ jacobian
        residual *= w
        jacobian *= w[:, None]
        return residual.reshape(len(rows), -1), jacobian.reshape(len(rows), 6, -1)

    return evaluate


def pose_jacobian(model: FieldModel, position_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Jacobian of the fields by position and turn, in the site's frame, unweighted.

    Parameters
    ----------
    position_m : ndarray, shape (e, 3)

    Returns
    -------
    jacobian : ndarray, shape (e, 6, 3, n)
        Derivative of component c of beacon i by unknown k: position (T/m), then rotation vector (T/rad).
    field_T : ndarray, shape (e, 3, n)
    """
    field, gradient = model.evaluate(position_m.T)
    jacobian = np.zeros((len(position_m), 6, 3, len(model)))
    jacobian[:, :3] = gradient.transpose(2, 1, 0, 3)
    x, y, z = field
    jacobian[:, 3, 1], jacobian[:, 3, 2] = z, -y
    jacobian[:, 4, 0], jacobian[:, 4, 2] = -z, x
    jacobian[:, 5, 0], jacobian[:, 5, 1] = y, -x
    return jacobian, field.swapaxes(0, 1)


def whitened_jacobian(
    model: FieldModel, position_m: FloatArray, rotation: FloatArray, weight: FloatArray
) -> FloatArray:
    """Return the Jacobian of the components in the sensor's frame over their standard deviations, shape (e, 6, 3n).

    ``weight``, shape (e, 3, n), is that of `Measurements.inverse_sigma`.
    """
    jacobian, _ = pose_jacobian(model, position_m)
    jacobian = rotation.swapaxes(1, 2)[:, None] @ jacobian
    jacobian *= weight[:, None]
    return jacobian.reshape(len(position_m), 6, -1)


def whitened_residual(model: FieldModel, measurements: Measurements, fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Return the residuals and the modelled components, over their standard deviations, both of shape (e, 3n)."""
    field, _ = model.evaluate(fit.position_m.T)
    weight = measurements.inverse_sigma()
    modelled = (fit.rotation.swapaxes(1, 2) @ field.swapaxes(0, 1)) * weight
    residual = measurements.filled_T.swapaxes(1, 2) * weight - modelled
    return residual.reshape(len(measurements), -1), modelled.reshape(len(measurements), -1)


def _retract(state: State, step: FloatArray) -> State:
    position, attitude = state
    return position + step[:, :3], turned(attitude, step[:, 3:])

"""The full fit: position and attitude to the measured components, for many epochs at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.budget import Budget
from goldfield.locate.least_squares import Evaluate, State, minimise
from goldfield.locate.rotations import orthonormal, turned
from goldfield.locate.sensor_axes import Levers
from goldfield.locate.site_errors import SiteErrors
from goldfield.locate.whitening import Correlated, Independent, Whitening, whitening_around
from goldfield.types import FloatArray

TOLERANCE = 1e-6
"""A fit ends when its next step promises to lower the cost by less, unless another limit is given."""

MOST_ROUNDS = 4
SETTLED = 1e-2
"""With errors of the site the components are whitened anew around what a fit has found, at most so often in all, and as
long as the pose has moved by more than so many standard deviations, squared."""

UNBOUNDED = 2**62
"""Evaluations that epochs without a budget may take: more than can be done."""


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
        return Fit(
            self.position_m[rows], self.rotation[rows], self.cost[rows], self.information[rows], self.converged[rows]
        )

    def put(self, rows: NDArray[np.intp], other: Fit) -> None:
        """Replace some of the poses, in place."""
        for mine, new in zip(self.parts(), other.parts(), strict=True):
            mine[rows] = new

    def parts(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
        """Return the attributes, in their order."""
        return self.position_m, self.rotation, self.cost, self.information, self.converged


def stacked(fits: Sequence[Fit]) -> Fit:
    """Put poses one after another."""
    return Fit(*(np.concatenate(parts) for parts in zip(*(fit.parts() for fit in fits), strict=True)))


class Measurements:
    """Measured fields of e epochs with their standard deviations, ready for fitting.

    Parameters
    ----------
    field_T : ndarray, shape (e, n, 3)
        Fields in the sensor's frame, one row a beacon of the model; NaN where nothing was measured.
    sigma_T : ndarray, shape (e, n)
        Standard deviation of each component: of the noise, and with errors of the site isotropic for these too
        (`with_errors`), which is what a search needs that knows no pose.
    noise_T : ndarray, shape (e, n), optional
        Standard deviation of the noise alone; default: ``sigma_T``.
    errors : SiteErrors, optional
        Errors of the site and the sensor, which a final fit, its statistics and its covariance take into account.
    budget : Budget, optional
        What fits of these measurements, and of all that are taken from them, may cost; default: no bound but their own.
    """

    def __init__(
        self,
        field_T: FloatArray,
        sigma_T: FloatArray,
        noise_T: FloatArray | None = None,
        errors: SiteErrors | None = None,
        budget: Budget | None = None,
    ) -> None:
        self.field_T = field_T
        self.sigma_T = sigma_T
        self.noise_T = sigma_T if noise_T is None else noise_T
        self.errors = errors
        self.budget = budget

    def with_errors(self, model: FieldModel, errors: SiteErrors | None) -> Measurements:
        """Return the same with errors of the site of ``model`` and of the sensor; unchanged for none."""
        if errors is None:
            return self
        sigma = np.hypot(self.noise_T, errors.isotropic(model, self.magnitude_T))
        return Measurements(self.field_T, sigma, self.noise_T, errors, self.budget)

    def of_fields(self, field_T: FloatArray, factor: FloatArray | float = 1.0) -> Measurements:
        """Return the same with other fields and ``factor`` times the standard deviations, broadcast to shape (e, n)."""
        return Measurements(field_T, self.sigma_T * factor, self.noise_T * factor, self.errors, self.budget)

    def within(self, budget: Budget) -> Measurements:
        """Return the same with a budget."""
        return Measurements(self.field_T, self.sigma_T, self.noise_T, self.errors, budget)

    def affordable_in_all(self, coils: int) -> int:
        """Return how many evaluations of so many coils all epochs together may take."""
        return UNBOUNDED if self.budget is None else self.budget.evaluations(coils)

    def affordable(self, coils: int, most: int) -> int:
        """Return how many evaluations of so many coils each epoch may take, at most as many as are asked for."""
        if self.budget is None:
            return most
        return min(most, self.budget.evaluations(coils) // max(len(self), 1))

    def spend(self, evaluations: int, coils: int) -> None:
        """Take what was done off the budget, if there is one."""
        if self.budget is not None:
            self.budget.spend(evaluations, coils)

    @property
    def levers(self) -> Levers | None:
        """Where the axes of the sensor read; None: all at one point."""
        return None if self.errors is None else self.errors.levers

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

    def whitening(self, model: FieldModel, position_m: FloatArray, rotation: FloatArray) -> Whitening:
        """Return the whitening of the components around poses, shapes (e, 3) and (e, 3, 3)."""
        if self.errors is None:
            return Independent(self.inverse_sigma())
        return self._correlated(model, self.errors, position_m, rotation)

    def _correlated(
        self, model: FieldModel, errors: SiteErrors, position_m: FloatArray, rotation: FloatArray
    ) -> Correlated:
        noise = np.where(self.measured, self.noise_T[:, :, None], np.inf)
        return whitening_around(model, errors, noise, position_m, rotation)

    def take(self, rows: NDArray[np.intp]) -> Measurements:
        """Return some of the epochs, also repeated ones."""
        if len(rows) == len(self) and (rows == np.arange(len(self))).all():
            return self
        return Measurements(self.field_T[rows], self.sigma_T[rows], self.noise_T[rows], self.errors, self.budget)

    def of_beacons(self, rows: NDArray[np.intp]) -> Measurements:
        """Return the same epochs with only some of the beacons."""
        errors = None if self.errors is None else self.errors.subset(rows)
        return Measurements(self.field_T[:, rows], self.sigma_T[:, rows], self.noise_T[:, rows], errors, self.budget)

    def without(self, beacons: NDArray[np.bool_]) -> Measurements:
        """Return the same epochs without some beacons, mask of shape (e, n)."""
        field = np.where(beacons[:, :, None], np.nan, self.field_T)
        return Measurements(field, self.sigma_T, self.noise_T, self.errors, self.budget)


def fit_pose(
    model: FieldModel,
    measurements: Measurements,
    position_m: FloatArray,
    rotation: FloatArray,
    *,
    model_error: float = 0.0,
    iterations: int = 120,
    tolerance: float = TOLERANCE,
) -> Fit:
    """Fit position and attitude to the measured components by least squares, from a start near by.

    The kernel in C does it where it is built and knows the coils; the NumPy code computes the same.

    Parameters
    ----------
    model : FieldModel
        The n beacons.
    measurements : Measurements
        The e epochs.
    position_m, rotation : ndarray, shapes (e, 3) and (e, 3, 3)
        Positions, m, and attitudes, ``B_site = R B_sensor``, to start from.
    model_error : float
        Relative error of the model: the variance of a component is sigma^2 + (model_error |B|)^2 with the measured
        |B|. A few per cent widen the basin of convergence (strong, curved beacons no longer dominate). The last fit
        takes 0: then the errors of the site that the measurements carry count in full.
    iterations : int
        The most evaluations of the model in an epoch, as far as the budget goes; see `least_squares.minimise`.
    tolerance : float
        An epoch ends when its next step promises to lower the cost by less; see `least_squares.minimise`.

    Returns
    -------
    Fit
        The poses where the iteration ended; ``converged`` tells which ended by the tolerance.
    """
    quick = kernel.of(model)
    errors = measurements.errors if model_error == 0.0 else None
    iterations = measurements.affordable(len(model), iterations)
    if quick is not None and (errors is None or errors.levers is None):
        position, turn, cost, information, converged, evaluations = quick.fit(
            measurements.field_T,
            measurements.sigma_T if errors is None else measurements.noise_T,
            position_m,
            rotation,
            errors=errors,
            model_error=model_error,
            iterations=iterations,
            tolerance=tolerance,
        )
        measurements.spend(evaluations, len(model))
        return Fit(position, turn, cost, information, converged)
    if errors is not None:
        return _fit_with_errors(model, measurements, errors, (position_m, rotation), iterations, tolerance)
    evaluate = _weighted_misfit(model, measurements, model_error)
    end = minimise(evaluate, _retract, (position_m, rotation), iterations=iterations, tolerance=tolerance)
    measurements.spend(end.evaluations, len(model))
    position, attitude = end.state
    return Fit(position, orthonormal(attitude), end.cost, end.normal, end.converged)


def _fit_with_errors(
    model: FieldModel, measurements: Measurements, errors: SiteErrors, start: State, iterations: int, tolerance: float
) -> Fit:
    """Fit with the covariance of the site's errors around the start, then around what is found, until that stays."""
    count = len(measurements)
    position, rotation = start[0].copy(), start[1].copy()
    fits = Fit(position, rotation, np.empty(count), np.empty((count, 6, 6)), np.zeros(count, dtype=bool))
    active = np.arange(count)
    for _ in range(MOST_ROUNDS):
        before = fits.position_m[active], fits.rotation[active]
        some = measurements.take(active)
        evaluate = _whitened_misfit(model, some, some._correlated(model, errors, *before))
        end = minimise(evaluate, _retract, before, iterations=iterations, tolerance=tolerance)
        measurements.spend(end.evaluations + len(active), len(model))
        fits.put(active, Fit(end.state[0], end.state[1], end.cost, end.normal, end.converged))
        across = before[1] @ end.state[1].swapaxes(1, 2)
        turn = 0.5 * np.stack([across[:, k - 2, k - 1] - across[:, k - 1, k - 2] for k in range(3)], axis=1)
        shift = np.concatenate([end.state[0] - before[0], turn], axis=1)
        active = active[np.einsum("ek,ekl,el->e", shift, end.normal, shift) > SETTLED]
        if not len(active):
            break
    return Fit(fits.position_m, orthonormal(fits.rotation), fits.cost, fits.information, fits.converged)


def _whitened_misfit(model: FieldModel, measurements: Measurements, whitening: Correlated) -> Evaluate:
    """Return residuals and Jacobian as `_weighted_misfit` does, in the sensor's frame and whitened for all errors."""
    measured = measurements.filled_T.swapaxes(1, 2)

    def evaluate(state: State, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        position, attitude = state
        jacobian, field = sensor_jacobian(model, position, attitude, measurements.levers)
        some = whitening.take(rows)
        residual = measured[rows] - field
        return some(residual[:, None])[:, 0], some(jacobian)

    return evaluate


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
    field, gradient = kernel.evaluate(model, position_m.T)
    jacobian = np.zeros((len(position_m), 6, 3, len(model)))
    jacobian[:, :3] = gradient.transpose(2, 1, 0, 3)
    x, y, z = field
    jacobian[:, 3, 1], jacobian[:, 3, 2] = z, -y
    jacobian[:, 4, 0], jacobian[:, 4, 2] = -z, x
    jacobian[:, 5, 0], jacobian[:, 5, 1] = y, -x
    return jacobian, field.swapaxes(0, 1)


def sensor_jacobian(
    model: FieldModel, position_m: FloatArray, rotation: FloatArray, levers: Levers | None
) -> tuple[FloatArray, FloatArray]:
    """Return Jacobian and fields as `pose_jacobian` does, in the sensor's frame, read where its axes are.

    At the place p + R l the field also changes as a turn moves the place: by G (d_theta x R l).
    """
    back = rotation.swapaxes(1, 2)
    if levers is None:
        jacobian, field = pose_jacobian(model, position_m)
        return back[:, None] @ jacobian, back @ field
    total, read = np.zeros((len(position_m), 6, 3, len(model))), np.zeros((len(position_m), 3, len(model)))
    for lever, part in zip(levers.lever_m, levers.part, strict=True):
        arm = rotation @ lever
        jacobian, field = pose_jacobian(model, position_m + arm)
        shift = np.cross(np.eye(3)[:, None], arm)  # by a turn about each axis: shape (3, e, 3)
        jacobian[:, 3:] += np.einsum("kel,elcn->ekcn", shift, jacobian[:, :3])
        total += (part @ back)[:, None] @ jacobian
        read += part @ back @ field
    return total, read


def whitened_jacobian(
    model: FieldModel,
    position_m: FloatArray,
    rotation: FloatArray,
    whitening: Whitening,
    levers: Levers | None = None,
) -> FloatArray:
    """Return the whitened Jacobian of the components in the sensor's frame, shape (e, 6, 3n)."""
    return whitening(sensor_jacobian(model, position_m, rotation, levers)[0])


def whitened_residual(
    model: FieldModel, measurements: Measurements, fit: Fit, whitening: Whitening
) -> tuple[FloatArray, FloatArray]:
    """Return the whitened residuals, shape (e, 3n), and the modelled components, shape (e, 3, n), T."""
    if measurements.levers is None:
        field, _ = kernel.evaluate(model, fit.position_m.T)
        modelled = fit.rotation.swapaxes(1, 2) @ field.swapaxes(0, 1)
    else:
        _, modelled = sensor_jacobian(model, fit.position_m, fit.rotation, measurements.levers)
    measured = measurements.filled_T.swapaxes(1, 2)
    residual = whitening(measured[:, None]) - whitening(modelled[:, None])
    return residual[:, 0], modelled


def _retract(state: State, step: FloatArray) -> State:
    position, attitude = state
    return position + step[:, :3], turned(attitude, step[:, 3:])

"""The fit of a pose and of a sensor that distorts what it measures, b = S R'B(p) with a symmetric S.

S = fixed + sum of f_k basis_k. The factors f are found by linear equations at each pose, so that they need no start and
the fit has the six unknowns of a pose alone (variable projection, with the Jacobian of Kaufman).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.fit import Measurements, pose_jacobian
from goldfield.locate.least_squares import State, minimise
from goldfield.locate.rotations import turned
from goldfield.types import FloatArray

RIDGE = 1e-12
"""Relative addition to the diagonal of the linear equations: distortions that look alike share what the fields tell."""

TOLERANCE = 1e-3
"""A fit ends when its next step promises to lower the cost by less."""


@dataclass(frozen=True)
class Distorted:
    """Poses, from s starts, of a sensor that distorts.

    Attributes
    ----------
    position_m : ndarray, shape (s, 3)
    rotation : ndarray, shape (s, 3, 3)
    cost : ndarray, shape (s,)
        Sum of squared residuals over their standard deviations; infinite where a start was hopeless.
    distortion : ndarray, shape (s, 3, 3)
        S.
    """

    position_m: FloatArray
    rotation: FloatArray
    cost: FloatArray
    distortion: FloatArray

    def best(self, count: int = 1, among: int | None = None) -> Distorted:
        """Return those with the lowest costs, the best first, of all or among the first few."""
        some = np.argsort(self.cost[:among])[:count]
        return Distorted(self.position_m[some], self.rotation[some], self.cost[some], self.distortion[some])


def fit_distorted(
    model: FieldModel,
    measurements: Measurements,
    position_m: FloatArray,
    rotation: FloatArray,
    *,
    basis: FloatArray,
    fixed: FloatArray | None = None,
    model_error: float = 0.0,
    iterations: int = 60,
) -> Distorted:
    """Fit one epoch from each of s starts; the kernel in C does it where it is built and knows the coils.

    Parameters
    ----------
    model : FieldModel
    measurements : Measurements
        One epoch; each beacon's field is known whole or not at all.
    position_m, rotation : ndarray, shapes (s, 3) and (s, 3, 3)
    basis : ndarray, shape (k, 3, 3)
        Symmetric matrices along which S moves, at most six.
    fixed : ndarray, shape (3, 3), optional
        Default: zeros.
    model_error : float
        As `fit.fit_pose` has it.
    iterations : int
        The most evaluations of the model from a start.
    """
    repeated = measurements.take(np.zeros(len(position_m), dtype=np.intp))
    fixed = np.zeros((3, 3)) if fixed is None else fixed
    quick = kernel.of(model)
    iterations = repeated.affordable(len(model), iterations)
    if quick is not None:
        position, attitude, cost, distortion, evaluations = quick.fit_distorted(
            repeated.field_T,
            repeated.sigma_T,
            position_m,
            rotation,
            fixed=fixed,
            basis=basis,
            model_error=model_error,
            iterations=iterations,
            tolerance=TOLERANCE,
        )
    else:
        problem = _Problem(model, repeated, fixed, basis, model_error)
        end = minimise(problem, _retract, (position_m, rotation), iterations=iterations, tolerance=TOLERANCE)
        (position, attitude), cost, evaluations = end.state, end.cost, end.evaluations
        distortion = problem.solve(end.state, np.arange(len(position)))[0]
    measurements.spend(evaluations, len(model))
    return Distorted(position, attitude, np.where(np.isfinite(cost), cost, np.inf), distortion)


class _Problem:
    """What `least_squares.minimise` asks for, with the distortion eliminated."""

    def __init__(
        self, model: FieldModel, measurements: Measurements, fixed: FloatArray, basis: FloatArray, model_error: float
    ) -> None:
        self._model, self._fixed, self._basis = model, fixed, basis
        self._weight = measurements.inverse_sigma(model_error)
        self._measured = measurements.filled_T.swapaxes(1, 2)

    def solve(
        self, state: State, rows: NDArray[np.intp]
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return S, shape (e, 3, 3), residuals, columns of the distortions, their squares, and the pose's slopes."""
        position, rotation = state
        count = len(rows)
        w = self._weight[rows]
        slope, field = pose_jacobian(self._model, position)
        back = rotation.swapaxes(1, 2)
        seen = back @ field
        column = ((self._basis @ seen[:, None]) * w[:, None]).reshape(count, len(self._basis), -1)
        target = ((self._measured[rows] - self._fixed @ seen) * w).reshape(count, -1)
        square = column @ column.swapaxes(1, 2)
        diagonal = np.arange(len(self._basis))
        square[:, diagonal, diagonal] *= 1.0 + RIDGE
        factor = np.linalg.solve(square, column @ target[:, :, None])
        distortion = self._fixed + np.einsum("ek,kij->eij", factor[..., 0], self._basis)
        residual = target - (factor.swapaxes(1, 2) @ column)[:, 0]
        jacobian = (((distortion @ back)[:, None] @ slope) * w[:, None]).reshape(count, 6, -1)
        return distortion, residual, column, square, jacobian

    def __call__(self, state: State, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        _, residual, column, square, jacobian = self.solve(state, rows)
        taken = np.linalg.solve(square, column @ jacobian.swapaxes(1, 2))
        return residual, jacobian - taken.swapaxes(1, 2) @ column


def _retract(state: State, step: FloatArray) -> State:
    position, rotation = state
    return position + step[:, :3], turned(rotation, step[:, 3:])

"""Positions from field magnitudes, which need no attitude: the sources' first step and an improvement of their second.

Each takes the magnitudes that were measured, shape (e, n), and returns positions, shape (e, 3); see maths.md, 3 of
the sources' restatement: |B| = k sqrt(1 + 3 cos^2 theta)/r^3 (patent, eqns 6 and 7), and |B| ~ 1.5 k/r^3 (eqn 8).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.field.constants import MU0_OVER_4PI
from goldfield.locate.least_squares import State, minimise
from goldfield.types import FloatArray

SIMPLE_RANGE_ERROR = 0.12
"""Relative error of a range from 1.5 k/r^3: sqrt(1 + 3 cos^2) lies between 1 and 2, the range within -10 and +14 %."""

MAGNITUDE_ERROR = 0.1
"""Model error of the logarithms of magnitudes: keeps one strong beacon from hiding the others."""


def simple_ranges(model: FieldModel, magnitude_T: FloatArray) -> FloatArray:
    """Return the range of each beacon, shape (e, n), by |B| = 1.5 k/r^3 (patent, eqn 8)."""
    k = MU0_OVER_4PI * np.linalg.norm(model.moment_A_m2, axis=1)
    return np.asarray(np.cbrt(1.5 * k / np.maximum(magnitude_T, 1e-30)))


def simple_magnitudes(
    model: FieldModel,
    magnitude_T: FloatArray,
    sigma_T: FloatArray,
    known: NDArray[np.bool_],
    *,
    start_m: FloatArray | None = None,
    weighted: bool = True,
) -> FloatArray:
    """Trilaterate with the ranges of `simple_ranges` (patent, eqn 8).

    Parameters
    ----------
    model : FieldModel
        n beacons.
    magnitude_T, sigma_T : ndarray, shape (e, n)
    known : ndarray of bool, shape (e, n)
        Tells which magnitudes were measured.
    start_m : ndarray, shape (e, 3), optional
        Default: the mean of the beacons' places, near beacons counting more, moved off their plane.
    weighted : bool
        False counts all ranges alike, as the patent does.

    Returns
    -------
    position_m : ndarray, shape (e, 3)
    """
    range_m = simple_ranges(model, magnitude_T)
    relative = np.hypot(SIMPLE_RANGE_ERROR, sigma_T / (3.0 * np.maximum(magnitude_T, 1e-30)))
    weight = np.where(known, 1.0 / (range_m * relative) if weighted else 1.0, 0.0)
    if start_m is None:
        start_m = _middle(model, range_m, known)

    def evaluate(state: State, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        offset = state[0][:, :, None] - model.centre_m.T
        distance = np.sqrt((offset * offset).sum(axis=1))
        w = weight[rows]
        return (range_m[rows] - distance) * w, offset * (w / np.maximum(distance, 1e-9))[:, None, :]

    return minimise(evaluate, _move, (start_m,), iterations=25, tolerance=1e-2).state[0]


def log_magnitudes(
    model: FieldModel, magnitude_T: FloatArray, sigma_T: FloatArray, known: NDArray[np.bool_], start_m: FloatArray
) -> FloatArray:
    """Fit the logarithms of the magnitudes from a start, shape (e, 3).

    The logarithm is nearly linear in position where the magnitude is not, so that the fit converges from much further
    away than one of the magnitudes (patent, eqns 6 and 7). The weights are those of the noise and `MAGNITUDE_ERROR`.
    """
    magnitude = np.maximum(magnitude_T, 1e-30)
    weight = np.where(known, 1.0 / np.hypot(MAGNITUDE_ERROR, sigma_T / magnitude), 0.0)
    logarithm = np.log(magnitude)

    def evaluate(state: State, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        modelled, slope = _magnitude(model, state[0])
        w = weight[rows]
        return (logarithm[rows] - np.log(modelled)) * w, slope * (w / modelled)[:, None]

    return minimise(evaluate, _move, (start_m,), iterations=25, tolerance=1e-2).state[0]


def _magnitude(model: FieldModel, position_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the magnitude, shape (e, n), and its gradient, shape (e, 3, n)."""
    field, gradient = model.evaluate(position_m.T)
    magnitude = np.sqrt((field * field).sum(axis=0))
    slope = (field[:, None] * gradient).sum(axis=0) / magnitude
    return magnitude, slope.swapaxes(0, 1)


def _middle(model: FieldModel, range_m: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    weight = np.where(known, range_m**-2, 0.0)
    middle = weight @ model.centre_m / weight.sum(axis=1, keepdims=True)
    # In the plane of coplanar beacons the trilateration has no slope across it: start off the plane by the least range.
    nearest = np.where(known, range_m, np.inf).min(axis=1)
    return np.asarray(middle + 0.3 * nearest[:, None] * model.across)


def _move(state: State, step: FloatArray) -> State:
    return (state[0] + step,)

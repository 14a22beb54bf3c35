"""Nonlinear least squares by Levenberg and Marquardt, over many independent problems at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.types import FloatArray

State = tuple[FloatArray, ...]
"""Arrays with one problem a row."""

Evaluate = Callable[[State, NDArray[np.intp]], tuple[FloatArray, FloatArray]]
"""(state, indices of its problems) -> whitened residual (e, m) and transposed Jacobian of the model (e, k, m)."""

Retract = Callable[[State, FloatArray], State]
"""(state, step (e, k)) -> new state."""


@dataclass(frozen=True)
class Minimum:
    """Where the iteration ended, for each of e problems with k unknowns.

    Attributes
    ----------
    state : State
    cost : ndarray, shape (e,)
        Sum of squared whitened residuals; not finite if the start was hopeless.
    normal : ndarray, shape (e, k, k)
        Normal matrix at the end: the inverse of the Gauss-Newton covariance.
    converged : ndarray of bool, shape (e,)
    evaluations : int
        How often all problems together were evaluated.
    """

    state: State
    cost: FloatArray
    normal: FloatArray
    converged: NDArray[np.bool_]
    evaluations: int


@np.errstate(all="ignore")  # a trial far off may overflow: a cost that is not finite is not accepted
def minimise(
    evaluate: Evaluate, retract: Retract, start: State, *, iterations: int = 120, tolerance: float = 1e-6
) -> Minimum:
    """Minimise the sums of squares of e problems, each with its own damping.

    A problem ends when its next step promises to lower its cost by less than ``tolerance`` (in units of the noise's
    variance: 1e-6 is a thousandth of a standard deviation) or after ``iterations`` evaluations. Ended problems are
    not evaluated again.
    """
    count = len(start[0])
    state = tuple(part.copy() for part in start)
    everyone = np.arange(count)
    residual, jacobian = evaluate(state, everyone)
    cost = np.einsum("em,em->e", residual, residual)
    normal = jacobian @ jacobian.swapaxes(1, 2)
    gradient = (jacobian @ residual[:, :, None])[:, :, 0]
    damping = np.full(count, 1e-3)
    done = ~np.isfinite(cost)
    converged = np.zeros(count, dtype=bool)
    diagonal = np.arange(normal.shape[1])
    active = everyone[~done]
    evaluations = count
    for _ in range(iterations):
        if not len(active):
            break
        damped = normal[active]
        scale = damped[:, diagonal, diagonal]
        floor = 1e-12 * scale.max(axis=1, keepdims=True) + 1e-300
        damped[:, diagonal, diagonal] += damping[active, None] * scale + floor
        step = np.linalg.solve(damped, gradient[active, :, None])[:, :, 0]
        promise = np.einsum("ek,ek->e", gradient[active], step)
        near = promise < tolerance
        trial = retract(tuple(part[active] for part in state), step)
        residual, jacobian = evaluate(trial, active)
        evaluations += len(active)
        trial_cost = np.einsum("em,em->e", residual, residual)
        better = trial_cost <= cost[active]
        chosen = active[better]
        for part, new in zip(state, trial, strict=True):
            part[chosen] = new[better]
        cost[chosen] = trial_cost[better]
        jacobian, residual = jacobian[better], residual[better]
        normal[chosen] = jacobian @ jacobian.swapaxes(1, 2)
        gradient[chosen] = (jacobian @ residual[:, :, None])[:, :, 0]
        damping[chosen] = np.maximum(0.1 * damping[chosen], 1e-9)
        damping[active[~better]] *= 8.0
        converged[active[near]] = True
        stuck = damping[active] > 1e12
        active = active[~(near | stuck)]
    return Minimum(state=state, cost=cost, normal=normal, converged=converged, evaluations=evaluations)

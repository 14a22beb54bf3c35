"""The iterated update: prior and one cycle's observation to the most probable state.

With the prior's covariance S S' and the state x0 moved by S u, the cost is |u|^2 + |r|^2: the prior's 15 numbers and
the observation's, all of unit variance. Gauss-Newton on u, damped when a step would raise the cost: the iterated Kalman
filter (Bell & Cathey 1993) in square-root form. At the end the cost of a consistent epoch is chi-square distributed
with as many degrees of freedom as there are numbers observed: it is the normalised innovation squared, taken where the
linearisation holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from goldfield.locate.chances import chdtri
from goldfield.track.motion import SIZE, TURN, Agility, Observation, State, turn_jacobian
from goldfield.types import FloatArray

TOLERANCE = 0.1
"""The step that promises to lower the cost by less, three tenths of a standard deviation, is taken as the last: a
quadratic method is then a hundredth away. A finer one changes no figure of a track by a thousandth."""

SEARCH_TOLERANCE = 0.01
"""The same for fits from far away, which creep along curved valleys."""

FIRST_DAMPING = 1e-3
"""First damping of Levenberg and Marquardt, relative to the diagonal, once a step would raise the cost."""

VAGUE = np.repeat([1.0, 1.0, 10.0, 10.0, 2e-4], 3)
"""Standard deviations around the start, far above what a cycle leaves open: they add nothing to it."""


@dataclass(frozen=True, eq=False)
class Fixed:
    """The state's error in two parts: by noise and motion, and by errors of the site and the sensor that stay.

    Attributes
    ----------
    noise : ndarray, shape (15, m)
        Root of the first part's covariance.
    sensitivity : ndarray, shape (15, k)
        By how much each of the k errors, in standard deviations, moves the state (`goldfield.track.deviations`).
    """

    noise: FloatArray
    sensitivity: FloatArray

    @property
    def spread(self) -> FloatArray:
        """Covariance of the second part, shape (15, 15)."""
        return np.asarray(self.sensitivity @ self.sensitivity.T)


@dataclass(frozen=True, eq=False)
class Belief:
    """A state with its uncertainty.

    Attributes
    ----------
    state : State
    root : ndarray, shape (15, m)
        Root of the covariance with which the filter weights: if the site is exact, of the state's error.
    fixed : Fixed or None
        What the errors of the site do to the state, apart from noise; None if the site is exact.
    """

    state: State
    root: FloatArray
    fixed: Fixed | None = None

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the state's error, shape (15, 15)."""
        if self.fixed is None:
            return np.asarray(self.root @ self.root.T)
        return np.asarray(self.fixed.noise @ self.fixed.noise.T + self.fixed.spread)

    def after(self, seconds: float, agility: Agility, transition: FloatArray | None = None) -> Belief:
        """Return what is believed some time later (or earlier); ``transition`` is the state's, if it is at hand."""
        transition = self.state.transition(seconds) if transition is None else transition
        added = agility.noise_root(seconds)
        fixed = self.fixed
        if fixed is not None:
            fixed = Fixed(compact(np.hstack([transition @ fixed.noise, added])), transition @ fixed.sensitivity)
        return Belief(self.state.after(seconds), compact(np.hstack([transition @ self.root, added])), fixed)

    def widened(self, covariance: FloatArray, factor: float) -> Belief:
        """Return the belief with the deviations of the pose multiplied and a covariance, shape (6, 6), added to it."""
        scale = np.ones((SIZE, 1))
        scale[:6] = factor
        added = np.zeros((SIZE, 6))
        eigenvalue, vector = np.linalg.eigh(covariance)
        added[:6] = vector * np.sqrt(np.maximum(eigenvalue, 0.0))
        fixed = self.fixed
        if fixed is not None:
            fixed = Fixed(compact(np.hstack([scale * fixed.noise, added])), fixed.sensitivity)
        return Belief(self.state, compact(np.hstack([scale * self.root, added])), fixed)


@dataclass(frozen=True, eq=False)
class Estimate:
    """Outcome of an update.

    Attributes
    ----------
    belief : Belief
    cost : float
    count : int
        Numbers observed: the degrees of freedom of the cost.
    evaluations : int
        Number of evaluations of the field model.
    """

    belief: Belief
    cost: float
    count: int
    evaluations: int

    def probable(self, level: float) -> bool:
        """Tell whether a cost this high has at least this probability."""
        return self.cost <= _chi_square(level, self.count)


def estimate(prior: Belief, observation: Observation, evaluations: int, tolerance: float = TOLERANCE) -> Estimate:
    """Update a prior with an observation; the number of evaluations of the field model is bounded.

    Errors of the site and the sensor count as noise around the prior's state.
    """
    observation = observation.around(prior.state)
    u, offset, state = np.zeros(prior.root.shape[1]), np.zeros(SIZE), prior.state
    residual, jacobian = observation.residual(state)
    cost = float(residual @ residual)
    if not np.isfinite(cost):
        return Estimate(prior, np.inf, observation.count, 1)
    used, damping, moved = 1, 0.0, True
    while True:
        if moved:
            jacobian[:, TURN] = jacobian[:, TURN] @ turn_jacobian(offset[TURN])
            whitened = jacobian @ prior.root
            normal = whitened.T @ whitened
            normal.flat[:: len(u) + 1] += 1.0
            gradient = whitened.T @ residual - u
        damped = normal + damping * np.diag(np.diag(normal)) if damping else normal
        step = np.linalg.solve(damped, gradient)
        promise = float(gradient @ step)
        if promise < tolerance:
            offset = offset + prior.root @ step
            state, cost = prior.state.moved(offset), cost - promise
            break
        if used >= evaluations:
            break
        trial = u + step
        offset_there = prior.root @ trial
        state_there = prior.state.moved(offset_there)
        with np.errstate(all="ignore"):  # a step into a wire: a cost that is not finite is not lower
            there = observation.residual(state_there)
        used += 1
        cost_there = float(trial @ trial + there[0] @ there[0])
        moved = cost_there <= cost
        if moved:
            u, offset, state, (residual, jacobian), cost = trial, offset_there, state_there, there, cost_there
            damping = 0.1 * damping if damping > FIRST_DAMPING else 0.0
        else:
            damping = max(10.0 * damping, FIRST_DAMPING)
    root = np.linalg.solve(np.linalg.cholesky(normal), prior.root.T).T
    fixed = None
    if observation.mixing is not None and observation.effect is not None:
        fixed = _fixed(prior, observation.mixing, observation.effect, jacobian, root)
    for part in (root,) if fixed is None else (root, fixed.noise, fixed.sensitivity):
        part[TURN] = turn_jacobian(offset[TURN]) @ part[TURN]
    return Estimate(Belief(state, root, fixed), cost, observation.count, used)


def _fixed(prior: Belief, mixing: FloatArray, effect: FloatArray, jacobian: FloatArray, root: FloatArray) -> Fixed:
    """Return both parts of the error after an update that led to a root, jacobian being that of whitened numbers."""
    gain = root @ (root.T @ jacobian.T)
    before = Fixed(prior.root, np.zeros((SIZE, effect.shape[1]))) if prior.fixed is None else prior.fixed
    noise = np.hstack([before.noise - gain @ (jacobian @ before.noise), gain @ mixing])
    return Fixed(compact(noise), before.sensitivity - gain @ (jacobian @ before.sensitivity + effect))


def second_order(belief: Belief, observation: Observation) -> Belief:
    """Return a belief of which an observation made all, widened by the second-order terms of the model.

    Of a single observation the errors of the site are noise like any other: the belief that is returned has no others.

    As `goldfield.locate.uncertainty.second_order_covariance`, for all 15 unknowns; 31 evaluations of the field model.
    """
    root = compact(belief.root)
    observation = observation.around(belief.state)
    _, jacobian = observation.residual(belief.state)
    back = jacobian @ root
    bends = np.empty((SIZE, SIZE, SIZE))
    for axis in range(SIZE):
        _, ahead = observation.residual(belief.state.moved(root[:, axis]))
        _, behind = observation.residual(belief.state.moved(-root[:, axis]))
        bends[axis] = 0.5 * ((ahead - behind) @ root).T @ back
    bends = 0.5 * (bends + bends.swapaxes(0, 1))
    mean = np.einsum("iik->k", bends)
    flat = bends.reshape(-1, SIZE)
    second = 0.25 * (np.outer(mean, mean) + 2.0 * flat.T @ flat)
    return Belief(belief.state, root @ np.linalg.cholesky(np.eye(SIZE) + second))


def compact(root: FloatArray) -> FloatArray:
    """Return a root of the same covariance with 15 columns."""
    return np.asarray(np.linalg.qr(root.T, mode="r")).T


@lru_cache(maxsize=256)
def _chi_square(level: float, freedom: int) -> float:
    return float(chdtri(freedom, level)) if freedom else 0.0

"""The block filter of docs/blocks.md once more, dense and in double precision, as the truth for the one in C.

Nothing is in closed form here: fields by elliptic integrals, all derivatives numerical, the rows of a block whitened by
the Cholesky factor of its gram matrix and reduced by QR, the update by the textbook's gain. Units: uT, m, rad, s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, cholesky, solve_triangular
from scipy.spatial.transform import Rotation
from scipy.special import ellipe, ellipk

from goldfield.types import FloatArray

CHIP_S = 0.1 / 1023
AGILITIES = ((0.01, 0.02), (0.05, 0.08), (0.25, 0.3), (0.5, 1.0), (2.0, 4.0), (8.0, 15.0))


@dataclass(frozen=True)
class Coils:
    """Circular coils: centres and axes, shape (n, 3), k = mu0 / (4 pi) times the moments, uT m^3, and radii, m."""

    centre: FloatArray
    axis: FloatArray
    k: FloatArray
    radius: FloatArray

    def field(self, point: FloatArray) -> FloatArray:
        """Return the fields at a point, shape (n, 3), by the textbook form with elliptic integrals."""
        offset = point - self.centre
        height = (offset * self.axis).sum(axis=1)
        radial = offset - height[:, None] * self.axis
        rho = np.linalg.norm(radial, axis=1)
        far, near = (rho + self.radius) ** 2 + height**2, (rho - self.radius) ** 2 + height**2
        m = 1.0 - near / far
        k, e = ellipk(m), ellipe(m)
        scale = 2.0 * self.k / (np.pi * self.radius**2 * np.sqrt(far))
        along = scale * (k + (self.radius**2 - rho**2 - height**2) / near * e)
        across = scale * height / rho * (-k + (self.radius**2 + rho**2 + height**2) / near * e)
        return along[:, None] * self.axis + (across / rho)[:, None] * radial


@dataclass(frozen=True)
class State:
    """A state of docs/blocks.md, six vectors; the attitude as a matrix."""

    p: FloatArray
    rotation: FloatArray
    v: FloatArray
    w: FloatArray
    e: FloatArray
    b: FloatArray

    def moved(self, error: FloatArray) -> State:
        """Return the state with an error of 18 numbers."""
        p, theta, v, w, e, b = np.reshape(error, (6, 3))
        turn = Rotation.from_rotvec(theta).as_matrix()
        return State(self.p + p, turn @ self.rotation, self.v + v, self.w + w, self.e + e, self.b + b)

    def minus(self, other: State) -> FloatArray:
        """Return the error of 18 numbers that leads from another state to this."""
        theta = Rotation.from_matrix(self.rotation @ other.rotation.T).as_rotvec()
        rest = (self.v - other.v, self.w - other.w, self.e - other.e, self.b - other.b)
        return np.concatenate([self.p - other.p, theta, *rest])

    def ahead(self, seconds: float) -> State:
        """Return the state later."""
        turn = Rotation.from_rotvec(seconds * self.w).as_matrix()
        return replace(self, p=self.p + seconds * self.v, rotation=turn @ self.rotation)


def products(columns: FloatArray, chip_s: float = CHIP_S) -> tuple[FloatArray, FloatArray]:
    """Return gram and moment matrix of columns, shape (m, n + 1)."""
    tau = chip_s * (np.arange(len(columns)) - 0.5 * (len(columns) - 1))
    return columns.T @ columns, columns.T @ (tau[:, None] * columns)


def still_part(coils: Coils, state: State) -> FloatArray:
    """Return h, the fields in the sensor's frame with the ambient one last, shape (n + 1, 3)."""
    ambient = state.rotation.T @ state.e + state.b
    return np.vstack([coils.field(state.p) @ state.rotation, ambient])


def moving_part(coils: Coils, state: State) -> FloatArray:
    """Return h', how they change: the derivative of h over time, shape (n + 1, 3)."""
    step = 1e-4
    return (still_part(coils, state.ahead(step)) - still_part(coils, state.ahead(-step))) / (2.0 * step)


def sums(coils: Coils, state: State, gram: FloatArray, moment: FloatArray) -> FloatArray:
    """Return the sums of a block as the model has them, shape (n + 1, 3)."""
    return gram @ still_part(coils, state) + moment @ moving_part(coils, state)


def slope(function, state: State, errors: range) -> FloatArray:
    """Return the derivatives of a function by some of a state's errors, as columns."""
    columns = []
    for k in errors:
        step = np.zeros(18)
        step[k] = 1e-5
        columns.append((function(state.moved(step)) - function(state.moved(-step))).ravel() / 2e-5)
    return np.stack(columns, axis=1)


UNEVEN = 5.0
"""Standard deviation of how fast the ambient field changes within a block by itself, uT/s."""


def measured(
    coils: Coils, reference: State, gram: FloatArray, moment: FloatArray, data: FloatArray, noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return the twelve whitened numbers of a block at the reference, and their rows, shape (12, 18).

    The first nine are those of the fields, the last three what is left of the ambient field's sweep.
    """
    whiten = np.kron(np.linalg.inv(cholesky(gram, lower=True)), np.eye(3)) / noise
    left = whiten @ (data - sums(coils, reference, gram, moment)).ravel()
    rows = whiten @ np.kron(gram, np.eye(3)) @ slope(lambda s: still_part(coils, s), reference, range(18))
    late = whiten @ np.kron(moment, np.eye(3))
    ramp = whiten @ np.kron(moment[:, -1:], np.eye(3))
    q, _ = np.linalg.qr(np.hstack([rows[:, [*range(6), *range(12, 15)]], ramp]))
    rows[:, 6:12] += late @ slope(lambda s: moving_part(coils, s), reference, range(6, 12))
    sweep = rows.copy()
    turning = slope(lambda s: moving_part(coils, s)[-1], reference, range(18))
    sweep[:, 3:6] += ramp @ turning[:, 3:6]
    sweep[:, 12:15] += ramp @ turning[:, 12:15]
    even = 1.0 / np.sqrt(1.0 + UNEVEN**2 * (ramp**2).sum() / 3.0)
    fields, last = q[:, :9].T, even * q[:, 9:].T
    return np.concatenate([fields @ left, last @ left]), np.vstack([fields @ rows, last @ sweep])


def updated(
    state: State, covariance: FloatArray, reference: State, y: FloatArray, rows: FloatArray
) -> tuple[State, FloatArray, float, float]:
    """Return state and covariance after a block, its chi-square, and the logarithm of the determinant."""
    innovation = np.eye(len(y)) + rows @ covariance @ rows.T
    y = y - rows @ state.minus(reference)
    gain = np.linalg.solve(innovation, rows @ covariance).T
    after = covariance - gain @ rows @ covariance
    chi_square = float(y @ np.linalg.solve(innovation, y))
    return state.moved(gain @ y), 0.5 * (after + after.T), chi_square, float(np.linalg.slogdet(innovation)[1])


def predicted(
    state: State, covariance: FloatArray, agility: tuple[float, float], seconds: float
) -> tuple[State, FloatArray]:
    """Return state and covariance later; the transition by numerical derivatives."""
    later = state.ahead(seconds)
    columns = []
    for k in range(18):
        step = np.zeros(18)
        step[k] = 1e-5
        columns.append(
            (state.moved(step).ahead(seconds).minus(later) - state.moved(-step).ahead(seconds).minus(later)) / 2e-5
        )
    f = np.stack(columns, axis=1)
    t = abs(seconds)
    walk = np.zeros((18, 18))
    for place, size in ((0, agility[0]), (3, agility[1])):
        for axis in range(place, place + 3):
            both = np.ix_([axis, axis + 6], [axis, axis + 6])
            walk[both] = size**2 * np.array([[t**3 / 3, seconds * t / 2], [seconds * t / 2, t]])
    walk += block_diag(np.zeros((12, 12)), 25.0 * t * np.eye(3), 0.02**2 * t * np.eye(3))
    return later, f @ covariance @ f.T + walk


def whitened_step(step: FloatArray, covariance: FloatArray) -> float:
    """Return the length of a step in standard deviations of a covariance."""
    return float(np.linalg.norm(solve_triangular(cholesky(covariance, lower=True), step, lower=True)))


@dataclass(frozen=True)
class Model:
    """One filter of a bank, and the number of its agility."""

    state: State
    covariance: FloatArray
    probability: float
    agility: int


def combined(models: list[Model], weights: FloatArray, best: State) -> tuple[State, FloatArray]:
    """Return the mean of some filters with weights, and its covariance."""
    errors = np.stack([model.state.minus(best) for model in models])
    mean = weights @ errors
    covariance = np.zeros((18, 18))
    for model, weight, error in zip(models, weights, errors, strict=True):
        covariance += weight * (model.covariance + np.outer(error - mean, error - mean))
    return best.moved(mean), covariance


def likeliest(models: list[Model]) -> Model:
    """Return the filter with the greatest probability, the first of equals."""
    return max(models, key=lambda model: model.probability)


def followed(models: list[Model]) -> list[Model]:
    """Return the filters with agilities that have the likeliest one amid them; the greatest is always one of them."""
    slow, _, quick, quickest = sorted(models, key=lambda model: model.agility)
    gone, come = slow.agility, slow.agility
    if quick.probability + quickest.probability > 0.4 and quick.agility < len(AGILITIES) - 2:
        come = quick.agility + 1
    elif slow.probability > 0.5 and slow.agility > 0:
        gone, come = quick.agility, slow.agility - 1
    return [replace(model, agility=come) if model.agility == gone else model for model in models]


def mixed(models: list[Model], seconds: float) -> list[Model]:
    """Return the filters after mixing, those with agilities next to the likeliest one."""
    models = followed(models)
    change = (1.0 - np.exp(-seconds / 0.5)) / 3.0
    best, result = likeliest(models).state, []
    for j in range(4):
        shares = np.array([m.probability * (1.0 - 3.0 * change if j == k else change) for k, m in enumerate(models)])
        result.append(Model(*combined(models, shares / shares.sum(), best), float(shares.sum()), models[j].agility))
    return result


def weighed(models: list[Model], likelihoods: FloatArray) -> list[Model]:
    """Return the filters with the probabilities after a block."""
    weights = np.array([m.probability for m in models]) * np.exp(likelihoods - likelihoods.max())
    weights = np.maximum(weights / weights.sum(), 1e-9)
    return [replace(model, probability=float(weight)) for model, weight in zip(models, weights, strict=True)]

"""The state of a moving sensor, how it goes on, and what a cycle sees of it.

An error of the state is a vector of 15: position (m), a small rotation in the site's frame (rad), velocity (m/s),
angular velocity (rad/s, site's frame), ambient field (T, site's frame). The true state is `State.moved` by it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.rotations import matrix_of, orthonormal, skew, vector_of
from goldfield.track.deviations import Deviations
from goldfield.types import FloatArray

SIZE = 15
IDENTITY: FloatArray = np.eye(3)
UNIT_CROSSES: FloatArray = skew(IDENTITY)
"""[v]x of the unit vectors: [v]x is the sum of these, each times its component of v."""

POSITION, TURN, VELOCITY, RATE, AMBIENT = (slice(first, first + 3) for first in range(0, SIZE, 3))


@dataclass(frozen=True, eq=False)
class State:
    """A sensor at one moment.

    Attributes
    ----------
    position_m : ndarray, shape (3,)
    rotation : ndarray, shape (3, 3)
        ``B_site = R B_sensor``.
    velocity_m_s, rate_rad_s : ndarray, shape (3,)
        Velocity and turn rate in the site's frame.
    ambient_T : ndarray, shape (3,)
        Whatever follows no code (the earth's field), in the site's frame.
    """

    position_m: FloatArray
    rotation: FloatArray
    velocity_m_s: FloatArray
    rate_rad_s: FloatArray
    ambient_T: FloatArray

    def moved(self, error: FloatArray) -> State:
        """Return the state that differs by an error, shape (15,)."""
        return State(
            self.position_m + error[POSITION],
            turn_matrix(error[TURN]) @ self.rotation,
            self.velocity_m_s + error[VELOCITY],
            self.rate_rad_s + error[RATE],
            self.ambient_T + error[AMBIENT],
        )

    def minus(self, other: State) -> FloatArray:
        """Return the error, shape (15,), by which this state differs from another."""
        turn = vector_of(self.rotation @ other.rotation.T)
        return np.concatenate(
            [
                self.position_m - other.position_m,
                turn,
                self.velocity_m_s - other.velocity_m_s,
                self.rate_rad_s - other.rate_rad_s,
                self.ambient_T - other.ambient_T,
            ]
        )

    def after(self, seconds: float) -> State:
        """Return the state some time later (or earlier) at constant velocity and angular velocity."""
        return State(
            self.position_m + seconds * self.velocity_m_s,
            orthonormal(turn_matrix(seconds * self.rate_rad_s) @ self.rotation),
            self.velocity_m_s,
            self.rate_rad_s,
            self.ambient_T,
        )

    def transition(self, seconds: float) -> FloatArray:
        """Return how a small error goes on, shape (15, 15)."""
        turn, by_rate = _turns(self.rate_rad_s, np.array([seconds]))
        result = np.eye(SIZE)
        result[POSITION, VELOCITY] = seconds * IDENTITY
        result[TURN, TURN] = turn[0]
        result[TURN, RATE] = by_rate[0]
        return result


@dataclass(frozen=True)
class Agility:
    """How the sensor may move: white accelerations, as root of their power densities.

    Attributes
    ----------
    acceleration : float
        m/s^2 per root hertz: the velocity changes by this much in one second (standard deviation, each axis).
    angular_acceleration : float
        rad/s^2 per root hertz.
    ambient : float
        T per root second, each axis: the ambient field differs from place to place.
    """

    acceleration: float = 0.5
    angular_acceleration: float = 1.0
    ambient: float = 5e-6

    def noise_root(self, seconds: float) -> FloatArray:
        """Return a root of the covariance that comes in with time, shape (15, 15).

        Integrated white noise, per axis sigma^2 [[dt^3/3, dt^2/2], [dt^2/2, dt]] of (position, velocity): with s the
        root of sigma^2 dt the root is s [[dt/sqrt(12), dt/2], [0, 1]].
        """
        steady, growing = self._noise_roots
        return np.asarray(math.sqrt(abs(seconds)) * (steady + seconds * growing))

    @cached_property
    def _noise_roots(self) -> tuple[FloatArray, FloatArray]:
        """The two parts of `noise_root` over the root of the time, of which the second goes with the time, too."""
        steady, growing = np.zeros((2, SIZE, SIZE))
        for place, speed, sigma in ((POSITION, VELOCITY, self.acceleration), (TURN, RATE, self.angular_acceleration)):
            steady[speed, speed] = sigma * IDENTITY
            growing[place, place] = sigma / math.sqrt(12.0) * IDENTITY
            growing[place, speed] = 0.5 * sigma * IDENTITY
        steady[AMBIENT, AMBIENT] = self.ambient * IDENTITY
        return steady, growing


@dataclass(frozen=True, eq=False)
class Observation:
    """What one cycle tells, as uncorrelated numbers of unit variance for each axis of the sensor.

    Attributes
    ----------
    model : FieldModel
        n beacons.
    times_s : ndarray, shape (k,)
        Nodes of the cycle, from its middle, which is one of them: their number is odd.
    seen : ndarray, shape (3, r, (n + 1) k)
        What the numbers of each axis see of the fields at the nodes; the node runs fastest, the ambient field comes
        last. Rows of zeros where nothing was measured.
    values : ndarray, shape (3, r)
    count : int
        Numbers that were measured.
    deviations : Deviations or None
        Errors of the site and the sensor; None if they are exact.
    mixing : ndarray, shape (3 r, 3 r), or None
        Matrix by which residuals and Jacobian are multiplied, so that they are uncorrelated with these errors too;
        `around` sets it.
    effect : ndarray, shape (3 r, k), or None
        What each of the errors adds to the numbers, multiplied so; see `Deviations.effect`.
    """

    model: FieldModel
    times_s: FloatArray
    seen: FloatArray
    values: FloatArray
    count: int
    deviations: Deviations | None = None
    mixing: FloatArray | None = None
    effect: FloatArray | None = None

    def around(self, state: State) -> Observation:
        """Return the observation whitened for the errors of the site and the sensor as they act near a state.

        One that is whitened already is returned as it is.
        """
        if self.deviations is None or self.mixing is not None:
            return self
        position = state.position_m + self.times_s[:, None] * state.velocity_m_s
        rotation = _turns(state.rate_rad_s, self.times_s)[0] @ state.rotation
        effect = self.deviations.effect(self.model, self.seen, position, rotation, state.ambient_T)
        if not np.isfinite(effect).all():  # on a wire
            return self
        mixing = _inverse_root(effect)
        return replace(self, mixing=mixing, effect=mixing @ effect)

    def residual(self, state: State) -> tuple[FloatArray, FloatArray]:
        """Return measured minus expected numbers, shape (3 r,), and the Jacobian of the expected, shape (3 r, 15)."""
        return self.linearised(state)[:2]

    def linearised(self, state: State) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return what `residual` does, and the beacons' fields and gradients at mid-cycle in the sensor's frame.

        Their shapes are (n, 3) and (n, 3, 3); the gradient is R'G, its columns are along the site's axes.

        At a node the field of beacon i is h = R' B_i(p) in the sensor's frame, and
        dh = R' (G_i dp + B_i x d_theta): R' [G_i, tau G_i, [B_i]x Exp(w tau), [B_i]x tau J(w tau)] of the errors at
        mid-cycle, J the left Jacobian of rotations.
        """
        nodes, beacons = len(self.times_s), len(self.model)
        points = state.position_m + self.times_s[:, None] * state.velocity_m_s
        field, gradient = kernel.evaluate(self.model, points.T)  # (3, k, n), (3, 3, k, n)
        now, by_rate = _turns(state.rate_rad_s, self.times_s)
        back = (now @ state.rotation).swapaxes(1, 2)
        fields = np.empty((nodes, 3, beacons + 1))
        fields[:, :, :beacons] = field.swapaxes(0, 1)
        fields[:, :, beacons] = state.ambient_T
        in_sensor = (back @ fields).swapaxes(1, 2)  # (k, n + 1, 3)
        slope = back @ gradient.transpose(2, 0, 1, 3).reshape(nodes, 3, -1)
        slope = slope.reshape(nodes, 3, 3, beacons).transpose(1, 3, 0, 2)  # (3, n, k, 3)
        # R' Exp' [B]x = [h]x R' Exp', of which the turn's part is [h]x R', since Exp' Exp = 1
        turned = np.empty((nodes, 3, 6))
        turned[:, :, :3] = state.rotation.T
        turned[:, :, 3:] = back @ by_rate
        across = in_sensor @ (UNIT_CROSSES.reshape(9, 3) @ turned).reshape(nodes, 3, 18)
        across = across.reshape(nodes, beacons + 1, 3, 6).transpose(2, 1, 0, 3)
        change = np.zeros((3, beacons + 1, nodes, SIZE + 1))  # the last column is the field itself
        change[:, :beacons, :, POSITION] = slope
        change[:, :beacons, :, VELOCITY] = self.times_s[:, None] * slope
        change[..., TURN], change[..., RATE] = across[..., :3], across[..., 3:]
        change[:, beacons, :, AMBIENT] = back.swapaxes(0, 1)
        change[..., SIZE] = in_sensor.T
        seen = self.seen @ change.reshape(3, -1, SIZE + 1)
        seen[..., SIZE] -= self.values
        told = seen.reshape(-1, SIZE + 1)
        if self.mixing is not None:
            told = self.mixing @ told
        middle = nodes // 2
        return -told[:, SIZE], told[:, :SIZE], in_sensor[middle, :beacons], slope[:, :, middle].swapaxes(0, 1)

    def strength(self) -> float:
        """Return what the numbers hold beside the ambient field: chi-square if there is nothing but noise.

        Its degrees of freedom are then at most ``count``.
        """
        ambient = self.seen[:, :, -len(self.times_s) :]
        if not ambient.any():
            return float((self.values * self.values).sum())
        total = 0.0
        for seen, values in zip(ambient, self.values, strict=True):
            rest = values - seen @ np.linalg.lstsq(seen, values, rcond=None)[0]
            total += float(rest @ rest)
        return total


def _inverse_root(effect: FloatArray) -> FloatArray:
    """Return a matrix W, shape (m, m), with W (I + E E') W' = I for effects E, shape (m, k)."""
    try:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(np.eye(len(effect)) + effect @ effect.T)))
    except np.linalg.LinAlgError:  # the noise is nothing beside the effects: slower, but nothing is rounded off
        across, size, _ = np.linalg.svd(effect)
        size = np.append(size, np.zeros(max(len(effect) - len(size), 0)))
        return np.asarray((across / np.sqrt(1.0 + size * size)).T)


def turn_matrix(vector: FloatArray) -> FloatArray:
    """Return the rotation by a rotation vector, shape (3,): Rodrigues' formula, shape (3, 3)."""
    return _series(vector, *_coefficients(float(vector @ vector))[:2])


def turn_jacobian(vector: FloatArray) -> FloatArray:
    """Return the left Jacobian J of rotations, shape (3, 3): Exp(v + dv) = Exp(J dv) Exp(v) for small dv."""
    return _series(vector, *_coefficients(float(vector @ vector))[1:])


def _turns(rate_rad_s: FloatArray, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Exp(w tau) and tau J(w tau) at times tau, shape (k,): shapes (k, 3, 3).

    Both are sums of I, [w]x and [w]x^2, of which only the coefficients depend on the time.
    """
    rate2 = float(rate_rad_s @ rate_rad_s)
    terms = []
    for tau in times_s.tolist():
        first, second, third = _coefficients(rate2 * tau * tau)
        terms.append((1.0, first * tau, second * tau * tau))
        terms.append((tau, second * tau * tau, third * tau**3))
    cross = skew(rate_rad_s)
    powers = np.array([IDENTITY, cross, cross @ cross]).reshape(3, 9)
    both = (np.array(terms) @ powers).reshape(-1, 2, 3, 3)
    return both[:, 0], both[:, 1]


def _coefficients(angle2: float) -> tuple[float, float, float]:
    """Return sin(x)/x, (1 - cos x)/x^2 and (x - sin x)/x^3 of an angle x, given its square."""
    if angle2 < 1e-6:
        return 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, (1.0 - angle2 / 20.0) / 6.0
    angle = math.sqrt(angle2)
    sine = math.sin(angle) / angle
    return sine, (1.0 - math.cos(angle)) / angle2, (1.0 - sine) / angle2


def _series(vector: FloatArray, first: float, second: float) -> FloatArray:
    """Return I + first [v]x + second [v]x^2."""
    x, y, z = vector.tolist()
    xx, yy, zz = second * x * x, second * y * y, second * z * z
    xy, xz, yz = second * x * y, second * x * z, second * y * z
    x, y, z = first * x, first * y, first * z
    return np.array([[1.0 - yy - zz, xy - z, xz + y], [xy + z, 1.0 - xx - zz, yz - x], [xz - y, yz + x, 1.0 - xx - yy]])


def standing(position_m: FloatArray, orientation_xyzw: FloatArray) -> State:
    """Return the state of a sensor at rest, the ambient field not known."""
    return State(position_m, matrix_of(orientation_xyzw), np.zeros(3), np.zeros(3), np.zeros(3))

"""The state of a moving sensor, how it goes on, and what a cycle sees of it.

An error of the state is a vector of 15: position (m), a small rotation in the site's frame (rad), velocity (m/s),
angular velocity (rad/s, site's frame), ambient field (T, site's frame). The true state is `State.moved` by it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate.rotations import skew
from goldfield.track.deviations import Deviations
from goldfield.types import FloatArray

SIZE = 15
IDENTITY: FloatArray = np.eye(3)
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
        turn = Rotation.from_matrix(self.rotation @ other.rotation.T).as_rotvec()
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
        turn = seconds * self.rate_rad_s
        result = np.eye(SIZE)
        result[POSITION, VELOCITY] = seconds * IDENTITY
        result[TURN, TURN] = turn_matrix(turn)
        result[TURN, RATE] = seconds * turn_jacobian(turn)
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
        span = abs(seconds)
        result = np.zeros((SIZE, SIZE))
        for place, speed, sigma in ((POSITION, VELOCITY, self.acceleration), (TURN, RATE, self.angular_acceleration)):
            unit = sigma * np.sqrt(span) * IDENTITY
            result[place, place] = seconds / np.sqrt(12.0) * unit
            result[place, speed] = 0.5 * seconds * unit
            result[speed, speed] = unit
        result[AMBIENT, AMBIENT] = self.ambient * np.sqrt(span) * IDENTITY
        return result


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
        position = state.position_m + np.outer(self.times_s, state.velocity_m_s)
        rotation = np.array([turn_matrix(time_s * state.rate_rad_s) @ state.rotation for time_s in self.times_s])
        effect = self.deviations.effect(self.model, self.seen, position, rotation, state.ambient_T)
        if not np.isfinite(effect).all():  # on a wire
            return self
        mixing = np.linalg.inv(np.linalg.cholesky(np.eye(len(effect)) + effect @ effect.T))
        return replace(self, mixing=mixing, effect=mixing @ effect)

    def residual(self, state: State) -> tuple[FloatArray, FloatArray]:
        """Return measured minus expected numbers, shape (3 r,), and the Jacobian of the expected, shape (3 r, 15)."""
        return self.linearised(state)[:2]

    def linearised(self, state: State) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what `residual` does, and the beacons' fields at mid-cycle in the sensor's frame, shape (n, 3).

        At a node the field of beacon i is h = R' B_i(p) in the sensor's frame, and
        dh = R' (G_i dp + B_i x d_theta): R' [G_i, tau G_i, [B_i]x Exp(w tau), [B_i]x tau J(w tau)] of the errors at
        mid-cycle, J the left Jacobian of rotations.
        """
        nodes, beacons = len(self.times_s), len(self.model)
        points = state.position_m + np.outer(self.times_s, state.velocity_m_s)
        field, gradient = self.model.evaluate(points.T)  # (3, k, n), (3, 3, k, n)
        fields = np.empty((beacons + 1, nodes, 3))
        fields[:beacons] = field.transpose(2, 1, 0)
        fields[beacons] = state.ambient_T
        change = np.zeros((beacons + 1, nodes, 3, SIZE))
        change[:beacons, :, :, POSITION] = gradient.transpose(3, 2, 0, 1)
        change[:, :, :, VELOCITY] = self.times_s[:, None, None] * change[:, :, :, POSITION]
        change[beacons, :, :, AMBIENT] = IDENTITY
        turns = np.outer(self.times_s, state.rate_rad_s)
        both = [_turn_and_jacobian(turn) for turn in turns]
        now = np.array([turn for turn, _ in both])
        by_rate = self.times_s[:, None, None] * np.array([jacobian for _, jacobian in both])
        across = skew(fields)
        change[..., TURN] = across @ now
        change[..., RATE] = across @ by_rate
        back = (now @ state.rotation).swapaxes(1, 2)
        in_sensor = (back @ fields[..., None])[..., 0].reshape(-1, 3)
        by_error = (back @ change).reshape(-1, 3, SIZE).swapaxes(0, 1)
        expected = (self.seen @ in_sensor.T[:, :, None])[..., 0]
        residual, jacobian = (self.values - expected).ravel(), (self.seen @ by_error).reshape(-1, SIZE)
        middle = field[:, nodes // 2].T @ state.rotation
        if self.mixing is None:
            return residual, jacobian, middle
        return self.mixing @ residual, self.mixing @ jacobian, middle

    def strength(self) -> float:
        """Return what the numbers hold beside the ambient field: chi-square if there is nothing but noise.

        Its degrees of freedom are then at most ``count``.
        """
        total, nodes = 0.0, len(self.times_s)
        for seen, values in zip(self.seen, self.values, strict=True):
            ambient = seen[:, -nodes:]
            rest = values - ambient @ np.linalg.lstsq(ambient, values, rcond=None)[0] if ambient.any() else values
            total += float(rest @ rest)
        return total


def turn_matrix(vector: FloatArray) -> FloatArray:
    """Return the rotation by a rotation vector, shape (3,): Rodrigues' formula, shape (3, 3)."""
    return _series(vector, *_coefficients(vector)[:2])


def turn_jacobian(vector: FloatArray) -> FloatArray:
    """Return the left Jacobian J of rotations, shape (3, 3): Exp(v + dv) = Exp(J dv) Exp(v) for small dv."""
    return _series(vector, *_coefficients(vector)[1:])


def _turn_and_jacobian(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    first, second, third = _coefficients(vector)
    return _series(vector, first, second), _series(vector, second, third)


def _coefficients(vector: FloatArray) -> tuple[float, float, float]:
    """Return sin(x)/x, (1 - cos x)/x^2 and (x - sin x)/x^3 of a vector's length x."""
    angle2 = float(vector @ vector)
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
    rotation = Rotation.from_quat(orientation_xyzw).as_matrix()
    return State(position_m, rotation, np.zeros(3), np.zeros(3), np.zeros(3))


def orthonormal(rotation: FloatArray) -> FloatArray:
    """Remove the rounding of many turns: one Newton step to the nearest rotation."""
    return np.asarray(0.5 * rotation @ (3.0 * IDENTITY - rotation.T @ rotation))

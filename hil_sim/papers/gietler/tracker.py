"""Tracking a body with three emitters by one fixed three-axis sensor (Gietler, Ammari & Zangl).

The emitters transmit one after the other, in slots that are short against the body's motion: every epoch gives three
field vectors at one pose, as phasors if the sensor knows the emitters' phase. The base model takes the emitters for
dipoles in air; the extended model adds the field of a conductor that moves with them. State, process model and
iterated update are those of the beacons' tracker (`motion`, `estimate`); there is no ambient field, as the emitters
alternate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, cast

import numpy as np

from goldfield.field.conductor import Parts
from goldfield.field.conductor.explicit import ComplexArray
from goldfield.locate.rotations import skew
from goldfield.track.estimate import Belief, estimate
from goldfield.track.motion import POSITION, SIZE, TURN, Agility, Observation, State
from goldfield.types import FloatArray

EVALUATIONS = 30
"""Largest number of evaluations of the field model in one update; most updates need three."""


@dataclass(frozen=True, eq=False)
class EmitterBody:
    """Emitters fixed to a moving body, in the body's frame.

    Attributes
    ----------
    offset_m, moment_A_m2 : ndarray, shape (3, 3)
        One emitter a row.
    parts : Parts or None
        The conductor that moves with them, one row of currents and moments an emitter; None: the base model.
    """

    offset_m: FloatArray
    moment_A_m2: FloatArray
    parts: Parts | None = None

    @cached_property
    def _sources(self) -> Parts:
        """Return the emitters' own dipoles and the conductor's parts together."""
        count = len(self.offset_m)
        own = np.zeros((count, count, 3), dtype=np.complex128)
        own[np.arange(count), np.arange(count)] = self.moment_A_m2
        alone = Parts(self.offset_m, np.zeros_like(own), own)
        if self.parts is None:
            return alone
        return Parts(
            np.concatenate([alone.position_m, self.parts.position_m]),
            np.concatenate([alone.current_A_m, self.parts.current_A_m], axis=1),
            np.concatenate([alone.moment_A_m2, self.parts.moment_A_m2], axis=1),
        )

    def seen(self, state: State) -> tuple[ComplexArray, ComplexArray]:
        """Return the field at the sensor, at the origin, and its Jacobian by position and turn, shape (3, 3, 6).

        With d = -p and h(R'd) in the body's frame, H = R h: dH = R G R' (-dp + d x d_theta) - H x d_theta.
        """
        rotation = state.rotation
        towards = -state.position_m
        fields, gradients = self._sources.field_and_gradient((rotation.T @ towards)[None])
        field, gradient = fields[:, 0] @ rotation.T, rotation @ gradients[:, 0] @ rotation.T
        across = np.stack([skew(h.real) + 1.0j * skew(h.imag) for h in field])
        return field, np.concatenate([-gradient, gradient @ skew(towards) - across], axis=2)


@dataclass(frozen=True, eq=False)
class EmitterObservation:
    """The fields of one epoch.

    Attributes
    ----------
    body : EmitterBody
    field_A_m : ndarray of complex, shape (3, 3)
        One emitter a row.
    sigma_A_m : ndarray, shape (3,)
        Standard deviation of each emitter's components, real and imaginary alike.
    """

    body: EmitterBody
    field_A_m: ComplexArray
    sigma_A_m: FloatArray
    mixing: ClassVar[None] = None
    effect: ClassVar[None] = None

    @property
    def count(self) -> int:
        """Return how many real numbers were measured."""
        return 2 * self.field_A_m.size

    def around(self, state: State) -> EmitterObservation:
        """Return the observation itself: it has no errors beside its noise."""
        return self

    def residual(self, state: State) -> tuple[FloatArray, FloatArray]:
        """Return measured minus expected numbers of unit variance, (18,), and the expected ones' Jacobian, (18, 15)."""
        field, change = self.body.seen(state)
        weight = 1.0 / self.sigma_A_m[:, None]
        difference = weight * (self.field_A_m - field)
        change = (weight[..., None] * change).reshape(-1, 6)
        jacobian = np.zeros((2 * len(change), SIZE))
        jacobian[:, POSITION] = np.concatenate([change.real, change.imag])[:, :3]
        jacobian[:, TURN] = np.concatenate([change.real, change.imag])[:, 3:]
        return np.concatenate([difference.real.ravel(), difference.imag.ravel()]), jacobian


@dataclass(frozen=True)
class Noise:
    """What a measured component's error is made of.

    Attributes
    ----------
    sensor_A_m : float
        Standard deviation of the sensor's noise.
    model : float
        Relative error of the field model.
    """

    sensor_A_m: float = 1e-4
    model: float = 0.005

    def sigma(self, field_A_m: ComplexArray) -> FloatArray:
        """Return the standard deviation for each emitter from the measured fields."""
        size = np.linalg.norm(field_A_m, axis=1)
        return np.asarray(np.sqrt(self.sensor_A_m**2 + (self.model * size) ** 2))


class EmitterTracker:
    """Iterated error-state filter: position, attitude, velocity, angular velocity.

    Parameters
    ----------
    body : EmitterBody
    start : State
    deviations : ndarray, shape (4,)
        Standard deviations at the start of position (m), attitude (rad), velocity (m/s) and angular velocity (rad/s).
    agility : Agility
    noise : Noise
    """

    def __init__(
        self, body: EmitterBody, start: State, deviations: FloatArray, agility: Agility, noise: Noise | None = None
    ) -> None:
        self.body, self._agility = body, agility
        self._noise = Noise() if noise is None else noise
        self.belief = Belief(start, np.diag(np.repeat(np.append(deviations, 0.0), 3)))

    def predict(self, seconds: float) -> None:
        """Go on in time."""
        self.belief = self.belief.after(seconds, self._agility)

    def update(self, field_A_m: ComplexArray) -> State:
        """Take an epoch's fields, shape (3, 3), and return the state after it."""
        observation = EmitterObservation(self.body, field_A_m, self._noise.sigma(field_A_m))
        self.belief = estimate(self.belief, cast(Observation, observation), EVALUATIONS).belief
        return self.belief.state


class PlainFilter:
    """The extended Kalman filter as printed: Euler angles R = Rz Ry Rx, one linearisation an epoch, eqs. (17) to (24).

    The parameters are those of `EmitterTracker`, but ``start`` is (velocity, position, angle rates, angles), shape
    (4, 3).
    """

    def __init__(
        self, body: EmitterBody, start: FloatArray, deviations: FloatArray, agility: Agility, noise: Noise | None = None
    ) -> None:
        self.body, self._agility = body, agility
        self._noise = Noise() if noise is None else noise
        self.state: FloatArray = start.ravel().copy()
        order = deviations[[2, 0, 3, 1]]
        self._covariance: FloatArray = np.diag(np.repeat(order, 3) ** 2)

    def predict(self, seconds: float) -> None:
        """Go on in time."""
        transition = np.eye(12)
        transition[3:6, 0:3] = transition[9:12, 6:9] = seconds * np.eye(3)
        self.state = transition @ self.state
        self._covariance = transition @ self._covariance @ transition.T
        block = np.array([[seconds, seconds**2 / 2.0], [seconds**2 / 2.0, seconds**3 / 3.0]])
        for first, sigma in ((0, self._agility.acceleration), (6, self._agility.angular_acceleration)):
            self._covariance[first : first + 6, first : first + 6] += sigma**2 * np.kron(block, np.eye(3))

    def update(self, field_A_m: ComplexArray) -> State:
        """Take an epoch's fields and return the state after it."""
        observation = EmitterObservation(self.body, field_A_m, self._noise.sigma(field_A_m))
        innovation, by_error = observation.residual(self._as_state())
        jacobian = np.zeros((len(innovation), 12))
        jacobian[:, 3:6] = by_error[:, POSITION]
        jacobian[:, 9:12] = by_error[:, TURN] @ euler_axes(self.state[9:])
        spread = jacobian @ self._covariance @ jacobian.T + np.eye(len(innovation))
        gain = np.linalg.solve(spread, jacobian @ self._covariance).T
        self.state = self.state + gain @ innovation
        self._covariance = (np.eye(12) - gain @ jacobian) @ self._covariance
        self._covariance = 0.5 * (self._covariance + self._covariance.T)
        return self._as_state()

    def _as_state(self) -> State:
        velocity, position, rates, angles = self.state.reshape(4, 3)
        return State(position, euler_matrix(angles), velocity, euler_axes(angles) @ rates, np.zeros(3))


def euler_matrix(angles_rad: FloatArray) -> FloatArray:
    """Return R = Rz Ry Rx of angles about x, y and z, shape (3, 3); eq. (3)."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles_rad), np.sin(angles_rad)
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def euler_axes(angles_rad: FloatArray) -> FloatArray:
    """Return the matrix from rates of the angles to the angular velocity in the fixed frame, shape (3, 3)."""
    _, cy, cz = np.cos(angles_rad)
    _, sy, sz = np.sin(angles_rad)
    return np.array([[cz * cy, -sz, 0.0], [sz * cy, cz, 0.0], [-sy, 0.0, 1.0]])

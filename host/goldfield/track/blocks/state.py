"""The state of the block filter: 18 errors, and how they go on.

Their order: position (m), a small rotation in the site's frame (rad), velocity (m/s), turn rate (rad/s, site's frame),
ambient field (T, site's frame), offset of the sensor (T, its own frame). The first fifteen are those of
`goldfield.track.motion`. Everything takes leading axes: the filters of a bank go on together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.locate.rotations import orthonormal
from goldfield.track.motion import UNIT_CROSSES
from goldfield.types import FloatArray

SIZE = 18
POSITION, TURN, VELOCITY, RATE, AMBIENT, OFFSET = (slice(first, first + 3) for first in range(0, SIZE, 3))

AMBIENT_WALK_T = 5e-6
"""Walk of the ambient field, T per root second: it differs from place to place, near iron by microteslas."""

OFFSET_WALK_T = 2e-8
"""Walk of the sensor's offset, T per root second."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A sensor at one moment, or several of them with leading axes.

    Attributes
    ----------
    position_m : ndarray, shape (..., 3)
    rotation : ndarray, shape (..., 3, 3)
        ``B_site = R B_sensor``.
    velocity_m_s, rate_rad_s : ndarray, shape (..., 3)
        In the site's frame.
    ambient_T : ndarray, shape (..., 3)
        The ambient field in the site's frame.
    offset_T : ndarray, shape (..., 3)
        The sensor's offset in its own frame.
    """

    position_m: FloatArray
    rotation: FloatArray
    velocity_m_s: FloatArray
    rate_rad_s: FloatArray
    ambient_T: FloatArray
    offset_T: FloatArray

    def after(self, seconds: float) -> Motion:
        """Return the motion some time later, or earlier, at constant velocity and turn rate."""
        return onward(self, seconds)[0]

    def moved(self, error: FloatArray) -> Motion:
        """Return the motion that differs by an error, shape (..., 18)."""
        return Motion(
            self.position_m + error[..., POSITION],
            rotation_of(error[..., TURN]) @ self.rotation,
            self.velocity_m_s + error[..., VELOCITY],
            self.rate_rad_s + error[..., RATE],
            self.ambient_T + error[..., AMBIENT],
            self.offset_T + error[..., OFFSET],
        )

    def squared(self) -> Motion:
        """Return the motion without the rounding that many turns leave in its rotation."""
        return replace(self, rotation=orthonormal(self.rotation))

    def minus(self, other: Motion) -> FloatArray:
        """Return the errors, shape (..., 18), by which this differs from another motion, which may be a single one."""
        return np.concatenate(
            [
                self.position_m - other.position_m,
                rotation_vector(self.rotation @ np.swapaxes(other.rotation, -1, -2)),
                self.velocity_m_s - other.velocity_m_s,
                self.rate_rad_s - other.rate_rad_s,
                self.ambient_T - other.ambient_T,
                self.offset_T - other.offset_T,
            ],
            axis=-1,
        )

    def taken(self, which: int | NDArray[np.intp]) -> Motion:
        """Return one or some of several motions."""
        return Motion(
            self.position_m[which],
            self.rotation[which],
            self.velocity_m_s[which],
            self.rate_rad_s[which],
            self.ambient_T[which],
            self.offset_T[which],
        )


_CROSSES: FloatArray = np.ascontiguousarray(UNIT_CROSSES.reshape(3, 9))
_TURNS: FloatArray = 0.5 * _CROSSES.T
"""What makes [v]x of v, and the sine times the axis of a rotation's nine elements."""

_EYE3: FloatArray = np.eye(3)


def crosses(vector: FloatArray) -> FloatArray:
    """Return [v]x, shape (..., 3, 3), of vectors, shape (..., 3)."""
    return np.asarray((vector @ _CROSSES).reshape(*vector.shape, 3))


def rotation_of(vector: FloatArray) -> FloatArray:
    """Return the rotations by rotation vectors, shape (..., 3): Rodrigues' formula, shape (..., 3, 3)."""
    angle2 = (vector * vector).sum(axis=-1)[..., None, None]
    cross = crosses(vector)
    if angle2.max() < 1e-2:  # the next terms of both series are below 1e-9
        sine = 1.0 + angle2 * (angle2 / 120.0 - 1.0 / 6.0)
        versine = 0.5 + angle2 * (angle2 / 720.0 - 1.0 / 24.0)
    else:
        angle = np.sqrt(np.maximum(angle2, 1e-12))
        sine, versine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle)
    return np.asarray(_EYE3 + sine * cross + versine * (cross @ cross))


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """Return the rotation vectors of rotations that are well below half a turn, shape (..., 3, 3) to (..., 3)."""
    flat = rotation.reshape(*rotation.shape[:-2], 9)
    sine = flat @ _TURNS
    length = np.sqrt((sine * sine).sum(axis=-1, keepdims=True))
    cosine = 0.5 * (flat[..., ::4].sum(axis=-1, keepdims=True) - 1.0)
    return np.asarray(sine * (np.arctan2(length, cosine) / np.maximum(length, 1e-300)))


def onward(motion: Motion, seconds: float) -> tuple[Motion, FloatArray]:
    """Return the motion some time later and how small errors go on until then, shape (..., 18, 18)."""
    turning = seconds * motion.rate_rad_s
    turn = rotation_of(turning)
    transition = np.zeros((*turning.shape[:-1], SIZE, SIZE))
    transition.reshape(-1, SIZE * SIZE)[:, :: SIZE + 1] = 1.0
    transition[..., POSITION, VELOCITY] = seconds * _EYE3
    transition[..., TURN, TURN] = turn
    cross = crosses(turning)
    transition[..., TURN, RATE] = seconds * (_EYE3 + 0.5 * cross + cross @ cross / 6.0)
    later = Motion(
        motion.position_m + seconds * motion.velocity_m_s,
        turn @ motion.rotation,
        motion.velocity_m_s,
        motion.rate_rad_s,
        motion.ambient_T,
        motion.offset_T,
    )
    return later, transition


def added(agility: FloatArray, seconds: float) -> FloatArray:
    """Return the covariance that time adds, shape (..., 18, 18).

    Parameters
    ----------
    agility : ndarray, shape (..., 2)
        Agilities of acceleration, m/s^2 per root hertz, and of the turn, rad/s^2 per root hertz.
    seconds : float
        Negative ones add as much.
    """
    result = np.zeros((*agility.shape[:-1], SIZE, SIZE))
    long, eye = abs(seconds), np.eye(3)
    for place, speed, power in (
        (POSITION, VELOCITY, agility[..., 0, None, None] ** 2),
        (TURN, RATE, agility[..., 1, None, None] ** 2),
    ):
        result[..., place, place] = long**3 / 3.0 * power * eye
        result[..., place, speed] = result[..., speed, place] = 0.5 * seconds * long * power * eye
        result[..., speed, speed] = long * power * eye
    result[..., AMBIENT, AMBIENT] = AMBIENT_WALK_T**2 * long * eye
    result[..., OFFSET, OFFSET] = OFFSET_WALK_T**2 * long * eye
    return result

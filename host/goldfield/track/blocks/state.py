"""The state of the block filter: 18 errors, and how they go on.

Their order: position (m), a small rotation in the site's frame (rad), velocity (m/s), turn rate (rad/s, site's frame),
ambient field (T, site's frame), offset of the sensor (T, its own frame). The first fifteen are those of
`goldfield.track.motion`. Everything takes leading axes: the filters of a bank go on together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.locate.rotations import orthonormal, skew
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
        turn = rotation_of(seconds * self.rate_rad_s)
        return Motion(
            self.position_m + seconds * self.velocity_m_s,
            orthonormal(turn @ self.rotation),
            self.velocity_m_s,
            self.rate_rad_s,
            self.ambient_T,
            self.offset_T,
        )

    def moved(self, error: FloatArray) -> Motion:
        """Return the motion that differs by an error, shape (..., 18)."""
        return Motion(
            self.position_m + error[..., POSITION],
            orthonormal(rotation_of(error[..., TURN]) @ self.rotation),
            self.velocity_m_s + error[..., VELOCITY],
            self.rate_rad_s + error[..., RATE],
            self.ambient_T + error[..., AMBIENT],
            self.offset_T + error[..., OFFSET],
        )

    def taken(self, which: object) -> Motion:
        """Return some of several motions, by an index of the leading axes."""
        return Motion(*(part[which] for part in self._parts))  # type: ignore[call-overload]

    @property
    def _parts(self) -> tuple[FloatArray, ...]:
        return (
            self.position_m,
            self.rotation,
            self.velocity_m_s,
            self.rate_rad_s,
            self.ambient_T,
            self.offset_T,
        )


def rotation_of(vector: FloatArray) -> FloatArray:
    """Return the rotations by rotation vectors, shape (..., 3): Rodrigues' formula, shape (..., 3, 3)."""
    angle2 = (vector * vector).sum(axis=-1)[..., None, None]
    small = angle2 < 1e-6
    angle = np.sqrt(np.where(small, 1.0, angle2))
    sine = np.where(small, 1.0 - angle2 / 6.0, np.sin(angle) / angle)
    versine = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(angle)) / (angle * angle))
    cross = skew(vector)
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """Return the rotation vectors of rotations that are well below half a turn, shape (..., 3, 3) to (..., 3)."""
    sine = 0.5 * np.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        axis=-1,
    )
    length = np.sqrt((sine * sine).sum(axis=-1, keepdims=True))
    cosine = 0.5 * (np.trace(rotation, axis1=-2, axis2=-1)[..., None] - 1.0)
    angle = np.arctan2(length, cosine)
    return np.asarray(sine * np.where(length > 1e-8, angle / np.maximum(length, 1e-300), 1.0))


def transition(rate_rad_s: FloatArray, seconds: float) -> FloatArray:
    """Return how small errors go on at turn rates, shape (..., 3): shape (..., 18, 18)."""
    result = np.zeros((*rate_rad_s.shape[:-1], SIZE, SIZE))
    result[...] = np.eye(SIZE)
    result[..., POSITION, VELOCITY] = result[..., TURN, RATE] = seconds * np.eye(3)
    cross = skew(seconds * rate_rad_s)
    result[..., TURN, TURN] = rotation_of(seconds * rate_rad_s)
    result[..., TURN, RATE] += 0.5 * seconds * cross
    return result


def added(agility: FloatArray, seconds: float) -> FloatArray:
    """Return the covariance that time adds, shape (..., 18, 18).

    Parameters
    ----------
    agility : ndarray, shape (..., 2)
        Of acceleration, m/s^2 per root hertz, and of the turn, rad/s^2 per root hertz.
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

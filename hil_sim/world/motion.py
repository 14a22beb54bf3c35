"""Motions of a sensor: poses as functions of time, ``B_site = R B_sensor``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]


class Motion(Protocol):
    """A trajectory."""

    @property
    def still(self) -> bool:
        """True if the pose never changes."""
        ...

    def poses(self, times_s: FloatArray) -> tuple[FloatArray, Rotation]:
        """Return positions, shape (n, 3), metres, and n rotations from the sensor's frame to the site's."""
        ...


@dataclass(frozen=True, eq=False)
class Still:
    """A sensor at rest.

    Parameters
    ----------
    position_m : ndarray, shape (3,)
    rotation_vector_rad : ndarray, shape (3,)
        Rotation from the sensor's frame to the site's.
    """

    position_m: FloatArray
    rotation_vector_rad: FloatArray
    still: bool = True

    def poses(self, times_s: FloatArray) -> tuple[FloatArray, Rotation]:
        """See `Motion.poses`."""
        count = len(times_s)
        return np.tile(self.position_m, (count, 1)), Rotation.from_rotvec(np.tile(self.rotation_vector_rad, (count, 1)))


@dataclass(frozen=True, eq=False)
class Line:
    """A straight line at constant speed with constant rotation.

    Parameters
    ----------
    position_m, rotation_vector_rad : ndarray, shape (3,)
        Pose at time 0.
    velocity_m_per_s : ndarray, shape (3,)
    rate_rad_per_s : ndarray, shape (3,)
        Angular velocity in the site's frame.
    """

    position_m: FloatArray
    rotation_vector_rad: FloatArray
    velocity_m_per_s: FloatArray
    rate_rad_per_s: FloatArray
    still: bool = False

    def poses(self, times_s: FloatArray) -> tuple[FloatArray, Rotation]:
        """See `Motion.poses`."""
        turned = Rotation.from_rotvec(np.outer(times_s, self.rate_rad_per_s))
        return (
            self.position_m + np.outer(times_s, self.velocity_m_per_s),
            turned * Rotation.from_rotvec(self.rotation_vector_rad),
        )


class Waypoints:
    """Through given poses at given times; at rest before the first and after the last.

    The position is a cubic spline with zero speed at both ends. The attitude turns about a fixed axis from waypoint to
    waypoint, with a rate that starts and ends at zero (the cubic 3 u^2 - 2 u^3 of the fraction u of the way).

    Parameters
    ----------
    times_s : ndarray, shape (n,)
        Increasing, at least two.
    positions_m : ndarray, shape (n, 3)
    rotation_vectors_rad : ndarray, shape (n, 3)
    """

    still = False

    def __init__(self, times_s: FloatArray, positions_m: FloatArray, rotation_vectors_rad: FloatArray) -> None:
        self._times = times_s
        self._spline = CubicSpline(times_s, positions_m, bc_type="clamped")
        self._rotations = Rotation.from_rotvec(rotation_vectors_rad)
        self._turns = (self._rotations[:-1].inv() * self._rotations[1:]).as_rotvec()

    def poses(self, times_s: FloatArray) -> tuple[FloatArray, Rotation]:
        """See `Motion.poses`."""
        times = np.clip(times_s, self._times[0], self._times[-1])
        leg = np.clip(np.searchsorted(self._times, times, side="right") - 1, 0, len(self._times) - 2)
        u = (times - self._times[leg]) / np.diff(self._times)[leg]
        turned = Rotation.from_rotvec((u * u * (3.0 - 2.0 * u))[:, None] * self._turns[leg])
        return np.asarray(self._spline(times), dtype=np.float64), self._rotations[leg] * turned

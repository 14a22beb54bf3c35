"""Smooth motions without a stop: through a box at a chosen speed, turning all the time, and shaken by a hand if wished.

Each coordinate is the sum of two waves that fill the box. The attitude is R(t) = exp(t w1) exp(t w2) R0 with w1 and w2
at right angles: the angular velocity w1 + exp(t w1) w2 has a constant size and a turning axis. Every derivative exists
at every moment, so that nothing but speed, turn rate and shaking makes a motion hard to follow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]

SHARES = np.array([0.6, 0.4])
"""Amplitudes of a coordinate's two waves in half the side of the box: together they just reach its walls."""
SPREAD = 0.25
"""Largest relative difference of a wave's frequency from the common one, so that no curve closes."""
TURN_SHARES = np.array([0.8, 0.6])
"""Shares of the two turns in the turn rate: their axes are at right angles, so that their squares add up to 1."""
ELLIPSE = 0.5
"""The hand shakes along an ellipse whose short half axis is this part of its long one."""


@dataclass(frozen=True)
class Shake:
    """How a hand shakes the sensor: ``size_m`` and ``angle_rad`` to each side of the smooth curve, ``frequency_Hz``."""

    frequency_Hz: float = 0.0
    size_m: float = 0.0
    angle_rad: float = 0.0


class Roaming:
    """A smooth motion inside a box that never rests.

    Parameters
    ----------
    seed : int
        The same seed makes the same motion.
    low_m, high_m : ndarray, shape (3,)
        Opposite corners of the box; the shaking comes on top. A side of no length leaves its coordinate as it is.
    speed_m_per_s : float
        Root mean square of the speed without the shaking; no effect in a box without a side.
    rate_rad_per_s : float
        Angular velocity without the shaking: its size is constant, its axis is not, and every attitude comes.
    shake : Shake
    """

    def __init__(
        self,
        seed: int,
        low_m: FloatArray,
        high_m: FloatArray,
        speed_m_per_s: float,
        rate_rad_per_s: float,
        shake: Shake | None = None,
    ) -> None:
        random = np.random.default_rng([seed, 6])
        self._shake = shake or Shake()
        self._middle, half = 0.5 * (low_m + high_m), 0.5 * (high_m - low_m)
        self._amplitudes = half[:, None] * SHARES
        relative = 1.0 + SPREAD * random.uniform(-1.0, 1.0, (3, 2))
        self._phases = random.uniform(0.0, 2.0 * math.pi, (3, 2))
        # The mean square of a wave's speed is (amplitude times angular frequency)^2 / 2.
        size = math.sqrt(0.5 * float(((self._amplitudes * relative) ** 2).sum()))
        self._rates = relative * (speed_m_per_s / size if size > 0.0 else 0.0)
        axes = Rotation.random(rng=random).as_matrix()
        self._turns = rate_rad_per_s * TURN_SHARES[:, None] * axes[:2]
        self._start = Rotation.random(rng=random)
        directions = Rotation.random(2, rng=random).as_matrix()
        self._shaken, self._tilted = directions[0][:2], directions[1][:2]
        self.still = not (self._rates.any() or rate_rad_per_s or self._shake.frequency_Hz)

    def poses(self, times_s: FloatArray) -> tuple[FloatArray, Rotation]:
        """See `hil_sim.world.motion.Motion.poses`."""
        times = np.asarray(times_s, dtype=np.float64)
        waves = np.sin(self._rates * times[:, None, None] + self._phases)
        positions = self._middle + (self._amplitudes * waves).sum(axis=2)
        turned = Rotation.from_rotvec(np.outer(times, self._turns[0]))
        rotation = turned * Rotation.from_rotvec(np.outer(times, self._turns[1])) * self._start
        angle = 2.0 * math.pi * self._shake.frequency_Hz * times
        ellipse = np.column_stack([np.sin(angle), ELLIPSE * (np.cos(angle) - 1.0)])
        positions = positions + self._shake.size_m * (ellipse @ self._shaken)
        return positions, rotation * Rotation.from_rotvec(self._shake.angle_rad * (ellipse @ self._tilted))

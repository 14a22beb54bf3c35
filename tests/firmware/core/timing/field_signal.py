"""What a sensor's converters see in the field of coded beacons, computed with NumPy alone; for the tests of acquire.c.

Nothing here is taken from the firmware or from ``hil_sim``: dipoles, a linear slew of the coil's current behind a
first-order low-pass, earth's field, mains, noise of a burst and of each conversion, a 12-bit converter.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]

TICKS_PER_S = 168e6
CHIP_TICKS = 16422
CHIPS = 1023
FIRST_HOLD, CONVERSION = 14672, 216
"""Ticks from a chip's start to the first conversion's sample, and from one to the next (boards: converters.c)."""
MOMENT_FIELD = 13.25e-7
"""mu0 m / 4 pi of the 0.298 m coil with 19 turns and 10 A, T m^3."""
CUBE_M = np.array([[x, y, z] for x in (0.0, 2.13) for y in (0.0, 2.13) for z in (0.0, 1.78)])


@dataclass
class Signal:
    """The field at one sensor, in its frame.

    Attributes
    ----------
    chips : ndarray, shape (beacons, 1023)
        Codes, +1 and -1.
    field_T : ndarray, shape (beacons, 3)
        The field of each beacon at chip +1.
    start_s : float
        When the beacons begin chip 0 of a cycle.
    chip_s : float
    rise_s, lag_s : float
        Duration of the current's slew, and the front end's time constant.
    earth_T, mains_T : ndarray, shape (3,)
    mains_Hz, mains_phase : float
    noise_T : float
        One number a burst and axis, standard deviation.
    conversion_noise_T : float
        One number a conversion and axis.
    on : callable
        Whether the beacons are on at a time, array to array.
    """

    chips: FloatArray
    field_T: FloatArray
    start_s: float
    random: np.random.Generator
    chip_s: float = CHIP_TICKS / TICKS_PER_S
    rise_s: float = 32e-6
    lag_s: float = 1.59e-6
    earth_T: FloatArray = field(default_factory=lambda: np.zeros(3))
    mains_T: FloatArray = field(default_factory=lambda: np.zeros(3))
    mains_Hz: float = 50.0
    mains_phase: float = 0.0
    noise_T: float = 2e-7
    conversion_noise_T: float = 5e-8
    on: Callable[[FloatArray], FloatArray] = field(default=lambda t: np.ones_like(t))

    def transition(self, since_s: FloatArray) -> FloatArray:
        """Return how much of a change is done, from 0 to 1, a time after the edge."""
        rise, lag = self.rise_s, self.lag_s
        t = np.clip(since_s, 0.0, None)
        during = (t - lag * (1.0 - np.exp(-t / lag))) / rise
        left = lag / rise * (1.0 - np.exp(-rise / lag))
        return np.where(t < rise, during, 1.0 - left * np.exp(-np.clip(t - rise, 0.0, None) / lag))

    def counts(self, time_s: FloatArray) -> NDArray[np.uint16]:
        """Return conversions of bursts held at times of shape (bursts, conversions); shape (bursts, conversions, 3)."""
        number = np.floor((time_s - self.start_s) / self.chip_s).astype(np.int64)
        since = time_s - self.start_s - number * self.chip_s
        before, now = self.chips[:, (number - 1) % CHIPS], self.chips[:, number % CHIPS]
        drive = (before + (now - before) * self.transition(since)) * self.on(time_s)
        total = np.einsum("kij,ka->ija", drive, self.field_T) + self.earth_T
        angle = 2.0 * np.pi * self.mains_Hz * time_s + self.mains_phase
        total += (np.sin(angle) + 0.3 * np.sin(3.0 * angle))[..., None] * self.mains_T
        total += self.random.normal(0.0, self.noise_T, (len(time_s), 1, 3))
        total += self.random.normal(0.0, self.conversion_noise_T, total.shape)
        return np.clip(np.floor(2048.5 + total * (2048 / 200e-6)), 0, 4095).astype(np.uint16)


def random_signal(random: np.random.Generator, family: FloatArray, codes: list[int], **options: object) -> Signal:
    """Return eight beacons in the cube, a random pose inside it, random time, clocks, earth and mains."""
    away = random.uniform([0.2, 0.2, 0.2], [1.93, 1.93, 1.58]) - CUBE_M
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    unit = away / distance
    dipole = MOMENT_FIELD * (3.0 * unit * unit[:, 2:] - np.array([0.0, 0.0, 1.0])) / distance**3
    turn = Rotation.random(random_state=random)

    def direction(size: float) -> FloatArray:
        return size * Rotation.random(random_state=random).apply([0.0, 0.0, 1.0])

    settings = {
        "start_s": -random.uniform(0.0, 0.1),
        "chip_s": CHIP_TICKS / TICKS_PER_S / (1.0 + random.uniform(-100e-6, 100e-6)),
        "earth_T": direction(50e-6),
        "mains_T": direction(0.5e-6),
        "mains_Hz": random.choice([50.0, 60.0]) + random.uniform(-0.1, 0.1),
        "mains_phase": random.uniform(0.0, 2.0 * np.pi),
    }
    return Signal(family[codes], turn.apply(dipole), random=random, **{**settings, **options})

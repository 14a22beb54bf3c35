"""A room with dual-axis beacons: what a sensor samples there.

The coils are magpylib's current loops with all turns at one radius; nothing here knows how the host models a beacon.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hil_sim.world.path import CoilGeometry

FloatArray = NDArray[np.float64]

EARTH_T = (18.0e-6, 2.0e-6, -44.0e-6)
"""A field of 48 uT, dipping as in middle northern latitudes."""

DAY_S = 86400.0
WARM_UP_S = 1800.0
"""Time constant with which a coil and its amplifier warm up."""
WARM_UP = -4.0e-3
"""Change of the current once they are warm: 1 K changes the resistance of copper by 0.39 %, of which an amplifier with
feedback leaves a part."""
DAILY = 1.0e-3
"""Amplitude of the change with the room's temperature over a day."""
WANDER, WANDER_S = 5.0e-4, 3600.0
"""Standard deviation and correlation time of what else happens (draughts, mains voltage)."""


class CrossedCoils(Protocol):
    """What the room needs to know of a beacon; units as named, axes of unit length."""

    @property
    def position_m(self) -> FloatArray: ...  # noqa: D102

    @property
    def x_axis(self) -> FloatArray: ...  # noqa: D102

    @property
    def y_axis(self) -> FloatArray: ...  # noqa: D102

    @property
    def turns(self) -> float: ...  # noqa: D102

    @property
    def radius_m(self) -> float: ...  # noqa: D102

    @property
    def current_A(self) -> float: ...  # noqa: D102

    @property
    def frequency_Hz(self) -> float: ...  # noqa: D102


class RotatingRoom:
    """The field of n dual-axis beacons and the earth.

    Parameters
    ----------
    beacons : sequence of CrossedCoils
        The coil around ``x_axis`` carries the cosine, the one around ``y_axis`` the sine.
    """

    def __init__(self, beacons: Sequence[CrossedCoils]) -> None:
        self._coils = [
            (beacon.current_A, CoilGeometry(beacon.turns, beacon.radius_m, beacon.position_m, axis))
            for beacon in beacons
            for axis in (beacon.x_axis, beacon.y_axis)
        ]
        self._frequency = np.array([beacon.frequency_Hz for beacon in beacons])

    def field(self, position_m: FloatArray) -> FloatArray:
        """Return Bc and Bs in the site's frame, tesla, shape (e, n, 2, 3), at positions of shape (e, 3)."""
        fields = [current * coil.field_per_ampere(position_m) for current, coil in self._coils]
        return np.stack(fields, axis=1).reshape(len(position_m), -1, 2, 3)

    def samples(
        self,
        position_m: FloatArray,
        rotation: FloatArray,
        time_s: FloatArray,
        noise_T: float,
        rng: np.random.Generator,
        drive: FloatArray | None = None,
    ) -> FloatArray:
        """Return what a sensor at rest samples, tesla, its own frame, shape (e, t, 3).

        Parameters
        ----------
        position_m, rotation : ndarray, shapes (e, 3) and (e, 3, 3)
            Pose of the sensor in each of e windows; ``B_site = R B_sensor``.
        time_s : ndarray, shape (t,)
            Times of the samples in a window, on the beacons' clock.
        noise_T : float
            Standard deviation of white noise of each sample.
        rng : numpy.random.Generator
        drive : ndarray, shape (e, n), optional
            Factor on each beacon's current; default 1.
        """
        field = self.field(position_m)
        if drive is not None:
            field = field * drive[:, :, None, None]
        turn = 2.0 * np.pi * np.outer(time_s, self._frequency)
        wave = np.stack([np.cos(turn), np.sin(turn)], axis=2)
        total = np.einsum("tns,ensj->etj", wave, field) + np.array(EARTH_T)
        return np.asarray(total @ rotation + noise_T * rng.standard_normal(total.shape))

    def thermal_drive(self, time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the factor on the current of each beacon over the hours after it was switched on, shape (t, n).

        It has the warm-up, the room's day, and a first-order Gauss-Markov wander; each beacon has its own share
        of each.

        Parameters
        ----------
        time_s : ndarray, shape (t,)
            Times, evenly spaced, from 0.
        rng : numpy.random.Generator
        """
        count = len(self._frequency)
        warm = WARM_UP * rng.uniform(0.5, 1.5, count) * -np.expm1(-time_s[:, None] / WARM_UP_S)
        phase = rng.uniform()
        day = DAILY * rng.uniform(0.5, 1.5, count) * np.sin(2.0 * np.pi * (time_s[:, None] / DAY_S + phase))
        keep = np.exp(-(time_s[1] - time_s[0]) / WANDER_S) if len(time_s) > 1 else 0.0
        kicks = WANDER * rng.standard_normal((len(time_s), count))
        kicks[1:] *= np.sqrt(1.0 - keep**2)
        wander = lfilter([1.0], [1.0, -keep], kicks, axis=0)
        return np.asarray(1.0 + warm + day + wander)

"""A simulated room with dual-axis beacons, and the host's view of it: fields separated from samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.errors import UserError
from goldfield.site.rotating import RotatingSite
from goldfield.types import FloatArray
from hil_sim.papers.zheng.methods.field_ellipse import rms_strength
from hil_sim.papers.zheng.methods.fingerprint import NEIGHBOURS, FingerprintMap
from hil_sim.papers.zheng.methods.separation import RotatingSeparator
from hil_sim.world.rotating_room import RotatingRoom

FINGERPRINT_SPACING_M = 0.5
"""Distance of neighbouring fingerprints along each axis."""

NEAREST_M = 0.92
"""No fingerprint and no target is nearer to a beacon: twice the coil's width, as the paper asks for dipoles (2.2)."""

MOST_TRIES = 20
"""Draws of random places after which a box counts as having no room for them."""


@dataclass(frozen=True)
class Setting:
    """What a room experiment fixes.

    Attributes
    ----------
    window_s, rate_Hz : float
        Duration and rate of the samples that one estimate is made from.
    noise_T : float
        Standard deviation of each sample in the simulated room.
    seed : int
    low_m, high_m : ndarray-like, 3 values each
        Corners of the box that holds fingerprints and targets.
    """

    window_s: float
    rate_Hz: float
    noise_T: float
    seed: int
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    def times_s(self) -> FloatArray:
        """Return the sample times of a window, shape (t,)."""
        return np.arange(max(round(self.window_s * self.rate_Hz), 1)) / self.rate_Hz


class Room:
    """A simulated room, and the host's view of it: fields separated from samples.

    Parameters
    ----------
    site : RotatingSite
        The beacons of the room, and what the host knows of them.
    setting : Setting
    """

    def __init__(self, site: RotatingSite, setting: Setting) -> None:
        self.site, self.setting = site, setting
        self.world = RotatingRoom(site.beacons)
        self.rng = np.random.default_rng(setting.seed)
        self._separator = RotatingSeparator(site.frequency_Hz, setting.times_s(), setting.noise_T)
        self.sigma_T = self._separator.sigma_T

    def measure(
        self, position_m: FloatArray, rotation: FloatArray | None = None, drive: FloatArray | None = None
    ) -> FloatArray:
        """Return separated fields, shape (e, n, 2, 3), at e poses; without a rotation the sensor is not turned."""
        return self._separator.separate(self.samples(position_m, rotation, drive)).field_T

    def samples(
        self, position_m: FloatArray, rotation: FloatArray | None = None, drive: FloatArray | None = None
    ) -> FloatArray:
        """Return samples, shape (e, t, 3), at e poses; as `measure`."""
        if rotation is None:
            rotation = np.tile(np.eye(3), (len(position_m), 1, 1))
        return self.world.samples(position_m, rotation, self.setting.times_s(), self.setting.noise_T, self.rng, drive)

    def grid(self) -> FloatArray:
        """Return the places of the fingerprints, shape (p, 3)."""
        low, high = np.array(self.setting.low_m), np.array(self.setting.high_m)
        steps = [np.arange(a, b + 1e-9, FINGERPRINT_SPACING_M) for a, b in zip(low, high, strict=True)]
        grid = self._clear(np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3))
        if len(grid) < NEIGHBOURS:
            raise UserError(
                f"the box has room for {len(grid)} fingerprints every {FINGERPRINT_SPACING_M:g} m and {NEAREST_M:g} m "
                f"from the beacons; the algorithms need at least {NEIGHBOURS}: give a larger box"
            )
        return grid

    def survey(self) -> FingerprintMap:
        """Measure the fingerprints on their grid."""
        grid = self.grid()
        names = tuple(beacon.id for beacon in self.site.beacons)
        return FingerprintMap(names, grid, rms_strength(self.measure(grid)))

    def targets(self, count: int) -> FloatArray:
        """Return random places in the box, shape (count, 3)."""
        low, high = np.array(self.setting.low_m), np.array(self.setting.high_m)
        found = np.empty((0, 3))
        for _ in range(MOST_TRIES):
            found = np.concatenate([found, self._clear(self.rng.uniform(low, high, (4 * count, 3)))])
            if len(found) >= count:
                return found[:count]
        raise UserError(f"the box has no room for targets {NEAREST_M:g} m from the beacons: give a larger box")

    def tilted(self, count: int, largest_deg: float) -> FloatArray:
        """Return random attitudes, shape (count, 3, 3): any yaw, then a tilt about any horizontal axis."""
        yaw, azimuth = self.rng.uniform(0.0, 2.0 * np.pi, (2, count))
        tilt = np.radians(self.rng.uniform(0.0, largest_deg, count))
        axis = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], axis=1)
        turned = Rotation.from_rotvec(tilt[:, None] * axis) * Rotation.from_euler("z", yaw[:, None])
        return np.asarray(turned.as_matrix())

    def _clear(self, position_m: FloatArray) -> FloatArray:
        distance = np.linalg.norm(position_m[:, None] - self.site.position_m, axis=2)
        return np.asarray(position_m[(distance >= NEAREST_M).all(axis=1)])

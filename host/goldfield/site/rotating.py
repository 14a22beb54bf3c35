"""The site file of dual-axis (rotating-field) beacons: where they stand, how their coils lie, how fast they turn."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from goldfield.files.toml_table import Table, read_table
from goldfield.site import Beacon
from goldfield.site.constants import MU_0
from goldfield.types import FloatArray

LARGEST_ALONG = 0.02
"""Largest accepted dot product of the two axes: about 1 degree from a right angle."""


@dataclass(frozen=True, eq=False)
class DualAxisBeacon:
    """Two equal circular coils around one centre, driven with cosine and sine.

    Attributes
    ----------
    id : str
    position_m : ndarray, shape (3,)
    x_axis, y_axis : ndarray, shape (3,)
        Unit vectors at right angles: the normals of the coils with the cosine and with the sine.
    turns, radius_m : float
        Turns and radius of each coil.
    current_A : float
        Amplitude.
    frequency_Hz : float
    """

    id: str
    position_m: FloatArray
    x_axis: FloatArray
    y_axis: FloatArray
    turns: float
    radius_m: float
    current_A: float
    frequency_Hz: float

    @property
    def strength_T_m3(self) -> float:
        """Constant k: mu0/4 pi times the moment of one coil."""
        return float(MU_0 / 4.0 * self.turns * self.current_A * self.radius_m**2)

    @property
    def frame(self) -> FloatArray:
        """Rotation from the beacon's frame to the site's, shape (3, 3): its columns are the axes."""
        return np.stack([self.x_axis, self.y_axis, np.cross(self.x_axis, self.y_axis)], axis=1)

    def coils(self) -> tuple[Beacon, Beacon]:
        """Return the two coils as single beacons: what locates those then locates these."""
        x, y = (
            Beacon(f"{self.id}.{name}", self.position_m, axis, self.turns, self.radius_m, None, self.current_A, 0)
            for name, axis in (("x", self.x_axis), ("y", self.y_axis))
        )
        return x, y


@dataclass(frozen=True, eq=False)
class RotatingSite:
    """Dual-axis beacons and the noise of the sensor.

    The sensor is on the z side of the beacons' planes (z = x cross y): one beacon makes the same field at r and -r.

    Attributes
    ----------
    noise_T : float
        Standard deviation of one sample on one axis.
    beacons : tuple of DualAxisBeacon
        Ids and frequencies are unique.
    """

    noise_T: float
    beacons: tuple[DualAxisBeacon, ...]

    @property
    def position_m(self) -> FloatArray:
        """Places of the beacons, shape (n, 3)."""
        return np.array([beacon.position_m for beacon in self.beacons])

    @property
    def frequency_Hz(self) -> tuple[float, ...]:
        """Frequencies of the beacons."""
        return tuple(beacon.frequency_Hz for beacon in self.beacons)

    @property
    def strength_T_m3(self) -> FloatArray:
        """Values of k of the beacons, shape (n,)."""
        return np.array([beacon.strength_T_m3 for beacon in self.beacons])

    @property
    def frame(self) -> FloatArray:
        """Rotations from the beacons' frames to the site's, shape (n, 3, 3)."""
        return np.array([beacon.frame for beacon in self.beacons])

    @property
    def up(self) -> FloatArray:
        """Mean direction of the beacons' z, shape (3,): the side where the sensor is."""
        total = self.frame[:, :, 2].sum(axis=0)
        return np.asarray(total / np.linalg.norm(total))

    def first(self, count: int) -> RotatingSite:
        """Return the site with only the first beacons."""
        return RotatingSite(self.noise_T, self.beacons[:count])


def load(path: str | Path) -> RotatingSite:
    """Read a site file of dual-axis beacons (TOML).

    ``[sensor]`` has ``noise_T``; each ``[[beacon]]`` has ``id, position_m, turns, radius_m, current_A, frequency_Hz``
    and may have ``x_axis`` and ``y_axis`` (default: the site's x and y; made exactly orthogonal).

    Raises
    ------
    UserError
        If anything is wrong; the sentence names file, line, table and key.
    """
    path = Path(path)
    document = read_table(path, "site file of rotating beacons")
    document.allow("sensor", "beacon")
    sensor = document.table("sensor")
    sensor.allow("noise_T")
    noise = sensor.positive("noise_T")
    beacons: list[DualAxisBeacon] = []
    for table in document.tables("beacon"):
        beacon = _beacon(table)
        for other in beacons:
            if other.id == beacon.id:
                raise table.error("id", f'is "{beacon.id}", as of another beacon: ids must differ')
            if other.frequency_Hz == beacon.frequency_Hz:
                raise table.error("frequency_Hz", f'is {beacon.frequency_Hz:g}, as of "{other.id}": they must differ')
        beacons.append(beacon)
    site = RotatingSite(noise, tuple(beacons))
    for beacon, table in zip(beacons, document.tables("beacon"), strict=True):
        if not beacon.frame[:, 2] @ site.frame[:, :, 2].sum(axis=0) > 0.0:
            raise table.error(
                "y_axis",
                "with x_axis puts the beacon's z (x cross y) away from the others': the sensor is on the z side of all",
            )
    return site


def is_of_boards(path: str | Path) -> bool:
    """Tell whether a file is a site file of boards (`goldfield.site`).

    Raises
    ------
    UserError
        If it cannot be read or is no TOML.
    """
    return "site" in read_table(Path(path), "site file")


def _beacon(table: Table) -> DualAxisBeacon:
    table.allow("id", "position_m", "x_axis", "y_axis", "turns", "radius_m", "current_A", "frequency_Hz")
    x = table.direction("x_axis") if "x_axis" in table else np.array([1.0, 0.0, 0.0])
    y = table.direction("y_axis") if "y_axis" in table else np.array([0.0, 1.0, 0.0])
    upright = crossed(x, y)
    if upright is None:
        raise table.error("y_axis", "is not at right angles to x_axis (more than 1 degree off): the coils must cross")
    return DualAxisBeacon(
        id=table.label("id"),
        position_m=table.vector("position_m"),
        x_axis=x,
        y_axis=upright,
        turns=table.positive("turns"),
        radius_m=table.positive("radius_m"),
        current_A=table.positive("current_A"),
        frequency_Hz=table.positive("frequency_Hz"),
    )


def crossed(x: FloatArray, y: FloatArray) -> FloatArray | None:
    """Return the unit vector y made exactly orthogonal to x; None if it is more than about 1 degree off."""
    along = float(x @ y)
    if abs(along) > LARGEST_ALONG:
        return None
    rest = y - along * x
    return np.asarray(rest / np.linalg.norm(rest))

"""Dual-axis beacons in a site file of boards: pairs of beacons at one place, one with the cosine, one with the sine.

A site with ``access = "fdma"`` names the coils of a dual-axis beacon ``m1.cos`` and ``m1.sin``. To everything that
separates and locates they are two beacons like others; this puts them together for the methods that take a beacon as a
whole (the experiments of ``goldfield paper zheng``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import UserError
from goldfield.site import Beacon, Site
from goldfield.site.rotating import DualAxisBeacon, RotatingSite, crossed
from goldfield.types import FloatArray

COSINE, SINE = ".cos", ".sin"

LEAST_TOWARDS = 0.5
"""Cosine of the angle between a half-space's normal and the coils' z, from which on it tells the side: 60 degrees."""


@dataclass(frozen=True, eq=False)
class DualAxisSite:
    """A site of boards with its beacons as pairs.

    Attributes
    ----------
    site : Site
        The site as its file has it.
    rotating : RotatingSite
        The pairs, in the order of their cosines; the z = x cross y of each points to the sensor's side.
    rows : ndarray of int, shape (n, 2)
        Places, among the site's beacons, of the coils along x and y. Where the sensor is on the other side of cosine
        cross sine, the sine's coil is x: the field of a unit current in each coil is the same whichever comes first.
    """

    site: Site
    rotating: RotatingSite
    rows: NDArray[np.intp]

    def first(self, count: int) -> DualAxisSite:
        """Return this with only the first pairs; the site keeps all, since their fields are in the samples."""
        return DualAxisSite(self.site, self.rotating.first(count), self.rows[:count])


def of_site(site: Site) -> DualAxisSite:
    """Put the beacons of a site together.

    Raises
    ------
    UserError
        If a beacon has no partner, or the two are not the crossed equal coils of one dual-axis beacon.
    """
    if site.access != "fdma":
        raise UserError(
            f'the site "{site.name}" tells beacons apart by {site.access}: dual-axis beacons need access = "fdma"'
        )
    row_of = {beacon.id: row for row, beacon in enumerate(site.beacons)}
    beacons, rows = [], []
    for beacon in site.beacons:
        name = beacon.id.removesuffix(COSINE).removesuffix(SINE)
        first, second = (row_of.get(name + suffix) for suffix in (COSINE, SINE))
        if name == beacon.id or first is None or second is None:
            raise UserError(
                f'beacon "{beacon.id}" of the site "{site.name}" is no half of a dual-axis beacon: name the two coils '
                f'"{name}{COSINE}" and "{name}{SINE}", or use "goldfield locate", which takes any beacons'
            )
        if beacon.id.endswith(COSINE):
            pair, order = _oriented(site, name, first, second)
            beacons.append(pair)
            rows.append(order)
    rotating = RotatingSite(site.sensor.noise_T, tuple(beacons))
    for pair in beacons:
        if pair.frame[:, 2] @ rotating.up <= 0.0:
            raise UserError(
                f'the coils of "{pair.id}" turn against the others of the site "{site.name}": the sensor is taken to '
                "be on the side of cosine cross sine of all; add half_space, or exchange the axes"
            )
    return DualAxisSite(site, rotating, np.array(rows, dtype=np.intp))


def _oriented(site: Site, name: str, first: int, second: int) -> tuple[DualAxisBeacon, tuple[int, int]]:
    """Return a pair and its rows, the coil first of which the other is a quarter turn ahead about the sensor's side."""
    x, y = _axis(site.beacons[first]), _axis(site.beacons[second])
    _check_equal(name, site.beacons[first], site.beacons[second])
    if site.half_space is not None:
        towards = float(np.cross(x, y) @ site.half_space.normal)
        if abs(towards) < LEAST_TOWARDS:
            raise UserError(
                f'half_space of the site "{site.name}" does not tell on which side of the coils of "{name}" the sensor '
                'is (its normal is more than 60 degrees off their z): leave it out, or use "goldfield locate"'
            )
        if towards < 0.0:
            x, y, first, second = y, x, second, first
    upright = crossed(x, y)
    if upright is None:
        raise UserError(f'the axes of "{name}{COSINE}" and "{name}{SINE}" are more than 1 degree off a right angle')
    beacon, period_s = site.beacons[first], site.cycle_s / (site.beacons[first].drive.periods or 1)
    assert beacon.radius_m is not None
    pair = DualAxisBeacon(
        name, beacon.position_m, x, upright, beacon.turns, beacon.radius_m, abs(beacon.current_A), 1.0 / period_s
    )
    return pair, (first, second)


def _axis(beacon: Beacon) -> FloatArray:
    return np.asarray(np.copysign(1.0, beacon.current_A) * beacon.axis)


def _check_equal(name: str, cosine: Beacon, sine: Beacon) -> None:
    if (cosine.drive.wave, sine.drive.wave) != ("cosine", "sine"):
        raise UserError(f'the waves of "{cosine.id}" and "{sine.id}" must be "cosine" and "sine"')
    for beacon in (cosine, sine):
        if beacon.radius_m is None:
            raise UserError(
                f'the coil of "{beacon.id}" is given by points_m: the algorithms for dual-axis beacons need circles of '
                'radius_m; "goldfield locate" takes any coils'
            )
    same = {
        "frequency_Hz": cosine.drive.periods == sine.drive.periods,
        "position_m": np.array_equal(cosine.position_m, sine.position_m),
        "turns": cosine.turns == sine.turns,
        "radius_m": cosine.radius_m == sine.radius_m,
        "current_A": abs(cosine.current_A) == abs(sine.current_A),
    }
    for key, equal in same.items():
        if not equal:
            raise UserError(
                f'{key} of "{cosine.id}" and "{sine.id}" differ: the coils of "{name}" must be equal and in one place; '
                '"goldfield locate" takes any coils'
            )

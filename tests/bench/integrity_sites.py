"""Sites and places for the integrity figures; every site reaches the locator through a site file.

A site file says what errors its survey and sensor may have (`Errors`). Where the reader does not know these keys, a
file without errors is written without them; others raise `KeysUnknown`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import UserError
from goldfield.site import Beacon, Site, load
from tests.bench.locate_trials import CHIPS, loop_beacon, prigge_cube, site_of

FloatArray = NDArray[np.float64]

HALL_M = np.array([10.0, 10.0, 3.5])
WIRE_M = 0.01
"""A sensor is never nearer to a coil's wire than this."""
POSES_A_HALL = 25


@dataclass(frozen=True)
class Errors:
    """Standard deviations of what a site file tells.

    Attributes
    ----------
    position_m, axis_rad, current : float
        Each coordinate of each coil, each of the two turns of its axis, and the relative current.
    gain, sensor_axis_rad : float
        Relative gain of each of the sensor's axes, and each of the two turns of each of its axes.
    """

    position_m: float = 0.0
    axis_rad: float = 0.0
    current: float = 0.0
    gain: float = 0.0
    sensor_axis_rad: float = 0.0

    def times(self, factor: float) -> Errors:
        return Errors(
            *(factor * v for v in (self.position_m, self.axis_rad, self.current, self.gain, self.sensor_axis_rad))
        )


EXACT = Errors()


class KeysUnknown(Exception):
    """The site file's reader does not know the keys of the errors."""


def text_of(site: Site, errors: Errors | None) -> str:
    """Return the site file of a site of circular coils; no errors: the file says nothing about them."""

    def row(values: FloatArray) -> str:
        return "[" + ", ".join(repr(float(value)) for value in values) + "]"

    lines = ["[site]", f'name = "{site.name}"', f"chip_period_s = {site.chip_period_s!r}", f"degree = {site.degree}"]
    if site.half_space is not None:
        plane = f"{{point = {row(site.half_space.point_m)}, normal = {row(site.half_space.normal)}}}"
        lines.append(f"half_space = {plane}")
    lines += ["", "[sensor]", f"noise_T = {site.sensor.noise_T!r}"]
    if errors is not None:
        lines += [f"gain_sd = {errors.gain!r}", f"axis_sd_rad = {errors.sensor_axis_rad!r}"]
        lines += ["", "[survey]", f"position_sd_m = {errors.position_m!r}", f"axis_sd_rad = {errors.axis_rad!r}"]
        lines += [f"current_sd = {errors.current!r}"]
    for beacon in site.beacons:
        lines += ["", "[[beacon]]", f'id = "{beacon.id}"', f"position_m = {row(beacon.position_m)}"]
        lines += [f"axis = {row(beacon.axis)}", f"turns = {beacon.turns!r}", f"radius_m = {beacon.radius_m!r}"]
        lines += [f"current_A = {float(beacon.current_A)!r}", f"code = {beacon.code}"]
    return "\n".join(lines) + "\n"


def told(site: Site, errors: Errors | None = EXACT) -> Site:
    """Return a site as the host reads it from its file.

    Raises
    ------
    KeysUnknown
        The file tells errors and the reader does not know their keys.
    """
    with tempfile.TemporaryDirectory(prefix="goldfield-integrity-") as folder:
        path = Path(folder) / "site.toml"
        path.write_text(text_of(site, errors), encoding="utf-8")
        try:
            return load(path)
        except UserError as error:
            if "survey" not in str(error) and "_sd" not in str(error):
                raise
            if errors != EXACT:
                raise KeysUnknown(str(error)) from error
        path.write_text(text_of(site, None), encoding="utf-8")
        return load(path)


def sigma_of(site: Site) -> float:
    """Return the standard deviation of a separated component: that of a sample over the root of the chips."""
    return float(site.sensor.noise_T / np.sqrt(CHIPS))


def cube(noise_T: float) -> Site:
    """Return Prigge and How's eight coils."""
    return prigge_cube(noise_T)


def hall(rng: np.random.Generator, beacons: int, noise_T: float = 2e-8) -> Site:
    """Return a hall of coils anywhere in it, with any axes, turns, radii and currents of either sign."""
    return site_of(
        [
            replace(
                loop_beacon(
                    index,
                    HALL_M * rng.uniform(size=3),
                    rng.normal(size=3),
                    turns=float(rng.integers(10, 200)),
                    radius=rng.uniform(0.1, 0.5),
                    current=rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 10.0),
                ),
                code=3 + 7 * index,
            )
            for index in range(beacons)
        ],
        noise_T=noise_T,
    )


def wire_distance(beacon: Beacon, point_m: FloatArray) -> FloatArray:
    """Return the distance of points, shape (e, 3), from the wire of a circular coil, m."""
    offset = point_m - beacon.position_m
    along = offset @ beacon.axis
    across = np.linalg.norm(offset - along[:, None] * beacon.axis, axis=1)
    return np.hypot(across - beacon.radius_m, along)


def places(rng: np.random.Generator, site: Site, count: int, near: bool) -> FloatArray:
    """Return places in a hall: uniform in it, or uniform within a radius of a coil's centre, off the wires."""
    found = np.empty((0, 3))
    while len(found) < count:
        if near:
            which = rng.integers(len(site.beacons), size=count)
            direction = rng.normal(size=(count, 3))
            direction /= np.linalg.norm(direction, axis=1)[:, None]
            reach = np.array([site.beacons[i].radius_m for i in which]) * np.cbrt(rng.uniform(size=count))
            point = np.array([site.beacons[i].position_m for i in which]) + reach[:, None] * direction
        else:
            point = HALL_M * rng.uniform(size=(count, 3))
        clear = np.all([wire_distance(beacon, point) > WIRE_M for beacon in site.beacons], axis=0)
        found = np.concatenate([found, point[clear]])
    return found[:count]


def halls(
    rng: np.random.Generator, poses: int, beacons: int, near: bool = False, noise_T: float = 2e-8
) -> Iterator[tuple[Site, FloatArray]]:
    """Yield halls and the places in each, `POSES_A_HALL` of them, until there are as many poses as asked for."""
    for first in range(0, poses, POSES_A_HALL):
        site = hall(rng, beacons, noise_T)
        yield site, places(rng, site, min(POSES_A_HALL, poses - first), near)

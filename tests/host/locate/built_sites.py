"""Sites as they are built: each pose on a site of its own, off from what the file says; fields by magpylib."""

from __future__ import annotations

from dataclasses import replace

import magpylib
import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.site import HalfSpace, SensorSite, Survey
from tests.bench import locate_trials as bench

DECLARED = Survey(0.01, np.radians(1.0), 0.01)
DEFAULT = Survey(0.003, 0.005, 0.003)


def declared(site, survey=DECLARED, gain_sd=0.0, axis_sd_rad=0.0):
    """The same site with errors declared for all beacons and the sensor."""
    beacons = tuple(replace(beacon, survey=survey) for beacon in site.beacons)
    return replace(site, beacons=beacons, sensor=SensorSite(site.sensor.noise_T, gain_sd, axis_sd_rad))


def mixed_cube(noise_T=2e-7):
    """Coils at the corners of 2.13 x 2.13 x 1.78 m that point along x, y, z and askew."""
    axes = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (1, -1, 0), (0, 1, -1), (-1, 0, 1), (1, 1, -1)]
    cube = bench.prigge_cube(noise_T)
    beacons = [bench.loop_beacon(i, b.position_m, axes[i]) for i, b in enumerate(cube.beacons)]
    return bench.site_of(beacons, noise_T=noise_T)


def hall(count, noise_T=2e-7, size=(10.0, 10.0, 4.0)):
    """Coils on the walls and the ceiling of a hall of 10 x 10 x 4 m, with mixed axes."""
    rng = np.random.default_rng(1)
    spots = [(0, 0, 3), (1, 1, 3.5), (0, 1, 0.5), (1, 0, 1), (0.5, 0, 4), (0, 0.5, 2), (0.5, 1, 0.2), (1, 0.5, 2.5)]
    beacons = [
        bench.loop_beacon(i, np.array([x * size[0], y * size[1], z]), rng.normal(size=3), turns=60.0, radius=0.3)
        for i, (x, y, z) in enumerate(spots[:count])
    ]
    return bench.site_of(beacons, HalfSpace(np.zeros(3), np.array([0.0, 0.0, 1.0])), noise_T)


def inside(site, rng, count):
    """Positions in the box of the coils, 10 % away from its faces."""
    places = np.array([beacon.position_m for beacon in site.beacons])
    low, high = places.min(axis=0), places.max(axis=0)
    return low + (high - low) * rng.uniform(0.1, 0.9, size=(count, 3))


def fields_of_coils(place, axis, radius, current, point):
    """Fields of circular coils, each at its own point, shape (m, 3)."""
    z = np.broadcast_to([0.0, 0.0, 1.0], axis.shape)
    across = np.cross(z, axis)
    length = np.linalg.norm(across, axis=1)
    angle = np.arctan2(length, axis[:, 2])
    turn = Rotation.from_rotvec(across / np.maximum(length, 1e-300)[:, None] * angle[:, None])
    local = turn.inv().apply(point - place)
    return turn.apply(magpylib.func.circle_field("B", local, 2 * radius, current))


def measured(site, position, rng, real=None, sensor=None):
    """What the sensor measures, on a site that is built with real errors (`Survey`) for every pose anew.

    ``sensor`` has the real deviations of its gains and axes.
    """
    count, n = len(position), len(site.beacons)
    of = lambda values: np.repeat(np.array(values)[None], count, axis=0)  # noqa: E731
    place, axis = of([b.position_m for b in site.beacons]), of([b.axis for b in site.beacons])
    current = of([b.turns * b.current_A for b in site.beacons])
    radius = of([b.radius_m for b in site.beacons])
    if real is not None:
        place = place + real.position_sd_m * rng.normal(size=place.shape)
        turn = Rotation.from_rotvec(real.axis_sd_rad * rng.normal(size=(count * n, 3)))
        axis = turn.apply(axis.reshape(-1, 3)).reshape(axis.shape)
        current = current * (1.0 + real.current_sd * rng.normal(size=current.shape))
    flat = [np.reshape(values, (count * n, *values.shape[2:])) for values in (place, axis, radius, current)]
    truth = fields_of_coils(*flat, np.repeat(position, n, axis=0)).reshape(count, n, 3)
    rotation = Rotation.random(count, rng=rng).as_matrix()
    field = truth @ rotation
    if sensor is not None:
        gain, lean = sensor
        matrix = np.eye(3) + np.where(np.eye(3) > 0, gain, lean) * rng.normal(size=(count, 3, 3))
        field = field @ matrix.swapaxes(1, 2)
    sigma = site.sensor.noise_T / np.sqrt(bench.CHIPS)
    field = field + sigma * rng.normal(size=field.shape)
    return bench.Trials(position, rotation, field, np.full((count, n), sigma))

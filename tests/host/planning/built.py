"""Sites for the tests of planning, and the true model of their measurements, by magpylib alone."""

from __future__ import annotations

from dataclasses import replace

import magpylib
import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.site import Beacon, HalfSpace, SensorSite, Site
from goldfield.site.model import Survey

SURVEY = Survey(position_sd_m=0.003, axis_sd_rad=0.005, current_sd=0.003)
SENSOR = SensorSite(2e-7, gain_sd=0.003, axis_sd_rad=0.005)


def beacon(index, position, axis=(0.0, 0.0, 1.0), current=10.0, survey=SURVEY):
    axis = np.asarray(axis, dtype=float)
    place = np.asarray(position, dtype=float)
    return Beacon(f"b{index}", place, axis / np.linalg.norm(axis), 19.0, 0.149, None, current, index + 2, survey=survey)


def site_of(beacons, sensor=SENSOR, half_space=None):
    return Site("planned", 97.75e-6, 10, half_space, sensor, tuple(beacons))


def cube(**options):
    """Return Prigge and How's cube: eight coils at the corners of 2.13 x 2.13 x 1.78 m, all pointing up."""
    corners = [(x, y, z) for z in (0.0, 1.78) for x in (0.0, 2.13) for y in (0.0, 2.13)]
    return site_of([beacon(i, corner) for i, corner in enumerate(corners)], **options)


def ceiling(nx, ny, spacing=3.0, height=3.0, side=-1.0, noise_T=2e-8):
    """Return a ceiling lattice; the sensor is below (-1), above (1) or on either side (0)."""
    beacons = [beacon(i * ny + j, (i * spacing, j * spacing, height)) for i in range(nx) for j in range(ny)]
    plane = HalfSpace(np.array([0.0, 0.0, height]), np.array([0.0, 0.0, side])) if side else None
    return site_of(beacons, replace(SENSOR, noise_T=noise_T), plane)


def true_components(site, position, rotation):
    """Return the fields of all beacons in the sensor's frame, shape (3n,), by magpylib."""
    coils = []
    for one in site.beacons:
        turn = Rotation.align_vectors(one.axis[None], [[0.0, 0.0, 1.0]])[0]
        coils.append(
            magpylib.current.Circle(
                diameter=2 * one.radius_m,
                current=one.turns * one.current_A,
                position=one.position_m,
                orientation=turn,
            )
        )
    return (magpylib.getB(coils, position, squeeze=False)[:, 0, 0, 0] @ rotation).ravel()

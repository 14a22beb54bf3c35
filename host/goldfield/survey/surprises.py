"""What was found far from what the site file says, many of its standard deviations: named, with what to check.

The site file counts as a measurement. A parameter far away from it is one that the file has wrong, or of which it
claims to know too much; or it takes the blame for something that is not modelled.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import counted
from goldfield.survey.outcome import Solution
from goldfield.survey.parameters import BEACON, LEVER, OFFSET, SENSOR
from goldfield.types import FloatArray

FAR = 5.0
"""Standard deviations that are far: chance alone makes one of a million parameters so."""
NAMED = 3
"""Beacons of a kind that are named, the worst first."""
TILTS = ("x and y", "x and z", "y and z")


def surprises(solution: Solution) -> Iterator[str]:
    """Name what is far from the site file, kind by kind."""
    away = np.abs(solution.problem.prior.residual(solution.state))
    count = len(solution.state.axis)
    beacon, sensor = away[: BEACON * count].reshape(count, BEACON), away[BEACON * count :][:SENSOR]
    kinds = (
        ("place", np.linalg.norm(beacon[:, :3], axis=1), "position_m", "position_sd_m"),
        ("axis", np.linalg.norm(beacon[:, 3:5], axis=1), "axis and how the coil is mounted", "axis_sd_rad"),
        ("current", beacon[:, 5], "current_A, turns, radius_m and its driver", "current_sd"),
    )
    for what, size, check, key in kinds:
        far = np.flatnonzero(size > FAR)
        if len(far):
            yield _of_beacons(solution, what, size, far, check, key)
    for k, axis in enumerate("xyz"):
        if sensor[k] > FAR:
            yield (
                f"the gain of the sensor's {axis} axis is {sensor[k]:.2g} of its standard deviations from what the "
                "site file says: check the sensor's calibration, or allow for more in gain_sd"
            )
    for k, axes in enumerate(TILTS):
        if sensor[3 + k] > FAR:
            yield (
                f"the angle between the sensor's axes {axes} is {sensor[3 + k]:.2g} of its standard deviations from "
                "what the site file says: check axes of [sensor], or allow for more in its axis_sd_rad"
            )
    if sensor[OFFSET].max() > FAR:
        yield "the offset in the sensor's frame is far beyond 1 uT: check the sensor's zero"
    if sensor[LEVER].max() > FAR:
        yield "an axis of the sensor reads 15 cm or more from where lever_m says: check lever_m and the known points"


def _of_beacons(solution: Solution, what: str, size: FloatArray, far: NDArray[np.intp], check: str, key: str) -> str:
    """Name the beacons whose places, axes or currents are far off, and what to check."""
    order = far[np.argsort(-size[far])]
    names = [solution.problem.site.beacons[row].id for row in order[:NAMED]]
    more = f" and {counted(len(far) - NAMED, 'more beacons')}" if len(far) > NAMED else ""
    of = (
        ", ".join(names[:-1]) + (" and " if len(names) > 1 and not more else ", " if len(names) > 1 else "") + names[-1]
    )
    reach = f"{size[order[0]]:.2g} of the standard deviations that {key} says"
    if 2 * len(far) > len(size) > 2 and what != "current":
        check = f"the known points and that they are in the site file's frame, {check}"
    return f"the {what} of {of}{more} is up to {reach} from the site file: check {check}, or allow for more in {key}"

"""The keys of a site file that tell of metal: the table ``[metal]``, and ``metal_T_A`` of each ``[[beacon]]``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from goldfield.errors import counted
from goldfield.files.toml_table import Table
from goldfield.site.metal import MOST_BODIES, MOST_DEGREE, BeaconMetal, Metal, harmonic_count, symmetric
from goldfield.site.model import Beacon

KEYS = ("degree", "centre_m", "radius_m", "sd_T_A", "walked_m", "body")
BEACON_KEY = "metal_T_A"
LEAST_GAP_M = 1e-3
"""Least distance of a body from the centre of a coil and from its wire: at these themselves its answer has no limit."""
SMALLEST_ROOM = 1e-3
"""Least extent of the corners of ``walked_m`` off any plane, over their largest extent."""


def read_metal(table: Table) -> Metal:
    """Read the table ``[metal]``; UserError, with file, line and key, if it is wrong."""
    table.allow(*KEYS)
    degree = table.integer("degree") if "degree" in table else 0
    if not 0 <= degree <= MOST_DEGREE:
        raise table.error("degree", f"is {degree}: it must be 0 to {MOST_DEGREE}")
    sd_T_A = table.number("sd_T_A") if "sd_T_A" in table else 0.0
    if sd_T_A < 0.0:
        raise table.error("sd_T_A", f"is {sd_T_A:g}: a standard deviation is 0 or more")
    bodies = table.tables("body") if "body" in table else []
    if len(bodies) > MOST_BODIES:
        raise table.error("body", f"stands {len(bodies)} times: at most {MOST_BODIES} bodies are allowed")
    walked = table.vectors("walked_m") if "walked_m" in table else np.empty((0, 3))
    if len(walked):
        extent = np.linalg.svd(walked - walked.mean(axis=0), compute_uv=False)
        if len(extent) < 3 or len(walked) < 4 or extent[2] <= SMALLEST_ROOM * extent[0]:
            raise table.error("walked_m", "enclose no room: give at least four corners that are not in one plane")
    return Metal(
        centre_m=table.vector("centre_m") if degree else np.zeros(3),
        radius_m=table.positive("radius_m") if degree else 1.0,
        degree=degree,
        body_m=np.array([body.vector("position_m") for body in bodies]).reshape(-1, 3),
        polarisability_A_m2_T=np.array([_polarisability(body) for body in bodies]).reshape(-1, 3, 3),
        sd_T_A=sd_T_A,
        walked_m=walked,
    )


def check_bodies(table: Table, metal: Metal, beacons: Sequence[Beacon]) -> None:
    """Refuse a body in the centre of a coil or on its wire, where the field that it would answer has no limit."""
    for body, place in zip(table.tables("body") if len(metal.body_m) else [], metal.body_m, strict=True):
        for beacon in beacons:
            where = "centre" if np.linalg.norm(place - beacon.position_m) < LEAST_GAP_M else "wire"
            if where == "centre" or _distance_to_wire_m(beacon, place) < LEAST_GAP_M:
                raise body.error(
                    "position_m", f"is the {where} of a beacon's coil, where no metal can be: move the body"
                )


def _distance_to_wire_m(beacon: Beacon, place_m: np.ndarray) -> float:
    """Return the distance of a place from a coil's circle, or from the segments of its wire."""
    if beacon.points_m is None:
        assert beacon.radius_m is not None
        offset = place_m - beacon.position_m
        height = float(offset @ beacon.axis)
        return float(np.hypot(np.linalg.norm(offset - height * beacon.axis) - beacon.radius_m, height))
    start = beacon.points_m
    along = np.roll(start, -1, axis=0) - start  # the wire is closed
    length2 = np.maximum((along * along).sum(axis=1), np.finfo(float).tiny)
    part = np.clip(((place_m - start) * along).sum(axis=1) / length2, 0.0, 1.0)
    return float(np.linalg.norm(place_m - start - part[:, None] * along, axis=1).min())


def _polarisability(body: Table) -> np.ndarray:
    body.allow("position_m", "polarisability_A_m2_T")
    values = body.numbers("polarisability_A_m2_T")
    if len(values) != 6:
        raise body.error(
            "polarisability_A_m2_T", f"has {counted(len(values), 'numbers')}: it needs six, xx, yy, zz, xy, xz and yz"
        )
    return np.asarray(symmetric(values[None])[0])


def read_beacon_metal(table: Table, metal: Metal | None) -> BeaconMetal | None:
    """Read what metal adds to a beacon's field; ``metal`` is that of the site."""
    if metal is None:
        if BEACON_KEY in table:
            raise table.error(BEACON_KEY, "needs a table [metal] that says what the coefficients belong to")
        return None
    count = harmonic_count(metal.degree)
    if count == 0 and BEACON_KEY not in table:
        return BeaconMetal(metal, np.empty(0))
    values = table.numbers(BEACON_KEY)
    if len(values) != count:
        raise table.error(
            BEACON_KEY,
            f"has {counted(len(values), 'coefficients')}: [metal] degree = {metal.degree} needs {count} of them",
        )
    return BeaconMetal(metal, values)

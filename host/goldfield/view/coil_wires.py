"""The wires of a site's coils as pictures draw them, and the box that holds them."""

from __future__ import annotations

import math

import numpy as np

from goldfield.site import Site
from goldfield.site.coil_shapes import frame
from goldfield.site.model import Beacon
from goldfield.types import FloatArray

ROUND_POINTS = 48
"""Points that draw a round coil."""
MOST_POINTS = 256
"""Points that draw a wire, of which a survey may have thousands."""
MARGIN = 0.08
"""The box that is shown is larger than the beacons' by this part of its largest side, on each side."""


def wire_of(beacon: Beacon) -> FloatArray:
    """Return a coil's wire in the site's frame, m, shape (n, 3), closed, of as many points as a picture needs."""
    if beacon.points_m is not None:
        every = math.ceil(len(beacon.points_m) / MOST_POINTS)
        return np.concatenate([beacon.points_m[::every], beacon.points_m[-1:]])
    angle = np.linspace(0.0, 2.0 * math.pi, ROUND_POINTS + 1)
    assert beacon.radius_m is not None  # a coil has points or a radius
    flat = beacon.radius_m * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    return np.asarray(beacon.position_m + flat @ frame(beacon.axis, 0.0).T)


def site_box(site: Site) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box that is shown, m, shape (3,) each: it holds every coil."""
    points_m = np.concatenate([wire_of(beacon) for beacon in site.beacons])
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    margin = MARGIN * max(float((high - low).max()), 0.1)
    return low - margin, high + margin

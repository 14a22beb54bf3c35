"""The path of a sensor: field per ampere of each coil in the sensor's frame, as cubics in time for ``path.h``.

The coils are magpylib's: true current loops with all turns at one radius, or the wire as a polyline. Nothing here knows
how the host models a coil.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import magpylib
import numpy as np
from magpylib.core import current_circle_Hfield
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from hil_sim.world.magnet import Magnet
from hil_sim.world.metal import Source
from hil_sim.world.motion import Motion

FloatArray = NDArray[np.float64]

wires: Any = magpylib.current  # magpylib carries no types

TOLERANCE = 1e-5
"""Largest interpolation error of a coil's field relative to its magnitude at the same moment."""
MARGIN = 4.0
"""The error is looked at in the middle of the intervals, where it is largest on a smooth path; the rest is margin."""
FEWEST_KNOTS, MOST_INTERVALS = 9, 16384
ON_WIRE = 1e-12
"""A place nearer than so many radii to a loop's wire is on it, whatever rounding makes of its coordinates."""
FIELDS_AT_ONCE = 16384
"""Positions times coils of one call of magpylib: more do not stay in a processor's cache, fewer spend it on calls."""
NO_FIELD = 1e-12
"""What is smaller counts as that large where errors are relative, T/A or T: no converter sees it."""


class PathError(ValueError):
    """The path cannot be computed; the message is a sentence for the user."""


@dataclass(frozen=True, eq=False)
class CoilGeometry:
    """Where a coil's wire runs, in the site's frame.

    Attributes
    ----------
    turns : float
    radius_m : float or None
        Radius of a circular loop around ``position_m`` with its normal along ``axis``.
    position_m, axis : ndarray, shape (3,)
    points_m : ndarray, shape (n, 3), or None
        The wire as a polyline, taken as listed, in place of a circle.
    """

    turns: float
    radius_m: float | None
    position_m: FloatArray
    axis: FloatArray
    points_m: FloatArray | None = None

    def moved(self, by_m: FloatArray) -> CoilGeometry:
        """Return the coil at another place."""
        points = None if self.points_m is None else self.points_m + by_m
        return replace(self, position_m=self.position_m + by_m, points_m=points)

    def field_per_ampere(self, positions_m: FloatArray) -> FloatArray:
        """Return B of one ampere, shape (n, 3), tesla, site's frame, at positions of shape (n, 3)."""
        if self.points_m is not None:
            wire = wires.Polyline(vertices=self.points_m, current=self.turns)
        else:
            assert self.radius_m is not None
            to_axis = Rotation.align_vectors(self.axis[None, :], np.array([[0.0, 0.0, 1.0]]))[0]
            wire = wires.Circle(
                current=self.turns, diameter=2.0 * self.radius_m, position=self.position_m, orientation=to_axis
            )
        return np.asarray(wire.getB(positions_m), dtype=np.float64).reshape(-1, 3)


def fields_per_ampere(coils: Sequence[Source], positions_m: FloatArray) -> FloatArray:
    """Return what each coil's `field_per_ampere` tells, shape (n, coils, 3), all circular loops in a few calls."""
    fields = np.empty((len(positions_m), len(coils), 3))
    loops: dict[int, CoilGeometry] = {}
    for i, coil in enumerate(coils):
        if isinstance(coil, CoilGeometry) and coil.points_m is None:
            loops[i] = coil
        else:
            fields[:, i] = coil.field_per_ampere(positions_m)
    at_once = max(1, FIELDS_AT_ONCE // len(positions_m))
    for some in (list(loops)[begin : begin + at_once] for begin in range(0, len(loops), at_once)):
        fields[:, some] = _loops_field([loops[i] for i in some], positions_m)
    return fields


def _loops_field(loops: Sequence[CoilGeometry], positions_m: FloatArray) -> FloatArray:
    """Return B of one ampere in each of several circular loops, shape (n, loops, 3), tesla; not finite on a wire.

    magpylib's formula knows loops around the z axis alone, and gives cylindrical components there.
    """
    axis = np.array([loop.axis / np.linalg.norm(loop.axis) for loop in loops])
    away = positions_m[:, None, :] - np.array([loop.position_m for loop in loops])
    along = np.einsum("nci,ci->nc", away, axis)
    across = away - along[..., None] * axis
    radius = np.linalg.norm(across, axis=2)
    turns = np.broadcast_to([loop.turns for loop in loops], radius.shape)
    size = np.broadcast_to([float(loop.radius_m or 0.0) for loop in loops], radius.shape)
    on_wire = np.hypot(radius - size, along) < ON_WIRE * size
    elsewhere = np.where(on_wire, 0.0, radius)  # the formula finds no end on a wire
    radial, _, axial = current_circle_Hfield(size.ravel(), elsewhere.ravel(), along.ravel(), turns.ravel())
    outward = across / np.maximum(radius, np.finfo(float).tiny)[..., None]
    field = radial.reshape(radius.shape)[..., None] * outward + axial.reshape(radius.shape)[..., None] * axis
    field[on_wire] = np.nan
    return np.asarray(magpylib.mu_0 * field)


@dataclass(frozen=True, eq=False)
class Path:
    """Cubics on equal intervals.

    Attributes
    ----------
    start_s, interval_s : float
    coefficients : ndarray, shape (intervals, columns, 4)
        The cubics as ``path.h`` describes them: constant term first, in fractions of an interval.
    """

    start_s: float
    interval_s: float
    coefficients: FloatArray


def columns(coils: Sequence[Source], motion: Motion, times_s: FloatArray, magnets: Sequence[Magnet] = ()) -> FloatArray:
    """Return the columns of ``path.h``, shape (n, 3 coils + 12), at times of shape (n,).

    Raises
    ------
    PathError
        If the sensor runs through a coil's wire.
    """
    positions, rotation = motion.poses(times_s)
    to_sensor = np.swapaxes(rotation.as_matrix(), 1, 2)
    fields = np.einsum("nij,ncj->nci", to_sensor, fields_per_ampere(coils, positions))
    magnetic = np.zeros((len(times_s), 3))
    for magnet in magnets:
        magnetic += np.einsum("nij,nj->ni", to_sensor, magnet.field_T(positions, times_s))
    count = len(times_s)
    result = np.hstack([fields.reshape(count, 3 * len(coils)), to_sensor.reshape(count, 9), magnetic])
    # On a wire magpylib gives zero or what is not finite; a coil alone has no zero of its field anywhere else.
    if not np.all(np.isfinite(result)) or not np.all(np.any(fields, axis=2)):
        raise PathError(
            "the sensor runs through a coil's wire, where the field has no limit: move the path or the coil"
        )
    return result


def _relative_error(spline: CubicSpline[np.float64], truth: FloatArray, times_s: FloatArray) -> float:
    error = np.abs(spline(times_s) - truth).reshape(len(times_s), -1, 3)
    size = np.linalg.norm(truth.reshape(len(times_s), -1, 3), axis=2, keepdims=True)
    return float(np.max(error / np.maximum(size, NO_FIELD)))


def compute(
    coils: Sequence[Source], motion: Motion, start_s: float, stop_s: float, magnets: Sequence[Magnet] = ()
) -> Path:
    """Compute the path between two times, as fine as `TOLERANCE` asks.

    Raises
    ------
    PathError
        If the motion is too fast for any reasonable number of knots, or runs through a wire.
    """
    if motion.still and all(magnet.still for magnet in magnets):
        values = columns(coils, motion, np.array([start_s]), magnets)
        constant = np.zeros((1, values.shape[1], 4))
        constant[0, :, 0] = values[0]
        return Path(start_s, stop_s - start_s, constant)
    intervals = FEWEST_KNOTS - 1
    knots = np.linspace(start_s, stop_s, intervals + 1)
    values = columns(coils, motion, knots, magnets)
    while intervals <= MOST_INTERVALS:
        middles = 0.5 * (knots[1:] + knots[:-1])
        between = columns(coils, motion, middles, magnets)
        spline = CubicSpline(knots, values)
        if _relative_error(spline, between, middles) < TOLERANCE / MARGIN:
            scale = (knots[1] - knots[0]) ** np.arange(4)
            return Path(start_s, float(knots[1] - knots[0]), np.moveaxis(spline.c[::-1], 0, 2) * scale)
        merged = np.empty((2 * intervals + 1, values.shape[1]))
        merged[::2], merged[1::2] = values, between
        values = merged
        intervals *= 2
        knots = np.linspace(start_s, stop_s, intervals + 1)
    raise PathError(f"the motion between {start_s:g} s and {stop_s:g} s is too fast to follow: slow it down")

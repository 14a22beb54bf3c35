"""The images of a pose that some arrangements of coils have.

Coplanar coils that all point across their plane: a reflection through the plane leaves every such coil as it is (a
magnetic moment is an axial vector), so the field at the image point is the field turned by half a turn about the
normal, B(p') = N B(p), N = 2 n n' - I. Coils around one point: B(-r) = B(r). In both cases the image pose gives the
very same measurements, whatever the sensor. Coils that are both have a third image, the one of the one by the other.

What is nearly so has images that nearly fit: with coils that are a hundredth of the sensor's distance apart, the fields
at the point across their middle differ by some per cent, which is less than the noise of many a sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate.fit import Fit
from goldfield.types import FloatArray

FLAT = 0.25
"""Thickness over extent of the beacons, and their extent over the distance to the sensor, below which the image of a
pose is tried as a rival, exact or not."""

EXACT = 1e-6
"""Relative thickness, and tilt of the axes, below which the image is taken as exact."""


@dataclass(frozen=True, eq=False)
class Mirror:
    """A map of poses that changes the measurements little or not at all.

    Attributes
    ----------
    point_m : ndarray, shape (3,)
        Fixed point.
    reflection, turn : ndarray, shape (3, 3)
        What the map does to positions and to attitudes.
    exact : bool
        True if the image of a pose gives the same measurements exactly.
    least_m : float
        Distance from the fixed point from which on the image is worth a trial.
    """

    point_m: FloatArray
    reflection: FloatArray
    turn: FloatArray
    exact: bool
    least_m: float = 0.0

    def concerns(self, position_m: FloatArray) -> NDArray[np.bool_]:
        """Tell which positions, shape (e, 3), are far enough for their image to be tried."""
        return np.asarray(np.linalg.norm(position_m - self.point_m, axis=1) >= self.least_m)

    def image(self, fit: Fit) -> Fit:
        """Images of poses, with the same cost and the reflected information."""
        return Fit(
            self.point_m + (fit.position_m - self.point_m) @ self.reflection.T,
            self.turn @ fit.rotation,
            fit.cost.copy(),
            self.reflected(fit.information),
            fit.converged.copy(),
        )

    def reflected(self, matrix: FloatArray) -> FloatArray:
        """Information or covariance, shape (e, 6, 6), of the images of poses."""
        both = np.zeros((6, 6))
        both[:3, :3], both[3:, 3:] = self.reflection, self.turn
        return np.asarray(both @ matrix @ both.T)


class Reach(NamedTuple):
    """What decides where k mirrors are worth a trial, as arrays.

    Attributes
    ----------
    point_m, reflection : ndarray, shapes (k, 3) and (k, 3, 3)
        Those of `Mirror`.
    least_m2 : ndarray, shape (k,)
        Squares of `Mirror.least_m`.
    """

    point_m: FloatArray
    reflection: FloatArray
    least_m2: FloatArray

    @classmethod
    def of(cls, mirrors: Sequence[Mirror]) -> Reach:
        """Return that of some mirrors."""
        return cls(
            np.array([mirror.point_m for mirror in mirrors]),
            np.array([mirror.reflection for mirror in mirrors]),
            np.square([mirror.least_m for mirror in mirrors]),
        )


def find_mirrors(model: FieldModel, flat: float = FLAT) -> tuple[Mirror, ...]:
    """Return the maps of coils nearly in a plane and pointing across it, of coils around a point, and of both."""
    middle = model.centre_m.mean(axis=0)
    offset = model.centre_m - middle
    plane, centre = _plane(model, middle, offset, flat), _centre(model, middle, offset, flat)
    if plane is None or centre.exact:  # coils that are exactly both have a ring of poses, not images
        return (centre,)
    both = Mirror(middle, -plane.reflection, plane.turn, exact=False, least_m=centre.least_m)
    return plane, centre, both


def _centre(model: FieldModel, middle: FloatArray, offset: FloatArray, flat: float) -> Mirror:
    """Return the map to the other side of the middle of all coils."""
    extent = float(np.linalg.norm(offset, axis=1).max())
    exact = extent <= EXACT * model.reach_m.min() and not len(model.wire_points_m)
    return Mirror(middle, -np.eye(3), np.eye(3), exact, extent / flat)


def _plane(model: FieldModel, middle: FloatArray, offset: FloatArray, flat: float) -> Mirror | None:
    """Return the map through the plane in which all coils nearly lie and across which they point, if there is one.

    Its normal is where the spread of the places, over their extent, less that of the axes is least: of coils on a line,
    which lie in many planes, the axes tell which it is.
    """
    extent = max(float(np.linalg.norm(offset, 2)), np.finfo(float).tiny)  # the largest singular value
    axis = model.moment_A_m2 / np.linalg.norm(model.moment_A_m2, axis=1, keepdims=True)
    scaled = offset / extent
    normal = np.linalg.eigh(scaled.T @ scaled - axis.T @ axis / len(axis))[1][:, 0]
    thickness = float(np.abs(scaled @ normal).max())
    tilt = float(np.sqrt(np.maximum(1.0 - (axis @ normal) ** 2, 0.0)).max())
    if thickness > flat or tilt > flat:
        return None
    wires = float(np.abs((model.wire_points_m - middle) @ normal).max(initial=0.0) / extent)
    across = np.outer(normal, normal)
    exact = max(thickness, tilt, wires) <= EXACT
    return Mirror(middle, np.eye(3) - 2.0 * across, 2.0 * across - np.eye(3), exact)

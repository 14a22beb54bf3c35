"""The exact images of a pose that some arrangements of coils have.

Coplanar coils that all point across their plane: a reflection through the plane leaves every such coil as it is (a
magnetic moment is an axial vector), so the field at the image point is the field turned by half a turn about the
normal, B(p') = N B(p), N = 2 n n' - I. Coils around one point: B(-r) = B(r). In both cases the image pose gives the
very same measurements, whatever the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate.fit import Fit
from goldfield.types import FloatArray

FLAT = 0.25
"""Thickness over extent of the beacons below which the image of a pose is tried as a rival, exact or not."""

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
    """

    point_m: FloatArray
    reflection: FloatArray
    turn: FloatArray
    exact: bool

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


def find_mirror(model: FieldModel) -> Mirror | None:
    """Return the map of coils around one point, or nearly in a plane and pointing across it; None if there is none."""
    middle = model.centre_m.mean(axis=0)
    _, extent, directions = np.linalg.svd(model.centre_m - middle, full_matrices=True)
    if extent[0] <= EXACT * model.reach_m.min():
        return Mirror(middle, -np.eye(3), np.eye(3), exact=not len(model.wire_points_m))
    normal = directions[2]
    axis = model.moment_A_m2 / np.linalg.norm(model.moment_A_m2, axis=1, keepdims=True)
    if extent[1] <= 1e-9 * extent[0]:
        # Beacons on a line lie in many planes: the one that their axes cross, if there is one.
        normal = axis.mean(axis=0) - (axis.mean(axis=0) @ directions[0]) * directions[0]
        normal = normal / max(float(np.linalg.norm(normal)), 1e-300)
    thickness = float(np.abs((model.centre_m - middle) @ normal).max() / extent[0])
    tilt = float(np.sqrt(np.maximum(1.0 - (axis @ normal) ** 2, 0.0)).max())
    if thickness > FLAT or tilt > FLAT:
        return None
    wires = float(np.abs((model.wire_points_m - middle) @ normal).max(initial=0.0) / extent[0])
    exact = max(thickness, tilt, wires) <= EXACT
    across = np.outer(normal, normal)
    return Mirror(middle, np.eye(3) - 2.0 * across, 2.0 * across - np.eye(3), exact)

"""The exact mirror of coplanar coils that all point across their plane.

A reflection through the plane leaves every such coil as it is (a magnetic moment is an axial vector), so the field at
the image point is the field turned by 180 degrees about the normal: B(p') = N B(p), N = 2 n n' - I. The pose (p', N
R) gives the very same measurements, whatever the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate.fit import Fit
from goldfield.poses import FloatArray

FLAT = 0.25
"""Thickness over extent of the beacons below which the image of a pose is tried as a rival, exact or not."""

EXACT = 1e-6
"""Relative thickness, and tilt of the axes, below which the image is taken as exact."""


@dataclass(frozen=True, eq=False)
class Mirror:
    """Plane of nearly coplanar coils.

    Attributes
    ----------
    point_m, normal : ndarray, shape (3,)
    exact : bool
        Whether the image of a pose gives the same measurements exactly.
    """

    point_m: FloatArray
    normal: FloatArray
    exact: bool

    @property
    def turn(self) -> FloatArray:
        """Half a turn about the normal, shape (3, 3)."""
        return np.asarray(2.0 * np.outer(self.normal, self.normal) - np.eye(3))

    def position(self, position_m: FloatArray) -> FloatArray:
        """Images of positions, shape (e, 3)."""
        height = (position_m - self.point_m) @ self.normal
        return np.asarray(position_m - 2.0 * height[:, None] * self.normal)

    def image(self, fit: Fit) -> Fit:
        """Images of poses, with the same cost and the reflected information."""
        reflection = np.eye(3) - 2.0 * np.outer(self.normal, self.normal)
        both = np.zeros((6, 6))
        both[:3, :3], both[3:, 3:] = reflection, self.turn
        return Fit(
            self.position(fit.position_m),
            self.turn @ fit.rotation,
            fit.cost.copy(),
            both @ fit.information @ both.T,
            fit.converged.copy(),
        )


def find_mirror(model: FieldModel) -> Mirror | None:
    """Return the plane of the model's coils if they are nearly coplanar and nearly all point across it, else None."""
    middle = model.centre_m.mean(axis=0)
    _, extent, directions = np.linalg.svd(model.centre_m - middle, full_matrices=True)
    normal = directions[2]
    axis = model.moment_A_m2 / np.linalg.norm(model.moment_A_m2, axis=1, keepdims=True)
    if len(extent) == 3 and extent[1] <= 1e-9 * extent[0]:
        # Beacons on a line lie in many planes: the one that their axes cross, if there is one.
        normal = axis.mean(axis=0) - (axis.mean(axis=0) @ directions[0]) * directions[0]
        normal = normal / max(float(np.linalg.norm(normal)), 1e-300)
    thickness = float(np.abs((model.centre_m - middle) @ normal).max() / extent[0])
    tilt = float(np.sqrt(np.maximum(1.0 - (axis @ normal) ** 2, 0.0)).max())
    if thickness > FLAT or tilt > FLAT:
        return None
    return Mirror(middle, normal, exact=thickness <= EXACT and tilt <= EXACT)

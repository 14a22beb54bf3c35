"""Coils as they really stand, one row an epoch, and a sensor's fields of them: by magpylib, no field model of the host.

What is told to the locator (a site) and what is true (`Coils`, the sensor's matrix) are separate here: a fault is a
difference between the two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from magpylib.func import circle_field
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from goldfield.site import Site
from tests.bench.locate_trials import Trials

FloatArray = NDArray[np.float64]

AT_ONCE = 200_000
"""Loops given to magpylib at once; more would take memory and save nothing."""


@dataclass(frozen=True)
class Coils:
    """True circular coils of e epochs.

    Attributes
    ----------
    position_m, axis : ndarray, shape (e, n, 3)
        Centres and unit normals.
    radius_m, ampere_turns : ndarray, shape (e, n)
        Radii, and turns times current.
    """

    position_m: FloatArray
    axis: FloatArray
    radius_m: FloatArray
    ampere_turns: FloatArray

    @classmethod
    def of(cls, site: Site, count: int) -> Coils:
        """Return the coils exactly as a site tells them, for a number of epochs."""
        one = cls(
            np.array([beacon.position_m for beacon in site.beacons]),
            np.array([beacon.axis for beacon in site.beacons]),
            np.array([beacon.radius_m for beacon in site.beacons], dtype=float),
            np.array([beacon.turns * beacon.current_A for beacon in site.beacons]),
        )
        return cls(
            *(np.repeat(v[None], count, axis=0) for v in (one.position_m, one.axis, one.radius_m, one.ampere_turns))
        )

    def moved(self, step_m: FloatArray) -> Coils:
        """Return the coils shifted by steps, broadcast to shape (e, n, 3), m."""
        return replace(self, position_m=self.position_m + step_m)

    def turned(self, vector_rad: FloatArray) -> Coils:
        """Return the coils turned about their centres by rotation vectors, broadcast to shape (e, n, 3), rad."""
        vectors = np.array(np.broadcast_to(vector_rad, self.axis.shape)).reshape(-1, 3)
        axis = Rotation.from_rotvec(vectors).apply(self.axis.reshape(-1, 3))
        return replace(self, axis=axis.reshape(self.axis.shape))

    def scaled(self, factor: FloatArray | float) -> Coils:
        """Return the coils with their currents multiplied by factors, broadcast to shape (e, n)."""
        return replace(self, ampere_turns=self.ampere_turns * factor)

    def field(self, point_m: FloatArray) -> FloatArray:
        """Return the field of each coil at points, shape (e, 3), tesla in the site's frame, shape (e, n, 3)."""
        count, beacons = self.radius_m.shape
        each = max(AT_ONCE // max(beacons, 1), 1)
        parts = [self._field(point_m, slice(first, first + each)) for first in range(0, count, each)]
        return np.concatenate(parts) if parts else np.empty((0, beacons, 3))

    def _field(self, point_m: FloatArray, some: slice) -> FloatArray:
        shape = self.axis[some].shape
        field = circle_field(
            "B",
            observers=np.repeat(point_m[some], shape[1], axis=0),
            diameters=2.0 * self.radius_m[some].ravel(),
            currents=self.ampere_turns[some].ravel(),
            positions=self.position_m[some].reshape(-1, 3),
            orientations=_from_z(self.axis[some].reshape(-1, 3)),
            squeeze=False,
        )
        return np.asarray(field).reshape(shape)


def _from_z(axis: FloatArray) -> Rotation:
    """Return rotations that take z to unit vectors, shape (k, 3)."""
    quaternion = np.column_stack([-axis[:, 1], axis[:, 0], np.zeros(len(axis)), 1.0 + axis[:, 2]])
    quaternion[1.0 + axis[:, 2] < 1e-12] = [1.0, 0.0, 0.0, 0.0]
    return Rotation.from_quat(quaternion)


def attitudes(rng: np.random.Generator, count: int) -> FloatArray:
    """Return uniform random attitudes R, B_site = R B_sensor, shape (count, 3, 3)."""
    return Rotation.random(count, rng=rng).as_matrix()


def measured(
    field_T: FloatArray,
    position_m: FloatArray,
    sigma_T: float,
    rng: np.random.Generator,
    sensor: FloatArray | None = None,
    rotation: FloatArray | None = None,
) -> Trials:
    """Let a sensor at given or random attitudes measure true fields.

    Parameters
    ----------
    field_T : ndarray, shape (e, n, 3)
        True fields in the site's frame.
    position_m : ndarray, shape (e, 3)
    sigma_T : float
        Standard deviation of each separated component.
    rng : Generator
    sensor : ndarray, shape (3, 3) or (e, 3, 3), optional
        What the sensor makes of a field in its frame, before its noise: the unit matrix if it is sound.
    rotation : ndarray, shape (e, 3, 3), optional
    """
    if rotation is None:
        rotation = attitudes(rng, len(position_m))
    seen = np.einsum("eki,enk->eni", rotation, field_T)
    if sensor is not None:
        matrix = np.broadcast_to(sensor, rotation.shape)
        seen = np.einsum("eij,enj->eni", matrix, seen)
    seen = seen + sigma_T * rng.normal(size=seen.shape)
    return Trials(position_m, rotation, seen, np.full(seen.shape[:2], sigma_T))

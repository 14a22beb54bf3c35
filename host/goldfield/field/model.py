"""The fields of a site's beacons at given points."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from goldfield.field.dipole import dipole
from goldfield.field.loop import loop
from goldfield.field.metal import MetalField
from goldfield.field.polyline import polyline
from goldfield.site import Beacon
from goldfield.types import FloatArray

Kind = Literal["exact", "dipole"]

FAR_FROM_WIRE = 100.0
"""A coil given by its wire is taken for its dipole beyond this many half-diameters: within 2e-4 of its field there."""


class FieldModel:
    """Fields and gradients of several coils, vectorised over points and coils.

    Circular coils are computed exactly at any range, since that costs no more than choosing; coils given by their
    wire exactly near by and as dipoles from far away (`FAR_FROM_WIRE`).

    Parameters
    ----------
    beacons : sequence of Beacon
    kind : {"exact", "dipole"}
        "dipole" takes every coil for its dipole at any range, as the sources do.

    Attributes
    ----------
    centre_m, moment_A_m2 : ndarray, shape (n, 3)
        Places and moments of the equivalent dipoles.
    reach_m : ndarray, shape (n,)
        Largest distance of each coil's wire from its centre.
    loop_radius_m : ndarray, shape (n,)
        Radii of circular coils; 0 for coils that are taken for dipoles, NaN for those given by their wire.
    wire_points_m : ndarray, shape (m, 3)
        Corners of all coils that are given by their wire.
    metal : MetalField or None
        What metal in the room adds; it is part of all fields.
    """

    def __init__(self, beacons: Sequence[Beacon], kind: Kind = "exact") -> None:
        self._beacons, self._kind = tuple(beacons), kind
        self.centre_m: FloatArray = np.array([_centre(beacon) for beacon in beacons], dtype=float).reshape(-1, 3)
        self.moment_A_m2: FloatArray = np.array([beacon.moment_A_m2 for beacon in beacons], dtype=float).reshape(-1, 3)
        self._centre = np.ascontiguousarray(self.centre_m.T)
        self._moment = np.ascontiguousarray(self.moment_A_m2.T)
        exact = kind == "exact"
        is_loop = np.array([exact and beacon.points_m is None for beacon in beacons], dtype=bool)
        is_wire = np.array([exact and beacon.points_m is not None for beacon in beacons], dtype=bool)
        self._loops: NDArray[np.intp] = np.flatnonzero(is_loop)
        self._wires: NDArray[np.intp] = np.flatnonzero(is_wire)
        self._dipoles: NDArray[np.intp] = np.flatnonzero(~is_loop & ~is_wire)

        loops = [beacons[int(i)] for i in self._loops]
        self._loop_axis = np.array([beacon.axis for beacon in loops], dtype=float).reshape(-1, 3).T.copy()
        self._loop_radius = np.array([beacon.radius_m for beacon in loops], dtype=float)
        self._loop_current = np.array([beacon.turns * beacon.current_A for beacon in loops], dtype=float)
        self.loop_radius_m: FloatArray = np.zeros(len(beacons))
        self.loop_radius_m[self._loops] = self._loop_radius
        self.loop_radius_m[self._wires] = np.nan
        self._least_m: FloatArray = np.nan_to_num(self.loop_radius_m)

        wires = [beacons[int(i)] for i in self._wires]
        points = [np.asarray(beacon.points_m, dtype=float) for beacon in wires]
        self.wire_points_m: FloatArray = np.concatenate([np.empty((0, 3)), *points])
        segments = max((len(p) - 1 for p in points), default=0)
        padded = [np.concatenate([p, np.repeat(p[-1:], segments + 1 - len(p), axis=0)]) for p in points]
        corners = np.array(padded, dtype=float).reshape(len(wires), segments + 1, 3).transpose(2, 0, 1)
        self._wire_start, self._wire_end = corners[..., :-1].copy(), corners[..., 1:].copy()
        self._wire_current = np.array([beacon.turns * beacon.current_A for beacon in wires], dtype=float)
        self.reach_m: FloatArray = np.array([_reach(beacon) for beacon in beacons], dtype=float)
        self._wire_far2 = (FAR_FROM_WIRE * self.reach_m[self._wires]) ** 2

        self.metal: MetalField | None = None
        if any(beacon.metal is not None for beacon in beacons):
            self.metal = MetalField(beacons, self.field)

    def __len__(self) -> int:
        """Return the number of coils."""
        return len(self.centre_m)

    @property
    def beacons(self) -> tuple[Beacon, ...]:
        """The coils, as the site describes them."""
        return self._beacons

    @cached_property
    def across(self) -> FloatArray:
        """Unit vector, shape (3,), along which the coils' places extend least: off their plane if they have one."""
        return np.asarray(np.linalg.svd(self.centre_m - self.centre_m.mean(axis=0))[2][2])

    def subset(self, rows: NDArray[np.intp]) -> FieldModel:
        """Return the model of some of the coils."""
        return FieldModel([self._beacons[int(row)] for row in rows], self._kind)

    def evaluate(self, point_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return field and gradient with components leading, for numerical work.

        Parameters
        ----------
        point_m : ndarray, shape (3, ...)

        Returns
        -------
        field_T : ndarray, shape (3, ..., n)
        gradient_T_m : ndarray, shape (3, 3, ..., n)
            Row i, column j: dB_i/dp_j.
        """
        field, gradient = self.evaluate_coils(point_m)
        if self.metal is not None:
            of_metal = self.metal.evaluate(point_m)
            field, gradient = field + of_metal[0], gradient + of_metal[1]
        return field, gradient

    def evaluate_coils(self, point_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the same of the coils alone, without what metal adds."""
        point = point_m[..., None]
        if len(self._loops) == len(self):
            return loop(point - self._shaped(self._centre, point), *self._loop_arguments(point))
        shape = (*point_m.shape[1:], len(self))
        kind = point_m.dtype
        field, gradient = np.empty((3, *shape), dtype=kind), np.empty((3, 3, *shape), dtype=kind)
        if len(self._loops):
            offset = point - self._shaped(self._centre[:, self._loops], point)
            field[..., self._loops], gradient[..., self._loops] = loop(offset, *self._loop_arguments(point))
        if len(self._dipoles):
            offset = point - self._shaped(self._centre[:, self._dipoles], point)
            field[..., self._dipoles], gradient[..., self._dipoles] = dipole(
                offset, self._shaped(self._moment[:, self._dipoles], point)
            )
        if len(self._wires):
            field[..., self._wires], gradient[..., self._wires] = self._evaluate_wires(point)
        return field, gradient

    def field(self, point_m: FloatArray) -> FloatArray:
        """Return the field of each coil at each point.

        Parameters
        ----------
        point_m : ndarray, shape (..., 3)
            Points in the site's frame.

        Returns
        -------
        field_T : ndarray, shape (..., n, 3)
            Fields in the site's frame.

        Examples
        --------
        A coil of 20 turns and 0.15 m with 10 A, seen from 2 m above and from 2 m beside it:

        >>> coil = Beacon("b1", np.zeros(3), np.array([0.0, 0.0, 1.0]), 20.0, 0.15, None, 10.0, code=2)
        >>> (1e6 * FieldModel([coil]).field(np.array([[0.0, 0.0, 2.0], [2.0, 0.0, 0.0]])))[:, 0, 2].round(3).tolist()
        [0.35, -0.178]
        """
        return self.field_and_gradient(point_m)[0]

    def field_and_gradient(self, point_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the field and gradient of each coil at each point.

        Parameters
        ----------
        point_m : ndarray, shape (..., 3)

        Returns
        -------
        field_T : ndarray, shape (..., n, 3)
        gradient_T_m : ndarray, shape (..., n, 3, 3)
            Row i, column j: dB_i/dp_j.
        """
        field, gradient = self.evaluate(np.moveaxis(np.asarray(point_m), -1, 0))
        return np.moveaxis(field, 0, -1), np.moveaxis(gradient, (0, 1), (-2, -1))

    def nearest_m(self, point_m: FloatArray) -> FloatArray:
        """Return the distance of points, shape (e, 3), to the nearest coil, shape (e,): no less than its radius.

        It is the length over which the fields change their shape: in the middle of a loop they hardly change within a
        tenth of its radius, though the centre is at hand. The radius of coils given by their wire does not count.
        """
        offset = point_m[:, None] - self.centre_m
        distance = np.sqrt((offset * offset).sum(axis=2))
        return np.asarray(np.maximum(distance, self._least_m).min(axis=1))

    def _loop_arguments(self, point: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self._shaped(self._loop_axis, point), self._loop_radius, self._loop_current

    def _evaluate_wires(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        offset = point - self._shaped(self._centre[:, self._wires], point)
        far = (offset * offset).sum(axis=0).real > self._wire_far2
        if far.all():
            return dipole(offset, self._shaped(self._moment[:, self._wires], point))
        spread = (slice(None), *(None,) * (point.ndim - 2), slice(None), slice(None))
        field, gradient = polyline(point, self._wire_start[spread], self._wire_end[spread], self._wire_current)
        if far.any():
            far_field, far_gradient = dipole(offset, self._shaped(self._moment[:, self._wires], point))
            field, gradient = np.where(far, far_field, field), np.where(far, far_gradient, gradient)
        return field, gradient

    @staticmethod
    def _shaped(vectors: FloatArray, point: FloatArray) -> FloatArray:
        """Put the axes of the points between the components and the coils."""
        return vectors.reshape(3, *(1,) * (point.ndim - 2), vectors.shape[1])


def _centre(beacon: Beacon) -> FloatArray:
    """Return where the equivalent dipole stands: of a wire its centre of mass, however it is divided into segments."""
    if beacon.points_m is None:
        return beacon.position_m
    lengths = np.linalg.norm(np.diff(beacon.points_m, axis=0), axis=1)
    middles = 0.5 * (beacon.points_m[1:] + beacon.points_m[:-1])
    return np.asarray(lengths @ middles / lengths.sum(), dtype=np.float64)


def _reach(beacon: Beacon) -> float:
    if beacon.points_m is None:
        assert beacon.radius_m is not None
        return beacon.radius_m
    return float(np.linalg.norm(beacon.points_m - _centre(beacon), axis=1).max())

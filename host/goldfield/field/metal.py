"""The field that metal adds to those of the coils (`goldfield.site.metal`), and its gradient."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import UserError
from goldfield.field.dipole import dipole
from goldfield.field.harmonics import derivative_matrices, field_norms, harmonic_values
from goldfield.site import Beacon
from goldfield.site.metal import COLUMNS, ROWS, Metal
from goldfield.types import FloatArray


class MetalField:
    """What the metal of a site adds to the fields of some beacons, vectorised over points and beacons.

    Parameters
    ----------
    beacons : sequence of Beacon
        At least one has metal; those that have it share one `Metal`.
    field_of_coils : callable
        Takes points, shape (k, 3), and returns the fields of the beacons' coils alone, shape (k, n, 3): what the bodies
        stand in.

    Attributes
    ----------
    metal : Metal
    sums : ndarray, shape (9, t, n)
        The polynomials' fields (x, y, z) and gradients (xx, yy, zz, xy, xz, yz) as sums of the harmonics up to degree
        ``metal.degree - 1`` at ``(point - centre_m)/radius_m``; t is ``metal.degree**2``.
    moment_A_m2 : ndarray, shape (k, 3, n)
        Moment that each beacon's field makes in each body.

    Raises
    ------
    UserError
        If two beacons have metal of different sites.
    """

    def __init__(self, beacons: Sequence[Beacon], field_of_coils: Callable[[FloatArray], FloatArray]) -> None:
        metals = [beacon.metal.metal for beacon in beacons if beacon.metal is not None]
        if any(metal is not metals[0] for metal in metals):
            raise UserError("the metal of two sites is mixed: take all beacons from one site file")
        self.metal: Metal = metals[0]
        from scipy.spatial import ConvexHull  # long to import: only where a site has metal

        corners = self.metal.walked_m
        self._facets: FloatArray | None = ConvexHull(corners).equations if len(corners) else None
        factor = field_norms(self.metal.degree)
        coefficients = np.zeros((len(beacons), 1 + len(factor)))
        shared = np.zeros(len(beacons))
        for row, beacon in enumerate(beacons):
            if beacon.metal is not None:
                coefficients[row, 1:] = beacon.current_A * factor * beacon.metal.harmonics_T_A
                shared[row] = 1.0
        self.sums = _sums(coefficients, self.metal.degree, self.metal.radius_m)
        at_bodies = field_of_coils(self.metal.body_m) * shared[:, None]
        self.moment_A_m2: FloatArray = np.einsum("kij,knj->kin", self.metal.polarisability_A_m2_T, at_bodies)

    def evaluate(self, point_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return field, shape (3, ..., n), and gradient, shape (3, 3, ..., n), at points of shape (3, ...)."""
        spread = (slice(None), *(None,) * (point_m.ndim - 1))
        shape = (*point_m.shape[1:], self.sums.shape[2])
        field, gradient = np.zeros((3, *shape), point_m.dtype), np.zeros((3, 3, *shape), point_m.dtype)
        if self.metal.degree:
            scaled = (point_m - self.metal.centre_m[spread]) / self.metal.radius_m
            both = np.einsum("t...,ctn->c...n", harmonic_values(scaled, self.metal.degree - 1), self.sums)
            field += both[:3]
            for row, (i, j) in enumerate(zip(ROWS, COLUMNS, strict=True), start=3):
                gradient[i, j] += both[row]
                if i != j:
                    gradient[j, i] += both[row]
        for place, moment in zip(self.metal.body_m, self.moment_A_m2, strict=True):
            offset = (point_m - place[spread])[..., None]
            of_body = dipole(offset, moment.reshape(3, *(1,) * (point_m.ndim - 1), -1))
            field, gradient = field + of_body[0], gradient + of_body[1]
        return field, gradient

    def learned(self, position_m: FloatArray) -> NDArray[np.bool_]:
        """Tell which positions, shape (e, 3), are in the room in which the metal was learned; all if it is unknown."""
        if self._facets is None:
            return np.ones(len(position_m), dtype=bool)
        outside = position_m @ self._facets[:, :3].T + self._facets[:, 3]
        return np.asarray((outside <= 1e-9 * self.metal.radius_m).all(axis=1))


def _sums(coefficients: FloatArray, degree: int, radius_m: float) -> FloatArray:
    """Return `MetalField.sums` of coefficients of shape (n, (degree + 1)^2)."""
    if degree == 0:
        return np.zeros((9, 0, len(coefficients)))
    derivative = derivative_matrices(degree)
    field = np.stack([coefficients @ derivative[a] for a in range(3)])
    slopes = np.stack([field[i] @ derivative[j] / radius_m for i, j in zip(ROWS, COLUMNS, strict=True)])
    return np.ascontiguousarray(np.concatenate([field, slopes])[:, :, : degree**2].transpose(0, 2, 1))

"""The field inside a conductor near dipoles, integrated over its parts: what the explicit formula is fed with.

Two ways, by the ratio of the body's size a (radius of the largest ball inside) to its skin depth:

- `SkinResponse`, a > `SKIN_RATIO` skin depths: H decays as exp(-(1+i) z/depth) under the surface (Leontovich). With
  s = mu_r depth/(1+i), div B = 0 gives H_n = -s div_surface H_t, and Green's formula for the total potential outside
  becomes (I - D) phi + s S K phi = phi_0 at the corners of the surface. Part i is the skin under triangle i: its
  current is n x H_t, its moment (with the first moment of the current in depth) s H_t. A field that varies along the
  surface with wave number q decays faster: s is divided by sqrt(1 + (q depth)^2/(2i)), in first order.
- `VolumeResponse`, a < `SKIN_RATIO` skin depths, not permeable: J = sigma E, E = -i omega (A_0 + A[J]) - grad phi with
  n.E = 0 at the surface; J at voxels by GMRES, phi by point charges around the body that fit the normal component.

Largest error against the exact series of a sphere, not permeable, at the paper's geometry (`goldfield paper gietler
formula`): 1.7 % up to a fifth of a skin depth, 2.4 % at 1.9, 3.0 % at 2.4, 5.2 % at 3.0, 1.0 % at 4.8, .2 % from 48
up; mu_r = 100: 1.4 % at 19. A permeable body whose skin is not thin is refused.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from scipy.constants import mu_0
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse.linalg import LinearOperator, gmres

from goldfield.errors import SystemFailure, UserError
from goldfield.field.conductor.body import Body
from goldfield.field.conductor.explicit import ComplexArray, Parts
from goldfield.field.conductor.surface import layer_matrices, slope_matrix, stiffness
from goldfield.types import FloatArray

SKIN_RATIO = 3.0
LAYERS = 3
CHARGES = 6
"""The charges around a body stand on the corners of its surface cut into so many pieces."""

CHARGE_DISTANCE = 1.7


class Response(Protocol):
    """A body at one frequency, ready for any sources."""

    body: Body
    frequency_Hz: float

    def parts(self, source_m: FloatArray, moment_A_m2: FloatArray) -> Parts:
        """Return the parts of the body in the field of e dipoles, shapes (e, 3), outside it."""
        ...


def respond(body: Body, frequency_Hz: float) -> Response:
    """Choose the way to compute the interior field.

    Raises
    ------
    UserError
        The body is permeable and neither way holds.
    """
    depth = body.material.skin_depth_m(frequency_Hz)
    if body.size_m > SKIN_RATIO * depth:
        return SkinResponse(body, frequency_Hz)
    ratio = body.size_m / depth
    if body.material.relative_permeability > 1.0:
        raise UserError(
            f"the conductor is permeable and only {ratio:.2g} skin depths thick from surface to centre at "
            f"{frequency_Hz:g} Hz: its field is computed from {SKIN_RATIO:g} up; take a frequency of at least "
            f"{frequency_Hz * (SKIN_RATIO / ratio) ** 2:.3g} Hz"
        )
    return VolumeResponse(body, frequency_Hz)


class SkinResponse:
    """The response of a body whose skin is thin.

    Parameters
    ----------
    body : Body
    frequency_Hz : float
    """

    def __init__(self, body: Body, frequency_Hz: float) -> None:
        self.body, self.frequency_Hz = body, frequency_Hz
        depth = body.material.skin_depth_m(frequency_Hz)
        self._skin = body.material.relative_permeability * depth / (1.0 + 1.0j)
        double, single = layer_matrices(body)
        bending = stiffness(body)
        unit = np.eye(len(double))
        inverse = (0.5 * (depth / (1.0 + 1.0j)) ** 2 / body.patch_m2)[:, None] * bending
        self._smooth = np.linalg.inv(unit + inverse)
        self._factors = lu_factor(unit - double + self._skin * (single @ bending @ self._smooth))
        self._slope = slope_matrix(body)

    def parts(self, source_m: FloatArray, moment_A_m2: FloatArray) -> Parts:
        """See `Response`."""
        _check_outside(self.body, source_m)
        offset = self.body.corner_m - source_m[:, None]  # (e, v, 3)
        distance3 = (offset * offset).sum(axis=-1) ** 1.5
        applied = np.einsum("evc,ec->ev", offset, moment_A_m2) / (4.0 * np.pi * distance3)
        potential: ComplexArray = np.asarray(lu_solve(self._factors, applied.T).T, dtype=np.complex128)
        area = np.linalg.norm(self.body.area_m2, axis=1)[:, None]
        moment = self._skin * area * self._tangential(potential @ self._smooth.T)
        return Parts(self.body.middle_m, np.cross(self.body.area_m2, self._tangential(potential)), moment)

    def _tangential(self, potential: ComplexArray) -> ComplexArray:
        """Return the tangential field on the triangles from the potential at the corners."""
        return np.asarray(-np.einsum("eti,tic->etc", potential[:, self.body.triangles], self._slope))


class VolumeResponse:
    """The response of a body that the field penetrates; not permeable.

    Parameters
    ----------
    body : Body
    frequency_Hz : float
    first_order : bool
        Leave out what the currents induce in each other: right for bodies much thinner than the skin depth.
    """

    def __init__(self, body: Body, frequency_Hz: float, first_order: bool = False) -> None:
        self.body, self.frequency_Hz, self._first_order = body, frequency_Hz, first_order
        self._drive = -2.0j * math.pi * frequency_Hz * body.material.conductivity_S_m
        self._voxel, self._volume = body.voxels(LAYERS)
        middle = body.middle_m
        area = np.linalg.norm(body.area_m2, axis=1)
        self._normal = body.area_m2 / area[:, None]

        # grad phi at the voxels from the normal derivative at the surface.
        step = max(1, len(body.corner_m) // (6 * CHARGES**2))
        charge = body.centre_m + CHARGE_DISTANCE * (body.corner_m[::step] - body.centre_m)
        weight = np.sqrt(area)
        normal_slope = np.einsum("tsc,tc->ts", _coulomb(middle, charge), self._normal)
        inverse = np.linalg.pinv(normal_slope * weight[:, None], rcond=1e-8) * weight
        self._charges, self._slopes = inverse, _coulomb(self._voxel, charge)

        # A at voxels and at the surface from the current in voxels, one component at a time.
        to_voxel = np.linalg.norm(self._voxel[:, None] - self._voxel, axis=2)
        radius = (0.75 * self._volume / np.pi) ** (1.0 / 3.0)
        np.fill_diagonal(to_voxel, 1.0 / 1.5 * radius)  # the mean of 1/r over a ball seen from its centre is 3/(2 R)
        self._to_voxel = mu_0 / (4.0 * np.pi) * self._volume / np.maximum(to_voxel, radius / 1.5)
        to_surface = np.linalg.norm(middle[:, None] - self._voxel, axis=2)
        self._to_surface = mu_0 / (4.0 * np.pi) * self._volume / np.maximum(to_surface, radius / 1.5)

    def parts(self, source_m: FloatArray, moment_A_m2: FloatArray) -> Parts:
        """See `Response`."""
        _check_outside(self.body, source_m)
        current = np.stack([self._current(s, m) for s, m in zip(source_m, moment_A_m2, strict=True)])
        integral = self._volume[:, None] * current
        return Parts(self._voxel, integral, np.zeros_like(integral))

    def _current(self, source_m: FloatArray, moment_A_m2: FloatArray) -> ComplexArray:
        """Solve J = -i omega sigma P (A_0 + A[J]); P removes the normal component by a gradient."""
        applied = self._drive * self._confined(
            _vector_potential(self._voxel - source_m, moment_A_m2),
            _vector_potential(self.body.middle_m - source_m, moment_A_m2),
        )
        if self._first_order:
            return applied

        def system(flat: ComplexArray) -> ComplexArray:
            current = flat.reshape(-1, 3)
            induced = self._confined(self._to_voxel @ current, self._to_surface @ current)
            return np.asarray((current - self._drive * induced).ravel())

        operator = LinearOperator((applied.size,) * 2, matvec=system, dtype=np.complex128)
        solution, failed = gmres(operator, applied.ravel(), rtol=1e-6, restart=60, maxiter=5)
        if failed:
            raise SystemFailure(
                f"the eddy currents did not converge at {self.frequency_Hz:g} Hz: this is a defect, please report it"
            )
        return np.asarray(solution.reshape(-1, 3))

    def _confined(self, inside: ComplexArray | FloatArray, surface: ComplexArray | FloatArray) -> ComplexArray:
        normal = (surface * self._normal).sum(axis=1)
        return np.asarray(inside - np.einsum("nsc,s->nc", self._slopes, self._charges @ normal))


def _vector_potential(offset_m: FloatArray, moment_A_m2: FloatArray) -> FloatArray:
    distance3 = (offset_m * offset_m).sum(axis=-1, keepdims=True) ** 1.5
    return np.asarray(mu_0 / (4.0 * np.pi) * np.cross(moment_A_m2, offset_m) / distance3)


def _coulomb(point_m: FloatArray, charge_m: FloatArray) -> FloatArray:
    """Return the gradient of 1/|x - y| up to its sign, shape (points, charges, 3)."""
    offset = point_m[:, None] - charge_m
    return np.asarray(offset / (offset * offset).sum(axis=-1, keepdims=True) ** 1.5)


def _check_outside(body: Body, source_m: FloatArray) -> None:
    """Refuse sources inside: the solid angle of the surface tells."""
    corner = body.corner_m[body.triangles] - np.asarray(source_m, dtype=float)[:, None, None]
    length = np.linalg.norm(corner, axis=-1)
    triple = np.linalg.det(corner)
    sums = length.prod(axis=-1)
    for i in range(3):
        sums += length[..., i] * (corner[..., (i + 1) % 3, :] * corner[..., (i + 2) % 3, :]).sum(axis=-1)
    turns = 2.0 * np.arctan2(triple, sums).sum(axis=-1) / (4.0 * np.pi)
    for source, turn in zip(source_m, turns, strict=True):
        if turn > 0.25:
            raise UserError(f"a source at {np.round(source, 4).tolist()} m is inside the conductor: move it out")

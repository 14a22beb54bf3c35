"""A steel rod beside a sensor: a straight row of touching spheres, conducting and permeable, coupled as dipoles.

Each sphere answers to a uniform field as the exact quasi-static solution does (Jackson, 5.18; with w^2 = s mu_0 mu_r
sigma a^2 at the Laplace variable s, u = w^2/(w coth w - 1) - 1),

    m = alpha H,    alpha = -2 pi a^3 (u - 2 mu_r)/(u + mu_r),

and stands in the field of the coils and of the other spheres' dipoles: m = alpha (H + A m). A is symmetric,
A = V L V', so m = V [alpha/(1 - alpha L)] V' H. What a despreader sees of the response to a chip's edge is the response
to a step at the end of the chip, when the sensor samples; later parts correlate with shifted codes, which are almost
orthogonal. The step's response is the inverse Laplace transform of [...]/s (Talbot's contour: all poles are on the
negative real axis).

Nothing here is the host's: the product's conductor models are not used. Higher multipoles of neighbours and what the
coils feel of the rod are left out: a real rod differs in figures, not in kind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.bench.integrity_coils import Coils

FloatArray = NDArray[np.float64]
MU_0 = 4e-7 * math.pi
CHIP_S = 97.75e-6
NODES = 24
"""Nodes of Talbot's contour: more lose digits to cancellation, fewer leave 1e-6."""


@dataclass(frozen=True)
class Material:
    """A material: conductivity, S/m, and relative permeability."""

    conductivity_S_m: float
    permeability: float


STEEL = Material(6e6, 200.0)
FERRITE = Material(0.0, 1000.0)
"""It is the worst case: no eddy current opposes the field that it draws in."""


def sphere_response(s: complex, radius_m: float, material: Material) -> complex:
    """Return alpha, m^3, the dipole moment of a sphere over the uniform field, at Laplace variables s."""
    mu = material.permeability
    squared = complex(s) * MU_0 * mu * material.conductivity_S_m * radius_m**2
    w = np.sqrt(squared)
    u = 2.0 + squared / 5.0 if abs(w) < 1e-3 else squared / (w / np.tanh(w) - 1.0) - 1.0
    return complex(-2.0 * math.pi * radius_m**3 * (u - 2.0 * mu) / (u + mu))


def step_response(radius_m: float, material: Material, coupling: FloatArray, time_s: float = CHIP_S) -> FloatArray:
    """Return alpha/(1 - alpha coupling), m^3, at a time after a step of the field.

    Parameters
    ----------
    coupling : ndarray, shape (k,)
        Eigenvalues of the coupling, 1/m^3; 0 for a sphere alone.
    """
    theta = np.arange(1, NODES) * math.pi / NODES
    cot = 1.0 / np.tan(theta)
    scale = 2.0 * NODES / (5.0 * time_s)
    nodes = np.concatenate([[scale], scale * theta * (cot + 1j)])
    weight = np.concatenate([[0.5], 1.0 + 1j * theta * (1.0 + cot**2) - 1j * cot])
    total = np.zeros(len(coupling))
    for s, factor in zip(nodes, weight, strict=True):
        alpha = sphere_response(s, radius_m, material)
        total += np.real(np.exp(s * time_s) * factor * alpha / (1.0 - alpha * coupling) / s)
    return total * scale / NODES


def dipole_tensors(offset_m: FloatArray) -> FloatArray:
    """Return the matrices that take dipole moments to H at offsets, shape (..., 3), in shape (..., 3, 3), 1/m^3."""
    r = np.linalg.norm(offset_m, axis=-1)[..., None, None]
    unit = offset_m[..., :, None] / r
    return np.asarray((3.0 * unit * unit.swapaxes(-1, -2) - np.eye(3)) / (4.0 * math.pi * r**3))


@dataclass(frozen=True)
class Rod:
    """A rod in the sensor's frame.

    Attributes
    ----------
    sphere_m : ndarray, shape (k, 3)
        Centres of its spheres.
    radius_m : float
    material : Material
    """

    sphere_m: FloatArray
    radius_m: float
    material: Material

    @classmethod
    def beside(
        cls,
        rng: np.random.Generator,
        distance_m: float,
        material: Material = STEEL,
        diameter_m: float = 0.01,
        length_m: float = 0.1,
    ) -> Rod:
        """Return a rod whose surface is at a distance from the sensor, anywhere around it, across the line to it."""
        towards = rng.normal(size=3)
        towards /= np.linalg.norm(towards)
        along = np.cross(towards, rng.normal(size=3))
        along /= np.linalg.norm(along)
        count = round(length_m / diameter_m)
        place = (np.arange(count) - 0.5 * (count - 1)) * diameter_m
        centre = (distance_m + 0.5 * diameter_m) * towards
        return cls(centre + place[:, None] * along, 0.5 * diameter_m, material)

    def moments(self, time_s: float = CHIP_S) -> FloatArray:
        """Return the matrix from H at the spheres to their moments at the end of a chip, shape (3 k, 3 k), m^3."""
        count = len(self.sphere_m)
        apart = self.sphere_m[:, None] - self.sphere_m
        tensor = np.zeros((count, count, 3, 3))
        other = ~np.eye(count, dtype=bool)
        tensor[other] = dipole_tensors(apart[other])
        coupling, vector = np.linalg.eigh(tensor.swapaxes(1, 2).reshape(3 * count, 3 * count))
        return np.asarray(vector * step_response(self.radius_m, self.material, coupling, time_s) @ vector.T)

    def added(self, coils: Coils, position_m: FloatArray, rotation: FloatArray) -> FloatArray:
        """Return the fields that the rod adds at the sensor, shape (e, n, 3), tesla in the site's frame.

        Parameters
        ----------
        position_m, rotation : ndarray, shapes (e, 3) and (e, 3, 3)
            The sensor's poses; the rod goes with it.
        """
        count = len(self.sphere_m)
        beacons = coils.radius_m.shape[1]
        place = position_m[:, None] + np.einsum("eij,kj->eki", rotation, self.sphere_m)
        primary = np.stack([coils.field(place[:, k]) for k in range(count)], axis=2)  # (e, n, k, 3)
        seen = np.einsum("eji,enkj->enki", rotation, primary).reshape(len(position_m), beacons, 3 * count)
        moment = (seen @ self.moments()).reshape(len(position_m), beacons, count, 3)  # times mu_0
        field = np.einsum("kij,enkj->eni", dipole_tensors(-self.sphere_m), moment)
        return np.asarray(np.einsum("eij,enj->eni", rotation, field))

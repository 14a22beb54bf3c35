"""A steel rod beside a sensor: a slender prolate spheroid, conducting and permeable.

The moment of a spheroid of volume V in a uniform field H, along its axis (a) and across (t), is

    m = V (mu_i - 1)/(1 + N_i (mu_i - 1)) H,    i = a, t,

with the demagnetising factors N_i (Osborn 1945). Eddy currents make the permeability appear less; that of a long
cylinder of radius b, exact with w^2 = s mu_0 mu_r sigma b^2 at the Laplace variable s, is taken:

    mu_a = 2 mu_r I_1(w)/(w I_0(w)),    mu_t = mu_r I_1(w)/(w I_1'(w)).

So the static spheroid, the perfectly conducting one (mu_i = 0) and the endless cylinder are exact. Outside, a uniformly
polarised prolate spheroid is exactly a line of dipoles between its foci, as dense as f^2 - z^2.

What a despreader sees of the response to a chip's edge is the response to a step at the end of the chip, when the
sensor samples; later parts correlate with shifted codes, which are almost orthogonal. It is the inverse Laplace
transform of m/s, by Talbot's contour: all poles are on the negative real axis. The product's models of conductors are
not used. Left out are the field's change of shape over the rod, of which a mean is taken, and what the coils feel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from tests.bench.integrity_coils import Coils

FloatArray = NDArray[np.float64]
MU_0 = 4e-7 * math.pi
CHIP_S = 97.75e-6
NODES = 24
"""Nodes of Talbot's contour: more lose digits to cancellation, fewer leave 1e-6."""
POINTS = 24
"""Dipoles that stand for the line of dipoles (Gauss and Legendre)."""


@dataclass(frozen=True)
class Material:
    """A material: conductivity, S/m, and relative permeability."""

    conductivity_S_m: float
    permeability: float


STEEL = Material(6e6, 200.0)
FERRITE = Material(0.0, 1000.0)
"""It is the worst case: no eddy current opposes the field that it draws in."""


@dataclass(frozen=True)
class Spheroid:
    """A prolate spheroid: half its length, half its thickness (less), and its material."""

    half_length_m: float
    half_width_m: float
    material: Material

    @property
    def focus_m(self) -> float:
        """Distance of each focus from the middle."""
        return math.sqrt(self.half_length_m**2 - self.half_width_m**2)

    @property
    def factors(self) -> FloatArray:
        """Demagnetising factors along and across."""
        e = self.focus_m / self.half_length_m
        along = (1.0 - e * e) / e**2 * (math.atanh(e) / e - 1.0)
        return np.array([along, 0.5 * (1.0 - along)])

    def polarisability(self, s: complex) -> NDArray[np.complex128]:
        """Return the moments along and across over a uniform H, shape (2,), m^3, at a Laplace variable, 1/s."""
        mu, conductivity = self.material.permeability, self.material.conductivity_S_m
        w = np.sqrt(complex(s) * MU_0 * mu * conductivity) * self.half_width_m
        apparent = np.full(2, mu, dtype=np.complex128)
        if abs(w) > 1e-4:
            ratio = ive(1, w) / ive(0, w)  # I_1' = I_0 - I_1/w
            apparent = mu * np.array([2.0 * ratio / w, ratio / (w - ratio)])
        volume = 4.0 / 3.0 * math.pi * self.half_length_m * self.half_width_m**2
        return np.asarray(volume * (apparent - 1.0) / (1.0 + self.factors * (apparent - 1.0)))

    def step_response(self, time_s: float = CHIP_S) -> FloatArray:
        """Return the moments along and across a time after a step of H, over its height, shape (2,), m^3."""
        theta = np.arange(1, NODES) * math.pi / NODES
        cot = 1.0 / np.tan(theta)
        scale = 2.0 * NODES / (5.0 * time_s)
        nodes = np.concatenate([[scale], scale * theta * (cot + 1j)])
        weight = np.concatenate([[0.5], 1.0 + 1j * theta * (1.0 + cot**2) - 1j * cot])
        terms = [
            np.exp(s * time_s) * factor * self.polarisability(s) / s for s, factor in zip(nodes, weight, strict=True)
        ]
        return np.real(np.sum(terms, axis=0)) * scale / NODES


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
    centre_m, along : ndarray, shape (3,)
        Its middle and the unit vector of its axis.
    body : Spheroid
    """

    centre_m: FloatArray
    along: FloatArray
    body: Spheroid

    @classmethod
    def beside(
        cls,
        rng: np.random.Generator,
        distance_m: float,
        material: Material = STEEL,
        diameter_m: float = 0.01,
        length_m: float = 0.1,
    ) -> Rod:
        """Return a rod whose surface is at a distance from the sensor, anywhere around it, in any direction.

        Its nearest point is anywhere along the middle half of its length.
        """
        towards = rng.normal(size=3)
        towards /= np.linalg.norm(towards)
        along = np.cross(towards, rng.normal(size=3))
        along /= np.linalg.norm(along)
        body = Spheroid(0.5 * length_m, 0.5 * diameter_m, material)
        part = rng.uniform(-0.5, 0.5)
        normal = np.array([part / body.half_length_m, math.sqrt(1.0 - part * part) / body.half_width_m])
        normal /= np.linalg.norm(normal)
        surface = np.array([part * body.half_length_m, math.sqrt(1.0 - part * part) * body.half_width_m])
        sensor = surface + distance_m * normal  # along the axis, and away from it, seen from the middle
        return cls(-(sensor[0] * along + sensor[1] * towards), along, body)

    def points(self) -> tuple[FloatArray, FloatArray]:
        """Return the places of the dipoles, shape (k, 3), in the sensor's frame, and their parts of the moment."""
        place, weight = np.polynomial.legendre.leggauss(POINTS)
        dense = weight * (1.0 - place**2)
        return self.centre_m + self.body.focus_m * place[:, None] * self.along, dense / dense.sum()

    def moments(self, time_s: float = CHIP_S) -> FloatArray:
        """Return the matrix from the mean H to the rod's moment at the end of a chip, shape (3, 3), m^3."""
        axial, across = self.body.step_response(time_s)
        outer = np.outer(self.along, self.along)
        return np.asarray(axial * outer + across * (np.eye(3) - outer))

    def added(self, coils: Coils, position_m: FloatArray, rotation: FloatArray) -> FloatArray:
        """Return the fields that the rod adds at the sensor, shape (e, n, 3), tesla in the site's frame.

        Parameters
        ----------
        position_m, rotation : ndarray, shapes (e, 3) and (e, 3, 3)
            The sensor's poses; the rod goes with it.
        """
        points, parts = self.points()
        place = position_m[:, None] + np.einsum("eij,kj->eki", rotation, points)
        primary = sum(part * coils.field(place[:, k]) for k, part in enumerate(parts))
        effect = np.einsum("k,kij->ij", parts, dipole_tensors(-points)) @ self.moments()
        return np.asarray(np.einsum("eij,jk,elk,enl->eni", rotation, effect, rotation, primary))

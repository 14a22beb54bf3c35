"""Metal as unknowns of an adjustment: coefficients of harmonic polynomials for each beacon, and bodies for all of them.

In the vector of what all epochs have in common they stand behind the beacons and the sensor: the n C coefficients,
beacon by beacon, then nine numbers a body: its place and its polarisability as xx, yy, zz, xy, xz, yz. With D(r) m the
field of a dipole at a distance r and B the field of a coil at the body's place q, a body adds D(x - q) alpha B(q) at x.
By its place this changes by -grad(D m) + D alpha grad B, by its polarisability by D E B, with E the unit matrices. That
a body answers otherwise when a beacon is moved is left out: bodies are weak and far.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from goldfield.field import FieldModel
from goldfield.field.dipole import dipole
from goldfield.field.harmonics import harmonic_fields
from goldfield.site import Beacon
from goldfield.site.metal import MOST_DEGREE, BeaconMetal, Metal, harmonic_count, symmetric
from goldfield.types import FloatArray

BODY = 9
"""Unknowns of a body."""
RELATIVE_HARMONIC = 0.1
"""`MetalState.relative_sd` where nothing is known of it."""
BODY_SD_M = 0.3
POLARISABILITY_SD = 1e6
"""Standard deviations of a body's place, and of its polarisability, A m^2/T: that of an iron ball of 46 cm radius."""


@dataclass(frozen=True, eq=False)
class MetalState:
    """Values of the unknowns of metal.

    Attributes
    ----------
    centre_m : ndarray, shape (3,)
    radius_m : float
    degree : int
        See `goldfield.site.metal.Metal`; these three are not estimated.
    harmonics_T : ndarray, shape (n, C)
        Coefficients at the currents of the site.
    body_m : ndarray, shape (k, 3)
    polarisability : ndarray, shape (k, 6)
        A m^2/T.
    relative_sd : ndarray, shape (degree,) or ()
        Standard deviation of the coefficients of each degree before the survey, over the root of the mean square of
        the beacon's fields.
    """

    centre_m: FloatArray
    radius_m: float
    degree: int
    harmonics_T: FloatArray
    body_m: FloatArray
    polarisability: FloatArray
    relative_sd: FloatArray = field(default_factory=lambda: np.array(RELATIVE_HARMONIC))

    @property
    def is_none(self) -> bool:
        """Whether no metal is estimated."""
        return self.size == 0

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.harmonics_T.size + BODY * len(self.body_m)

    def vector(self) -> FloatArray:
        """Return all unknowns, shape (size,)."""
        return np.concatenate([self.harmonics_T.ravel(), np.hstack([self.body_m, self.polarisability]).ravel()])

    def moved(self, step: FloatArray) -> MetalState:
        """Return the state after a step, shape (size,)."""
        count = self.harmonics_T.size
        bodies = step[count:].reshape(-1, BODY)
        return replace(
            self,
            harmonics_T=self.harmonics_T + step[:count].reshape(self.harmonics_T.shape),
            body_m=self.body_m + bodies[:, :3],
            polarisability=self.polarisability + bodies[:, 3:],
        )

    def sd(self, field_T: FloatArray) -> FloatArray:
        """Return the standard deviations before the survey, shape (size,).

        Parameters
        ----------
        field_T : ndarray, shape (n,)
            Root of the mean square of each beacon's measured fields.
        """
        every = np.broadcast_to(self.relative_sd, self.degree)
        relative = np.repeat(every, 2 * np.arange(1, self.degree + 1) + 1)
        harmonics = np.outer(field_T, relative).ravel()
        body = np.array([BODY_SD_M] * 3 + [POLARISABILITY_SD] * 6)
        return np.concatenate([harmonics, np.tile(body, len(self.body_m))])

    def metal(self, sd_T_A: float = 0.0, walked_m: FloatArray | None = None) -> Metal:
        """Return what all beacons have in common."""
        return Metal(
            centre_m=self.centre_m,
            radius_m=self.radius_m,
            degree=self.degree,
            body_m=self.body_m,
            polarisability_A_m2_T=symmetric(self.polarisability),
            sd_T_A=sd_T_A,
            walked_m=np.empty((0, 3)) if walked_m is None else walked_m,
        )

    def added_to(self, before: tuple[Beacon, ...], beacons: tuple[Beacon, ...], metal: Metal) -> tuple[Beacon, ...]:
        """Return beacons with their metal; ``before`` has the currents of the site."""
        return tuple(
            replace(beacon, metal=BeaconMetal(metal, row / old.current_A))
            for old, beacon, row in zip(before, beacons, self.harmonics_T, strict=True)
        )


def no_metal(beacons: int) -> MetalState:
    """Return the state without any unknowns."""
    return MetalState(np.zeros(3), 1.0, 0, np.empty((beacons, 0)), np.empty((0, 3)), np.empty((0, 6)))


def polynomials_around(walked_m: FloatArray, beacons: int, degree: int = MOST_DEGREE) -> MetalState:
    """Return polynomials of zero around what was walked; the few epochs that are far from all others do not count.

    Parameters
    ----------
    walked_m : ndarray, shape (e, 3)
    beacons, degree : int
    """
    low, high = np.quantile(walked_m, 0.01, axis=0), np.quantile(walked_m, 0.99, axis=0)
    centre = 0.5 * (low + high)
    radius = float(np.quantile(np.linalg.norm(walked_m - centre, axis=1), 0.95))
    harmonics = np.zeros((beacons, harmonic_count(degree)))
    return MetalState(centre, radius, degree, harmonics, np.empty((0, 3)), np.empty((0, 6)))


def effects_of_harmonics(metal: MetalState, strength: FloatArray, point_m: FloatArray) -> FloatArray:
    """Return the derivatives of the field by the coefficients, shape (e, n, 3, C).

    Parameters
    ----------
    strength : ndarray, shape (n,)
        Each current over that of the site.
    point_m : ndarray, shape (e, 3)
    """
    if metal.degree == 0:
        return np.empty((len(point_m), len(strength), 3, 0))
    scaled = (point_m - metal.centre_m) / metal.radius_m
    fields = harmonic_fields(scaled.T, metal.degree).transpose(2, 0, 1)  # (e, 3, C)
    return np.asarray(strength[None, :, None, None] * fields[:, None])


def effects_of_bodies(metal: MetalState, coils: FieldModel, point_m: FloatArray) -> FloatArray:
    """Return the derivatives of the field by places and polarisabilities of the bodies, shape (e, n, 3, 9 k)."""
    effect = np.empty((len(point_m), len(coils), 3, len(metal.body_m), BODY))
    at_body, slope = coils.evaluate_coils(np.ascontiguousarray(metal.body_m.T))  # (3, k, n), (3, 3, k, n)
    matrices = symmetric(metal.polarisability)
    unit = symmetric(np.eye(6))  # (6, 3, 3)
    for k, (place, matrix) in enumerate(zip(metal.body_m, matrices, strict=True)):
        offset = (point_m - place).T[..., None]  # (3, e, 1)
        of_units = dipole(offset, np.eye(3)[:, None, :])[0].transpose(1, 0, 2)  # (e, 3, moment)
        moment = matrix @ at_body[:, k]  # (3, n)
        gradient = dipole(offset, moment[:, None])[1].transpose(2, 3, 0, 1)  # (e, n, 3, 3)
        turned = np.einsum("ij,jan->nia", matrix, slope[:, :, k])  # by the place of the body, the moment: (n, 3, 3)
        effect[..., k, :3] = -gradient + np.einsum("eim,nma->enia", of_units, turned)
        moments = np.einsum("pmj,jn->nmp", unit, at_body[:, k])
        effect[..., k, 3:] = np.einsum("eim,nmp->enip", of_units, moments)
    return effect.reshape(*effect.shape[:3], BODY * len(metal.body_m))

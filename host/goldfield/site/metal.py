"""What metal in a room adds to the fields of the beacons, as a survey has learned it.

Metal answers each coil's field by one of its own. Where there is no metal that field has neither curl nor divergence,
so it is the gradient of a sum of harmonic polynomials, one sum a beacon. Some of it may come from a few small bodies,
which answer all beacons alike: by the field that they stand in times their polarisability. `goldfield.field.metal` adds
both to the fields of the coils; ``goldfield survey --free field`` finds them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.errors import UserError
from goldfield.types import FloatArray

MOST_DEGREE = 5
"""Highest degree of the polynomials: 35 coefficients a beacon, as many as a walk of some hundred epochs tells."""

MOST_BODIES = 8
"""Largest number of bodies."""


ROWS, COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
"""Where the six numbers of a symmetric matrix stand: xx, yy, zz, xy, xz, yz."""


def symmetric(numbers: FloatArray) -> FloatArray:
    """Return symmetric matrices, shape (k, 3, 3), of their six numbers, shape (k, 6).

    Examples
    --------
    >>> symmetric(np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]])).tolist()
    [[[1.0, 4.0, 5.0], [4.0, 2.0, 6.0], [5.0, 6.0, 3.0]]]
    """
    result = np.empty((len(numbers), 3, 3))
    result[:, ROWS, COLUMNS] = result[:, COLUMNS, ROWS] = numbers
    return result


def harmonic_count(degree: int) -> int:
    """Return how many harmonic polynomials there are from degree 1 to this one.

    Examples
    --------
    >>> harmonic_count(4)
    24
    """
    return (degree + 1) ** 2 - 1


@dataclass(frozen=True, eq=False)
class Metal:
    """The metal of a site: what all beacons have in common; equal to itself only.

    Attributes
    ----------
    centre_m : ndarray, shape (3,)
        Where the polynomials are centred.
    radius_m : float
        Distance at which a coefficient is the root mean square of its field over a sphere.
    degree : int
        Highest degree of the polynomials, 0 (none) to `MOST_DEGREE`.
    body_m : ndarray, shape (k, 3)
        Places of the bodies, at most `MOST_BODIES`.
    polarisability_A_m2_T : ndarray, shape (k, 3, 3)
        Magnetic moment of each body over the field that it stands in, symmetric.
    sd_T_A : float
        Standard deviation of what is left of the metal's field, each component, tesla for each ampere of a beacon.
    walked_m : ndarray, shape (v, 3)
        Corners of the convex room in which it was learned; outside, the polynomials mean nothing. Empty: unknown.

    Raises
    ------
    UserError
        If a shape is wrong, a value is not finite or out of range, or a polarisability is not symmetric.
    """

    centre_m: FloatArray
    radius_m: float
    degree: int
    body_m: FloatArray
    polarisability_A_m2_T: FloatArray
    sd_T_A: float
    walked_m: FloatArray

    def __post_init__(self) -> None:
        """Check everything, since a survey makes one as well as a site file does."""
        bodies = len(self.body_m)
        shapes = (
            ("centre_m", (3,)),
            ("body_m", (bodies, 3)),
            ("polarisability_A_m2_T", (bodies, 3, 3)),
            ("walked_m", (len(self.walked_m), 3)),
        )
        for name, shape in shapes:
            value = getattr(self, name)
            if value.shape != shape or not np.isfinite(value).all():
                raise UserError(f"{name}= of Metal must be finite numbers of shape {shape}")
        if not (np.isfinite(self.radius_m) and self.radius_m > 0.0):
            raise UserError(f"radius_m= of Metal is {self.radius_m:g}: it must be above 0")
        if not (np.isfinite(self.sd_T_A) and self.sd_T_A >= 0.0):
            raise UserError(f"sd_T_A= of Metal is {self.sd_T_A:g}: it must be 0 or more")
        if not 0 <= self.degree <= MOST_DEGREE:
            raise UserError(f"degree= of Metal is {self.degree}: it must be 0 to {MOST_DEGREE}")
        if bodies > MOST_BODIES:
            raise UserError(f"body_m= of Metal has {bodies} bodies: at most {MOST_BODIES} are allowed")
        if not np.array_equal(self.polarisability_A_m2_T, self.polarisability_A_m2_T.swapaxes(1, 2)):
            raise UserError("polarisability_A_m2_T= of Metal must be symmetric: a body without loss has no other")

    @property
    def is_nothing(self) -> bool:
        """Whether nothing is added and nothing is unknown."""
        return self.degree == 0 and len(self.body_m) == 0 and self.sd_T_A == 0.0


def no_metal() -> Metal:
    """Return metal that adds nothing."""
    none = np.empty((0, 3))
    return Metal(np.zeros(3), 1.0, 0, none, np.empty((0, 3, 3)), 0.0, none)


@dataclass(frozen=True, eq=False)
class BeaconMetal:
    """What metal adds to one beacon's field; equal to itself only.

    Attributes
    ----------
    metal : Metal
        The same object for all beacons of a site.
    harmonics_T_A : ndarray, shape (harmonic_count(metal.degree),)
        Coefficients of the polynomials, tesla for each ampere of the beacon's current, ordered as
        `goldfield.field.harmonics` says.

    Raises
    ------
    UserError
        If the number of coefficients is not that of the degree, or one is not finite.
    """

    metal: Metal
    harmonics_T_A: FloatArray

    def __post_init__(self) -> None:
        """Check the number of coefficients."""
        count = harmonic_count(self.metal.degree)
        if self.harmonics_T_A.shape != (count,) or not np.isfinite(self.harmonics_T_A).all():
            raise UserError(
                f"harmonics_T_A= of BeaconMetal has the shape {self.harmonics_T_A.shape}: "
                f"degree {self.metal.degree} needs {count} finite numbers"
            )

"""The exact eddy-current field of a conducting, permeable sphere near magnetic dipoles, at any frequency.

Quasi-static: outside H = -grad psi. Around the sphere's centre a dipole m at d has, for r < d,
psi_0 = sum_n r^n Y_n(x/r),  4 pi Y_n = m . grad_d [d^-(n+1) P_n(cos gamma)].  Inside, B = curl curl (r f_n(r) Y_n) with
f_n the spherical Bessel function j_n(k r), k^2 = -i omega mu sigma (phasors exp(+i omega t)). With continuous B_r and
tangential H each order answers alone: psi = chi_n a^(2n+1) r^-(n+1) Y_n with

    chi_n = n (u_n - (n+1) mu_r) / ((n+1) (u_n + n mu_r)),    u_n = k a j_(n-1)(k a)/j_n(k a) - n,

u_n = n + 1 for a static field and infinite for a perfect conductor (Jackson, Classical Electrodynamics, 5.18, gives
n = 1; Bidinosti, Chapple & Hayden 2007). There is no toroidal part: a dipole in air drives none in a sphere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

MU_0 = 4e-7 * math.pi
ORDERS = 120
"""Multipoles summed: the terms fall as (a^2/(r d))^n; 1e-9 at a distance of a fifth of the radius on both sides."""

FEW_ORDERS = 2e4
"""Arguments from which on upward recursion keeps its digits for all `ORDERS`: their square is below it."""

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Sphere:
    """A homogeneous sphere.

    Parameters
    ----------
    centre_m : ndarray, shape (3,)
    radius_m : float
    conductivity_S_m : float
        May be infinite: a perfect conductor.
    relative_permeability : float
    """

    centre_m: FloatArray
    radius_m: float
    conductivity_S_m: float
    relative_permeability: float = 1.0

    def wave_number(self, frequency_Hz: float) -> complex:
        """Return k inside, 1/m, with a negative imaginary part: (1 - i)/skin depth."""
        rate = 2.0 * math.pi * frequency_Hz * MU_0 * self.relative_permeability * self.conductivity_S_m
        return complex(np.sqrt(0.5 * rate)) * (1.0 - 1.0j)

    def susceptibilities(self, frequency_Hz: float, orders: int = ORDERS) -> ComplexArray:
        """Return chi_n for n = 1 to orders; 0 Hz gives the magnetostatic ones."""
        n = np.arange(1, orders + 1)
        mu = self.relative_permeability
        if math.isinf(self.conductivity_S_m):
            return np.asarray(n / (n + 1.0) + 0.0j)
        u = _logarithmic_slope(self.wave_number(frequency_Hz) * self.radius_m, orders)
        return np.asarray(n * (u - (n + 1) * mu) / ((n + 1) * (u + n * mu)))

    def secondary(
        self, point_m: FloatArray, source_m: FloatArray, moment_A_m2: FloatArray, frequency_Hz: float
    ) -> ComplexArray:
        """Return the field that the sphere adds outside itself.

        Parameters
        ----------
        point_m : ndarray, shape (..., 3)
        source_m, moment_A_m2 : ndarray, shape (..., 3)
            Dipoles outside the sphere; broadcast against the points.
        frequency_Hz : float

        Returns
        -------
        field_A_m : ndarray of complex, shape (..., 3)

        Raises
        ------
        ValueError
            A point or a source is not outside the sphere.
        """
        harmonics = _Harmonics(self, point_m, source_m, moment_A_m2)
        if (harmonics.r <= self.radius_m).any():
            raise ValueError("the sphere's field is asked for at a point inside the sphere: use interior")
        chi = self.susceptibilities(frequency_Hz)
        a, r = self.radius_m, harmonics.r[..., None]
        field = np.zeros(harmonics.shape, dtype=np.complex128)
        for n, value, slope in harmonics:
            scale = chi[n - 1] * (a / r) ** (n + 2) * a ** (n - 1)
            field += scale * ((n + 1) * value[..., None] * harmonics.radial - slope)
        return field

    def interior(
        self, point_m: FloatArray, source_m: FloatArray, moment_A_m2: FloatArray, frequency_Hz: float, orders: int = 60
    ) -> tuple[ComplexArray, ComplexArray]:
        """Total field inside and its curl, the current density; arguments as of `secondary`.

        Returns
        -------
        field_A_m, current_A_m2 : ndarray of complex, shape (..., 3)
        """
        harmonics = _Harmonics(self, point_m, source_m, moment_A_m2)
        chi = self.susceptibilities(frequency_Hz, orders)
        a, r, mu = self.radius_m, harmonics.r, self.relative_permeability
        k = self.wave_number(frequency_Hz)
        field, current = (np.zeros(harmonics.shape, dtype=np.complex128) for _ in range(2))
        slope_there = _logarithmic_slope(k * r, orders)
        for n, value, slope in harmonics:
            if n > orders:
                break
            f_surface = -(n - (n + 1) * chi[n - 1]) * a**n / (n * (n + 1) * mu)
            f = f_surface * _bessel_ratio(n, np.asarray(k * r), k * a)
            lifted = (f / r)[..., None]
            field += lifted * (
                n * (n + 1) * value[..., None] * harmonics.radial + slope_there[..., n - 1, None] * slope
            )
            current -= k * k * f[..., None] * np.cross(harmonics.radial, slope)
        return field, current


class _Harmonics:
    """Iterates over n, Y_n and its surface gradient r grad Y_n at the points, scaled to the unit sphere."""

    def __init__(self, sphere: Sphere, point_m: FloatArray, source_m: FloatArray, moment_A_m2: FloatArray) -> None:
        x = np.asarray(point_m, dtype=float) - sphere.centre_m
        d = np.asarray(source_m, dtype=float) - sphere.centre_m
        x, d, m = np.broadcast_arrays(x, d, np.asarray(moment_A_m2, dtype=float))
        self.shape = x.shape
        self.r = np.maximum(np.linalg.norm(x, axis=-1), 1e-12 * sphere.radius_m)
        distance = np.linalg.norm(d, axis=-1)
        if (distance <= sphere.radius_m).any():
            raise ValueError("a dipole is inside the sphere: the series is that of sources outside")
        self.radial = x / self.r[..., None]
        self._distance = distance
        towards = d / distance[..., None]
        self._cosine = (self.radial * towards).sum(axis=-1)
        self._along = (m * towards).sum(axis=-1)
        self._across = (m * self.radial).sum(axis=-1) - self._cosine * self._along
        self._towards = towards - self._cosine[..., None] * self.radial
        moment = m - (m * self.radial).sum(axis=-1)[..., None] * self.radial
        self._moment = moment - self._along[..., None] * self._towards

    def __iter__(self) -> Iterator[tuple[int, FloatArray, FloatArray]]:
        c = self._cosine
        previous, p = np.ones_like(c), c.copy()
        dp, ddp = np.ones_like(c), np.zeros_like(c)
        power = 1.0 / (4.0 * math.pi * self._distance**3)
        for n in range(1, ORDERS + 1):
            value = power * (-(n + 1) * self._along * p + self._across * dp)
            turning = power * (-(n + 1) * self._along * dp + self._across * ddp)
            yield n, value, turning[..., None] * self._towards + (power * dp)[..., None] * self._moment
            previous, p, dp, ddp = (
                p,
                ((2 * n + 1) * c * p - n * previous) / (n + 1),
                (n + 1) * p + c * dp,
                (n + 2) * dp + c * ddp,
            )
            power = power / self._distance


def _logarithmic_slope(z: complex | ComplexArray, orders: int) -> ComplexArray:
    """Return u_n = d(r j_n)/dr / j_n at r = 1 of j_n(z r), shape (..., orders)."""
    z = np.asarray(z, dtype=np.complex128)
    u = np.empty((*z.shape, orders), dtype=np.complex128)
    n = np.arange(1, orders + 1)
    small = np.abs(z) < 1e-7
    u[small] = n + 1.0
    moderate = ~small & (np.abs(z) < FEW_ORDERS)
    if moderate.any():
        some = z[moderate]
        ratio = np.zeros_like(some)  # j_n/j_(n-1), by its continued fraction from far above
        for order in range(orders + 60 + int(1.5 * np.abs(some).max()), 0, -1):
            ratio = 1.0 / ((2 * order + 1) / some - ratio)
            if order <= orders:
                u[moderate, order - 1] = some / ratio - order
    large = ~small & ~moderate
    if large.any():
        some = 1j * z[large]
        ratio = 1.0 - 1.0 / some  # i_1/i_0, then upward: stable where the orders are few against the argument
        for order in range(1, orders + 1):
            u[large, order - 1] = some / ratio - order
            ratio = 1.0 / ratio - (2 * order + 1) / some
    return u


def _bessel_ratio(n: int, z: ComplexArray, surface: complex) -> ComplexArray:
    """Return j_n(z)/j_n(surface), with |z| <= |surface| on the same ray."""
    part = np.abs(z) / max(abs(surface), 1e-300)
    if abs(surface) < 1e-3:
        return np.asarray(part**n + 0.0j)
    w, w_surface = 1j * z, np.complex128(1j * surface)
    whole = complex(ive(np.array([n + 0.5]), np.array([w_surface]))[0])
    if abs(whole) < 1e-250:
        return np.asarray(part**n + 0.0j)
    inner = ive(n + 0.5, w) * np.exp(np.abs(w.real) - abs(w_surface.real)) / np.sqrt(part)
    return np.asarray(inner / whole)

"""A conducting, permeable sphere in time: its exact relaxations, and what a sensor samples beside it.

Order n of `hil_sim.world.sphere` answers with chi_n = N/D of z = k a, -z^2 = i omega tau_0, tau_0 = mu sigma a^2. The
zeros z_p of D are real, so chi_n(omega) = chi_n(0) + sum_p A_p i omega tau_p/(1 + i omega tau_p), tau_p = tau_0/z_p^2,
A_p = 2 N/(z D') at z_p: a step is answered with chi_n(0) + sum_p A_p exp(-t/tau_p), exactly.
"""

import dataclasses

import numpy as np
from scipy.optimize import brentq
from scipy.special import spherical_jn

from hil_sim.world.sphere import MU_0, Sphere

ORDERS = 6


def relaxations(sphere, n, fastest_s):
    """Time constants, s, and amplitudes of an order, down to the fastest that matters."""
    mu = sphere.relative_permeability
    tau_0 = MU_0 * mu * sphere.conductivity_S_m * sphere.radius_m**2

    def denominator(z):
        return z * spherical_jn(n - 1, z) + n * (mu - 1.0) * spherical_jn(n, z)

    grid = np.arange(0.05, np.sqrt(tau_0 / fastest_s) + 4.0, 0.05)
    value = denominator(grid)
    change = np.flatnonzero(np.sign(value[1:]) != np.sign(value[:-1]))
    z = np.array([brentq(denominator, grid[i], grid[i + 1], xtol=1e-13) for i in change])
    j, inner = spherical_jn(n, z), spherical_jn(n - 1, z)
    numerator = n / (n + 1) * (z * inner - (n + (n + 1) * mu) * j)
    slope = inner + z * spherical_jn(n - 1, z, derivative=True) + n * (mu - 1.0) * spherical_jn(n, z, derivative=True)
    return tau_0 / z**2, 2.0 * numerator / (z * slope)


def answers(sphere, drives, chip_s):
    """What each order's answer to drives, shape (N, n) and repeating, is at the ends of the chips: (orders, N, n)."""
    chips = len(drives)
    result = []
    for n in range(1, ORDERS + 1):
        tau, amplitude = relaxations(sphere, n, 0.1 * chip_s)
        # A step in chip 0 has left exp(-(m + 1) T/tau) at the end of chip m; one in every earlier cycle, too.
        e = np.exp(-chip_s / tau)
        kernel = np.exp(-np.outer(np.arange(chips) * chip_s, 1.0 / tau)) @ (amplitude * (e - 1.0) / (1.0 - e**chips))
        kernel[0] += amplitude.sum()
        late = np.fft.ifft(np.fft.fft(kernel)[:, None] * np.fft.fft(drives, axis=0), axis=0).real
        static = sphere.susceptibilities(0.0, n)[n - 1].real
        result.append(static * drives + late)
    return np.array(result)


def added(sphere, answer, source_m, moment_A_m2):
    """Field, tesla, that the sphere adds at the origin to the samples of a cycle, shape (N, 3).

    ``answer`` is that of `answers`; sources and moments, shape (n, 3), belong to its drives.
    """
    total = np.zeros((answer.shape[1], 3))
    for n, of_order in enumerate(answer, start=1):
        single = _OneOrder(**{**vars(sphere), "order": n})
        total += MU_0 * of_order @ single.secondary(np.zeros(3), source_m, moment_A_m2, 1.0).real
    return total


@dataclasses.dataclass(frozen=True, eq=False)
class _OneOrder(Sphere):
    """The field of one order for a susceptibility of one."""

    order: int = 1

    def susceptibilities(self, frequency_Hz, orders=120):
        return (np.arange(1, orders + 1) == self.order) + 0.0j

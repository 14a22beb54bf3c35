"""Conductors seen through the separation: eddy currents answer late, and each access hears them so.

A conductor in a field that is switched on opposes it at first and lets it in over its time constants: to the drive
d(t) of a beacon it adds S_0 d + sum_p S_p (d - d * exp(-t/tau_p)/tau_p), a part that follows at once (magnetisation)
and relaxations (poles of a quasi-static conductor are real: Landau, Lifshitz & Pitaevskii, Electrodynamics of
Continuous Media, sec. 59). What is left of a relaxation in the samples at the ends of the chips is the drive minus the
filtered drive (`goldfield.access.rise`); the weights of the site's separation turn that into g_ji(tau), the part of
beacon i's that is found in beacon j's field. For codes it is about exp(-T/tau): what is left at the end of a chip of
length T. For a tone it is the part in phase at its frequency; a sine and a cosine at one frequency each also hear the
part in quadrature of the other.

A model of the conductor knows S(omega), its field as a phasor, of which a relaxation makes the part
(x^2 + i x)/(1 + x^2), x = omega tau. So g is fitted over all tau by such parts at a few frequencies, and the field
found in beacon j is the real part of sum_ik w_jik S_i(omega_k).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from goldfield.access.of_site import SiteAccess
from goldfield.access.rise import filtered
from goldfield.access.waveform import site_templates
from goldfield.errors import UserError
from goldfield.site import Site
from goldfield.types import FloatArray

TAU_CHIPS = np.logspace(-3.0, 6.0, 91)
"""Time constants fitted: from relaxations that are over within a chip to those that last for a thousand cycles."""

LOWEST, HIGHEST = 0.1, 10.0
"""Range of frequencies, radians a chip, of which answers to single chips are composed, within 0.5 %."""

PER_DECADE = 2.0
"""Frequencies a decade."""

SMALLEST_SINGULAR = 1e-3
"""Smallest singular value kept: the weights stay near one and do not multiply a model's errors; costs 0.1 %."""


def eddy_frequencies(site: Site) -> FloatArray:
    """Return the frequencies at which a conductor must be known, Hz, shape (k,).

    They are those of the tones where all drives are sines; else two a decade, from the slowest change of a drive to
    ten radians a chip.

    Raises
    ------
    UserError
        If the phases of tones are unknown.
    """
    if any(beacon.drive.frequency_Hz is not None for beacon in site.beacons):
        raise UserError(
            f'site {site.name}: with phase = "unknown" nothing tells which part of a tone is in phase with '
            "a current, so eddy currents cannot be predicted: leave out --own-body"
        )
    periods = [beacon.drive.periods for beacon in site.beacons if beacon.drive.periods is not None]
    if periods and not site.beacons[0].drive.square:
        return np.array(sorted(set(periods))) / site.cycle_s
    lowest = LOWEST
    if periods:
        lowest = 2.0 * math.pi * min(periods) / site.chips
    elif site.slots:
        lowest = site.slots / site.chips
    count = 2 + math.ceil(PER_DECADE * math.log10(HIGHEST / lowest) - 2.0 + 1e-9)
    return np.asarray(np.geomspace(lowest, HIGHEST, count) / (2.0 * math.pi * site.chip_period_s))


def eddy_weights(site: Site, frequency_Hz: FloatArray) -> NDArray[np.complex128]:
    """Return the weights w of the phasors S, shape (n, n, k).

    The field found in beacon j is Re sum_ik w[j, i, k] S[i, k].

    Parameters
    ----------
    site : Site
    frequency_Hz : ndarray, shape (k,)
        The frequencies of `eddy_frequencies`.
    """
    templates, weights = site_templates(site), SiteAccess(site).weights
    parts = np.stack([weights @ (templates - filtered(templates, tau)) for tau in TAU_CHIPS])
    x = 2.0 * np.pi * site.chip_period_s * np.outer(TAU_CHIPS, frequency_Hz)
    basis = np.hstack([x * x, x]) / np.tile(1.0 + x * x, 2)
    fitted = np.linalg.lstsq(basis, parts.reshape(len(TAU_CHIPS), -1), rcond=SMALLEST_SINGULAR)[0]
    count = len(site.beacons)
    real, imaginary = (part.reshape(-1, count, count) for part in np.split(fitted, 2))
    return np.asarray(np.moveaxis(real - 1j * imaginary, 0, 2))

"""Tones of any frequency in a window of any length, with phases that nobody knows: recordings of one's own.

Each axis is fitted by least squares with a sine and a cosine of each tone and a constant. As the three axes see one
current, a beacon's tone has one phase on all of them: field and phase follow from its three complex amplitudes
z = b exp(i phase), up to the sign of both. A reference channel that records the current decides it; without one the
phase is the one nearest to what the site file says in the first window, and nearest to the last one from then on.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from goldfield.access.cdma import Separation
from goldfield.access.linear import TemplateAccess
from goldfield.access.nuisance import Nuisance, constant, mains, mains_frequency
from goldfield.access.of_site import SiteCycle
from goldfield.site import Site
from goldfield.types import FloatArray

AUDIBLE = 10.0
"""A reference channel holds a tone if its amplitude there is this many standard deviations of its noise."""


class ToneAccess:
    """Tells the tones of a site apart whose phases are unknown, window after window.

    Phases count from the first sample of the first window, as if all windows followed each other without a gap: a
    recorder whose clock is not the transmitters' lets them drift, and up to a quarter of a turn from one window to the
    next the signs hold. Fields need to stand out of the noise: the phase that fits best makes a field of nothing but
    noise 1.3 times as large as its noise, and its sign is chance.

    Parameters
    ----------
    site : Site
        With ``phase = "unknown"``.
    mains_Hz : float, optional
        As for `SiteAccess`.
    harmonics : int

    Raises
    ------
    UserError
        If tones are too near to each other for the window.
    """

    has_offset = True

    def __init__(self, site: Site, mains_Hz: float | None = None, harmonics: int = 1) -> None:
        self._site, self._mains_Hz, self._harmonics = site, mains_Hz, harmonics
        self._turns = np.array([beacon.drive.frequency_Hz for beacon in site.beacons], dtype=float) * site.chip_period_s
        angle = 2.0 * np.pi * np.arange(site.chips)[:, None] * self._turns
        self._columns = np.stack([np.cos(angle), np.sin(angle)], axis=2).reshape(site.chips, -1)
        self._names = [beacon.id for beacon in site.beacons for _ in range(2)]
        self._quiet_mains = self._access(mains_Hz)
        self._told = np.array([beacon.drive.phase_rad for beacon in site.beacons])
        self._last = self._told
        self._windows = 0

    def cycle(self, samples_T: FloatArray, reference: FloatArray | None = None) -> SiteCycle:
        """Separate the next window.

        Parameters
        ----------
        samples_T : ndarray, shape (N, 3)
            NaN where a sample is missing.
        reference : ndarray, shape (N,), optional
            A channel that records the currents, or their sum, in any unit. ``phase_rad`` of a beacon is then that of
            its field less that of its current. A beacon whose tone it does not hold has no field.
        """
        access, mains_Hz = self._quiet_mains, None
        if self._mains_Hz is not None:
            known = np.hstack([self._columns, constant(self._site.chips).columns])
            mains_Hz = mains_frequency(samples_T, known, self._site.chip_period_s, self._mains_Hz, self._harmonics)
            access = self._access(mains_Hz)
        coefficients, variance = access.coefficients(samples_T)
        amplitude = self._from_the_first(coefficients)
        if reference is None:
            phase = _common_phase(amplitude)
            phase = phase + np.pi * np.round((self._last - phase) / np.pi)
            self._last = np.where(np.isfinite(phase), phase, self._last)
        else:
            phase = self._told + self._phase_of_current(access, reference)
        self._windows += 1
        field = (amplitude * np.exp(-1j * phase)[:, None]).real
        larger = variance[: 2 * len(field)].reshape(-1, 2, 3).max(axis=1)  # of sine and cosine
        worst = np.where(np.isfinite(field), larger, -np.inf).max(axis=1)
        sigma = np.where(np.isfinite(worst), self._site.sensor.noise_T * np.sqrt(np.maximum(worst, 0.0)), np.inf)
        offset = coefficients[2 * len(field)]
        turned = np.remainder(phase + np.pi, 2.0 * np.pi) - np.pi
        return SiteCycle(Separation(field, offset, sigma), mains_Hz, None, turned)

    def _from_the_first(self, coefficients: FloatArray) -> NDArray[np.complex128]:
        """Return complex amplitudes, shape (n, k), with phases that count from the first window's first sample."""
        waves = coefficients[: 2 * len(self._turns)].reshape(len(self._turns), 2, -1)
        begun = np.remainder(self._turns * self._windows * self._site.chips, 1.0)
        return np.asarray((waves[:, 0] - 1j * waves[:, 1]) * np.exp(-2j * np.pi * begun)[:, None])

    def _phase_of_current(self, access: TemplateAccess, reference: FloatArray) -> FloatArray:
        """Return the phases of a reference channel's tones, shape (n,); NaN where it holds none, or no value at all."""
        if not np.isfinite(reference).any():
            return np.full(len(self._turns), np.nan)
        alone = np.full((len(reference), 3), np.nan)
        alone[:, 0] = reference
        coefficients, variance = access.coefficients(alone)
        rest = reference - access.columns @ coefficients[:, 0]
        noise = math.sqrt(float(np.nanmean(rest**2))) * np.sqrt(variance[: 2 * len(self._turns) : 2, 0])
        current = self._from_the_first(coefficients[:, :1])[:, 0]
        return np.where(np.abs(current) > AUDIBLE * noise, np.angle(current), np.nan)

    def _access(self, mains_Hz: float | None) -> TemplateAccess:
        nuisances: list[Nuisance] = [constant(self._site.chips)]
        if mains_Hz is not None:
            nuisances.append(mains(self._site.chips, self._site.chip_period_s, mains_Hz, self._harmonics))
        return TemplateAccess(self._names, self._columns, nuisances, self._site.sensor.noise_T)


def _common_phase(amplitude: NDArray[np.complex128]) -> FloatArray:
    """Return the phase, in a half turn, that all axes of each beacon share by least squares, shape (n,).

    It maximises the sum of the squares of Re(z exp(-i phase)); axes that were not measured, NaN, do not count.
    """
    measured = np.isfinite(amplitude)
    squares = (np.where(measured, amplitude, 0.0) ** 2).sum(axis=1)
    return np.where(measured.any(axis=1), 0.5 * np.angle(squares), np.nan)

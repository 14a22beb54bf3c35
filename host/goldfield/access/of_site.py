"""The access that a site asks for: its templates, a constant field, and on demand the mains and unknown coil rise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.access.cdma import Separation
from goldfield.access.linear import TemplateAccess
from goldfield.access.nuisance import Nuisance, constant, mains, mains_frequency
from goldfield.access.rise import LAGS, lagged, tau_from_lags
from goldfield.access.waveform import site_templates
from goldfield.errors import UserError
from goldfield.site import Site
from goldfield.types import FloatArray


@dataclass(frozen=True, eq=False)
class SiteCycle:
    """A separated cycle and what was found on the way.

    Attributes
    ----------
    separation : Separation
    mains_Hz : float or None
        Frequency of the hum that was taken out.
    tau_s : ndarray, shape (n,), or None
        Time constants of the coils, if they were unknown.
    phase_rad : ndarray, shape (n,), or None
        Phases of the tones, -pi to pi, if they were unknown.
    """

    separation: Separation
    mains_Hz: float | None
    tau_s: FloatArray | None
    phase_rad: FloatArray | None = None


class SiteAccess:
    """Tells the beacons of a site apart, by whichever access its file names; an `Access` like the others.

    Parameters
    ----------
    site : Site
    mains_Hz : float, optional
        Nominal frequency of a hum to take out; the true one is searched for in every cycle within half a hertz.
    harmonics : int
        How many multiples of that frequency are taken out, from the first on.
    unknown_rise : bool
        Ignore the file's ``tau_s`` and regress on three lags of the drive, which costs sqrt(3) times the noise.

    Attributes
    ----------
    has_offset : bool
        False if every chip belongs to a time slot: the ambient field then stays in every beacon's field.

    Raises
    ------
    UserError
        If beacons cannot be told apart.
    """

    def __init__(
        self, site: Site, mains_Hz: float | None = None, harmonics: int = 1, unknown_rise: bool = False
    ) -> None:
        self._site, self._mains_Hz, self._harmonics = site, mains_Hz, harmonics
        self._unknown_rise = unknown_rise
        self._templates = site_templates(site, rise=not unknown_rise)
        driven = len(site.beacons) * (site.chips // site.slots) if site.access == "tdma" else 0
        self.has_offset = driven < site.chips
        self._names = [beacon.id for beacon in site.beacons]
        if unknown_rise:
            if site.access == "fdma":
                raise UserError(
                    'with access = "fdma" coil rise cannot be found from samples: it only turns and shrinks a tone; '
                    "give tau_s of each beacon"
                )
            self._templates = lagged(self._templates)
            self._names = [name for name in self._names for _ in range(LAGS)]
        self._nuisances = [constant(site.chips)] if self.has_offset else []
        self._quiet_mains = self._access(mains_Hz)

    @property
    def covariance_T2(self) -> FloatArray:
        """Covariance of the fields from a complete cycle, one axis, shape (n, n); mains at their nominal frequency."""
        whole = self._quiet_mains.covariance_T2
        if not self._unknown_rise:
            return whole
        count = len(whole) // LAGS
        return np.asarray(whole.reshape(count, LAGS, count, LAGS).sum(axis=(1, 3)))

    @property
    def weights(self) -> FloatArray:
        """Weights of a complete cycle's samples in the fields, shape (n, N); mains at their nominal frequency."""
        whole = self._quiet_mains.weights[: self._templates.shape[1]]
        if not self._unknown_rise:
            return whole
        return np.asarray(whole.reshape(-1, LAGS, whole.shape[1]).sum(axis=1))

    def from_samples(self, samples_T: FloatArray) -> Separation:
        """Separate one cycle of samples, shape (N, 3), one row a chip; NaN where a sample is missing."""
        return self.cycle(samples_T).separation

    def cycle(self, samples_T: FloatArray) -> SiteCycle:
        """Separate as `from_samples` and tell what was found on the way."""
        access, mains_Hz = self._quiet_mains, None
        if self._mains_Hz is not None:
            known = np.hstack([self._templates, *(nuisance.columns for nuisance in self._nuisances)])
            mains_Hz = mains_frequency(samples_T, known, self._site.chip_period_s, self._mains_Hz, self._harmonics)
            access = self._access(mains_Hz)
        separation = access.from_samples(samples_T)
        if not self._unknown_rise:
            return SiteCycle(separation, mains_Hz, None)
        count = len(self._site.beacons)
        lags = separation.field_T.reshape(count, LAGS, 3)
        tau = np.array([tau_from_lags(lag[:, np.isfinite(lag).all(axis=0)]) for lag in lags])
        worse = separation.sigma_T / np.sqrt(np.diag(access.covariance_T2))  # 1 unless samples are missing
        sigma = np.sqrt(np.diag(self.covariance_T2)) * worse.reshape(count, LAGS).max(axis=1)
        summed = Separation(lags.sum(axis=1), separation.offset_T, sigma)
        return SiteCycle(summed, mains_Hz, tau * self._site.chip_period_s)

    def _access(self, mains_Hz: float | None) -> TemplateAccess:
        nuisances: list[Nuisance] = list(self._nuisances)
        if mains_Hz is not None:
            nuisances.append(mains(self._site.chips, self._site.chip_period_s, mains_Hz, self._harmonics))
        return TemplateAccess(self._names, self._templates, nuisances, self._site.sensor.noise_T)

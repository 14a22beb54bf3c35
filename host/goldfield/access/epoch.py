"""Separation of a board's reports: turns the report of a cycle into the field of each beacon of the site."""

from __future__ import annotations

import math

import numpy as np

from goldfield.access.cdma import Separator
from goldfield.link.reports import FIELD_LIMIT_T, OFFSET_LIMIT_T, Report
from goldfield.site import Site
from goldfield.types import Fields


class EpochSeparator:
    """Turns reports into fields, with the exact correction for the beacons in use.

    Raises
    ------
    UserError
        If the site's codes cannot be separated.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        tau_chips = [beacon.drive.tau_s / site.chip_period_s for beacon in site.beacons]
        self._separator = Separator(site.degree, site.codes, site.sensor.noise_T, tau_chips)
        self._last: tuple[int, float] | None = None

    def fields(self, report: Report) -> Fields:
        """Separate one report.

        A lost field or one out of range widens the sigma of the others by what it may leak into them; lost and
        saturated chips by the part of the offset that no longer cancels. Fields that did not arrive are left out.
        """
        site = self._site
        correlation = np.array([report.correlation_T.get(code, np.full(3, np.nan)) for code in site.codes])
        arrived = np.array([code in report.correlation_T for code in site.codes])
        magnitudes = np.abs(correlation[np.isfinite(correlation)])
        strongest = float(magnitudes.max()) if magnitudes.size else 0.0
        mean = np.full(3, np.nan) if report.offset_T is None else report.offset_T
        chips = site.chips if report.chips is None else max(1, min(report.chips, site.chips))
        disturbed = site.chips - chips + (report.saturated or 0)
        offset_size = OFFSET_LIMIT_T if np.isnan(mean).any() else float(np.abs(mean).max())
        scale = site.chips / chips
        separation = self._separator.from_correlations(
            correlation * scale,
            mean * scale,
            missing_T=np.where(arrived, 2.0 * FIELD_LIMIT_T, strongest),
            extra_T=offset_size * math.sqrt(disturbed) / site.chips,
        )
        measured = np.asarray(np.isfinite(separation.field_T).any(axis=1))
        return Fields(
            epoch=report.cycle,
            time_s=self._time(report),
            beacons=tuple(b.id for b, seen in zip(site.beacons, measured, strict=True) if seen),
            field_T=separation.field_T[measured],
            sigma_T=separation.sigma_T[measured],
        )

    def _time(self, report: Report) -> float:
        """Return the middle of the cycle; it is counted on from the last known one if the header was lost."""
        if math.isfinite(report.time_s):
            self._last = (report.cycle, report.time_s)
            return report.time_s
        if self._last is None:
            return math.nan
        cycle, time_s = self._last
        return time_s + (report.cycle - cycle) % (1 << 20) * self._site.cycle_s

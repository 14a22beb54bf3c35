"""Separation of a board's reports: turns the report of a cycle into the field of each beacon of the site."""

from __future__ import annotations

import math

import numpy as np

from goldfield.access.cdma import Separation, Separator
from goldfield.link.reports import FIELD_LIMIT_T, OFFSET_LIMIT_T, Report
from goldfield.site import Site
from goldfield.types import Fields, FloatArray

ENTERS = math.sqrt(8.0 * 4.108)
"""Standard deviations of a component of a field above which a sensor takes a code in, whatever its axis
(``firmware/core/codes/strongest.h``: 8 times the upper quartile of chi square with three degrees of freedom)."""

REMEMBERED = 16
"""Sets of strange codes whose separators are kept."""


class EpochSeparator:
    """Turns reports into fields, with the exact correction for the beacons in use.

    Raises
    ------
    UserError
        If the site's codes cannot be separated.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._tau_chips = [beacon.drive.tau_s / site.chip_period_s for beacon in site.beacons]
        self._separators: dict[tuple[int, ...], Separator] = {(): self._separator_with(())}
        self._last: tuple[int, float] | None = None

    def fields(self, report: Report, strongest: int = 0) -> Fields:
        """Separate one report.

        Where the sensor has chosen its codes, at most ``strongest``, one that it left out is weak: it widens the sigma
        of the others by what it may leak at most. Codes that no beacon of the site has are separated with the others.

        A lost field or one out of range widens the sigma of the others by what it may leak into them; lost and
        saturated chips by the part of the offset that no longer cancels. Fields that did not arrive are left out.
        """
        site = self._site
        strangers = tuple(sorted(report.correlation_T.keys() - set(site.codes))) if strongest else ()
        codes = (*site.codes, *strangers)
        correlation = np.array([report.correlation_T.get(code, np.full(3, np.nan)) for code in codes])
        arrived = np.array([code in report.correlation_T for code in codes])
        magnitudes = np.abs(correlation[np.isfinite(correlation)])
        largest = float(magnitudes.max()) if magnitudes.size else 0.0
        mean = np.full(3, np.nan) if report.offset_T is None else report.offset_T
        chips = site.chips if report.chips is None else max(1, min(report.chips, site.chips))
        disturbed = site.chips - chips + (report.saturated or 0)
        offset_size = OFFSET_LIMIT_T if np.isnan(mean).any() else float(np.abs(mean).max())
        scale = site.chips / chips

        def separated(unheard_T: float) -> Separation:
            return self._separator(strangers).from_correlations(
                correlation * scale,
                mean * scale,
                missing_T=np.where(arrived, 2.0 * FIELD_LIMIT_T, unheard_T),
                extra_T=offset_size * math.sqrt(disturbed) / site.chips,
            )

        separation = separated(largest)
        if strongest and report.announced is not None and len(report.correlation_T) >= report.announced:
            separation = separated(min(largest, self._left_out_T(separation.field_T[arrived], strongest)))
        measured = np.asarray(np.isfinite(separation.field_T).any(axis=1))[: len(site.beacons)]
        return Fields(
            epoch=report.cycle,
            time_s=self._time(report),
            beacons=tuple(b.id for b, seen in zip(site.beacons, measured, strict=True) if seen),
            field_T=separation.field_T[: len(measured)][measured],
            sigma_T=separation.sigma_T[: len(measured)][measured],
        )

    def _separator(self, strangers: tuple[int, ...]) -> Separator:
        if strangers not in self._separators:
            if len(self._separators) > REMEMBERED:
                del self._separators[next(iter(self._separators.keys() - {()}))]
            self._separators[strangers] = self._separator_with(strangers)
        return self._separators[strangers]

    def _separator_with(self, strangers: tuple[int, ...]) -> Separator:
        site = self._site
        tau_chips = [*self._tau_chips, *(0.0 for _ in strangers)]
        return Separator(site.degree, (*site.codes, *strangers), site.sensor.noise_T, tau_chips)

    def _left_out_T(self, chosen_T: FloatArray, strongest: int) -> float:
        """Return how strong a code may be that the sensor did not choose: what it would have had to exceed."""
        site = self._site
        enters_T = ENTERS * site.sensor.noise_T / math.sqrt(site.chips)
        if len(chosen_T) < min(strongest, (site.chips + 1) // 8):
            return enters_T
        weakest_T = float(np.linalg.norm(np.nan_to_num(chosen_T), axis=1).min())
        return math.sqrt(2.0) * math.hypot(weakest_T, enters_T)

    def _time(self, report: Report) -> float:
        """Return the middle of the cycle; it is counted on from the last known one if the header was lost."""
        if math.isfinite(report.time_s):
            self._last = (report.cycle, report.time_s)
            return report.time_s
        if self._last is None:
            return math.nan
        cycle, time_s = self._last
        return time_s + (report.cycle - cycle) % (1 << 20) * self._site.cycle_s

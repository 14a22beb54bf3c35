"""Separation of a board's reports: turns the report of a cycle into the field of each beacon of the site."""

from __future__ import annotations

import math

import numpy as np

from goldfield.access.cdma import Separation, Separator
from goldfield.access.hum import hum_deviations
from goldfield.access.users import CodeUsers
from goldfield.link.reports import FIELD_LIMIT_T, OFFSET_LIMIT_T, Report
from goldfield.site import Site
from goldfield.types import Fields, FloatArray

ENTERS = math.sqrt(8.0 * 4.108)
"""Standard deviations of a component of a field above which a sensor takes a code in, whatever its axis
(``firmware/core/codes/strongest.h``: 8 times the upper quartile of chi square with three degrees of freedom)."""

MOST_AT_A_TIME = 64
"""Most codes that a sensor reports: the codes of a site with more beacons never have to be separated all at once."""

REMEMBERED = 16
"""Sets of strange codes whose separators are kept."""


class EpochSeparator:
    """Turns reports into fields, with the exact correction for the beacons in use.

    Where beacons share codes, the field of a code is that of the beacon which is near the others that are heard
    (`CodeUsers`); a code of which that is not told has no field.

    Raises
    ------
    UserError
        If the site's codes cannot be separated.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._users = CodeUsers(site)
        self._hum_T = hum_deviations(site)
        self._codes = self._users.codes
        drives = [site.beacons[self._users.first(code)].drive for code in self._codes]
        self._tau_chips = [drive.tau_s / site.chip_period_s for drive in drives]
        self._separators: dict[tuple[int, ...], Separator] = {(): self._separator_with(())}
        self._last: tuple[int, float] | None = None

    def fields(self, report: Report, strongest: int = 0) -> Fields:
        """Separate one report.

        Where the sensor has chosen its codes, at most ``strongest``, one that it left out is weak: it widens the sigma
        of the others by what it may leak at most. Codes that no beacon of the site has are separated with the others.

        A lost field or one out of range widens the sigma of the others by what it may leak into them; lost and
        saturated chips by the part of the offset that no longer cancels; and the hum of the mains that of each code by
        its own part. Fields that did not arrive are left out.
        """
        site = self._site
        strangers = tuple(sorted(report.correlation_T.keys() - set(self._codes))) if strongest else ()
        codes = (*self._codes, *strangers)
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
        rows, beacons = self._heard(separation.field_T[: len(self._codes)])
        return Fields(
            epoch=report.cycle,
            time_s=self._time(report),
            beacons=tuple(site.beacons[index].id for index in beacons),
            field_T=separation.field_T[rows],
            sigma_T=np.hypot(separation.sigma_T[rows], self._hum_T[beacons]),
        )

    def _heard(self, field_T: FloatArray) -> tuple[list[int], list[int]]:
        """Return the rows of codes whose field was measured, and the beacons that they are of, in the site's order."""
        rows = np.flatnonzero(np.isfinite(field_T).any(axis=1))
        strength = np.linalg.norm(np.nan_to_num(field_T[rows]), axis=1)
        users = self._users.heard([self._codes[row] for row in rows.tolist()], strength)
        told = sorted((user, row) for user, row in zip(users, rows.tolist(), strict=True) if user is not None)
        return [row for _, row in told], [user for user, _ in told]

    def _separator(self, strangers: tuple[int, ...]) -> Separator:
        if strangers not in self._separators:
            if len(self._separators) > REMEMBERED:
                del self._separators[next(iter(self._separators.keys() - {()}))]
            self._separators[strangers] = self._separator_with(strangers)
        return self._separators[strangers]

    def _separator_with(self, strangers: tuple[int, ...]) -> Separator:
        site = self._site
        tau_chips = [*self._tau_chips, *(0.0 for _ in strangers)]
        some = len(self._codes) > MOST_AT_A_TIME
        return Separator(site.degree, (*self._codes, *strangers), site.sensor.noise_T, tau_chips, some=some)

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

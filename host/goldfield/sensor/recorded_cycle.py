"""Whether a recording was made with the site's degree: a live sensor is asked, a recording's cycles show it."""

from __future__ import annotations

import math

from goldfield.errors import UserError
from goldfield.link.reports import CYCLE_MODULUS, Report
from goldfield.site import Site

TOLERANCE = 0.1
"""Largest relative error of a cycle's duration from the site's: the next degree doubles it, clocks differ by ppm."""
IN_A_ROW = 3
"""Cycles that must differ in turn: a restart, or two sensors of one number, make single ones differ."""
FARTHEST = 8
"""Cycles between two headers from which a duration is still taken."""


class RecordedCycle:
    """Checks the cycles of a recording, one after another.

    Parameters
    ----------
    name : str
        The recording, for messages.
    site : Site
    """

    def __init__(self, name: str, site: Site) -> None:
        self._name = name
        self._site = site
        self._before: tuple[int, float] | None = None
        self._differ = 0

    def check(self, report: Report) -> None:
        """Check the next cycle.

        Raises
        ------
        UserError
            If it has more chips than the site's degree, or lasts longer or shorter several times in a row.
        """
        site = self._site
        if report.chips is not None and report.chips > site.chips:
            raise UserError(
                f"{self._name}: a cycle of the sensor has {report.chips} chips, one of the site {site.chips} (degree "
                f"{site.degree}): correct the site's degree"
            )
        if math.isnan(report.time_s):
            return
        before, self._before = self._before, (report.cycle, report.time_s)
        steps = 0 if before is None else (report.cycle - before[0]) % CYCLE_MODULUS
        if before is None or not 0 < steps <= FARTHEST or report.time_s <= before[1]:
            return
        cycle_s = (report.time_s - before[1]) / steps
        self._differ = self._differ + 1 if abs(cycle_s / site.cycle_s - 1.0) > TOLERANCE else 0
        if self._differ >= IN_A_ROW:
            raise UserError(
                f"{self._name}: a cycle of the sensor lasts {cycle_s:.3g} s, one of the site {site.cycle_s:.3g} s: "
                "correct the site's degree or chip_period_s"
            )

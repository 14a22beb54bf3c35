"""Codes that a sensor hears though no beacon of the site has them, told where the sensor chooses what it reports."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from goldfield.access.gold import code_matrix
from goldfield.link.reports import Report
from goldfield.site import Site

PATIENCE = 10
"""Cycles in a row after which a stranger is told: noise alone brings a code for a cycle, seldom for two."""


class Strangers:
    """Tells each such code once.

    Parameters
    ----------
    site : Site
    tell : callable
        Takes the sentence.
    """

    def __init__(self, site: Site, tell: Callable[[str], object]) -> None:
        self._codes, self._degree = frozenset(site.codes), site.degree
        self._tell = tell
        self._heard: dict[int, int] = {}
        self._told: set[int] = set()

    def take(self, report: Report) -> None:
        """Take the report of the next cycle; one of which nothing arrived says nothing."""
        if not report.correlation_T:
            return
        strangers = report.correlation_T.keys() - self._codes
        self._heard = {code: self._heard.get(code, 0) + 1 for code in strangers}
        for code in sorted(strangers):
            if self._heard[code] >= PATIENCE and code not in self._told:
                self._told.add(code)
                size_T = self._size_T(report, code)
                self._tell(f"code {code} is heard, {1e9 * size_T:.0f} nT, and is no beacon of the site")

    def _size_T(self, report: Report, code: int) -> float:
        """Return the size of a field without what the ambient one leaves in its correlation."""
        mean = float(code_matrix(self._degree, [code]).mean())
        ambient_T = np.zeros(3) if report.offset_T is None else mean * report.offset_T
        return float(np.linalg.norm(np.nan_to_num(report.correlation_T[code] - ambient_T)))

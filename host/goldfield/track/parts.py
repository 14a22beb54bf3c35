"""Thirds of a cycle, as a sensor with parameter ``parts`` = 3 sends them: observations of a moving sensor."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from goldfield.link.reports import Report
from goldfield.site import Site
from goldfield.track.motion import Observation, State
from goldfield.track.observe import CycleData, CycleObserver, EpochObserver
from goldfield.types import Fields, Pose

PARTS = 3
PART_STRIDE = 1026
PLAIN = 1025
"""Index of a ``PART``: part * 1026 + code; 1025 in place of the code: the plain sum (framing.md)."""


def sensor_sends_parts(site: Site) -> bool:
    """Tell whether a sensor's parts serve on this site: each beacon has its own code of degree 10."""
    return site.access == "cdma" and site.degree == 10 and len(set(site.codes)) == len(site.beacons)


def cycle_of_parts(site: Site, report: Report, time_s: float) -> CycleData | None:
    """Return the partial sums of a report as data of `CycleObserver`.

    Parameters
    ----------
    site : Site
    report : Report
    time_s : float
        Middle of the cycle.

    Returns
    -------
    CycleData or None
        None if a part is missing, or if chips were lost or saturated: the fields then tell more.
    """
    if report.chips != site.chips or report.saturated or not sensor_sends_parts(site):
        return None
    indices = [part * PART_STRIDE + code for part in range(PARTS) for code in (*site.codes, PLAIN)]
    if not all(index in report.parts_T for index in indices):
        return None
    sums = site.chips * np.array([report.parts_T[index] for index in indices])
    return CycleData(report.cycle, time_s, tuple(beacon.id for beacon in site.beacons), sums)


class PartsObserver:
    """Observes the parts of cycles where they came whole, and separated fields where not."""

    def __init__(self, site: Site) -> None:
        self._site = site
        self._fields = EpochObserver(site)

    @cached_property
    def _parts(self) -> CycleObserver:
        return CycleObserver(self._site, PARTS)

    def start(self, data: Fields | CycleData) -> tuple[Pose, State | None]:
        """See `Observer.start`."""
        return self._parts.start(data) if isinstance(data, CycleData) else self._fields.start(data)

    def observation(
        self, data: Fields | CycleData, rate_rad_s: float, without: Sequence[str] = ()
    ) -> tuple[Observation, tuple[str, ...]]:
        """See `Observer.observation`."""
        if isinstance(data, CycleData):
            return self._parts.observation(data, rate_rad_s, without)
        return self._fields.observation(data, rate_rad_s, without)

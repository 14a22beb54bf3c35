"""What a moving sensor's own motion does to separated fields, taken out by how the fields go on from cycle to cycle.

While the sensor moves, the field of each beacon changes during the cycle. Codes do not cancel a ramp: a little of each
beacon's change appears in all others, as the product of the change, the code and a ramp. And the mean of a field that
curves is not the field of the middle. At 0.5 m/s and 1 rad/s both are as large as the noise of 0.2 mG a sample. Two
cycles before tell how the fields change, as the ambient field's do in `goldfield.access.sweep`.

What the noise adds to slopes and bends makes that of a single cycle 3 % less, and leaves that of a mean of many as it
was; the fields' deviations stay as they are.

Trackers do not want this: their model has the motion during the cycle. It is for who takes each cycle for an instant.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from goldfield.access.moving import sample_times
from goldfield.access.sweep import REMEMBERED, cycle_weights
from goldfield.site import Site
from goldfield.types import Fields, FloatArray

STEP_TOLERANCE = 0.25
"""Largest part of a cycle by which the time between two neighbours differs from one."""
ABRUPT, ABRUPT_SIGMAS = 0.25, 20.0
"""Size of a change of the change, over the field's size, and over its noise, from which on both together it is no
motion of a hand but a fault, or a table of poses that do not follow each other. A turn of 1 rad/s makes 0.01 of the
field, 0.5 m/s at 0.4 m 0.15; the noise alone has a root of the mean square of 4.2 sigma, all three axes."""


def is_next(site: Site, fields: Fields, before: Fields) -> bool:
    """Tell whether fields are of the next cycle after others."""
    return abs((fields.time_s - before.time_s) / site.cycle_s - 1.0) < STEP_TOLERANCE


class MotionRepair:
    """Follows the fields of one sensor.

    Parameters
    ----------
    site : Site
        Each beacon with one plain code; another site's fields are returned as they are.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._plain = all(beacon.code >= 0 for beacon in site.beacons)
        self._leaks: dict[tuple[str, ...], tuple[FloatArray, FloatArray]] = {}
        self._past: deque[Fields] = deque(maxlen=3)

    def repaired(self, fields: Fields) -> Fields:
        """Return the fields of the next cycle as those of its middle; as they came before the third cycle in a row.

        They also stay as they are where one of them changes more abruptly than motion explains. How a field changes
        that the two cycles before do not have, or not on the same axes, is not known and stays in all of them: a sensor
        that reports the strongest beacons takes in a weak one each second as it walks, and the others go on.
        """
        if not self._plain or not fields.beacons:
            self._past.clear()
            return fields
        if self._past and not is_next(self._site, fields, self._past[-1]):
            self._past.clear()
        self._past.append(fields)
        if len(self._past) < 3:
            return fields
        past = np.array([_rows(one, fields.beacons) for one in self._past])
        known = (np.isfinite(past) == np.isfinite(fields.field_T)).all(axis=(0, 2))
        if not known.any():
            return fields
        oldest, before, now = np.where(known[:, None], np.nan_to_num(past), 0.0)
        change = now - before
        bend = change - (before - oldest)
        limit = ABRUPT * np.linalg.norm(now, axis=1) + ABRUPT_SIGMAS * np.where(
            np.isfinite(fields.sigma_T), fields.sigma_T, 0.0
        )
        if (np.linalg.norm(bend, axis=1) > limit).any():
            return fields
        by_slope, by_bend = self._leaks_of(fields.beacons)
        return replace(fields, field_T=fields.field_T - by_slope @ (change + 0.5 * bend) - by_bend @ bend)

    def _leaks_of(self, beacons: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
        """Return what slopes and bends of all fields, a cycle and a squared cycle, do to each, shape (n, n) both."""
        if beacons not in self._leaks:
            if len(self._leaks) >= REMEMBERED:
                self._leaks.clear()
            weights, templates = cycle_weights(self._site, beacons)
            time = sample_times(self._site.chips)[:, None]
            self._leaks[beacons] = weights @ (templates * time), weights @ (templates * (0.5 * time**2))
        return self._leaks[beacons]


def _rows(fields: Fields, beacons: tuple[str, ...]) -> FloatArray:
    """Return the fields of these beacons, shape (n, 3); NaN for one that is not among them."""
    rows = dict(zip(fields.beacons, fields.field_T, strict=True))
    return np.array([rows.get(name, np.full(3, np.nan)) for name in beacons])

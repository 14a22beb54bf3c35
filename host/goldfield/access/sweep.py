"""The ambient field's ramp, taken out of fields that were separated on [codes, 1].

A turning sensor sweeps the earth's field, hundreds of times a beacon's, over its axes, and codes do not cancel a ramp:
1 rad/s costs 20 mm where 7 mm are possible (maths.md, 4). A sensor that sends only its correlations and the mean of
each cycle still tells the ramp: by how the mean goes on from cycle to cycle.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from goldfield.access.gold import code_matrix
from goldfield.access.moving import sample_times, separation_weights
from goldfield.access.waveform import beacon_template
from goldfield.site import Site
from goldfield.types import Fields, FloatArray

LONGEST_STEP = 1.5
"""Cycles further apart than this many are no neighbours."""

PART_OF_CHANGE = 0.5
"""Standard deviation of the ramp as a part of the change that the latest of three cycles makes to it."""

REMEMBERED = 64
"""Sets of beacons whose shapes are kept."""


class SweepRepair:
    """Follows the mean of the cycles of one sensor.

    Parameters
    ----------
    site : Site
        Each beacon with one plain code; another site's fields are returned as they are.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._codes = {beacon.id: beacon.code for beacon in site.beacons}
        self._shapes: dict[tuple[str, ...], tuple[FloatArray, FloatArray]] = {}
        self._past: deque[tuple[float, FloatArray]] = deque(maxlen=3)

    def repaired(self, fields: Fields, mean_T: FloatArray | None) -> Fields:
        """Return the fields without the ramp, and with ``sweep_T_s``; as they came before the third cycle in a row.

        Parameters
        ----------
        fields : Fields
            Separated fields of the next cycle.
        mean_T : ndarray, shape (3,), or None
            Mean of all samples; None, or NaN on an axis that was measured, if not known: three more are then needed.
        """
        if mean_T is None or not np.isfinite(fields.time_s) or not fields.beacons or min(self._codes.values()) < 0:
            self._past.clear()
            return fields
        shape, sums = self._shape(fields.beacons)
        axes = np.isfinite(fields.field_T).any(axis=0)
        offset = np.where(axes, mean_T - sums @ np.nan_to_num(fields.field_T), 0.0)
        if not np.isfinite(offset).all():
            self._past.clear()
            return fields
        if self._past and not 0.0 < fields.time_s - self._past[-1][0] < LONGEST_STEP * self._site.cycle_s:
            self._past.clear()
        self._past.append((fields.time_s, offset))
        if len(self._past) < 3:
            return fields
        (t0, o0), (t1, o1), (t2, o2) = self._past
        before, latest = (o1 - o0) / (t1 - t0), (o2 - o1) / (t2 - t1)
        change = (latest - before) * (t2 - t1) / (t2 - t0)  # to the slope at t2 of the parabola through the three
        sigma = PART_OF_CHANGE * float(np.linalg.norm(change))
        return replace(fields, field_T=fields.field_T - np.outer(shape, latest + change), sweep_T_s=sigma)

    def _shape(self, beacons: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
        """Return the error of the fields by a ramp of 1 T/s, s, and the codes' means, both of shape (n,)."""
        if beacons not in self._shapes:
            if len(self._shapes) >= REMEMBERED:
                self._shapes.clear()
            codes = [self._codes[name] for name in beacons]
            ramp = self._site.cycle_s * sample_times(self._site.chips)
            chips: NDArray[np.int8] = code_matrix(self._site.degree, codes)
            self._shapes[beacons] = cycle_weights(self._site, beacons)[0] @ ramp, chips.mean(axis=0)
        return self._shapes[beacons]


def cycle_weights(site: Site, beacons: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Return the samples' weights in the separated fields, shape (n, N), and what the samples hold of each, (N, n)."""
    templates = np.stack([beacon_template(site, site.beacon(name)) for name in beacons], axis=1)
    codes = [site.beacon(name).code for name in beacons]
    return separation_weights(site.degree, codes, templates=templates)[:-1], templates

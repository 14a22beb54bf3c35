"""Which beacon of several with one code a sensor hears: the one that is where the others are that it hears."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from goldfield.site import Site
from goldfield.types import FloatArray

ASKED = 3
"""The strongest codes of a cycle: each of their beacons may be the one that the sensor is near to."""

APART = 1.25
"""By how much the second best place must fit worse than the best, or nothing is told."""


class CodeUsers:
    """The beacons of each code of a site.

    Parameters
    ----------
    site : Site

    Attributes
    ----------
    codes : tuple of int
        Every code once, in the order of the site.
    """

    def __init__(self, site: Site) -> None:
        self._users: dict[int, list[int]] = {}
        for index, code in enumerate(site.codes):
            self._users.setdefault(code, []).append(index)
        self.codes = tuple(self._users)
        self._place_m = np.array([beacon.position_m for beacon in site.beacons]).reshape(-1, 3)

    def first(self, code: int) -> int:
        """Return the index of the first beacon of a code."""
        return self._users[code][0]

    def heard(self, codes: Sequence[int], strength_T: FloatArray) -> list[int | None]:
        """Return the index of the beacon that is heard of each code; None where nobody can tell.

        Each beacon of the strongest codes is a place where the sensor may be; there the nearest beacon of every code
        is taken. The place counts where the sum of their distances is least.

        Parameters
        ----------
        codes : sequence of int
            Different codes of the site.
        strength_T : ndarray, shape (k,)
            Magnitudes of their fields; NaN counts as 0.
        """
        users = [self._users[code] for code in codes]
        if all(len(of) == 1 for of in users):
            return [of[0] for of in users]
        strongest = np.argsort(-np.nan_to_num(strength_T), kind="stable")[:ASKED].tolist()
        candidates = sorted({index for place in strongest for index in users[place]})
        nearest, cost = self._nearest(candidates, users)
        best = int(cost.argmin())
        shared = np.array([len(of) > 1 for of in users])
        elsewhere = 2 * (nearest != nearest[best]).sum(axis=1) > shared.sum()
        rival = float(cost[elsewhere].min(initial=np.inf))
        told = rival > APART * float(cost[best])
        return [
            int(index) if told or not several else None
            for index, several in zip(nearest[best].tolist(), shared.tolist(), strict=True)
        ]

    def _nearest(self, candidates: list[int], users: list[list[int]]) -> tuple[NDArray[np.intp], FloatArray]:
        """Return the beacon of each code that is nearest to each candidate, shape (m, k), and what these cost, (m,)."""
        centre = self._place_m[candidates]
        nearest = np.empty((len(candidates), len(users)), dtype=np.intp)
        cost = np.zeros(len(candidates))
        for column, of in enumerate(users):
            distance = np.linalg.norm(centre[:, None] - self._place_m[of], axis=2)
            best = distance.argmin(axis=1)
            nearest[:, column] = np.array(of)[best]
            cost += distance[np.arange(len(candidates)), best]
        return nearest, cost

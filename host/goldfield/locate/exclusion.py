"""Exclusion: the one or two beacons without which the rest of an epoch agrees.

Every beacon, and if need be every pair, is left out in turn; the rest is fitted from a few poses that the whole and the
other subsets gave, so that the work is bounded: some five fits a beacon, and as many a pair.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from goldfield.locate.constellation import Constellation
from goldfield.locate.fit import Fit, Measurements, stacked

LEAST_FOR_ONE, LEAST_FOR_TWO = 5, 7
"""Beacons that must be heard to leave out one, and two: the rest must be a clear majority that can still be tested."""

POOL = 3
"""Poses from which each subset is fitted beside its own."""


@dataclass(frozen=True)
class Subsets:
    """Fits of one epoch without some of its beacons, the lowest cost first.

    Attributes
    ----------
    left_out : ndarray of int, shape (s, k)
        Rows of the k beacons that each subset lacks.
    fit : Fit
        The s poses.
    """

    left_out: NDArray[np.intp]
    fit: Fit


def without_one(constellation: Constellation, measurements: Measurements, poses: Fit) -> Subsets:
    """Fit one epoch without each of its beacons in turn, from given poses and from those of the other subsets."""
    single = np.arange(len(constellation.model))[:, None]
    return _without(constellation, measurements, single, poses)


def without_two(constellation: Constellation, measurements: Measurements, ones: Subsets) -> Subsets:
    """Fit one epoch without each pair of its beacons, from the poses that leaving out one of them gave."""
    pairs = np.array(list(combinations(range(len(constellation.model)), 2)), dtype=np.intp)
    return _without(constellation, measurements, pairs, ones.fit.take(np.arange(min(POOL, len(ones.left_out)))))


def _without(
    constellation: Constellation, measurements: Measurements, left_out: NDArray[np.intp], poses: Fit
) -> Subsets:
    count = len(left_out)
    mask = np.zeros((count, len(constellation.model)), dtype=bool)
    mask[np.arange(count)[:, None], left_out] = True
    thinned = measurements.take(np.zeros(count, dtype=np.intp)).without(mask)
    chain = thinned.complete
    best = constellation.from_magnitudes(thinned) if chain else _solved(constellation, measurements, mask)
    best = _better_from(constellation, thinned, best, poses)
    order = np.argsort(np.where(np.isfinite(best.cost), best.cost, np.inf))
    # The poses of the best subsets are starts for the others: a fit that ended in the wrong valley is found out.
    best = _better_from(constellation, thinned, best, best.take(order[:POOL]))
    order = np.argsort(np.where(np.isfinite(best.cost), best.cost, np.inf))
    return Subsets(left_out[order], best.take(order))


def _solved(constellation: Constellation, measurements: Measurements, mask: NDArray[np.bool_]) -> Fit:
    """Search the pose of each subset: where the chain of magnitudes cannot be used."""
    found = []
    for row in mask:
        kept = np.flatnonzero(~row)
        found.append(constellation.subset(kept).solve(measurements.of_beacons(kept)).best)
    return stacked(found)


def _better_from(constellation: Constellation, thinned: Measurements, best: Fit, poses: Fit) -> Fit:
    """Fit every subset from every pose too and keep what costs less."""
    usable = poses.take(np.flatnonzero(np.isfinite(poses.cost)))
    subsets, starts = len(best.cost), len(usable.cost)
    if not starts:
        return best
    which = np.repeat(np.arange(subsets), starts)
    start = usable.take(np.tile(np.arange(starts), subsets))
    fitted = constellation.refine(thinned.take(which), start.position_m, start.rotation)
    cost = np.where(np.isfinite(fitted.cost), fitted.cost, np.inf).reshape(subsets, starts)
    chosen = fitted.take(np.arange(subsets) * starts + cost.argmin(axis=1))
    better = np.flatnonzero(~(best.cost <= chosen.cost) & np.isfinite(chosen.cost))
    result = best.take(np.arange(subsets))
    result.put(better, chosen.take(better))
    return result

"""Exclusion: the one or two beacons without which the rest of an epoch agrees.

Every beacon, and if need be every pair of the likeliest, is left out in turn; the rest is fitted from a few poses that
the whole and the other subsets gave, so that the work is bounded: some five rough fits a beacon, six a pair, and a few
fits to the end. `searched_without_one` looks further: it searches all of space for the pose of each subset.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from goldfield.locate import kernel
from goldfield.locate.constellation import ROBUST_MODEL_ERROR, ROUGH_TOLERANCE, Constellation
from goldfield.locate.fit import TOLERANCE, Fit, Measurements, fit_pose, stacked
from goldfield.locate.solutions import nowhere
from goldfield.types import FloatArray

LEAST_FOR_ONE, LEAST_FOR_TWO = 5, 7
"""Beacons that must be heard to leave out one, and two: the rest must be a clear majority that can still be tested."""

POOL = 3
"""Subsets whose poses are starts for all the others: a fit that ended in the wrong valley is found out."""

CLEAR = 25.0
"""Cost by which an explanation must be better than the next: 270,000 to one, which pays for what was tried."""

ROUGH_ITERATIONS, FINAL_ITERATIONS = 15, 120
"""The most evaluations of a fit with model error, which compares the subsets, and of one without."""

_HOW = {
    "model_error": ROBUST_MODEL_ERROR,
    "rough_iterations": ROUGH_ITERATIONS,
    "rough_tolerance": ROUGH_TOLERANCE,
    "final_iterations": FINAL_ITERATIONS,
    "final_tolerance": TOLERANCE,
    "pool": POOL,
    "clear_cost": CLEAR,
}
"""What the kernel in C is told of the above."""

SUBSET_EVALUATIONS = 600
"""Evaluations of the search of a subset's pose, where no subset fits the poses that are known."""

MOST_SEARCHED = 12
"""Subsets whose poses are searched. Subsets of more beacons begin from the poses that are known: one beacon of many
spoils no start."""

MOST_IN_PAIRS = 12
"""Beacons of which all pairs are left out: those without which the rest costs the least; the first of them goes with
every other beacon, too."""


@dataclass(frozen=True)
class Subsets:
    """Fits of one epoch without some of its beacons, the lowest cost first.

    Attributes
    ----------
    left_out : ndarray of int, shape (s, k)
        Rows of the k beacons that each subset lacks.
    fit : Fit
        The s poses.
    hopeless : bool
        True if no subset fits its pose even with model error.
    """

    left_out: NDArray[np.intp]
    fit: Fit
    hopeless: bool


def without_one(constellation: Constellation, measurements: Measurements, poses: Fit) -> Subsets:
    """Fit one epoch without each of its beacons in turn, from given poses and from those of the other subsets."""
    count = len(constellation.model)
    usable = np.flatnonzero(np.isfinite(poses.cost))
    starts = poses.take(np.tile(usable, count))
    return _without(constellation, measurements, np.arange(count)[:, None], starts)


def without_two(constellation: Constellation, measurements: Measurements, ones: Subsets) -> Subsets:
    """Fit one epoch without each pair of its likeliest beacons, from the poses that leaving out either gave."""
    every = combinations(range(len(ones.left_out)), 2)
    ranks = np.array([(a, b) for a, b in every if a == 0 or b < MOST_IN_PAIRS], dtype=np.intp)
    return _without(constellation, measurements, ones.left_out[ranks, 0], ones.fit.take(ranks.ravel()))


def searched_without_one(constellation: Constellation, measurements: Measurements, ones: Subsets) -> Subsets:
    """Search all of space for the pose of each subset, too: near coils the chain of magnitudes fails.

    Sensors without three axes, more than `MOST_SEARCHED` subsets, and epochs whose budget ends keep what they have.
    """
    thinned = _thinned(measurements, ones.left_out)
    within = len(ones.left_out) <= MOST_SEARCHED and thinned.complete
    within &= thinned.affordable(len(constellation.model), SUBSET_EVALUATIONS) == SUBSET_EVALUATIONS
    found = constellation.searched(thinned, SUBSET_EVALUATIONS, at_any_cost=False) if within else None
    if found is None:
        return ones
    best = _rough(constellation, thinned, found[0][:, 0], found[1][:, 0])
    return _compared(constellation, thinned, best, ones.fit, ones.left_out)


def _without(
    constellation: Constellation, measurements: Measurements, left_out: NDArray[np.intp], starts: Fit
) -> Subsets:
    """Fit without each of s subsets, from as many starts each, subset by subset, and from the chain of magnitudes.

    Of more than `MOST_SEARCHED` beacons the starts are enough.
    """
    thinned = _thinned(measurements, left_out)
    count = len(left_out)
    if len(constellation.model) > MOST_SEARCHED:
        best = nowhere(count)
    elif thinned.complete:
        best = _rough(constellation, thinned, *constellation.starts(thinned))
    elif count <= MOST_SEARCHED:
        best = _solved(constellation, measurements, left_out)
    else:
        best = nowhere(count)
    return _compared(constellation, thinned, best, starts, left_out)


def _thinned(measurements: Measurements, left_out: NDArray[np.intp]) -> Measurements:
    """Return the epoch once without each of s subsets."""
    count = len(left_out)
    mask = np.zeros((count, measurements.known.shape[1]), dtype=bool)
    mask[np.arange(count)[:, None], left_out] = True
    return measurements.take(np.zeros(count, dtype=np.intp)).without(mask)


def _compared(
    constellation: Constellation, thinned: Measurements, best: Fit, starts: Fit, left_out: NDArray[np.intp]
) -> Subsets:
    """Fit the subsets from their starts and from each other's best poses, and end those fits that matter.

    Rough fits compare the subsets. Only those that may still cost as little as the best are fitted to the end, because
    a cost with model error is less than one without; the others keep their rough pose and cost. If no subset fits even
    with model error all keep it. The kernel in C does it where it knows the coils; the NumPy code computes the same.
    """
    quick = kernel.of(constellation.model)
    if quick is not None and thinned.levers is None and len(left_out) <= kernel.MOST_SUBSETS:
        hopeless, evaluations = quick.fit_subsets(
            thinned.field_T,
            thinned.sigma_T,
            thinned.noise_T,
            best.parts(),
            starts.position_m,
            starts.rotation,
            errors=thinned.errors,
            most_evaluations=thinned.affordable_in_all(len(constellation.model)),
            unfit_cost=constellation.unfit,
            **_HOW,
        )
        thinned.spend(evaluations, len(constellation.model))
    else:
        best = _better_from(constellation, thinned, best, starts)
        best = _better_from(constellation, thinned, best, best.take(np.tile(_order(best)[:POOL], len(left_out))))
        hopeless = not (best.cost < constellation.unfit).any()
        if not hopeless:
            _end(constellation, thinned, best)
    order = _order(best)
    return Subsets(left_out[order], best.take(order), hopeless)


def _end(constellation: Constellation, thinned: Measurements, best: Fit) -> None:
    """End the fits that matter, in place."""
    done = _order(best)[:POOL]
    _finish(constellation, thinned, best, done)
    likely = best.cost < best.cost[done].min() + CLEAR
    likely[done] = False
    _finish(constellation, thinned, best, np.flatnonzero(likely))


def _order(fits: Fit) -> NDArray[np.intp]:
    return np.argsort(np.where(np.isfinite(fits.cost), fits.cost, np.inf))


def _rough(
    constellation: Constellation,
    measurements: Measurements,
    position: FloatArray,
    rotation: FloatArray,
    iterations: int = ROUGH_ITERATIONS,
) -> Fit:
    return fit_pose(
        constellation.model,
        measurements,
        position,
        rotation,
        model_error=ROBUST_MODEL_ERROR,
        iterations=iterations,
        tolerance=ROUGH_TOLERANCE,
    )


def _finish(constellation: Constellation, measurements: Measurements, fits: Fit, rows: NDArray[np.intp]) -> None:
    """Fit some of the poses without model error, in place."""
    if len(rows):
        position, rotation = fits.position_m[rows], fits.rotation[rows]
        some = measurements.take(rows)
        fits.put(rows, fit_pose(constellation.model, some, position, rotation, iterations=FINAL_ITERATIONS))


def _solved(constellation: Constellation, measurements: Measurements, left_out: NDArray[np.intp]) -> Fit:
    """Search the pose of each subset: where the chain of magnitudes cannot be used."""
    found = []
    for rows in left_out:
        kept = np.delete(np.arange(len(constellation.model)), rows)
        thinned = measurements.of_beacons(kept)
        found.append(constellation.subset(kept).solve(thinned, SUBSET_EVALUATIONS).best)
    return stacked(found)


def _better_from(constellation: Constellation, thinned: Measurements, best: Fit, starts: Fit) -> Fit:
    """Fit every subset roughly from the best of its starts too and keep what costs less."""
    subsets = len(best.cost)
    each = len(starts.cost) // subsets
    if not each:
        return best
    if each > 1:
        which = np.repeat(np.arange(subsets), each)
        there = _rough(constellation, thinned.take(which), starts.position_m, starts.rotation, iterations=0)
        cost = np.where(np.isfinite(there.cost), there.cost, np.inf).reshape(subsets, each)
        starts = starts.take(np.arange(subsets) * each + cost.argmin(axis=1))
    chosen = _rough(constellation, thinned, starts.position_m, starts.rotation)
    better = np.flatnonzero(~(best.cost <= chosen.cost) & np.isfinite(chosen.cost))
    result = best.take(np.arange(subsets))
    result.put(better, chosen.take(better))
    return result

"""Position from ranges alone: min over P of sum_i (|P - M_i| - r_i)^2 (Zheng et al. 2022, eqn 17)."""

from __future__ import annotations

import numpy as np

from goldfield.locate.least_squares import State, minimise
from goldfield.types import FloatArray

START_HEIGHTS_M = (0.3, 1.0, 3.0)
"""Heights of the starts over the middle of the beacons. Ranges to beacons in one plane leave a saddle in that plane, so
the starts are off it; the best end counts."""


def trilaterate(
    beacon_m: FloatArray, range_m: FloatArray, up: FloatArray | None = None, z_m: FloatArray | None = None
) -> FloatArray:
    """Return the positions of e epochs, shape (e, 3).

    Parameters
    ----------
    beacon_m : ndarray, shape (n, 3)
        Places of at least three beacons.
    range_m : ndarray, shape (e, n)
    up : ndarray, shape (3,), optional
        Direction towards the side of the beacons' middle where the sensor is; default +z. Where the beacons stand in
        one plane the mirror position fits as well.
    z_m : ndarray, shape (e,), optional
        Known heights: then only x and y are sought.
    """
    up = np.array([0.0, 0.0, 1.0]) if up is None else up
    middle = beacon_m.mean(axis=0)
    count = len(range_m)
    free = np.array([1.0, 1.0, 0.0 if z_m is not None else 1.0])

    def evaluate(state: State, rows: np.ndarray[tuple[int], np.dtype[np.intp]]) -> tuple[FloatArray, FloatArray]:
        offset = state[0][:, None, :] - beacon_m
        distance = np.linalg.norm(offset, axis=2)
        slope = free * offset / np.maximum(distance, 1e-9)[:, :, None]
        return range_m[rows] - distance, slope.swapaxes(1, 2)

    def search(start: FloatArray) -> tuple[FloatArray, FloatArray]:
        end = minimise(evaluate, lambda state, step: (state[0] + step,), (start,), tolerance=1e-14)
        return end.state[0], end.cost

    best, cost = np.full((count, 3), np.nan), np.full(count, np.inf)
    for height in START_HEIGHTS_M:
        start = np.tile(middle + height * up, (count, 1))
        if z_m is not None:
            start[:, 2] = z_m
        found, found_cost = search(start)
        if z_m is None:
            depth = np.minimum((found - middle) @ up, 0.0)
            if depth.any():
                found, found_cost = search(found - 2.0 * depth[:, None] * up)
        better = found_cost < cost
        best[better], cost[better] = found[better], found_cost[better]
    return best

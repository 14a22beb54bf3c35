"""Images of a pose that one beacon alone rules out: if that is at fault, the sensor may as well be there.

Coils on a floor and one under the ceiling have one pose, for the last tells on which side of the floor it is. Should it
fail, the others fit the image of the pose as well as the pose (`goldfield.locate.mirror`), and an image below the floor
is so far from the ceiling that a dead coil there agrees with it. Solution separation is linear and sees the pose
without a beacon beside the one with it, not the one across the plane: so the protection level has to reach there.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from goldfield.locate.constellation import RIVAL_COST, Constellation
from goldfield.locate.fault_statistics import FaultStatistics
from goldfield.locate.fit import Fit, Measurements
from goldfield.locate.mirror import Mirror
from goldfield.types import FloatArray

MOVED = 0.25
"""Part of the way to an image by which a fit is taken to move it at most, where the half-space decides."""

LEAST = 4
"""Beacons from which on one may be left out and the others fit a pose by more than chance."""


def image_distance_m(
    constellation: Constellation, measurements: Measurements, fit: Fit, statistics: FaultStatistics
) -> FloatArray:
    """Return how far the farthest image of e poses is that fits all beacons but one, shape (e, n); 0: there is none.

    Parameters
    ----------
    constellation : Constellation
        n beacons.
    measurements : Measurements
        e epochs.
    fit : Fit
        Their poses.
    statistics : FaultStatistics
        Those of the poses: what each beacon adds to the cost.
    """
    distance = np.zeros((len(fit.cost), len(constellation.model)))
    if len(constellation.model) < LEAST:
        return distance
    for row, mirror, concerned in _concerned(constellation, fit.position_m):
        epochs = np.flatnonzero(concerned)
        image = mirror.image(fit.take(epochs))
        fits: NDArray[np.bool_] = constellation.inside(image.position_m)
        if not mirror.exact:
            kept = np.delete(np.arange(len(constellation.model)), row)
            others = measurements.take(epochs).of_beacons(kept)
            across_m = image.position_m
            image = constellation.subset(kept).refine(others, across_m, image.rotation)
            rest = fit.cost[epochs] - statistics.drop[epochs, row]
            fits = constellation.inside(image.position_m) & (image.cost - rest < RIVAL_COST)
            fits &= _nearer(image.position_m, across_m, fit.position_m[epochs])
        apart = np.linalg.norm(image.position_m - fit.position_m[epochs], axis=1)
        distance[epochs, row] = np.maximum(distance[epochs, row], np.where(fits, apart, 0.0))
    return distance


def _nearer(position_m: FloatArray, here_m: FloatArray, there_m: FloatArray) -> NDArray[np.bool_]:
    """Return which positions are nearer to the first than to the second: the fit has not come back to the pose."""
    return np.asarray(np.linalg.norm(position_m - here_m, axis=1) < np.linalg.norm(position_m - there_m, axis=1))


def _concerned(constellation: Constellation, position_m: FloatArray) -> Iterator[tuple[int, Mirror, NDArray[np.bool_]]]:
    """Yield the mirrors of which an image is worth a trial, each with its beacon and the positions, shape (e,).

    All are looked at in one step: nearly always there is none, and a pose is one of many. In a hall with all coils
    under its ceiling each of them has one, which a half-space rules out: it lies outside by more than a fit moves it.
    """
    reach = constellation.mirrors_reach
    away_m = position_m[:, None] - reach.point_m
    concerned = np.einsum("eki,eki->ek", away_m, away_m) >= reach.least_m2
    half = constellation.half_space
    if half is not None and concerned.any():
        image_m = reach.point_m + np.einsum("kij,ekj->eki", reach.reflection, away_m)
        way_m = np.linalg.norm(image_m - position_m[:, None], axis=2)
        concerned &= (image_m - half.point_m) @ half.normal > -MOVED * way_m
    for k in np.flatnonzero(concerned.any(axis=0)).tolist():
        yield *constellation.mirrors_without_one[k], concerned[:, k]

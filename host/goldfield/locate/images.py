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
from goldfield.locate.fit import Fit, Measurements, stacked
from goldfield.locate.mirror import Mirror
from goldfield.types import FloatArray

MOVED = 0.25
"""Part of the way to an image by which a fit is taken to move it at most, where the half-space decides."""

AT_ONCE = 512
"""Images that are fitted in one step: some 15 kB each among a hundred beacons."""

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
    nearly: list[tuple[NDArray[np.intp], NDArray[np.intp], Fit]] = []
    for row, mirror, concerned in _concerned(constellation, fit.position_m):
        epochs = np.flatnonzero(concerned)
        rows, image = np.full(len(epochs), row), mirror.image(fit.take(epochs))
        if mirror.exact:
            _lengthen(distance, epochs, rows, image, fit, constellation.inside(image.position_m))
        else:
            nearly.append((epochs, rows, image))
    if nearly:
        epochs = np.concatenate([epochs for epochs, _, _ in nearly])
        rows = np.concatenate([rows for _, rows, _ in nearly])
        across = stacked([image for _, _, image in nearly])
        rest = fit.cost[epochs] - statistics.drop[epochs, rows]
        for first in range(0, len(epochs), AT_ONCE):
            some = np.arange(first, min(first + AT_ONCE, len(epochs)))
            tried = _without(measurements.take(epochs[some]), rows[some])
            image = constellation.refine(tried, across.position_m[some], across.rotation[some])
            fits = constellation.inside(image.position_m) & (image.cost - rest[some] < RIVAL_COST)
            fits &= _nearer(image.position_m, across.position_m[some], fit.position_m[epochs[some]])
            _lengthen(distance, epochs[some], rows[some], image, fit, fits)
    return distance


def _without(measurements: Measurements, rows: NDArray[np.intp]) -> Measurements:
    """Return epochs in each of which one beacon, given by its row, was not measured: all are fitted in one step."""
    field_T = measurements.field_T.copy()
    field_T[np.arange(len(rows)), rows] = np.nan
    return measurements.of_fields(field_T)


def _lengthen(
    distance: FloatArray,
    epochs: NDArray[np.intp],
    rows: NDArray[np.intp],
    image: Fit,
    fit: Fit,
    fits: NDArray[np.bool_],
) -> None:
    """Let distances reach to those of the images that fit, in place."""
    apart = np.linalg.norm(image.position_m - fit.position_m[epochs], axis=1)
    np.maximum.at(distance, (epochs, rows), np.where(fits, apart, 0.0))


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

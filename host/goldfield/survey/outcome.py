"""What comes out of an adjustment: the site as it was found, each parameter with its deviation, and the outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.locate import Locator
from goldfield.site import Beacon, Site
from goldfield.site.metal import COLUMNS, ROWS
from goldfield.site.model import Survey
from goldfield.survey.adjustment import Evaluation, Problem
from goldfield.survey.data import Free, Outlier, Parameter
from goldfield.survey.parameters import BEACON, LEVER, OFFSET, TERMS, State, across, beacons_of
from goldfield.types import Fields, FloatArray

MOST_SEARCHED = 60
"""Outliers in which the wrong beacon is looked for; the others are told by their residual alone."""


@dataclass(frozen=True, eq=False)
class Solution:
    """An adjustment that has ended.

    Attributes
    ----------
    problem : Problem
        With all epochs, their deviations widened where they had to be.
    state : State
    sound : ndarray of bool, shape (e,)
    last : Evaluation
        That of the sound epochs, on which the result rests.
    squares : ndarray, shape (e,)
        Chi-square of each epoch, outliers too.
    covariance : ndarray, shape (6 n + 18, 6 n + 18), and more with metal
        That of the common parameters; 0 for those that were not estimated.
    widened : float
        Factor by which the deviations were widened.
    residual_before, residual_after : float
    """

    problem: Problem
    state: State
    sound: NDArray[np.bool_]
    last: Evaluation
    squares: FloatArray
    covariance: FloatArray
    widened: float
    residual_before: float
    residual_after: float


def found_site(solution: Solution) -> Site:
    """Return the site as it was found, with the deviations that `locate` uses: roots of means over directions."""
    problem, sd = solution.problem, np.sqrt(np.diag(_without_common_gain(solution)))
    beacons: list[Beacon] = []
    for i, beacon in enumerate(beacons_of(problem.site, solution.state)):
        own, free = sd[BEACON * i : BEACON * (i + 1)], problem.prior.free[BEACON * i : BEACON * (i + 1)]
        survey = Survey(
            position_sd_m=float(np.sqrt(np.mean(own[:3] ** 2))) if free[0] else beacon.survey.position_sd_m,
            axis_sd_rad=float(np.sqrt(np.mean(own[3:5] ** 2))) if free[3] else beacon.survey.axis_sd_rad,
            current_sd=float(own[5]) if free[5] else beacon.survey.current_sd,
        )
        beacons.append(replace(beacon, survey=survey))
    own, free = sd[BEACON * len(beacons) :], problem.prior.free[BEACON * len(beacons) :]
    sensor = problem.site.sensor
    if free[0]:
        sensor = replace(sensor, gain_sd=float(own[:3].max()))
    if free[3]:  # a tilt is the lean of two axes towards each other
        sensor = replace(sensor, axis_sd_rad=float(own[3:TERMS].max() / np.sqrt(2.0)))
    if free[0] or free[3]:
        sensor = replace(sensor, axes=solution.state.matrix() @ problem.axes)
    if problem.prior.free[BEACON * len(beacons) :][LEVER].any():
        sensor = replace(sensor, lever_m=solution.state.lever_m)
    metal = beacons[0].metal.metal if beacons[0].metal is not None else None
    return replace(problem.site, beacons=tuple(beacons), sensor=sensor, assumed=(), metal=metal)


def _without_common_gain(solution: Solution) -> FloatArray:
    """Return the covariance for a known mean of the sensor's gains.

    A common gain and all currents change the fields alike, so that the fields tell but their product, and a pose asks
    for no more: the deviation of the product is that of the currents alone.
    """
    mean = np.zeros(len(solution.covariance))
    mean[BEACON * len(solution.state.axis) :][:3] = 1.0 / 3.0
    shared = solution.covariance @ mean
    variance = float(mean @ shared)
    return solution.covariance - np.outer(shared, shared) / variance if variance > 0.0 else solution.covariance


def parameters_of(site: Site, solution: Solution, free: frozenset[Free]) -> dict[str, Parameter]:
    """Return everything that was estimated, by names such as ``b1.x_m``, ``b1.axis_x`` and ``sensor.gain_x``.

    ``site`` is what the file said before.
    """
    problem, state, prior = solution.problem, solution.state, solution.problem.prior
    sd = np.sqrt(np.diag(solution.covariance))
    result: dict[str, Parameter] = {}
    after = beacons_of(problem.site, state)
    two = across(state.axis)
    for i, (old, new) in enumerate(zip(site.beacons, after, strict=True)):
        first = BEACON * i
        for k, letter in enumerate("xyz"):
            if prior.free[first]:
                result[f"{old.id}.{letter}_m"] = _parameter(new.position_m[k], sd[first + k], old.position_m[k])
        if prior.free[first + 3]:
            moves = np.cross(two[i], state.axis[i])
            spread = moves.T @ solution.covariance[first + 3 : first + 5, first + 3 : first + 5] @ moves
            for k, letter in enumerate("xyz"):
                result[f"{old.id}.axis_{letter}"] = _parameter(new.axis[k], np.sqrt(spread[k, k]), old.axis[k])
        if prior.free[first + 5]:
            size = abs(new.current_A) * sd[first + 5]
            result[f"{old.id}.current_A"] = _parameter(new.current_A, size, old.current_A)
    return {**result, **_of_sensor(state, prior.start, sd[BEACON * len(after) :], free)}


def _of_sensor(state: State, start: State, sd: FloatArray, free: frozenset[Free]) -> dict[str, Parameter]:
    result = {}
    for k in range(TERMS):
        kind = Free.GAIN if ROWS[k] == COLUMNS[k] else Free.TILT
        if kind in free:
            letters = "".join("xyz"[j] for j in sorted({int(ROWS[k]), int(COLUMNS[k])}))
            base = 1.0 if kind is Free.GAIN else 0.0
            unit = "" if kind is Free.GAIN else "_rad"
            result[f"sensor.{kind.value}_{letters}{unit}"] = _parameter(base + state.terms[k], sd[k], base)
    if Free.OFFSET in free:
        for k, letter in enumerate("xyz"):
            result[f"sensor.offset_{letter}_T"] = _parameter(state.offset_T[k], sd[OFFSET][k], 0.0)
    if Free.LEVER in free:
        for k, name in enumerate(f"sensor.lever_{axis}_{letter}_m" for axis in "xyz" for letter in "xyz"):
            result[name] = _parameter(state.lever_m.flat[k], sd[LEVER][k], start.lever_m.flat[k])
    return result


def _parameter(value: float, sd: float, before: float) -> Parameter:
    return Parameter(float(value), float(sd), float(before))


def outliers_of(solution: Solution, site: Site, epochs: Sequence[Fields]) -> tuple[Outlier, ...]:
    """Return the epochs that do not agree with the others, each with the beacons that `locate` leaves out of it."""
    rows = np.flatnonzero(~solution.sound)
    locator = Locator(site)
    poses = locator.locate_many([epochs[row] for row in rows[:MOST_SEARCHED]])
    freedom = np.maximum(solution.problem.readings.count - 6.0, 1.0)
    named = [pose.excluded for pose in poses] + [()] * (len(rows) - len(poses))
    return tuple(
        Outlier(epochs[row].epoch, beacons, float(np.sqrt(solution.squares[row] / freedom[row])))
        for row, beacons in zip(rows.tolist(), named, strict=True)
    )

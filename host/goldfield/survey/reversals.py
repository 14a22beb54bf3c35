"""Coils that run the other way round than the site says, and sensors with left-handed axes: found before all else.

No small step leads from a coil to a reversed one. Where the rough fit fails, the fields of one beacon or of all are
negated on trial, as long as that helps. Negated are those of reversed coils; if they are more than half of all, it is
rather the sensor that is left-handed: a mirrored sensor reads negated fields in another attitude.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from goldfield.site import Beacon, Site
from goldfield.survey.adjustment import STAGES, Problem, evaluate
from goldfield.survey.equations import Readings
from goldfield.survey.parameters import State
from goldfield.survey.starts import rough_poses
from goldfield.types import FloatArray

MISFIT = 3.0
"""Median chi-square of the rough poses over the degrees of freedom, from which on reversals are looked for."""
HELPS = 0.6
"""A reversal is believed if it leaves less than this part of the cost."""
MOST_EPOCHS = 60
"""Epochs on which they are tried."""


def right_way_round(site: Site, problem: Problem, state: State) -> Site:
    """Return the site with reversed coils and left-handed axes as the fields have them; the same if all is well.

    Parameters
    ----------
    site : Site
    problem : Problem
    state : State
        With rough poses.
    """
    every = max(len(state.sensor_m) // MOST_EPOCHS, 1)
    some = np.arange(len(state.sensor_m)) % every == 0
    few = problem.of_epochs(some)
    freedom = few.readings.count - 6.0
    squares = evaluate(few, state.of_epochs(some), STAGES[0]).squares
    if not (freedom > 0.0).any() or not np.median((squares / np.maximum(freedom, 1.0))[freedom > 0.0]) > MISFIT:
        return site
    count = len(site.beacons)
    signs, cost = np.ones(count), float(np.median(squares))
    for _ in range(count):
        trials = [-signs, *(signs * np.where(np.arange(count) == i, -1.0, 1.0) for i in range(count))]
        costs = [_cost(few, state.of_epochs(some), trial) for trial in trials]
        best = int(np.argmin(costs))
        if not costs[best] < HELPS * cost:
            break
        signs, cost = trials[best], costs[best]
    mirrored = signs.sum() < 0.0
    beacons = tuple(
        _reversed(beacon) if sign != (-1.0 if mirrored else 1.0) else beacon
        for beacon, sign in zip(site.beacons, signs, strict=True)
    )
    sensor = replace(site.sensor, axes=-problem.axes) if mirrored else site.sensor
    return replace(site, beacons=beacons, sensor=sensor)


def _reversed(beacon: Beacon) -> Beacon:
    return replace(beacon, current_A=-beacon.current_A)


def _cost(problem: Problem, state: State, signs: FloatArray) -> float:
    """Return the median chi-square of the epochs at their rough poses, if some fields are negated."""
    negated = replace(problem, readings=Readings(problem.readings.field_T * signs[:, None], problem.readings.sigma_T))
    return float(np.median(evaluate(negated, rough_poses(negated, state), STAGES[0]).squares))


def reversals_in_words(before: Site, after: Site) -> tuple[str, ...]:
    """Say which coils run the other way round than the site said, and whether the sensor is left-handed."""
    turned = [
        new.id for old, new in zip(before.beacons, after.beacons, strict=True) if old.current_A * new.current_A < 0.0
    ]
    lines = [f"{name} is reversed: its current has the other sign in the new site file" for name in turned]
    if _hand(before) * _hand(after) < 0.0:
        hand = "left-handed" if _hand(after) < 0.0 else "right-handed"
        lines.append(f"the axes of the sensor are {hand}: axes in the new site file say so")
    return tuple(lines)


def _hand(site: Site) -> float:
    axes = site.sensor.axes
    return 1.0 if axes is None or len(axes) < 3 else float(np.sign(np.linalg.det(axes)))

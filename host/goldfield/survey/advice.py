"""What a survey leaves open, in words: through what origin, direction and scale are known, and what to measure next.

Fields tell the shape of a site, not where it stands, where it looks, and hardly how large it is: shifted, turned, or
stretched with all currents by the third power, it makes the same fields in its sensors. What fixes these seven modes is
known otherwise. Each mode is a vector v of all parameters, poses too; what a source knows of it is v' H v with the
information H of this source alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate.mirror import find_mirrors
from goldfield.survey.constraints import name_of_known
from goldfield.survey.data import Free, SurveyData
from goldfield.survey.outcome import Solution
from goldfield.survey.parameters import BEACON, across
from goldfield.types import FloatArray

TAPE_M, SHUNT = 0.002, 0.001
"""Deviations of what might be measured next: a length by a tape, a current by a shunt."""
MOST_PAIRS, MOST_PLACES = 500, 60
"""Pairs of beacons and epochs that are tried for it."""
WORTH = 0.95
"""Something is worth measuring if it leaves less than this part of the beacons' deviation."""
MOSTLY = 0.8
"""A source is named alone if it knows this part of what is known."""
SITE = "the site file"
SPREAD = 2.0
"""A site whose beacons are spread over less than so many of their radii has neither direction nor scale of its own."""


@dataclass(frozen=True, eq=False)
class Mode:
    """A way in which the whole site may be wrong.

    Attributes
    ----------
    beacons : ndarray, shape (n, 6)
        What it does to the parameters of the beacons.
    poses : ndarray, shape (e, 3)
        What it does to the sensor's places.
    amount : ndarray, shape (n, 3)
        Its amount is the sum of these times the beacons' shifts.
    """

    beacons: FloatArray
    poses: FloatArray
    amount: FloatArray


def advice_of(solution: Solution, data: SurveyData, sought: frozenset[Free]) -> tuple[str, ...]:
    """Return what to know and what to do, as sentences; ``sought`` is what was estimated."""
    free = solution.problem.prior.free[: BEACON * len(solution.state.axis)].reshape(-1, BEACON)
    if not free[:, 0].any():
        return ()
    origin, direction, scale = _modes(solution)
    model = FieldModel(solution.problem.site.beacons)
    lines = [_sentence("the origin", origin, solution, data, "mm", 1e3, "a known point")]
    if _size(solution) > SPREAD * model.reach_m.max():
        remedy = "three known points"
        lines += [
            _sentence("the direction of the site", direction, solution, data, "degrees", np.rad2deg(1.0), remedy),
            _sentence("its scale", [scale], solution, data, "%", 100.0, "one distance between beacons"),
        ]
    lines += _misfits(solution, data)
    if solution.widened > 1.0:
        metal = "" if Free.FIELD in sought else "; if metal is near, find it with --free field added"
        lines.append(
            f"the fields scatter {solution.widened:.2g} times as much as sigma_T says: all deviations were widened so"
            + metal
        )
    lines += _worst(solution)
    walked_m = solution.state.sensor_m
    if solution.problem.site.half_space is None and any(m.concerns(walked_m).any() for m in find_mirrors(model)):
        lines.append(
            "all beacons are about in one plane or around one point, so that poses may be mirror images; the beacons "
            "are right all the same: give half_space in the site file"
        )
    lines += _next(solution)
    return tuple(lines)


def _size(solution: Solution) -> float:
    centre = solution.state.position_m - solution.state.position_m.mean(axis=0)
    return float(np.sqrt((centre**2).sum(axis=1).mean()))


def _modes(solution: Solution) -> tuple[list[Mode], list[Mode], Mode]:
    """Return the shifts along the axes, the turns about them, and the stretch."""
    state = solution.state
    middle = state.position_m.mean(axis=0)
    arm, reach = state.position_m - middle, state.sensor_m - middle
    count = len(arm)
    shifts, turns = [], []
    moment = np.einsum("ni,nj->ij", arm, arm)
    inertia = np.trace(moment) * np.eye(3) - moment
    for k in range(3):
        unit = np.eye(3)[k]
        beacons = np.zeros((count, BEACON))
        beacons[:, :3] = unit
        shifts.append(Mode(beacons, np.tile(unit, (len(reach), 1)), np.tile(unit / count, (count, 1))))
        beacons = np.zeros((count, BEACON))
        beacons[:, :3] = np.cross(unit, arm)
        beacons[:, 3:5] = across(state.axis) @ unit
        amount = np.cross(np.linalg.pinv(inertia)[k], arm)
        turns.append(Mode(beacons, np.cross(unit, reach), amount))
    beacons = np.zeros((count, BEACON))
    beacons[:, :3], beacons[:, 5] = arm, 3.0
    return shifts, turns, Mode(beacons, reach, arm / max(float((arm**2).sum()), 1e-300))


def _deviation(mode: Mode, solution: Solution) -> float:
    count = len(mode.amount)
    row = np.zeros((count, BEACON))
    row[:, :3] = mode.amount
    flat = row.ravel()
    return float(np.sqrt(flat @ solution.covariance[: len(flat), : len(flat)] @ flat))


def _sources(mode: Mode, solution: Solution, data: SurveyData) -> dict[str, float]:
    """Return what each source knows of a mode."""
    problem = solution.problem
    count = len(mode.beacons)
    inverse = (1.0 / problem.prior.sd[: BEACON * count]).reshape(count, BEACON)
    held = np.where(problem.prior.free[: BEACON * count].reshape(count, BEACON), inverse, 1e6)
    known = (mode.beacons * held) ** 2
    sources = {SITE: float(known[:, :5].sum())}
    for i, beacon in enumerate(problem.site.beacons):
        sources[f"the current of {beacon.id}"] = float(known[i, 5])
    sources["the known points"] = float(((problem.point_weight * mode.poses)[solution.sound] ** 2).sum())
    vector = np.zeros(len(problem.prior.sd))
    vector[: BEACON * count] = mode.beacons.ravel()
    for one in data.known:
        _, slopes = problem.constraints.one(one, solution.state)
        sources[name_of_known(one)] = sources.get(name_of_known(one), 0.0) + float(((slopes @ vector) ** 2).sum())
    return sources


def _sentence(
    what: str, modes: Sequence[Mode], solution: Solution, data: SurveyData, unit: str, factor: float, remedy: str
) -> str:
    """Say how well the worst of some modes is known, and through what."""
    worst = max(modes, key=lambda mode: _deviation(mode, solution))
    sources = _sources(worst, solution, data)
    whole = max(sum(sources.values()), 1e-300)
    name, most = max(sources.items(), key=lambda item: item[1])
    currents = sum(value for key, value in sources.items() if key.startswith("the current of"))
    if most < MOSTLY * whole and currents > most:
        name, most = "the currents", currents
    only = "only " if most > MOSTLY * whole else "mostly "
    size = f"{factor * _deviation(worst, solution):.2g} {unit}"
    measured = name.startswith(("the known points", "the distance", "the measured"))
    return f"{what} is known to {size}, {only}through {name}" + ("" if measured else f": give {remedy}")


def _misfits(solution: Solution, data: SurveyData) -> Iterator[str]:
    """Name known points that were left out, and what else is known and does not fit."""
    number = {fields.epoch: row for row, fields in enumerate(data.epochs)}
    for point in data.points:
        row = number[point.epoch]
        if solution.sound[row] and not solution.problem.point_weight[row].any():
            off = point.position_m - solution.state.sensor_m[row]
            size = float(np.linalg.norm(off[np.isfinite(off)]))
            yield (
                f"the known point of epoch {point.epoch} is {size:.3g} m from where the fields and the other points "
                "put the sensor: it was left out; check it"
            )
    for known, size in solution.problem.constraints.unfit(solution.state):
        yield f"{name_of_known(known)} does not fit, by {size:.3g} of its standard deviations: check it"


def _worst(solution: Solution) -> Iterator[str]:
    """Name the beacon that is known worst, if it stands out."""
    variance = np.diag(solution.covariance)[: BEACON * len(solution.state.axis)].reshape(-1, BEACON)
    deviation = np.sqrt(variance[:, :3].sum(axis=1))
    worst = int(np.argmax(deviation))
    if deviation[worst] > 2.0 * np.median(deviation):
        beacon = solution.problem.site.beacons[worst]
        yield f"{beacon.id} is known worst, to {1e3 * deviation[worst]:.2g} mm: walk nearer to it and around it"


def _next(solution: Solution) -> list[str]:
    """Return what would make the beacons best known if it were measured next, one sentence a kind, the best first."""
    places = np.arange(len(solution.state.axis) * BEACON).reshape(-1, BEACON)[:, :3].ravel()
    variance = float(np.diag(solution.covariance)[places].sum())
    now = np.sqrt(variance / len(solution.state.axis))
    found = [
        max(options, key=lambda option: option[0])
        for options in (_distances(solution, places), _currents(solution, places), _points(solution, places))
        if options
    ]
    lines = []
    for gain, text in sorted(found, reverse=True):
        then = np.sqrt(max(variance - gain, 0.0) / len(solution.state.axis))
        if then < WORTH * now:
            lines.append(
                f"measure {text}: the beacons are then known to {1e3 * then:.3g} mm instead of {1e3 * now:.3g}"
            )
    return lines


def _gain(solution: Solution, row: FloatArray, sd: float, places: NDArray[np.intp]) -> float:
    """Return by how much a measurement of one combination of parameters lowers the variance of all places."""
    spread = solution.covariance @ row
    return float((spread[places] ** 2).sum() / (sd**2 + row @ spread))


def _distances(solution: Solution, places: NDArray[np.intp]) -> list[tuple[float, str]]:
    beacons, position = solution.problem.site.beacons, solution.state.position_m
    pairs = list(combinations(range(len(beacons)), 2))
    options = []
    for i, j in pairs[:: max(len(pairs) // MOST_PAIRS, 1)]:
        between = position[i] - position[j]
        row = np.zeros(len(solution.covariance))
        unit = between / max(float(np.linalg.norm(between)), 1e-9)
        row[BEACON * i : BEACON * i + 3], row[BEACON * j : BEACON * j + 3] = unit, -unit
        text = f"the distance from {beacons[i].id} to {beacons[j].id} to {1e3 * TAPE_M:g} mm"
        options.append((_gain(solution, row, TAPE_M, places), text))
    return options


def _currents(solution: Solution, places: NDArray[np.intp]) -> list[tuple[float, str]]:
    options = []
    for i, beacon in enumerate(solution.problem.site.beacons):
        row = np.zeros(len(solution.covariance))
        row[BEACON * i + 5] = 1.0
        text = f"the current of {beacon.id} to {100.0 * SHUNT:g} %"
        options.append((_gain(solution, row, SHUNT, places), text))
    return options


def _points(solution: Solution, places: NDArray[np.intp]) -> list[tuple[float, str]]:
    """Try the sensor's places of some sound epochs as known points."""
    epochs = np.flatnonzero(solution.sound)
    if not len(epochs):
        return []
    free = solution.problem.prior.free
    inner = np.flatnonzero(free)
    covariance = solution.covariance[np.ix_(free, free)]
    wanted = np.isin(inner, places)
    _, _, parts = solution.last.equations.reduced()
    back, crossed, _ = parts[0]
    options = []
    for row in range(0, len(epochs), max(len(epochs) // MOST_PLACES, 1)):
        slope = (back[row] @ crossed[row])[:3]
        shared = -covariance @ slope.T
        own = (back[row] @ back[row].T)[:3, :3] + slope @ covariance @ slope.T + TAPE_M**2 * np.eye(3)
        gain = float(np.trace(np.linalg.solve(own, shared[wanted].T @ shared[wanted])))
        where = ", ".join(f"{value:.2f}" for value in solution.state.sensor_m[epochs[row]])
        options.append((gain, f"one more point to {1e3 * TAPE_M:g} mm, near ({where}) m"))
    return options

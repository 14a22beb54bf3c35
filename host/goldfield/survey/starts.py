"""Rough poses to start from: by the site as it is, which may be 20 cm and 10 degrees wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate.constellation import Constellation
from goldfield.locate.fit import Fit, Measurements, fit_pose
from goldfield.locate.sensor_axes import levers_of
from goldfield.locate.site_errors import SiteErrors
from goldfield.locate.wahba import wahba
from goldfield.site import Site
from goldfield.survey.adjustment import STAGES, Problem
from goldfield.survey.parameters import State, beacons_of
from goldfield.types import FloatArray

SPACING = 24
"""Points of the grid of starts along the longest edge of the room."""
BEST = 6
"""Points of the grid from which a pose is fitted."""
BEYOND = 0.5
"""How far the grid goes beyond the beacons, as a part of the room's longest edge."""
LOUD = 3.0
"""A field below so many standard deviations says nothing of a range."""
AT_ONCE = 64
"""Epochs compared with the grid at once."""


def measurements_of(problem: Problem, state: State, model_error: float) -> Measurements:
    """Return the readings as fields of a perfect sensor, their deviations with a relative error of the model."""
    readings = problem.readings
    straight = np.linalg.inv(state.matrix() @ problem.axes)
    measured = np.isfinite(readings.sigma_T)
    field = (readings.field_T - np.where(measured, state.offset_T, 0.0)) @ straight.T
    size2 = (field * field).sum(axis=2)
    sigma = np.sqrt(np.where(measured, readings.sigma_T**2, np.inf).min(axis=2) + (model_error**2) * size2)
    usable = np.isfinite(sigma)
    return Measurements(np.where(measured & usable[..., None], field, np.nan), np.where(usable, sigma, 1.0))


def levers_alone(site: Site) -> SiteErrors | None:
    """Return the levers that a site has as a pose's fit takes them, all else taken for exact; None if it has none."""
    levers, exact = levers_of(site.sensor), np.zeros(len(site.beacons))
    return None if levers is None else SiteErrors(exact, exact, exact, 0.0, 0.0, levers=levers)


def rough_poses(problem: Problem, state: State) -> State:
    """Return the state with a pose of each epoch: from known points and a grid, by magnitudes, Wahba and a wide fit."""
    measurements = measurements_of(problem, state, STAGES[0])
    model = FieldModel(beacons_of(problem.site, state))
    grid = _grid(problem, model)
    strength = np.linalg.norm(model.field(grid), axis=2)  # (g, n)
    places = np.concatenate(
        [_nearest(grid, strength, measurements, some) for some in _batches(len(measurements))]
    )  # (e, BEST, 3)
    known = np.asarray((problem.point_weight > 0.0).all(axis=1))
    places[known] = problem.point_m[known][:, None]
    best: Fit | None = None
    for k in range(places.shape[1]):
        fit = _fitted(model, measurements, places[:, k])
        inside = _inside(problem, fit.position_m)
        fit.cost[~inside] = fit.cost[~inside] + 1e6
        fit.cost[~np.isfinite(fit.cost)] = np.inf
        if best is None:
            best = fit
        else:
            better = np.flatnonzero(fit.cost < best.cost)
            best.put(better, fit.take(better))
    assert best is not None
    position = np.where(known[:, None], problem.point_m, best.position_m)
    away = np.where(np.isfinite(position), np.abs(position - problem.room_m), np.inf)
    far = np.flatnonzero(away.max(axis=1) > 3.0 * problem.room_sd_m)
    position[far] = places[far, 0]
    whole = np.asarray(np.isfinite(best.rotation).all(axis=(1, 2)))
    rotation = np.where(whole[:, None, None], best.rotation, np.eye(3))
    return _posed(state, position, rotation)


def searched_poses(problem: Problem, state: State, rows: NDArray[np.intp]) -> State:
    """Return the state with poses of some epochs found anew, by the search of all of space that `locate` makes."""
    model = FieldModel(beacons_of(problem.site, state))
    measurements = measurements_of(problem, state, 0.0).take(rows)
    fit = located(Constellation(model, problem.site.half_space), measurements)
    found = np.isfinite(fit.cost)
    position, rotation = state.sensor_m.copy(), state.rotation.copy()
    position[rows[found]], rotation[rows[found]] = fit.position_m[found], fit.rotation[found]
    return _posed(state, position, rotation)


def located(whole: Constellation, measurements: Measurements) -> Fit:
    """Return the best poses of epochs that need not have heard the same beacons."""
    best = Fit(
        np.zeros((len(measurements), 3)),
        np.zeros((len(measurements), 3, 3)),
        np.full(len(measurements), np.inf),
        np.zeros((len(measurements), 6, 6)),
        np.zeros(len(measurements), dtype=bool),
    )
    groups: dict[bytes, list[int]] = {}
    for index, heard in enumerate(measurements.known):
        groups.setdefault(heard.tobytes(), []).append(index)
    for key, members in groups.items():
        beacons = np.flatnonzero(np.frombuffer(key, dtype=bool))
        if len(beacons) >= 3:
            some = np.array(members)
            best.put(some, whole.subset(beacons).solve(measurements.take(some).of_beacons(beacons)).best)
    return best


def anchor_attitudes(problem: Problem, state: State) -> FloatArray:
    """Return the attitude of each anchor that fits its fields best, shape (a, 3, 3)."""
    model = FieldModel(beacons_of(problem.site, state))
    weight = problem.anchors.weight(STAGES[0])[:, :, 0] ** 2
    field = model.field(state.position_m[problem.anchor_rows])
    return wahba(np.where(np.isfinite(field), field, 0.0), problem.anchors.field_T, weight)


def _posed(state: State, position_m: FloatArray, rotation: FloatArray) -> State:
    return replace(
        state,
        sensor_m=np.asarray(position_m, dtype=np.float64),
        rotation=np.asarray(rotation, dtype=np.float64),
    )


def _batches(count: int) -> list[NDArray[np.intp]]:
    return [np.arange(first, min(first + AT_ONCE, count)) for first in range(0, count, AT_ONCE)]


def _grid(problem: Problem, model: FieldModel) -> FloatArray:
    """Return points all over the room and a good way beyond it, shape (g, 3), those on the wrong side left out."""
    low, high = model.centre_m.min(axis=0), model.centre_m.max(axis=0)
    edge = float((high - low).max())
    margin = BEYOND * edge if edge > 0.0 else 10.0 * float(model.reach_m.max())
    spacing = (edge + 2.0 * margin) / SPACING
    axes = [np.arange(a - margin, b + margin + 0.5 * spacing, spacing) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[_inside(problem, grid)]


def _inside(problem: Problem, position_m: FloatArray) -> NDArray[np.bool_]:
    side = problem.site.half_space
    if side is None:
        return np.ones(len(position_m), dtype=bool)
    return np.asarray((position_m - side.point_m) @ side.normal >= 0.0)


def _nearest(grid: FloatArray, strength: FloatArray, measurements: Measurements, rows: NDArray[np.intp]) -> FloatArray:
    """Return the points of the grid whose strengths are most like those of some epochs, shape (r, BEST, 3)."""
    size, sigma = measurements.magnitude_T[rows], measurements.sigma_T[rows]
    loud = measurements.known[rows] & (size > LOUD * sigma)
    loud |= measurements.known[rows] & ~loud.any(axis=1, keepdims=True)
    measured = np.where(loud, np.log(np.maximum(size, 1e-300)), 0.0)
    modelled = np.log(np.maximum(strength, 1e-300))
    # The sum of squares of the differences over the beacons that are loud, by its three products.
    misfit = (measured**2).sum(axis=1)[:, None] - 2.0 * measured @ modelled.T + loud @ (modelled**2).T
    order = np.argpartition(misfit, min(BEST, misfit.shape[1] - 1), axis=1)[:, :BEST]
    rank = np.take_along_axis(misfit, order, axis=1).argsort(axis=1)
    return np.asarray(grid[np.take_along_axis(order, rank, axis=1)])


def _fitted(model: FieldModel, measurements: Measurements, position_m: FloatArray) -> Fit:
    weight = measurements.inverse_sigma()[:, 0] ** 2
    rotation = wahba(model.field(position_m), measurements.filled_T, weight)
    return fit_pose(model, measurements, position_m, rotation, iterations=40, tolerance=1e-2)

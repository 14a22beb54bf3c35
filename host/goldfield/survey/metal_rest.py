"""What the chosen metal leaves, and how far the whole map can be trusted.

Fields of epochs that were kept out do not show all that a map lacks: what looks like another pose, the poses take. So
the chosen bodies and polynomials are completed: all beacons get polynomials of the highest degree, with a prior whose
size is learned from the walk, a degree at a time (empirical Bayes: the mean square of the coefficients that are found
and their variance, over and over). Where the chosen metal explains everything this prior shrinks to next to nothing.
The covariance of the completed adjustment then holds what the walk does not tell of the map, too.

A site file has no room for that covariance. `trusted` puts into its standard deviations what makes those of poses
right on the average over the walked room: the map's part as noise of each field, ``sd_T_A``; where errors of beacons
and map take each other away, so that the beacons' deviations taken for themselves make poses look too bad, a common
factor on these.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate.fit import whitened_jacobian
from goldfield.locate.site_errors import errors_of
from goldfield.locate.whitening import Independent, Whitening, whitening_around
from goldfield.site import Site
from goldfield.site.metal import MOST_DEGREE, harmonic_count
from goldfield.site.model import Survey
from goldfield.survey.adjustment import ROUGH_PROGRESS, Problem, adjust, evaluate
from goldfield.survey.data import Free, SurveyData
from goldfield.survey.equations import derivatives
from goldfield.survey.metal import MetalState
from goldfield.survey.outcome import Solution
from goldfield.survey.parameters import BEACON, SENSOR, State, beacons_of
from goldfield.survey.problem import problem_of
from goldfield.survey.procedure import covariance_of, with_poses
from goldfield.types import FloatArray

FIRST_RELATIVE = 0.005
"""Deviation of a coefficient that learning starts with, over the root of the mean square of the beacon's fields."""
MOST_ROUNDS, SETTLED = 6, 0.1
"""How often the prior's size is learned, at most, and its relative change that ends it."""
PLACES = 150
"""Places in the walked room over which the deviations of poses are made right."""
LEAST_FACTOR = 0.05
"""Least factor on the beacons' deviations."""
TOLERANCE = 0.01
"""How well, relatively, the deviations are determined that make it 1."""
MOST_DOUBLINGS = 30


def completed(
    site: Site,
    data: SurveyData,
    free: frozenset[Free],
    solution: Solution,
    start: MetalState,
    *,
    robust: bool = False,
) -> Solution:
    """Return an adjustment with polynomials of the highest degree beside the metal that it has.

    Parameters
    ----------
    site, data, free
        As in `goldfield.survey.procedure.solve`.
    solution : Solution
        With metal; its sound epochs, and deviations as they were widened, are taken over.
    start : MetalState
        With the centre and the radius of the polynomials.
    robust : bool
        For a solution in which no outliers were looked for.
    """
    problem, state = _with_polynomials(site, data, free, solution, start)
    sound, count = solution.sound, harmonic_count(MOST_DEGREE)
    first = BEACON * len(site.beacons) + SENSOR
    own = slice(first, first + count * len(site.beacons))
    degree = np.repeat(np.arange(MOST_DEGREE), 2 * np.arange(1, MOST_DEGREE + 1) + 1)
    size = problem.prior.sd[own].reshape(-1, count) / FIRST_RELATIVE
    for _ in range(MOST_ROUNDS):
        some = problem.of_epochs(sound), state.of_epochs(sound)
        kept, last = adjust(*some, robust=robust, progress=ROUGH_PROGRESS)
        state = with_poses(state, kept, sound)
        covariance = covariance_of(problem, last)
        square = (state.metal.harmonics_T**2 + np.diag(covariance)[own].reshape(size.shape)) / size**2
        relative = np.sqrt(np.bincount(degree, square.mean(axis=0)) / np.bincount(degree))
        before = problem.prior.start.metal
        if np.abs(relative / before.relative_sd - 1.0).max() < SETTLED:
            break
        sd = problem.prior.sd.copy()
        sd[own] = (size * relative[degree]).ravel()
        then = replace(problem.prior.start, metal=replace(before, relative_sd=relative))
        problem = replace(problem, prior=replace(problem.prior, sd=sd, start=then))
    freedom = float((problem.readings.count[sound] - 6.0).sum())
    return replace(
        solution,
        problem=problem,
        state=state,
        last=last,
        squares=evaluate(problem, state).squares,
        covariance=covariance,
        residual_after=float(np.sqrt(last.squares.sum() / freedom)),
    )


def _with_polynomials(
    site: Site, data: SurveyData, free: frozenset[Free], solution: Solution, start: MetalState
) -> tuple[Problem, State]:
    """Return the problem with polynomials of the highest degree, around zero, and the state to start from."""
    old, found = solution.problem, solution.state.metal
    harmonics = np.zeros((len(site.beacons), harmonic_count(MOST_DEGREE)))
    metal = replace(
        found,
        centre_m=start.centre_m,
        radius_m=start.radius_m,
        degree=MOST_DEGREE,
        harmonics_T=harmonics.copy(),
        relative_sd=np.full(MOST_DEGREE, FIRST_RELATIVE),
    )
    problem = problem_of(old.site, data, free, metal)
    problem = replace(problem, readings=old.readings, point_weight=old.point_weight)
    problem = replace(problem, anchor_error=old.anchor_error, anchor_sd=old.anchor_sd)
    harmonics[:, : found.harmonics_T.shape[1]] = found.harmonics_T
    return problem, replace(solution.state, metal=replace(metal, harmonics_T=harmonics))


@dataclass(frozen=True, eq=False)
class _Places:
    """Poses in the walked room, and what is known there.

    Attributes
    ----------
    position_m, rotation : ndarray, shapes (p, 3) and (p, 3, 3)
    spread : ndarray, shape (p, 3 n, 3 n)
        Covariance of the fields' components, the three of a beacon together: of the noise, and of the site's errors as
        the adjustment knows them.
    noise_T : float
    """

    position_m: FloatArray
    rotation: FloatArray
    spread: FloatArray
    noise_T: float


def trusted(site: Site, solution: Solution, residual: float) -> Site:
    """Return a site with standard deviations that make those of poses right, on the average over the walked room.

    Parameters
    ----------
    site : Site
        As it was found, with metal whose ``sd_T_A`` is not known yet.
    solution : Solution
        The completed adjustment.
    residual : float
        That of the epochs that were kept out, 1 for noise alone: what no map shows counts as noise.
    """
    places = _places(solution, max(residual, 1.0))
    found = _Found.of(solution)
    estimated = found.alone(site)

    def too_small(factor: float, left_T: float) -> bool:
        return _square(found.scaled(estimated, factor), places, left_T) > 1.0

    if too_small(1.0, 0.0):
        high = places.noise_T
        for _ in range(MOST_DOUBLINGS):
            if not too_small(1.0, high):
                break
            high *= 2.0
        left_T = _bisected(lambda value: too_small(1.0, value), 0.0, high)
        current = float(np.median([abs(beacon.current_A) for beacon in site.beacons]))
        return with_metal_sd(site, left_T / current)
    return found.scaled(site, _bisected(lambda value: too_small(value, 0.0), LEAST_FACTOR, 1.0))


@dataclass(frozen=True)
class _Found:
    """Which kinds of the site's standard deviations an adjustment has found."""

    position: bool
    axis: bool
    current: bool
    gain: bool
    tilt: bool

    @classmethod
    def of(cls, solution: Solution) -> _Found:
        """Return those of an adjustment."""
        free = solution.problem.prior.free
        sensor = BEACON * len(solution.state.axis)
        position, axis, current = (bool(free[:sensor].reshape(-1, BEACON)[:, k].any()) for k in (0, 3, 5))
        return cls(position, axis, current, bool(free[sensor]), bool(free[sensor + 3]))

    def alone(self, site: Site) -> Site:
        """Return the site with all else called exact, as the adjustment took it."""
        sensor = replace(
            site.sensor, gain_sd=self.gain * site.sensor.gain_sd, axis_sd_rad=self.tilt * site.sensor.axis_sd_rad
        )
        return replace(_with_factors(site, self.position, self.axis, self.current), sensor=sensor)

    def scaled(self, site: Site, factor: float) -> Site:
        """Return the site with what was found of the beacons a factor times as uncertain."""
        position, axis, current = (factor if one else 1.0 for one in (self.position, self.axis, self.current))
        return _with_factors(site, position, axis, current)


def _with_factors(site: Site, position: float, axis: float, current: float) -> Site:
    """Return the site with the beacons' standard deviations times factors."""
    beacons = []
    for beacon in site.beacons:
        old = beacon.survey
        survey = Survey(position * old.position_sd_m, axis * old.axis_sd_rad, current * old.current_sd)
        beacons.append(replace(beacon, survey=survey))
    return replace(site, beacons=tuple(beacons))


def with_metal_sd(site: Site, sd_T_A: float) -> Site:
    """Return the site with another standard deviation of what is left of its metal."""
    assert site.metal is not None
    metal = replace(site.metal, sd_T_A=sd_T_A)
    beacons = tuple(
        beacon if beacon.metal is None else replace(beacon, metal=replace(beacon.metal, metal=metal))
        for beacon in site.beacons
    )
    return replace(site, metal=metal, beacons=beacons)


def _places(solution: Solution, residual: float) -> _Places:
    """Return places between those of the walk, with attitudes of the walk; always the same."""
    rng = np.random.default_rng(1)
    rows = np.flatnonzero(solution.sound)
    one, other = rng.choice(rows, (2, PLACES))
    part = rng.uniform(size=(PLACES, 1))
    walked, turns = solution.state.sensor_m, solution.state.rotation
    position, rotation = part * walked[one] + (1.0 - part) * walked[other], turns[one]
    state, problem = solution.state, solution.problem
    count = len(state.position_m)
    effect = _effects(solution, position, rotation)
    finite = np.where(np.isfinite(problem.readings.sigma_T), problem.readings.sigma_T, np.nan)
    noise = float(np.nanmedian(finite))
    spread = effect @ solution.covariance @ effect.swapaxes(1, 2) + (noise * residual) ** 2 * np.eye(3 * count)
    return _Places(position, rotation, spread, noise)


def _effects(solution: Solution, position_m: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the derivatives of the components by what all epochs have in common, shape (p, 3 n, g)."""
    state, problem = solution.state, solution.problem
    places, count = len(position_m), len(state.position_m)
    model = FieldModel(beacons_of(problem.site, state))
    nothing = np.zeros((places, count, 3))
    parts = derivatives(model, state, problem.axes, nothing, position_m, rotation, state.matrix())
    harmonics, bodies = parts.harmonics.shape[3], parts.bodies.shape[3]
    first = BEACON * count + SENSOR
    effect = np.zeros((places, count, 3, first + count * harmonics + bodies))
    for i in range(count):
        effect[:, i, :, BEACON * i : BEACON * (i + 1)] = parts.beacon[:, i]
        effect[:, i, :, first + harmonics * i : first + harmonics * (i + 1)] = parts.harmonics[:, i]
    effect[..., BEACON * count : first] = parts.sensor
    effect[..., first + count * harmonics :] = parts.bodies
    return effect.reshape(places, 3 * count, -1)


def _square(site: Site, places: _Places, left_T: float) -> float:
    """Return the mean normalised square of a pose's error, an axis, if so much is told as noise of the metal."""
    model, errors = FieldModel(site.beacons), errors_of(site.beacons, site.sensor)
    count = len(site.beacons)
    sigma = np.full((len(places.position_m), count, 3), np.hypot(places.noise_T, left_T))
    whitening: Whitening = Independent((1.0 / sigma).swapaxes(1, 2))
    if errors is not None:
        whitening = whitening_around(model, errors, sigma, places.position_m, places.rotation)
    jacobian = whitened_jacobian(model, places.position_m, places.rotation, whitening)  # (p, 6, 3 n)
    units = np.eye(3 * count).reshape(3 * count, count, 3).swapaxes(1, 2)
    each = whitening(np.broadcast_to(units, (len(sigma), *units.shape)))  # (p, 3 n, 3 n)
    told = np.linalg.inv(jacobian @ jacobian.swapaxes(1, 2))
    gain = told @ jacobian @ each.swapaxes(1, 2)
    real = (gain @ places.spread @ gain.swapaxes(1, 2))[:, :3, :3]
    return float(np.nanmean(np.einsum("pij,pji->p", np.linalg.inv(told[:, :3, :3]), real))) / 3.0


def _bisected(too_small: Callable[[float], bool], low: float, high: float) -> float:
    """Return the value, between two, from which on one is no longer too small."""
    while high - low > TOLERANCE * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if too_small(middle) else (low, middle)
    return high

"""Where beacons should be: places, axes and currents for the least position bound under constraints.

From the start an exchange moves single beacons to the places of a coarse grid in the allowed regions as long as that
helps. All that is free is refined together by sequential quadratic programming (Kraft, 1988; SciPy's SLSQP) on the
objective of `goldfield.planning.objective`: from the start itself, from the result of the exchange and, if axes are
free, from axes that lean. Each result is a local optimum of that objective. The start competes by the figure that was
asked for, and by the number of points that are weak or ambiguous; where less power is wished, all its currents are
weakened alike. So the result is never worse than that start, and no claim is made that it is the best there is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import minimize

from goldfield.errors import UserError
from goldfield.planning.grid import Grid
from goldfield.planning.maps import Maps
from goldfield.planning.objective import EXPONENTS, Objective
from goldfield.planning.optimise_file import FIGURES, Region, Wishes
from goldfield.planning.request import Request
from goldfield.planning.spreading import plan
from goldfield.planning.variables import Variables
from goldfield.site import Beacon, Site
from goldfield.types import FloatArray

MOST_BEACONS = 200
"""More are not optimised at once: the time of a step grows with the square of their number."""

MOST_POINTS = 400
"""Points that the objective sees: every second or third of more, in each direction. The figures are of all."""

CANDIDATES = 60
"""Places that the exchange tries for a beacon, about, in all regions."""

SWEEPS = 3
"""Times that the exchange goes through all beacons, at most."""

TILT = 0.4
"""Standard deviation of the components by which the third start's axes lean, of a unit axis."""

STEPS = 60
"""Steps of a refinement, at most."""

GAIN = 1e-3
"""A part of the objective that an exchange must gain."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """A start and what became of it.

    Attributes
    ----------
    site : Site
        The best of all that was found, the start included.
    before, after : Maps
    figure_before_m, figure_after_m : float
    """

    site: Site
    before: Maps
    after: Maps
    figure_before_m: float
    figure_after_m: float


def optimise(
    request: Request, wishes: Wishes, *, workers: int = 1, told: Callable[[str], None] = lambda text: None
) -> Outcome:
    """Improve a site's beacons.

    Parameters
    ----------
    request : Request
        The start, and the points that count.
    wishes : Wishes
    workers : int
        Processes of this machine that compute the maps before and after.
    told : callable, optional
        Is called with a sentence whenever something better is found.

    Raises
    ------
    UserError
        If the start breaks a constraint, or has too many beacons or coils that are not circular.
    """
    _check(request.site, wishes)
    before = after = plan(request, workers=workers)
    start = best = _within(wishes.power, request.site)
    if start is not request.site:
        after = plan(replace(request, site=start), workers=workers)
    figure_before, figure = figure_of(before, wishes), figure_of(after, wishes)
    point = _thinned(request.grid)
    power = wishes.power * sum(beacon.current_A**2 for beacon in request.site.beacons)
    for name, begin in (("start", _same), ("exchange", exchanged), ("tilted start", tilted)):
        site = begin(start, Objective(start, point), wishes)
        if site is start and begin is not _same:
            continue
        for exponent in EXPONENTS:
            if wishes.target_m is not None and figure <= wishes.target_m:
                break
            site = refined(site, Objective(start, point, exponent), wishes, power)
            maps = plan(replace(request, site=site), workers=workers)
            if _doubtful(maps) <= _doubtful(after) and figure_of(maps, wishes) < figure:
                best, after, figure = site, maps, figure_of(maps, wishes)
                told(f"refined from the {name}: {wishes.figure} of the position bound is {100.0 * figure:.3g} cm")
    return Outcome(best, before, after, figure_before, figure)


def figure_of(maps: Maps, wishes: Wishes) -> float:
    """Return the figure that is to become small, m: no more than the wished part of the points exceed it."""
    ordered = np.sort(maps.figures.position_sd_m, axis=None)
    return float(ordered[int(np.ceil(FIGURES[wishes.figure] * (len(ordered) - 1)))])


def _doubtful(maps: Maps) -> int:
    return int((maps.figures.weak | maps.figures.ambiguous).sum())


def _check(site: Site, wishes: Wishes) -> None:
    if len(site.beacons) > MOST_BEACONS:
        raise UserError(f"{len(site.beacons)} beacons are too many to optimise: give at most {MOST_BEACONS}")
    if site.metal is not None:
        raise UserError("the site has [metal], learned with the beacons where they are: leave it out to move them")
    for beacon in site.beacons:
        if beacon.radius_m is None:
            raise UserError(f'beacon "{beacon.id}" is given by its wire: only circular coils can be optimised')
        if not any(region.contains(beacon.position_m) for region in wishes.regions):
            raise UserError(f'beacon "{beacon.id}" is in no [[region]]: start in one, or give it a region of its own')
        if abs(beacon.current_A) > wishes.most_current_A:
            raise UserError(f'beacon "{beacon.id}" has more current than most_current_A: start with less')
    if wishes.power < 1.0 and "current" not in wishes.free:
        raise UserError('power is below 1, but no current may change: put "current" into free')


def _thinned(grid: Grid) -> FloatArray:
    every = max(1, int(np.ceil((len(grid) / MOST_POINTS) ** (1.0 / max(1, sum(n > 1 for n in grid.shape))))))
    axes = [axis[(len(axis) - 1) % every // 2 :: every] for axis in (grid.x_m, grid.y_m, grid.z_m)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def candidates(regions: tuple[Region, ...]) -> FloatArray:
    """Return the places of a coarse grid in all regions, shape (c, 3), about `CANDIDATES`."""
    share = max(4.0, CANDIDATES / len(regions))
    places = []
    for region in regions:
        extent = region.high_m - region.low_m
        open_axes = extent > 0.0
        step = float(np.prod(extent[open_axes]) / share) ** (1.0 / max(1, int(open_axes.sum())))
        counts = np.where(open_axes, np.maximum(2, np.round(extent / step) + 1), 1).astype(int)
        axes = [np.linspace(low, high, n) for low, high, n in zip(region.low_m, region.high_m, counts, strict=True)]
        places += list(product(*axes))
    return np.array(places)


def _within(power: float, site: Site) -> Site:
    """Return the site with so much of its power, if that is less than all."""
    if power >= 1.0:
        return site
    beacons = [replace(beacon, current_A=beacon.current_A * float(np.sqrt(power))) for beacon in site.beacons]
    return replace(site, beacons=tuple(beacons))


def _same(site: Site, objective: Objective, wishes: Wishes) -> Site:
    return site


def tilted(site: Site, objective: Objective, wishes: Wishes) -> Site:
    """Return the site with axes that lean to all sides, if axes are free: parallel ones may be a saddle."""
    if "axis" not in wishes.free:
        return site
    lean = np.random.default_rng(0).normal(scale=TILT, size=(len(site.beacons), 3))
    beacons = []
    for beacon, vector in zip(site.beacons, lean, strict=True):
        axis = beacon.axis + vector
        beacons.append(replace(beacon, axis=axis / np.linalg.norm(axis)))
    return replace(site, beacons=tuple(beacons))


@np.errstate(all="ignore")  # a candidate whose wire runs through a point
def exchanged(site: Site, objective: Objective, wishes: Wishes) -> Site:
    """Return the site after single beacons were moved to better candidates, if places are free."""
    if "position" not in wishes.free:
        return site
    places, beacons = candidates(wishes.regions), list(site.beacons)
    sigma = site.sensor.noise_T / np.sqrt(site.chips)
    each = _information(objective, beacons, sigma)
    for _ in range(SWEEPS):
        moves = 0
        for index, beacon in enumerate(beacons):
            tried = [replace(beacon, position_m=place) for place in places]
            others = each.sum(axis=0) - each[index]
            told = _information(objective, tried, sigma)
            value = np.array([float(objective.of_information(others + one)) for one in told])
            now = float(objective.of_information(others + each[index]))
            chosen = int(np.nanargmin(value))
            if value[chosen] < (1.0 - GAIN) * now:
                beacons[index], each[index], moves = tried[chosen], told[chosen], moves + 1
        if not moves:
            break
    return replace(site, beacons=tuple(beacons))


def _information(objective: Objective, beacons: list[Beacon], sigma_T: float) -> FloatArray:
    """Return each beacon's M_i, shape (n, e, k, k)."""
    column = objective.columns(beacons, np.full(len(beacons), sigma_T))
    return np.asarray(np.einsum("encj,enck->nejk", column, column, optimize=True))


def refined(site: Site, objective: Objective, wishes: Wishes, power_A2: float) -> Site:
    """Return the site at a local optimum of the objective near it, every constraint kept."""
    variables = Variables(site, wishes, power_A2)

    def evaluate(x: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = objective.with_gradient(variables.beacons(x))
        return value / scale, variables.gradient(x, gradient) / scale

    scale = objective.with_gradient(variables.beacons(variables.start))[0]
    result = minimize(
        evaluate,
        variables.start,
        jac=True,
        method="SLSQP",
        bounds=variables.bounds,
        constraints=variables.constraints,
        options={"maxiter": STEPS, "ftol": 1e-6},
    )
    return replace(site, beacons=tuple(variables.beacons(variables.kept(result.x))))

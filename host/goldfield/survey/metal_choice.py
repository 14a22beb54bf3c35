"""A survey that learns what metal adds: which polynomials and how many bodies is decided by epochs that are kept out.

One candidate after another is fitted to four fifths of the walk and judged by the poses of the rest: by the logarithm
of their chi-square over the degrees of freedom, epoch by epoch. A richer candidate takes the place of a plainer one
only if it is better by more than chance, so that a room without metal stays as it is. Bodies start where the
polynomials' field shows them, one after another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import chdtri

from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.field.dipole import dipole
from goldfield.locate.constellation import Constellation
from goldfield.site import Site
from goldfield.site.metal import MOST_DEGREE, symmetric
from goldfield.survey.data import Free, MetalFound, SurveyData, SurveyResult
from goldfield.survey.metal import MetalState, effects_of_bodies, no_metal, polynomials_around
from goldfield.survey.metal_rest import completed, trusted
from goldfield.survey.outcome import Solution, found_site
from goldfield.survey.parameters import beacons_of
from goldfield.survey.problem import problem_of
from goldfield.survey.procedure import Progress, result_of, solve
from goldfield.survey.starts import located, measurements_of
from goldfield.survey.strays import gathered
from goldfield.types import FloatArray

PIECES, KEPT_OUT = 25, 5
"""The walk is cut into so many pieces, of which each fifth is kept out: neighbours in time are neighbours in place."""
SURE = 3.0
"""A candidate is better if the mean of its gains exceeds so many of its standard deviations,"""
WORTH = 0.02
"""and this: 1 % of the residual."""
FIRST_DEGREE, SEEN_DEGREE, LAST_HYBRID = 2, 4, 3
"""Least degree that is tried, the one whose field shows the bodies, and the highest together with bodies."""
MOST_TRIED = 6
"""Bodies that are tried."""
AROUND, GRID = 0.6, 12
"""How far beyond the beacons and the walk bodies are looked for, as a part of the longest edge, and points along it."""
APART = 0.04
"""Least distance of a body from the walk and the coils, as a part of the longest edge."""
MARGIN = 0.05
"""By how much the walked room is taken for larger, as a part of its radius."""
CORNERS = 42
"""Corners of the walked room, at most."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A candidate: its solution, and chi-square and freedom of each epoch that was kept out."""

    solution: Solution
    squares: FloatArray
    freedom: FloatArray

    @property
    def score(self) -> FloatArray:
        """Logarithm of chi-square over the freedom of each epoch that was kept out; NaN without a pose."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.where(self.freedom > 0.0, np.log(self.squares / self.freedom), np.nan))

    def excess(self) -> float:
        """Return the usual chi-square over that of noise alone."""
        known = np.isfinite(self.score)
        return float(np.median(self.squares[known] / chdtri(self.freedom[known], 0.5)))

    @property
    def metal(self) -> MetalState:
        return self.solution.state.metal

    def better_than(self, other: _Candidate) -> bool:
        """Tell whether it explains the epochs that were kept out better by more than chance."""
        gain, needed = self.gain_over(other)
        return gain > needed

    def gain_over(self, other: _Candidate) -> tuple[float, float]:
        """Return by how much the logarithm of the usual chi-square is less, and by how much it is if not by chance."""
        gain = other.score - self.score
        gain = gain[np.isfinite(gain)]
        if len(gain) < 2:
            return 0.0, np.inf
        chance = float(gain.std(ddof=1) / np.sqrt(len(gain)))
        return float(gain.mean()), max(SURE * chance, WORTH)


def survey_with_metal(
    site: Site, data: SurveyData, free: frozenset[Free], progress: Progress | None = None
) -> SurveyResult:
    """Find beacons, sensor and metal; as `goldfield.survey.procedure.survey`, with `Free.FIELD` among ``free``.

    Raises
    ------
    UserError, SystemFailure
        As in `survey`; also if there is no walk that could tell of metal.
    """
    tell = progress if progress is not None else (lambda what, part: None)
    bare = replace(site, metal=None, beacons=tuple(replace(beacon, metal=None) for beacon in site.beacons))
    if len(data.epochs) < 4 * PIECES:
        raise UserError(
            f"metal is learned from a walk of at least {4 * PIECES} epochs, and there are {len(data.epochs)}: walk "
            "through the whole room"
        )
    walk = gathered(bare, data, free, tell)
    data = walk.data
    choice = _Choice(bare, data, free, tell)
    best = choice.best()
    tell("last fit", 0.9)
    solution = solve(bare, data, free, metal=best.metal)
    if not best.metal.is_none:
        whole = choice.completed(best)
        if not best.better_than(whole):
            solution, best = completed(bare, data, free, solution, choice.around(best)), whole
    without = float(np.sqrt(choice.plain.excess()))
    found = MetalFound(without, float(np.sqrt(best.excess())), choice.unseen_T, found_site(choice.plain.solution))
    result = walk.all_told(replace(result_of(bare, solution, data, free), metal=found))
    if best.metal.is_none:
        return result
    sound = solution.state.sensor_m[solution.sound]
    metal = solution.state.metal.metal(0.0, walked_room(sound, solution.state.metal.radius_m))
    beacons = solution.state.metal.added_to(bare.beacons, result.site.beacons, metal)
    mapped = replace(result.site, beacons=beacons, metal=metal)
    return replace(result, site=trusted(mapped, solution, found.residual_with))


class _Choice:
    """Fits candidates to a part of the walk and compares them on the rest."""

    def __init__(self, site: Site, data: SurveyData, free: frozenset[Free], tell: Progress) -> None:
        self._site, self._free, self._tell = site, free, tell
        piece = np.arange(len(data.epochs)) * PIECES // len(data.epochs)
        out: NDArray[np.bool_] = np.asarray(piece % KEPT_OUT == KEPT_OUT // 2)
        self._part, self._kept_out = data.of_epochs(~out), data.of_epochs(out).epochs
        self._done, self._needed = 0.0, np.inf
        self.plain = self._candidate(no_metal(len(site.beacons)), None, "no metal")

    @property
    def unseen_T(self) -> float:
        """What metal may add to each component unnoticed: what the polynomial that tells most needs to gain."""
        sigma = float(np.median(np.concatenate([fields.sigma_T for fields in self._kept_out])))
        return float(np.sqrt(np.expm1(self._needed))) * sigma

    def best(self) -> _Candidate:
        """Return the best candidate."""
        plain = self.plain
        best, seen = plain, None
        for degree in range(FIRST_DEGREE, MOST_DEGREE + 1):
            state = self.polynomials(plain, degree)
            found = self._candidate(state, plain.solution, f"polynomials of degree {degree}")
            self._needed = min(self._needed, found.gain_over(plain)[1])
            seen = found if degree == SEEN_DEGREE else seen
            if found.better_than(best):
                best = found
        assert seen is not None
        if not best.metal.is_none:
            bodies = self._bodies(plain, seen)
            if bodies is not None:
                best = self._plainer(bodies, best)
        return best

    @staticmethod
    def _plainer(bodies: _Candidate, other: _Candidate) -> _Candidate:
        """Return the better of two, of two that are alike the one with fewer unknowns."""
        if other.better_than(bodies):
            return other
        if bodies.better_than(other) or bodies.metal.size <= other.metal.size:
            return bodies
        return other

    def _bodies(self, plain: _Candidate, seen: _Candidate) -> _Candidate | None:
        """Return the best candidate with bodies, alone or with polynomials; None if no body is better than none."""
        best, before = None, plain
        for count in range(1, MOST_TRIED + 1):
            start = self._placed(seen, before.metal)
            if start is None:
                break
            found = self._candidate(start, before.solution, f"{count} bodies" if count > 1 else "a body")
            if not found.better_than(before):
                break
            best = before = found
        if best is None:
            return None
        alone = best
        for degree in range(FIRST_DEGREE, LAST_HYBRID + 1):
            state = self.polynomials(plain, degree)
            state = replace(state, body_m=alone.metal.body_m, polarisability=alone.metal.polarisability)
            found = self._candidate(state, alone.solution, f"bodies and polynomials of degree {degree}")
            if found.better_than(best):
                best = found
        return best

    def completed(self, best: _Candidate) -> _Candidate:
        """Return the candidate with what its metal leaves (`completed`)."""
        self._tell("what the metal leaves", 0.85)
        around = self.around(best)
        return self._of(completed(self._site, self._part, self._free, best.solution, around, robust=True))

    def around(self, best: _Candidate) -> MetalState:
        """Return metal with the centre and the radius of a candidate's polynomials, which it may be without."""
        return best.metal if best.metal.degree else self.polynomials(self.plain, MOST_DEGREE)

    def _candidate(self, metal: MetalState, start: Solution | None, name: str) -> _Candidate:
        self._done = min(self._done + 0.05, 0.85)
        self._tell(name, self._done)
        state = None if start is None else start.state
        return self._of(solve(self._site, self._part, self._free, metal=metal, start=state, judged=False))

    def _of(self, solution: Solution) -> _Candidate:
        """Judge a solution by the epochs that are kept out."""
        problem = problem_of(self._site, SurveyData(self._kept_out), self._free)
        measurements = measurements_of(problem, solution.state, 0.0)
        model = FieldModel(beacons_of(self._site, solution.state))
        fit = located(Constellation(model, self._site.half_space), measurements)
        squares = np.where(np.isfinite(fit.cost), fit.cost, np.nan)
        return _Candidate(solution, squares, 3.0 * measurements.known.sum(axis=1) - 6.0)

    def polynomials(self, plain: _Candidate, degree: int) -> MetalState:
        """Return polynomials around what was walked."""
        return polynomials_around(plain.solution.state.sensor_m, len(self._site.beacons), degree)

    def _placed(self, seen: _Candidate, before: MetalState) -> MetalState | None:
        """Return the bodies so far and one more, where the polynomials' field is explained best."""
        walked = seen.solution.state.sensor_m[:: max(len(seen.solution.state.sensor_m) // 150, 1)]
        beacons = beacons_of(self._site, seen.solution.state)
        model = FieldModel(beacons)
        assert model.metal is not None
        wanted = model.metal.evaluate(np.ascontiguousarray(walked.T))[0].transpose(1, 2, 0)  # (e, n, 3)
        coils = FieldModel([replace(beacon, metal=None) for beacon in beacons])
        rest = wanted - _of_bodies(coils, before.body_m, before.polarisability, walked)
        found = [_explained(coils, rest, place, walked) for place in self._places(walked, coils)]
        if not found:
            return None
        _, place, numbers = max(found, key=lambda item: item[0])
        places, numbers = np.vstack([before.body_m, place]), np.vstack([before.polarisability, numbers])
        places, numbers = _refined(coils, wanted, places, numbers, walked)
        return replace(before, body_m=places, polarisability=numbers)

    def _places(self, walked: FloatArray, coils: FieldModel) -> FloatArray:
        """Return places where a body may be, shape (q, 3): around the walk and the coils, but not at them."""
        everything = np.vstack([walked, coils.centre_m])
        low, high = everything.min(axis=0), everything.max(axis=0)
        edge = float((high - low).max())
        spacing = (1.0 + 2.0 * AROUND) * edge / GRID
        axes = [np.arange(a - AROUND * edge, b + AROUND * edge, spacing) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        near = np.linalg.norm(grid[:, None] - everything, axis=2).min(axis=1)
        return np.asarray(grid[near > max(APART * edge, 0.5 * spacing)])


def _of_bodies(coils: FieldModel, body_m: FloatArray, polarisability: FloatArray, point_m: FloatArray) -> FloatArray:
    """Return the fields of bodies, shape (e, n, 3)."""
    result = np.zeros((len(point_m), len(coils), 3))
    at_body = coils.field(body_m)  # (k, n, 3)
    for place, matrix, field in zip(body_m, symmetric(polarisability), at_body, strict=True):
        offset, moment = (point_m - place).T[..., None], (field @ matrix).T[:, None]
        result += dipole(offset, moment)[0].transpose(1, 2, 0)
    return result


def _explained(
    coils: FieldModel, rest_T: FloatArray, place: FloatArray, point_m: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Return how much of the fields one body at a place explains, the place, and its polarisability that does."""
    metal = replace(no_metal(len(coils)), body_m=place[None], polarisability=np.zeros((1, 6)))
    rows = effects_of_bodies(metal, coils, point_m)[..., 3:].reshape(-1, 6)
    normal, right = rows.T @ rows, rows.T @ rest_T.ravel()
    numbers = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(6), right)
    return float(right @ numbers), place, numbers


def _refined(
    coils: FieldModel, wanted_T: FloatArray, body_m: FloatArray, polarisability: FloatArray, point_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return places and polarisabilities of bodies that explain fields best, from some near by."""
    metal = replace(no_metal(len(coils)), body_m=body_m, polarisability=polarisability)

    def at(numbers: FloatArray) -> MetalState:
        return metal.moved(numbers)

    def residual(numbers: FloatArray) -> FloatArray:
        now = at(numbers)
        return np.asarray(1e9 * (_of_bodies(coils, now.body_m, now.polarisability, point_m) - wanted_T).ravel())

    def jacobian(numbers: FloatArray) -> FloatArray:
        slopes = 1e9 * effects_of_bodies(at(numbers), coils, point_m)
        return np.asarray(slopes.reshape(-1, metal.size))

    with np.errstate(all="ignore"):
        found = least_squares(residual, np.zeros(metal.size), jac=jacobian, x_scale="jac", max_nfev=40)
    best = at(found.x)
    return best.body_m, best.polarisability


def walked_room(position_m: FloatArray, radius_m: float) -> FloatArray:
    """Return corners of a convex room that holds all positions, a little larger; it is nowhere flat.

    Parameters
    ----------
    position_m : ndarray, shape (e, 3)
    radius_m : float

    Returns
    -------
    ndarray, shape (v, 3)
        The outermost points along evenly spread directions, `CORNERS` of them or fewer.
    """
    margin = MARGIN * radius_m
    points = np.concatenate([position_m + sign * margin * axis for axis in np.eye(3) for sign in (-1.0, 1.0)])
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(CORNERS)
    height = 1.0 - (2.0 * np.arange(CORNERS) + 1.0) / CORNERS
    width = np.sqrt(1.0 - height**2)
    directions = np.column_stack([width * np.cos(turn), width * np.sin(turn), height])
    return np.unique(points[(points @ directions.T).argmax(axis=0)], axis=0)

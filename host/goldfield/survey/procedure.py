"""The survey from beginning to end: rough poses, graduated fits, outliers, the last fit, and what came out of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, gammaincc

from goldfield.errors import SystemFailure, UserError
from goldfield.field import FieldModel
from goldfield.locate.fit import fit_pose
from goldfield.site import Site
from goldfield.survey.adjustment import (
    FINE_PROGRESS,
    ROUGH_PROGRESS,
    STAGES,
    Evaluation,
    Problem,
    adjust,
    anchor_error,
    anchor_levers,
    evaluate,
)
from goldfield.survey.advice import advice_of
from goldfield.survey.anchor_tables import sensors_elsewhere
from goldfield.survey.constraints import name_of_known
from goldfield.survey.data import Free, SurveyData, SurveyResult
from goldfield.survey.equations import Readings, inverse
from goldfield.survey.levers import untold_levers
from goldfield.survey.metal import MetalState
from goldfield.survey.outcome import Solution, found_site, outliers_of, parameters_of
from goldfield.survey.parameters import BEACON, TERMS, State, default_free, start_of
from goldfield.survey.problem import problem_of
from goldfield.survey.reversals import reversals_in_words, right_way_round
from goldfield.survey.starts import anchor_attitudes, levers_alone, measurements_of, rough_poses, searched_poses
from goldfield.survey.surprises import surprises
from goldfield.types import FloatArray

UNLIKELY = 1e-5
"""An epoch is an outlier if its residual is less likely than this."""
WIDENED, REFUSED = 1.5, 9.0
"""Median chi-square over the degrees of freedom: from the first on the standard deviations of the fields are widened,
from the second on nothing fits and the survey is refused."""
LEAST_SOUND = 0.5
"""Part of the epochs that must agree."""
WRONG_POINT = float(chdtri(3.0, UNLIKELY))
"""Square of a known point's deviation, in standard deviations, from which on it does not fit."""
MOST_WRONG_POINTS = 5
"""Known points that may be left out since they do not fit."""
ANCHOR_ROUNDS, SETTLED = 6, 0.1
"""How often the model's error at the anchors and the size of their levers are estimated from how well they fit, at
most, and the relative change of them that ends that."""
ROUNDS = 3
"""How often epochs are judged anew."""

Progress = Callable[[str, float], None]
"""(what is being done, part of the whole that is done) -> None."""


def chosen_free(site: Site, free: frozenset[Free] | None = None) -> frozenset[Free]:
    """Return what a survey estimates: what was asked for, else everything that the site does not call exact.

    Raises
    ------
    UserError
        If that is nothing; no walk changes it.
    """
    free = default_free(site) if free is None else free
    if not free:
        raise UserError(
            f'the site "{site.name}" says that everything is exact, so there is nothing to estimate: say with --free '
            "what is to be found, or give standard deviations in its [survey]"
        )
    return free


def survey(
    site: Site, data: SurveyData, free: frozenset[Free] | None = None, progress: Progress | None = None
) -> SurveyResult:
    """Find beacons and sensor as they are.

    Parameters
    ----------
    site : Site
        As it is thought to be: what its ``[survey]`` and ``[sensor]`` say counts as a measurement.
    data : SurveyData
    free : set of Free, optional
        What is estimated; by default everything that the site does not call exact, and no offset.
    progress : callable, optional
        Is told what is being done.

    Returns
    -------
    SurveyResult

    Raises
    ------
    UserError
        If there is nothing to estimate, or too little was measured.
    SystemFailure
        If no survey fits what was measured.
    """
    free = chosen_free(site, free)
    solution = solve(site, data, free, progress=progress)
    return result_of(site, solution, data, free)


def solve(
    site: Site,
    data: SurveyData,
    free: frozenset[Free],
    *,
    metal: MetalState | None = None,
    start: State | None = None,
    judged: bool = True,
    progress: Progress | None = None,
) -> Solution:
    """Adjust everything.

    Parameters
    ----------
    site, data, free
        As in `survey`.
    metal : MetalState, optional
        Unknowns of metal, with the values to start from.
    start : State, optional
        Beacons, sensor and poses to start from, near the truth; by default those of the site, and rough poses.
    judged : bool
        Whether outliers are left out, and a survey that does not fit is refused; if not, all epochs count as sound and
        nothing is told of the uncertainty.
    progress : callable, optional

    Raises
    ------
    UserError, SystemFailure
        As in `survey`.
    """
    problem = problem_of(site, data, free, metal)
    tell_progress = progress if progress is not None else (lambda what, part: None)
    if start is None:
        stages: tuple[float, ...] = STAGES
        state = start_of(site, len(data.epochs), len(data.anchors), metal)
        tell_progress("rough poses", 0.0)
        if data.epochs:
            state = rough_poses(problem, state)
            turned = right_way_round(site, problem, state)
            if turned is not site:
                problem = problem_of(turned, data, free, metal)
                state = rough_poses(problem, state)
        if data.anchors:
            lever = problem.anchor_known[:, TERMS:]
            state = replace(state, anchor_rotation=anchor_attitudes(problem, state), anchor_lever_m=lever)
    else:
        state = replace(start, metal=problem.prior.start.metal)
        stages = STAGES[-3:]
    state, now = _through_stages(problem, state, stages, tell_progress)
    return _judged(problem, state, now, tell_progress) if judged else _unjudged(problem, state, now)


def result_of(site: Site, solution: Solution, data: SurveyData, free: frozenset[Free]) -> SurveyResult:
    """Return what is told of an adjustment; ``site`` is as it was before."""
    found = found_site(solution)
    count = BEACON * len(found.beacons)
    gone = ~solution.sound
    return SurveyResult(
        site=found,
        parameters=parameters_of(site, solution, free),
        covariance=solution.covariance[:count, :count],
        residual_before=solution.residual_before,
        residual_after=solution.residual_after,
        outliers=outliers_of(solution, found, data.epochs),
        advice=(
            *reversals_in_words(site, found),
            *surprises(solution),
            *untold_levers(solution),
            *sensors_elsewhere(found, data.anchors),
            *advice_of(solution, data, free),
        ),
        position_m=np.where(gone[:, None], np.nan, solution.state.sensor_m),
        rotation=np.where(gone[:, None, None], np.nan, solution.state.rotation),
    )


def _through_stages(
    problem: Problem, state: State, stages: tuple[float, ...], progress: Progress
) -> tuple[State, Evaluation]:
    """Adjust through the stages, with a robust loss."""
    for place, model_error in enumerate(stages):
        progress(f"fit with a model error of {100.0 * model_error:g} %", 0.1 + 0.1 * place)
        state, now = adjust(
            problem, state, model_error, robust=True, progress=ROUGH_PROGRESS if model_error else FINE_PROGRESS
        )
    return state, now


def _unjudged(problem: Problem, state: State, now: Evaluation) -> Solution:
    sound = np.ones(len(state.sensor_m), dtype=bool)
    none = np.zeros((len(problem.prior.free),) * 2)
    return Solution(problem, state, sound, now, now.squares, none, 1.0, np.nan, np.nan)


def _judged(problem: Problem, state: State, now: Evaluation, progress: Progress) -> Solution:
    """Find the outliers, and adjust the rest once more without any robust loss."""
    searched = np.zeros(len(state.sensor_m), dtype=bool)
    for place in range(ROUNDS):
        lost = ~(_likely(now.squares, problem.readings.count) | searched)
        if not lost.any():
            break
        searched |= lost
        progress(f"search for {int(lost.sum())} epochs that do not fit", 0.6 + 0.08 * place)
        tried = searched_poses(problem, state, np.flatnonzero(lost))
        squares = evaluate(problem, tried).squares
        elsewhere = lost & _likely(squares, problem.readings.count) & (_off_points(problem, tried) > WRONG_POINT)
        weight = np.where(elsewhere[:, None], 0.0, problem.point_weight)
        problem = replace(problem, point_weight=weight)
        better = lost & (squares < now.squares - 1.0)
        if not better.any():
            break
        state = replace(
            state,
            sensor_m=np.where(better[:, None], tried.sensor_m, state.sensor_m),
            rotation=np.where(better[:, None, None], tried.rotation, state.rotation),
        )
        state, now = adjust(problem, state, robust=True)
    widened = _widening(problem, state, now)
    if widened > 1.0:
        problem = replace(problem, readings=Readings(problem.readings.field_T, widened * problem.readings.sigma_T))
        state, now = adjust(problem, state, robust=True)
    sound = _likely(now.squares, problem.readings.count)
    problem, state, sound, last = _last_fit(problem, state, sound, progress)
    covariance = covariance_of(problem, last)
    for _ in range(ANCHOR_ROUNDS if problem.anchor_rows else 0):
        error, sd = anchor_error(problem, state, covariance), anchor_levers(problem, state, covariance)
        changes = np.append(sd / problem.anchor_sd, error / problem.anchor_error)
        problem = replace(problem, anchor_error=error, anchor_sd=sd)
        problem, state, sound, last = _last_fit(problem, state, sound, progress)
        covariance = covariance_of(problem, last)
        if np.abs(changes - 1.0).max() < SETTLED:
            break
    return Solution(
        problem,
        state,
        sound,
        last,
        evaluate(problem, state).squares,
        covariance,
        widened,
        *_residuals(problem, state, sound, last),
    )


def covariance_of(problem: Problem, last: Evaluation) -> FloatArray:
    """Return the covariance of the common parameters, 0 for those that are not estimated."""
    free = problem.prior.free
    matrix, _, _ = last.equations.reduced()
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(free, free)] = inverse(matrix)
    return covariance


def _last_fit(
    problem: Problem, state: State, sound: NDArray[np.bool_], progress: Progress
) -> tuple[Problem, State, NDArray[np.bool_], Evaluation]:
    """Adjust the sound epochs without a robust loss; those that turn out to be unsound are left out, and so on.

    The known point that fits worst is left out, too, if it does not fit: its weight in the problem is then 0.
    """
    for place in range(ROUNDS + MOST_WRONG_POINTS):
        _check_sound(sound)
        progress(f"last fit of {int(sound.sum())} epochs", 0.9)
        kept, last = adjust(problem.of_epochs(sound), state.of_epochs(sound))
        state = with_poses(state, kept, sound)
        still = _likely(last.squares, problem.readings.count[sound])
        off = _off_points(problem, state) * sound
        wrong = int(np.argmax(off)) if len(off) and off.max() > WRONG_POINT else None
        if still.all() and wrong is None:
            break
        if not still.all() and place < ROUNDS:
            sound[np.flatnonzero(sound)[~still]] = False
        elif wrong is not None:
            weight = problem.point_weight.copy()
            weight[wrong] = 0.0
            problem = replace(problem, point_weight=weight)
    return problem, state, sound, last


def _off_points(problem: Problem, state: State) -> FloatArray:
    """Return the squares of the deviations of the poses from known points, in standard deviations, shape (e,)."""
    return np.asarray(((problem.point_weight * (problem.point_m - state.sensor_m)) ** 2).sum(axis=1))


def with_poses(state: State, some: State, rows: NDArray[np.bool_]) -> State:
    """Return the state of some epochs, with the poses of the others."""
    position, rotation = state.sensor_m.copy(), state.rotation.copy()
    position[rows], rotation[rows] = some.sensor_m, some.rotation
    return replace(some, sensor_m=position, rotation=rotation)


def _likely(squares: FloatArray, count: FloatArray) -> NDArray[np.bool_]:
    """Tell which epochs, shape (e,), have a chi-square that noise explains; those without redundancy have none."""
    freedom = count - 6.0
    finite = np.where(np.isfinite(squares), squares, np.inf)
    return np.asarray((freedom > 0.0) & (gammaincc(np.maximum(freedom, 1.0) / 2.0, finite / 2.0) > UNLIKELY))


def _widening(problem: Problem, state: State, now: Evaluation) -> float:
    """Return by what the fields' deviations must be multiplied so that the usual epoch fits.

    Raises
    ------
    SystemFailure
        If the usual epoch is far from fitting.
    """
    freedom = problem.readings.count - 6.0
    some = freedom > 0.0
    if not some.any():
        return 1.0
    usual = float(np.median(now.squares[some] / chdtri(freedom[some], 0.5)))
    if not usual < REFUSED:
        raise SystemFailure(_refusal(problem, state, now, usual))
    return float(np.sqrt(usual)) if usual > WIDENED else 1.0


def _refusal(problem: Problem, state: State, now: Evaluation, usual: float) -> str:
    """Say that nothing fits, which beacon fits worst, and what is known and contradicts the rest."""
    measured = np.isfinite(problem.readings.sigma_T).any(axis=2)
    size = np.where(measured, now.by_beacon, np.nan)
    heard = np.asarray(measured.any(axis=0))
    each = np.full(len(heard), -np.inf)
    each[heard] = np.nanmedian(size[:, heard], axis=0)
    worst = problem.site.beacons[int(np.argmax(each))].id
    unfit = sorted(problem.constraints.unfit(state), key=lambda one: -one[1])
    contradicted = "".join(
        f"{name_of_known(known)} does not fit, by {size:.3g} of its standard deviations: check it first; "
        for known, size in unfit[:1]
    )
    return (
        f"no survey fits the fields: the usual epoch has a residual of {np.sqrt(usual):.3g}, where a sound one has 1; "
        f"{contradicted}{worst} fits worst: check its entry in the site file, whether [survey] and [sensor] allow for "
        "how wrong the site may be, sigma_T, and whether metal is near"
    )


def _check_sound(sound: NDArray[np.bool_]) -> None:
    if 0 < LEAST_SOUND * sound.size > sound.sum():
        raise SystemFailure(
            f"only {int(sound.sum())} of {len(sound)} epochs agree with each other: walk again slowly, away from "
            "metal, or check sigma_T"
        )


def _residuals(problem: Problem, state: State, sound: NDArray[np.bool_], last: Evaluation) -> tuple[float, float]:
    """Return the normalised residuals of the sound epochs with the site as it was, and as it was found."""
    freedom = float((problem.readings.count[sound] - 6.0).sum())
    if freedom <= 0.0:
        anchors = float(problem.anchors.count.sum())
        value = float(np.sqrt(last.anchor_squares.sum() / max(anchors - 6.0 * len(problem.anchor_rows), 1.0)))
        return float("nan"), value
    some = problem.of_epochs(sound)
    start = replace(problem.prior.start, sensor_m=state.sensor_m[sound], rotation=state.rotation[sound])
    measurements = measurements_of(some, start, 0.0)
    measurements.errors = levers_alone(problem.site)
    fit = fit_pose(FieldModel(problem.site.beacons), measurements, start.sensor_m, start.rotation)
    before = float(np.sqrt(fit.cost[np.isfinite(fit.cost)].sum() / freedom))
    return before, float(np.sqrt(last.squares.sum() / freedom))

"""The adjustment: Levenberg and Marquardt on the whole cost, over what all epochs have in common and all poses at once.

The cost is the sum over epochs of a loss of their chi-square s, the squares of the deviations of known points from the
poses, of a weak tie of each pose to the room, of what was known before and of what was measured beside. The loss is s,
or Cauchy's c log(1 + s/c) with c twice the number of components: an epoch that fits nowhere then pulls at nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.site import Site
from goldfield.survey.constraints import Constraints
from goldfield.survey.equations import (
    Equations,
    Group,
    Readings,
    anchor_equations,
    derivatives,
    walk_equations,
)
from goldfield.survey.parameters import ANCHOR, ANCHOR_LEVER, ANCHOR_TERMS, Prior, State, beacons_of, matrix_of
from goldfield.types import FloatArray

STAGES = (0.15, 0.05, 0.02, 0.005, 0.0)
"""Relative errors of the model, one fit after another: first all fields count alike, whatever their strength, so that
a site that is 20 cm wrong fits somewhere; each fit starts where the one before ended."""
LOSS_SCALE = 2.0
"""Scale of Cauchy's loss over the number of an epoch's components."""
AT_ONCE = 1024
"""Epochs that are evaluated at once, so that a long walk takes little more memory than what is kept of it."""
MOST_STEPS = 60
ROUGH_PROGRESS, FINE_PROGRESS = 1e-3, 1e-7
"""A fit ends when a step promises to lower the cost by less than this part of it, and of 1 at the least."""
ANCHOR_MODEL_ERROR, LEAST_ANCHOR_ERROR = 0.002, 2e-4
"""Relative error of the model at an anchor, as by metal: what is assumed first, and the least that is taken from how
well the anchors fit."""
ANCHOR_LEVER_SD_M, LEAST_LEVER_SD_M, MOST_LEVER_SD_M = 0.003, 2e-5, 0.03
"""How far an anchor's sensor stands from the centre of its coil, along each axis, where nobody has measured it: what is
assumed first, and the least and the most that is taken from where the sensors are found to be."""
KNOWN_PLACES = np.arange(ANCHOR_TERMS.start, ANCHOR)
"""Where an anchor's unknowns of which something is known before stand among its own: terms and lever."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that an adjustment takes as given.

    Attributes
    ----------
    site : Site
    axes : ndarray, shape (3, 3)
        The sensor's axes as the site says.
    prior : Prior
    readings : Readings
        Those of the e epochs.
    point_m, point_weight : ndarray, shape (e, 3)
        Known coordinates of the sensor, and reciprocal standard deviations; 0 for those that are not known.
    room_m, room_sd_m : ndarray, shape (3,), and float
        Middle of the room, and how far from it the sensor may be.
    constraints : Constraints
    anchors : Readings
        Those of the a anchors, one epoch each; that of the own beacon is not measured.
    anchor_rows : list of int
        The beacon where each stands.
    anchor_known : ndarray, shape (a, 9)
        Terms and lever of each anchor's sensor as they are known before.
    anchor_sd : ndarray, shape (a, 9)
        Their standard deviations.
    levers_told : ndarray of bool, shape (a,)
        Whether somebody has measured the lever.
    anchor_error : float
        Relative error of the model at an anchor.
    """

    site: Site
    axes: FloatArray
    prior: Prior
    readings: Readings
    point_m: FloatArray
    point_weight: FloatArray
    room_m: FloatArray
    room_sd_m: float
    constraints: Constraints
    anchors: Readings
    anchor_rows: list[int]
    anchor_known: FloatArray
    anchor_sd: FloatArray
    levers_told: NDArray[np.bool_]
    anchor_error: float = ANCHOR_MODEL_ERROR

    def of_epochs(self, rows: NDArray[np.bool_] | slice) -> Problem:
        """Return the problem with some of the epochs."""
        readings = Readings(self.readings.field_T[rows], self.readings.sigma_T[rows])
        return replace(self, readings=readings, point_m=self.point_m[rows], point_weight=self.point_weight[rows])


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The cost of a state and its normal equations.

    Attributes
    ----------
    cost : float
    squares : ndarray, shape (e,)
        Chi-square of each epoch, that of a known point not counted.
    anchor_squares : ndarray, shape (a,)
    by_beacon : ndarray, shape (e, n)
        Chi-square of each beacon's field.
    equations : Equations
    """

    cost: float
    squares: FloatArray
    anchor_squares: FloatArray
    by_beacon: FloatArray
    equations: Equations


@np.errstate(all="ignore")  # a step far off may overflow: a cost that is not finite is not accepted
def evaluate(problem: Problem, state: State, model_error: float = 0.0, *, robust: bool = False) -> Evaluation:
    """Return the cost and the normal equations of a state."""
    model = FieldModel(beacons_of(problem.site, state))
    some = [slice(first, first + AT_ONCE) for first in range(0, max(len(state.sensor_m), 1), AT_ONCE)]
    pieces = [_piece(problem.of_epochs(rows), model, state.of_epochs(rows), model_error, robust) for rows in some]
    return _joined(problem, model, state, pieces, model_error, robust)


@dataclass(frozen=True, eq=False)
class _Piece:
    """What some of the epochs add: loss, the chi-squares, and their part of the normal equations."""

    loss: float
    squares: FloatArray
    by_beacon: FloatArray
    common: FloatArray
    gradient: FloatArray
    group: Group


def _piece(problem: Problem, model: FieldModel, state: State, model_error: float, robust: bool) -> _Piece:
    readings = problem.readings
    parts = derivatives(model, state, problem.axes, readings.field_T, state.sensor_m, state.rotation, state.matrix())
    weight = readings.weight(model_error)
    by_beacon = ((parts.residual * weight) ** 2).sum(axis=2)
    squares = by_beacon.sum(axis=1)
    loss, share = _loss(squares, readings.count, robust)
    common, gradient, walk = walk_equations(parts, weight * np.sqrt(share)[:, None, None])
    off = problem.point_weight * (problem.point_m - state.sensor_m)
    away = (problem.room_m - state.sensor_m) / problem.room_sd_m
    tie = problem.point_weight**2 + problem.room_sd_m**-2
    walk.own[:, [0, 1, 2], [0, 1, 2]] += tie
    walk.gradient[:, :3] += problem.point_weight * off + away / problem.room_sd_m
    cost = float(loss.sum() + (off * off).sum() + (away * away).sum())
    return _Piece(cost, squares, by_beacon, common, gradient, walk)


def _joined(
    problem: Problem, model: FieldModel, state: State, pieces: Sequence[_Piece], model_error: float, robust: bool
) -> Evaluation:
    """Return the whole evaluation of the pieces of the walk: with anchors, and with what was known and measured."""
    cost = sum(piece.loss for piece in pieces)
    common = np.sum([piece.common for piece in pieces], axis=0)
    gradient = np.sum([piece.gradient for piece in pieces], axis=0)
    names = ("own", "cross", "gradient")
    walk = Group(*(np.concatenate([getattr(piece.group, name) for piece in pieces]) for name in names))
    groups, anchor_squares = [walk], np.empty(0)
    if problem.anchor_rows:
        anchor_loss, each, extra, extra_gradient, group = _anchors(problem, model, state, model_error, robust)
        anchor_squares = each.sum(axis=(1, 2))
        cost += anchor_loss
        common, gradient = common + extra, gradient + extra_gradient
        groups.append(group)
    known, slopes = problem.constraints.rows(state)
    before = problem.prior.residual(state)
    cost += float(known @ known + before @ before)
    common = common + slopes.T @ slopes + np.diag(problem.prior.sd**-2)
    gradient = gradient + slopes.T @ known - before / problem.prior.sd
    equations = _only(problem.prior.free, common, gradient, groups)
    squares = np.concatenate([piece.squares for piece in pieces])
    by_beacon = np.concatenate([piece.by_beacon for piece in pieces])
    return Evaluation(cost, squares, anchor_squares, by_beacon, equations)


def _loss(squares: FloatArray, count: FloatArray, robust: bool) -> tuple[FloatArray, FloatArray]:
    """Return the loss of each epoch, and its derivative by the chi-square."""
    if not robust:
        return squares, np.ones(len(squares))
    scale = LOSS_SCALE * np.maximum(count, 1.0)
    return scale * np.log1p(squares / scale), 1.0 / (1.0 + squares / scale)


def _anchors(
    problem: Problem, model: FieldModel, state: State, model_error: float, robust: bool
) -> tuple[float, FloatArray, FloatArray, FloatArray, Group]:
    """Return what the anchors add: loss, chi-square of each component, common matrix, gradient and their group."""
    place = state.position_m[problem.anchor_rows]
    sound = replace(state, offset_T=np.zeros(3), lever_m=np.repeat(state.anchor_lever_m[:, None], 3, axis=1))
    matrix = matrix_of(state.anchor_terms)
    parts = derivatives(model, sound, np.eye(3), problem.anchors.field_T, place, state.anchor_rotation, matrix)
    weight = problem.anchors.weight(float(np.hypot(model_error, problem.anchor_error)))
    heard = weight > 0.0  # at its own centre a coil's field has no use
    parts = type(parts)(
        np.where(heard, parts.residual, 0.0),
        *(
            np.where(heard[..., None], values, 0.0)
            for values in (parts.pose, parts.beacon, parts.sensor, parts.harmonics, parts.bodies)
        ),
    )
    squares = (parts.residual * weight) ** 2
    loss, share = _loss(squares.sum(axis=(1, 2)), problem.anchors.count, robust)
    weighted = weight * np.sqrt(share)[:, None, None]
    common, gradient, group = anchor_equations(parts, weighted, problem.anchor_rows)
    found = np.hstack([state.anchor_terms, state.anchor_lever_m])
    before = (found - problem.anchor_known) / problem.anchor_sd
    group.own[:, KNOWN_PLACES, KNOWN_PLACES] += problem.anchor_sd**-2
    group.gradient[:, KNOWN_PLACES] -= before / problem.anchor_sd
    return float(loss.sum() + (before * before).sum()), squares, common, gradient, group


def anchor_error(problem: Problem, state: State, covariance: FloatArray) -> float:
    """Return the relative error of the model at the anchors with which they fit as they should.

    Their chi-square is expected to be the number of their components less what they fit themselves: three turns, six
    terms and a lever each, as far as these are not known before, and their part of the common parameters, which is the
    trace of their information times the covariance. The step is Fisher's scoring of the variance: each component counts
    for the part that the model's error has in its own, so that one step about finds it, from above or from below.

    Parameters
    ----------
    covariance : ndarray, shape (g, g)
        That of the common parameters.
    """
    model = FieldModel(beacons_of(problem.site, state))
    _, squares, common, gradient, group = _anchors(problem, model, state, 0.0, robust=False)
    every = np.ones(len(common), dtype=bool)
    information, _, _ = _only(every, common, gradient, [group]).reduced()
    known = np.linalg.inv(group.own)[:, KNOWN_PLACES, KNOWN_PLACES] * problem.anchor_sd**-2
    own = ANCHOR * len(squares) - float(known.sum())
    count = problem.anchors.count.sum()
    redundancy = max((count - own - float((information * covariance).sum())) / count, 0.05)
    # The part of each component's variance that is the model's: a component of mere noise says nothing of it.
    heard = np.isfinite(problem.anchors.sigma_T)
    noise = np.where(heard, problem.anchors.sigma_T, 0.0) * problem.anchors.weight(problem.anchor_error)
    part = np.where(heard, 1.0 - noise**2, 0.0)
    excess = float((part * (squares - redundancy)).sum()) / max(redundancy * float((part**2).sum()), 1e-300)
    factor = np.sqrt(max(1.0 + excess, 0.0))
    return float(np.clip(problem.anchor_error * factor, LEAST_ANCHOR_ERROR, 10.0 * ANCHOR_MODEL_ERROR))


def anchor_levers(problem: Problem, state: State, covariance: FloatArray) -> FloatArray:
    """Return ``anchor_sd`` with the deviation of the levers that nobody has measured, as it shows in those found.

    Their mean square is that of what was found over the part of it that the data tell (MacKay's step of empirical
    Bayes); the parameters are those of `anchor_error`.
    """
    result = problem.anchor_sd.copy()
    if problem.levers_told.all():
        return result
    model = FieldModel(beacons_of(problem.site, state))
    *_, group = _anchors(problem, model, state, 0.0, robust=False)
    own = np.linalg.inv(group.own)
    by_common = own @ group.cross
    spread = own + by_common @ covariance @ by_common.swapaxes(1, 2)
    variance = np.einsum("akk->ak", spread)[:, ANCHOR_LEVER]
    part = 1.0 - (variance / result[:, -3:] ** 2)[~problem.levers_told]
    square = float((state.anchor_lever_m[~problem.levers_told] ** 2).sum()) / max(float(part.sum()), 0.05 * part.size)
    result[~problem.levers_told, -3:] = np.clip(np.sqrt(square), LEAST_LEVER_SD_M, MOST_LEVER_SD_M)
    return result


def _only(free: NDArray[np.bool_], common: FloatArray, gradient: FloatArray, groups: Sequence[Group]) -> Equations:
    """Return the equations of the parameters that are free."""
    return Equations(
        common[np.ix_(free, free)],
        gradient[free],
        tuple(Group(group.own, group.cross[:, :, free], group.gradient) for group in groups),
    )


def adjust(
    problem: Problem,
    state: State,
    model_error: float = 0.0,
    *,
    robust: bool = False,
    progress: float = FINE_PROGRESS,
    told: Callable[[float], None] | None = None,
) -> tuple[State, Evaluation]:
    """Minimise the cost from a state near by.

    Parameters
    ----------
    problem : Problem
    state : State
    model_error : float
        Relative error of the model: the variance of a component is sigma^2 + (model_error |B|)^2.
    robust : bool
        Whether the loss of an epoch is Cauchy's.
    progress : float
        The iteration ends when a step promises less, as a part of the cost.
    told : callable, optional
        Is given the cost after each step.

    Returns
    -------
    state : State
    evaluation : Evaluation
        There.
    """
    now = evaluate(problem, state, model_error, robust=robust)
    damping = 1e-4
    for _ in range(MOST_STEPS):
        common, (poses, *others), promise = now.equations.step(damping)
        whole = np.zeros(len(problem.prior.free))
        whole[problem.prior.free] = common
        anchors = others[0] if others else np.empty((0, ANCHOR))
        trial = state.moved(whole, poses, anchors)
        then = evaluate(problem, trial, model_error, robust=robust)
        if then.cost <= now.cost:
            state, now = trial, then
            damping = max(0.1 * damping, 1e-9)
            if told is not None:
                told(now.cost)
        else:
            damping *= 8.0
        if promise < progress * max(now.cost, 1.0) or damping > 1e9:
            break
    return state, now

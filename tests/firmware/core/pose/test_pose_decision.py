"""Which beacon is left out of a wrong pose, and what it is said to be in the end.

States before and after, as in test_pose_explain.py, which has the way to here.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.firmware.core.pose.explaining import (
    HOPELESS,
    SIGMA_T,
    SUSPECT,
    Explaining,
    Place,
    off,
)
from tests.firmware.core.pose.test_pose import (
    AMBIGUOUS,
    BEACON,
    GAINS,
    INCONSISTENT,
    LEFT_OUT,
    NOBODY,
    OK,
    STRENGTH,
    UNEXPLAINED,
    UNVERIFIED,
    lattice,
)


# ---- without one beacon after another ----
def without(board, place, cost, tried=0, again=False):
    """Come back from the search without a beacon, whose best pose costs so much."""
    board.lib.pose_problem_leave_out(board.problem, place, True)
    board.explain.place, board.explain.tried, board.explain.again = place, tried, again
    board.solver.best = board.evaluated()
    board.solver.best.cost = cost
    return board.step(board.lib.POSE_EXPLAIN_WITHOUT)


@pytest.mark.parametrize(
    ("rest", "cost", "next_before", "next_after", "best"),
    [
        (HOPELESS, 30.0, 90.0, 90.0, 2),
        (50.0, 30.0, 90.0, 50.0, 2),
        (50.0, 30.0, 40.0, 40.0, 2),
        (30.0, 50.0, 90.0, 50.0, 6),
        (30.0, 50.0, 40.0, 40.0, 6),
        (30.0, 30.0, 90.0, 30.0, 6),
    ],
)
def test_the_cheapest_rest_is_kept_and_the_next_one_noted(core, place, rest, cost, next_before, next_after, best):
    board = Explaining(core, place)
    board.explain.rest.cost, board.explain.left_out, board.explain.next_cost = rest, 6, next_before
    board.explain.rest_contested, board.solver.contested = False, True
    board.explain.faults.drop = [5.0, 4.0, -1.0, 3.0, 2.0, 9.0, -1.0, 1.0, 1e6] + [1e6] * 55
    assert not without(board, 2, cost)
    explain = board.explain
    assert (explain.left_out, bool(explain.rest_contested)) == (best, best == 2)
    assert explain.rest.cost == min(rest, cost)
    assert explain.next_cost == next_after
    assert (explain.tried, explain.place, explain.stage) == (1, 5, board.lib.POSE_EXPLAIN_WITHOUT)
    assert board.order() == ([0, 1, 2, 3, 4, 7, 6], 5)
    assert not explain.refuted


@pytest.mark.parametrize(("heard", "tried", "more"), [(8, 6, True), (8, 7, False), (16, 10, True), (16, 11, False)])
@pytest.mark.parametrize("cost", [40.0, HOPELESS])
def test_all_of_few_and_twelve_of_many_are_left_out(core, place, heard, tried, more, cost):
    board = Explaining(core, place)
    for i in range(8, heard):
        board.problem.heard[i] = board.problem.heard[i - 8]
    board.problem.count = heard
    without(board, 2, cost, tried)
    ended = board.lib.POSE_EXPLAIN_RIVALS if cost < HOPELESS else board.lib.POSE_EXPLAIN_DECIDE
    assert board.explain.stage == (board.lib.POSE_EXPLAIN_WITHOUT if more else ended)
    assert board.problem.count == heard - more
    assert more or board.explain.place == 0


@pytest.mark.parametrize(("share", "refuted"), [(0.98, False), (1.02, True)])
@pytest.mark.parametrize("again", [True, False])
def test_a_suspicion_is_refuted_by_a_rest_that_is_suspect_itself(core, place, share, refuted, again):
    board = Explaining(core, place)
    board.explain.refuted = True
    assert without(board, 2, share * chi2.isf(SUSPECT, 15), 0, again) == (again and refuted)
    assert bool(board.explain.refuted) == (again and refuted)
    assert board.explain.stage == (board.lib.POSE_EXPLAIN_GAINS if again else board.lib.POSE_EXPLAIN_WITHOUT)
    if again:
        assert (board.problem.count, board.explain.left_out) == (8, 2)
        assert board.explain.round == 0
        assert board.solver.best.cost == board.explain.rest.cost


# ---- rivals ----
@pytest.mark.parametrize(("row", "decided"), [(1, False), (2, False), (7, True)])
def test_rivals_are_fitted_from_the_pose_of_the_best_rest(core, place, row, decided):
    """Its own place is passed over. The cost of another one is that of a fit of its own, from the true pose."""
    rng = np.random.default_rng(5)
    board = Explaining(core, place, place.fields + 3.0 * SIGMA_T * rng.normal(size=(8, 3)))
    board.explain.rest = board.start(board.ffi.new("pose_fit_t *"), [0.01, 0.0, -0.01])[0]
    board.explain.place, board.explain.left_out = row, 2
    assert not board.step(board.lib.POSE_EXPLAIN_RIVALS)
    assert (board.explain.stage == board.lib.POSE_EXPLAIN_DECIDE) == decided
    assert board.explain.place == row + 1
    assert board.order()[0] == list(range(8))
    if row == 2:
        assert board.explain.next_cost == pytest.approx(HOPELESS)
        assert board.pose.iterations == 0
    else:
        assert board.explain.next_cost == pytest.approx(board.fitted(row).cost, rel=1e-3)
        assert board.pose.iterations > 1


# ---- the decision ----
def decided(board, left_out, margin=99.0, whole=UNEXPLAINED, contested=False, again=False):
    """Decide on the rest without a beacon, what the next best explanation costs more being known."""
    board.explain.rest = board.fitted(left_out)
    board.explain.full = board.fitted()
    board.explain.left_out, board.explain.whole = left_out, whole
    board.explain.rest_contested, board.explain.again = contested, again
    board.explain.agreed = False
    board.explain.next_cost = board.explain.rest.cost + margin
    assert board.step(board.lib.POSE_EXPLAIN_DECIDE)
    return board.answer()


def reversed_at(place, row):
    fields = place.fields.copy()
    fields[row] *= -1.0
    return fields


def test_the_decision(core, place):
    """One beacon left out, or why not; the problem is whole again if not."""
    for margin, contested, alert_m, answer in (
        (25.1, False, 100.0, (OK, LEFT_OUT, 3)),
        (25.1, True, 100.0, (AMBIGUOUS, 8, 3)),
        (25.1, False, 0.001, (UNVERIFIED, 10, 3)),
        (24.9, False, 100.0, (INCONSISTENT, BEACON, NOBODY)),
    ):
        fields = off(place, 0.5, 15, [0, 1, 2, 4, 5, 6, 7])
        fields[3] *= -1.0
        board = Explaining(core, place, fields)
        board.problem.alert_limit_m = alert_m
        assert decided(board, 3, margin, contested=contested) == answer
        out = answer[2] == 3
        assert (bool(board.explain.agreed), board.pose.used, board.problem.count) == (out, 8 - out, 8 - out)


@pytest.mark.parametrize("whole", [STRENGTH, GAINS])
def test_what_explains_all_fields_comes_before_one_beacon(core, place, whole):
    board = Explaining(core, place, reversed_at(place, 3))
    assert decided(board, 3, 20.0, whole) == (INCONSISTENT, whole, NOBODY)


@pytest.mark.parametrize(("share", "left_out"), [(0.98, True), (1.02, False)])
def test_the_rest_must_be_likelier_than_one_in_a_hundred(core, place, share, left_out):
    rows = [0, 1, 2, 4, 5, 6, 7]
    fields = off(place, share, 15, rows)
    fields[3] *= -1.0
    answer = decided(Explaining(core, place, fields), 3)
    assert answer == ((OK, LEFT_OUT, 3) if left_out else (INCONSISTENT, UNEXPLAINED, NOBODY))


def test_the_rest_must_raise_no_alarm(core, place):
    """A gain of all fields, which costs too little to be unlikely, but more than a gain may."""
    fields = reversed_at(place, 3)
    answers = []
    for gain in (1.0, 1.0026, 1.0029):
        board = Explaining(core, place, gain * fields)
        answers.append(decided(board, 3)[1])
        assert board.explain.rest.cost < chi2.isf(SUSPECT, 15)
    assert answers == [LEFT_OUT, LEFT_OUT, UNEXPLAINED]


def test_no_rest_and_a_rest_that_tells_no_pose_are_left(core, place):
    board = Explaining(core, place, reversed_at(place, 3))
    board.explain.full = board.fitted()
    board.explain.rest.cost = HOPELESS
    board.explain.next_cost = HOPELESS
    board.explain.left_out = 2**31  # Nobody has set it.
    board.step(board.lib.POSE_EXPLAIN_DECIDE)
    assert board.answer() == (INCONSISTENT, UNEXPLAINED, NOBODY)
    assert board.problem.count == 8
    board.explain.faults.alarm = False  # A fit before has raised none.
    board.explain.rest = board.fitted(3)
    board.explain.rest.triangle.r[5][5] = 0.0
    board.explain.left_out = 3
    board.step(board.lib.POSE_EXPLAIN_DECIDE)
    assert board.answer() == (INCONSISTENT, UNEXPLAINED, NOBODY)


def test_a_rest_whose_image_fits_too_is_ambiguous(core, tmp_path):
    place = Place(lattice(tmp_path, False), [4.0, 5.0, 1.2], Rotation.from_rotvec([0.4, -0.9, 1.7]))
    assert decided(Explaining(core, place, reversed_at(place, 3)), 3)[:2] == (AMBIGUOUS, 8)


def test_again_all_beacons_are_fitted_from_the_pose_of_the_rest(core, place):
    """Nobody has done so: what full was before does not count."""
    board = Explaining(core, place, reversed_at(place, 3))
    answer = decided(board, 3, 20.0, again=True)
    assert answer == (INCONSISTENT, BEACON, NOBODY)
    board.explain.full.cost = 0.0
    board.explain.full.position_m = [float("nan")] * 3
    board.step(board.lib.POSE_EXPLAIN_DECIDE)
    assert board.answer() == answer
    assert board.explain.full.cost > 1e3

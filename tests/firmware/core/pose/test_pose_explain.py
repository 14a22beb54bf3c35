"""What a wrong pose is said to be, step by step: states before and after, with the costs that decide put in.

Fields are magpylib's, fits are the board's from the true pose. A cost that only is compared is written into its fit.
"""

import numpy as np
import pytest
from scipy.stats import chi2

from tests.firmware.core.pose.explaining import (
    HOPELESS,
    LIKELY,
    NO_POSE,
    SIGMA_T,
    SUSPECT,
    Explaining,
    off,
    same,
)
from tests.firmware.core.pose.test_pose import (
    FAILED,
    GAINS,
    INCONSISTENT,
    NEGATED,
    NOBODY,
    STRENGTH,
    UNEXPLAINED,
)


# ---- how it begins ----
def test_it_begins_with_the_negated_fields(core, place):
    board = Explaining(core, place)
    board.ffi.memmove(board.explain, b"\x55" * board.ffi.sizeof("pose_explain_t"), board.ffi.sizeof("pose_explain_t"))
    board.solver.best, whole = board.fitted(), board.fitted()
    board.lib.pose_explain_begin(board.solver, board.explain)
    explain = board.explain
    assert explain.stage == board.lib.POSE_EXPLAIN_NEGATED
    assert list(explain.full.position_m) == list(whole.position_m)
    assert same(board.fields_T(), -place.fields)
    assert board.searches(300, 80)
    assert (explain.again, explain.agreed, explain.refuted) == (False, False, False)
    assert (explain.whole, explain.tried) == (UNEXPLAINED, 0)
    assert explain.next_cost == explain.rest.cost == pytest.approx(HOPELESS)


@pytest.mark.parametrize(
    ("rows", "row", "begun"), [(range(5), 4, True), (range(5), 0, True), (range(5), 5, False), (range(4), 3, False)]
)
def test_a_suspect_is_left_out_of_five_that_are_heard(core, place, rows, row, begun):
    board = Explaining(core, place, rows=rows)
    assert bool(board.lib.pose_explain_again(board.solver, board.explain, row, False, board.pose)) == begun
    if begun:
        assert (board.explain.stage, board.explain.again) == (board.lib.POSE_EXPLAIN_WITHOUT, True)
        assert board.explain.place == row
        assert board.order() == ([0, 1, 2, 3] if row == 4 else [4, 1, 2, 3], row)
        assert board.searches(100, 40)
        assert (board.pose.tracked, board.pose.iterations) == (False, 0)
    else:
        assert board.problem.count == len(rows)


@pytest.mark.parametrize(("share", "tracked"), [(0.98, True), (1.02, False)])
def test_the_rest_is_tracked_from_the_previous_pose_while_it_is_no_suspect(core, place, share, tracked):
    rows = [0, 1, 2, 3, 4, 5, 7]
    fields = off(place, share, 15, rows)
    fields[6] *= -1.0
    board = Explaining(core, place, fields)
    board.solver.contested = True
    board.start(board.solver.best)
    assert board.lib.pose_explain_again(board.solver, board.explain, 6, True, board.pose)
    assert bool(board.pose.tracked) == tracked
    assert board.searches(100, 40) == (not tracked)
    assert not board.solver.contested
    assert 2 <= board.pose.iterations <= 10
    assert not tracked or board.solver.best.cost == pytest.approx(share * chi2.isf(SUSPECT, 15), rel=2e-3)


@pytest.mark.parametrize(("normal", "tracked"), [(1.0, True), (-1.0, False)])
def test_the_rest_is_not_tracked_beyond_the_half_space(core, place, normal, tracked):
    board = Explaining(core, place)
    board.problem.normal, board.problem.point_m = [0.0, 0.0, normal], (-np.array(list(board.problem.origin_m))).tolist()
    board.start(board.solver.best)
    assert board.lib.pose_explain_again(board.solver, board.explain, 6, True, board.pose)
    assert bool(board.pose.tracked) == tracked


def test_a_fit_of_a_pose_that_is_nearly_known_takes_ten_evaluations_at_most(core, place):
    """From half a metre off it is not done by then; each step that fits so adds to what the pose has taken."""
    rng = np.random.default_rng(4)
    fields = rng.normal(size=(8, 3)) * 1e-6
    board = Explaining(core, place, fields)
    board.pose.iterations = 5
    board.start(board.solver.best, [0.5, -0.3, 0.2])
    board.lib.pose_explain_again(board.solver, board.explain, 6, True, board.pose)
    assert board.pose.iterations == 15
    board = Explaining(core, place, fields)
    board.solver.best = board.explain.rest = board.evaluated([0.5, -0.3, 0.2])
    board.explain.round = 0
    board.step(board.lib.POSE_EXPLAIN_GAINS)
    assert board.pose.iterations == 10
    board.explain.left_out, board.explain.place = 0, 1
    board.step(board.lib.POSE_EXPLAIN_RIVALS)
    assert board.pose.iterations == 20
    board.explain.again = True
    board.explain.rest.cost = 1e6
    board.step(board.lib.POSE_EXPLAIN_DECIDE)
    assert board.pose.iterations == 30


# ---- the negated fields ----
@pytest.mark.parametrize(
    ("share", "margin", "heard", "answer"),
    [
        (0.98, 25.1, 8, (INCONSISTENT, NEGATED, NOBODY)),
        (0.98, 24.9, 8, None),
        (1.02, 99.0, 8, None),
        (1.02, 99.0, 5, None),
        (1.07, 99.0, 4, (INCONSISTENT, UNEXPLAINED, NOBODY)),
        (0.98, 25.1, 4, (INCONSISTENT, NEGATED, NOBODY)),
    ],
)
def test_negated_fields_explain_what_is_likely_and_twenty_five_better(core, place, share, margin, heard, answer):
    board = Explaining(core, place, rows=range(heard))
    board.explain.full = board.fitted()
    board.lib.pose_problem_negate(board.problem)
    board.solver.best.cost = share * chi2.isf(LIKELY, 3 * heard - 6)
    board.explain.full.cost = board.solver.best.cost + margin
    board.explain.round, board.explain.total, board.explain.faults.level_m = 7, [7.0] * 3, 1e6
    assert board.step(board.lib.POSE_EXPLAIN_NEGATED) == (answer is not None)
    assert same(board.fields_T(), place.fields[:heard])
    assert board.explain.next_cost == pytest.approx(share * chi2.isf(LIKELY, 3 * heard - 6))
    if answer is not None:
        assert board.answer() == answer
        assert np.linalg.norm(np.array(list(board.pose.position_m)) - place.position) < 1e-3
        assert 0.0 < board.pose.protection_m < 1.0  # Its own, not what stood there.
    else:
        assert board.explain.stage == board.lib.POSE_EXPLAIN_GAINS
        assert (board.explain.round, list(board.explain.total)) == (0, [1.0] * 3)
        assert board.solver.best.cost == board.explain.full.cost


def test_a_whole_that_tells_no_pose_fails(core, place):
    board = Explaining(core, place)
    board.explain.full = board.fitted()
    board.explain.full.triangle.r[5][5] = 0.0
    board.lib.pose_explain_whole(board.solver, board.explain, UNEXPLAINED, board.pose)
    assert (board.pose.status, board.pose.reason) == (FAILED, NO_POSE)


# ---- gains ----
@pytest.mark.parametrize(
    ("gains", "taken"),
    [((0.29, 0.31, 1.1), (0.3, 0.31, 1.1)), ((3.2, 3.5, 0.8), (3.2, 10.0 / 3.0, 0.8)), ((1.0, 1.0, 0.9), None)],
)
def test_a_round_takes_the_gains_but_no_factor_beyond_ten_thirds(core, place, gains, taken):
    """The fields really have those gains, at the true pose; what was multiplied before stays multiplied."""
    taken = np.array(gains if taken is None else taken)
    board = Explaining(core, place, place.fields * gains)
    board.solver.best = board.evaluated()
    board.explain.total, board.explain.round = [2.0, 0.5, 3.0], 2
    assert not board.step(board.lib.POSE_EXPLAIN_GAINS)
    assert list(board.explain.total) == pytest.approx([2.0, 0.5, 3.0] / taken, rel=3e-3)
    assert board.fields_T() == pytest.approx(place.fields * gains / taken, rel=3e-3)
    assert board.explain.round == 3
    assert board.pose.iterations > 0
    assert board.explain.stage == board.lib.POSE_EXPLAIN_GAINS


def after_gains(board, total, cost, again=True):
    """End the rounds with gains and a cost."""
    board.explain.total, board.explain.round, board.explain.again = list(total), 5, again
    board.solver.best.cost = cost
    board.explain.place = 7
    assert not board.step(board.lib.POSE_EXPLAIN_GAINS)


def test_there_are_five_rounds_of_gains(core, place):
    for done, ended in ((4, False), (5, True)):
        board = Explaining(core, place)
        board.solver.best, board.explain.again, board.explain.round = board.evaluated(), True, done
        board.step(board.lib.POSE_EXPLAIN_GAINS)
        assert (board.explain.stage == board.lib.POSE_EXPLAIN_RIVALS) == ended


def test_gains_of_a_fit_that_tells_no_pose_end_at_once(core, place):
    board = Explaining(core, place)
    board.solver.best, board.explain.again, board.explain.round = board.evaluated(), True, 0
    board.solver.best.triangle.r[5][5] = 0.0
    board.step(board.lib.POSE_EXPLAIN_GAINS)
    assert board.explain.stage == board.lib.POSE_EXPLAIN_RIVALS


@pytest.mark.parametrize(("share", "likely"), [(0.98, True), (1.02, False)])
@pytest.mark.parametrize(
    ("total", "reason"),
    [
        ((2.0, 2.0, 2.0), STRENGTH),
        ((1.0 + 2.0 * 0.0588, 1.0 - 0.0588, 1.0 - 0.0588), GAINS),
        ((1.0 + 0.0588, 1.0 - 0.0294, 1.0 - 0.0294), STRENGTH),
        ((1.0 - 0.0307, 1.0 + 0.0614, 1.0 - 0.0307), GAINS),
        ((1.0 - 0.0588, 1.0 + 0.0294, 1.0 + 0.0294), STRENGTH),
        ((1.0 + 0.0307, 1.0 + 0.0307, 1.0 - 0.0614), GAINS),
        ((1.0 + 0.0588, 1.0, 1.0 - 0.0588), STRENGTH),
    ],
)
def test_gains_within_six_per_cent_of_their_mean_are_one_strength(core, place, share, likely, total, reason):
    """The fields are as they were, then, and what explains them must be likely."""
    board = Explaining(core, place, place.fields * total)
    cost = share * chi2.isf(LIKELY, 18)
    after_gains(board, total, cost)
    assert board.explain.whole == (reason if likely else UNEXPLAINED)
    assert same(board.fields_T(), place.fields)
    assert (board.explain.stage, board.explain.place) == (board.lib.POSE_EXPLAIN_RIVALS, 0)
    assert board.explain.next_cost == pytest.approx(cost)


@pytest.mark.parametrize(("before", "after"), [(40.0, 40.0), (60.0, 50.0)])
def test_the_next_best_explanation_is_the_cheapest(core, place, before, after):
    board = Explaining(core, place)
    board.explain.next_cost = before
    after_gains(board, [1.0] * 3, 50.0)
    assert board.explain.next_cost == after


@pytest.mark.parametrize("suspect", [0, 1, 7])
def test_the_most_suspect_beacon_is_left_out_first(core, place, suspect):
    """One whose field is off by far more than noise; a fit that tells no pose suspects the first."""
    fields = place.fields.copy()
    fields[suspect] += 40.0 * SIGMA_T * np.array([1.0, -1.0, 1.0])
    for told, row in ((True, suspect), (False, 0)):
        board = Explaining(core, place, fields)
        board.explain.full = board.fitted()
        if not told:
            board.explain.full.triangle.r[5][5] = 0.0
        board.explain.faults.drop = list(range(1, 65))
        after_gains(board, [1.0] * 3, 50.0, again=False)
        assert board.explain.stage == board.lib.POSE_EXPLAIN_WITHOUT
        assert (board.explain.place, board.order()[1], board.problem.count) == (row, row, 7)
        assert board.explain.faults.drop[row] == -1.0
        assert board.searches(100, 40)

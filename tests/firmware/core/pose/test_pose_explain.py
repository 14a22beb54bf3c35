"""What a wrong pose is said to be, step by step: states before and after, with the costs that decide put in.

Fields are magpylib's, fits are the board's from the true pose. A cost that only is compared is written into its fit.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.firmware.core.pose.fault_truth import field_T
from tests.firmware.core.pose.test_pose import (
    AMBIGUOUS,
    BEACON,
    FAILED,
    GAINS,
    INCONSISTENT,
    LEFT_OUT,
    NEGATED,
    NOBODY,
    OK,
    STRENGTH,
    UNEXPLAINED,
    UNVERIFIED,
    Sensor,
    lattice,
)

SIGMA_T = 2e-8 / np.sqrt(1023)
HOPELESS = 1e30
NO_POSE = 3
SUSPECT, LIKELY = 0.01, 1e-5


class Place:
    """A pose at a site with its fields, shape (n, 3), T."""

    def __init__(self, site, position, rotation):
        self.site, self.position, self.rotation = site, np.asarray(position), rotation
        self.fields = rotation.inv().apply(np.array([field_T(b, self.position) for b in site.beacons]))


@pytest.fixture(scope="module")
def place(mixed_cube):
    return Place(mixed_cube, [0.8, 1.3, 0.7], Rotation.from_rotvec([0.4, -0.9, 1.7]))


class Explaining:
    """A board amid an explanation; the beacons of the rows are heard."""

    def __init__(self, core, place, fields=None, rows=None):
        self.ffi, self.lib = core
        self.place, self.sensor = place, Sensor(core, place.site)
        fields = place.fields if fields is None else fields
        heard = range(len(fields)) if rows is None else rows
        table = [(f.tolist(), SIGMA_T if i in heard else 0.0) for i, f in enumerate(fields)]
        self.ffi.memmove(self.sensor.work, b"\x55" * 64, 64)
        self.solver = self.ffi.addressof(self.sensor.work, "solver")
        self.explain = self.ffi.addressof(self.sensor.work, "explain")
        self.problem = self.ffi.addressof(self.solver, "problem")
        self.pose = self.ffi.new("pose_t *")
        self.pose.left_out = NOBODY
        self.lib.pose_problem(self.sensor.site, self.ffi.new("pose_field_t[]", table), self.problem)
        self.solver.stage = self.lib.POSE_SOLVE_DONE
        self.explain.next_cost = HOPELESS
        self.explain.rest.cost = HOPELESS
        self.explain.whole = UNEXPLAINED
        self.explain.total = [1.0, 1.0, 1.0]

    def start(self, fit, offset_m=(0.0, 0.0, 0.0)):
        """Put the true pose, so far off, into a fit."""
        fit.position_m = (self.place.position + offset_m - np.array(list(self.problem.origin_m))).tolist()
        fit.quaternion = self.place.rotation.as_quat().tolist()
        return fit

    def fitted(self, without=None):
        """A fit of the fields of all beacons, or of all but one."""
        fit = self.start(self.ffi.new("pose_fit_t *"))
        if without is not None:
            self.lib.pose_problem_leave_out(self.problem, without, True)
        self.lib.pose_fit(self.problem, 30, fit)
        if without is not None:
            self.lib.pose_problem_leave_out(self.problem, without, False)
        return fit[0]

    def evaluated(self, offset_m=(0.0, 0.0, 0.0)):
        """The true pose, so far off, as it is."""
        fit = self.start(self.ffi.new("pose_fit_t *"), offset_m)
        self.lib.pose_fit(self.problem, 1, fit)
        return fit[0]

    def step(self, stage):
        """Do the step of a stage; returns whether the explanation is complete."""
        self.explain.stage = stage
        return bool(self.lib.pose_explain_step(self.solver, self.explain, self.pose))

    def fields_T(self):
        """The fields that the problem has now, by the rows of the site."""
        rows = sorted((h.row, list(h.field_uT)) for h in list(self.problem.heard)[: self.problem.count])
        return 1e-6 * np.array([field for _, field in rows])

    def order(self):
        """The rows of the beacons that are heard, and that of the one behind them."""
        rows = [self.problem.heard[i].row for i in range(self.problem.count + 1)]
        return rows[:-1], rows[-1]

    def searches(self, directions, evaluations):
        """Whether such a search has been begun."""
        asked = (self.solver.candidates.directions, self.solver.left, self.solver.candidates.next)
        return self.solver.stage == self.lib.POSE_SOLVE_SEARCH and asked == (directions, evaluations, 0)

    def answer(self):
        return self.pose.status, self.pose.reason, self.pose.left_out


def same(fields, expected):
    return np.allclose(fields, expected, rtol=1e-6, atol=0.0)


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


def off(place, share, freedom, rows, seed=3):
    """The fields with a residual that no pose takes away of those rows, so far from the chi-square of one in 100."""
    rng, eps = np.random.default_rng(seed), 1e-5
    columns = []
    for way in eps * np.eye(6):
        turn = Rotation.from_rotvec(way[3:]) * place.rotation
        moved = Place(place.site, place.position + way[:3], turn).fields
        columns.append((moved - place.fields)[rows].ravel() / eps)
    known = np.linalg.qr(np.array(columns).T)[0]
    left = rng.normal(size=3 * len(rows))
    for _ in range(2):
        left -= known @ (known.T @ left)
    left *= np.sqrt(share * chi2.isf(SUSPECT, freedom)) / np.linalg.norm(left)
    fields = place.fields.copy()
    fields[rows] += SIGMA_T * left.reshape(-1, 3)
    return fields


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

"""The steps of a pose: which comes next, from states that are put in between, and what the answer is."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from goldfield.site.model import HalfSpace
from tests.firmware.core.pose.explaining import HOPELESS, NO_POSE, SIGMA_T, SUSPECT, Place
from tests.firmware.core.pose.test_pose import (
    AMBIGUOUS,
    FAILED,
    INCONSISTENT,
    LEFT_OUT,
    NEGATED,
    NOBODY,
    OK,
    Sensor,
    lattice,
)

FEW, NOISE, RIVAL, PENDING = 1, 2, 8, 14


class Board:
    """A board that does the steps of a pose one by one; the beacons of the rows are heard."""

    def __init__(self, core, place, fields=None, rows=None, previous=None, verdict=None, offset_m=(0.0, 0.0, 0.0)):
        self.ffi, self.lib = core
        self.place, self.sensor = place, Sensor(core, place.site)
        fields = place.fields if fields is None else fields
        heard = range(len(fields)) if rows is None else rows
        table = [(f.tolist(), SIGMA_T if i in heard else 0.0) for i, f in enumerate(fields)]
        self.work, self.pose = self.sensor.work, self.ffi.new("pose_t *")
        self.work.alarmed, self.work.stage = True, self.lib.POSE_STEP_EXPLAIN
        self.solver = self.ffi.addressof(self.work, "solver")
        self.explain = self.ffi.addressof(self.work, "explain")
        self.problem = self.ffi.addressof(self.solver, "problem")
        self.solver.stage = self.lib.POSE_SOLVE_SEARCH
        self.pose.status = OK if previous is None else previous
        self.pose.position_m = (place.position + np.asarray(offset_m)).tolist()
        self.pose.quaternion = place.rotation.as_quat().tolist()
        self.pose.iterations, self.pose.left_out, self.pose.tracked = 99, 3, True
        told = self.ffi.NULL if verdict is None else self.ffi.new("pose_verdict_t *", verdict)
        table = self.ffi.new("pose_field_t[]", table)
        self.lib.pose_begin(self.sensor.site, table, previous is not None, told, self.work, self.pose)

    def step(self, stage=None):
        """Do the next step, or that of a stage with no search under way; returns whether the pose is complete."""
        if stage is not None:
            self.work.stage, self.solver.stage = stage, self.lib.POSE_SOLVE_DONE
        return bool(self.lib.pose_step(self.work, self.pose))

    def fitted(self, fit, limit=30):
        """Put the true pose, fitted, into a fit."""
        fit.position_m = (self.place.position - np.array(list(self.problem.origin_m))).tolist()
        fit.quaternion = self.place.rotation.as_quat().tolist()
        self.lib.pose_fit(self.problem, limit, self.ffi.addressof(fit))
        return fit

    def near(self, fit):
        """Whether a fit is at the true place."""
        place = np.array(list(fit.position_m)) + np.array(list(self.problem.origin_m))
        return bool(np.linalg.norm(place - self.place.position) < 1e-3)

    def answer(self):
        return self.pose.status, self.pose.reason

    def searches_all(self):
        solver, lib = self.solver, self.lib
        asked = (solver.candidates.directions, solver.left, solver.stage, self.work.stage)
        return asked == (300, 80, lib.POSE_SOLVE_SEARCH, lib.POSE_STEP_ALL)


def with_plane(place, side):
    """The same place with a half-space that holds it, 0.1 m from its plane, or does not."""
    half = HalfSpace(place.position - 0.1 * side * np.array([0.0, 0.6, 0.8]), np.array([0.0, 0.6, 0.8]))
    return Place(dataclasses.replace(place.site, half_space=half), place.position, place.rotation)


def reversed_at(place, row):
    fields = place.fields.copy()
    fields[row] *= -1.0
    return fields


# ---- the beginning ----
@pytest.mark.parametrize(("previous", "known"), [(None, False), (OK, True), (INCONSISTENT, True), (FAILED, False)])
@pytest.mark.parametrize("verdict", [None, (5, NEGATED)])
def test_a_pose_begins_with_nothing_of_the_one_before(core, place, previous, known, verdict):
    board = Board(core, place, rows=range(6), previous=previous, verdict=verdict)
    work, pose = board.work, board.pose
    assert (pose.used, pose.left_out, pose.iterations, pose.tracked) == (6, NOBODY, 0, False)
    assert (work.known, work.later, work.alarmed) == (known, verdict is not None, False)
    assert (work.stage, board.solver.stage) == (board.lib.POSE_STEP_BEGIN, board.lib.POSE_SOLVE_DONE)
    assert verdict is None or (work.verdict.row, work.verdict.reason) == verdict
    assert board.near(board.solver.best) == known
    if known:
        assert list(board.solver.best.quaternion) == pytest.approx(place.rotation.as_quat())


@pytest.mark.parametrize(
    ("heard", "previous", "stage", "answer"),
    [
        (2, OK, None, (FAILED, FEW)),
        (3, None, "ALL", None),
        (3, OK, "ALL", None),
        (4, OK, "TRACK", None),
        (4, None, "ALL", None),
    ],
)
def test_what_comes_first_is_told_by_how_many_are_heard(core, place, heard, previous, stage, answer):
    board = Board(core, place, rows=range(heard), previous=previous)
    assert board.step() == (answer is not None)
    if answer is not None:
        assert board.answer() == answer
    else:
        assert board.work.stage == getattr(board.lib, f"POSE_STEP_{stage}")
        assert (board.pose.iterations > 0) == (stage == "TRACK")
        assert board.searches_all() == (stage == "ALL")


@pytest.mark.parametrize(("share", "noise"), [(0.98, True), (1.02, False)])
def test_noise_is_no_pose(core, place, share, noise):
    """The limit by Wilson and Hilferty is too great by at most 1.3 %."""
    shape = place.fields / np.linalg.norm(place.fields)
    board = Board(core, place, shape * SIGMA_T * np.sqrt(share * 1.005 * chi2.isf(1e-6, 24)))
    assert board.step() == noise
    assert not noise or board.answer() == (FAILED, NOISE)


def test_a_fit_from_the_previous_pose_takes_fourteen_evaluations_at_most(core, place):
    fields = np.random.default_rng(4).normal(size=(8, 3)) * 1e-6
    board = Board(core, place, fields, previous=OK, offset_m=[0.5, -0.3, 0.2])
    board.step()
    assert board.pose.iterations == 14


# ---- from the previous pose ----
def test_a_pose_that_explains_the_fields_is_tracked(core, place):
    for side in (1.0, -1.0):
        board = Board(core, with_plane(place, side), previous=OK)
        assert not board.step()
        assert board.step() == (side > 0.0)
        assert bool(board.pose.tracked) == (side > 0.0)
        assert board.searches_all() == (side < 0.0)
        assert side < 0.0 or board.answer() == (OK, 0)


def test_a_pose_that_does_not_is_searched(core, place):
    """Fields that do not agree, or a fit that tells no pose; the previous pose stands in the fit again."""
    for alarm in (True, False):
        board = Board(core, place, reversed_at(place, 2) if alarm else None, previous=OK)
        board.step()
        if not alarm:
            board.solver.best.triangle.r[5][5] = 0.0
        board.solver.best.quaternion = [1.0, 0.0, 0.0, 0.0]
        assert not board.step()
        assert board.searches_all()
        assert not board.pose.tracked
        assert board.near(board.solver.best) or board.solver.best.cost >= HOPELESS


def test_the_image_of_a_tracked_pose_contests_it(core, tmp_path):
    place = Place(lattice(tmp_path, False), [4.0, 5.0, 1.2], Rotation.from_rotvec([0.4, -0.9, 1.7]))
    board = Board(core, place, previous=OK)
    while not board.step():
        assert board.work.stage == board.lib.POSE_STEP_TRACK
    assert board.answer() == (AMBIGUOUS, RIVAL)
    assert board.pose.tracked


# ---- with a verdict of a cycle before ----
@pytest.mark.parametrize(
    ("row", "previous", "again"), [(2, OK, True), (2, FAILED, True), (NOBODY, OK, False), (7, OK, False)]
)
def test_fields_that_do_not_agree_are_searched_without_the_beacon_of_the_verdict(core, place, row, previous, again):
    """If it is heard. From the previous pose, if there is one, whatever the fit with all beacons has come to."""
    board = Board(core, place, reversed_at(place, 2), range(7), previous, (row, PENDING))
    while board.work.stage in (board.lib.POSE_STEP_BEGIN, board.lib.POSE_STEP_TRACK):
        assert not board.step()
        if previous == OK:
            board.solver.best.position_m[0] += 50.0
    assert board.work.stage == (board.lib.POSE_STEP_AGAIN if again else board.lib.POSE_STEP_ALL)
    assert board.problem.count == 7 - again
    assert bool(board.pose.tracked) == (again and previous == OK)
    assert board.searches_all() == (not again)


def test_without_a_verdict_a_verdict_that_lies_there_does_not_count(core, place):
    board = Board(core, place, reversed_at(place, 2))
    board.work.verdict.row = 2
    assert not board.step()
    assert board.searches_all()


@pytest.mark.parametrize("margin", [30.0, 20.0])
def test_the_pose_without_the_beacon_of_the_verdict_was_alarmed(core, place, margin):
    """Whether it is taken or not: the fields of all beacons do not agree."""
    board = Board(core, place, reversed_at(place, 2), previous=OK, verdict=(2, LEFT_OUT))
    while board.work.stage != board.lib.POSE_STEP_AGAIN:
        board.step()
    while board.explain.stage != board.lib.POSE_EXPLAIN_DECIDE:
        assert not board.step()
        assert not board.work.alarmed
    board.explain.next_cost = board.explain.rest.cost + margin
    board.explain.whole = 6
    assert board.step()
    assert board.work.alarmed
    assert (board.answer(), board.pose.left_out) == (
        ((OK, LEFT_OUT), 2) if margin > 25.0 else ((INCONSISTENT, 5), NOBODY)
    )


def test_a_suspicion_that_is_refuted_ends_in_a_search_with_all(core, place):
    board = Board(core, place, reversed_at(place, 2), previous=OK, verdict=(3, LEFT_OUT))
    while board.work.stage != board.lib.POSE_STEP_AGAIN:
        board.step()
    board.pose.tracked, board.solver.stage = True, board.lib.POSE_SOLVE_DONE
    board.solver.best.cost = 1e4
    assert not board.step()
    assert board.searches_all()
    assert not board.pose.tracked
    assert board.problem.count == 8
    assert not board.work.alarmed


# ---- after the search with all beacons ----
def test_no_pose_at_all_fails(core, place):
    board = Board(core, place)
    board.solver.best.cost = HOPELESS
    assert board.step(board.lib.POSE_STEP_ALL)
    assert board.answer() == (FAILED, NO_POSE)


@pytest.mark.parametrize("contested", [False, True])
def test_a_pose_of_the_search_that_explains_the_fields(core, place, contested):
    board = Board(core, place)
    board.fitted(board.solver.best)
    board.solver.contested = contested
    assert board.step(board.lib.POSE_STEP_ALL)
    assert board.answer() == ((AMBIGUOUS, RIVAL) if contested else (OK, 0))
    assert not board.pose.tracked


def test_the_image_of_a_searched_pose_contests_it(core, tmp_path):
    place = Place(lattice(tmp_path, False), [4.0, 5.0, 1.2], Rotation.from_rotvec([0.4, -0.9, 1.7]))
    board = Board(core, place)
    board.fitted(board.solver.best)
    board.solver.contested = False
    assert board.step(board.lib.POSE_STEP_ALL)
    assert board.answer() == (AMBIGUOUS, RIVAL)
    assert board.pose.iterations > 0


@pytest.mark.parametrize(("share", "failed"), [(0.98, True), (1.02, False)])
def test_a_pose_that_is_not_told_fails_if_its_fields_agree(core, place, share, failed):
    """Else they are explained."""
    board = Board(core, place)
    board.fitted(board.solver.best)
    board.solver.best.triangle.r[5][5] = 0.0
    board.solver.best.cost = share * chi2.isf(SUSPECT, 18)
    assert board.step(board.lib.POSE_STEP_ALL) == failed
    if failed:
        assert board.answer() == (FAILED, NO_POSE)
    else:
        assert board.work.stage == board.lib.POSE_STEP_EXPLAIN
        assert board.explain.stage == board.lib.POSE_EXPLAIN_NEGATED


@pytest.mark.parametrize(
    ("verdict", "reason"),
    [(None, None), ((NOBODY, NEGATED), NEGATED), ((NOBODY, PENDING), PENDING), ((3, 11), PENDING)],
)
def test_fields_that_no_pose_explains_are_explained_now_or_later(core, place, verdict, reason):
    board = Board(core, place, reversed_at(place, 2), verdict=verdict)
    board.fitted(board.solver.best)
    board.explain.again = True
    assert board.step(board.lib.POSE_STEP_ALL) == (verdict is not None)
    assert bool(board.work.alarmed) == (verdict is not None)
    assert not board.explain.again
    assert list(board.explain.full.position_m) == list(board.solver.best.position_m)
    if verdict is None:
        assert board.work.stage == board.lib.POSE_STEP_EXPLAIN
    else:
        assert board.answer() == (INCONSISTENT, reason)


def test_the_steps_of_an_explanation_are_done_until_it_is_complete(core, place):
    board = Board(core, place, -place.fields)
    board.lib.pose_problem_negate(board.problem)
    board.fitted(board.explain.full)
    board.fitted(board.solver.best)
    board.lib.pose_problem_negate(board.problem)
    board.fitted(board.explain.full)
    board.lib.pose_problem_negate(board.problem)
    board.explain.stage = board.lib.POSE_EXPLAIN_NEGATED
    assert board.step(board.lib.POSE_STEP_EXPLAIN)
    assert board.answer() == (INCONSISTENT, NEGATED)


# ---- the review ----
@pytest.mark.parametrize(("again", "agreed"), [(False, False), (True, False), (True, True)])
def test_a_review_explains_the_fields_of_all_beacons(core, place, again, agreed):
    """From a fit of all of them, which a pose without one of them has not made; the pose itself stays as it is."""
    board = Board(core, place, reversed_at(place, 2), verdict=(2, LEFT_OUT))
    board.fitted(board.solver.best)
    cost = board.solver.best.cost
    if agreed:
        board.lib.pose_problem_leave_out(board.problem, 2, True)
        board.fitted(board.solver.best)
    board.explain.again, board.explain.agreed, board.explain.left_out = again, agreed, 2
    board.work.alarmed = True
    review, pose = board.ffi.new("pose_work_t *"), board.ffi.new("pose_t *")
    board.ffi.memmove(pose, b"\x55" * board.ffi.sizeof("pose_t"), board.ffi.sizeof("pose_t"))
    board.lib.pose_review(board.work, review, pose)
    assert (pose.used, pose.left_out, pose.tracked) == (8, NOBODY, False)
    assert (pose.iterations > 0) == again
    assert pose.iterations <= 10
    assert [review.solver.problem.heard[i].row for i in range(8)] == list(range(8))
    assert review.explain.full.cost == pytest.approx(cost, rel=0.01)
    assert review.stage == board.lib.POSE_STEP_EXPLAIN
    assert (review.explain.stage, review.explain.again) == (board.lib.POSE_EXPLAIN_NEGATED, False)
    assert (board.problem.count, board.explain.again) == (8 - agreed, again)
    assert board.solver.best.cost == pytest.approx(0.0 if agreed else cost, abs=1.0)


def test_a_review_takes_ten_evaluations_at_most(core, place):
    fields = np.random.default_rng(4).normal(size=(8, 3)) * 1e-6
    board = Board(core, place, fields, previous=OK, offset_m=[0.5, -0.3, 0.2])
    board.explain.again, board.explain.agreed = True, False
    review, pose = board.ffi.new("pose_work_t *"), board.ffi.new("pose_t *")
    board.lib.pose_review(board.work, review, pose)
    assert pose.iterations == 10


# ---- at once ----
def test_find_and_track_do_all_steps(core, place):
    sensor = Sensor(core, place.site)
    found = sensor.locate(place.fields, SIGMA_T)
    assert (found.status, found.tracked) == (OK, False)
    table = sensor.ffi.new("pose_field_t[]", [(f.tolist(), SIGMA_T) for f in place.fields])
    sensor.lib.pose_find(sensor.site, table, sensor.work, found)  # No pose of before counts.
    assert (found.status, found.tracked) == (OK, False)
    tracked = Sensor(core, place.site).locate(place.fields, SIGMA_T, found)
    assert (tracked.status, tracked.tracked) == (OK, True)
    for pose in (found, tracked):
        assert np.linalg.norm(np.array(list(pose.position_m)) - place.position) < 1e-4

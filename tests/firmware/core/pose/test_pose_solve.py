"""The search for the pose step by step: what is fitted, which fit is the best one, and what contests it."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.firmware.core.pose.explaining import HOPELESS, SUSPECT, Explaining, Place, off
from tests.firmware.core.pose.test_pose import lattice

FAR = np.array([0.5, 0.3, -0.4])


class Solving(Explaining):
    """A board amid a search, with candidates that are put in."""

    def __init__(self, core, place, candidates=(), fields=None, rows=None, left=80):
        super().__init__(core, place, fields, rows)
        self.lib.pose_solve_begin(self.solver, 120, left)
        self.solver.stage = self.lib.POSE_SOLVE_CANDIDATE
        self.solver.candidates.count = len(candidates)
        for row, offset in zip(self.solver.candidates.candidates, candidates, strict=False):
            row.position_m = self.relative(place.position + np.asarray(offset))
        self.evaluations = self.ffi.new("uint32_t *", 100)

    def relative(self, position):
        return (np.asarray(position) - np.array(list(self.problem.origin_m))).tolist()

    def next(self):
        """Do the next step; returns whether none was left, and how many evaluations it took."""
        before, left = self.evaluations[0], self.solver.left
        none = self.lib.pose_solve_step(self.solver, self.evaluations)
        taken = self.evaluations[0] - before
        assert taken == left - self.solver.left
        return bool(none), taken

    def plane(self, inside):
        """A half-space that the true place is in, or is not, 0.1 m from its edge."""
        normal = np.array([0.0, 0.6, 0.8])
        self.problem.normal = normal.tolist()
        self.problem.point_m = self.relative(self.place.position - (0.1 if inside else -0.1) * normal)

    def found(self, fit, position=None):
        """Whether a fit is at a place, which is the true one unless told."""
        wanted = self.place.position if position is None else position
        return bool(np.linalg.norm(np.array(list(fit.position_m)) - self.relative(wanted)) < 2e-3)

    def put(self, fit, cost, offset_m=(0.0, 0.0, 0.0), turn_rad=0.0):
        """Put a pose with a cost into a fit: the true one, so far off, turned around an axis of its own."""
        self.start(fit, offset_m)
        turn = Rotation.from_rotvec(turn_rad * np.array([0.6, 0.0, 0.8]))
        fit.quaternion = (turn * self.place.rotation).as_quat().tolist()
        fit.cost = cost


@pytest.mark.parametrize("count", [4, 8])
def test_a_cost_within_chance_explains_the_fields(core, place, count):
    board = Solving(core, place, rows=range(count))
    for share in (0.985, 1.015):
        board.solver.best.cost = share * 1.002 * chi2.isf(SUSPECT, 3 * count - 6)
        explained = board.lib.pose_solve_explains(board.problem, board.ffi.addressof(board.solver.best), 2.326)
        assert explained == (share < 1.0)


def test_the_search_comes_first_in_slices(core, place):
    board = Solving(core, place)
    board.solver.next, board.solver.rival = 3, 1.0
    board.solver.best.cost = board.solver.image.cost = 1.0
    board.lib.pose_solve_begin(board.solver, 120, 80)
    solver = board.solver
    assert (solver.next, solver.left, solver.candidates.directions, solver.candidates.next) == (0, 80, 120, 0)
    assert min(solver.rival, solver.best.cost, solver.image.cost) >= HOPELESS * (1.0 - 1e-6)
    for done in (50, 100, 120):
        assert solver.stage == board.lib.POSE_SOLVE_SEARCH
        assert board.next() == (False, 0)
        assert solver.candidates.next == done
    assert solver.stage == board.lib.POSE_SOLVE_CANDIDATE
    assert solver.candidates.count > 0


def test_after_the_last_step_none_is_left(core, place):
    board = Solving(core, place, [[0.0, 0.0, 0.0]])
    board.solver.stage = board.lib.POSE_SOLVE_DONE
    assert board.next() == (True, 0)
    assert board.solver.next == 0


@pytest.mark.parametrize("left", [36, 37])
def test_a_candidate_is_fitted_while_evaluations_are_left(core, place, left):
    board = Solving(core, place, [[0.05, -0.02, 0.03]], left=left)
    none, taken = board.next()
    assert not none
    assert (taken > 0) == (left == 37)
    assert board.solver.next == (left == 37)
    assert board.found(board.solver.best) == (left == 37)
    if left == 37:
        assert board.solver.best.cost < 1.0
        assert board.solver.stage == board.lib.POSE_SOLVE_CANDIDATE
        assert board.next() == (False, 0)
        assert not board.solver.contested
    assert board.solver.stage == board.lib.POSE_SOLVE_DONE


@pytest.mark.parametrize(
    ("count", "inside", "cost", "more"),
    [
        (4, True, 16.4, False),
        (4, True, 17.5, True),
        (4, True, 1.0, False),
        (3, True, 1.0, True),
        (4, False, 1.0, True),
        (4, True, 99.0, True),
        (8, True, 1.0, False),
    ],
)
def test_another_candidate_is_fitted_unless_one_was_found(core, place, count, inside, cost, more):
    """From four beacons on, if it explains the fields (the limit is 16.8) and is in the half-space."""
    board = Solving(core, place, [[0.05, -0.02, 0.03]], rows=range(count))
    board.plane(inside)
    board.put(board.solver.best, cost)
    board.next()
    assert board.solver.next == more
    board.next()
    assert board.solver.stage == board.lib.POSE_SOLVE_DONE


def wild(place):
    return place.fields[[3, 0, 4, 1, 7, 2, 6, 5]] * np.array([1.0, -1.0, 0.5])


@pytest.mark.parametrize(("left", "last"), [(37, 12), (44, 19), (45, 20), (200, 20)])
def test_the_last_resort_has_twenty_evaluations_or_what_is_left(core, place, left, last):
    """A candidate that does not come to an end has twenty-five."""
    board = Solving(core, place, [FAR], wild(place), left=left)
    assert board.next() == (False, 25)
    assert board.next() == (False, last)
    assert board.solver.stage == board.lib.POSE_SOLVE_DONE


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_what_robust_weights_do_not_explain_is_no_candidate(core, place, share):
    """The residual that no pose takes away is made such that its cost with the robust weights is at the limit."""
    limit, scale = chi2.isf(SUSPECT, 18), 1e4
    for _ in range(6):
        board = Solving(core, place, [[0.02, -0.02, 0.03]], off(place, scale, 18, range(8)))
        fit = board.start(board.ffi.new("pose_fit_t *"))
        board.lib.pose_fit_robust(board.problem, 25, fit)
        scale *= share * limit / fit.cost
    assert fit.cost == pytest.approx(share * limit, rel=0.02)
    board.next()
    assert (board.solver.image.cost < HOPELESS) == (share > 1.0)
    assert (board.solver.best.cost < HOPELESS) == (share < 1.0)


def test_all_evaluations_of_a_candidate_are_counted(core, place):
    board = Solving(core, place, [[0.05, -0.02, 0.03]])
    fit = board.start(board.ffi.new("pose_fit_t *"), [0.05, -0.02, 0.03])
    board.lib.pose_search_attitude(board.problem, fit.position_m, fit.quaternion)
    robust = board.lib.pose_fit_robust(board.problem, 25, fit)
    exact = board.lib.pose_fit(board.problem, 80 - robust, fit)
    assert exact > 1
    assert board.next() == (False, robust + exact)
    assert list(board.solver.best.position_m) == list(fit.position_m)


def test_the_least_implausible_is_the_last_resort(core, place):
    """It is fitted with the declared errors at last, with at most 20 evaluations."""
    board = Solving(core, place, [FAR, 0.5 * FAR, 2.0 * FAR], wild(place), left=200)
    costs, images = [], []
    for _ in range(3):
        assert board.next()[0] is False
        costs.append(board.solver.other.cost)
        images.append(board.solver.image.cost)
        assert board.solver.best.cost >= HOPELESS * (1.0 - 1e-6)
    assert images == list(np.minimum.accumulate(costs))
    assert len(set(images)) > 1
    position = list(board.solver.image.position_m)
    none, taken = board.next()
    assert not none
    assert 0 < taken <= 20
    assert board.solver.best.cost < HOPELESS
    assert np.linalg.norm(np.array(list(board.solver.best.position_m)) - position) < 3.0
    assert board.solver.stage == board.lib.POSE_SOLVE_DONE


def test_a_pose_that_was_found_needs_no_last_resort(core, place):
    board = Solving(core, place)
    board.put(board.solver.best, 5.0)
    board.put(board.solver.image, 1.0, FAR)
    assert board.next() == (False, 0)
    assert board.solver.best.cost == 5.0


def test_without_any_candidate_there_is_no_pose(core, place):
    board = Solving(core, place)
    assert board.next() == (False, 0)
    assert board.solver.best.cost >= HOPELESS * (1.0 - 1e-6)


def near_m(board, offset):
    """The distance to the nearest beacon from a place so far from the true one."""
    centres = np.array([b.position_m for b in board.place.site.beacons])
    return np.linalg.norm(centres - board.place.position - offset, axis=1).min()


@pytest.mark.parametrize(
    ("share", "turn_rad", "other"),
    [
        (0.0, 0.0, False),
        (0.97, 0.0, False),
        (1.03, 0.0, True),
        (0.0, 0.195, False),
        (0.0, 0.206, True),
        (0.0, 6.0, True),
    ],
)
@pytest.mark.parametrize("cost", [9.0, 60.0])
def test_a_rival_is_another_pose(core, place, share, turn_rad, other, cost):
    """A twentieth of the distance to the nearest beacon away, or turned by 0.2 rad; the greater cost is the rival's."""
    board = Solving(core, place, [[0.05, -0.02, 0.03]], off(place, 0.5, 3, [0, 1, 2]), rows=[0, 1, 2])
    way = np.array([0.48, -0.6, 0.64])
    distance = 0.05 * share
    for _ in range(20):
        centres = np.array([b.position_m for b in place.site.beacons[:3]])
        distance = 0.05 * share * np.linalg.norm(centres - place.position - distance * way, axis=1).min()
    board.put(board.solver.best, cost, distance * way, turn_rad)
    board.next()
    assert board.found(board.solver.best)
    assert board.solver.best.cost == pytest.approx(0.5 * chi2.isf(SUSPECT, 3), rel=0.01)
    assert board.solver.rival == (pytest.approx(cost) if other else pytest.approx(HOPELESS))


def test_the_least_rival_counts_and_a_worse_fit_is_not_the_best(core, place):
    board = Solving(core, place, [[0.05, -0.02, 0.03]] * 3, rows=[0, 1, 2])
    for rival, cost, told in ((7.0, 9.0, 7.0), (9.0, 7.0, 7.0), (HOPELESS, -5.0, 0.0)):
        board.solver.rival = rival
        board.put(board.solver.best, cost, FAR)
        board.next()
        assert board.found(board.solver.best, place.position + (FAR if cost < 0.0 else 0.0))
        assert board.solver.rival == pytest.approx(told, abs=0.5)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_pose_beyond_the_half_space_is_no_rival(core, place, side):
    board = Solving(core, place, [[0.05, -0.02, 0.03]], rows=[0, 1, 2])
    normal = side * FAR / np.linalg.norm(FAR)
    board.problem.normal, board.problem.point_m = normal.tolist(), board.relative(place.position + 0.5 * FAR)
    board.put(board.solver.best, 5.0, FAR)
    board.next()
    assert board.found(board.solver.best)
    assert board.solver.rival == pytest.approx(HOPELESS)


@pytest.mark.parametrize(("margin", "contested"), [(14.9, True), (15.1, False)])
def test_a_rival_that_fits_nearly_as_well_contests(core, place, margin, contested):
    board = Solving(core, place)
    board.put(board.solver.best, 20.0)
    board.solver.rival, board.solver.contested = 20.0 + margin, not contested
    board.next()
    assert board.solver.contested == contested


# ---- images ----
def at_a_point(site, same_axis):
    """Coils around one place or, with one axis, within 0.5 m of its plane."""
    rows = []
    for i, b in enumerate(site.beacons):
        offset = 0.25 * np.array([np.cos(i), np.sin(2.0 * i), 0.0]) * same_axis
        axis = np.array([0.0, 0.0, 1.0]) if same_axis else b.axis
        rows.append(dataclasses.replace(b, position_m=np.array([1.0, 2.0, 1.5]) + offset, axis=axis))
    return dataclasses.replace(site, beacons=tuple(rows))


ROTATION = Rotation.from_rotvec([0.4, -0.9, 1.7])


class Images(Solving):
    """A board with the true pose fitted; ``kind`` says which images there are."""

    def __init__(self, core, kind, tmp_path, site, sigma=1.0):
        if kind == "plane":
            place = Place(lattice(tmp_path, False), [4.0, 5.0, 1.2], ROTATION)
            self.normal, self.middle = np.array([0.0, 0.0, 1.0]), np.array([4.5, 4.5, 2.7])
        else:
            place = Place(at_a_point(site, kind == "both"), [2.8, 1.1, 3.2], ROTATION)
            self.normal = np.array([0.0, 0.0, 1.0])
            self.middle = np.mean([b.position_m for b in place.site.beacons], axis=0)
        super().__init__(core, place)
        for heard in list(self.problem.heard)[: self.problem.count]:
            heard.sigma_uT *= sigma
        self.start(self.solver.best)
        self.lib.pose_fit(self.problem, 30, self.ffi.addressof(self.solver.best))
        self.image = {
            "plane": place.position - 2.0 * ((place.position - self.middle) @ self.normal) * self.normal,
            "across": 2.0 * self.middle - place.position,
            "here": place.position,
        }

    def side(self, *inside):
        """A half-space through the middle whose edge parts the true place and an image."""
        here, there = self.place.position, self.image["plane" if "plane" in inside else "across"]
        way = (here - there) / np.linalg.norm(here - there) * (1.0 if "here" in inside else -1.0)
        self.problem.normal, self.problem.point_m = way.tolist(), self.relative(0.5 * (here + there))

    def mirror(self):
        """Whether it is contested, and how many evaluations it took."""
        before = self.evaluations[0]
        contested = self.lib.pose_solve_mirror(self.solver, self.evaluations)
        return bool(contested), self.evaluations[0] - before


@pytest.mark.parametrize("kind", ["plane", "across"])
def test_an_exact_image_contests(core, tmp_path, mixed_cube, kind):
    board = Images(core, kind, tmp_path, mixed_cube)
    contested, taken = board.mirror()
    assert contested
    assert 0 < taken <= 10
    assert board.found(board.solver.best)
    assert board.found(board.solver.image, board.image[kind])


@pytest.mark.parametrize("kind", ["plane", "across"])
@pytest.mark.parametrize("side", ["here", "there"])
def test_the_half_space_decides_between_images(core, tmp_path, mixed_cube, kind, side):
    board = Images(core, kind, tmp_path, mixed_cube)
    board.side(kind, side)
    assert not board.mirror()[0]
    assert board.found(board.solver.best, None if side == "here" else board.image[kind])


@pytest.mark.parametrize(
    ("cost", "taken", "contested"),
    [(-15.2, False, False), (-14.8, False, True), (0.8, False, True), (1.2, True, True), (50.0, True, True)],
)
@pytest.mark.parametrize("kind", ["plane", "across"])
def test_an_image_that_fits_better_is_taken(core, tmp_path, mixed_cube, kind, cost, taken, contested):
    """By one in cost. One that fits worse by 15 is no rival."""
    board = Images(core, kind, tmp_path, mixed_cube)
    board.solver.best.cost = cost
    assert board.mirror()[0] == contested
    assert board.found(board.solver.best, board.image[kind] if taken else None)


def test_an_image_that_fits_worse_is_not_taken_though_it_is_on_the_right_side(core, tmp_path, mixed_cube):
    board = Images(core, "plane", tmp_path, mixed_cube)
    board.side("plane", "there")
    board.solver.best.cost = -15.2
    assert not board.mirror()[0]
    assert board.found(board.solver.best)


def test_coils_that_have_no_image_need_no_evaluation(core, place):
    board = Solving(core, place)
    board.start(board.solver.best)
    board.lib.pose_fit(board.problem, 30, board.ffi.addressof(board.solver.best))
    assert not board.lib.pose_solve_mirror(board.solver, board.evaluations)
    assert board.evaluations[0] == 100


@pytest.mark.parametrize("side", [None, "here", "there"])
@pytest.mark.parametrize("sigma", [1.0, 1e4])
def test_of_coils_in_a_plane_seen_from_far_all_three_images_are_fitted(core, tmp_path, mixed_cube, sigma, side):
    """The plane's fits as well, unless the half-space parts them; noise hides that the coils are not at one point."""
    board = Images(core, "both", tmp_path, mixed_cube, sigma)
    if side is not None:
        board.side("plane", side)
    contested, taken = board.mirror()
    assert contested == (side is None or sigma > 1.0)
    assert sigma > 1.0 or taken == 2 + 2 * 10  # The plane's is exact; the others would take more than they may.
    assert board.found(board.solver.best, board.image["plane"] if side == "there" else None)
    if sigma > 1.0:
        last = board.image["across"] * [1.0, 1.0, 0.0] + [
            0.0,
            0.0,
            board.image["plane" if side == "there" else "here"][2],
        ]
        assert board.found(board.solver.image, last)


def test_an_image_whose_fit_comes_back_is_none(core, mixed_cube):
    """Four coils that are not quite in a plane, and a sensor nearly in it."""
    rng, rows = np.random.default_rng(1370), []
    for b in mixed_cube.beacons[:4]:
        axis = np.array([0.0, 0.0, 1.0]) + rng.uniform(-0.15, 0.15, 3) * [1.0, 1.0, 0.0]
        position = np.append(rng.normal(size=2), 0.2 * rng.uniform(-1.0, 1.0))
        rows.append(dataclasses.replace(b, position_m=position, axis=axis / np.linalg.norm(axis)))
    site = dataclasses.replace(mixed_cube, beacons=tuple(rows))
    place = Place(site, rng.normal(size=3) * [1.0, 1.0, 0.6], Rotation.random(random_state=rng))
    board = Solving(core, place)
    board.start(board.solver.best)
    board.lib.pose_fit(board.problem, 30, board.ffi.addressof(board.solver.best))
    assert not board.lib.pose_solve_mirror(board.solver, board.evaluations)
    assert board.evaluations[0] > 100
    assert board.found(board.solver.image)
    assert board.found(board.solver.best)

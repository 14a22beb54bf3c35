"""What becomes of poses that fit alike: which are the same, which images are rivals, and what a half-space decides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate.constellation import RIVAL_COST, Constellation
from goldfield.locate.fit import Fit, Measurements
from goldfield.locate.mirror import Mirror
from goldfield.locate.solutions import unsolved
from goldfield.site import HalfSpace
from tests.bench import locate_trials as bench

ABOVE = HalfSpace(np.array([5.0, 5.0, 1.0]), np.array([0.0, 0.0, 1.0]))
CUBE = FieldModel(bench.prigge_cube().beacons)


def fits(position, cost, rotation=None):
    """Fits of these places and costs."""
    count = len(cost)
    turn = np.repeat(np.eye(3)[None], count, axis=0) if rotation is None else np.array(rotation)
    information = np.arange(1.0, count + 1.0)[:, None, None] * np.diag(np.arange(1.0, 7.0))
    return Fit(np.array(position, dtype=float), turn, np.array(cost), information, np.ones(count, dtype=bool))


def turned(angle_rad, axis=2):
    return Rotation.from_rotvec(angle_rad * np.eye(3)[axis]).as_matrix()


def three_axes(axes=(0, 1, 2)):
    field = np.full((1, 8, 3), np.nan)
    field[:, :, axes] = 1e-6
    field[0, 3] = np.nan  # one beacon was not heard
    return Measurements(field, np.full((1, 8), 1e-9))


def test_the_half_space_is_from_its_plane_on():
    """The plane is tilted, and goes through a point that is far from the origin."""
    plane = HalfSpace(np.array([3.0, 0.0, 4.0]), np.array([0.0, 0.6, 0.8]))
    points = np.array([[0.0, 0.0, 4.0], [9.0, 4.0, 1.01], [9.0, 4.0, 0.99], [0.0, 0.0, -4.1]])
    assert Constellation(CUBE, plane).inside(points).tolist() == [True, True, False, False]
    assert Constellation(CUBE).inside(points).tolist() == [True] * 4


def kept(found, measurements=None, half_space=None):
    """The costs of the poses that stay."""
    return Constellation(CUBE, half_space)._distinct(found, measurements or three_axes()).cost.tolist()


NEAREST = CUBE.centre_m[7]
PLACE = NEAREST + np.array([0.0, 0.0, 0.8])


@pytest.mark.parametrize(
    ("away", "turn_rad", "costs"),
    [
        ((0.039, 0.0, 0.0), 0.0, [1.0]),
        ((0.0, 0.0, 0.041), 0.0, [1.0]),  # 5 % of the way of this one, which is further from the coil
        ((0.041, 0.0, 0.0), 0.0, [1.0, 2.0]),
        ((0.0, 0.0, -0.041), 0.0, [1.0, 2.0]),
        ((0.0, 0.0, 0.0), 0.198, [1.0]),
        ((0.0, 0.0, 0.0), 0.203, [1.0, 2.0]),
        ((0.0, 0.0, 0.0), -0.203, [1.0, 2.0]),
        ((0.5, 0.0, 0.0), 1.0, [1.0, 2.0]),
    ],
)
def test_poses_are_the_same_where_neither_place_nor_attitude_differs(away, turn_rad, costs):
    """By a twentieth of the way to the nearest coil, and by .2 in any component of the axes."""
    base = Rotation.from_rotvec([0.0, 0.0, 0.0]).as_matrix()
    found = fits([PLACE, PLACE + away], [1.0, 2.0], [base, turned(turn_rad) @ base])
    assert kept(found) == costs


def test_only_axes_that_measured_tell_attitudes_apart():
    """A turn about z leaves the axis z where it is."""
    found = fits([PLACE, PLACE], [1.0, 2.0], [np.eye(3), turned(2.0)])
    assert kept(found, three_axes((2,))) == [1.0]
    assert kept(found, three_axes((0,))) == [1.0, 2.0]
    about_x = fits([PLACE, PLACE], [1.0, 2.0], [np.eye(3), turned(2.0, axis=0)])
    assert kept(about_x, three_axes((0,))) == [1.0]


def test_poses_outside_stay_only_where_none_is_inside():
    low, high = [1.0, 1.0, 0.5], [1.0, 1.0, 1.2]
    other_low = [0.3, 1.0, 0.5]
    assert kept(fits([low, high], [1.0, 2.0]), half_space=ABOVE) == [2.0]
    assert kept(fits([low, other_low], [1.0, 2.0]), half_space=ABOVE) == [1.0, 2.0]
    assert kept(fits([low, high], [1.0, np.inf]), half_space=ABOVE) == [1.0]
    assert kept(fits([low, high], [np.nan, np.inf])) == pytest.approx([np.nan], nan_ok=True)
    assert kept(fits([high, low, other_low], [1.0, np.inf, 3.0])) == [1.0, 3.0]


def test_all_poses_are_compared_with_all_that_stay():
    places = PLACE + np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.01, 0.0, 0.0], [0.51, 0.0, 0.0]])
    assert kept(fits(places, [1.0, 2.0, 3.0, 4.0])) == [1.0, 2.0]


def solutions(best, rival=None, contested=False):
    found = unsolved(best)
    flags = np.broadcast_to(np.asarray(contested), len(best.cost)).copy()
    return replace(found, rival=best.take(np.arange(len(best.cost))) if rival is None else rival, contested=flags)


HIGH, LOW, OTHER_HIGH = [1.0, 1.0, 2.0], [1.0, 1.0, 0.0], [0.4, 1.0, 2.0]


@pytest.mark.parametrize(
    ("best", "rival", "contested", "place", "stays_contested", "outside"),
    [
        (HIGH, LOW, True, HIGH, False, False),
        (LOW, HIGH, True, HIGH, False, False),
        (HIGH, OTHER_HIGH, True, HIGH, True, False),
        (LOW, [0.4, 1.0, 0.0], True, LOW, True, True),
        (HIGH, LOW, False, HIGH, False, False),
        (LOW, HIGH, False, LOW, False, True),
        (HIGH, OTHER_HIGH, False, HIGH, False, False),
        (LOW, [0.4, 1.0, 0.0], False, LOW, False, True),
    ],
)
def test_the_half_space_decides_between_rivals(best, rival, contested, place, stays_contested, outside):
    """What is no rival decides nothing. The pose that is not taken is the rival then."""
    given = solutions(fits([best], [1.0]), fits([rival], [2.0]), contested)
    decided = Constellation(CUBE, ABOVE)._sided(given)
    np.testing.assert_array_equal(decided.best.position_m, [place])
    np.testing.assert_array_equal(decided.rival.position_m, [rival if place == best else best])
    assert decided.contested.tolist() == [stays_contested]
    assert decided.outside.tolist() == [outside]
    whole = solutions(fits([best], [1.0]), fits([rival], [2.0]), contested)
    without = Constellation(CUBE)._sided(whole)
    assert without is whole


FLOOR = np.diag([1.0, 1.0, -1.0])
HALF_TURN = np.diag([-1.0, -1.0, 1.0])


def mirror(exact=True, turn=HALF_TURN, height_m=1.0):
    """Reflects places through a level plane."""
    return Mirror(np.array([0.0, 0.0, height_m]), FLOOR, turn, exact)


def reflected(given, of=None, half_space=None, refined=None):
    """Let a mirror reflect solutions, in place; ``refined`` stands in for the fit of an image that is not exact."""
    constellation = Constellation(CUBE, half_space)
    if refined is not None:
        constellation.refine = refined
    with np.errstate(invalid="ignore"):  # as all of location is done: an infinite cost less another is nothing
        constellation._reflect(three_axes(), given, of or mirror())
    return given


def test_the_image_of_a_pose_is_its_rival_where_nothing_decides():
    best = fits([HIGH], [3.0], [turned(0.3)])
    found = reflected(solutions(best))
    np.testing.assert_array_equal(found.best.position_m, [HIGH])
    np.testing.assert_array_equal(found.rival.position_m, [LOW])
    np.testing.assert_allclose(found.rival.rotation, [HALF_TURN @ turned(0.3)])
    assert found.contested.tolist() == [True]


@pytest.mark.parametrize(("best", "place"), [(HIGH, HIGH), (LOW, HIGH)])
def test_of_a_pose_and_its_image_the_one_inside_is_taken(best, place):
    given = solutions(fits([best], [3.0]))
    given.covariance_widening[:] = np.arange(36.0).reshape(6, 6)
    signs = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])
    found = reflected(given, half_space=ABOVE)
    np.testing.assert_array_equal(found.best.position_m, [place])
    assert found.contested.tolist() == [False]
    widening = np.arange(36.0).reshape(6, 6) * (1.0 if place == best else np.outer(signs, signs))
    np.testing.assert_array_equal(found.covariance_widening, [widening])


@pytest.mark.parametrize("best", [[1.0, 1.0, 2.0], [1.0, 1.0, 0.0]])
def test_on_one_side_the_better_of_a_pose_and_its_image_is_the_best(best):
    for change, swapped in ((-2.0, True), (0.0, False), (2.0, False)):
        image = fits([[1.0, 1.0, 2.0 - best[2]]], [3.0 + change], [HALF_TURN])
        given = solutions(fits([best], [3.0]))
        found = reflected(given, mirror(exact=False), refined=lambda *_, image=image: image.take(np.arange(1)))
        poses = ([best], image.position_m.tolist())
        assert found.best.position_m.tolist() == poses[swapped]
        assert found.rival.position_m.tolist() == poses[not swapped]
        assert found.best.cost.tolist() == [3.0 + min(change, 0.0)]
        assert found.contested.tolist() == [True]


@pytest.mark.parametrize(
    ("more", "likely"),
    [(RIVAL_COST, False), (0.98 * RIVAL_COST, True), (1.02 * RIVAL_COST, False), (RIVAL_COST + 0.5, False)],
)
def test_an_image_that_fits_much_worse_is_no_rival(more, likely):
    image = fits([LOW], [16.0 + more], [HALF_TURN])
    found = reflected(solutions(fits([HIGH], [16.0])), mirror(exact=False), refined=lambda *_: image)
    assert found.contested.tolist() == [likely]
    np.testing.assert_array_equal(found.rival.position_m, [LOW if likely else HIGH])
    # Neither is it where the half-space would take it.
    given = solutions(fits([LOW], [16.0]))
    image = fits([HIGH], [16.0 + more], [HALF_TURN])
    found = reflected(given, mirror(exact=False), ABOVE, refined=lambda *_: image)
    np.testing.assert_array_equal(found.best.position_m, [HIGH if likely else LOW])


@pytest.mark.parametrize(
    ("apart_m", "turn_rad", "other"),
    [(0.98e-3, 0.0, False), (1.02e-3, 0.0, True), (0.0, 0.198, False), (0.0, 0.203, True), (0.5, 1.0, True)],
)
def test_an_image_that_is_the_pose_itself_is_no_rival(apart_m, turn_rad, other):
    """A millimetre or .2 of an axis makes it another."""
    given = solutions(fits([[1.0, 1.0, 1.0 + apart_m / 2.0]], [3.0]))
    found = reflected(given, mirror(turn=turned(turn_rad)))
    assert found.contested.tolist() == [other]


def test_a_rival_outside_is_seen_from_inside_where_its_image_is_there():
    """The mirror is exact; where the rival is none, or inside, or its image is outside, it stays."""
    low_rival = [0.4, 1.0, -0.5]
    for rival, contested, half_space, there in (
        (low_rival, True, ABOVE, [0.4, 1.0, 2.5]),
        (low_rival, False, ABOVE, low_rival),
        (low_rival, True, None, None),
        (OTHER_HIGH, True, ABOVE, OTHER_HIGH),
    ):
        found = reflected(solutions(fits([HIGH], [3.0]), fits([rival], [4.0]), contested), half_space=half_space)
        np.testing.assert_array_equal(found.rival.position_m, [LOW if there is None else there])
        np.testing.assert_array_equal(found.best.position_m, [HIGH])
    far = HalfSpace(np.array([0.0, 0.0, 2.2]), np.array([0.0, 0.0, 1.0]))  # neither the rival nor its image is inside
    found = reflected(solutions(fits([[1.0, 1.0, 3.0]], [3.0]), fits([OTHER_HIGH], [4.0]), True), half_space=far)
    np.testing.assert_array_equal(found.rival.position_m, [OTHER_HIGH])


def test_each_of_several_epochs_is_reflected_on_its_own():
    """One inside, one outside, one on the plane itself, which is its own image, and one that no one heard."""
    best = fits([HIGH, LOW, [1.0, 1.0, 1.0], LOW], [1.0, 2.0, 3.0, np.inf])
    found = reflected(solutions(best), mirror(turn=np.eye(3)), half_space=ABOVE)
    np.testing.assert_array_equal(found.best.position_m, [HIGH, HIGH, [1.0, 1.0, 1.0], LOW])
    np.testing.assert_array_equal(found.best.cost, [1.0, 2.0, 3.0, np.inf])
    assert not found.contested.any()
    both = solutions(fits([HIGH, [1.0, 1.0, 1.0]], [1.0, 2.0]))
    assert reflected(both, mirror(turn=np.eye(3))).contested.tolist() == [True, False]
    np.testing.assert_array_equal(both.rival.position_m, [LOW, [1.0, 1.0, 1.0]])

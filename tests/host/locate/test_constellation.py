"""What is taken without a search: what is heard, known, enough or sure, and one faulty beacon.

Where a step is looked at alone, those around it are put in its place by hand.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from goldfield.locate import constellation as module
from goldfield.locate.constellation import (
    OUTSTANDING,
    SURE_RADII,
    SUSPECT,
    Constellation,
)
from goldfield.locate.fit import Measurements
from goldfield.locate.solutions import unsolved
from goldfield.site import HalfSpace
from tests.host.locate.steps import Asked, fits, of_axes, without_kernel


def test_subsets_are_remembered_until_there_are_too_many(cube, monkeypatch):
    monkeypatch.setattr(module, "REMEMBERED", 10)
    plane = HalfSpace(np.zeros(3), np.eye(3)[2])
    whole = Constellation(cube, plane)
    rows = [np.delete(np.arange(8), [k % 8, (k + 1 + k // 8) % 8]) for k in range(11)]
    first = whole.subset(rows[0])
    np.testing.assert_array_equal(first.model.centre_m, cube.centre_m[rows[0]])
    assert first.half_space is plane
    for row in rows[1:10]:
        whole.subset(row)
    assert whole.subset(rows[0]) is first
    assert whole.subset(rows[10]) is whole.subset(rows[10])
    assert whole.subset(rows[0]) is not first


@pytest.mark.parametrize("heard", [(True, True, True, True), (True, False, True, False), (False,) * 4])
@pytest.mark.parametrize("known", [False, True])
def test_only_what_is_heard_is_solved(cube, run, monkeypatch, heard, known):
    constellation, heard = Constellation(cube), np.array(heard)
    measurements = Measurements(np.where(heard[:, None, None], run.field_T, 0.0), run.sigma_T)
    asked = Asked(monkeypatch, constellation, _solve_heard=lambda some, *_: unsolved(fits(np.arange(len(some)) + 7.0)))
    given = fits([1.0, 2.0, 3.0, 4.0]) if known else None
    solved = constellation.solve(measurements, 500, at_any_cost=False, known=given)
    assert len(asked.calls) == heard.any()
    for some, most, at_any_cost, of in asked.told("_solve_heard"):
        np.testing.assert_array_equal(some.field_T, run.field_T[heard])
        assert (most, at_any_cost) == (500, False)
        assert (of is None) == (not known)
        if known:
            np.testing.assert_array_equal(of.cost, given.cost[heard])
    np.testing.assert_array_equal(solved.best.cost[heard], 7.0 + np.arange(heard.sum()))
    assert np.isinf(solved.best.cost[~heard]).all()


STEPS = {
    "from_magnitudes": lambda some: fits(np.ones(len(some))),
    "_search": lambda some, *_: unsolved(fits(np.full(len(some), 5.0))),
    "_search_shell": lambda some, *_: unsolved(fits(np.full(len(some), 6.0))),
    "_enough": lambda some, fit, *, strict: np.isfinite(fit.cost) & (np.arange(len(some)) != 2),
    "_enough_without_one": None,
}


@pytest.mark.parametrize(
    ("library", "axes", "beacons", "begins", "searches"),
    [
        (True, 3, 8, True, "_search"),
        (True, 3, 6, True, "_search"),
        (True, 3, 5, False, "_search"),
        (True, 2, 8, False, "_search_shell"),
        (False, 3, 4, True, "_search_shell"),
        (False, 3, 3, False, "_search_shell"),
        (False, 2, 8, False, "_search_shell"),
    ],
)
def test_the_chain_comes_first_where_it_may_be_enough(cube, run, monkeypatch, library, axes, beacons, begins, searches):
    """It is enough in three epochs of four; where it cannot be asked, all are searched."""
    if not library:
        without_kernel(monkeypatch)
    constellation = Constellation(cube.subset(np.arange(beacons)))
    constellation.__dict__["mirrors"] = ()
    asked = Asked(monkeypatch, constellation, **STEPS)
    measurements = of_axes(run, axes, beacons)
    solved = constellation._solve_heard(measurements, 300, True, None)
    few = searches == "_search"
    further = [2] if begins else [0, 1, 2, 3]
    one_by_one = [searches] * (1 if few else len(further))
    assert asked.names == ["from_magnitudes"] * begins + ["_enough"] + ["_enough_without_one"] * few + one_by_one
    ((_, _, options),) = [call for call in asked.calls if call[0] == "_enough"]
    assert options == {"strict": few}
    cost = np.full(4, 1.0 if begins else np.inf)
    cost[further] = 5.0 if few else 6.0
    np.testing.assert_array_equal(solved.best.cost, cost)
    if few:
        ((some, most, at_any_cost),) = asked.told("_search")
        np.testing.assert_array_equal(some.field_T, measurements.field_T[further])
        assert (most, at_any_cost) == (300, True)
    else:
        for e, (one, _, most) in zip(further, asked.told("_search_shell"), strict=True):
            np.testing.assert_array_equal(one.field_T, measurements.field_T[[e]])
            assert most == 300


@pytest.mark.parametrize("library", [True, False])
def test_nothing_is_searched_where_all_is_enough(cube, sound, monkeypatch, library):
    if not library:
        without_kernel(monkeypatch)
    constellation = Constellation(cube)
    asked = Asked(monkeypatch, constellation, **{**STEPS, "_enough": np.ones(4, dtype=bool)})
    constellation._solve_heard(sound, 300, True, None)
    assert asked.names == ["from_magnitudes", "_enough"]


def test_poses_that_are_known_stand_in_for_the_chain(cube, sound, monkeypatch):
    """They are looked at as they are, and stay as they are."""
    constellation, known = Constellation(cube), fits([1.0, 2.0, 3.0, 4.0])
    asked = Asked(monkeypatch, constellation, **STEPS)
    solved = constellation._solve_heard(sound, 300, True, known)
    assert "from_magnitudes" not in asked.names
    np.testing.assert_array_equal(solved.best.cost, [1.0, 2.0, 5.0, 4.0])
    np.testing.assert_array_equal(known.cost, [1.0, 2.0, 3.0, 4.0])


def test_mirrors_reflect_those_that_they_concern(cube, sound, monkeypatch):
    constellation = Constellation(cube)
    far = SimpleNamespace(concerns=lambda position: position[:, 0] >= 2.0)
    none = SimpleNamespace(concerns=lambda position: position[:, 0] > 9.0)
    constellation.__dict__["mirrors"] = (none, far)
    known, reflected = fits([1.0, 2.0, 3.0, 4.0]), []

    def reflect(some, solutions, mirror):
        reflected.append((some, mirror))
        solutions.best.cost[:] += 100.0

    Asked(monkeypatch, constellation, _enough=np.ones(4, dtype=bool), _reflect=reflect)
    solved = constellation._solve_heard(sound, 300, True, known)
    np.testing.assert_array_equal(solved.best.cost, [1.0, 2.0, 103.0, 104.0])
    ((some, mirror),) = reflected
    assert mirror is far
    np.testing.assert_array_equal(some.field_T, sound.field_T[2:])


def test_a_fit_is_enough_where_it_ended_and_its_cost_is_likely(cube, sound, monkeypatch):
    """Eight coils leave 18 degrees of freedom. A likelihood that is just the limit is not above it."""
    constellation, limit = Constellation(cube), chi2.isf(SUSPECT, 18)
    asked = Asked(monkeypatch, constellation, sure=np.array([False, True, True, True]))
    found = fits(limit * np.array([0.999, 0.999, 1.001, 0.999]), converged=[True, True, True, False])
    assert constellation._enough(sound, found, strict=False).tolist() == [True, True, False, False]
    assert asked.calls == []
    assert constellation._enough(sound, found, strict=True).tolist() == [False, True, False, False]
    monkeypatch.setattr(module, "probability", lambda cost, freedom: np.array([SUSPECT, 1.1 * SUSPECT, 0.0, 1.0]))
    assert constellation._enough(sound, found, strict=False).tolist() == [False, True, False, False]


def at_strength(strength, cube):
    """One epoch whose beacons are as many standard deviations strong, at the middle of the cube."""
    field = np.zeros((1, 8, 3))
    field[0, :, 1] = np.array(strength) * 0.5
    return Measurements(field, np.full((1, 8), 0.5)), fits([1.0], cube.centre_m.mean(axis=0)[None])


@pytest.mark.parametrize(
    ("weak", "others", "sure"),
    [
        ([1.0, 1.0], OUTSTANDING * 1.01, True),
        ([1.0, 1.0, 1.0], 20.0, False),
        ([1.0, 1.0], OUTSTANDING, False),
        ([OUTSTANDING] * 2, 20.0, True),
        ([OUTSTANDING] * 3, 20.0, False),
        ([], 7.5, True),
    ],
)
def test_six_beacons_must_stand_out_for_a_pose_to_be_sure(cube, weak, others, sure):
    measurements, fit = at_strength(weak + [others] * (8 - len(weak)), cube)
    assert Constellation(cube).sure(measurements, fit).tolist() == [sure]


def test_near_a_coil_no_pose_is_sure(cube):
    measurements, fit = at_strength([20.0] * 8, cube)
    reach = cube.reach_m[3]
    for share, sure in ((0.999, False), (1.001, True)):
        fit.position_m[:] = cube.centre_m[3] - np.array([0.0, share * SURE_RADII * reach, 0.0])
        assert Constellation(cube).sure(measurements, fit).tolist() == [sure]


def test_beacons_that_are_spread_badly_make_no_pose_sure(cube, monkeypatch):
    """Those that stand out are looked at, of epochs that are sure else, from where each pose is."""
    constellation, looked = Constellation(cube), []

    def good(some, position_m):
        looked.append((some, position_m))
        return np.array([True, False])

    constellation.__dict__["_spread"] = SimpleNamespace(good=good)
    field = np.zeros((3, 8, 3))
    field[:, :, 0] = 20.0
    field[0, 6, 0] = 1.0
    field[1, :3, 0] = 1.0
    places = cube.centre_m.mean(axis=0) + np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.2], [0.0, 0.0, 0.3]])
    measurements = Measurements(field, np.ones((3, 8)))
    assert constellation.sure(measurements, fits([1.0] * 3, places)).tolist() == [True, False, False]
    ((some, position_m),) = looked
    np.testing.assert_array_equal(position_m, places[[0, 2]])
    np.testing.assert_array_equal(some, [[True] * 6 + [False, True], [True] * 8])


def far_off(run, row=2, factor=1.1):
    """Fields of which those of one beacon are not the site's."""
    field = run.field_T.copy()
    field[:, row] *= factor
    return Measurements(field, run.sigma_T)


def test_one_faulty_beacon_needs_no_search(cube, run):
    """The pose is that which fits all best near that of the others; what is enough already, or never ended, stays."""
    constellation, measurements = Constellation(cube), far_off(run)
    start = constellation._polished(measurements, run.position_m, run.rotation)
    start.converged[1] = False
    start.position_m[0] += 0.001  # whatever the pose that is known is worth
    solutions, enough = unsolved(start.take(np.arange(4))), np.array([False, False, False, True])
    solutions.best.cost[3] = 1e9
    constellation._enough_without_one(measurements, solutions, enough)
    assert enough.tolist() == [True, False, True, True]
    for e in (0, 2):
        thinned = constellation.subset(np.delete(np.arange(8), 2))
        one = np.array([e])
        others = thinned._polished(
            measurements.take(one).of_beacons(np.delete(np.arange(8), 2)), run.position_m[one], run.rotation[one]
        )
        best = constellation._polished(measurements.take(one), others.position_m, others.rotation)
        np.testing.assert_allclose(solutions.best.position_m[e], best.position_m[0], atol=1e-6)
        assert solutions.best.cost[e] == pytest.approx(best.cost[0], rel=1e-6)
    np.testing.assert_array_equal(solutions.best.position_m[[1, 3]], start.position_m[[1, 3]])
    assert solutions.best.cost[3] == 1e9


@pytest.mark.parametrize(
    ("factor", "other", "cost_share", "weak", "spared"),
    [
        (1.1, None, None, 0, True),
        (1.1, 5, None, 0, False),  # two faulty beacons
        (1.1, None, None, 1, True),  # seven stand out, six without the faulty one
        (1.1, None, None, 2, False),
        (1.0, None, 0.999, 0, False),  # the cost is likely: there is nothing to mend
        (1.0, None, 1.001, 0, True),
    ],
)
def test_what_a_faulty_beacon_leaves_must_be_sure(cube, run, factor, other, cost_share, weak, spared):
    measurements = far_off(run, factor=factor)
    if other is not None:
        measurements.field_T[:, other] *= 1.1
    sigma = measurements.sigma_T.copy()
    sigma[:, 6 : 6 + weak] = np.linalg.norm(measurements.field_T[:, 6 : 6 + weak], axis=2) / (0.99 * OUTSTANDING)
    measurements = Measurements(measurements.field_T, sigma)
    constellation = Constellation(cube)
    known = constellation._polished(measurements, run.position_m, run.rotation)
    if cost_share is not None:
        known.cost[:] = cost_share * chi2.isf(SUSPECT, 18)
    solutions, enough = unsolved(known), np.zeros(4, dtype=bool)
    constellation._enough_without_one(measurements, solutions, enough)
    assert enough.tolist() == [spared] * 4


@pytest.mark.parametrize(("weak", "looked_at"), [(1, True), (2, False)])
def test_a_cost_that_is_just_as_likely_as_the_limit_is_looked_at(cube, monkeypatch, weak, looked_at):
    """If more than six beacons stand out; one that is just as strong as the limit does not."""
    monkeypatch.setattr(module, "probability", lambda cost, freedom: np.full(len(cost), SUSPECT))
    asked, drop = [], np.eye(8)[:1]
    monkeypatch.setattr(module, "fault_statistics", lambda *given: asked.append(given) or SimpleNamespace(drop=drop))
    measurements, known = at_strength([OUTSTANDING] * weak + [20.0] * (8 - weak), cube)
    Constellation(cube)._enough_without_one(measurements, unsolved(known), np.zeros(1, dtype=bool))
    assert len(asked) == looked_at


def test_a_pose_of_all_that_does_not_end_is_searched_all_the_same(cube, run, monkeypatch):
    constellation, measurements = Constellation(cube), far_off(run)
    solutions = unsolved(constellation._polished(measurements, run.position_m, run.rotation))
    whole, calls = constellation._polished, []

    def polished(some, position_m, rotation):
        calls.append(len(some))
        fit = whole(some, position_m, rotation)
        if len(calls) == 2:
            fit.converged[0] = False
        return fit

    monkeypatch.setattr(constellation, "_polished", polished)
    before, enough = solutions.best.position_m.copy(), np.zeros(4, dtype=bool)
    constellation._enough_without_one(measurements, solutions, enough)
    assert enough.tolist() == [False, True, True, True]
    np.testing.assert_array_equal(solutions.best.position_m[0], before[0])

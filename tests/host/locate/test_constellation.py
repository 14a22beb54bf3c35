"""The course of a search: what is taken without one, what is searched how far, and what is said of its end.

Where a step is looked at alone, those around it are put in its place by hand.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from goldfield.field import FieldModel
from goldfield.locate import constellation as module
from goldfield.locate import kernel
from goldfield.locate.budget import Budget
from goldfield.locate.constellation import (
    CANDIDATE_EVALUATIONS,
    CANDIDATES,
    OUTSTANDING,
    RIVAL_COST,
    ROBUST_MODEL_ERROR,
    SURE_RADII,
    SUSPECT,
    Constellation,
)
from goldfield.locate.fit import Fit, Measurements
from goldfield.locate.solutions import nowhere, unsolved
from goldfield.site import HalfSpace
from tests.bench import locate_trials as bench

SIGMA_T = 1e-9


@pytest.fixture(scope="module")
def site():
    return bench.prigge_cube(2e-8)


@pytest.fixture(scope="module")
def cube(site):
    return FieldModel(site.beacons)


@pytest.fixture(scope="module")
def run(site):
    rng = np.random.default_rng(71)
    return bench.trials(site, bench.cube_positions(rng, 4, 0.6), rng, sigma_T=SIGMA_T)


@pytest.fixture
def sound(run):
    return Measurements(run.field_T, run.sigma_T)


def fits(cost, position=None, converged=True):
    """Fits of these costs; the place tells which is which."""
    count = len(cost)
    place = np.arange(count)[:, None] * np.ones(3) if position is None else np.array(position, dtype=float)
    turn = np.repeat(np.eye(3)[None], count, axis=0)
    done = np.broadcast_to(np.asarray(converged), count).copy()
    return Fit(place, turn, np.array(cost, dtype=float), np.zeros((count, 6, 6)), done)


class Asked:
    """Notes what a constellation asks of its own steps, and answers with what is given."""

    def __init__(self, monkeypatch, constellation, **answers):
        self.calls = []
        for name, answer in answers.items():
            monkeypatch.setattr(constellation, name, self._noting(name, answer))

    def _noting(self, name, answer):
        def step(*arguments, **options):
            self.calls.append((name, arguments, options))
            return answer(*arguments, **options) if callable(answer) else answer

        return step

    @property
    def names(self):
        return [name for name, *_ in self.calls]

    def told(self, name):
        return [arguments for of, arguments, _ in self.calls if of == name]


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


def without_kernel(monkeypatch):
    monkeypatch.setattr(kernel, "_library", lambda: None)


def of_axes(run, axes, beacons):
    field = run.field_T[:, :beacons].copy()
    field[:, :, axes:] = np.nan
    return Measurements(field, run.sigma_T[:, :beacons])


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


@pytest.mark.parametrize("half_space", [None, HalfSpace(np.array([0.0, 2.0, 3.0]), np.array([0.0, 0.6, 0.8]))])
def test_a_search_is_told_its_side_and_its_bounds_and_is_paid(cube, sound, monkeypatch, half_space):
    """A cost of 50 and of 5 for each component is beyond all hope."""
    given = []

    def search(field_T, sigma_T, **options):
        given.append((field_T, sigma_T, options))
        return None, None, None, None, np.array([100, 20, 3, 0])

    monkeypatch.setattr(kernel, "of", lambda model: SimpleNamespace(search=search))
    constellation, budget = Constellation(cube, half_space), Budget(8)
    before = budget.evaluations(1)
    constellation.searched(sound.within(budget), 5000, at_any_cost=False)
    ((field_T, sigma_T, options),) = given
    np.testing.assert_array_equal(field_T, sound.field_T)
    np.testing.assert_array_equal(sigma_T, sound.sigma_T)
    np.testing.assert_allclose(options.pop("half_space"), np.zeros(4) if half_space is None else [0.0, 0.6, 0.8, 3.6])
    assert options == {"most_evaluations": 5000, "hopeless_cost": 50.0 + 5.0 * 24, "at_any_cost": False}
    assert before - budget.evaluations(1) == 123 * 8
    monkeypatch.setattr(kernel, "of", lambda model: None)
    assert constellation.searched(sound, 5000, at_any_cost=True) is None


def searching(monkeypatch, constellation, best, rival, count, evaluations):
    """What a search returns, and what fits of it end at; the second place tells the rival."""
    position = np.zeros((4, 2, 3))
    position[:, 1] = 100.0
    rotation = np.repeat(np.array([np.eye(3), np.diag([1.0, -1.0, -1.0])])[None], 4, axis=0)
    widening = np.arange(4.0)[:, None, None] * np.ones((6, 6))

    def polished(some, position_m, rotation):  # the attitudes are those of the places
        of_rival = len(position_m) > 0 and bool((position_m == 100.0).all())
        assert (rotation[:, 1, 1] == (-1.0 if of_rival else 1.0)).all()
        chosen = rival if of_rival else best
        return chosen.take(np.arange(len(chosen.cost)))

    return Asked(
        monkeypatch,
        constellation,
        searched=(position, rotation, np.array(count), widening, np.array(evaluations)),
        _polished=polished,
        _further=None,
    )


def test_of_a_search_the_best_and_a_rival_that_fits_nearly_as_well_are_told(cube, sound, monkeypatch):
    constellation = Constellation(cube)
    best = fits([10.0, 20.0, 30.0, 40.0])
    more = np.array([0.98, 1.02]) * RIVAL_COST
    asked = searching(
        monkeypatch, constellation, best, fits(np.array([20.0, 30.0]) + more), [0, 2, 2, 1], [9, 9, 9, 10]
    )
    found = constellation._search(sound, 10, False)
    np.testing.assert_array_equal(found.best.cost, [np.inf, 20.0, 30.0, 40.0])
    np.testing.assert_array_equal(found.rival.cost[1:], [20.0 + more[0], 30.0 + more[1], 40.0])
    assert found.contested.tolist() == [False, True, False, False]
    assert found.bounded.tolist() == [False, False, False, True]
    np.testing.assert_array_equal(found.evaluations, [9, 9, 9, 10])
    np.testing.assert_array_equal(found.covariance_widening[:, 2, 4], [0.0, 1.0, 2.0, 3.0])
    assert asked.calls[0][1:] == ((sound, 10), {"at_any_cost": False})
    ((_, of, rows),) = asked.told("_further")
    assert (len(of.cost), rows.tolist()) == (4, [])


def test_a_rival_that_is_just_as_much_worse_is_none(cube, sound, monkeypatch):
    constellation = Constellation(cube)
    searching(monkeypatch, constellation, fits([1.0] * 4), fits([1.0 + RIVAL_COST] * 4), [2] * 4, [9] * 4)
    assert constellation._search(sound, 10, True).contested.tolist() == [False] * 4


def test_a_fit_that_did_not_end_goes_on_unless_it_is_beyond_hope(cube, sound, monkeypatch):
    """If it does not end then either, the search has shown nothing."""
    constellation, hopeless = Constellation(cube), 170.0
    costs = [0.999 * hopeless, hopeless, 1.001 * hopeless, 1.0]
    best = fits(costs, converged=[False, False, False, True])
    asked = searching(monkeypatch, constellation, best, None, [1] * 4, [9] * 4)
    found = constellation._search(sound, 10, True)
    assert [rows.tolist() for *_, rows in asked.told("_further")] == [[0]]
    assert found.bounded.tolist() == [True, False, False, False]
    assert not found.contested.any()


def test_where_nothing_is_found_there_is_no_pose(cube, sound, monkeypatch):
    constellation = Constellation(cube)
    searching(monkeypatch, constellation, fits([1.0] * 4), None, [0] * 4, [9] * 4)
    found = constellation._search(sound, 10, True)
    assert np.isinf(found.best.cost).all()
    assert np.isnan(found.best.position_m).all()


def shells(monkeypatch, constellation, costs):
    """What the shell gives of so many candidates."""
    answers = iter(costs)
    return Asked(monkeypatch, constellation, from_shell=lambda some, candidates: next(answers))


@pytest.mark.parametrize(
    ("likely_at", "most", "asked_for"),
    [
        (0, 5000, [8]),
        (1, 5000, [8, 32]),
        (2, 5000, [8, 32, 250]),
        (9, 5000, [8, 32, 250]),
        (9, 400, [8, 20]),
        (9, 640, [8, 32]),
        (9, 160, [8]),
    ],
)
def test_more_candidates_are_fitted_until_the_best_is_likely(cube, run, monkeypatch, likely_at, most, asked_for):
    assert (CANDIDATES, CANDIDATE_EVALUATIONS) == (8, 20)
    constellation, measurements = Constellation(cube), of_axes(run, 2, 8).take(np.array([0]))
    limit = chi2.isf(SUSPECT, 10)  # of 16 components
    costs = [fits([limit * (0.999 if k >= likely_at else 1.001), 1e9]) for k in range(3)]
    asked = shells(monkeypatch, constellation, costs)
    found = constellation._search_shell(measurements, nowhere(1), most)
    assert [candidates for _, candidates in asked.told("from_shell")] == asked_for
    assert found.best.cost[0] == costs[len(asked_for) - 1].cost[0]


def test_what_is_just_as_likely_as_the_limit_is_likely(cube, run, monkeypatch):
    constellation, measurements = Constellation(cube), of_axes(run, 2, 8).take(np.array([0]))
    asked = shells(monkeypatch, constellation, [fits([3.0])] * 3)
    monkeypatch.setattr(module, "probability", lambda cost, freedom: np.array([SUSPECT]))
    constellation._search_shell(measurements, nowhere(1), 5000)
    assert len(asked.calls) == 1


@pytest.mark.parametrize(
    ("shell", "known", "best", "rival", "contested"),
    [
        ([3.0, 20.0], np.inf, 3.0, 20.0, False),
        ([3.0, 3.0 + RIVAL_COST], np.inf, 3.0, 3.0 + RIVAL_COST, False),
        ([3.0, 17.0, 18.0], np.inf, 3.0, 17.0, True),
        ([3.0, 17.0], 2.0, 2.0, 3.0, True),
        ([3.0, 18.9], 4.0, 3.0, 4.0, True),
        ([3.0], np.inf, 3.0, None, False),
        ([np.inf], 3.0, 3.0, None, False),
        ([np.inf], np.inf, np.inf, None, False),
    ],
)
def test_the_pose_that_is_known_competes_with_those_of_the_shell(
    cube, run, monkeypatch, shell, known, best, rival, contested
):
    constellation, measurements = Constellation(cube), of_axes(run, 2, 8).take(np.array([0]))
    shells(monkeypatch, constellation, [fits(shell)] * 3)
    found = constellation._search_shell(measurements, fits([known], [[50.0, 0.0, 0.0]]), 160)
    assert found.best.cost.tolist() == [best]
    if rival is not None:
        assert found.rival.cost.tolist() == [rival]
    assert found.contested.tolist() == [contested]


def test_a_rival_is_no_pose_that_is_the_same(cube, run, monkeypatch):
    constellation, measurements = Constellation(cube), of_axes(run, 2, 8).take(np.array([0]))
    shells(monkeypatch, constellation, [fits([4.0, 3.0], [[1.0, 1.0, 1.0], [1.001, 1.0, 1.0]])] * 3)
    found = constellation._search_shell(measurements, fits([4.5], [[1.0, 1.001, 1.0]]), 160)
    assert (found.best.cost.tolist(), found.contested.tolist()) == ([3.0], [False])
    np.testing.assert_array_equal(found.rival.cost, found.best.cost)


def test_starts_lead_near_the_pose_with_and_without_the_library(cube, run, sound, monkeypatch):
    """Attitudes by all vectors, each with an error of 3 %; what the library took is paid."""
    budget = Budget(8)
    before = budget.evaluations(1)
    constellation = Constellation(cube)
    found = [constellation.starts(sound.within(budget))]
    assert budget.evaluations(1) < before
    without_kernel(monkeypatch)
    found.append(constellation.starts(sound))
    for position, rotation in found:
        np.testing.assert_allclose(position, run.position_m, atol=0.3)
        for e in range(4):
            modelled = cube.field(position[e])
            weight = 1.0 / (SIGMA_T**2 + (ROBUST_MODEL_ERROR * np.linalg.norm(run.field_T[e], axis=1)) ** 2)
            expected, _ = Rotation.align_vectors(modelled, run.field_T[e], weights=weight)
            np.testing.assert_allclose(rotation[e], expected.as_matrix(), atol=1e-6)


def test_the_shell_leads_to_the_pose_on_the_right_side(cube, run):
    """One axis and two, one beacon not heard; the best fit comes first."""
    for axes in (3, 2):
        field = run.field_T[1:2].copy()
        field[:, :, axes:] = np.nan
        field[:, 4] = np.nan
        measurements = Measurements(field, run.sigma_T[1:2])
        found = Constellation(cube).from_shell(measurements, 32)
        np.testing.assert_allclose(found.position_m[0], run.position_m[1], atol=5e-3)
        assert (np.diff(found.cost) >= 0.0).all()
        assert 1 < len(found.cost) <= 8
        above = HalfSpace(run.position_m[1] + np.array([0.0, 0.0, 0.05]), np.array([0.0, 0.0, 1.0]))
        other = Constellation(cube, above).from_shell(measurements, 32)
        assert len(other.cost) >= 1
    nothing = HalfSpace(np.array([0.0, 0.0, 1e6]), np.array([0.0, 0.0, 1.0]))
    for constellation, some in (
        (Constellation(cube, nothing), measurements),
        (Constellation(cube), Measurements(np.zeros((1, 8, 3)), np.ones((1, 8)))),
    ):
        lost = constellation.from_shell(some)
        assert lost.cost.tolist() == [np.inf]


def test_a_shell_that_is_given_is_searched(cube, run):
    """As that of a site with many coils, of which these are some."""
    nothing = SimpleNamespace(candidates=lambda field: (np.empty((0, 3)), np.empty((0, 8, 3))))
    one = Measurements(run.field_T[:1], run.sigma_T[:1])
    assert Constellation(cube, shell=nothing).from_shell(one).cost.tolist() == [np.inf]
    assert np.isfinite(Constellation(cube).from_shell(one).cost).all()


def test_candidates_lie_the_further_apart_the_fewer_there_are(cube, run, monkeypatch):
    """By a quarter of the way to the nearest coil for eight; those outside are none."""
    given, whole = [], module.best_apart

    def best_apart(position_m, loss, count, apart_m):
        given.append((position_m, loss, count, apart_m))
        return whole(position_m, loss, count, apart_m)

    monkeypatch.setattr(module, "best_apart", best_apart)
    half = HalfSpace(np.array([0.0, 0.0, 0.9]), np.array([0.0, 0.0, 1.0]))
    one = Measurements(run.field_T[:1], run.sigma_T[:1])
    for count, share in ((8, 0.25), (32, 0.0625)):
        given.clear()
        Constellation(cube, half).from_shell(one, count)
        ((position_m, loss, asked_for, apart_m),) = given
        assert asked_for == count
        nearest = np.min([np.linalg.norm(position_m - centre, axis=1) for centre in cube.centre_m], axis=0)
        np.testing.assert_allclose(apart_m, share * nearest)
        assert (np.isinf(loss) == (position_m[:, 2] < 0.9)).all()
        assert 0 < np.isinf(loss).sum() < len(loss)


def test_fits_go_on_from_where_they_are_or_do_not_move(cube, run, sound):
    constellation = Constellation(cube)
    start = run.position_m + 0.01
    there = constellation.at(sound, start, run.rotation)
    np.testing.assert_array_equal(there.position_m, start)
    field = cube.field(start) @ run.rotation
    np.testing.assert_allclose(there.cost, (((run.field_T - field) / SIGMA_T) ** 2).sum(axis=(1, 2)), rtol=1e-9)
    constellation._further(sound, there, np.array([], dtype=np.intp))
    np.testing.assert_array_equal(there.position_m, start)
    constellation._further(sound, there, np.array([1, 3]))
    assert there.converged[[1, 3]].all()
    np.testing.assert_allclose(there.position_m[[1, 3]], run.position_m[[1, 3]], atol=2e-3)
    np.testing.assert_array_equal(there.position_m[[0, 2]], start[[0, 2]])

"""The course of a search: how far is searched, from where, and what is said of its end.

Where a step is looked at alone, those around it are put in its place by hand.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from goldfield.locate import constellation as module
from goldfield.locate import kernel
from goldfield.locate.budget import Budget
from goldfield.locate.constellation import (
    CANDIDATE_EVALUATIONS,
    CANDIDATES,
    RIVAL_COST,
    ROBUST_MODEL_ERROR,
    SUSPECT,
    Constellation,
)
from goldfield.locate.fit import Measurements
from goldfield.locate.solutions import nowhere
from goldfield.site import HalfSpace
from tests.host.locate.steps import SIGMA_T, Asked, fits, of_axes, without_kernel


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

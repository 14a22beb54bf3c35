"""How subsets of beacons are compared: which are searched where, by what, and which fits are ended.

Where no fields lead near a limit, what fits poses is put in place by hand, and what it was asked is noted.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from goldfield.field import FieldModel
from goldfield.locate import exclusion
from goldfield.locate.budget import Budget
from goldfield.locate.constellation import Constellation
from goldfield.locate.exclusion import Subsets, searched_without_one, without_one
from goldfield.locate.fit import Fit, Measurements
from goldfield.locate.solutions import nowhere
from tests.bench import locate_trials as bench

CORNERS = [(x, y, z) for z in (0.0, 1.0, 2.0, 3.0) for x in (0.0, 2.0) for y in (0.0, 2.0)]


def epoch(beacons, axes=3, budget=None):
    """A constellation, and fields at one place in it of which those of the fourth coil are reversed."""
    site = bench.site_of([bench.loop_beacon(i, CORNERS[i]) for i in range(beacons)], noise_T=2e-8)
    run = bench.trials(site, np.array([[0.8, 1.1, 0.7]]), np.random.default_rng(1), sigma_T=0.0)
    field = run.field_T.copy()
    field[0, 3] *= -1.0
    field[:, :, axes:] = np.nan
    sigma = np.full((1, beacons), 2e-8 / np.sqrt(bench.CHIPS))
    return Constellation(FieldModel(site.beacons)), Measurements(field, sigma, budget=budget), run


def fits_of(cost, position_m=None):
    """Fits of these costs."""
    fits = nowhere(len(cost))
    fits.cost[:] = cost
    fits.position_m[:] = np.arange(len(cost))[:, None] if position_m is None else position_m
    return fits


def left_for(evaluations, beacons):
    """A budget of which so many evaluations of each of as many epochs as coils are left."""
    budget = Budget(beacons)
    budget.spend(200_000 - evaluations * beacons**2, 1)
    return budget


@pytest.mark.parametrize(
    ("beacons", "axes", "left", "asked"),
    [(12, 3, None, True), (13, 3, None, False), (12, 2, None, False), (12, 3, 600, True), (12, 3, 599, False)],
)
def test_twelve_subsets_of_three_axes_are_searched_if_the_budget_lasts(monkeypatch, beacons, axes, left, asked):
    constellation, measurements, _ = epoch(beacons, axes, None if left is None else left_for(left, beacons))
    calls = []

    def searched(self, thinned, most, *, at_any_cost):
        calls.append((thinned.known.sum(axis=1).tolist(), most, at_any_cost))

    monkeypatch.setattr(Constellation, "searched", searched)
    ones = Subsets(np.arange(beacons)[:, None], nowhere(beacons), True)
    assert searched_without_one(constellation, measurements, ones) is ones
    assert calls == ([(12 * [11], 600, False)] if asked else [])


def test_a_search_finds_the_pose_that_no_start_has_led_to():
    constellation, measurements, run = epoch(8)
    far = fits_of(8 * [1e6], np.array([30.0, 30.0, 30.0]))
    ones = Subsets(np.arange(8)[:, None], far, True)
    found = searched_without_one(constellation, measurements, ones)
    assert not found.hopeless
    assert found.left_out[0].tolist() == [3]
    assert found.fit.cost[0] < 1.0
    np.testing.assert_allclose(found.fit.position_m[0], run.position_m[0], atol=1e-3)


def test_of_two_poses_that_a_search_finds_the_first_is_taken(monkeypatch):
    """Each subset's: the second one is its rival."""
    constellation, measurements, _ = epoch(8)
    position, rotation = np.arange(48.0).reshape(8, 2, 3), np.arange(144.0).reshape(8, 2, 3, 3)
    monkeypatch.setattr(Constellation, "searched", lambda *_, **__: (position, rotation))
    monkeypatch.setattr(exclusion, "_rough", lambda _, __, *pose: pose)
    monkeypatch.setattr(exclusion, "_compared", lambda _, __, best, ___, left_out: (best, left_out))
    ones = Subsets(np.arange(8)[::-1, None], nowhere(8), True)
    (position_m, rotations), left_out = searched_without_one(constellation, measurements, ones)
    np.testing.assert_array_equal(position_m, position[:, 0])
    np.testing.assert_array_equal(rotations, rotation[:, 0])
    assert left_out is ones.left_out


def test_of_two_axes_each_subset_is_solved():
    constellation, measurements, run = epoch(7, axes=2)
    found = without_one(constellation, measurements, nowhere(1))
    assert found.left_out[0].tolist() == [3]
    assert sorted(found.left_out[:, 0]) == list(range(7))
    np.testing.assert_allclose(found.fit.position_m[0], run.position_m[0], atol=1e-2)


@pytest.mark.parametrize(
    ("beacons", "axes", "pairs", "by"),
    [
        (12, 3, 0, "starts"),
        (13, 3, 0, None),
        (8, 3, 13, "starts"),
        (12, 2, 0, "solved"),
        (13, 2, 0, None),
        (8, 2, 12, "solved"),
        (8, 2, 13, None),
    ],
)
def test_where_subsets_begin(monkeypatch, beacons, axes, pairs, by):
    """By magnitudes, by a search of each, or by the known poses alone: of many coils, or many subsets of two axes."""
    constellation, measurements, _ = epoch(beacons, axes)
    left_out = np.arange(beacons)[:, None]
    if pairs:
        left_out = np.array([(a, b) for a in range(8) for b in range(a)][:pairs])
    asked, given = [], []
    starts = Constellation.starts
    monkeypatch.setattr(Constellation, "starts", lambda *of: asked.append("starts") or starts(*of))
    monkeypatch.setattr(exclusion, "_solved", lambda *of: asked.append("solved") or nowhere(len(left_out)))
    monkeypatch.setattr(exclusion, "_compared", lambda _, thinned, best, *__: given.append((thinned, best)))
    exclusion._without(constellation, measurements, left_out, nowhere(0))
    assert asked == ([] if by is None else [by])
    ((thinned, best),) = given
    assert np.isfinite(best.cost).any() == (by == "starts")
    known = np.ones((len(left_out), beacons), dtype=bool)
    for row, rows in enumerate(left_out):
        known[row, rows] = False
    np.testing.assert_array_equal(thinned.known, known)


class Thinned(SimpleNamespace):
    """Measurements of subsets, of which nothing is known but what they may cost."""

    def __init__(self, levers=None):
        super().__init__(levers=levers, field_T=None, sigma_T=None, noise_T=None, errors=None, told=[])

    def affordable_in_all(self, coils):
        return 1000 + coils

    def spend(self, evaluations, coils):
        self.told.append((evaluations, coils))


@pytest.mark.parametrize(
    ("count", "levers", "known", "quick"),
    [
        (128, None, True, True),
        (129, None, True, False),
        (8, None, False, False),
        (8, np.zeros(3), True, False),
    ],
)
def test_the_kernel_compares_what_it_can(monkeypatch, count, levers, known, quick):
    """It knows the coils, takes 128 subsets, and no levers; what it took is told to the budget."""
    asked = []
    kernel = SimpleNamespace(fit_subsets=lambda *_, **options: asked.append(options) or (False, 55))
    monkeypatch.setattr(exclusion.kernel, "of", lambda _: kernel if known else None)
    monkeypatch.setattr(exclusion, "_better_from", lambda _, __, best, ___: best)
    monkeypatch.setattr(exclusion, "_end", lambda *_: asked.append("ended"))
    constellation, thinned = SimpleNamespace(model=range(8), unfit=500.0), Thinned(levers)
    cost = np.random.default_rng(3).permutation(count).astype(float)
    cost[cost == 5.0] = np.nan
    left_out = np.arange(count)[:, None]
    found = exclusion._compared(constellation, thinned, fits_of(cost), nowhere(0), left_out)
    assert asked[0] == "ended" if not quick else (asked[0]["most_evaluations"], asked[0]["unfit_cost"]) == (1008, 500.0)
    assert len(asked) == 1
    assert thinned.told == ([(55, 8)] if quick else [])
    assert found.left_out[:5, 0].tolist() == [cost.tolist().index(i) for i in range(5)]
    assert np.isnan(found.fit.cost[-1])


@pytest.mark.parametrize(("cost", "hopeless"), [(499.9, False), (500.0, True), (500.1, True)])
def test_without_the_kernel_all_are_hopeless_that_cost_what_sound_fields_do_not(monkeypatch, cost, hopeless):
    asked = []
    monkeypatch.setattr(exclusion.kernel, "of", lambda _: None)
    monkeypatch.setattr(exclusion, "_better_from", lambda _, __, best, starts: asked.append(len(starts.cost)) or best)
    monkeypatch.setattr(exclusion, "_end", lambda *_: asked.append("ended"))
    constellation = SimpleNamespace(model=range(8), unfit=500.0)
    best = fits_of([900.0, cost, 800.0, np.nan])
    found = exclusion._compared(constellation, Thinned(), best, nowhere(8), np.arange(4)[:, None])
    assert found.hopeless == hopeless
    assert asked == [8, 4 * 3] + ([] if hopeless else ["ended"])  # The three best poses are starts for all.


def test_those_fits_are_ended_that_may_cost_as_little_as_the_best(monkeypatch):
    """The three best first; by what they then cost all others within 25 of them, once each."""
    cost = [40.0, 7.0, 8.0, 9.0, 34.9, 35.0, 35.1, np.inf, 20.0]
    ended = []

    def finish(_, __, fits, rows):
        ended.append(rows.tolist())
        fits.cost[rows] += 3.0

    monkeypatch.setattr(exclusion, "_finish", finish)
    exclusion._end(None, None, fits_of(cost))
    assert ended == [[1, 2, 3], [4, 8]]


@pytest.mark.parametrize("rows", [[], [2, 0]])
def test_fits_that_are_ended_replace_the_rough_ones(monkeypatch, rows):
    asked = []

    def fit_pose(model, some, position, rotation, *, iterations):
        asked.append((some, position[:, 0].tolist(), iterations))
        return fits_of(np.full(len(position), 1.0), position + 0.5)

    monkeypatch.setattr(exclusion, "fit_pose", fit_pose)
    fits = fits_of([10.0, 20.0, 30.0])
    measurements = SimpleNamespace(take=lambda which: which.tolist())
    exclusion._finish(SimpleNamespace(model=None), measurements, fits, np.array(rows, dtype=int))
    assert asked == ([([2, 0], [2.0, 0.0], 120)] if rows else [])
    assert fits.cost.tolist() == ([1.0, 20.0, 1.0] if rows else [10.0, 20.0, 30.0])


@pytest.mark.parametrize(
    ("best", "starts", "position"),
    [
        ([5.0, 5.0], [], [-1.0, -1.0]),
        ([5.0, 5.0], [4.0, 6.0], [4.0, -1.0]),
        ([5.0, 5.0], [5.0, np.nan], [-1.0, -1.0]),
        ([np.inf, np.nan], [9.0, 8.0], [9.0, 8.0]),
        ([np.inf, 5.0], [np.nan, np.nan, 9.0, 3.0, np.nan, 1.0], [9.0, 1.0]),
        ([5.0, 5.0], [8.0, 2.0, 3.0, 7.0, 6.0, 9.0], [2.0, -1.0]),
        ([np.inf, 5.0], [np.nan, np.nan, np.nan, np.nan], [-1.0, -1.0]),
    ],
)
def test_each_subset_takes_the_best_of_its_starts_if_that_costs_less(monkeypatch, best, starts, position):
    """A start costs what its place says, before and behind its fit; several are compared without a fit first."""
    asked = []

    def rough(_, measurements, position_m, rotation, iterations=15):
        asked.append((measurements, len(position_m), iterations))
        return Fit(
            position_m, rotation, position_m[:, 0].copy(), np.zeros((len(position_m), 6, 6)), position_m[:, 0] > 0
        )

    monkeypatch.setattr(exclusion, "_rough", rough)
    measurements = SimpleNamespace(take=lambda which: which.tolist())
    found = exclusion._better_from(
        None, measurements, fits_of(best, -1.0), fits_of(starts, np.array(starts).reshape(-1, 1))
    )
    assert found.position_m[:, 0].tolist() == position
    each = len(starts) // 2
    compared = [([*(each * [0]), *(each * [1])], 2 * each, 0)] if each > 1 else []
    assert asked == [*compared, *([(measurements, 2, 15)] if each else [])]

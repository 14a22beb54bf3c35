"""One budget of evaluations for all that an epoch's location does: what it takes, and what is said when it ends."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.field import FieldModel
from goldfield.locate import Locator, budget, kernel, sentences
from goldfield.locate.budget import Budget
from goldfield.locate.constellation import Constellation
from goldfield.locate.fit import Measurements
from goldfield.locate.integrity import explain
from goldfield.types import Status
from tests.bench import locate_trials as bench


@pytest.fixture
def counted(monkeypatch):
    """The fields of single coils that the kernel has evaluated in fits, starts and searches, as a list of numbers."""
    found = []
    for name in ("starts", "fit", "fit_subsets", "fit_distorted", "search"):
        whole = getattr(kernel.Kernel, name)

        def noting(self, *arguments, whole=whole, **options):
            result = whole(self, *arguments, **options)
            found.append(int(np.sum(result[-1])) * self._coils.count)
            return result

        monkeypatch.setattr(kernel.Kernel, name, noting)
    return found


def permuted(seed, count=6):
    """Epochs of a cube of eight coils whose fields have changed places: nothing explains them."""
    site, rng = bench.prigge_cube(2e-8), np.random.default_rng(seed)
    run = bench.trials(site, bench.cube_positions(rng, count), rng)
    return site, bench.fields_of(
        site, bench.Trials(run.position_m, run.rotation, run.field_T[:, [3, 0, 5, 1, 7, 2, 4, 6]], run.sigma_T)
    )


def test_all_that_is_done_for_an_epoch_counts(counted):
    site, epochs = permuted(1)
    constellation = Constellation(FieldModel(site.beacons))
    for fields in epochs:
        measurements = Measurements(fields.field_T[None], fields.sigma_T[None])
        solutions = constellation.solve(measurements)
        left = Budget(8)
        before = left.evaluations(1)
        counted.clear()
        explain(constellation, measurements.within(left), solutions, [b.id for b in site.beacons])
        assert before - left.evaluations(1) == sum(counted)
        assert sum(counted) > 15_000


def test_what_the_search_took_is_off_the_budget_of_the_explanation(monkeypatch):
    site, epochs = permuted(2, 1)
    told = []

    def noting(constellation, measurements, solutions, names):
        told.append((measurements.budget.evaluations(1), int(solutions.evaluations[0])))
        return explain(constellation, measurements, solutions, names)

    monkeypatch.setattr("goldfield.locate.locator.explain", noting)
    Locator(site).locate(epochs[0])
    ((left, took),) = told
    assert took > 0
    assert left == Budget(8).evaluations(1) - 8 * took


OVERRUN = 16_000
"""What may be spent after the budget has ended: the stages that are left evaluate each of their starts a few times."""


def test_an_epoch_takes_little_more_than_its_budget(counted, monkeypatch):
    site, epochs = permuted(2)
    locator = Locator(site)
    monkeypatch.setattr(budget, "LEAST_EVALUATIONS", 0)
    needed = []
    for most in (10_000, 15_000, budget.MOST_FIELDS):
        monkeypatch.setattr(budget, "MOST_FIELDS", most)
        for fields in epochs:
            counted.clear()
            pose = locator.locate(fields)
            assert sum(counted) < most + OVERRUN
            needed.append(sum(counted))
            assert pose.status is Status.INCONSISTENT
            assert (pose.reason == sentences.NOT_EXPLAINED) == (most < 20_000)
    assert max(needed) > 15_000 + OVERRUN


def test_what_was_found_when_the_budget_ended_is_not_believed(monkeypatch):
    site, rng = bench.prigge_cube(2e-8), np.random.default_rng(3)
    run = bench.trials(site, bench.cube_positions(rng, 5, 0.6), rng)
    epochs = bench.fields_of(site, bench.with_fault("dead", site, run, rng, 2))
    assert all(pose.excluded == ("b2",) for pose in Locator(site).locate_many(epochs))
    monkeypatch.setattr(budget, "LEAST_EVALUATIONS", 0)
    monkeypatch.setattr(budget, "MOST_FIELDS", 2_000)
    for pose in Locator(site).locate_many(epochs):
        gone_off = sentences.unheard(sentences.NOT_EXPLAINED)
        assert (pose.status, pose.reason) in (
            (Status.INCONSISTENT, sentences.NOT_EXPLAINED),
            (Status.FAILED, gone_off),
        )
        assert pose.excluded == ()


def test_a_large_site_may_always_be_searched_once():
    assert Budget(8).evaluations(8) == budget.MOST_FIELDS // 8
    assert Budget(48).evaluations(48) == budget.LEAST_EVALUATIONS
    spent = Budget(8)
    spent.spend(budget.MOST_FIELDS // 8 - 1, 8)
    assert not spent.spent
    spent.spend(1, 8)
    assert spent.spent
    assert spent.evaluations(8) == 0
    nearly = Budget(8)
    nearly.spend(budget.MOST_FIELDS - 1, 1)
    assert not nearly.spent

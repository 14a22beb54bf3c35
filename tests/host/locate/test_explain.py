"""In which order an epoch that raised the alarm is explained: what is asked when, and what decides it.

What explains an epoch is put in place by hand; what was asked is noted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from goldfield.field import FieldModel
from goldfield.locate import integrity, sentences
from goldfield.locate.budget import Budget
from goldfield.locate.constellation import Constellation
from goldfield.locate.exclusion import Subsets, without_one
from goldfield.locate.fit import Measurements
from goldfield.locate.sensor_rivals import SensorRival, SensorRivals
from goldfield.types import Explanation, Finding
from tests.bench import locate_trials as bench

NAMES = tuple(f"b{i}" for i in range(8))
MIRRORED = Finding(Explanation.MIRRORED, (), "mirrored")
OF_SENSOR = Finding(Explanation.STRENGTH, (), "all fields are stronger")
NEARLY = Finding(Explanation.UNITS, (), "nearly one factor")


class Epoch:
    """Eight coils, of which b3 is reversed, and what is found of them."""

    def __init__(self):
        site, rng = bench.prigge_cube(2e-8), np.random.default_rng(101)
        run = bench.trials(site, bench.cube_positions(rng, 1, 0.6), rng, sigma_T=0.0)
        self.constellation = Constellation(FieldModel(site.beacons))
        field = run.field_T.copy()
        field[:, 3] *= -1.0
        self.measurements = Measurements(field, np.full((1, 8), 2e-8 / np.sqrt(bench.CHIPS)))
        self.solutions = self.constellation.solve(self.measurements)
        self.ones = without_one(self.constellation, self.measurements, self.solutions.best)


@pytest.fixture(scope="module")
def found():
    epoch = Epoch()
    assert epoch.ones.left_out[0].tolist() == [3]
    return epoch


class Asked:
    """Stands in for whatever explains, and notes what it was asked with."""

    def __init__(self, monkeypatch, found, *, sure=False, mirrored=None, rivals=(), **verdicts):
        self.calls = []
        self.ones = replace(found.ones, hopeless=verdicts.get("hopeless", False))
        self.verdicts = list(verdicts.get("without", [None, None]))
        self.found, self.nearly = found, verdicts.get("nearly")
        answers = {
            "without_one": lambda _, __, poses: self.note("one", len(poses.cost), self.ones),
            "without_two": lambda *_: self.note("two", None, self.ones),
            "searched_without_one": lambda _, __, ones: self.note("searched", None, ones),
            "mirrored": lambda *_: self.note("mirrored", None, mirrored),
            "sensor_rivals": lambda _, __, known, **how: self.note(
                "rivals", (len(known.cost), how), SensorRivals(list(rivals))
            ),
            "nearly_one_factor": lambda *_: self.note("nearly", None, self.nearly),
            "_sure": lambda *_: self.note("sure", None, sure),
            "_without": lambda *_: self.note("without", None, self.verdicts.pop(0)),
        }
        for name, answer in answers.items():
            monkeypatch.setattr(integrity, name, answer)

    def note(self, name, told, answer):
        self.calls.append((name, told))
        return answer

    def explain(self, measurements=None, solutions=None):
        measurements = measurements or self.found.measurements
        return integrity.explain(self.found.constellation, measurements, solutions or self.found.solutions, NAMES)

    @property
    def names(self):
        return [name for name, _ in self.calls]


def rival(score=0.0):
    return SensorRival(OF_SENSOR, 0.0, score)


def test_without_an_explanation_all_are_asked_in_their_order(monkeypatch, found):
    asked = Asked(monkeypatch, found)
    verdict = asked.explain()
    assert asked.names == ["one", "sure", "mirrored", "rivals", "without", "two", "without", "nearly"]
    assert verdict.unknown
    assert verdict.reason == sentences.NOT_MENDED
    assert dict(asked.calls)["one"] == 1
    assert dict(asked.calls)["rivals"] == (3, {"anywhere": True})  # The pose, and those without the likeliest two.


def test_a_contested_pose_and_its_rival_are_both_starts(monkeypatch, found):
    asked = Asked(monkeypatch, found)
    asked.explain(solutions=replace(found.solutions, contested=np.array([True])))
    assert dict(asked.calls)["one"] == 2
    assert dict(asked.calls)["rivals"][0] == 4


@pytest.mark.parametrize(
    ("sure", "axes", "asks"), [(False, 3, True), (True, 3, False), (False, 2, False), (True, 2, False)]
)
def test_the_negated_fields_are_asked_of_three_axes_that_are_not_sure(monkeypatch, found, sure, axes, asks):
    field = found.measurements.field_T.copy()
    field[:, :, axes:] = np.nan
    asked = Asked(monkeypatch, found, sure=sure, mirrored=MIRRORED)
    verdict = asked.explain(Measurements(field, found.measurements.sigma_T))
    assert ("mirrored" in asked.names) == asks
    assert (verdict.findings == (MIRRORED,)) == asks
    if not asks:
        assert dict(asked.calls)["rivals"][1] == {"anywhere": not sure}


@pytest.mark.parametrize("hopeless", [False, True])
@pytest.mark.parametrize("explained", [False, True])
def test_all_of_space_is_searched_where_neither_a_subset_nor_the_sensor_fits(monkeypatch, found, hopeless, explained):
    asked = Asked(monkeypatch, found, hopeless=hopeless, rivals=[rival()] if explained else [])
    verdict = asked.explain()
    assert ("searched" in asked.names) == (hopeless and not explained)
    assert (verdict.findings == (OF_SENSOR,)) == explained


@pytest.mark.parametrize("by", [0, 1])
def test_what_leaving_out_explains_comes_first(monkeypatch, found, by):
    """One beacon before two, and either before what the sensor explains."""
    mended = integrity._inconsistent([NEARLY], "mended")
    asked = Asked(monkeypatch, found, without=by * [None] + [mended], rivals=[rival()])
    assert asked.explain() is mended
    assert ("two" in asked.names) == (by == 1)
    assert "nearly" not in asked.names


def test_behind_a_budget_that_is_spent_nothing_is_told(monkeypatch, found):
    for spent in (False, True):
        asked = Asked(monkeypatch, found, rivals=[rival()])
        budget = Budget(8)
        budget.spend(25_000 if spent else 24_999, 8)
        verdict = asked.explain(found.measurements.within(budget))
        assert budget.spent == spent
        assert verdict.unknown == spent
        assert verdict.reason == (sentences.NOT_EXPLAINED if spent else OF_SENSOR.text)


def test_one_factor_that_explains_most_is_told_at_last(monkeypatch, found):
    asked = Asked(monkeypatch, found, nearly=NEARLY)
    verdict = asked.explain()
    assert (verdict.findings, verdict.reason) == ((NEARLY,), NEARLY.text)


@pytest.mark.parametrize(("share", "likely"), [(0.995, True), (1.005, False)])
@pytest.mark.parametrize("alone", [True, False])
def test_what_is_sure_fits_without_the_likeliest_beacon_and_can_fit_no_other_pose(
    monkeypatch, found, share, likely, alone
):
    """Likelier than one in a hundred; what can fit no other pose are the fields without that beacon, at its pose."""
    asked = []

    def sure(measurements, fit):
        asked.append((measurements.measured[:, :, 0].tolist(), fit.position_m.tolist()))
        return np.array([alone])

    monkeypatch.setattr(found.constellation, "sure", sure)
    cost = np.full(8, 1e6)
    cost[0] = share * chi2.isf(0.01, 15)
    ones = replace(found.ones, fit=replace(found.ones.fit, cost=cost))
    assert integrity._sure(found.constellation, found.measurements, ones) == (likely and alone)
    if likely:
        assert asked == [([[i != 3 for i in range(8)]], [found.ones.fit.position_m[0].tolist()])]


def test_of_several_rivals_by_the_sensor_the_best_alone_is_alike(found):
    score = float(chi2.isf(1e-4 / 8, 3))
    cost = np.full(8, 1e6)
    cost[0] = 0.0
    ones = replace(found.ones, fit=replace(found.ones.fit, cost=cost))
    verdict = integrity._without(
        found.constellation, found.measurements, ones, [rival(score - 1.0), rival(score + 1.0)], NAMES
    )
    assert [finding.kind for finding in verdict.findings] == [Explanation.REVERSED, Explanation.STRENGTH]


@pytest.mark.parametrize("alarmed", [False, True])
def test_a_rest_that_raises_the_alarm_explains_nothing(monkeypatch, found, alarmed):
    monkeypatch.setattr(integrity, "alarm", lambda *_: np.array([alarmed]))
    verdict = integrity._without(found.constellation, found.measurements, found.ones, [], NAMES)
    assert (verdict is None) == alarmed


@pytest.mark.parametrize(
    ("pairs", "alike", "beacons"),
    [
        ([], [], {}),
        ([[3, 1]], [24.9], {1: 1}),
        ([[3, 1]], [25.1], {}),
        ([[3, 1], [2, 5], [1, 4], [4, 6]], [10.0, 11.0, 12.0, 26.0], {1: 1, 2: 2, 4: 3}),
        ([[3, 1], [5, 1], [3, 2], [2, 1], [6, 7]], 5 * [1.0], {1: 1, 2: 3, 6: 5, 7: 5}),
    ],
)
def test_beacons_without_which_the_rest_fits_about_as_well_are_told_once_each(found, pairs, alike, beacons):
    """With the first subset that lacks each of them; those that the best lacks, too, are none of them."""
    fit = found.ones.fit.take(np.zeros(1 + len(pairs), dtype=int))
    subsets = Subsets(np.array([[3, 5], *pairs]), replace(fit, cost=np.array([7.0, *(7.0 + np.array(alike))])), False)
    assert integrity._others_alike(subsets) == beacons

"""What is asked of the sensor and the whole site, from where, and what its answers are called.

What fits is put in place by hand but where the search itself is meant.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from goldfield.field import FieldModel
from goldfield.locate import sensor_rivals
from goldfield.locate.constellation import Constellation
from goldfield.locate.distorted import Distorted
from goldfield.locate.fit import Fit, Measurements
from goldfield.locate.sensor_rivals import UNITS, nearly_one_factor
from goldfield.types import Explanation
from tests.bench import locate_trials as bench

SIGMA_T = 2e-8 / np.sqrt(bench.CHIPS)


class Case:
    """One epoch of the cube without noise."""

    def __init__(self, heard=8, seed=105):
        rng = np.random.default_rng(seed)
        site = bench.prigge_cube(2e-8)
        self.constellation = Constellation(FieldModel(site.beacons))
        run = bench.trials(site, bench.cube_positions(rng, 1, 0.6), rng, sigma_T=0.0)
        self.position_m, self.rotation, self.field_T = run.position_m, run.rotation, run.field_T
        self.field_T[:, heard:] = np.nan

    def measurements(self, distortion=1.0):
        field = self.field_T * distortion if np.isscalar(distortion) else self.field_T @ distortion
        return Measurements(field, np.full((1, 8), SIGMA_T))


def poses(cost, offset=0.0):
    """Poses with these costs, told apart by where they are."""
    count = len(cost)
    places = offset + np.outer(np.arange(count), np.ones(3))
    turns = np.stack([np.eye(3)] * count)
    return Fit(places, turns, np.array(cost), np.stack([np.eye(6)] * count), np.ones(count, dtype=bool))


def fitted(distortion, cost, place=0.0):
    return Distorted(np.full((1, 3), place), np.eye(3)[None], np.array([cost]), distortion * np.eye(3)[None])


class Fits:
    """Stands in for the fits of distortions: notes each call, and answers by what is admitted."""

    def __init__(self, monkeypatch, *, factor, whole, axes=(1e9, 1e9, 1e9)):
        self.calls = []
        self._factor, self._whole, self._axes = factor, whole, axes
        monkeypatch.setattr(sensor_rivals, "fit_distorted", self)

    def __call__(self, model, measurements, position_m, rotation, *, basis, fixed=None, **how):
        self.calls.append((position_m[:, 0].tolist(), len(basis), None if fixed is None else basis[0] - fixed))
        if len(basis) == 6:
            return self._whole
        if fixed is None:
            return self._factor
        axis = int(np.argmax(np.diag(basis[0])))
        gain = np.ones(3)
        gain[axis] = 1.5
        return fitted(np.diag(gain), self._axes[axis])


def test_all_are_asked_from_the_first_four_poses_that_are_any(monkeypatch):
    case = Case()
    fits = Fits(monkeypatch, factor=fitted(1.3, 1.0), whole=fitted(np.diag([1.2, 1.0, 0.9]), 2.0, 7.0))
    given = poses([3.0, np.inf, 4.0, 5.0, 6.0, 7.0])
    found = sensor_rivals.sensor_rivals(case.constellation, case.measurements(), given, anywhere=False)
    assert found.factor is None
    assert [(place, count) for place, count, _ in fits.calls] == [
        ([0.0, 2.0, 3.0, 4.0], 1),
        ([0.0, 2.0, 3.0, 4.0], 6),
        *[([7.0], 1)] * 3,
    ]
    for axis, (*_, difference) in enumerate(fits.calls[2:]):
        np.testing.assert_array_equal(difference, np.diag(2.0 * np.eye(3)[axis] - 1.0))
    assert [rival.finding.kind for rival in found.explaining] == [Explanation.STRENGTH, Explanation.SENSOR]


def test_what_takes_least_off_by_chance_comes_first(monkeypatch):
    """By the costs the gain of y, then any distortion, then one factor; their unknowns are worth 1, 6 and 1."""
    case = Case()
    Fits(monkeypatch, factor=fitted(1.3, 15.0), whole=fitted(np.diag([1.2, 1.0, 0.9]), 2.0), axes=(30.0, 1.0, 1e9))
    found = sensor_rivals.sensor_rivals(case.constellation, case.measurements(), poses([1e3]), anywhere=False)
    worth = {1: chi2.isf(1e-4, 1), 6: chi2.isf(1e-4, 6), "axis": chi2.isf(1e-4 / 3, 1)}
    expected = sorted(
        [
            (15.0 + worth[1], Explanation.STRENGTH, 1.3),
            (2.0 + worth[6], Explanation.SENSOR, None),
            (30.0 + worth["axis"], Explanation.AXIS_GAIN, 1.5),
            (1.0 + worth["axis"], Explanation.AXIS_GAIN, 1.5),
        ],
        key=lambda each: each[0],
    )
    assert [rival.finding.kind for rival in found.explaining] == [kind for _, kind, _ in expected]
    assert [rival.score for rival in found.explaining] == pytest.approx([score for score, *_ in expected])
    assert [rival.finding.factor for rival in found.explaining] == [factor for *_, factor in expected]
    assert ["the sensor's y axis" in rival.finding.text for rival in found.explaining] == [True, False, False, False]


@pytest.mark.parametrize(("gains", "cost"), [((1.2, 1.0, 0.01), 2.0), ((1.2, 1.0, 0.9), 1e9)])
def test_no_axis_is_asked_where_no_distortion_explains_that_a_sensor_may_have(monkeypatch, gains, cost):
    case = Case()
    fits = Fits(monkeypatch, factor=fitted(1.3, 1.0), whole=fitted(np.diag(gains), cost), axes=(1.0, 1.0, 1.0))
    found = sensor_rivals.sensor_rivals(case.constellation, case.measurements(), poses([1e3]), anywhere=False)
    assert len(fits.calls) == 2
    assert [rival.finding.kind for rival in found.explaining] == [Explanation.STRENGTH]


@pytest.mark.parametrize(("heard", "asked"), [(3, 0), (4, 1), (5, 5)])
def test_one_factor_takes_four_beacons_and_any_distortion_five(monkeypatch, heard, asked):
    case = Case(heard)
    fits = Fits(monkeypatch, factor=fitted(1.3, 0.0), whole=fitted(np.diag([1.2, 1.0, 0.9]), 0.0))
    sensor_rivals.sensor_rivals(case.constellation, case.measurements(), poses([1e3]), anywhere=False)
    assert len(fits.calls) == asked


def test_a_beacon_that_is_known_in_part_leaves_nothing_to_ask(monkeypatch):
    case = Case()
    case.field_T[0, 5, 1] = np.nan
    fits = Fits(monkeypatch, factor=fitted(1.3, 0.0), whole=fitted(1.0, 0.0))
    found = sensor_rivals.sensor_rivals(case.constellation, case.measurements(), poses([1e3]))
    assert (found.explaining, found.factor, fits.calls) == ([], None, [])
    assert nearly_one_factor(case.constellation, case.measurements(), poses([1e3]), fitted(5.0, 0.0)) is None


def test_the_factor_from_anywhere_is_the_best_from_there_and_from_the_first_pose(monkeypatch):
    """Four starts from anywhere come first, then the poses: the fifth start is the first of those."""
    case = Case()
    starts = [Distorted(np.full((4, 3), 50.0), np.stack([np.eye(3)] * 4), np.zeros(4), np.zeros((4, 3, 3)))]
    costs = np.array([9.0, 8.0, 7.0, 6.0, 3.0, 1.0])
    places, turns = np.arange(6.0)[:, None] * np.ones(3), np.stack([np.eye(3)] * 6)
    factors = Distorted(places, turns, costs, 1.3 * turns)
    asked = []

    def fit(model, measurements, position_m, rotation, *, basis, model_error=0.0, **_):
        asked.append((len(position_m), len(basis)))
        if model_error:
            return starts[0]
        return factors if len(basis) == 1 else fitted(1.0, 1e9)

    monkeypatch.setattr(sensor_rivals, "fit_distorted", fit)
    found = sensor_rivals.sensor_rivals(case.constellation, case.measurements(), poses([3.0, 4.0]))
    assert asked == [(len(sensor_rivals.FACTORS), 1), (6, 1), (6, 6)]
    assert found.factor.cost.tolist() == [3.0]
    assert [rival.cost for rival in found.explaining] == [1.0]


@pytest.mark.parametrize("factor", [0.01, 1.0 / 0.3048**3, 1e4, 0.15])
@pytest.mark.parametrize("quick", [True, False])
def test_a_factor_is_found_from_anywhere(monkeypatch, factor, quick):
    """Though the only pose that is given is far from right, and with noise that belongs to the units."""
    if not quick:
        monkeypatch.setattr("goldfield.locate.kernel._library", lambda: None)
    case = Case()
    found = sensor_rivals.sensor_rivals(case.constellation, case.measurements(factor), poses([1e9], offset=3.0))
    assert found.factor.distortion[0, 0, 0] == pytest.approx(factor, rel=1e-4)
    np.testing.assert_allclose(found.factor.position_m, case.position_m, atol=1e-3)
    told = nearly_one_factor(case.constellation, case.measurements(factor), poses([1e9], offset=3.0), None)
    assert told.factor == pytest.approx(factor, rel=1e-4)


@pytest.mark.parametrize(
    ("factor", "cost", "told"),
    [
        (2.02, 1.98, True),
        (1.98, 1.98, False),
        (0.495, 1.98, True),
        (0.505, 1.98, False),
        (2.02, 2.02, False),
        (0.495, 2.02, False),
        (-3.0, 1.98, True),
    ],
)
def test_one_factor_that_is_far_from_one_and_leaves_a_fiftieth_is_told(factor, cost, told):
    case = Case()
    finding = nearly_one_factor(case.constellation, case.measurements(), poses([100.0]), fitted(factor, cost))
    assert (finding is not None) == told
    if told:
        kind = Explanation.STRENGTH if factor > 0.0 else Explanation.MIRRORED
        assert (finding.kind, finding.factor) == (kind, factor)
        assert finding.text.startswith("no pose fits the fields within noise_T, but nearly: ")


@pytest.mark.parametrize(("times", "told"), [(49.0, False), (51.0, True)])
def test_where_no_factor_is_known_one_factor_alone_is_sought(times, told):
    """Gains that differ along x and y, too, explain these fields whole."""
    case = Case()
    measurements = case.measurements(np.diag([3.9, 2.1, 3.0]))
    cost = sensor_rivals.sensor_rivals(case.constellation, measurements, poses([1e9], offset=3.0)).factor.cost[0]
    finding = nearly_one_factor(case.constellation, measurements, poses([times * cost], offset=3.0), None)
    assert (finding is not None) == told


@pytest.mark.parametrize(("heard", "told"), [(3, False), (4, True)])
def test_nearly_one_factor_takes_four_beacons(heard, told):
    case = Case(heard)
    finding = nearly_one_factor(case.constellation, case.measurements(), poses([100.0]), fitted(5.0, 0.0))
    assert (finding is not None) == told


def on_axis(radius, distance):
    return radius**2 / (radius**2 + distance**2) ** 1.5


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("radii_too", [True, False])
@pytest.mark.parametrize("taken_for_metres", [True, False])
def test_each_unit_has_its_factors(unit, radii_too, taken_for_metres):
    """By the field on the axis of a loop, whose lengths are not those that the file says."""
    real = UNITS[unit] if taken_for_metres else 1.0 / UNITS[unit]
    radius, distance = 1e-9, 1.0
    factor = on_axis(radius * real if radii_too else radius, distance * real) / on_axis(radius, distance)
    finding = sensor_rivals._factor(factor)
    assert finding.kind is Explanation.UNITS
    what = "positions and radii" if radii_too else "positions"
    said = f"{unit} taken for metres" if taken_for_metres else f"metres taken for {unit}"
    assert f"as if its {what} were {said}" in finding.text


@pytest.mark.parametrize(("off", "kind"), [(0.049, Explanation.UNITS), (0.051, Explanation.STRENGTH)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_factor_within_a_twentieth_of_gauss_is_gauss(off, kind, sign):
    finding = sensor_rivals._factor(1e4 * np.exp(sign * off))
    assert finding.kind is kind
    assert ("gauss" in finding.text) == (kind is Explanation.UNITS)


@pytest.mark.parametrize(
    ("gains", "unknowns", "tried", "kind"),
    [
        ((1.5, 1.0, 1.0), 1, 3, Explanation.AXIS_GAIN),
        ((0.2, 1.0, 1.0), 1, 3, Explanation.AXIS_GAIN),
        ((1.04, 1.0, 1.0), 1, 3, Explanation.AXIS_GAIN),
        ((1.5, 1.5, 1.5), 1, 1, Explanation.STRENGTH),
        ((-1.0, 1.0, 0.8), 6, 1, Explanation.MIRRORED),
        ((-1.0, -1.0, 0.8), 6, 1, Explanation.SENSOR),
        ((0.0, 1.0, 0.8), 6, 1, Explanation.SENSOR),
    ],
)
def test_what_a_distortion_is_called(gains, unknowns, tried, kind):
    finding = sensor_rivals._named(np.diag(gains), unknowns, tried)
    assert finding.kind is kind
    if kind is Explanation.AXIS_GAIN:
        assert finding.factor == gains[0]
        assert "the sensor's x axis" in finding.text
    if kind is Explanation.SENSOR:
        told = ", ".join(f"{gain:.3g}" for gain in sorted(gains))
        assert f"gains {told} along" in finding.text


@pytest.mark.parametrize(("heard", "freedom"), [(5, 3), (4, 0)])
def test_a_fit_with_no_degree_of_freedom_left_explains_anything(heard, freedom):
    case = Case(heard)
    for cost in (0.99, 1.01):
        limit = chi2.isf(1e-5, freedom) if freedom else 1e3
        rival = sensor_rivals._rival(case.measurements(), fitted(1.3, cost * limit), 6, 1)
        assert (rival is not None) == (cost < 1.0 or freedom == 0)

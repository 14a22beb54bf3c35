"""Both sides of what decides among explanations: which count, which are alike, how a beacon's fault is named.

States are made by hand where no fields lead near a figure.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, norm

from goldfield.field import FieldModel
from goldfield.locate import Locator, integrity, sensor_rivals
from goldfield.locate.beacon_faults import beacon_finding
from goldfield.locate.constellation import Constellation
from goldfield.locate.distorted import Distorted
from goldfield.locate.exclusion import Subsets, without_one
from goldfield.locate.fit import Measurements, fit_pose
from goldfield.locate.protection import level_of
from goldfield.locate.sensor_rivals import SensorRival
from goldfield.locate.solutions import unsolved
from goldfield.types import Explanation, Fields, Finding, Status
from tests.bench import locate_trials as bench

SIGMA_T = 2e-8 / np.sqrt(bench.CHIPS)
NAMES = tuple(f"b{i}" for i in range(8))
OF_SENSOR = Finding(Explanation.STRENGTH, (), "all fields are stronger")


class Case:
    """One epoch of the cube, without noise: its model, pose and fields, shape (8, 3)."""

    def __init__(self, seed, keep=range(8)):
        rng = np.random.default_rng(seed)
        self.site = bench.prigge_cube(2e-8, keep)
        self.model = FieldModel(self.site.beacons)
        self.constellation = Constellation(self.model)
        run = bench.trials(self.site, bench.cube_positions(rng, 1, 0.6), rng, sigma_T=0.0)
        self.position_m, self.rotation, self.field_T = run.position_m, run.rotation, run.field_T[0]

    def measurements(self, field_T=None):
        field = self.field_T if field_T is None else field_T
        return Measurements(field[None], np.full((1, len(field)), SIGMA_T))

    def fit(self, measurements):
        return fit_pose(self.model, measurements, self.position_m, self.rotation)


@pytest.fixture(scope="module")
def reversed3():
    """(case, measurements, subsets without one) of an epoch whose beacon b3 is reversed."""
    case = Case(101)
    field = case.field_T.copy()
    field[3] *= -1.0
    measurements = case.measurements(field)
    ones = without_one(case.constellation, measurements, case.constellation.solve(measurements).best)
    assert ones.left_out[0].tolist() == [3]
    return case, measurements, ones


def judged(reversed3, costs=(), of_sensor=None, rest=0.0):
    """The verdict if rest and the subsets after the best cost so much, and a rival by the sensor scores so much.

    A rival's score is given relative to that of the best subset.
    """
    case, measurements, ones = reversed3
    cost = np.full(8, 1e6)
    cost[0] = rest
    cost[1 : 1 + len(costs)] = costs
    subsets = replace(ones, fit=replace(ones.fit, cost=cost))
    score = float(chi2.isf(1e-4 / 8, 3))
    rivals = [] if of_sensor is None else [SensorRival(OF_SENSOR, 0.0, score + of_sensor)]
    return integrity._without(case.constellation, measurements, subsets, rivals, NAMES)


@pytest.mark.parametrize(("share", "sound"), [(0.995, True), (1.005, False)])
def test_the_rest_must_be_likelier_than_one_in_a_hundred(reversed3, share, sound):
    assert (judged(reversed3, rest=share * chi2.isf(0.01, 15)) is not None) == sound


@pytest.mark.parametrize(
    ("of_sensor", "kinds", "left_out"),
    [
        (-25.1, None, []),
        (-24.9, [Explanation.REVERSED, Explanation.STRENGTH], []),
        (24.9, [Explanation.REVERSED, Explanation.STRENGTH], []),
        (25.1, [Explanation.REVERSED], [3]),
    ],
)
def test_a_rival_by_the_sensor_within_twenty_five_is_alike(reversed3, of_sensor, kinds, left_out):
    verdict = judged(reversed3, of_sensor=of_sensor)
    assert (verdict is None) == (kinds is None)
    if verdict is not None:
        assert [finding.kind for finding in verdict.findings] == kinds
        assert verdict.left_out.tolist() == left_out


@pytest.mark.parametrize(("cost", "count"), [(24.9, 2), (25.1, 1)])
def test_another_subset_within_twenty_five_is_alike(reversed3, cost, count):
    verdict = judged(reversed3, [cost])
    assert len(verdict.findings) == count
    assert (verdict.rest is None) == (count == 2)


@pytest.mark.parametrize(("alike", "unknown"), [(2, False), (3, True)])
def test_of_more_than_two_that_are_alike_none_is_told(reversed3, alike, unknown):
    verdict = judged(reversed3, [10.0] * alike)
    assert verdict.unknown == unknown
    assert len(verdict.findings) == (1 if unknown else 3)


@pytest.mark.parametrize(("of_sensor", "told"), [(-0.1, False), (0.1, True)])
def test_of_many_that_are_alike_the_sensor_has_its_turn_if_it_is_likelier(reversed3, of_sensor, told):
    verdict = judged(reversed3, [10.0, 10.0], of_sensor)
    assert (verdict is not None) == told
    assert verdict is None or verdict.unknown


@pytest.mark.parametrize(("better", "put"), [(0.9, False), (1.1, True)])
def test_the_pose_of_exclusion_is_put_where_it_costs_one_less(reversed3, better, put):
    *_, ones = reversed3
    solutions = unsolved(ones.fit.take(np.array([1])))
    fit = ones.fit.take(np.array([0]))
    fit.cost[0] = solutions.best.cost[0] - better
    found = integrity._at_least(solutions, fit).best
    assert (found.cost[0] == fit.cost[0]) == put


@pytest.mark.parametrize(("beacons", "told"), [(8, False), (9, True)])
def test_the_rest_needs_three_degrees_of_freedom(beacons, told):
    """A sensor with one axis has five unknowns: seven others leave two, eight leave three."""
    rng = np.random.default_rng(102)
    corners = [(x, y, z) for z in (0.0, 1.0, 2.0) for x in (0.0, 2.0) for y in (0.0, 2.0)]
    site = bench.site_of([bench.loop_beacon(i, corners[i]) for i in range(beacons)], noise_T=2e-8)
    constellation = Constellation(FieldModel(site.beacons))
    run = bench.trials(site, np.array([[0.8, 1.1, 0.7]]), rng, sigma_T=0.0)
    field = run.field_T.copy()
    field[0, 3] *= -1.0
    field[:, :, 1:] = np.nan
    measurements = Measurements(field, np.full((1, beacons), SIGMA_T))
    kept = np.delete(np.arange(beacons), 3)
    fit = fit_pose(constellation.subset(kept).model, measurements.of_beacons(kept), run.position_m, run.rotation)
    subsets = Subsets(np.array([[3]]), fit, False)
    assert measurements.of_beacons(kept).freedom[0] == (3 if told else 2)
    verdict = integrity._without(constellation, measurements, subsets, [], site_names(site))
    assert (verdict is not None) == told


def site_names(site):
    return tuple(beacon.id for beacon in site.beacons)


@pytest.mark.parametrize(("margin", "kind"), [(24.9, Explanation.UNKNOWN), (25.1, Explanation.STRENGTH)])
def test_with_four_beacons_a_rival_by_the_sensor_must_be_twenty_five_better(monkeypatch, margin, kind):
    case = Case(103, keep=[0, 3, 5, 6])
    measurements = case.measurements()
    solutions = unsolved(case.fit(measurements))
    solutions.best.cost[0] = 100.0
    rival = SensorRival(OF_SENSOR, 0.0, 100.0 - margin)
    monkeypatch.setattr(integrity, "sensor_rivals", lambda *_: sensor_rivals.SensorRivals([rival]))
    verdict = integrity._few(case.constellation, measurements, solutions, 4)
    assert [finding.kind for finding in verdict.findings] == [kind]


@pytest.mark.parametrize(
    ("keep", "kinds"),
    [
        ([0, 3, 5], set()),
        ([0, 3, 5, 6], {Explanation.STRENGTH}),
        ([0, 3, 5, 6, 1], {Explanation.STRENGTH, Explanation.SENSOR, Explanation.AXIS_GAIN}),
    ],
)
def test_one_factor_takes_four_beacons_and_any_distortion_five(keep, kinds):
    case = Case(104, keep)
    measurements = case.measurements(1.3 * case.field_T)
    rivals = sensor_rivals.sensor_rivals(case.constellation, measurements, case.fit(measurements)).explaining
    found = {rival.finding.kind for rival in rivals}
    assert bool(found) == bool(kinds)
    assert found <= kinds
    assert (len(found - {Explanation.STRENGTH}) > 0) == (len(keep) == 5)


@pytest.mark.parametrize(("unknowns", "tried"), [(1, 1), (6, 1), (1, 3)])
@pytest.mark.parametrize(("share", "explains"), [(0.999, True), (1.001, False)])
def test_a_rival_explains_what_is_likelier_than_one_in_a_hundred_thousand(unknowns, tried, share, explains):
    case = Case(105)
    cost = share * chi2.isf(1e-5, 18 - unknowns)
    fitted = Distorted(case.position_m, case.rotation, np.array([cost]), 1.3 * np.eye(3)[None])
    rival = sensor_rivals._rival(case.measurements(), fitted, unknowns, tried)
    assert (rival is not None) == explains
    if rival is not None:
        assert rival.score - rival.cost == pytest.approx(chi2.isf(1e-4 / tried, unknowns))


@pytest.mark.parametrize(
    ("gain", "silent", "plausible"), [(9.9, 5.0, True), (10.1, 5.0, False), (10.1, 3.9, True), (10.1, 4.1, False)]
)
def test_gains_in_a_ratio_of_ten_are_a_sensors_and_more_if_an_axis_is_silent(gain, silent, plausible):
    """An axis is silent if its root mean square is below four standard deviations."""
    case = Case(106)
    field = np.full((8, 3), 100.0 * SIGMA_T)
    field[:, 2] = silent * SIGMA_T
    fitted = Distorted(case.position_m, case.rotation, np.zeros(1), np.diag([1.0, 1.0, 1.0 / gain])[None])
    assert sensor_rivals._plausible(case.measurements(field), fitted) == plausible


@pytest.mark.parametrize("factor", [0.0254, 1.0 / 0.3048, 0.01**3])
@pytest.mark.parametrize(("off", "kind"), [(0.0095, Explanation.UNITS), (0.0105, Explanation.STRENGTH)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_factor_within_a_hundredth_of_a_units_is_that_unit(factor, off, kind, sign):
    assert sensor_rivals._factor(factor * np.exp(sign * off)).kind is kind


def test_a_factor_below_nothing_is_mirrored():
    assert sensor_rivals._factor(-1e-3).kind is Explanation.MIRRORED
    assert sensor_rivals._factor(1e-3 * 1.5).kind is Explanation.STRENGTH


def named(case, value):
    """What is told of b3 if its field is ``value``, and the pose is known well beyond the noise."""
    field = case.field_T.copy()
    field[3] = value
    measurements = case.measurements(field)
    fit = case.fit(case.measurements())
    exact = replace(fit, information=1e8 * fit.information)
    return beacon_finding(case.model, measurements, exact, 3, "b3")


@pytest.mark.parametrize(("share", "admitted"), [(0.995, True), (1.005, False)])
@pytest.mark.parametrize(
    ("factor", "kind", "freedom"),
    [(0.0, Explanation.DEAD, 3), (-1.0, Explanation.REVERSED, 3), (1.5, Explanation.CURRENT, 2)],
)
def test_a_fault_of_a_beacon_is_named_if_its_misfit_is_likelier_than_one_in_a_thousand(
    factor, kind, freedom, share, admitted
):
    case = Case(107)
    across = np.cross(case.field_T[3], [0.3, -0.7, 0.5])
    misfit = across / np.linalg.norm(across) * SIGMA_T * np.sqrt(share * chi2.isf(1e-3, freedom))
    finding, residual = named(case, factor * case.field_T[3] + misfit)
    assert (finding.kind is kind) == admitted
    size = ((((factor - 1.0) * case.field_T[3] + misfit) / SIGMA_T) ** 2).sum()
    assert residual == pytest.approx(np.sqrt(size / 3), rel=1e-3)


def test_a_new_place_is_told_if_it_is_known_to_a_fifth_of_the_way():
    """The poses are ever worse. What the pose's error does to the place is by differences of the search itself."""
    case = Case(108)
    moved = list(case.site.beacons)
    moved[3] = replace(moved[3], position_m=moved[3].position_m + np.array([0.15, -0.1, 0.2]))
    field = case.field_T.copy()
    field[3] = bench.magpylib_fields(bench.site_of(moved), case.position_m)[0, 3] @ case.rotation[0]
    measurements, fit = case.measurements(field), case.fit(case.measurements())

    def told(doubt, start=fit):
        worse = replace(start, information=start.information / doubt**2)
        return beacon_finding(case.model, measurements, worse, 3, "b3")[0]

    low, high = 1.0, 1e6
    assert told(low).kind is Explanation.MOVED
    assert told(high).kind is not Explanation.MOVED
    for _ in range(30):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if told(middle).kind is Explanation.MOVED else (low, middle)
    place = told(low).position_m
    assert np.linalg.norm(place - moved[3].position_m) < 1e-3
    slope = []
    for step in np.eye(6) * 1e-5:
        ends = []
        for sign in (1.0, -1.0):
            shift, turn = sign * step[:3], sign * step[3:]
            cross = np.array([[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]])
            start = replace(fit, position_m=fit.position_m + shift, rotation=(np.eye(3) + cross) @ fit.rotation)
            ends.append(told(1e-3, start).position_m)
        slope.append((ends[0] - ends[1]) / 2e-5)
    covariance = np.array(slope).T @ np.linalg.inv(fit.information[0]) @ np.array(slope) * low**2
    way = np.linalg.norm(place - case.site.beacons[3].position_m)
    assert np.sqrt(np.linalg.eigvalsh(covariance)[-1]) == pytest.approx(0.2 * way, rel=0.02)


@pytest.mark.parametrize(("row", "direction"), [(0, 2), (0, 3), (1, 4), (2, 3)])
@pytest.mark.parametrize(("share", "found"), [(0.999, True), (1.001, False)])
def test_a_new_place_is_told_if_it_is_no_further_than_the_sensor(row, direction, share, found):
    """Beyond that its mirror image at the coil makes the same field of a dipole."""
    case = Case(108)
    way = np.random.default_rng(row).normal(size=(direction + 1, 3))[direction]
    way *= share * np.linalg.norm(case.position_m[0] - case.model.centre_m[row]) / np.linalg.norm(way)
    moved = list(case.site.beacons)
    moved[row] = replace(moved[row], position_m=moved[row].position_m + way)
    field = case.field_T.copy()
    field[row] = bench.magpylib_fields(bench.site_of(moved), case.position_m)[0, row] @ case.rotation[0]
    finding = beacon_finding(case.model, case.measurements(field), case.fit(case.measurements()), row, "b")[0]
    assert (finding.kind is Explanation.MOVED) == found
    if found:
        np.testing.assert_allclose(finding.position_m, moved[row].position_m, atol=1e-3)


@pytest.mark.parametrize(("without", "risk"), [(0.0, 1e-7), (8.0, 1e-3)])
def test_the_level_is_the_greater_of_noise_and_of_a_fault_that_is_missed(without, risk):
    """Isotropic errors are chi-square with three degrees of freedom, here as Wilson and Hilferty have it."""
    quantile = 3.0 * (1.0 - 2.0 / 27.0 + norm.isf(risk) * np.sqrt(2.0 / 27.0)) ** 3
    level, beacon = level_of(
        np.zeros((1, 1, 3)), without * np.eye(3)[None, None], np.zeros((1, 1), dtype=bool), np.eye(3)[None]
    )
    assert level[0] == pytest.approx(np.sqrt((1.0 + without) * quantile), rel=1e-9)
    assert beacon[0] == 0


@pytest.mark.parametrize(("heard", "failed"), [(2, True), (3, False)])
def test_three_beacons_are_located_from(heard, failed):
    case = Case(109)
    field = case.field_T.copy()
    field[heard:] = np.nan
    pose = Locator(case.site).locate(Fields(0, 0.0, NAMES, field, np.full(8, SIGMA_T)))
    assert (pose.status is Status.FAILED) == failed

"""Both sides of what decides: each limit of the alarm, and each figure by which an explanation is taken or not.

The epochs have no noise. Their residuals are put where the fit cannot take them away, so that the cost is known.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from goldfield.field import FieldModel
from goldfield.locate import Locator
from goldfield.locate.constellation import Constellation
from goldfield.locate.exclusion import without_one
from goldfield.locate.fault_statistics import FaultStatistics, alarm
from goldfield.locate.fit import Measurements, fit_pose
from goldfield.locate.sensor_rivals import mirrored
from goldfield.types import Explanation, Fields, Status
from tests.bench import locate_trials as bench

FALSE_ALARM = 7e-4
SIGMA_T = 2e-8 / np.sqrt(bench.CHIPS)
BEACONS = 8


def fields_of(site, field):
    return Fields(0, 0.0, tuple(b.id for b in site.beacons), field, np.full(len(field), SIGMA_T))


def epoch(rng, sound=range(BEACONS), share=1.0):
    """An epoch of the cube with a residual of the `sound` beacons alone whose cost is this share of chi-square one.

    The Jacobian is by differences of magpylib's fields; the residual is the part of a random one that no pose explains.
    """
    site = bench.prigge_cube(2e-8)
    run = bench.trials(site, bench.cube_positions(rng, 1, 0.6), rng, sigma_T=0.0)
    rows = list(sound)

    def components(shift, turn):
        angle = np.linalg.norm(turn)
        cross = np.array([[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]])
        small = np.eye(3) + cross + cross @ cross / 2 if angle else np.eye(3)
        return (bench.magpylib_fields(site, run.position_m + shift)[0, rows] @ (small @ run.rotation[0])).ravel()

    steps = np.vstack([np.eye(6) * 1e-5, -np.eye(6) * 1e-5])
    moved = np.array([components(step[:3], step[3:]) for step in steps])
    jacobian = (moved[:6] - moved[6:]) / 2e-5
    free = np.linalg.svd(jacobian.T, full_matrices=True)[0][:, 6:]
    residual = free @ rng.normal(size=free.shape[1])
    residual *= np.sqrt(share) * SIGMA_T / np.linalg.norm(residual)
    field = run.field_T[0].copy()
    field[rows] += residual.reshape(-1, 3)
    return site, field


def silent_statistics():
    """Statistics of one epoch in which nothing shows."""
    shape = (1, BEACONS)
    return FaultStatistics(
        np.zeros(shape),
        np.full(shape, 3),
        np.zeros(shape),
        np.zeros((*shape, 3)),
        np.zeros((*shape, 3, 3)),
        np.zeros((1, 4)),
        np.array([[1, 3, 6, 1]]),
    )


@pytest.mark.parametrize(
    ("test", "limit"),
    [
        ("whole", chi2.isf(0.1 * FALSE_ALARM, 18)),
        ("beacon", chi2.isf(0.3 * FALSE_ALARM / BEACONS, 3)),
        ("strength", chi2.isf(0.2 * FALSE_ALARM / BEACONS, 1)),
        ("gain", chi2.isf(0.2 * FALSE_ALARM, 1)),
        ("gains", chi2.isf(0.1 * FALSE_ALARM, 3)),
        ("distortion", chi2.isf(0.1 * FALSE_ALARM, 6)),
        ("axis", chi2.isf(0.3 * FALSE_ALARM / 3, 1)),
    ],
)
@pytest.mark.parametrize(("share", "alarmed"), [(0.999, False), (1.001, True)])
def test_each_test_of_the_alarm(test, limit, share, alarmed):
    measurements = Measurements(np.ones((1, BEACONS, 3)), np.ones((1, BEACONS)))
    statistics, cost, value = silent_statistics(), np.zeros(1), share * limit
    if test == "whole":
        cost[0] = value
    elif test == "beacon":
        statistics.drop[0, 4] = value
    elif test == "strength":
        statistics.scale[0, 4] = value
    else:
        statistics.distortion[0, ["gain", "gains", "distortion", "axis"].index(test)] = value
    assert alarm(measurements, cost, statistics).tolist() == [alarmed]


def heard_alone(heard):
    """Measurements of which the first beacons alone were heard."""
    field = np.full((1, BEACONS, 3), np.nan)
    field[:, :heard] = 1.0
    return Measurements(field, np.ones((1, BEACONS)))


@pytest.mark.parametrize(("heard", "alarmed"), [(1, False), (2, False), (3, True)])
def test_a_cost_without_a_degree_of_freedom_says_nothing(heard, alarmed):
    assert alarm(heard_alone(heard), np.array([1e9]), silent_statistics()).tolist() == [alarmed]


@pytest.mark.parametrize("heard", [1, 4, 8])
@pytest.mark.parametrize("freedom", [0, 1, 2, 3])
@pytest.mark.parametrize(("share", "alarmed"), [(0.999, False), (1.001, True)])
def test_the_limit_of_a_beacon_is_by_what_was_heard_and_can_show(heard, freedom, share, alarmed):
    statistics = silent_statistics()
    statistics.freedom[:] = freedom
    statistics.drop[0, 0] = share * chi2.isf(0.3 * FALSE_ALARM / heard, max(freedom, 1))
    assert alarm(heard_alone(heard), np.zeros(1), statistics).tolist() == [alarmed and freedom > 0]


@pytest.mark.parametrize("heard", [1, 4, 8])
@pytest.mark.parametrize(("share", "alarmed"), [(0.999, False), (1.001, True)])
def test_the_limit_of_a_strength_is_by_what_was_heard(heard, share, alarmed):
    statistics = silent_statistics()
    statistics.scale[0, heard - 1] = share * chi2.isf(0.2 * FALSE_ALARM / heard, 1)
    assert alarm(heard_alone(heard), np.zeros(1), statistics).tolist() == [alarmed]


@pytest.mark.parametrize("test", range(4))
@pytest.mark.parametrize("freedom", range(7))
@pytest.mark.parametrize(("share", "alarmed"), [(0.999, False), (1.001, True)])
def test_the_limit_of_a_distortion_is_by_what_can_show(test, freedom, share, alarmed):
    rate = (0.2, 0.1, 0.1, 0.3 / 3)[test]
    statistics = silent_statistics()
    statistics.distortion_freedom[:] = 0
    statistics.distortion_freedom[0, test] = freedom
    statistics.distortion[0, test] = share * chi2.isf(rate * FALSE_ALARM, max(freedom, 1))
    assert alarm(heard_alone(8), np.zeros(1), statistics).tolist() == [alarmed and freedom > 0]


def test_a_residual_is_the_root_of_what_is_left_out_by_its_degrees_of_freedom():
    statistics = silent_statistics()
    statistics.drop[0, :4], statistics.freedom[0, :4] = [12.0, 8.0, 4.0, 4.0], [3, 2, 1, 0]
    np.testing.assert_allclose(statistics.normalised(), [[2.0, 2.0, 2.0, np.nan, 0.0, 0.0, 0.0, 0.0]])


@pytest.mark.parametrize(("share", "named"), [(0.998, True), (1.002, False)])
@pytest.mark.parametrize("seed", [81, 82, 83])
def test_negated_fields_explain_what_is_likelier_than_one_in_a_hundred_thousand(seed, share, named):
    site, field = epoch(np.random.default_rng(seed), share=share * chi2.isf(1e-5, 18))
    measurements = Measurements(-field[None], np.full((1, BEACONS), SIGMA_T))
    finding = mirrored(Constellation(FieldModel(site.beacons)), measurements, cost=np.inf, margin=25.0)
    assert (finding is not None and finding.kind is Explanation.MIRRORED) == named


@pytest.mark.parametrize(("cost", "named"), [(44.9, False), (45.1, True)])
def test_negated_fields_must_be_twenty_five_better_than_the_fields_as_they_are(cost, named):
    site, field = epoch(np.random.default_rng(91), share=20.0)
    measurements = Measurements(-field[None], np.full((1, BEACONS), SIGMA_T))
    finding = mirrored(Constellation(FieldModel(site.beacons)), measurements, cost=cost, margin=25.0)
    assert (finding is not None) == named


@pytest.mark.parametrize(("share", "status"), [(0.95, Status.OK), (1.05, Status.INCONSISTENT)])
@pytest.mark.parametrize("seed", [84, 85, 86])
def test_the_rest_without_a_beacon_must_be_likelier_than_one_in_a_hundred(seed, share, status):
    sound = [0, 1, 2, 4, 5, 6, 7]
    site, field = epoch(np.random.default_rng(seed), sound, share * chi2.isf(0.01, 15))
    field[3] *= -1.0
    pose = Locator(site).locate(fields_of(site, field))
    assert pose.status is status
    assert pose.excluded == (("b3",) if status is Status.OK else ())


@pytest.mark.parametrize("seed", [89, 96])
def test_a_beacon_is_left_out_as_soon_as_the_next_subset_costs_twenty_five_more(seed):
    """A beacon ever weaker, by bisection; in these epochs no distortion of the sensor fits better than a subset."""
    site, field = epoch(np.random.default_rng(seed), share=0.0)
    locator, constellation = Locator(site), Constellation(FieldModel(site.beacons))

    def judged(weaker):
        faulty = field.copy()
        faulty[3] *= 1.0 - weaker
        measurements = Measurements(faulty[None], np.full((1, BEACONS), SIGMA_T))
        ones = without_one(constellation, measurements, constellation.solve(measurements).best)
        return locator.locate(fields_of(site, faulty)).excluded, ones.fit.cost[1] - ones.fit.cost[0]

    kept, left_out = 0.005, 0.5
    assert judged(kept)[0] == ()
    assert judged(left_out)[0] == ("b3",)
    for _ in range(14):
        middle = np.sqrt(kept * left_out)
        if judged(middle)[0]:
            left_out = middle
        else:
            kept = middle
    assert judged(kept)[1] == pytest.approx(25.0, abs=0.2)
    assert judged(left_out)[1] == pytest.approx(25.0, abs=0.2)


def test_the_residual_of_an_epoch_is_what_it_was_made_with():
    """Guards the generator: the fit finds the cost that was put in."""
    site, field = epoch(np.random.default_rng(90), share=33.0)
    measurements = Measurements(field[None], np.full((1, BEACONS), SIGMA_T))
    start = Locator(site).locate(fields_of(site, field))
    best = Constellation(FieldModel(site.beacons)).solve(measurements).best
    again = fit_pose(FieldModel(site.beacons), measurements, best.position_m, best.rotation)
    assert again.cost[0] == pytest.approx(33.0, rel=0.01)
    assert start.residual == pytest.approx(np.sqrt(33.0 / 18), rel=0.01)

"""What the locator makes of epochs: which are solved together, of which measurements, and whose verdict becomes what.

Where a step is looked at alone, those around it are put in its place by hand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from goldfield.locate import Locator, locator, sentences
from goldfield.locate.constellation import Constellation
from goldfield.locate.fault_statistics import fault_statistics
from goldfield.locate.integrity import Verdict
from goldfield.locate.solutions import nowhere, unsolved
from goldfield.site import SensorSite
from goldfield.site.metal import BeaconMetal, Metal
from goldfield.types import LEAST_SIGMA_T, Explanation, Fields, Finding, Status
from tests.bench import locate_trials as bench
from tests.host.locate import built_sites as built
from tests.host.locate.steps import SIGMA_T

NAMES = tuple(f"b{i}" for i in range(8))
UNKNOWN = Finding(Explanation.UNKNOWN, (), "nothing explains it")
DEAD = Finding(Explanation.DEAD, ("b5",), "b5 has no field")


@pytest.fixture(scope="module")
def run(site):
    rng = np.random.default_rng(61)
    return bench.trials(site, bench.cube_positions(rng, 6, 0.6), rng, sigma_T=SIGMA_T)


@pytest.fixture
def solved(monkeypatch):
    """What is given to be solved, as pairs of a model and measurements; no pose is found of any."""
    given = []

    def solve(self, measurements):
        given.append((self.model, measurements))
        return unsolved(nowhere(len(measurements)))

    monkeypatch.setattr(Constellation, "solve", solve)
    return given


def epoch(field, names=NAMES, sigma=SIGMA_T, number=0):
    return Fields(number, 0.1 * number, names, field, np.full(len(names), sigma))


def test_epochs_that_heard_the_same_beacons_are_solved_together_in_the_order_of_the_site(site, run, solved):
    """Beacons in any order, with a stranger among them, and with what is no measurement, which is as good as none."""
    field, seven = run.field_T, [0, 1, 2, 3, 4, 6, 7]
    gone, mute = field[3].copy(), np.full(8, SIGMA_T)
    gone[5], mute[5] = np.nan, 0.0
    spoiled = field[4].copy()
    spoiled[5, 1] = np.inf
    backward = np.insert(field[2, ::-1], 3, 1.0, axis=0)
    epochs = [
        epoch(field[0]),
        epoch(field[1][seven], tuple(NAMES[i] for i in seven)),
        epoch(backward, (*NAMES[:4:-1], "stranger", *NAMES[4::-1])),
        epoch(gone),
        epoch(spoiled),
        Fields(5, 0.5, NAMES, field[5], mute),
        epoch(field[0][:2], NAMES[:2]),
    ]
    poses = Locator(site).locate_many(epochs)
    (of_eight, eight), (of_seven, others) = solved
    np.testing.assert_array_equal(eight.field_T[:2], field[[0, 2]])
    np.testing.assert_array_equal(eight.field_T[2], np.where(np.isinf(spoiled), np.nan, spoiled))
    np.testing.assert_array_equal(others.field_T, field[[1, 3, 5]][:, seven])
    for measured, model, kept in ((eight, of_eight, range(8)), (others, of_seven, seven)):
        assert (measured.sigma_T == SIGMA_T).all()
        assert measured.errors is None
        np.testing.assert_array_equal(model.centre_m, [site.beacons[i].position_m for i in kept])
    used = [NAMES, tuple(NAMES[i] for i in seven)]
    assert [pose.used for pose in poses] == [used[i] for i in (0, 1, 0, 1, 0, 1)] + [NAMES[:2]]
    assert [pose.reason for pose in poses] == [sentences.NO_FIT] * 6 + [sentences.few_heard(2, 3)]
    assert {pose.status for pose in poses} == {Status.FAILED}


def test_three_beacons_are_enough_to_be_solved(site, run, solved):
    poses = Locator(site).locate_many([epoch(run.field_T[0][:3], NAMES[:3]), epoch(run.field_T[0][:2], NAMES[:2])])
    assert [measured.field_T.shape for _, measured in solved] == [(1, 3, 3)]
    assert [pose.reason for pose in poses] == [sentences.NO_FIT, sentences.few_heard(2, 3)]


def test_no_sensor_has_less_noise_than_numbers_can_carry(site, run, solved):
    Locator(site).locate_many([epoch(run.field_T[0], sigma=sigma) for sigma in (1e-30, LEAST_SIGMA_T, 2e-15)])
    np.testing.assert_array_equal(solved[0][1].sigma_T[:, 0], [1e-15, 1e-15, 2e-15])


def test_axes_are_undone_and_metal_adds_to_the_noise(site, run, solved):
    """The first axis reads twice, the second backward; a metre of ampere of what metal is left has 3 nT."""
    read = replace(site, sensor=SensorSite(2e-8, axes=np.diag([2.0, -1.0, 1.0])))
    Locator(read).locate(epoch(run.field_T[0] * [2.0, -1.0, 1.0]))
    np.testing.assert_allclose(solved[0][1].field_T[0], run.field_T[0], rtol=1e-12)
    np.testing.assert_allclose(solved[0][1].noise_T[0], SIGMA_T * np.sqrt((0.25 + 1.0 + 1.0) / 3.0))
    metal = Metal(np.zeros(3), 1.0, 0, np.empty((0, 3)), np.empty((0, 3, 3)), 3e-10, np.empty((0, 3)))
    beacons = tuple(replace(beacon, metal=BeaconMetal(metal, np.empty(0))) for beacon in site.beacons)
    Locator(replace(site, beacons=beacons, metal=metal)).locate(epoch(run.field_T[0]))
    np.testing.assert_allclose(solved[1][1].noise_T[0], np.hypot(1.0, 3.0) * SIGMA_T)  # of 10 A


def test_errors_of_the_site_are_those_of_the_beacons_that_were_heard(site, run, solved):
    beacons = [replace(b, survey=replace(built.DECLARED, current_sd=0.01 * i)) for i, b in enumerate(site.beacons)]
    Locator(replace(site, beacons=tuple(beacons))).locate(epoch(run.field_T[0][2:6], NAMES[2:6]))
    (_, measured), *_ = solved
    np.testing.assert_allclose(measured.errors.current_sd, [0.02, 0.03, 0.04, 0.05])
    assert (measured.sigma_T > measured.noise_T).all()
    np.testing.assert_array_equal(measured.noise_T, SIGMA_T)


def test_many_epochs_are_solved_some_at_a_time(site, run, solved, monkeypatch):
    monkeypatch.setattr(locator, "BATCH", 2)
    poses = Locator(site).locate_many([epoch(run.field_T[e], number=e) for e in range(5)])
    assert [len(measured) for _, measured in solved] == [2, 2, 1]
    np.testing.assert_array_equal(np.concatenate([measured.field_T for _, measured in solved]), run.field_T[:5])
    assert [pose.epoch for pose in poses] == list(range(5))


def test_where_there_is_no_pose_it_is_said_why(site, run, solved):
    """As many components as unknowns are enough; then fields are noise, or heard and fitted nowhere."""
    two_axes, one_axis = run.field_T[0][:3].copy(), run.field_T[0][:4].copy()
    two_axes[:, 2] = np.nan
    one_axis[:, :2] = np.nan
    noise = np.where(np.isnan(two_axes), np.nan, 0.0)
    fields = [(two_axes, 3), (one_axis, 4), (noise, 3), (run.field_T[0], 8)]
    poses = [Locator(site).locate(epoch(field, NAMES[:count])) for field, count in fields]
    reasons = [sentences.NO_FIT, sentences.few_components(4, 5), sentences.NOISE, sentences.NO_FIT]
    assert [pose.reason for pose in poses] == reasons


def test_a_pose_needs_as_many_components_as_unknowns_whatever_was_found(site, run, monkeypatch):
    """Three beacons of two axes have six components, four of one axis only four for five unknowns."""

    def solve(self, measurements):
        found = unsolved(self.at(measurements, run.position_m[:1], run.rotation[:1]))
        return replace(found, bounded=np.zeros(1, dtype=bool))

    monkeypatch.setattr(Constellation, "solve", solve)
    for axes, beacons, located in ((2, 3, True), (1, 4, False)):
        field = run.field_T[0][:beacons].copy()
        field[:, axes:] = np.nan
        pose = Locator(site).locate(epoch(field, NAMES[:beacons]))
        assert (pose.status is Status.FAILED) == (not located)
        assert np.isfinite(pose.position_m).all() == located


def test_poses_of_all_epochs_or_of_some_are_found_where_they_are(site, run):
    """Among them one of two beacons and one of nothing but noise, whose positions are NaN."""
    epochs = [epoch(run.field_T[e], number=e) for e in range(4)]
    epochs[1], epochs[2] = epoch(run.field_T[1][:2], NAMES[:2], number=1), epoch(np.zeros((8, 3)), number=2)
    found = Locator(site)
    position = found.fit_all(epochs)
    poses = found.locate_many(epochs)
    for e in range(4):
        if e in (1, 2):
            assert np.isnan(position[e]).all()
            assert poses[e].status is Status.FAILED
        else:
            np.testing.assert_allclose(position[e], run.position_m[e], atol=2e-3)
            np.testing.assert_allclose(poses[e].position_m, run.position_m[e], atol=2e-3)
            assert (poses[e].status, poses[e].epoch) == (Status.OK, e)
    assert found.fit_all([]).shape == (0, 3)


def reversed_coil(run, row=5):
    """Fields of which those of one beacon are reversed, in the second and the fourth of five epochs."""
    field = run.field_T[:5].copy()
    field[[1, 3], row] *= -1.0
    return [epoch(one, number=e) for e, one in enumerate(field)]


@pytest.fixture
def explained(monkeypatch):
    """Puts verdicts in the place of explanations, and notes what these were asked with."""
    asked = []

    def put(*verdicts):
        left = list(verdicts)

        def explain(constellation, measurements, solutions, names):
            asked.append((measurements, solutions, names))
            return left.pop(0)(constellation, measurements)

        monkeypatch.setattr(locator, "explain", explain)
        return asked

    return put


def unmended(finding):
    return lambda constellation, measurements: Verdict((finding,), finding.text, None, np.arange(0), {})


def without(row, run, e):
    """The verdict that one beacon is left out, with the pose of the others."""

    def verdict(constellation, measurements):
        kept = np.delete(np.arange(8), row)
        others, thinned = constellation.subset(kept), measurements.of_beacons(kept)
        rest = unsolved(others.at(thinned, run.position_m[[e]], run.rotation[[e]]))
        rest = replace(rest, bounded=np.zeros(1, dtype=bool))
        statistics = fault_statistics(others.model, thinned, rest.best)
        return Verdict((DEAD,), sentences.left_out([DEAD.text]), rest, np.array([row]), {row: 77.0}, statistics)

    return verdict


def test_those_that_raise_the_alarm_and_no_others_are_explained(site, run, explained):
    """One is given a pose of the rest, which is told with what is left out; the other stays without explanation."""
    asked = explained(without(5, run, 1), unmended(UNKNOWN))
    sites = replace(site, alert_limit_m=1.0)
    poses = Locator(sites).locate_many(reversed_coil(run))
    assert [pose.status for pose in poses] == [Status.OK, Status.OK, Status.OK, Status.INCONSISTENT, Status.OK]
    assert [pose.excluded for pose in poses] == [(), ("b5",), (), (), ()]
    rest, unknown = poses[1], poses[3]
    assert (rest.reason, rest.findings, rest.epoch) == ("left out: b5 has no field", (DEAD,), 1)
    assert rest.used == tuple(name for name in NAMES if name != "b5")
    assert rest.residuals["b5"] == 77.0
    assert len(rest.residuals) == 8
    np.testing.assert_array_equal(rest.position_m, run.position_m[1])
    assert (unknown.reason, unknown.findings, unknown.used) == (UNKNOWN.text, (UNKNOWN,), NAMES)
    for e in (0, 2, 4):
        assert (poses[e].reason, poses[e].epoch) == (None, e)
        np.testing.assert_allclose(poses[e].position_m, run.position_m[e], atol=2e-3)
    assert [names for *_, names in asked] == [NAMES, NAMES]
    assert all(len(measurements) == 1 for measurements, *_ in asked)


def test_what_is_wrong_with_the_pose_of_the_rest_goes_before_what_was_left_out(site, run, explained):
    explained(without(5, run, 1), without(5, run, 3))
    rest = Locator(replace(site, alert_limit_m=1e-9)).locate_many(reversed_coil(run))[1]
    assert rest.status is Status.UNVERIFIED
    assert rest.reason.startswith("a fault of ")
    assert rest.reason.endswith("; left out: b5 has no field")


def test_all_may_be_given_the_pose_of_their_rest(site, run, explained):
    explained(without(5, run, 1), without(5, run, 3))
    poses = Locator(replace(site, alert_limit_m=1.0)).locate_many([reversed_coil(run)[e] for e in (1, 3)])
    assert [(pose.status, pose.excluded, pose.epoch) for pose in poses] == [(Status.OK, ("b5",), e) for e in (1, 3)]


@pytest.mark.parametrize(
    ("axes", "finding", "status"),
    [(3, UNKNOWN, Status.INCONSISTENT), (2, UNKNOWN, Status.WEAK), (2, DEAD, Status.INCONSISTENT)],
)
def test_of_a_sensor_without_three_axes_what_nothing_explains_may_be_a_search_in_vain(
    site, run, explained, monkeypatch, axes, finding, status
):
    """Then the pose is weak, and no rival of it is told, which fits no better."""
    explained(unmended(finding))
    field = reversed_coil(run)[1].field_T
    field[:, axes:] = np.nan

    def solve(self, measurements):
        found = unsolved(self.at(measurements, run.position_m[[1]], run.rotation[[1]]))
        return replace(found, bounded=np.zeros(1, dtype=bool), contested=np.ones(1, dtype=bool))

    monkeypatch.setattr(Constellation, "solve", solve)
    pose = Locator(site).locate(epoch(field))
    assert pose.status is status
    assert pose.reason == (sentences.BOUNDED if status is Status.WEAK else finding.text)
    assert (pose.alternative is None) == (status is Status.WEAK)


def test_what_a_search_took_is_off_the_budget_of_the_explanation(site, run, explained, monkeypatch):
    asked = explained(unmended(DEAD))
    whole = Constellation.solve

    def solve(self, measurements):
        found = whole(self, measurements)
        found.bounded[:], found.evaluations[:] = False, 1000
        return found

    monkeypatch.setattr(Constellation, "solve", solve)
    Locator(site).locate(reversed_coil(run)[1])
    ((measurements, *_),) = asked
    assert measurements.budget.evaluations(8) == 25_000 - 1000

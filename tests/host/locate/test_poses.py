"""From solutions to poses: what is told of each, on both sides of each limit, and the figures that it comes with."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from goldfield.field import FieldModel
from goldfield.locate import poses, sentences
from goldfield.locate.fault_statistics import fault_statistics
from goldfield.locate.fit import Measurements, fit_pose
from goldfield.locate.integrity import Verdict
from goldfield.locate.poses import HEARD, WEAK_ATTITUDE_RAD, WEAK_POSITION, Judged, poses_of
from goldfield.locate.solutions import unsolved
from goldfield.types import Explanation, Fields, Finding, Status
from tests.bench import locate_trials as bench

MU0 = 4e-7 * np.pi
SITE = replace(bench.prigge_cube(2e-8), alert_limit_m=1.0)
NAMES = tuple(beacon.id for beacon in SITE.beacons)
FINDING = Finding(Explanation.UNKNOWN, (), "nothing explains it")


def judged_of(count=1, sigma_T=1e-9, axes=(0, 1, 2), site=SITE, change=None):
    """Sound epochs at places in the cube, fitted, that raised no alarm and have no rival."""
    rng = np.random.default_rng(17)
    run = bench.trials(site, bench.cube_positions(rng, count, 0.6), rng, sigma_T=sigma_T, axes=axes)
    field = run.field_T if change is None else change(run.field_T)
    model, measurements = FieldModel(site.beacons), Measurements(field, run.sigma_T)
    fit = fit_pose(model, measurements, run.position_m, run.rotation)
    statistics = fault_statistics(model, measurements, fit)
    images = np.zeros((count, len(site.beacons)))
    return Judged(site, model, NAMES[: len(site.beacons)], measurements, unsolved(fit), statistics, {}, images)


def told(judged):
    """The poses of epochs that are numbered from 40 on."""
    count = len(judged.measurements)
    empty = np.zeros((len(judged.names), 3))
    epochs = [Fields(40 + e, 0.1 * e, judged.names, empty, np.ones(len(empty))) for e in range(count)]
    return poses_of(epochs, judged)


@pytest.fixture(scope="module")
def five():
    return judged_of(5)


def test_sound_epochs_are_ok_and_nothing_is_said_of_them(five):
    for e, pose in enumerate(told(five)):
        assert (pose.status, pose.reason, pose.findings, pose.alternative) == (Status.OK, None, (), None)
        assert (pose.epoch, pose.time_s, pose.used) == (40 + e, 0.1 * e, NAMES)
        np.testing.assert_array_equal(pose.position_m, five.solutions.best.position_m[e])
        assert pose.residual == pytest.approx(np.sqrt(five.solutions.best.cost[e] / (24 - 6)))
        np.testing.assert_allclose(list(pose.residuals.values()), five.statistics.normalised()[e])
        covariance = np.linalg.inv(five.solutions.best.information[e])  # of next to no noise, the model is linear
        for ours, theirs in ((pose.position_cov_m2, covariance[:3, :3]), (pose.attitude_cov_rad2, covariance[3:, 3:])):
            np.testing.assert_allclose(ours, theirs, atol=0.02 * np.abs(theirs).max())


def test_a_residual_needs_redundancy():
    """Six numbers of two beacons for six unknowns, and seven."""
    site = replace(SITE, beacons=SITE.beacons[:3])

    def kept(count):
        return lambda field: np.where(np.arange(9).reshape(3, 3) < count, field, np.nan)

    for count, residual in ((6, 0.0), (7, 1.5)):
        judged = judged_of(site=site, change=kept(count))
        judged.solutions.best.cost[:] = 2.25
        (pose,) = told(judged)
        assert pose.residual == residual


def some(judged, **changes):
    """The same with other solutions."""
    return replace(judged, solutions=replace(judged.solutions, **changes))


def only(e, count=5):
    return np.arange(count) == e


def test_what_comes_in_the_way_of_one_epoch_is_told_of_that_alone(five):
    """Each epoch of one batch has another flaw, and one a flaw that an alarm has explained."""
    rival = replace(five.solutions.best, position_m=five.solutions.best.position_m + np.array([0.0, 0.0, 0.5]))
    verdict = Verdict((FINDING,), FINDING.text, None, np.arange(0), {})
    judged = some(five, outside=only(0) | only(4), contested=only(1), bounded=only(2), rival=rival)
    judged = replace(judged, verdicts={4: verdict})
    found = told(judged)
    statuses = [Status.INCONSISTENT, Status.AMBIGUOUS, Status.WEAK, Status.OK, Status.INCONSISTENT]
    assert [pose.status for pose in found] == statuses
    reasons = [sentences.OUTSIDE, sentences.ambiguous(rival.position_m[1]), sentences.BOUNDED, None, FINDING.text]
    assert [pose.reason for pose in found] == reasons
    assert [pose.findings for pose in found] == [(), (), (), (), (FINDING,)]
    assert [pose.alternative is None for pose in found] == [True, False, True, True, True]
    other = found[1].alternative
    np.testing.assert_array_equal(other.position_m, rival.position_m[1])
    assert (other.status, other.reason, other.epoch) == (Status.AMBIGUOUS, found[1].reason, 41)
    assert other.residual == pytest.approx(found[1].residual)


def test_outside_goes_before_contested_and_both_before_bounded(five):
    both = some(five, outside=only(0), contested=only(0) | only(1), bounded=only(1))
    assert [pose.status for pose in told(both)[:2]] == [Status.INCONSISTENT, Status.AMBIGUOUS]


def test_a_search_that_was_uncertain_widens_the_covariance(five):
    widening = np.zeros((5, 6, 6))
    widening[2] = np.diag([1e-4, 2e-4, 3e-4, 1e-3, 2e-3, 3e-3])
    plain, wide = told(five), told(some(five, covariance_widening=widening))
    for e in range(5):
        np.testing.assert_allclose(wide[e].position_cov_m2 - plain[e].position_cov_m2, widening[e, :3, :3], atol=1e-12)
        more = wide[e].attitude_cov_rad2 - plain[e].attitude_cov_rad2
        np.testing.assert_allclose(more, widening[e, 3:, 3:], atol=1e-12)
    assert wide[2].protection_m > plain[2].protection_m + 0.02
    assert wide[1].protection_m == plain[1].protection_m


def widened(judged, variances):
    return some(judged, covariance_widening=np.diag(variances)[None])


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("share", "status"), [(0.98, Status.UNVERIFIED), (1.02, Status.WEAK)])
def test_a_pose_is_weak_where_its_error_is_a_quarter_of_the_way_to_the_nearest_coil(axis, share, status):
    judged = replace(judged_of(), site=replace(SITE, alert_limit_m=0.01))
    place = judged.solutions.best.position_m[0]
    nearest_m = min(np.linalg.norm(place - beacon.position_m) for beacon in SITE.beacons)
    (pose,) = told(widened(judged, np.eye(6)[axis] * (share * WEAK_POSITION * nearest_m) ** 2))
    assert pose.status is status
    if status is Status.WEAK:
        size = np.sqrt(pose.position_cov_m2.diagonal()[axis]), nearest_m
        assert pose.reason.startswith(f"the standard deviation is {size[0]:.2g} m and")
        assert f", {size[1]:.2g} m from the nearest coil" in pose.reason


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("share", "status"), [(0.98, Status.OK), (1.02, Status.WEAK)])
def test_a_pose_is_weak_where_its_attitude_is_half_a_radian_uncertain(axis, share, status):
    (pose,) = told(widened(judged_of(), np.eye(6)[3 + axis] * (share * WEAK_ATTITUDE_RAD) ** 2))
    assert pose.status is status
    if status is Status.WEAK:
        assert f"and {share * WEAK_ATTITUDE_RAD:.2g} rad" in pose.reason


@pytest.mark.parametrize(("axes", "status"), [((2,), Status.OK), ((0, 2), Status.OK)])
def test_the_free_turn_of_a_sensor_with_one_axis_does_not_count(axes, status):
    (pose,) = told(judged_of(axes=axes))
    assert pose.status is status


@pytest.mark.parametrize(("share", "status"), [(0.98, Status.OK), (1.02, Status.WEAK)])
def test_what_a_sensor_with_one_axis_points_at_counts(share, status):
    judged = judged_of(axes=(2,))
    across = judged.solutions.best.rotation[0] @ np.diag([1.0, 1.0, 0.0]) @ judged.solutions.best.rotation[0].T
    widening = np.zeros((1, 6, 6))
    widening[0, 3:, 3:] = across * (share * WEAK_ATTITUDE_RAD) ** 2
    (pose,) = told(some(judged, covariance_widening=widening))
    assert pose.status is status


def limited(judged, limit_m):
    return replace(judged, site=replace(SITE, alert_limit_m=limit_m))


def test_a_protection_level_is_verified_up_to_the_alert_limit(five):
    levels = [pose.protection_m for pose in told(five)]
    middle = sorted(levels)[2]
    for limit, verified in ((middle, 3), (np.nextafter(middle, 0.0), 2), (np.nan, 0)):
        found = told(limited(five, limit))
        for pose, level in zip(found, levels, strict=True):
            assert (pose.status is Status.OK) == (level <= limit)
            assert (pose.reason is None) == (level <= limit)
        assert sum(pose.status is Status.OK for pose in found) == verified
        assert {pose.status for pose in found} <= {Status.OK, Status.UNVERIFIED}


def test_the_reason_names_the_beacon_whose_fault_could_hide_the_most(five):
    """An error of the image of a beacon comes on top where there is one, and then that beacon is named."""
    plain = told(limited(five, 1e-9))
    images = np.zeros((5, 8))
    images[1, [2, 6]] = 0.3, 0.7
    images[3, 0] = 0.4
    with_images = told(limited(replace(five, images_m=images), 1e-9))
    for e, more in enumerate((0.0, 0.7, 0.0, 0.4, 0.0)):
        level = plain[e].protection_m + more
        assert with_images[e].protection_m == pytest.approx(level)
        beacon = {1: "b6", 3: "b0"}.get(e)
        if beacon is None:
            assert with_images[e].reason == plain[e].reason
        else:
            assert with_images[e].reason == sentences.unverified(beacon, with_images[e].protection_m, 1e-9)


def test_the_beacon_without_which_the_pose_is_worst_is_the_one_that_is_named(five, monkeypatch):
    def level(measurements, statistics, covariance):
        return np.full(5, 0.2), np.arange(5)

    monkeypatch.setattr(poses, "protection_level", level)
    for e, pose in enumerate(told(limited(five, 0.1))):
        assert pose.reason == sentences.unverified(NAMES[e], 0.2, 0.1)


class Room:
    """The model of coils among metal that was learned on one side of a plane."""

    def __init__(self, model, height_m):
        self.metal = SimpleNamespace(learned=lambda position: position[:, 2] < height_m)
        self._model = model

    def __getattr__(self, name):
        return getattr(self._model, name)


def test_nothing_is_promised_beyond_the_room_in_which_metal_was_learned(five, monkeypatch):
    def covariance(model, *rest):
        return poses_covariance(five.model, *rest)

    poses_covariance = poses.second_order_covariance
    monkeypatch.setattr(poses, "second_order_covariance", covariance)
    height = five.solutions.best.position_m[:, 2]
    judged = replace(five, model=Room(five.model, np.sort(height)[2]))
    for pose in told(limited(judged, np.inf)):
        inside = pose.position_m[2] < np.sort(height)[2]
        assert (pose.status, pose.reason) == ((Status.OK, None) if inside else (Status.UNVERIFIED, sentences.STRANGE))
        assert np.isinf(pose.protection_m) == (not inside)


def test_a_beacon_that_was_not_measured_is_not_heard():
    """The pose is weak, of a fit that went astray, so near to that beacon that its field would tell."""
    judged = judged_of(change=lambda field: np.where(np.arange(8)[:, None] == 3, np.nan, field))
    judged.measurements.noise_T[:] = 1e-5
    nearest = SITE.beacons[3].position_m
    judged.solutions.best.position_m[:] = nearest + np.array([0.02, 0.01, 0.03])
    weak = widened(judged, np.ones(6))
    for verdicts, findings, reason in (
        ({}, (), sentences.UNHEARD),
        ({0: Verdict((FINDING,), FINDING.text, None, np.arange(0), {})}, (FINDING,), sentences.unheard(FINDING.text)),
    ):
        (pose,) = told(replace(weak, verdicts=verdicts))
        assert (pose.status, pose.reason, pose.findings, pose.used) == (Status.FAILED, reason, findings, NAMES)


@pytest.mark.parametrize(("share", "status"), [(1.02, Status.WEAK), (0.98, Status.FAILED)])
def test_a_pose_is_lost_where_all_beacons_together_are_no_stronger_than_the_noise(share, status):
    """On the axis of three coils in one place, whose field there is the textbook's."""
    beacon = SITE.beacons[0]
    distance_m = 40.0
    strength_T = MU0 * beacon.turns * beacon.current_A * beacon.radius_m**2 / 2.0
    strength_T /= (beacon.radius_m**2 + distance_m**2) ** 1.5
    model = FieldModel([beacon] * 3)
    sigma_T = np.sqrt(3.0 / (HEARD * share)) * abs(strength_T)
    measurements = Measurements(np.zeros((1, 3, 3)), np.full((1, 3), sigma_T))
    place = beacon.position_m + distance_m * beacon.axis
    fit = fit_pose(model, measurements, place[None], np.eye(3)[None], iterations=0)
    solutions = unsolved(fit)
    solutions.bounded[:] = False
    statistics = fault_statistics(model, measurements, fit)
    names = ("b0", "b1", "b2")
    judged = Judged(SITE, model, names, measurements, solutions, statistics, {}, np.zeros((1, 3)))
    (pose,) = poses_of([Fields(0, 0.0, names, np.zeros((3, 3)), np.ones(3))], judged)
    assert pose.status is status

"""The filter on moving sensors: accuracy, consistency, faults, gaps, time."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.access import Separator
from goldfield.access.moving import DriftSeparator
from goldfield.locate import locate
from goldfield.site import HalfSpace
from goldfield.track import (
    CycleData,
    CycleObserver,
    EpochObserver,
    FixedLagSmoother,
    Tracker,
    tracked,
)
from goldfield.types import Fields, Status
from tests.bench.locate_trials import prigge_cube, site_of
from tests.bench.motion_trials import Flight, Room, circling, epoch_bound, flight_poses

NOISE_T = 2e-7
SITE = prigge_cube(NOISE_T)
ROOM = Room(SITE)
IDS = tuple(beacon.id for beacon in SITE.beacons)
CYCLE_S = SITE.cycle_s


def cycles(flight, count, seed, noise_T=NOISE_T):
    rng = np.random.default_rng(seed)
    return [CycleData(k, k * CYCLE_S, IDS, ROOM.samples(flight, k * CYCLE_S, noise_T, rng)) for k in range(count)]


def epochs(data, separator=None):
    separator = Separator(10, SITE.codes, NOISE_T) if separator is None else separator
    separations = [separator.from_samples(cycle.data_T) for cycle in data]
    return [
        Fields(cycle.epoch, cycle.time_s, IDS, s.field_T, s.sigma_T) for cycle, s in zip(data, separations, strict=True)
    ]


FLIGHT = circling(np.random.default_rng(5), speed=1.0, rate=1.0)
CYCLES = cycles(FLIGHT, 40, 6)
EPOCHS = epochs(CYCLES)
STILL = epochs(cycles(circling(np.random.default_rng(8), speed=0.0, rate=0.0), 12, 9))


def error_of(pose, flight=FLIGHT):
    position, rotation = flight_poses(flight, pose.time_s)
    turn = (rotation * Rotation.from_quat(pose.orientation_xyzw).inv()).as_rotvec()
    return pose.position_m - position, turn


def over_bound(poses):
    """Root mean square of the position errors over the bound of each epoch alone."""
    ratio = [np.linalg.norm(error_of(pose)[0]) / epoch_bound(SITE, FLIGHT, pose.time_s) for pose in poses]
    return np.sqrt(np.mean(np.square(ratio)))


def normalised(poses):
    """Mean normalised errors squared per axis, of position and attitude."""
    both = [error_of(pose) for pose in poses]
    position = [e @ np.linalg.solve(p.position_cov_m2, e) / 3 for (e, _), p in zip(both, poses, strict=True)]
    turn = [e @ np.linalg.solve(p.attitude_cov_rad2, e) / 3 for (_, e), p in zip(both, poses, strict=True)]
    return np.mean(position), np.mean(turn)


def test_tracking_a_sensor_that_moves_and_turns():
    poses = list(tracked(SITE, EPOCHS))
    assert [pose.epoch for pose in poses] == list(range(40))
    assert all(pose.status is Status.OK and pose.used == IDS for pose in poses)
    assert over_bound(poses[3:]) < 1.3
    assert over_bound([locate(SITE, fields) for fields in EPOCHS[3:]]) > 1.8
    for value in normalised(poses[3:]):
        assert 0.5 < value < 1.6


def test_fields_without_the_sweep_are_tracked_as_such():
    drift = epochs(CYCLES, DriftSeparator(10, SITE.codes, NOISE_T))
    tracker = Tracker(SITE, EpochObserver(SITE, drift=2))
    poses = [tracker.update(fields) for fields in drift]
    assert over_bound(poses[3:]) < 1.15
    for value in normalised(poses[3:]):
        assert 0.5 < value < 1.6


def test_tracking_from_samples():
    tracker = Tracker(SITE, CycleObserver(SITE))
    poses = [tracker.update(cycle) for cycle in CYCLES[:25]]
    assert over_bound(poses[3:]) < 1.0
    for value in normalised(poses[3:]):
        assert 0.4 < value < 1.6


def test_smoothing_is_better_than_filtering_and_says_so():
    filtered = list(tracked(SITE, EPOCHS))
    smoothed = list(FixedLagSmoother(SITE, Tracker(SITE), 6).poses(EPOCHS))
    assert [pose.epoch for pose in smoothed] == list(range(40))
    assert over_bound(smoothed[3:-6]) < 0.9 * over_bound(filtered[3:-6])
    for value in normalised(smoothed[3:-6]):
        assert 0.5 < value < 1.6
    for late, early in zip(smoothed[:-1], filtered[:-1], strict=True):
        assert np.trace(late.position_cov_m2) < np.trace(early.position_cov_m2)
    np.testing.assert_allclose(smoothed[-1].position_m, filtered[-1].position_m, rtol=1e-12)


def test_a_lag_needs_an_epoch():
    with pytest.raises(ValueError, match="at least 1"):
        FixedLagSmoother(SITE, Tracker(SITE), 0)


def test_the_smoother_loses_no_epoch_over_gaps_and_failures():
    nothing = Fields(99, 1.5, (), np.empty((0, 3)), np.empty(0))
    some = [*EPOCHS[:8], *EPOCHS[25:30], nothing, *EPOCHS[30:33]]
    some[13] = replace(nothing, time_s=EPOCHS[29].time_s + 5.0)
    smoothed = list(FixedLagSmoother(SITE, Tracker(SITE), 4).poses(some))
    assert [pose.epoch for pose in smoothed] == [fields.epoch for fields in some]
    assert smoothed[13].status is Status.FAILED


def test_the_pose_at_any_time():
    tracker = Tracker(SITE)
    assert tracker.pose_at(0.0) is None
    for fields in EPOCHS[:20]:
        last = tracker.update(fields)
    now = tracker.pose_at(last.time_s + 0.08)
    position, turn = error_of(now)
    stale = np.linalg.norm(last.position_m - flight_poses(FLIGHT, last.time_s + 0.08)[0])
    assert np.linalg.norm(position) < 0.5 * stale
    assert position @ np.linalg.solve(now.position_cov_m2, position) < 16
    assert turn @ np.linalg.solve(now.attitude_cov_rad2, turn) < 16
    assert np.trace(now.position_cov_m2) > np.trace(last.position_cov_m2)
    assert tracker.pose_at(last.time_s).position_m == pytest.approx(last.position_m)


@pytest.mark.parametrize("fault", ["polarity", "dead", "wrong current"])
def test_a_beacon_that_fails_is_left_out(fault):
    factor = {"polarity": -1.0, "dead": 0.0, "wrong current": 1.5}[fault]
    tracker = Tracker(SITE)
    poses = []
    for fields in EPOCHS[:20]:
        row = int(np.argsort(np.linalg.norm(fields.field_T, axis=1))[-2])
        if fields.epoch >= 6:
            field = fields.field_T.copy()
            field[row] *= factor
            fields = replace(fields, field_T=field)
        pose = tracker.update(fields)
        if fields.epoch >= 6:
            assert pose.excluded == (IDS[row],)
            assert pose.status is Status.OK
            poses.append(pose)
    assert over_bound(poses) < 1.6


def test_a_sensor_carried_elsewhere_is_found_again():
    elsewhere = circling(np.random.default_rng(77), speed=0.0, rate=0.0)
    jump = epochs(cycles(elsewhere, 14, 78))[8:]
    tracker = Tracker(SITE)
    for fields in STILL[:8]:
        tracker.update(fields)
    poses = [tracker.update(fields) for fields in jump]
    assert [pose.status for pose in poses[:2]] == [Status.INCONSISTENT] * 2
    assert poses[0].used == ()
    assert poses[0].excluded == IDS
    assert [pose.status for pose in poses[2:]] == [Status.OK] * 4
    error = [np.linalg.norm(error_of(pose, elsewhere)[0]) for pose in poses[2:]]
    assert max(error) < 0.04


def test_after_a_gap_the_track_starts_anew():
    tracker = Tracker(SITE)
    steps = [tracker.step(fields) for fields in [*EPOCHS[:5], *EPOCHS[8:12], *EPOCHS[30:33]]]
    assert [step.predicted is None for step in steps] == [True] + [False] * 8 + [True] + [False] * 2
    assert all(step.pose.status is Status.OK for step in steps)
    assert over_bound([step.pose for step in steps]) < 2.0
    assert tracker.step(EPOCHS[31]).predicted is None, "time that runs backwards starts a new track"


def test_two_beacons_carry_a_track_for_a_while():
    tracker = Tracker(SITE)
    for fields in EPOCHS[:15]:
        tracker.update(fields)
    errors = []
    for fields in EPOCHS[15:19]:
        few = Fields(fields.epoch, fields.time_s, IDS[2:4], fields.field_T[2:4], fields.sigma_T[2:4])
        assert locate(SITE, few).status is Status.FAILED
        pose = tracker.update(few)
        assert pose.status is Status.UNVERIFIED, "nothing tells whether one of the two is at fault"
        assert pose.protection_m > 100.0
        assert pose.used == IDS[2:4]
        error, _ = error_of(pose)
        errors.append(error @ np.linalg.solve(pose.position_cov_m2, error))
    assert np.mean(errors) / 3 < 2.5


def test_epochs_that_say_nothing_are_bridged_and_then_not():
    tracker = Tracker(SITE)
    for fields in STILL:
        tracker.update(fields)
    empty = np.full((8, 3), np.nan)
    poses = [
        tracker.update(Fields(20 + k, STILL[-1].time_s + 0.1 * (k + 1), IDS, empty, np.full(8, np.inf)))
        for k in range(12)
    ]
    trace = [np.trace(pose.position_cov_m2) for pose in poses]
    assert all(np.diff(trace[:8]) > 0)
    assert all(pose.used == () for pose in poses)
    assert poses[0].status in (Status.OK, Status.WEAK)
    assert poses[-1].status is Status.FAILED


def test_one_axis_and_lost_components():
    tracker = Tracker(SITE)
    for fields in EPOCHS[:12]:
        tracker.update(fields)
    for k, fields in enumerate(EPOCHS[12:16]):
        field = fields.field_T.copy()
        field[k] = np.nan
        field[4:, 1] = np.nan
        pose = tracker.update(replace(fields, field_T=field))
        error, _ = error_of(pose)
        assert error @ np.linalg.solve(pose.position_cov_m2, error) < 16
        assert IDS[k] not in pose.used


def test_beacons_of_another_site_and_useless_noise_are_ignored():
    tracker = Tracker(SITE)
    for fields in STILL[:6]:
        tracker.update(fields)
    fields = STILL[6]
    sigma = fields.sigma_T.copy()
    sigma[[0, 1]] = np.nan, 0.0
    strange = replace(fields, beacons=(*IDS[:7], "nobody"), sigma_T=sigma)
    assert tracker.update(strange).used == IDS[2:7]


def test_the_other_side_of_a_plane_is_no_place_for_a_track():
    floor = [beacon for beacon in SITE.beacons if beacon.position_m[2] == 0.0]
    below = site_of(floor, HalfSpace(np.zeros(3), np.array([0.0, 0.0, -1.0])), NOISE_T)
    below = replace(below, alert_limit_m=0.1)
    above = replace(below, half_space=HalfSpace(np.zeros(3), np.array([0.0, 0.0, 1.0])))
    unknown = replace(below, half_space=None)
    rows = [IDS.index(beacon.id) for beacon in floor]
    part = [Fields(f.epoch, f.time_s, tuple(IDS[r] for r in rows), f.field_T[rows], f.sigma_T[rows]) for f in STILL]
    for site, sign in ((above, 1.0), (below, -1.0)):
        for pose in tracked(site, part):
            assert np.sign(pose.position_m[2]) == sign
            assert pose.status is Status.UNVERIFIED
    assert {pose.status for pose in tracked(unknown, part)} == {Status.AMBIGUOUS}


def test_no_time_no_track():
    tracker = Tracker(SITE)
    pose = tracker.update(replace(STILL[0], time_s=float("nan")))
    assert pose.status is Status.OK
    assert tracker.pose_at(0.0) is None


def test_a_sensor_shaken_by_hand_is_followed():
    """0.3 m to and fro, 4.8 m/s^2 and 7 rad/s^2 at the ends: more than twice what the filter expects."""
    middle, axis = np.array([1.0, 1.1, 0.8]), np.array([0.6, 0.0, 0.8])
    flight = Flight(
        lambda t: middle + 0.3 * np.outer(np.sin(4.0 * t), axis),
        lambda t: Rotation.from_rotvec(np.outer(0.45 * np.sin(4.0 * t), [0.0, 0.8, 0.6])),
    )
    poses = list(tracked(SITE, epochs(cycles(flight, 30, 31))))
    assert {pose.status for pose in poses} == {Status.OK}
    assert max(np.linalg.norm(error_of(pose, flight)[0]) for pose in poses) < 0.05

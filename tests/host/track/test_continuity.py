"""Quaternions of successive poses, and time that does not go on."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.sensor.location import Succession, location
from goldfield.sensor.options import Method
from goldfield.track import FixedLagSmoother, Tracker
from goldfield.track.continuity import Hemisphere, joined, time_break
from goldfield.types import Fields, Pose, Status
from tests.bench.locate_trials import prigge_cube
from tests.host.fake_sensor import CORNERS_M, beacon_fields

SITE = prigge_cube(2e-7)
SIGMA_T = 2e-7 / np.sqrt(1023)
AROUND = np.deg2rad(np.arange(0.0, 720.0, 10.0))
IDS = tuple(beacon.id for beacon in SITE.beacons)


def pose(quaternion, time_s=0.0, **others):
    nothing = Fields(0, time_s, (), np.empty((0, 3)), np.empty(0))
    return replace(Pose.failed(nothing), orientation_xyzw=np.array(quaternion), status=Status.OK, reason=None, **others)


def fields(angle, epoch, rng):
    """Fields in the middle of the cube after a turn about z."""
    attitude = Rotation.from_rotvec([0.0, 0.0, angle])
    own = [CORNERS_M.index(tuple(beacon.position_m)) for beacon in SITE.beacons]
    exact = beacon_fields(np.array([0.9, 1.2, 0.8]), attitude)[own]
    noisy = exact + SIGMA_T * rng.normal(size=(8, 3))
    return Fields(epoch, epoch * SITE.cycle_s, IDS, noisy, np.full(8, SIGMA_T))


def turning():
    rng = np.random.default_rng(3)
    return [fields(angle, epoch, rng) for epoch, angle in enumerate(AROUND)]


def jumps(poses):
    quaternions = np.array([pose.orientation_xyzw for pose in poses])
    return int((np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1]) < 0.0).sum())


def test_each_locates_two_turns_without_a_jump_of_sign():
    poses = [location(SITE, Method.EACH)(one, None) for one in turning()]
    assert jumps(poses) == 2, "a new source each time: every pose is canonical"
    locate = location(SITE, Method.EACH)
    poses = [locate(one, None) for one in turning()]
    assert jumps(poses) == 0
    assert poses[0].orientation_xyzw[3] > 0.0
    assert poses[len(poses) // 2].orientation_xyzw[3] < 0.0
    for one, angle in zip(poses, AROUND, strict=True):
        turn = Rotation.from_quat(one.orientation_xyzw) * Rotation.from_rotvec([0.0, 0.0, -angle])
        assert turn.magnitude() < 0.1


@pytest.mark.parametrize("smoothed", [False, True])
def test_a_track_keeps_its_hemisphere(smoothed):
    tracker = Tracker(SITE)
    every = [*turning()[:40], Fields(40, 40 * SITE.cycle_s, (), np.empty((0, 3)), np.empty(0)), *turning()[41:]]
    poses = (
        list(FixedLagSmoother(SITE, tracker, 3).poses(every)) if smoothed else [tracker.update(one) for one in every]
    )
    assert len(poses) == len(every)
    assert jumps(poses) == 0
    assert min(one.orientation_xyzw[3] for one in poses) < -0.9
    assert tracker.pose_at(every[-1].time_s + 0.01).orientation_xyzw @ poses[-1].orientation_xyzw > 0.9


def test_the_nearer_sign_and_a_failed_pose_between():
    hemisphere = Hemisphere()
    assert hemisphere.follow(pose([0.0, 0.0, 0.6, -0.8])).orientation_xyzw.tolist() == [0.0, 0.0, -0.6, 0.8]
    failed = pose([np.nan] * 4)
    assert hemisphere.follow(failed) is failed
    other = pose([0.0, 0.0, 0.0, 1.0])
    here = hemisphere.follow(pose([0.0, 0.0, 1.0, 0.01], alternative=other))
    assert here.orientation_xyzw.tolist() == [0.0, 0.0, -1.0, -0.01]
    assert here.alternative.orientation_xyzw.tolist() == [0.0, 0.0, 0.0, -1.0]
    assert hemisphere.nearest(pose([0.0, 0.0, 1.0, 0.0])).orientation_xyzw[2] == -1.0


def test_time_breaks_on_both_sides():
    assert time_break(1.0, np.nextafter(1.0, 2.0)) is None
    assert time_break(1.0, 1.0) == "the time stands still at 1.00 s"
    assert time_break(1.0, np.nextafter(1.0, 0.0)).startswith("the time went back")
    for last, now in ((np.nan, 1.0), (1.0, np.nan), (-np.inf, 1.0)):
        assert time_break(last, now) is None
    assert joined(None, None) is None


@pytest.mark.parametrize("method", [Method.EACH, Method.TRACK])
def test_time_that_goes_back_is_said_once_on_stderr_and_in_each_reason(method, capsys):
    epochs, tracked = turning()[:9], method is Method.TRACK
    epochs[3:6] = [replace(one, time_s=one.time_s - 0.3) for one in epochs[3:6]]
    epochs[8] = replace(epochs[8], time_s=epochs[7].time_s)
    locate = location(SITE, method)
    poses = [locate(one, None) for one in epochs]
    assert [index for index, one in enumerate(poses) if one.reason is not None] == ([3, 8] if tracked else [3])
    assert {one.status for one in poses} == {Status.OK}
    assert poses[3].reason.startswith("the time went back from 0.20 s to ")
    if tracked:
        assert poses[8].reason.startswith("the time stands still at 0.70 s")
    assert capsys.readouterr().err.count("the time went back") == 1


def test_a_reason_that_is_there_is_kept(capsys):
    succession = Succession()
    succession.follow(pose([0.0, 0.0, 0.0, 1.0], time_s=1.0))
    assert succession.follow(replace(pose([0.0, 0.0, 0.0, 1.0], time_s=0.5), reason="why")).reason == "why"
    assert "0.50 s" in capsys.readouterr().err


def test_an_epoch_without_a_time_leaves_the_track_as_it_is():
    epochs = turning()[:8]
    epochs[5] = replace(epochs[5], time_s=float("nan"))
    tracker = Tracker(SITE)
    steps = [tracker.step(one) for one in epochs]
    assert [step.predicted is None for step in steps] == [True, False, False, False, False, True, False, False]
    assert steps[5].pose.status is Status.OK
    assert steps[5].pose.reason.startswith("the time of the epoch is not known")
    smoothed = list(FixedLagSmoother(SITE, Tracker(SITE), 3).poses(epochs))
    assert [one.epoch for one in smoothed] == list(range(8))

"""All beacons are lost for a while: what a track says meanwhile, and how soon it is there again."""

from dataclasses import replace

import numpy as np
import pytest

from goldfield.access import Separator
from goldfield.track import Tracker
from goldfield.types import Fields, Status
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import CHIPS, EARTH_T, Room, circling, flight_poses

NOISE_T = 2e-7
SITE = prigge_cube(NOISE_T)
ROOM = Room(SITE)
IDS = tuple(beacon.id for beacon in SITE.beacons)
SEPARATOR = Separator(10, SITE.codes, NOISE_T)
BEFORE, AFTER = 4, 3


def epoch(flight, cycle, heard, rng):
    """Fields of a cycle; without beacons, those that noise and the earth's field leave to a sensor that turns."""
    middle = cycle * SITE.cycle_s
    if heard:
        samples = ROOM.samples(flight, middle, NOISE_T, rng)
    else:
        times = middle + (np.arange(CHIPS) + 1 - CHIPS / 2) * SITE.chip_period_s
        samples = flight.poses(times)[1].inv().apply(EARTH_T) + NOISE_T * rng.normal(size=(CHIPS, 3))
    separation = SEPARATOR.from_samples(samples)
    return Fields(cycle, middle, IDS, separation.field_T, separation.sigma_T)


def run(lost, noise, rng, speed=1.0, rate=1.0):
    """Lose the beacons for some cycles, of which with ``noise`` some more epochs come; poses and fields by cycle."""
    flight = circling(rng, speed, rate)
    tracker, poses = Tracker(SITE), {}
    last = BEFORE + lost
    for cycle in [*range(BEFORE), *range(BEFORE, BEFORE + min(lost, noise)), *range(last, last + AFTER)]:
        poses[cycle] = tracker.update(epoch(flight, cycle, cycle < BEFORE or cycle >= last, rng))
    return flight, poses, last


@pytest.mark.parametrize("noise", [0, 14])
def test_the_first_cycle_after_a_loss_of_1_to_60_s_is_ok(noise):
    """30 losses: no message for all the time, or at first cycles of nothing but noise."""
    rng = np.random.default_rng([9, noise])
    for seconds in np.geomspace(1.0, 60.0, 15):
        flight, poses, last = run(round(seconds / SITE.cycle_s), noise, rng)
        assert poses[last + 1].status is Status.OK
        for cycle in (last, last + 1, last + 2):
            if poses[cycle].status is Status.OK:
                assert np.linalg.norm(poses[cycle].position_m - flight_poses(flight, poses[cycle].time_s)[0]) < 0.1


def test_while_nothing_is_heard_the_poses_say_so():
    flight, poses, last = run(30, 30, np.random.default_rng(4), speed=0.3, rate=0.3)
    lost = [poses[cycle] for cycle in range(BEFORE, last)]
    assert [pose.status for pose in lost] == [Status.WEAK] * 10 + [Status.FAILED] * 20
    assert [pose.reason for pose in lost] == [f"no beacon has been heard for {0.1 * k:.1f} s" for k in range(1, 31)]
    assert all(pose.used == () and pose.excluded == IDS for pose in lost)
    traces = [np.trace(pose.position_cov_m2) for pose in lost[:10]]
    assert all(np.diff(traces) > 0.0)
    for pose in lost[:10]:
        error = pose.position_m - flight_poses(flight, pose.time_s)[0]
        assert error @ np.linalg.solve(pose.position_cov_m2, error) < 16.0


def test_a_gap_that_the_prediction_does_not_bridge_costs_no_epoch():
    """A sensor at rest is carried 1 m away within 0.6 s: the first epoch that contradicts the track starts anew."""
    rng = np.random.default_rng(12)
    here, there = circling(rng, 0.0, 0.0), circling(rng, 0.0, 0.0)
    tracker = Tracker(SITE)
    for cycle in range(8):
        tracker.update(epoch(here, cycle, True, rng))
    for cycle in range(8, 13):
        assert tracker.update(epoch(here, cycle, False, rng)).status is Status.WEAK
    step = tracker.step(epoch(there, 13, True, rng))
    assert step.pose.status is Status.OK
    assert step.predicted is None
    assert np.linalg.norm(step.pose.position_m - flight_poses(there, step.pose.time_s)[0]) < 0.1


def test_fields_just_above_and_below_the_noise_are_heard_or_not():
    """24 numbers: chi-square 74.0 is exceeded by noise alone once in 10^5 epochs."""
    from scipy.stats import chi2

    from goldfield.track.filter import SILENCE

    limit = chi2.isf(SILENCE, 24)
    fields = epoch(circling(np.random.default_rng(2), 0.0, 0.0), 0, True, np.random.default_rng(3))
    for factor, heard in ((0.999, False), (1.001, True)):
        weak = np.zeros((8, 3))
        weak[2, 1] = factor * np.sqrt(limit) * fields.sigma_T[2]
        pose = Tracker(SITE).update(replace(fields, field_T=weak, sweep_T_s=0.0))
        assert (pose.reason != "no beacon has been heard") == heard


def test_a_tracker_that_never_heard_anything():
    pose = Tracker(SITE).update(Fields(0, 0.0, (), np.empty((0, 3)), np.empty(0)))
    assert (pose.status, pose.reason) == (Status.FAILED, "no beacon has been heard")

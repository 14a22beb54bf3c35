"""When the poses of a smoothed track come, and of what time; a smoother that holds four blocks stands in for it."""

import numpy as np
import pytest

from goldfield.link.reports import Report
from goldfield.sensor.smoothed_track import SmoothedTrack
from tests.host.sensor.test_block_track import BLOCK_S, CYCLE_S, ROOM, Moving, block

HELD = 4


class Late(Moving):
    """Gives the pose of each block four blocks later."""

    def __init__(self, site):
        super().__init__(site)
        self.kept = []

    def update(self, block, without=(), ratio=None):
        self.kept.append(super().update(block, without, ratio))
        return [self.kept.pop(0)] if len(self.kept) > HELD else []

    def finish(self):
        kept, self.kept = self.kept, []
        return kept


@pytest.fixture(autouse=True)
def nothing_made():
    Moving.made = None


def followed(track, blocks):
    return [pose for one in blocks for pose in track.update(one)]


@pytest.mark.parametrize("clock", [1.0, 1.0001, 0.9999])
def test_every_block_has_its_pose_later(clock):
    blocks = [block(n, clock=clock) for n in range(40)]
    track = SmoothedTrack(ROOM, Late, 330.0)
    poses = followed(track, blocks)
    assert len(poses) == 40 - HELD
    poses += track.finish()
    assert [pose.time_s for pose in poses] == [one.time_s for one in blocks]
    assert track.finish() == []
    assert track.pose_at(blocks[-1].time_s) is None


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_between_blocks_poses_are_interpolated_but_not_over_lost_ones(rate_hz):
    track = SmoothedTrack(ROOM, Late, rate_hz)
    poses = followed(track, [block(n, 5) for n in range(60) if not 20 <= n < 30]) + track.finish()
    times = np.array([pose.time_s for pose in poses])
    np.testing.assert_allclose([pose.position_m[0] for pose in poses], times, rtol=1e-12)
    np.testing.assert_allclose(times * rate_hz, np.round(times * rate_hz), atol=1e-6)
    assert [pose.epoch for pose in poses] == [int(time_s / CYCLE_S) for time_s in times]
    lost_s = 10 * BLOCK_S
    gaps = np.diff(times)
    assert (gaps > 1.5 / rate_hz).sum() == 1
    assert lost_s - 1.0 / rate_hz < gaps.max() < lost_s + BLOCK_S + 1.0 / rate_hz


@pytest.mark.parametrize("phase", [0, 17])
def test_without_a_rate_there_is_one_at_the_end_of_each_cycle(phase):
    track = SmoothedTrack(ROOM, Late)
    poses = followed(track, [block(n, phase) for n in range(33 * 3 + 2)]) + track.finish()
    np.testing.assert_allclose([pose.time_s for pose in poses], CYCLE_S * np.arange(1, 4))
    assert [pose.epoch for pose in poses] == [0, 1, 2]


def test_what_is_kept_goes_out_before_a_new_track_begins():
    track = SmoothedTrack(ROOM, Late, 330.0)
    poses = followed(track, [block(n) for n in range(50, 60)])
    poses += track.update(block(0))
    assert [pose.time_s for pose in poses] == [block(n).time_s for n in range(50, 60)]
    assert track.update(block(1), (), {"b1": 0.9}) == []
    assert len(Moving.made) == 2
    assert [ratio for *_, ratio in Moving.made[1].blocks] == [None, {"b1": 0.9}]
    assert track.of_cycle(Report(0)) is None

"""When a track by blocks gives its poses, and of what time; a sensor that moves along x stands in for the filter."""

from dataclasses import replace

import numpy as np
import pytest

from goldfield.link.reports import Report
from goldfield.sensor.block_track import GAP_S, BlockTrack
from goldfield.site import load
from goldfield.types import Block, Pose, Status
from tests.host.fake_sensor import SITE

CHIPS, BLOCK = 1023, 31
CHIP_S = 97.75e-6
BLOCK_S, CYCLE_S = BLOCK * CHIP_S, CHIPS * CHIP_S
ROOM = load(SITE)


class Moving:
    """Follows a sensor that is at x = t, and notes of what it is told; it takes no block whose samples are NaN."""

    made = None

    def __init__(self, site):
        self.site, self.blocks, self.asked = site, [], []
        Moving.made = [*(Moving.made or []), self]

    def update(self, block, without=(), ratio=None):
        if np.isnan(block.data_T).all():
            return None
        self.blocks.append((block, tuple(without), ratio))
        return self._pose(block.time_s, (block.cycle + (block.chip + block.chips - 1) // CHIPS))

    def pose_at(self, time_s):
        self.asked.append(time_s - self.blocks[-1][0].time_s)
        return self._pose(time_s, -1)

    def _pose(self, time_s, epoch):
        return Pose(
            epoch, time_s, np.array([time_s, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.eye(3), np.eye(3), 1.0,
            Status.OK, (),
        )  # fmt: skip


@pytest.fixture(autouse=True)
def nothing_made():
    Moving.made = None


def block(number, phase=0, data=0.0, clock=1.0):
    """The block of 31 chips with a number, on a clock on which cycle 0 begins at 0 s; it begins at any code chip."""
    first = number * BLOCK + phase
    return Block(first // CHIPS, first % CHIPS, (first + BLOCK) * CHIP_S * clock, BLOCK, np.full((9, 3), data))


def followed(track, blocks):
    return [pose for one in blocks for pose in track.update(one)]


def report(cycle):
    return Report(cycle, time_s=(cycle + 0.5) * CYCLE_S)


@pytest.mark.parametrize("rate_hz", [330.0, 1.0 / BLOCK_S, 331.0])
@pytest.mark.parametrize(("phase", "clock"), [(0, 1.0), (17, 1.0), (0, 1.0001), (0, 0.9999)])
def test_at_the_rate_of_the_blocks_each_pose_is_that_of_a_blocks_end(rate_hz, phase, clock):
    blocks = [block(n, phase, clock=clock) for n in range(100)]
    poses = followed(BlockTrack(ROOM, Moving, rate_hz), blocks)
    assert [pose.time_s for pose in poses] == [one.time_s for one in blocks]
    assert [pose.epoch for pose in poses] == [(n * BLOCK + phase + BLOCK - 1) // CHIPS for n in range(100)]
    assert all(-BLOCK_S < ahead < 0.0 for ahead in Moving.made[0].asked), "only for the ends of cycles"


@pytest.mark.parametrize("rate_hz", [7.0, 10.0, 100.0, 200.0, 500.0, 1000.0])
@pytest.mark.parametrize("clock", [1.0, 1.0001, 0.9999])
def test_at_another_rate_the_times_are_multiples_and_each_is_out_with_its_block(rate_hz, clock):
    track = BlockTrack(ROOM, Moving, rate_hz)
    numbers = []
    for n in range(200):
        one = block(n, 5, clock=clock)
        for pose in track.update(one):
            assert one.time_s - clock * BLOCK_S - 1e-9 < pose.time_s <= one.time_s + 1e-9
            assert pose.position_m[0] == pose.time_s
            assert pose.epoch == int(pose.time_s / CYCLE_S / clock)
            numbers.append(pose.time_s * rate_hz)
    np.testing.assert_allclose(numbers, np.round(numbers), atol=1e-6)
    assert (np.diff(np.round(numbers)) == 1).all()
    assert len(numbers) == pytest.approx(200 * BLOCK_S * rate_hz, abs=1.0)


@pytest.mark.parametrize("rate_hz", [330.0, 100.0])
def test_lost_blocks_are_bridged_from_before_and_a_long_gap_is_not(rate_hz):
    whole = followed(BlockTrack(ROOM, Moving, rate_hz), [block(n) for n in range(40)])
    track = BlockTrack(ROOM, Moving, rate_hz)
    poses = followed(track, [block(n) for n in range(40) if not 10 <= n < 20])
    np.testing.assert_allclose([pose.time_s for pose in poses], [pose.time_s for pose in whole], rtol=0, atol=1e-9)
    assert max(Moving.made[-1].asked) == pytest.approx(10 * BLOCK_S, abs=1.0 / rate_hz), "extrapolated"
    far = 20 + int(1.1 * GAP_S / BLOCK_S)
    (*_, first) = poses
    (after, *_) = [*track.update(block(far + 30)), *track.update(block(far + 31)), *track.update(block(far + 32))]
    assert after.time_s - first.time_s > GAP_S


def test_a_block_without_data_is_as_one_that_was_lost():
    with_it = [block(n, data=np.nan if n == 7 else 0.0) for n in range(20)]
    poses = followed(BlockTrack(ROOM, Moving, 330.0), with_it)
    assert len(poses) == 20
    assert [one.time_s for one, *_ in Moving.made[0].blocks] == [one.time_s for one in with_it if one is not with_it[7]]


@pytest.mark.parametrize(("phase", "clock"), [(0, 1.0), (0, 1.0001), (0, 0.9999), (17, 1.0), (30, 1.0)])
def test_the_pose_of_a_cycle_is_that_of_its_end(phase, clock):
    track = BlockTrack(ROOM, Moving)
    ends = []
    for n in range(33 * 4):
        assert track.update(block(n, phase, clock=clock)) == []
        if n % 33 == 1 and n > 33:  # a report comes a little behind the end of its cycle
            ends.append(track.of_cycle(report(n // 33 - 1)))
    assert [pose.epoch for pose in ends] == [0, 1, 2]
    np.testing.assert_allclose([pose.time_s for pose in ends], clock * CYCLE_S * np.arange(1, 4), rtol=0, atol=1e-6)
    assert max(np.abs(Moving.made[0].asked), default=0.0) <= BLOCK_S
    assert len(Moving.made[0].asked) == (4 if phase else 0)


def test_the_end_of_a_cycle_without_its_block_is_extrapolated_and_without_blocks_there_is_none():
    track = BlockTrack(ROOM, Moving)
    assert track.of_cycle(report(0)) is None
    assert track.pose_at(0.1) is None
    followed(track, [block(n) for n in range(36) if n != 32])
    assert track.of_cycle(report(0)).time_s == pytest.approx(CYCLE_S)
    assert track.of_cycle(report(0)) is None, "it is handed out once"
    later = track.of_cycle(report(3))
    assert (later.epoch, later.time_s) == (3, pytest.approx(4 * CYCLE_S))
    assert track.of_cycle(report(12)) is None
    assert track.of_cycle(Report(2)) is None, "a header that was lost"
    assert track.pose_at(0.123).time_s == 0.123


def test_time_that_goes_back_begins_a_new_track():
    track = BlockTrack(ROOM, Moving, 330.0)
    followed(track, [block(n) for n in range(50, 60)])
    poses = followed(track, [block(n) for n in range(3)])
    assert len(Moving.made) == 2
    assert [pose.time_s for pose in poses] == [block(n).time_s for n in range(3)]


@pytest.mark.parametrize("rate_hz", [330.0, 100.0])
def test_blocks_that_are_let_go_cost_their_poses_and_no_other(rate_hz):
    whole = followed(BlockTrack(ROOM, Moving, rate_hz), [block(n) for n in range(80)])
    track = BlockTrack(ROOM, Moving, rate_hz)
    poses = []
    for n in range(80):
        if 10 <= n < 45:
            track.skip()
        else:
            poses += track.update(block(n))
    begin_s, end_s = 10 * BLOCK_S + 1e-9, 45 * BLOCK_S + 1e-9
    kept = [pose.time_s for pose in whole if not begin_s < pose.time_s < end_s]
    np.testing.assert_allclose([pose.time_s for pose in poses], kept, rtol=0, atol=1e-9)
    assert track.of_cycle(report(0)).time_s == pytest.approx(CYCLE_S), "a cycle has its pose all the same"
    poses = followed(track, [block(n) for n in range(3)])
    assert len(poses) == len(followed(BlockTrack(ROOM, Moving, rate_hz), [block(n) for n in range(3)]))


def test_what_is_not_believed_is_handed_on():
    track = BlockTrack(ROOM, Moving)
    track.update(block(0), ("b3",))
    assert Moving.made[0].blocks[0][1] == ("b3",)


def test_a_current_that_is_measured_is_handed_on_and_no_track_begins():
    track = BlockTrack(ROOM, Moving)
    ratios = [{}, {"b2": 1.006}, {"b2": 0.8}, {}]
    for number, ratio in enumerate(ratios):
        track.update(block(number), (), ratio)
    assert len(Moving.made) == 1
    assert [ratio for _, _, ratio in Moving.made[0].blocks] == ratios


def test_the_cycles_number_wraps():
    track = BlockTrack(ROOM, Moving, 330.0)
    last = (1 << 20) - 1
    (pose,) = track.update(replace(block(32), cycle=last))
    poses = track.update(replace(block(33), cycle=0))
    assert (track.of_cycle(Report(last)).epoch, poses[0].epoch) == (last, 0)
    assert pose.epoch == last
    track.update(replace(block(33 * 2 + 1), cycle=1))
    assert track.of_cycle(Report(0)).epoch == 0

"""Poses from blocks: accuracy, honesty, starts, losses and faults; fields by magpylib, codes by shift registers."""

import json
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.site import HalfSpace, SensorSite
from goldfield.site.model import Survey
from goldfield.track.blocks import BlockFilter
from goldfield.types import Block, Status
from goldfield.view.records import json_line, pose_record
from tests.bench.locate_trials import prigge_cube, site_of
from tests.bench.motion_trials import Room, circling
from tests.bench.rate_ways import follow
from tests.bench.rate_world import World, motion_of
from tests.host.track.blocks.flights import Stream, drone, hand, still, streamed

SETTLED_S = 0.15
SOUND = {Status.OK, Status.UNVERIFIED}
"""A track begins with one block, which verifies little at 2 mG."""

MOTIONS = {
    "still": still,
    "one": lambda rng: circling(rng, 1.0, 1.0),
    "hand": hand,
    "drone": drone,
}
SITES = {noise_T: prigge_cube(noise_T) for noise_T in (2e-7, 2e-8)}
ROOMS = {noise_T: Room(site) for noise_T, site in SITES.items()}


def stream_of(name, noise_T, seed, seconds, **more):
    rng = np.random.default_rng([seed, 31])
    return streamed(ROOMS[noise_T], MOTIONS[name](rng), seconds, noise_T, rng, **more)


def followed(stream, blocks=None, site=None):
    """Poses of a stream's blocks, those without a track left out."""
    track = BlockFilter(stream.site if site is None else site)
    poses = [track.update(block) for block in (stream.blocks() if blocks is None else blocks)]
    return [pose for pose in poses if pose.status is not Status.FAILED]


def figures(stream, poses, since=SETTLED_S):
    """Rms of position (m) and attitude (rad), and the mean normalised error squared per axis."""
    poses = [pose for pose in poses if pose.time_s > since]
    moved, turned = stream.errors(poses)
    normal = [
        (m @ np.linalg.solve(pose.position_cov_m2, m) + t @ np.linalg.solve(pose.attitude_cov_rad2, t)) / 6.0
        for pose, m, t in zip(poses, moved, turned, strict=True)
    ]
    return np.sqrt((moved**2).sum(axis=1).mean()), np.sqrt((turned**2).sum(axis=1).mean()), np.mean(normal)


@pytest.mark.parametrize(
    ("name", "noise_T", "most_m"),
    [
        ("still", 2e-7, 12e-3),
        ("one", 2e-7, 18e-3),
        ("one", 2e-8, 2.4e-3),
        ("hand", 2e-7, 26e-3),
        ("hand", 2e-8, 3.8e-3),
        ("drone", 2e-8, 3.2e-3),
    ],
)
def test_poses_of_a_moving_sensor(name, noise_T, most_m):
    stream = stream_of(name, noise_T, 1, 0.7)
    poses = followed(stream)
    assert len(poses) == len(stream.blocks())
    assert {pose.status for pose in poses} <= SOUND
    assert [pose.epoch for pose in poses[:34]] == [31 * k // 1023 for k in range(1, 35)] or poses[32].epoch == 0
    rms_m, rms_rad, normal = figures(stream, poses)
    assert rms_m < most_m
    assert rms_rad < np.radians(2.5 if noise_T > 1e-7 else 0.4)
    assert 0.4 < normal < 1.8


@pytest.mark.parametrize("first", [0, 17, 1005])
def test_a_track_begins_with_any_block(first):
    stream = stream_of("one", 2e-7, 2, 0.2)
    block, *_ = stream.blocks(first)
    pose = BlockFilter(stream.site).update(block)
    assert pose.status in SOUND
    assert pose.time_s == block.time_s
    assert pose.epoch == (first + 30) // 1023
    moved, _ = stream.errors([pose])
    assert np.linalg.norm(moved) < 0.15
    assert moved[0] @ np.linalg.solve(pose.position_cov_m2, moved[0]) / 3 < 4.0


def test_sums_of_the_wire_give_the_poses_of_samples():
    stream = stream_of("one", 2e-7, 3, 0.15)
    codes = np.hstack([ROOMS[2e-7].codes, np.ones((1023, 1))])
    by_sums = followed(stream, stream.blocks(codes=codes))
    for one, other in zip(followed(stream), by_sums, strict=True):
        np.testing.assert_allclose(one.position_m, other.position_m, atol=1e-8)


@pytest.mark.parametrize("lost", [slice(0, None, 10), slice(100, 133)])
def test_lost_blocks_are_bridged(lost):
    stream = stream_of("one", 2e-7, 4, 0.7)
    blocks = stream.blocks()
    del blocks[lost]
    poses = followed(stream, blocks)
    assert {pose.status for pose in poses} <= SOUND
    rms_m, _, normal = figures(stream, poses)
    assert rms_m < 22e-3
    assert normal < 1.8


def test_a_long_silence_ends_with_the_next_block():
    stream = stream_of("drone", 2e-8, 5, 1.3)
    blocks = stream.blocks()
    del blocks[100:330]
    poses = followed(stream, blocks)
    assert poses[100].status is Status.OK
    moved, _ = stream.errors(poses[100:140])
    assert np.linalg.norm(moved[0]) < 0.1
    assert np.linalg.norm(moved[20:], axis=1).max() < 0.02


def test_impulses_are_gated_and_told():
    stream, rng = stream_of("one", 2e-7, 6, 0.6), np.random.default_rng(7)
    struck = np.arange(20, len(stream.blocks()), 9)
    for place in struck:
        stream.samples[31 * place + rng.integers(31), rng.integers(3)] += 2e-5
    poses = followed(stream)
    assert all("contradicts the track: the pose is predicted" in (poses[k].reason or "") for k in struck)
    assert figures(stream, poses)[0] < 16e-3
    assert sum(pose.reason is not None for pose in poses) == len(struck)


@pytest.mark.parametrize(("name", "noise_T"), [("one", 2e-7), ("hand", 2e-8)])
def test_a_beacon_that_dies_is_left_out_and_comes_back(name, noise_T):
    stream = stream_of(name, noise_T, 8, 0.9)
    dead = ROOMS[noise_T].codes.copy()
    dead[:, 3] = 0
    first, last = (round(seconds / stream.site.chip_period_s) for seconds in (0.25, 0.5))
    stream.samples[first:last] = stream_of(name, noise_T, 8, 0.9, drives=dead).samples[first:last]
    poses = followed(stream)
    during = [pose for pose in poses if 0.29 < pose.time_s < 0.5]
    assert all("b3" in pose.excluded for pose in during)
    assert any("b3 has no field" in pose.reason for pose in during)
    after = [pose for pose in poses if pose.time_s > 0.3]
    moved, _ = stream.errors(after)
    for pose, error in zip(after, moved, strict=True):
        told = error @ np.linalg.solve(pose.position_cov_m2, error)
        assert told < 45.0 or pose.status is Status.INCONSISTENT  # 3 degrees of freedom: 1e-9


class AtOnce(Executor):
    """Has everything done when it is asked for, as a thread on an idle machine; without one it is done when needed."""

    def submit(self, work, *arguments):
        done = Future()
        done.set_result(work(*arguments))
        return done


def test_where_and_when_a_cycle_is_judged_changes_no_digit():
    stream = stream_of("one", 2e-8, 8, 0.9)
    dead = ROOMS[2e-8].codes.copy()
    dead[:, 3] = 0
    first, last = (round(seconds / stream.site.chip_period_s) for seconds in (0.25, 0.5))
    stream.samples[first:last] = stream_of("one", 2e-8, 8, 0.9, drives=dead).samples[first:last]
    told = []
    with ThreadPoolExecutor(1) as thread:
        for aside in (None, AtOnce(), thread):
            track = BlockFilter(stream.site, aside=aside)
            poses = [track.update(block) for block in stream.blocks()]
            told.append([json_line(pose_record(pose)) for pose in poses])
    assert told[0] == told[1] == told[2]
    assert len({record["residual"] for record in map(json.loads, told[0])}) > 8, "there were verdicts"


@pytest.mark.parametrize("kernel", [True, False])
def test_a_current_that_is_told_to_have_changed_costs_nothing(kernel):
    """The ratio comes some blocks late, as the boards' words do; the track goes on from where it was."""
    stream = stream_of("one", 2e-7, 8, 0.6)
    weak = ROOMS[2e-7].codes * np.where(np.arange(8) == 3, 0.6, 1.0)
    change = round(0.25 / stream.site.chip_period_s)
    stream.samples[change:] = stream_of("one", 2e-7, 8, 0.6, drives=weak).samples[change:]
    track = BlockFilter(stream.site, kernel=kernel)
    poses, tracks = [], set()
    for block in stream.blocks():
        ratio = {"b3": 0.6} if block.time_s > 0.253 else {}
        poses.append(track.update(block, (), ratio))
        tracks.add(track.step.track)
    assert len(tracks) == 1
    after = [pose for pose in poses if pose.time_s > 0.26]
    assert {pose.excluded for pose in after} == {()}
    assert {pose.status for pose in after} == {Status.OK}
    rms_m, _, normal = figures(stream, after)
    assert rms_m < 18e-3
    assert normal < 1.5
    untold = followed(stream)
    assert any("b3" in pose.excluded for pose in untold), "the change is seen where it is not told"


def test_a_beacon_elsewhere_draws_no_pose_that_is_called_ok():
    stream = stream_of("one", 2e-8, 9, 0.5)
    beacons = list(stream.site.beacons)
    beacons[2] = replace(beacons[2], position_m=beacons[2].position_m + np.array([0.05, -0.03, 0.02]))
    poses = followed(stream, site=replace(stream.site, beacons=tuple(beacons)))
    moved, _ = stream.errors(poses)
    for pose, error in zip(poses[40:], moved[40:], strict=True):
        assert "b2" in pose.excluded
        assert np.linalg.norm(error) < 0.02


def test_iron_near_the_path_does_not_draw_the_pose():
    gradient = 2e-6 * np.array([[0.5, 1.0, -0.3], [1.0, -0.8, 0.6], [-0.3, 0.6, 0.3]])
    stream = stream_of("one", 2e-8, 10, 0.5, fields=lambda position: position @ gradient)
    poses = followed(stream)
    rms_m, _, normal = figures(stream, poses)
    assert rms_m < 3e-3
    assert normal < 2.0


def test_errors_of_the_survey_are_in_the_covariance():
    rng, normals = np.random.default_rng(11), []
    for seed in range(6):
        stream = stream_of("one", 2e-8, 20 + seed, 0.25)
        beacons = tuple(
            replace(b, position_m=b.position_m + 5e-3 * rng.normal(size=3), survey=Survey(position_sd_m=5e-3))
            for b in stream.site.beacons
        )
        poses = followed(stream, site=replace(stream.site, beacons=beacons))
        assert {pose.status for pose in poses} <= SOUND
        normals.append(figures(stream, poses, since=0.1)[2])
    assert 0.4 < np.mean(normals) < 1.6


def test_a_sensor_with_other_axes_is_followed():
    axes, ratio = np.array([[1.0, 0.1, 0.0], [0.0, -0.9, 0.2], [0.05, 0.0, 1.1]]), np.array([1.0, 0.6, 1.3])
    stream = stream_of("one", 2e-7, 12, 0.5)
    site = replace(stream.site, sensor=SensorSite(2e-7, axes=axes, noise_ratio=ratio))
    noise = np.random.default_rng(1).normal(size=stream.samples.shape) * 2e-7 * ratio
    quiet = stream_of("one", 2e-7, 12, 0.5).samples  # noise before the axes is that of another sensor: small
    other = Stream(site, stream.flight, quiet @ axes.T + noise)
    poses = followed(other, site=site)
    assert {pose.status for pose in poses} <= {*SOUND, Status.INCONSISTENT}
    assert figures(other, poses)[0] < 22e-3


def plane_site(half_space):
    """Six coils on the floor: a sensor above has an image below."""
    beacons = [
        replace(SITES[2e-8].beacons[k], position_m=np.array([x, y, 0.0]))
        for k, (x, y) in enumerate([(0.0, 0.0), (2.0, 0.1), (0.2, 2.1), (2.2, 2.0), (1.1, -0.4), (0.9, 2.5)])
    ]
    return site_of(beacons, half_space, 2e-8)


def test_a_half_space_decides_between_images_and_without_it_both_are_told():
    above = HalfSpace(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    site = plane_site(None)
    rng = np.random.default_rng(13)
    stream = streamed(Room(site), circling(rng, 0.5, 0.5, radius=0.2), 0.15, 2e-8, rng)
    both = followed(stream)
    assert both[-1].status is Status.AMBIGUOUS
    near = [np.linalg.norm(stream.errors([pose])[0]) for pose in (both[-1], both[-1].alternative)]
    assert min(near) < 0.01 < 0.5 < max(near)
    decided = followed(stream, site=plane_site(above))
    assert decided[-1].status is not Status.AMBIGUOUS
    assert np.linalg.norm(stream.errors(decided[-1:])[0]) < 0.01


def test_time_that_goes_back_begins_a_new_track():
    stream = stream_of("one", 2e-7, 14, 0.2)
    track, blocks = BlockFilter(stream.site), stream.blocks()
    for block in blocks[20:40]:
        track.update(block)
    pose = track.update(blocks[3])
    assert "the time went back from" in pose.reason
    assert "a new track begins" in pose.reason
    assert np.linalg.norm(stream.errors([pose])[0]) < 0.2


def test_no_data_gives_no_pose_and_noise_none_either():
    site = SITES[2e-7]
    track = BlockFilter(site)
    assert track.update(Block(0, 0, 0.003, 31, np.full((31, 3), np.nan), True)) is None
    noise = 2e-7 * np.random.default_rng(15).normal(size=(31, 3)) + 2e-5
    pose = track.update(Block(0, 0, 0.003, 31, noise, True))
    assert pose.status is Status.FAILED
    assert track.state is None
    assert track.pose_at(0.004).status is Status.FAILED
    assert track.pose_at(0.004).reason.startswith("there is no track; ")


def test_poses_at_other_times_are_extrapolated():
    stream = stream_of("one", 2e-8, 16, 0.4)
    track = BlockFilter(stream.site)
    for block in stream.blocks():
        last = track.update(block)
    state = track.state
    for ahead in (-0.002, 0.01, 0.05):
        pose = track.pose_at(last.time_s + ahead)
        assert np.linalg.norm(stream.errors([pose])[0]) < 0.004 + 0.4 * abs(ahead)
        assert (np.trace(pose.position_cov_m2) > np.trace(last.position_cov_m2)) == (ahead > 0.0)
    np.testing.assert_allclose(track.pose_at(last.time_s).position_m, state.position_m)
    position, rotation = stream.flight.poses(np.array([last.time_s - 1e-3, last.time_s + 1e-3]))
    assert np.linalg.norm((position[1] - position[0]) / 2e-3 - state.velocity_m_s) < 0.2
    assert np.linalg.norm((rotation[1] * rotation[0].inv()).as_rotvec() / 2e-3 - state.rate_rad_s) < 0.3
    turned = Rotation.from_matrix(state.rotation) * Rotation.from_quat(last.orientation_xyzw).inv()
    assert turned.magnitude() < 1e-6


def test_a_track_that_is_elsewhere_is_found_out(monkeypatch):
    """A bank that learns nothing from its blocks and is sure of a wrong place near by."""
    stream = stream_of("still", 2e-7, 17, 0.5)
    track, blocks = BlockFilter(stream.site, kernel=False), stream.blocks()
    for block in blocks[:40]:
        track.update(block)
    pair = track._banks[0]
    for bank in (pair._seeing, pair._alone):
        bank._motion = bank._motion.moved(np.repeat([0.06, 0.0], [3, 15]))
        bank._merged = None
    pair._apart = None
    monkeypatch.setattr(pair, "update", lambda form, seconds: True)
    poses = [track.update(block) for block in blocks[40:]]
    moved, _ = stream.errors(poses)
    assert np.linalg.norm(moved[0]) > 0.08
    assert np.linalg.norm(moved[-20:], axis=1).max() < 0.03


@pytest.mark.parametrize("name", ["one", "drone"])
def test_protection_levels_hold_the_errors_of_fast_motion(name):
    stream = stream_of(name, 2e-8, 18, 0.5)
    poses = [pose for pose in followed(stream) if pose.status is Status.OK]
    moved, _ = stream.errors(poses)
    assert len(poses) > 150
    assert (np.linalg.norm(moved, axis=1) < [pose.protection_m for pose in poses]).all()
    assert np.median([pose.protection_m for pose in poses]) < 0.05


def test_a_smooth_manoeuvre_draws_no_pose_that_is_called_ok():
    """A filter that expects less agility falls behind for a while: with no other near it, it was believed."""
    site = prigge_cube(2e-8)
    track = World(site).motion_track(motion_of("0.5 m/s, 0.5 rad/s", 8), 1.6, np.random.default_rng([8, 10]), 2e-8)
    errors = follow(track, BlockFilter(site)).after(0.5)
    assert errors.share_ok > 0.99
    assert not errors.unsaid.any()

"""From fields to poses: success with no prior, honest uncertainty, statuses; the fields are magpylib's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.locate import Locator, locate
from goldfield.locate.constellation import Constellation
from goldfield.types import Fields, Status
from tests.bench import locate_trials as bench


def judge(site, run):
    """Locate all; returns poses, errors, bounds and whether each failed in the sense of maths.md, 3."""
    poses = Locator(site).locate_many(bench.fields_of(site, run))
    error = np.array([pose.position_m for pose in poses]) - run.position_m
    bound = bench.bound_of(site, run)
    size = np.linalg.norm(error, axis=1)
    return poses, error, bound, ~(size <= np.maximum(0.01, 8 * bound))


@pytest.mark.parametrize(("noise", "size"), [(2e-7, 1.0), (2e-7, 1.5), (2e-7, 2.0), (2e-8, 1.0)])
def test_cube_with_no_prior(noise, size):
    site = bench.prigge_cube(noise)
    rng = np.random.default_rng(41)
    run = bench.trials(site, bench.cube_positions(rng, 400, size), rng)
    poses, error, bound, failed = judge(site, run)
    assert not failed.any()
    assert np.sqrt(np.mean(np.sum(error**2, axis=1) / bound**2)) < 1.1
    position = np.array([pose.position_cov_m2 for pose in poses])
    attitude = np.array([pose.attitude_cov_rad2 for pose in poses])
    turn = bench.turn_error(run.rotation, Rotation.from_quat([p.orientation_xyzw for p in poses]).as_matrix())
    assert 0.8 < bench.normalised_error(error, position).mean() < 1.3
    assert 0.8 < bench.normalised_error(turn, attitude).mean() < 1.3
    assert np.mean([pose.residual**2 for pose in poses]) == pytest.approx(1.0, abs=0.06)
    fitting = [pose for pose in poses if pose.status in (Status.OK, Status.UNVERIFIED)]
    assert len(fitting) >= 0.95 * len(poses)
    assert all((pose.status is Status.OK) == (pose.protection_m <= site.alert_limit_m) for pose in fitting)
    assert all(pose.orientation_xyzw[3] >= 0 for pose in poses)


def test_one_by_one_is_the_same_as_many():
    site = bench.prigge_cube()
    rng = np.random.default_rng(42)
    fields = bench.fields_of(site, bench.trials(site, bench.cube_positions(rng, 8), rng))
    fields[3] = Fields(3, 0.3, fields[3].beacons[:5], fields[3].field_T[:5], fields[3].sigma_T[:5])
    many = Locator(site).locate_many(fields)
    for pose, epoch in zip(many, fields, strict=True):
        alone = locate(site, epoch)
        assert (pose.epoch, pose.time_s, pose.used) == (epoch.epoch, epoch.time_s, epoch.beacons)
        np.testing.assert_allclose(alone.position_m, pose.position_m, atol=1e-6)
        np.testing.assert_allclose(alone.orientation_xyzw, pose.orientation_xyzw, atol=1e-6)


def test_lattice_mirror_is_resolved_by_the_half_space():
    site = bench.ceiling_lattice()
    rng = np.random.default_rng(43)
    run = bench.nearest_only(site, bench.trials(site, bench.lattice_positions(rng, 150), rng))
    poses, error, bound, failed = judge(site, run)
    assert not failed.any()
    assert all(pose.status in (Status.OK, Status.UNVERIFIED, Status.WEAK) for pose in poses)
    assert np.sqrt(np.mean(np.sum(error**2, axis=1) / bound**2)) < 1.15


def test_lattice_mirror_is_reported_without_a_half_space():
    site = bench.ceiling_lattice(half_space=False)
    rng = np.random.default_rng(44)
    run = bench.nearest_only(site, bench.trials(site, bench.lattice_positions(rng, 60), rng))
    poses, _, bound, _ = judge(site, run)
    for pose, truth, attitude, limit in zip(poses, run.position_m, run.rotation, bound, strict=True):
        assert pose.status is Status.AMBIGUOUS
        assert pose.alternative is not None
        both = [pose, pose.alternative]
        near = min(both, key=lambda p: np.linalg.norm(p.position_m - truth))
        other = both[1] if near is both[0] else both[0]
        assert np.linalg.norm(near.position_m - truth) < 8 * limit
        assert (
            np.linalg.norm(
                bench.turn_error(attitude[None], Rotation.from_quat(near.orientation_xyzw).as_matrix()[None])
            )
            < 0.3
        )
        np.testing.assert_allclose(other.position_m, near.position_m * [1, 1, -1] + [0, 0, 5.4], atol=1e-6)
        np.testing.assert_allclose(
            other.position_cov_m2[2, :2], -near.position_cov_m2[2, :2], atol=1e-3 * np.abs(near.position_cov_m2).max()
        )


def test_tilted_axes_break_the_mirror():
    rng = np.random.default_rng(45)
    places = [(x, y, 2.0) for x in (0.0, 2.0) for y in (0.0, 2.0)]
    axes = [(0, 0, 1.0), (1.0, 0, 0), (0, 1.0, 0), (0.6, 0, 0.8)]
    site = bench.site_of([bench.loop_beacon(i, places[i], axes[i]) for i in range(4)], noise_T=2e-8)
    run = bench.trials(site, rng.uniform([0.2, 0.2, 0.5], [1.8, 1.8, 1.5], size=(60, 3)), rng)
    poses, _, _, failed = judge(site, run)
    assert not failed.any()
    assert sum(pose.status is Status.OK for pose in poses) >= 57


def test_coils_around_one_point_leave_the_antipode():
    """B(-r) = B(r): three orthogonal coils in one place cannot tell the sides."""
    rng = np.random.default_rng(57)
    site = bench.site_of([bench.loop_beacon(i, (0.5, 0.2, 0.1), np.eye(3)[i]) for i in range(3)], noise_T=2e-8)
    middle = np.array([0.5, 0.2, 0.1])
    run = bench.trials(site, middle + rng.uniform(0.3, 0.8, size=(10, 3)), rng)
    for pose, truth in zip(Locator(site).locate_many(bench.fields_of(site, run)), run.position_m, strict=True):
        assert pose.status is Status.AMBIGUOUS
        np.testing.assert_allclose(pose.position_m + pose.alternative.position_m, 2 * middle, atol=1e-6)
        assert min(np.linalg.norm(p.position_m - truth) for p in (pose, pose.alternative)) < 0.02


def test_three_beacons_of_mixed_axes_and_moments():
    rng = np.random.default_rng(46)
    site = bench.site_of(
        [
            bench.loop_beacon(0, (0.0, 0.0, 0.0), (1.0, 0.2, 0.1), current=10.0),
            bench.loop_beacon(1, (2.0, 0.0, 0.4), (0.0, 1.0, 0.3), current=-5.0),
            bench.loop_beacon(2, (0.3, 2.0, 1.1), (0.1, 0.0, 1.0), current=8.0),
        ],
        noise_T=2e-8,
    )
    run = bench.trials(site, rng.uniform([0.3, 0.3, 0.3], [1.6, 1.6, 1.5], size=(60, 3)), rng)
    poses, _, bound, failed = judge(site, run)
    for pose, truth, limit, wrong in zip(poses, run.position_m, bound, failed, strict=True):
        if wrong:  # nine numbers for six unknowns may have two answers: then both are given
            assert pose.status is Status.AMBIGUOUS
            assert np.linalg.norm(pose.alternative.position_m - truth) < max(0.01, 8 * limit)
    assert failed.sum() <= 6


@pytest.mark.parametrize("axes", [(2,), (0, 2)])
def test_spiral_coils_and_a_sensor_with_fewer_axes(axes):
    site = bench.spiral_board()
    rng = np.random.default_rng(47)
    run = bench.trials(site, bench.board_positions(rng, 20), rng, axes=axes)
    poses, error, bound, failed = judge(site, run)
    assert not failed.any()
    for pose, rotation in zip(poses, run.rotation, strict=True):
        estimate = Rotation.from_quat(pose.orientation_xyzw).as_matrix()
        for axis in axes:
            assert estimate[:, axis] @ rotation[:, axis] > 0.999
    assert np.sqrt(np.mean(np.sum(error**2, axis=1) / bound**2)) < 1.3


def test_two_answers_of_a_sensor_with_one_axis_are_both_given():
    """Eight numbers, five unknowns and much noise: other poses fit as well, or better."""
    site = bench.spiral_board()
    rng = np.random.default_rng(47)
    run = bench.trials(site, bench.board_positions(rng, 40), rng, sigma_T=25e-9, axes=(2,))
    poses, _, bound, failed = judge(site, run)
    assert failed.any()
    for e in np.flatnonzero(failed):
        assert poses[e].status is Status.AMBIGUOUS
        assert np.linalg.norm(poses[e].alternative.position_m - run.position_m[e]) < max(0.01, 8 * bound[e])


def test_what_cannot_be_located_says_failed():
    site = bench.prigge_cube()
    nothing = Fields(1, 0.1, (), np.zeros((0, 3)), np.zeros(0))
    two = Fields(2, 0.2, ("b0", "b1"), np.full((2, 3), 1e-6), np.full(2, 1e-9))
    gone = Fields(3, 0.3, tuple(f"b{i}" for i in range(8)), np.full((8, 3), np.nan), np.full(8, 1e-9))
    infinite = Fields(4, 0.4, tuple(f"b{i}" for i in range(8)), np.full((8, 3), np.inf), np.full(8, 1e-9))
    strangers = Fields(5, 0.5, ("x", "y", "z"), np.full((3, 3), 1e-6), np.full(3, 1e-9))
    for fields in (nothing, two, gone, infinite, strangers):
        pose = locate(site, fields)
        assert pose.status is Status.FAILED
        assert pose.epoch == fields.epoch
        assert np.isnan(pose.position_m).all()
        assert np.isnan(pose.orientation_xyzw).all()


def nothing_but(site, field, sigma=6e-9):
    return locate(site, Fields(0, 0.0, tuple(b.id for b in site.beacons), field, np.full(len(field), sigma)))


@pytest.mark.parametrize("beacons", [3, 4, 8])
def test_noise_alone_and_silence_fail(beacons):
    site = bench.prigge_cube(keep=range(8 - beacons, 8))
    rng = np.random.default_rng(48)
    assert nothing_but(site, np.zeros((beacons, 3))).status is Status.FAILED
    for _ in range(50):
        noise = 6e-9 * rng.normal(size=(beacons, 3))
        assert nothing_but(site, noise).status is Status.FAILED
        noise[1, 1] = 1.0  # one beacon, however strong, is no pose
        assert nothing_but(site, noise).status is Status.FAILED


def test_poses_on_the_way_out_are_ok_then_weak_then_failed():
    site, rng = bench.prigge_cube(), np.random.default_rng(53)
    away = rng.normal(size=(200, 3))
    away *= rng.uniform(3.0, 8.0, size=(200, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    run = bench.trials(site, np.array([1.065, 1.065, 0.9]) + away, rng)
    poses = Locator(site).locate_many(bench.fields_of(site, run))
    share = bench.bound_of(site, run) / np.linalg.norm(
        run.position_m[:, None] - [b.position_m for b in site.beacons], axis=2
    ).min(axis=1)
    failed = np.array([pose.status is Status.FAILED for pose in poses])
    assert not failed[share < 0.15].any()
    assert failed[share > 1.0].mean() > 0.9
    assert sum(pose.status is Status.WEAK for pose in poses) >= 3


def test_a_spike_is_never_ok():
    site, rng = bench.prigge_cube(), np.random.default_rng(48)
    run = bench.trials(site, np.array([[1.0, 1.2, 0.8]]), rng)
    field = run.field_T[0].copy()
    field[:, 1] = 1.0
    assert nothing_but(site, field).status is not Status.OK


def test_what_ended_for_want_of_iterations_is_weak_and_never_inconsistent(monkeypatch):
    """A fit that the cap ended proves nothing, however large its cost."""
    site, rng = bench.prigge_cube(), np.random.default_rng(54)
    run = bench.trials(site, bench.cube_positions(rng, 3), rng)
    solve = Constellation.solve

    def ended(self, measurements):
        solutions = solve(self, measurements)
        solutions.best.cost[:] = 1e6
        return replace(solutions, bounded=np.ones(len(measurements), dtype=bool))

    monkeypatch.setattr(Constellation, "solve", ended)
    for pose in Locator(site).locate_many(bench.fields_of(site, run)):
        assert pose.status is Status.WEAK


def test_far_away_is_weak():
    site = bench.prigge_cube()
    rng = np.random.default_rng(49)
    run = bench.trials(site, np.array([[3.8, 3.8, 2.0], [9.0, 9.0, 3.0]]), rng)
    weak, failed = Locator(site).locate_many(bench.fields_of(site, run))
    assert weak.status in (Status.WEAK, Status.AMBIGUOUS)
    assert failed.status is Status.FAILED  # .01 mG a beacon, of .0625 mG of noise

"""Faults of one beacon: detected, the right one excluded, the pose as good as without it; few false alarms."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.locate import Locator
from goldfield.types import Status
from tests.bench import locate_trials as bench


@pytest.mark.parametrize(("kind", "row"), list(zip(bench.FAULTS, (5, 7, 0, 3, 4, 6), strict=True)))
def test_a_faulty_beacon_is_found_and_left_out(kind, row):
    site = bench.prigge_cube()
    rng = np.random.default_rng(51)
    run = bench.trials(site, bench.cube_positions(rng, 60), rng)
    faulty = bench.with_fault(kind, site, run, rng, row)
    bad = np.linalg.norm(faulty.field_T[:, row] - run.field_T[:, row], axis=1) / run.sigma_T[:, row] > 30.0
    poses = Locator(site).locate_many(bench.fields_of(site, faulty))
    bound = bench.bound_of(site, run, without=row)
    error = np.linalg.norm(np.array([pose.position_m for pose in poses]) - run.position_m, axis=1)
    right = np.array([pose.excluded == (site.beacons[row].id,) for pose in poses])
    assert bad.sum() >= 6
    assert right[bad].mean() >= 0.9
    assert np.sqrt(np.mean((error[right] / bound[right]) ** 2)) < 1.25
    assert all(site.beacons[row].id not in pose.used for pose in np.array(poses, dtype=object)[right])


def test_false_alarms_are_rare():
    site = bench.prigge_cube()
    rng = np.random.default_rng(52)
    run = bench.trials(site, bench.cube_positions(rng, 1000), rng)
    poses = Locator(site).locate_many(bench.fields_of(site, run))
    assert sum(bool(pose.excluded) or pose.status is Status.INCONSISTENT for pose in poses) <= 4


def test_two_faulty_beacons_are_left_out_too():
    site = bench.prigge_cube()
    rng = np.random.default_rng(53)
    run = bench.trials(site, bench.cube_positions(rng, 20, 0.6), rng)
    faulty = bench.with_fault("polarity", site, bench.with_fault("dead", site, run, rng, 2), rng, 6)
    poses = Locator(site).locate_many(bench.fields_of(site, faulty))
    assert sum(set(pose.excluded) == {"b2", "b6"} for pose in poses) >= 17


def test_no_agreement_is_inconsistent():
    site = bench.prigge_cube()
    rng = np.random.default_rng(54)
    run = bench.trials(site, bench.cube_positions(rng, 5), rng)
    shuffled = bench.Trials(run.position_m, run.rotation, run.field_T[:, rng.permutation(8)], run.sigma_T)
    for pose in Locator(site).locate_many(bench.fields_of(site, shuffled)):
        assert pose.status is Status.INCONSISTENT
        assert pose.residual > 3.0


def test_protection_level_covers_undetected_faults():
    """A fault as large as goes unnoticed moves the position less than the protection level."""
    site = bench.prigge_cube()
    rng = np.random.default_rng(55)
    run = bench.trials(site, bench.cube_positions(rng, 30, 0.8), rng)
    checked = 0
    for share in (0.98, 0.95, 0.9, 0.8):
        weaker = run.field_T.copy()
        weaker[:, 1] *= share
        epochs = bench.fields_of(site, bench.Trials(run.position_m, run.rotation, weaker, run.sigma_T))
        for pose, truth in zip(Locator(site).locate_many(epochs), run.position_m, strict=True):
            if pose.status is Status.OK and not pose.excluded:
                assert np.linalg.norm(pose.position_m - truth) < pose.protection_m
                checked += 1
    assert checked >= 30


def test_protection_level_without_redundancy_is_infinite():
    """Three beacons on two axes: six numbers for six unknowns."""
    site = bench.prigge_cube(noise_T=2e-8, keep=(0, 3, 5))
    rng = np.random.default_rng(56)
    run = bench.trials(site, bench.cube_positions(rng, 3, 0.6), rng, axes=(0, 1))
    locator = Locator(site)
    for fields in bench.fields_of(site, run):
        pose = locator.locate(fields)
        assert pose.status is not Status.FAILED
        assert pose.status is not Status.OK
        assert pose.protection_m == np.inf

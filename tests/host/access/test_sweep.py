"""The ambient ramp from successive means; samples of a turning sensor by magpylib and shift registers."""

from dataclasses import replace

import numpy as np
import pytest

from goldfield.access import Separator
from goldfield.access.moving import DriftSeparator
from goldfield.access.sweep import SweepRepair
from goldfield.track import Tracker
from goldfield.types import Fields
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Room, circling, epoch_bound, flight_poses

NOISE_T = 2e-7
SITE = prigge_cube(NOISE_T)
IDS = tuple(beacon.id for beacon in SITE.beacons)
SIGMA_T = NOISE_T / np.sqrt(1023)


@pytest.fixture(scope="module")
def turning():
    """Fields and means of a sensor at 1 m/s and 1 rad/s, and the fields of samples without ramp and curve."""
    rng = np.random.default_rng(21)
    flight, room = circling(rng, 1.0, 1.0), Room(SITE)
    plain, drift = Separator(10, SITE.codes, NOISE_T), DriftSeparator(10, SITE.codes, NOISE_T)
    epochs, means, wanted = [], [], []
    for k in range(30):
        samples = room.samples(flight, k * SITE.cycle_s, NOISE_T, rng)
        separation = plain.from_samples(samples)
        epochs.append(Fields(k, k * SITE.cycle_s, IDS, separation.field_T, separation.sigma_T))
        means.append(samples.mean(axis=0))
        wanted.append(drift.from_samples(samples).field_T)
    return flight, epochs, means, wanted


def test_the_ramp_goes_and_the_rest_stays(turning):
    _, epochs, means, wanted = turning
    repair = SweepRepair(SITE)
    repaired = [repair.repaired(fields, mean) for fields, mean in zip(epochs, means, strict=True)]
    assert [fields.sweep_T_s is None for fields in repaired] == [True] * 2 + [False] * 28
    before = [np.abs(fields.field_T - field).max() for fields, field in zip(epochs[2:], wanted[2:], strict=True)]
    after = [np.abs(fields.field_T - field).max() for fields, field in zip(repaired[2:], wanted[2:], strict=True)]
    assert np.median(before) > 3 * SIGMA_T
    assert max(after) < SIGMA_T
    assert all(0.0 < fields.sweep_T_s < 5e-6 for fields in repaired[2:])


def test_tracking_gains_by_it(turning):
    flight, epochs, means, _ = turning
    repair, tracker = SweepRepair(SITE), Tracker(SITE)
    ratio = []
    for fields, mean in zip(epochs, means, strict=True):
        pose = tracker.update(repair.repaired(fields, mean))
        error = np.linalg.norm(pose.position_m - flight_poses(flight, fields.time_s)[0])
        ratio.append(error / epoch_bound(SITE, flight, fields.time_s))
    assert np.sqrt(np.mean(np.square(ratio[3:]))) < 1.15


def test_what_is_missing_needs_three_more_cycles(turning):
    _, epochs, means, _ = turning
    repair = SweepRepair(SITE)
    given = list(zip(epochs[:16], means[:16], strict=True))
    given[4] = (given[4][0], None)
    given[8] = (given[8][0], np.array([np.nan, 0.0, 0.0]))
    given[12] = (replace(given[12][0], time_s=float("nan")), given[12][1])
    known = [repair.repaired(fields, mean).sweep_T_s is not None for fields, mean in given]
    assert known == [False, False, True, True] + [False, False, False, True] * 3
    del given[2]
    repair = SweepRepair(SITE)
    assert [repair.repaired(f, m).sweep_T_s is None for f, m in given[:3]] == [True] * 3, "a cycle is missing"


def test_lost_fields_and_an_axis_less(turning):
    _, epochs, means, wanted = turning
    repair = SweepRepair(SITE)
    for fields, mean in zip(epochs[:6], means[:6], strict=True):
        part = fields.field_T[:7].copy()
        part[:, 1] = np.nan
        out = repair.repaired(
            Fields(fields.epoch, fields.time_s, IDS[:7], part, fields.sigma_T[:7]), mean * [1, np.nan, 1]
        )
    assert out.sweep_T_s is not None
    assert np.isnan(out.field_T[:, 1]).all()
    np.testing.assert_allclose(out.field_T[:, [0, 2]], wanted[5][:7, [0, 2]], atol=1.5 * SIGMA_T)


def test_a_sensor_at_rest_loses_nothing():
    rng = np.random.default_rng(22)
    room, flight = Room(SITE), circling(rng, 0.0, 0.0)
    plain, repair = Separator(10, SITE.codes, NOISE_T), SweepRepair(SITE)
    for k in range(4):
        samples = room.samples(flight, k * SITE.cycle_s, NOISE_T, rng)
        field = plain.from_samples(samples).field_T
        out = repair.repaired(Fields(k, k * SITE.cycle_s, IDS, field, np.full(8, SIGMA_T)), samples.mean(axis=0))
        np.testing.assert_allclose(out.field_T, field, atol=0.1 * SIGMA_T)


def test_sites_without_plain_codes_are_left_alone():
    site = replace(SITE, beacons=tuple(replace(beacon, code=-1) for beacon in SITE.beacons))
    repair = SweepRepair(site)
    fields = Fields(0, 0.0, IDS, np.ones((8, 3)), np.ones(8))
    assert repair.repaired(fields, np.ones(3)) is fields

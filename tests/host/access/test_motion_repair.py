"""Fields of a moving sensor as those of the middle of each cycle; samples by magpylib and shift registers."""

from dataclasses import replace

import magpylib
import numpy as np
import pytest

from goldfield.access import Separator
from goldfield.access.motion_repair import MotionRepair
from goldfield.access.sweep import SweepRepair
from goldfield.sensor.location import location
from goldfield.sensor.options import Method
from goldfield.types import Fields, Status
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Room, circling, flight_poses

NOISE_T = 2e-8
"""0.2 mG."""
SITE = prigge_cube(NOISE_T)
IDS = tuple(beacon.id for beacon in SITE.beacons)
SIGMA_T = NOISE_T / np.sqrt(1023)


def followed(seed, speed, rate, noise_T, count=40):
    """Return fields of a circling sensor, without the ambient ramp, and the true fields of the middle of each cycle."""
    rng = np.random.default_rng(seed)
    flight, room = circling(rng, speed, rate), Room(SITE)
    separator, sweep = Separator(10, SITE.codes, NOISE_T), SweepRepair(SITE)
    epochs, true = [], []
    for k in range(count):
        time = k * SITE.cycle_s
        samples = room.samples(flight, time, noise_T, rng)
        separation = separator.from_samples(samples)
        raw = Fields(k, time, IDS, separation.field_T, separation.sigma_T)
        epochs.append(sweep.repaired(raw, samples.mean(axis=0)))
        position, rotation = flight_poses(flight, time)
        true.append(rotation.inv().apply(magpylib.getB(room.coils, position, squeeze=False)[:, 0, 0, 0]))
    return flight, epochs, np.array(true)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_fields_are_those_of_the_middle(seed):
    """Without noise: what is left is the third derivative of the fields, and that of the ambient one."""
    _, epochs, true = followed(seed, 0.5, 1.0, 0.0)
    repair = MotionRepair(SITE)
    repaired = np.array([repair.repaired(fields).field_T for fields in epochs])
    before = np.sqrt(np.mean((np.array([fields.field_T for fields in epochs])[3:] - true[3:]) ** 2))
    after = np.sqrt(np.mean((repaired[3:] - true[3:]) ** 2))
    assert before > 0.4 * SIGMA_T
    assert after < 0.35 * before


def test_a_weak_beacon_that_comes_or_goes_leaves_the_others_their_repair():
    """As where a sensor reports the strongest: each change cost all of them the repair of two cycles."""
    _, epochs, true = followed(1, 0.5, 1.0, 0.0)
    weakest = int(np.argmin(np.linalg.norm(true, axis=2).max(axis=0)))
    rest = np.delete(np.arange(len(IDS)), weakest)
    names, order = tuple(IDS[row] for row in rest), rest[::-1]
    repair, others = MotionRepair(SITE), MotionRepair(SITE)
    left = []
    for k, fields in enumerate(epochs):
        apart = np.array([*order, weakest]) if k % 2 else order
        some = replace(
            fields,
            beacons=tuple(IDS[row] for row in apart),
            field_T=fields.field_T[apart],
            sigma_T=fields.sigma_T[apart],
        )
        mended = repair.repaired(some)
        whole = others.repaired(
            replace(fields, beacons=names, field_T=fields.field_T[rest], sigma_T=fields.sigma_T[rest])
        )
        if k >= 3:
            left.append(mended.field_T[: len(order)][::-1] - whole.field_T)
    assert np.sqrt(np.mean(np.square(left))) < 0.1 * SIGMA_T


def test_noise_is_not_larger_at_rest():
    _, epochs, true = followed(4, 0.0, 0.0, NOISE_T, count=60)
    repair = MotionRepair(SITE)
    repaired = np.array([repair.repaired(fields).field_T for fields in epochs])
    assert np.sqrt(np.mean((repaired[3:] - true[3:]) ** 2)) / SIGMA_T == pytest.approx(1.0, abs=0.06)


def test_poses_of_single_epochs_are_honest_while_the_sensor_moves():
    square, sound = [], []
    for seed in range(5, 9):
        flight, epochs, _ = followed(seed, 0.5, 1.0, NOISE_T)
        locate, repair = location(SITE, Method.EACH), MotionRepair(SITE)
        for fields in epochs:
            pose = locate(repair.repaired(fields), None)
            if fields.epoch < 3:
                continue
            off = pose.position_m - flight_poses(flight, fields.time_s)[0]
            square.append(off @ np.linalg.solve(pose.position_cov_m2, off) / 3.0)
            sound.append(pose.status is Status.OK)
    assert np.mean(sound) > 0.98
    assert 0.7 < np.mean(square) < 1.3


def test_what_does_not_follow_or_jumps_is_left_as_it_came():
    _, epochs, _ = followed(9, 0.5, 1.0, 0.0, count=12)

    def changed(given):
        repair = MotionRepair(SITE)
        return [repair.repaired(fields) is not fields for fields in given]

    assert changed(epochs) == [False] * 2 + [True] * 10
    assert changed(epochs[:4] + epochs[5:]) == [False, False, True, True, False, False] + [True] * 5
    less = replace(epochs[4], beacons=IDS[1:], field_T=epochs[4].field_T[1:], sigma_T=epochs[4].sigma_T[1:])
    assert changed([*epochs[:4], less, *epochs[5:8]]) == [False] * 2 + [True] * 6
    lost = epochs[4].field_T.copy()
    lost[2] = np.nan
    assert changed([*epochs[:4], replace(epochs[4], field_T=lost), *epochs[5:8]]) == [False] * 2 + [True] * 6
    flat = np.where([True, True, False], epochs[4].field_T, np.nan)
    other_axes = changed([*epochs[:4], replace(epochs[4], field_T=flat), *epochs[5:9]])
    assert other_axes == [False] * 2 + [True] * 2 + [False] * 3 + [True] * 2
    elsewhere = replace(epochs[4], beacons=tuple(f"{name}'" for name in IDS))
    repair = MotionRepair(SITE)
    for fields in epochs[:4]:
        repair.repaired(fields)
    assert repair.repaired(elsewhere) is elsewhere
    jumped = epochs[4].field_T.copy()
    jumped[2] *= 2.0
    assert changed([*epochs[:4], replace(epochs[4], field_T=jumped), *epochs[5:9]])[4:] == [False] * 3 + [True] * 2
    other = replace(SITE, beacons=tuple(replace(beacon, code=-1) for beacon in SITE.beacons))
    repair = MotionRepair(other)
    assert all(repair.repaired(fields) is fields for fields in epochs)

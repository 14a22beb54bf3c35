"""A moving sensor among coils that follow their codes slowly, time slots and tones: drives written down here."""

from dataclasses import replace

import numpy as np
import pytest

from goldfield.access import Separator, SiteAccess
from goldfield.sensor.on_sensor import on_sensor_parameters
from goldfield.site.drive import NO_CODE, Drive
from goldfield.track import CycleData, CycleObserver, Tracker, tracked
from goldfield.types import Fields, Status
from goldfield_protocol.parameters import PARAMETERS
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Room, circling, flight_poses

N, CYCLE_COUNT = 1023, 12
NOISE_T = 2e-8
CUBE = prigge_cube(NOISE_T)
TAU_CHIPS = 0.8
CODES = Room(CUBE).codes.astype(float)
PERIODS = (1, 2, 3, 4, 6, 7, 8, 9)


def risen(drives):
    """The current at the ends of the chips, chip by chip, from ten chips before the cycle."""
    e = np.exp(-1.0 / TAU_CHIPS)
    current, rows = drives[-30].copy(), []
    for drive in np.concatenate([drives[-29:], drives]):
        current = e * current + (1.0 - e) * drive
        rows.append(current)
    return np.array(rows)[29:]


def site_with(drives, access="cdma", slots=0):
    beacons = tuple(
        replace(beacon, drive=drive, code=beacon.code if access == "cdma" else NO_CODE)
        for beacon, drive in zip(CUBE.beacons, drives, strict=True)
    )
    return replace(CUBE, beacons=beacons, access=access, slots=slots)


SLOW = site_with([Drive(tau_s=TAU_CHIPS * CUBE.chip_period_s)] * 8)
WAYS = {
    "slow": (SLOW, risen(CODES), 1.0),
    "slots": (
        site_with([Drive(slot=k) for k in range(8)], "tdma", 9),
        np.arange(N)[:, None] // 113 == np.arange(8),
        0.0,
    ),
    "tones": (
        site_with([Drive(periods=k) for k in PERIODS], "fdma"),
        np.cos(2.0 * np.pi * np.outer(np.arange(N), PERIODS) / N),
        0.0,
    ),
    "rotating": (
        site_with([Drive(periods=k, wave=wave) for k in (2, 3, 4, 6) for wave in ("cosine", "sine")], "fdma"),
        np.stack([wave(2.0 * np.pi * k * np.arange(N) / N) for k in (2, 3, 4, 6) for wave in (np.cos, np.sin)], axis=1),
        0.0,
    ),
}


def flown(name):
    """Site, flight and cycles of samples; turning only where the ambient field's sweep can be taken out."""
    site, drives, rate = WAYS[name]
    flight = circling(np.random.default_rng(5), speed=1.0, rate=rate)
    room, rng = Room(CUBE), np.random.default_rng(6)
    room.codes = drives
    ids = tuple(beacon.id for beacon in site.beacons)
    return site, flight, [
        CycleData(k, k * site.cycle_s, ids, room.samples(flight, k * site.cycle_s, NOISE_T, rng))
        for k in range(CYCLE_COUNT)
    ]  # fmt: skip


def errors(poses, flight):
    return np.array([np.linalg.norm(pose.position_m - flight_poses(flight, pose.time_s)[0]) for pose in poses])


def normalised(poses, flight):
    apart = [pose.position_m - flight_poses(flight, pose.time_s)[0] for pose in poses]
    return np.mean([e @ np.linalg.solve(p.position_cov_m2, e) / 3 for e, p in zip(apart, poses, strict=True)])


@pytest.mark.parametrize("name", ["slots", "tones", "rotating"])
def test_separated_fields_of_a_moving_sensor(name):
    site, flight, data = flown(name)
    access = SiteAccess(site)
    epochs = []
    for cycle in data:
        s = access.from_samples(cycle.data_T)
        epochs.append(Fields(cycle.epoch, cycle.time_s, cycle.beacons, s.field_T, s.sigma_T))
    poses = list(tracked(site, epochs))
    assert {pose.status for pose in poses} == {Status.OK}
    assert errors(poses[3:], flight).max() < 0.006
    assert normalised(poses[3:], flight) < 4.0


def test_sums_and_samples_of_slow_coils():
    """What a sensor sends: sums with the plain codes; and samples of a coil that is known to be slow, or is not."""
    site, flight, data = flown("slow")
    separator = Separator(10, site.codes, NOISE_T, [TAU_CHIPS] * 8)
    epochs = []
    for cycle in data:
        s = separator.from_correlations(CODES.T @ cycle.data_T / N, cycle.data_T.mean(axis=0), np.zeros(8))
        epochs.append(Fields(cycle.epoch, cycle.time_s, cycle.beacons, s.field_T, s.sigma_T))
    whole = list(tracked(site, epochs))
    assert errors(whole[3:], flight).max() < 0.02
    for known, limit in ((SLOW, True), (CUBE, False)):
        tracker = Tracker(known, CycleObserver(known))
        poses = [tracker.update(cycle) for cycle in data]
        assert (errors(poses[3:], flight).max() < 0.003) == limit
        assert ({pose.status for pose in poses} == {Status.OK}) == limit


def test_a_sensor_s_own_poses_know_slow_coils_as_weaker_ones():
    """The parts of the drives in the correlations, against correlations of the current written down here."""
    names = {PARAMETERS["beacons"].identifier(8 * row + 6): row for row in range(8)}
    quick, slow = on_sensor_parameters(CUBE), on_sensor_parameters(SLOW)
    current = WAYS["slow"][1]
    for identifier, row in names.items():
        chips = CODES[:, row]
        part = chips @ (current[:, row] - chips.mean()) / (chips @ (chips - chips.mean()))
        assert slow[identifier] / quick[identifier] == pytest.approx(part, rel=1e-9)
        assert part == pytest.approx(1.0 - np.exp(-1.0 / TAU_CHIPS), abs=0.05)

"""Poses from blocks among coils that follow slowly, superposed codes, time slots, tones and other degrees."""

from dataclasses import replace

import numpy as np
import pytest

from goldfield.site.drive import NO_CODE, Code, Drive
from goldfield.track.blocks import BlockFilter
from goldfield.types import Status
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Room, circling
from tests.host.track.blocks.flights import streamed

N, NOISE_T = 1023, 2e-8
CUBE = prigge_cube(NOISE_T)
CODES = Room(CUBE).codes.astype(float)
TAU_CHIPS = 0.8
PERIODS = (60, 75, 90, 105, 120, 135, 150, 165)
SLOW_PERIODS = (1, 2, 3, 4, 6, 7, 8, 9)


def risen(drives):
    e, current, rows = np.exp(-1.0 / TAU_CHIPS), drives[0], []
    for drive in np.concatenate([drives, drives]):
        current = e * current + (1.0 - e) * drive
        rows.append(current)
    return np.array(rows)[N:]


def site_with(drives, access="cdma", slots=0):
    plain = all(not drive.codes and drive.slot is None and drive.periods is None for drive in drives)
    beacons = tuple(
        replace(beacon, drive=drive, code=beacon.code if plain else NO_CODE)
        for beacon, drive in zip(CUBE.beacons, drives, strict=True)
    )
    return replace(CUBE, beacons=beacons, access=access, slots=slots)


def turns(periods):
    return 2.0 * np.pi * np.outer(np.arange(N), periods) / N


WAYS = {
    "slow": (site_with([Drive(tau_s=TAU_CHIPS * CUBE.chip_period_s)] * 8), risen(CODES), 1.0, 1, 4e-3),
    "superposed": (
        site_with([Drive(codes=(Code(k + 2, 10), Code(k + 2, 10, offset=500))) for k in range(8)]),
        0.5 * (CODES + np.roll(CODES, -500, axis=0)),
        1.0,
        1,
        5e-3,
    ),
    "tones": (site_with([Drive(periods=k) for k in PERIODS], "fdma"), np.cos(turns(PERIODS)), 1.0, 3, 5e-3),
    "crossed": (
        site_with([Drive(periods=k, wave=wave) for k in PERIODS[::2] for wave in ("cosine", "sine")], "fdma"),
        np.stack([wave(turns([k]))[:, 0] for k in PERIODS[::2] for wave in (np.cos, np.sin)], axis=1),
        1.0,
        3,
        5e-3,
    ),
    "slots": (
        site_with([Drive(slot=k) for k in range(8)], "tdma", 9),
        (np.arange(N)[:, None] // 113 == np.arange(8)).astype(float),
        0.2,
        70,
        3e-2,
    ),
    "slow tones": (
        site_with([Drive(periods=k) for k in SLOW_PERIODS], "fdma"), np.cos(turns(SLOW_PERIODS)), 0.2, 34, 3e-2
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WAYS)
def test_sensors_are_followed_by_samples_of_any_drive(name):
    site, drives, speed, begun, most_m = WAYS[name]
    rng = np.random.default_rng(5)
    stream = streamed(Room(CUBE), circling(rng, speed, speed), 0.7, NOISE_T, rng, drives=drives)
    track = BlockFilter(site)
    poses = [track.update(block) for block in stream.blocks()]
    first = next(k for k, pose in enumerate(poses) if pose.status is not Status.FAILED)
    assert first < begun
    moved, _ = stream.errors(poses[first:])
    late = [pose for pose in poses if pose.time_s > 0.3]
    # A cycle of slots has one block or two a beacon that tell it from the ambient field: it may count as unheard
    allowed = {Status.OK, Status.UNVERIFIED, *([Status.WEAK] if name == "slots" else [])}
    assert {pose.status for pose in late} <= allowed
    assert np.sqrt((moved[-len(late) :] ** 2).sum(axis=1).mean()) < most_m
    normal = [e @ np.linalg.solve(p.position_cov_m2, e) / 3 for e, p in zip(moved[-len(late) :], late, strict=True)]
    assert np.mean(normal) < 2.0


def test_codes_of_another_degree():
    site = replace(CUBE, degree=7, beacons=tuple(replace(b, code=11 * k) for k, b in enumerate(CUBE.beacons)))
    u, v, chips = [1] * 7, [1] * 7, []
    for _ in range(127):  # x^7 + x^3 + 1 and x^7 + x^3 + x^2 + x + 1
        chips.append((u[6], v[6]))
        u, v = [u[2] ^ u[6], *u[:6]], [v[0] ^ v[1] ^ v[2] ^ v[6], *v[:6]]
    first, second = np.array(chips).T
    codes = np.stack([1 - 2 * (first ^ np.roll(second, -11 * k)) for k in range(8)], axis=1)
    rng = np.random.default_rng(6)
    stream = streamed(Room(site), circling(rng, 1.0, 1.0), 0.4, NOISE_T, rng, drives=codes)
    track = BlockFilter(site)
    poses = [track.update(block) for block in stream.blocks()]
    moved, _ = stream.errors(poses)
    assert np.sqrt((moved[50:] ** 2).sum(axis=1).mean()) < 4e-3
    assert poses[-1].epoch == (len(stream.blocks()) * 31 - 1) // 127

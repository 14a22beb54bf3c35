"""The simulated room of rotating beacons: its fields, samples and drift, against formulas of their own."""

from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from hil_sim.world.rotating_room import EARTH_T, RotatingRoom

BEACONS = [
    SimpleNamespace(
        position_m=np.array(place),
        x_axis=np.array([1.0, 0.0, 0.0]),
        y_axis=np.array([0.0, 1.0, 0.0]),
        turns=55.0,
        radius_m=0.23,
        current_A=8.0,
        frequency_Hz=frequency,
    )
    for place, frequency in (((0.0, 0.0, 0.0), 25.0), ((6.2, 0.54, 0.0), 20.0))
]
K = 1e-7 * 55 * 8 * np.pi * 0.23**2


def dipole_field(place, at):
    offset = at - place
    r = np.linalg.norm(offset)
    u = offset / r
    return np.array([K / r**3 * (3 * u[axis] * u - np.eye(3)[axis]) for axis in (0, 1)])


def test_far_away_each_beacon_is_two_dipoles_and_near_by_it_is_not():
    room = RotatingRoom(BEACONS)
    for distance, tolerance in ((20.0, 4e-4), (2.0, 4e-2)):
        at = np.array([3.0, 0.2, 0.0]) + distance * np.array([0.5, -0.7, 0.51])
        field = room.field(at[None])[0]
        for beacon, found in zip(BEACONS, field, strict=True):
            expected = dipole_field(beacon.position_m, at)
            error = np.linalg.norm(found - expected) / np.linalg.norm(expected)
            assert 1e-6 < error < tolerance


def test_samples_are_the_sum_in_the_sensors_frame():
    room = RotatingRoom(BEACONS)
    at, attitude = np.array([[2.0, 1.0, 0.5]]), Rotation.from_rotvec([0.3, -0.5, 1.0])
    times = np.array([0.0, 0.0111, 3.7])
    drive = np.array([[0.9, 1.1]])
    samples = room.samples(at, attitude.as_matrix()[None], times, 0.0, np.random.default_rng(1), drive)
    field = room.field(at)[0]
    for row, t in zip(samples[0], times, strict=True):
        total = np.array(EARTH_T)
        for beacon, (cosine, sine), factor in zip(BEACONS, field, drive[0], strict=True):
            turn = 2 * np.pi * beacon.frequency_Hz * t
            total = total + factor * (np.cos(turn) * cosine + np.sin(turn) * sine)
        np.testing.assert_allclose(attitude.apply(row), total, rtol=1e-12)


def test_noise_is_white_and_of_the_size_asked_for():
    room = RotatingRoom(BEACONS)
    place, level, times = np.tile([2.0, 1.0, 0.5], (50, 1)), np.tile(np.eye(3), (50, 1, 1)), np.arange(100) / 200
    quiet = room.samples(place, level, times, 0.0, np.random.default_rng(1))
    noise = room.samples(place, level, times, 3e-9, np.random.default_rng(1)) - quiet
    assert abs(noise.std() / 3e-9 - 1) < 0.02
    assert abs(np.mean(noise[:, 1:] * noise[:, :-1]) / 9e-18) < 0.03


def test_the_drive_warms_up_follows_the_day_and_wanders_without_a_trend():
    room, times = RotatingRoom(BEACONS), np.arange(2880) * 60.0
    drives = np.stack([room.thermal_drive(times, np.random.default_rng(seed)) for seed in range(40)])
    assert drives.shape == (40, 2880, 2)
    assert abs(drives[:, 0].mean() - 1) < 5e-4
    assert -6e-3 < (drives[:, 300:].mean() - 1) < -2e-3
    slopes = np.polyfit(times[300:] / 86400, drives[:, 300:].transpose(1, 0, 2).reshape(2580, -1), 1)[0]
    assert abs(slopes.mean()) < 3 * slopes.std() / np.sqrt(80)
    again = room.thermal_drive(times, np.random.default_rng(0))
    np.testing.assert_array_equal(drives[0], again)

"""Walks and turning by hand: limits are kept, stays are still, the same seed makes the same motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil_sim.world.walk import Limits, Mark, Room, Walk, turning

ROOM = Room(np.array([-1.0, 0.0, 0.5]), np.array([2.0, 3.0, 1.5]), tilt_rad=0.4, pause_s=1.0)
LIMITS = Limits(speed_m_per_s=0.3, rate_rad_per_s=0.8)
MARKS = [Mark(np.array([x, 1.0, 1.0]), 0.002, np.array([x + 0.001, 1.002, 0.999]), cycles=10) for x in (-0.5, 0.5, 1.5)]
CYCLE_S = 0.1


def walk(seed=1, marks=MARKS, seconds=60.0):
    return Walk(seed, 3.0, seconds, ROOM, LIMITS, marks, CYCLE_S)


def speeds(motion, times_s):
    """Return speed and angular velocity by differences."""
    positions, rotations = motion.poses(times_s)
    step = np.diff(times_s)
    return (
        np.linalg.norm(np.diff(positions, axis=0), axis=1) / step,
        (rotations[:-1].inv() * rotations[1:]).magnitude() / step,
    )


def test_a_walk_keeps_its_limits_and_reaches_them():
    times_s = np.arange(0.0, 90.0, 0.01)
    speed, rate = speeds(walk(), times_s)
    assert 0.29 < speed.max() <= 0.3 + 1e-9
    assert 0.75 < rate.max() <= 0.8 + 1e-9


def test_a_walk_stays_in_its_room_within_its_tilt():
    positions, rotations = walk(marks=[], seconds=300.0).poses(np.arange(0.0, 300.0, 0.1))
    assert np.all((ROOM.low_m <= positions) & (positions <= ROOM.high_m))
    assert np.all(np.ptp(positions, axis=0) > 0.7 * (ROOM.high_m - ROOM.low_m))
    lean = np.arccos(rotations.as_matrix()[:, 2, 2])
    assert 0.2 < lean.max() < 0.8  # at stops 0.4; between them the shortest turn may lean further
    heading = Rotation.from_quat(rotations.as_quat()).as_euler("zyx")[:, 0]
    assert np.ptp(heading) > 4.0


def test_at_each_mark_the_sensor_stands_where_the_mark_really_is():
    motion = walk()
    assert [visit.mark for visit in motion.visits] == MARKS
    for visit in motion.visits:
        assert visit.departure_s - visit.arrival_s == pytest.approx(11 * CYCLE_S)
        inside, _ = motion.poses(np.linspace(visit.arrival_s, visit.departure_s, 50))
        np.testing.assert_allclose(inside, np.tile(visit.mark.true_m, (50, 1)), atol=1e-12)
        before = motion.poses(np.array([visit.arrival_s - 0.5]))[0][0]
        assert np.linalg.norm(before - visit.mark.true_m) > 1e-4
    arrivals = np.array([visit.arrival_s for visit in motion.visits])
    assert np.all(np.diff(arrivals) > 5.0)  # they are spread over the walk


def test_it_rests_before_it_starts_and_when_its_time_is_over():
    motion = walk()
    speed, rate = speeds(motion, np.linspace(0.0, 3.9, 20))
    assert not speed.any()
    assert not rate.any()
    end_s = motion.departures_s[-1]
    assert 60.0 <= end_s - 3.0 < 90.0
    speed, _ = speeds(motion, np.linspace(end_s, end_s + 10.0, 20))
    assert speed.max() < 1e-12


def test_marks_are_visited_in_the_shortest_walk():
    assert len(walk(seconds=0.1).visits) == 3


def test_the_seed_makes_the_walk():
    times_s = np.linspace(0.0, 60.0, 100)
    one, same, other = (walk(seed).poses(times_s)[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0.3


def test_turning_by_hand_shows_all_directions_at_one_place():
    place = np.array([1.0, 2.0, 3.0])
    motion = turning(5, 3.0, 60.0, place, 0.02, Limits(np.inf, 1.2))
    times_s = np.arange(3.0, 63.0, 0.01)
    positions, rotations = motion.poses(times_s)
    assert np.linalg.norm(positions - place, axis=1).max() < 0.1
    assert positions.std(axis=0).min() > 0.005
    _, rate = speeds(motion, times_s)
    assert 1.1 < rate.max() <= 1.2 + 1e-9
    down = rotations.inv().apply([0.0, 0.0, 1.0])
    assert np.linalg.eigvalsh(down.T @ down / len(down))[0] > 0.1  # a third each if perfectly spread

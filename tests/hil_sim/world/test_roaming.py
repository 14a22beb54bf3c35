"""Roaming: speed, turn rate and shaking are as asked, the box is kept, and the same seed makes the same motion."""

from __future__ import annotations

import numpy as np
import pytest

from hil_sim.world.roaming import Roaming, Shake

LOW, HIGH = np.array([0.3, 0.4, 0.5]), np.array([1.8, 1.7, 1.3])
TIMES_S = np.arange(0.0, 60.0, 1e-3)


def speeds(motion, times_s=TIMES_S):
    """Return velocities and angular velocities by differences, each of shape (n - 1, 3)."""
    positions, rotations = motion.poses(times_s)
    step = np.diff(times_s)[:, None]
    return np.diff(positions, axis=0) / step, (rotations[1:] * rotations[:-1].inv()).as_rotvec() / step


@pytest.mark.parametrize(("speed", "rate"), [(0.5, 0.5), (1.0, 1.0), (3.0, 2.0)])
def test_speed_and_turn_rate_are_as_asked(speed, rate):
    motion = Roaming(1, LOW, HIGH, speed, rate)
    velocity, turn = speeds(motion, np.arange(0.0, 600.0, 5e-3))
    assert np.sqrt((velocity**2).sum(axis=1).mean()) == pytest.approx(speed, rel=0.05)
    np.testing.assert_allclose(np.linalg.norm(turn, axis=1), rate, rtol=1e-3)
    assert not motion.still


def test_the_box_is_kept_and_filled_and_all_attitudes_come():
    positions, rotations = Roaming(2, LOW, HIGH, 1.0, 2.0).poses(np.arange(0.0, 600.0, 0.05))
    assert np.all((positions >= LOW) & (positions <= HIGH))
    assert np.all(np.ptp(positions, axis=0) > 0.9 * (HIGH - LOW))
    down = rotations.inv().apply([0.0, 0.0, 1.0])
    assert np.linalg.eigvalsh(down.T @ down / len(down))[0] > 0.1  # a third each if perfectly spread


def test_it_is_smooth():
    """Fourth differences of samples at 1 ms show a jump of the acceleration by 0.01 m/s^2, or of the speed."""
    positions, _ = Roaming(3, LOW, HIGH, 3.0, 2.0, Shake(2.0, 0.1, 0.3)).poses(TIMES_S)
    assert np.abs(np.diff(positions, 4, axis=0)).max() < 1e-8


def test_a_hand_shakes_it():
    plain, shaken = (Roaming(4, LOW, HIGH, 0.3, 0.3, shake) for shake in (None, Shake(2.0, 0.1, 0.3)))
    (still, upright), (moved, turned) = (motion.poses(TIMES_S) for motion in (plain, shaken))
    off = np.linalg.norm(moved - still, axis=1)
    assert 0.099 < off.max() < 0.142  # the ellipse starts at zero, at an end of its short axis
    assert 0.29 < (upright.inv() * turned).magnitude().max() < 0.43
    np.testing.assert_allclose(moved[::500] - still[::500], 0.0, atol=1e-9)  # twice a second


def test_without_speed_turn_and_shaking_it_stands():
    motion = Roaming(5, LOW, HIGH, 0.0, 0.0)
    assert motion.still
    velocity, turn = speeds(motion)
    assert not velocity.any()
    assert not turn.any()
    at_a_place = Roaming(5, LOW, LOW, 1.0, 0.5)
    np.testing.assert_array_equal(at_a_place.poses(TIMES_S[:3])[0], np.tile(LOW, (3, 1)))


def test_the_seed_makes_the_motion():
    one, same, other = (Roaming(seed, LOW, HIGH, 1.0, 1.0).poses(TIMES_S[::100])[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0.3

"""What turning does to the mean of a cycle, and the recording of reports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.calibration.turn import smear, turn_of_fields
from tests.host.calibration.turning import record


def test_the_mean_of_a_turning_vector(tmp_path):
    """Against the mean of many moments, at 2 rad/s about any axis."""
    turn = record(tmp_path, 1, cycles=30).turn
    rate = np.array([1.2, -0.9, 1.3])
    attitudes = Rotation.from_rotvec([0.3, 0.2, -1.0]) * Rotation.from_rotvec(np.outer(turn.time_s, rate))
    vector = np.array([2e-5, -1e-5, 4e-5])
    moments_s = turn.cycle_s * ((np.arange(2000) + 0.5) / 2000 - 0.5)
    found = smear(turn, attitudes.as_matrix())
    for row in (0, 7, 29):
        during = attitudes[row] * Rotation.from_rotvec(np.outer(moments_s, rate))
        mean = during.inv().apply(vector).mean(axis=0)
        middle = attitudes[row].inv().apply(vector)
        assert np.linalg.norm(middle - mean) > 1e-4 * np.linalg.norm(vector)
        np.testing.assert_allclose(found[row] @ middle, mean, rtol=1e-6, atol=1e-11)


def test_who_has_no_neighbour_stands_still(tmp_path):
    turn = record(tmp_path, 1, cycles=30).turn
    attitudes = Rotation.random(30, random_state=1).as_matrix()
    far = replace(turn, time_s=2.0 * turn.time_s)
    np.testing.assert_allclose(smear(far, attitudes), np.tile(np.eye(3), (30, 1, 1)), atol=1e-12)


def test_fields_of_a_table_come_in_the_order_of_the_site_and_of_time(tmp_path):
    recording = record(tmp_path, 2, cycles=25)
    epochs = recording.turn.fields(recording.site)
    shuffled = [
        replace(one, beacons=one.beacons[::-1], field_T=one.field_T[::-1], sigma_T=one.sigma_T[::-1])
        for one in epochs[::-1]
    ]
    turn = turn_of_fields(recording.site, shuffled)
    np.testing.assert_array_equal(turn.field_T, recording.turn.field_T)
    np.testing.assert_array_equal(turn.epoch, np.arange(25))
    assert np.isnan(turn.mean_T).all()

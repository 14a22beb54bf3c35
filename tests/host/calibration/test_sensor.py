"""Calibration of a sensor that was turned by hand, against the simulator's world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.calibration.sensor import calibrate_sensor
from goldfield.errors import UserError
from hil_sim.world.motion import Line
from tests.host.calibration.turning import PLACE_M, record

UPPER = np.triu_indices(3)
SURVEYED = "position_sd_m = 0.003\naxis_sd_rad = 0.005\ncurrent_sd = 0.003"


def nees(found, recording):
    """Return the squared error of the six elements over their covariance: 6 on average."""
    error = (found.axes - recording.axes)[UPPER]
    return float(error @ np.linalg.solve(found.covariance, error))


def test_axes_and_offset_are_found_as_well_as_is_said(tmp_path):
    """Ten recordings of 15 s at 0.2 mG: chi-square of 60 and 30 degrees of freedom, both sides at 1e-4."""
    axes, offsets = 0.0, 0.0
    for seed in range(10):
        recording = record(tmp_path, seed)
        found = calibrate_sensor(recording.site, recording.turn)
        assert found.weak is None
        assert found.outliers == ()
        assert found.residual == pytest.approx(1.0, abs=0.1)
        assert found.relative_sd < 1e-4
        assert np.abs(found.axes - recording.axes).max() < 5e-4
        axes += nees(found, recording)
        offsets += float((((found.offset_T - recording.offset_T) / found.offset_sd_T) ** 2).sum())
        assert found.earth_T == pytest.approx(np.hypot(2e-5, 4.5e-5), rel=1e-3)
    assert 27.0 < axes < 107.0
    assert 9.0 < offsets < 66.0


def test_what_the_site_says_wrongly_goes_into_the_common_gain_and_its_deviation(tmp_path):
    total = 0.0
    for seed in range(8):
        recording = record(tmp_path, seed, installation=SURVEYED)
        found = calibrate_sensor(recording.site, recording.turn)
        assert 5e-4 < found.gain_sd < 4e-3
        assert found.relative_sd < 1e-4
        total += nees(found, recording)
    assert 18.0 < total < 93.0  # chi-square of 48, both sides at 1e-4


def test_what_is_added_to_the_fields_all_the_time_is_in_the_deviation_of_the_common_gain(tmp_path):
    """A nanotesla, as the mains leave it: without its part the gain is many deviations off, with it a few parts of one.

    The size of the constant parts is told by a dozen numbers, so that the normalised square scatters more than that of
    known deviations: 24 on average, where without that part it is above 300.
    """
    total, largest = 0.0, 0.0
    for seed in range(4):
        recording = record(tmp_path, seed, constant_T=1e-9)
        found = calibrate_sensor(recording.site, recording.turn)
        total += nees(found, recording)
        largest = max(largest, found.gain_sd)
        assert found.relative_sd < 1e-4
    assert total < 62.0
    assert 1e-4 < largest < 3e-3


def test_the_smear_of_turning_is_undone(tmp_path):
    """At 1.5 rad/s the mean over a cycle is up to 1e-3 too small: without its part the error is far beyond."""
    recording = record(tmp_path, 3, rate_rad_per_s=1.5)
    found = calibrate_sensor(recording.site, recording.turn)
    assert nees(found, recording) < 28.0  # chi-square of 6 at 1e-4
    # The same cycles, so far apart that nobody can tell the rate.
    far = replace(recording.turn, time_s=3.0 * recording.turn.time_s)
    assert nees(calibrate_sensor(recording.site, far), recording) > 100.0


def test_bad_cycles_are_named_and_do_no_harm(tmp_path):
    recording = record(tmp_path, 1)
    bad = np.arange(5, 150, 20)
    field_T = recording.turn.field_T.copy()
    field_T[bad, 3] *= 1.3
    found = calibrate_sensor(recording.site, replace(recording.turn, field_T=field_T))
    assert set(bad.tolist()) <= set(found.outliers)
    assert len(found.outliers) < len(bad) + 3
    assert nees(found, recording) < 28.0


def test_without_means_there_is_no_offset(tmp_path):
    recording = record(tmp_path, 2)
    unknown = np.full_like(recording.turn.mean_T, np.nan)
    found = calibrate_sensor(recording.site, replace(recording.turn, mean_T=unknown))
    assert (found.offset_T, found.offset_sd_T, found.earth_T) == (None, None, None)
    assert "the offset is not known" in found.weak
    assert nees(found, recording) < 28.0


@pytest.mark.parametrize("hand", [1.0, -1.0])
def test_the_frame_is_that_of_the_axes_that_the_site_has(tmp_path, hand):
    """The sensor is mounted askew, or left-handed, and the site says how, but for a few percent."""
    recording = record(tmp_path, 7)
    mounting = Rotation.from_rotvec([0.9, -0.4, 2.0]).as_matrix() @ np.diag([1.0, 1.0, hand])
    true = mounting @ recording.axes  # its axes read so much of a field in the frame that the recording has
    told = true + 0.01 * np.random.default_rng(1).normal(size=(3, 3))
    turn = replace(
        recording.turn, field_T=recording.turn.field_T @ mounting.T, mean_T=recording.turn.mean_T @ mounting.T
    )
    site = replace(recording.site, sensor=replace(recording.site.sensor, axes=told))
    found = calibrate_sensor(site, turn)
    # Readings tell a matrix up to a rotation of the frame: A A' is what they tell.
    np.testing.assert_allclose(found.axes @ found.axes.T, true @ true.T, atol=1e-3)
    turned = np.linalg.solve(told, found.axes)
    assert np.abs(turned - np.eye(3)).max() < 0.05


def test_turning_about_one_axis_alone_is_weak(tmp_path):
    """Eight beacons tell the axes even so, if the noise is small; here it is that of a chip of 10 mG."""
    level = Line(PLACE_M, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.1]))
    recording = record(tmp_path, 4, motion=level, noise_T=6e-7)
    found = calibrate_sensor(recording.site, recording.turn)
    assert "turn the sensor further, so that each axis points up, down and to all sides" in found.weak
    turned = record(tmp_path, 4, noise_T=6e-7)
    assert calibrate_sensor(turned.site, turned.turn).weak is None


def test_a_few_cycles_are_too_few(tmp_path):
    recording = record(tmp_path, 5, cycles=19)
    with pytest.raises(UserError, match="19 cycles of the recording have a pose, and a calibration needs 20"):
        calibrate_sensor(recording.site, recording.turn)


def test_a_beacon_elsewhere_is_no_calibration(tmp_path):
    recording = record(tmp_path, 6)
    beacons = list(recording.site.beacons)
    beacons[2] = replace(beacons[2], position_m=beacons[2].position_m + np.array([0.0, 0.3, 0.0]))
    with pytest.raises(UserError, match="times the noise: something else is wrong than the sensor's axes"):
        calibrate_sensor(replace(recording.site, beacons=tuple(beacons)), recording.turn)

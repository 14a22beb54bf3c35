"""The mains: what hum leaves in a code stays for many cycles, is in its sigma, and names no beacon."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.access.epoch import EpochSeparator
from goldfield.access.gold import code_matrix
from goldfield.access.hum import hum_deviations
from goldfield.link.reports import Report
from goldfield.sensor.location import location
from goldfield.sensor.options import Method
from goldfield.site import load
from goldfield.types import Explanation, Status
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Room, straight
from tests.host.fake_sensor import SITE as SITE_FILE

NOISE_T, HUM_T, HUM_HZ = 2e-8, 3e-8, 50.0
SOUND = prigge_cube(NOISE_T)
KNOWING = replace(SOUND, sensor=replace(SOUND.sensor, hum_T=HUM_T, hum_Hz=HUM_HZ))
ROW = 4
STEP_M = np.array([0.012, -0.012, 0.0105])
"""A step of 2 cm."""


def hum(time_s, phase):
    """A hum with equal parts on all axes, in the samples at given times."""
    return np.sqrt(2.0) * HUM_T * np.sin(2.0 * np.pi * HUM_HZ * time_s + phase)[:, None] * np.ones(3)


def test_the_deviation_is_that_of_separated_waves_of_every_phase():
    """Against least squares on the codes and a constant, of nothing but the hum, at phases all around."""
    chips = (np.arange(SOUND.chips) + 1.0) * SOUND.chip_period_s
    columns = np.hstack([code_matrix(SOUND.degree, SOUND.codes).astype(float), np.ones((SOUND.chips, 1))])
    waves = np.stack([hum(chips, phase)[:, 0] for phase in np.arange(8) * np.pi / 4], axis=1)
    left = np.linalg.lstsq(columns, waves, rcond=None)[0][:-1]
    np.testing.assert_allclose(hum_deviations(KNOWING), np.sqrt((left**2).mean(axis=1)), rtol=0.02, atol=0.02e-9)
    assert hum_deviations(KNOWING).max() > 2.0 * hum_deviations(KNOWING).min()  # one code keeps more than another
    assert not hum_deviations(SOUND).any()


def test_it_is_in_the_sigma_of_reports():
    site = load(SITE_FILE)
    knowing = replace(site, sensor=replace(site.sensor, hum_T=2e-6))
    report = Report(7, 0.75, 1023, 0, 8, True, np.zeros(3), has_header=True)
    report.correlation_T = {code: np.full(3, 1e-7) for code in site.codes}
    plain, wider = (EpochSeparator(one).fields(report) for one in (site, knowing))
    np.testing.assert_allclose(wider.sigma_T, np.hypot(plain.sigma_T, hum_deviations(knowing)))
    np.testing.assert_array_equal(wider.field_T, plain.field_T)


def poses(site, fault_m, phase, count=40, gain=1.0):
    """Poses of a sensor at rest in hum, of reports as a board sends them; one beacon is off by a fault.

    The sensor reads a gain times the field.
    """
    rng = np.random.default_rng(1)
    beacons = list(SOUND.beacons)
    beacons[ROW] = replace(beacons[ROW], position_m=beacons[ROW].position_m + fault_m)
    rest = straight(np.array([0.9, 1.2, 0.8]), Rotation.from_rotvec([0.3, -0.2, 1.1]), np.zeros(3), np.zeros(3))
    clean = Room(replace(SOUND, beacons=tuple(beacons))).samples(rest, 0.0, 0.0, rng)
    codes = code_matrix(SOUND.degree, SOUND.codes).astype(float)
    chips = (np.arange(SOUND.chips) + 1.0) * SOUND.chip_period_s
    locate, separator, found = location(site, Method.EACH), EpochSeparator(site), []
    for k in range(count):
        samples = clean + hum(k * SOUND.cycle_s + chips, phase) + NOISE_T * rng.normal(size=clean.shape)
        samples *= gain
        report = Report(k, k * SOUND.cycle_s, SOUND.chips, 0, 8, True, samples.mean(axis=0), has_header=True)
        report.correlation_T = {code: codes[:, i] @ samples / SOUND.chips for i, code in enumerate(SOUND.codes)}
        found.append(locate(separator.fields(report), report))
    return found


@pytest.mark.parametrize("phase", [0.0, 1.0, 2.0, 3.0])
def test_hum_that_the_site_tells_names_no_beacon(phase):
    """Where the site does not tell, beacons that are where they should be are named, and poses are not ``ok``."""
    assert any(pose.findings for pose in poses(SOUND, np.zeros(3), phase))
    told = poses(KNOWING, np.zeros(3), phase)
    assert not any(pose.findings for pose in told)
    assert all(pose.status is Status.OK for pose in told)


@pytest.mark.parametrize("gain", [0.1, 8.0])
def test_hum_is_told_in_what_an_axis_reads(gain):
    """A sensor that reads a tenth of the field, of all in it, tells the same: its sound beacons were blamed for hum."""
    sensor = replace(KNOWING.sensor, noise_T=gain * NOISE_T, hum_T=gain * HUM_T, axes=gain * np.eye(3))
    scaled = replace(KNOWING, sensor=sensor)
    for fault_m in (np.zeros(3), STEP_M):
        plain, read = poses(KNOWING, fault_m, 1.0), poses(scaled, fault_m, 1.0, gain=gain)
        assert [pose.findings and pose.findings[0].beacons for pose in read] == [
            pose.findings and pose.findings[0].beacons for pose in plain
        ]


def test_a_beacon_that_was_moved_is_named_in_spite_of_it():
    last = poses(KNOWING, 2.0 * STEP_M, 1.0)[-1]
    assert [(finding.kind, finding.beacons) for finding in last.findings] == [
        (Explanation.MOVED, (SOUND.beacons[ROW].id,))
    ]
    assert last.excluded == (SOUND.beacons[ROW].id,)

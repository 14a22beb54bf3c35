"""From a sensor's report to fields: what is lost or out of range shows in the sigma."""

import math

import numpy as np
import pytest

from goldfield.access.epoch import EpochSeparator
from goldfield.link.reports import Report
from goldfield.site import load
from tests.host.fake_sensor import CHIPS, CODES, SITE, beacon_fields

OFFSET_T = np.array([2e-5, -1e-5, 4e-5])
FLOOR_T = 2e-7 / math.sqrt(1023)


def report_of(samples, cycle=7, **changes):
    correlation = {code: CHIPS[:, i] @ samples / 1023 for i, code in enumerate(CODES)}
    report = Report(cycle, time_s=0.75, chips=1023, saturated=0, announced=8, locked=True, has_header=True)
    report.offset_T, report.correlation_T = samples.mean(axis=0), correlation
    for name, value in changes.items():
        setattr(report, name, value)
    return report


@pytest.fixture
def separator():
    return EpochSeparator(load(SITE))


def test_a_whole_report_is_exact(separator):
    fields = separator.fields(report_of(CHIPS @ beacon_fields() + OFFSET_T))
    assert (fields.epoch, fields.time_s, fields.beacons) == (7, 0.75, tuple(f"b{i}" for i in range(1, 9)))
    np.testing.assert_allclose(fields.field_T, beacon_fields(), atol=1e-17)
    np.testing.assert_allclose(fields.sigma_T, FLOOR_T, rtol=1e-3)


def test_lost_chips_cost_what_the_offset_leaks(separator):
    """The sensor's sums lack k chips: over many draws the error is of the size that sigma says."""
    rng = np.random.default_rng(2)
    ratios = []
    for _ in range(100):
        samples = CHIPS @ beacon_fields() + OFFSET_T
        samples[rng.choice(1023, size=10, replace=False)] = 0.0
        fields = separator.fields(report_of(samples, chips=1013))
        ratios.append(((fields.field_T - beacon_fields())[:, 2] ** 2).mean() / (fields.sigma_T**2).mean())
    assert 0.5 < np.sqrt(np.mean(ratios)) < 1.1


def test_sums_over_fewer_chips_are_scaled(separator):
    """One beacon alone, no offset, three tenths of the chips lost: its field still comes out at full size."""
    alone = np.zeros((8, 3))
    alone[2] = [3e-7, -2e-7, 1e-7]
    samples = CHIPS @ alone
    samples[np.random.default_rng(4).choice(1023, size=307, replace=False)] = 0.0
    fields = separator.fields(report_of(samples, chips=716))
    np.testing.assert_allclose(fields.field_T[2], alone[2], rtol=0.01)


def test_saturated_chips_are_trusted_less(separator):
    samples = CHIPS @ beacon_fields() + OFFSET_T
    assert (separator.fields(report_of(samples, saturated=5)).sigma_T > 5 * FLOOR_T).all()


def test_a_lost_field_is_left_out_and_widens_the_others_a_little(separator):
    report = report_of(CHIPS @ beacon_fields() + OFFSET_T)
    del report.correlation_T[5]
    fields = separator.fields(report)
    assert "b4" not in fields.beacons
    assert len(fields.beacons) == 7
    error = fields.field_T - np.delete(beacon_fields(), 3, axis=0)
    assert np.abs(error).max() < 1.1 * np.abs(beacon_fields()[3]).max() / 1023
    assert (fields.sigma_T > FLOOR_T).all()
    assert (fields.sigma_T < 1.1 * FLOOR_T).all()


def test_an_axis_out_of_range_is_not_measured_and_the_others_know(separator):
    strong = beacon_fields().copy()
    strong[0] = [80e-6, 1e-6, 1e-6]
    report = report_of(CHIPS @ strong + OFFSET_T)
    report.correlation_T[2][0] = np.nan
    fields = separator.fields(report)
    assert np.isnan(fields.field_T[0]).tolist() == [True, False, False]
    np.testing.assert_allclose(fields.field_T[:, 1:], strong[:, 1:], atol=1e-17)
    error = np.abs(fields.field_T[1:, 0] - strong[1:, 0])
    assert error.max() > 10 * FLOOR_T
    assert (error < fields.sigma_T[1:]).all()


def test_without_offset_nothing_is_measured(separator):
    fields = separator.fields(report_of(CHIPS @ beacon_fields(), offset_T=None))
    assert fields.beacons == ()
    assert fields.field_T.shape == (0, 3)


def test_time_goes_on_when_headers_are_lost(separator):
    samples = CHIPS @ beacon_fields()
    assert math.isnan(separator.fields(report_of(samples, time_s=math.nan)).time_s)
    separator.fields(report_of(samples, cycle=2**20 - 1, time_s=9.0))
    later = separator.fields(report_of(samples, cycle=1, time_s=math.nan))
    assert later.time_s == pytest.approx(9.0 + 2 * 1023 * 97.75e-6)

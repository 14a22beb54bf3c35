"""Reports of a sensor that chose its codes: what it left out is in the sigma, and strangers do no harm."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from goldfield.access.epoch import ENTERS, REMEMBERED, EpochSeparator
from goldfield.access.gold import code_matrix
from goldfield.link.reports import Report
from goldfield.site import load
from tests.host.fake_sensor import SITE

SITE_8 = load(SITE)
NOISE_T = SITE_8.sensor.noise_T
FLOOR_T = NOISE_T / math.sqrt(1023)
OFFSET_T = np.array([2e-5, -1e-5, 4e-5])
"""It leaves 45 nT in the correlation of a balanced code."""
STRANGER = 600


def cycle(fields):
    """Samples of beacons (code: field) and an offset, with no noise."""
    return sum(np.outer(code_matrix(10, [code])[:, 0], field) for code, field in fields.items()) + OFFSET_T


def report_of(samples, codes, **changes):
    report = Report(7, 0.75, 1023, 0, len(codes), True, samples.mean(axis=0), has_header=True)
    report.correlation_T = {code: code_matrix(10, [code])[:, 0] @ samples / 1023 for code in codes}
    return dataclasses.replace(report, **changes)


def strong_and_weak(weak_T):
    """Five beacons of about a microtesla, the strongest first, and three of a given size."""
    sizes = [2e-6, 1.5e-6, 1.2e-6, 1.1e-6, 1e-6, weak_T, weak_T, weak_T]
    directions = np.random.default_rng(3).normal(size=(8, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return {code: size * way for code, size, way in zip(SITE_8.codes, sizes, directions, strict=True)}


def test_what_the_sensor_left_out_is_absent_and_in_the_sigma():
    """With K codes reported, one that was left out may have 1.41 of the weakest field; it leaks by 1/1024 of that."""
    fields = strong_and_weak(1.3e-6)  # as strong as the factor lets them be, and they are left out
    codes = SITE_8.codes[:5]
    separated = EpochSeparator(SITE_8).fields(report_of(cycle(fields), codes), 5)
    assert separated.beacons == tuple(b.id for b in SITE_8.beacons[:5])
    off = separated.field_T - [fields[code] for code in codes]
    assert np.abs(off).max() > 1e-10  # they do leak
    bound_T = math.sqrt(2.0) * math.hypot(1e-6, ENTERS * FLOOR_T)
    expected = math.hypot(FLOOR_T, math.sqrt(3.0) * bound_T / 1024)
    np.testing.assert_allclose(separated.sigma_T, expected, rtol=0.02)
    assert np.sqrt((off**2).mean()) < math.sqrt(3.0) * bound_T / 1024


def test_the_weakest_is_taken_without_the_ambient_field():
    """A field of a few nanotesla among the chosen bounds those left out by as much, not by what the offset leaves."""
    fields = strong_and_weak(2e-9)
    separated = EpochSeparator(SITE_8).fields(report_of(cycle(fields), SITE_8.codes[:6]), 6)
    bound_T = math.sqrt(2.0) * math.hypot(2e-9, ENTERS * FLOOR_T)
    expected = math.hypot(FLOOR_T, math.sqrt(2.0) * bound_T / 1024)
    np.testing.assert_allclose(separated.sigma_T, expected, rtol=1e-5)


def test_with_fewer_than_k_all_others_are_below_the_floor():
    fields = strong_and_weak(0.0)
    codes = SITE_8.codes[:5]
    separated = EpochSeparator(SITE_8).fields(report_of(cycle(fields), codes), 6)
    np.testing.assert_allclose(separated.field_T, [fields[code] for code in codes], atol=1e-16)
    expected = math.hypot(FLOOR_T, math.sqrt(3.0) * ENTERS * FLOOR_T / 1024)
    np.testing.assert_allclose(separated.sigma_T, expected, rtol=1e-3)


def test_a_message_that_was_lost_may_have_been_the_strongest():
    """Five were announced and four came: the fifth may be any of the site's, and as strong as the strongest."""
    fields = strong_and_weak(0.0)
    report = report_of(cycle(fields), SITE_8.codes[1:5], announced=5)
    separated = EpochSeparator(SITE_8).fields(report, 5)
    off = separated.field_T - [fields[code] for code in SITE_8.codes[1:5]]
    assert np.abs(off).max() > 2e-10
    assert (np.abs(off) < 3.0 * separated.sigma_T[:, None]).all()
    assert separated.sigma_T.min() > math.hypot(FLOOR_T, 1e-6 / 1024)


def test_a_stranger_is_taken_out_exactly_and_left_out():
    fields = strong_and_weak(0.0)
    heard = [*SITE_8.codes[:5], STRANGER]
    report = report_of(cycle({**fields, STRANGER: np.array([3e-6, -2e-6, 1e-6])}), heard)
    separated = EpochSeparator(SITE_8).fields(report, 8)
    assert separated.beacons == tuple(b.id for b in SITE_8.beacons[:5])
    np.testing.assert_allclose(separated.field_T, [fields[code] for code in SITE_8.codes[:5]], atol=1e-16)


def test_without_the_choice_a_field_that_is_absent_was_lost():
    """As ever: it widens the sigma by what the strongest would leak."""
    fields = strong_and_weak(0.0)
    separated = EpochSeparator(SITE_8).fields(report_of(cycle(fields), SITE_8.codes[:5]))
    largest_T = max(float(np.abs(field).max()) for field in fields.values())
    expected = math.hypot(FLOOR_T, math.sqrt(3.0) * largest_T / 1024)
    np.testing.assert_allclose(separated.sigma_T, expected, rtol=0.02)


def test_many_sets_of_strangers_are_not_kept():
    separator = EpochSeparator(SITE_8)
    fields = strong_and_weak(0.0)
    for stranger in range(100, 100 + 2 * REMEMBERED):
        report = report_of(cycle(fields), [*SITE_8.codes[:5], stranger])
        np.testing.assert_allclose(
            separator.fields(report, 8).field_T, [fields[code] for code in SITE_8.codes[:5]], atol=1e-15
        )
    assert len(separator._separators) <= REMEMBERED + 1


@pytest.mark.parametrize("codes", [(), (STRANGER,)])
def test_nothing_of_the_site_is_heard(codes):
    separated = EpochSeparator(SITE_8).fields(report_of(cycle({STRANGER: np.array([3e-6, 0.0, 0.0])}), codes), 4)
    assert separated.beacons == ()
    assert separated.field_T.shape == (0, 3)

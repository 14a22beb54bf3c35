"""Beacons that share a code are told apart by the others that are heard."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from goldfield.access.epoch import EpochSeparator
from goldfield.access.gold import code_matrix
from goldfield.access.users import CodeUsers
from goldfield.errors import UserError
from goldfield.link.reports import Report
from goldfield.planning.code_plan import planned
from goldfield.planning.grid import Grid
from goldfield.sensor.dialogue import wanted_parameters
from tests.host.planning.built import beacon, ceiling, site_of, true_components

DEGREE, CHIPS, STRONGEST = 7, 127, 12


@pytest.fixture(scope="module")
def hall():
    """A hall of 196 beacons and 128 codes."""
    site = replace(ceiling(14, 14, spacing=4.5, height=4.5), degree=DEGREE, shared_codes=True)
    grid = Grid.of_box(np.array([0.0, 0.0, 0.5]), np.array([58.5, 58.5, 2.0]), 1.5)
    code = planned(site, grid, STRONGEST).code.tolist()
    assert len(set(code)) < 196
    return replace(site, beacons=tuple(replace(b, code=c) for b, c in zip(site.beacons, code, strict=True)))


def report_of(site, field_T):
    """What a sensor reports that chooses the strongest codes, without noise, with 50 uT of an ambient field."""
    samples = code_matrix(DEGREE, site.codes).astype(float) @ field_T + [2e-5, 0.0, -4.5e-5]
    strength = {code: 0.0 for code in site.codes}
    for code, field in zip(site.codes, field_T, strict=True):
        strength[code] += np.linalg.norm(field)
    codes = sorted(strength, key=lambda code: -strength[code])[:STRONGEST]
    report = Report(1, 0.05, CHIPS, 0, len(codes), True, has_header=True)
    report.offset_T = samples.mean(axis=0)
    report.correlation_T = {code: code_matrix(DEGREE, [code])[:, 0] @ samples / CHIPS for code in codes}
    return report


@pytest.mark.long
def test_everywhere_in_a_hall_the_near_ones_are_told(hall):
    separator, rng = EpochSeparator(hall), np.random.default_rng(4)
    place = np.array([one.position_m for one in hall.beacons])
    for _ in range(40):
        point = np.array([*rng.uniform(0.0, 58.5, 2), rng.uniform(0.5, 2.0)])
        field = true_components(hall, point, np.eye(3)).reshape(-1, 3)
        fields = separator.fields(report_of(hall, field), STRONGEST)
        assert len(fields.beacons) == STRONGEST
        index = [[b.id for b in hall.beacons].index(name) for name in fields.beacons]
        assert np.linalg.norm(place[index] - point, axis=1).max() < 16.0
        off = np.linalg.norm(fields.field_T - field[index], axis=1)
        assert (off < 0.1 * np.linalg.norm(field[index], axis=1).max()).all()


def test_two_places_with_the_same_codes_are_not_told_apart():
    """Their codes are left out, and those of their own are not."""
    places = [(x + far, y, 2.4) for far in (0.0, 60.0) for x, y in ((0, 0), (3, 0), (0, 3), (3, 3))]
    beacons = [replace(beacon(i, place), code=2 + i % 4) for i, place in enumerate(places)]
    alone = replace(beacon(8, (1.5, 1.5, 2.4)), code=9)
    twins = replace(site_of(beacons), shared_codes=True)
    assert CodeUsers(twins).codes == (2, 3, 4, 5)
    assert CodeUsers(twins).heard([2, 3, 4, 5], np.ones(4)) == [None] * 4
    told = CodeUsers(replace(twins, beacons=(*beacons, alone)))
    assert told.heard([2, 3, 4, 5, 9], np.ones(5)) == [0, 1, 2, 3, 8]
    assert told.heard([9], np.ones(1)) == [8]
    # A single stranger of the pattern changes nothing.
    assert told.heard([2, 3, 5, 9], np.array([1.0, np.nan, 3.0, 2.0])) == [0, 1, 3, 8]


def test_a_list_of_codes_has_each_once(hall):
    with pytest.raises(UserError, match=r"share codes, and a list has each code once: .*strongest"):
        wanted_parameters([3, 4, 3])
    assert wanted_parameters([3, 4, 5])


def test_a_large_site_is_never_separated_all_at_once():
    """As many codes as there are, which no cycle could tell apart; a few of them can be."""
    site = ceiling(32, 32, spacing=4.5, height=4.5)
    site = replace(site, beacons=tuple(replace(one, code=place) for place, one in enumerate(site.beacons)))
    samples = code_matrix(10, [1, 2, 1000]).astype(float) @ np.array([[1e-6, 0, 0], [0, 2e-6, 0], [0, 0, 3e-6]])
    report = Report(1, 0.05, 1023, 0, 3, True, has_header=True)
    report.offset_T = samples.mean(axis=0)
    report.correlation_T = {code: code_matrix(10, [code])[:, 0] @ samples / 1023 for code in (1, 2, 1000)}
    fields = EpochSeparator(site).fields(report, 16)
    assert fields.beacons == ("b1", "b2", "b1000")
    np.testing.assert_allclose(fields.field_T, np.diag([1e-6, 2e-6, 3e-6]), atol=1e-15)

"""Fields that fit no place: the fit goes off to where nothing is heard, and there is no pose."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.locate import Locator
from goldfield.types import Fields, Status
from tests.bench.integrity_coils import Coils, measured
from tests.bench.integrity_sites import cube, hall, sigma_of, told
from tests.bench.locate_trials import cube_positions, fields_of

ANY_SITE_M = 100.0
"""No site here is so large, and from no place beyond it would one of its beacons be heard."""


def epochs(site, position, rng, change):
    run = measured(Coils.of(site, len(position)).field(position), position, sigma_of(site), rng)
    return [Fields(0, 0.0, one.beacons, change(one.field_T), one.sigma_T) for one in fields_of(site, run)]


def absurd(name, seed):
    """A site, and 60 epochs of fields that are not its own."""
    rng = np.random.default_rng([seed, 98])
    if name == "a hundredth":
        site = cube(2e-8)
        return site, epochs(site, cube_positions(rng, 60), rng, lambda field: 0.01 * field)
    if name == "two axes dead":
        site = cube(2e-8)
        return site, epochs(site, cube_positions(rng, 60), rng, lambda field: field * [1.0, 0.0, 0.0])
    site = hall(rng, 3 if name == "one a thousand times" else 8)
    position = rng.uniform(0.0, 1.0, (60, 3)) * [10.0, 10.0, 3.5]
    if name == "one a thousand times":
        return site, epochs(site, position, rng, lambda field: field * np.array([[1e3], [1.0], [1.0]]))
    return site, epochs(site, position, rng, lambda field: field[rng.permutation(8)])


@pytest.mark.parametrize("name", ["a hundredth", "two axes dead", "one a thousand times", "of other beacons"])
def test_absurd_fields_have_no_absurd_place(name):
    """Some of each had a place 1e60 m away and farther."""
    site, fields = absurd(name, 1)
    locator = Locator(told(site, None))
    poses = locator.locate_many(fields)
    lost = [pose for pose in poses if pose.status is Status.FAILED]
    assert lost
    for pose in lost:
        assert np.isnan(pose.position_m).all()
        assert pose.reason.startswith("no place was found for these fields at which the beacons would be heard")
        assert pose.used == tuple(beacon.id for beacon in site.beacons)
    found = np.array([pose.position_m for pose in poses if pose.status is not Status.FAILED])
    assert np.linalg.norm(found, axis=1).max() < ANY_SITE_M
    which = [poses.index(lost[0]), next(i for i, pose in enumerate(poses) if pose.status is not Status.FAILED)]
    alone = [locator.locate(fields[i]) for i in which]
    assert [pose.reason for pose in alone] == [poses[i].reason for i in which]


def test_what_explains_the_fields_is_told_all_the_same():
    site, fields = absurd("a hundredth", 1)
    lost = [pose for pose in Locator(told(site, None)).locate_many(fields) if pose.status is Status.FAILED]
    for pose in lost:
        (finding,) = pose.findings
        assert finding.factor == pytest.approx(0.01, rel=0.01)
        assert pose.reason.endswith(finding.text)

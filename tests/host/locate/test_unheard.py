"""Fields that fit no place: the fit goes off to where nothing is heard, and there is no pose."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.field import FieldModel
from goldfield.locate import Locator
from goldfield.locate.fault_statistics import fault_statistics
from goldfield.locate.fit import Measurements, fit_pose
from goldfield.locate.poses import HEARD, Judged, poses_of
from goldfield.locate.solutions import unsolved
from goldfield.types import Fields, Status
from tests.bench.integrity_coils import Coils, measured
from tests.bench.integrity_sites import cube, hall, sigma_of, told
from tests.bench.locate_trials import cube_positions, fields_of

MU0 = 4e-7 * np.pi
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


@pytest.mark.parametrize(("share", "status"), [(1.02, Status.WEAK), (0.98, Status.FAILED)])
def test_a_pose_is_lost_where_all_beacons_together_are_no_stronger_than_the_noise(share, status):
    """On the axis of three coils in one place, whose field there is the textbook's."""
    beacon = cube(2e-8).beacons[0]
    distance_m = 40.0
    strength_T = MU0 * beacon.turns * beacon.current_A * beacon.radius_m**2 / 2.0
    strength_T /= (beacon.radius_m**2 + distance_m**2) ** 1.5
    model = FieldModel([beacon] * 3)
    sigma_T = np.sqrt(3.0 / (HEARD * share)) * abs(strength_T)
    measurements = Measurements(np.zeros((1, 3, 3)), np.full((1, 3), sigma_T))
    place = beacon.position_m + distance_m * beacon.axis
    fit = fit_pose(model, measurements, place[None], np.eye(3)[None], iterations=0)
    solutions = unsolved(fit)
    solutions.bounded[:] = False
    statistics = fault_statistics(model, measurements, fit)
    names = ("b0", "b1", "b2")
    judged = Judged(cube(2e-8), model, names, measurements, solutions, statistics, {}, np.zeros((1, 3)))
    (pose,) = poses_of([Fields(0, 0.0, names, np.zeros((3, 3)), np.ones(3))], judged)
    assert pose.status is status

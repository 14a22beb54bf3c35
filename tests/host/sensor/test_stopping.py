"""The cycle in which a coil goes off: a weak pose without it, whose uncertainty holds; coils by magpylib."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.access import Separator
from goldfield.locate import locate
from goldfield.sensor.location import location
from goldfield.sensor.options import Method
from goldfield.sensor.stopping import CLEAR_SIGMAS, Stopping
from goldfield.types import Fields, Status
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import CHIPS, EARTH_T, Room, straight

NOISE_T = 2e-7
SITE = prigge_cube(NOISE_T)
IDS = tuple(beacon.id for beacon in SITE.beacons)
SEPARATOR = Separator(10, SITE.codes, NOISE_T)
PLACE_M = np.array([0.9, 1.2, 0.8])
ROOM = Room(SITE)
REST = straight(PLACE_M, Rotation.from_rotvec([0.3, -0.2, 1.1]), np.zeros(3), np.zeros(3))
ALONE = [
    Room(replace(SITE, beacons=(beacon,))).samples(REST, 0.0, 0.0, np.random.default_rng(0), np.zeros(3))
    for beacon in SITE.beacons
]
"""What each coil alone adds to the samples."""
AMBIENT_T = REST.poses(np.zeros(1))[1].inv().apply(EARTH_T)[0]


def fields(epoch, rng, until):
    """Fields of a cycle in which each coil is on until a chip."""
    on = np.arange(CHIPS)[:, None]
    samples = AMBIENT_T + NOISE_T * rng.normal(size=(CHIPS, 3))
    samples = samples + sum(np.where(on < last, coil, 0.0) for coil, last in zip(ALONE, until, strict=True))
    separation = SEPARATOR.from_samples(samples)
    return Fields(epoch, epoch * SITE.cycle_s, IDS, separation.field_T, separation.sigma_T)


def poses(rng, row, chip):
    """Poses of two whole cycles and of one in which a coil goes off."""
    locator = location(SITE, Method.EACH)
    until = np.full(8, CHIPS)
    found = [locator(fields(epoch, rng, until), None) for epoch in range(2)]
    until[row] = chip
    last = fields(2, rng, until)
    return [*found, locator(last, None)], locate(SITE, last)


def test_no_pose_of_such_a_cycle_is_worse_than_weak_and_its_uncertainty_holds():
    rng = np.random.default_rng(15)
    alone, told, ratio = [], [], []
    for _ in range(80):
        row = int(rng.integers(8))
        found, single = poses(rng, row, int(rng.integers(1, CHIPS)))
        last = found[-1]
        alone.append(single.status)
        told.append(last.status)
        assert last.status in (Status.OK, Status.WEAK, Status.UNVERIFIED, Status.INCONSISTENT)
        if last.status is Status.WEAK:
            assert last.excluded == (IDS[row],)
            assert f"{IDS[row]} went off after " in last.reason
            off = last.position_m - PLACE_M
            ratio.append(off @ np.linalg.solve(last.position_cov_m2, off) / 3.0)
    assert alone.count(Status.INCONSISTENT) > 5  # by themselves
    assert told.count(Status.INCONSISTENT) <= 1
    assert len(ratio) > 5
    assert np.sqrt(np.mean(ratio)) < 1.1


@pytest.mark.parametrize(("less", "told"), [(1.05, True), (0.95, False)])
def test_both_sides_of_the_loss_that_is_believed(less, told):
    """A field is less by just more and just less than the limit, and a small part of all others is not as it was."""
    sigma_T, stopping = 6e-9, Stopping(SITE)
    before = fields(0, np.random.default_rng(1), np.full(8, CHIPS))
    before = replace(before, sigma_T=np.full(8, sigma_T))
    size_T = np.linalg.norm(before.field_T[3])
    changed = before.field_T.copy()
    changed[3] *= 1.0 - less * CLEAR_SIGMAS * sigma_T / size_T
    sound = locate(SITE, before)
    stopping.follow(before, sound)
    wrong = replace(sound, status=Status.INCONSISTENT)
    after = replace(before, epoch=1, time_s=SITE.cycle_s, field_T=changed)
    assert (stopping.follow(after, wrong).status is Status.WEAK) == told


def test_nothing_is_believed_of_a_cycle_that_does_not_follow_a_sound_one():
    rng = np.random.default_rng(2)
    before, until = fields(0, rng, np.full(8, CHIPS)), np.full(8, CHIPS)
    until[0] = 500
    after, sound = fields(1, rng, until), locate(SITE, before)
    wrong = replace(sound, status=Status.INCONSISTENT)
    for time_s, first in ((3.0 * SITE.cycle_s, sound), (SITE.cycle_s, wrong)):
        stopping = Stopping(SITE)
        stopping.follow(before, first)
        assert stopping.follow(replace(after, time_s=time_s), wrong) is wrong
    both = until.copy()
    both[4] = 300
    stopping = Stopping(SITE)
    stopping.follow(before, sound)
    assert stopping.follow(fields(1, rng, both), wrong) is wrong  # two coils at once are not one


@pytest.mark.parametrize(("heard", "told"), [(5, True), (4, False)])
def test_of_four_beacons_none_is_left_out(heard, told):
    rng = np.random.default_rng(3)
    until = np.full(8, CHIPS)
    before = fields(0, rng, until)
    until[0] = 500
    after, wrong = fields(1, rng, until), replace(locate(SITE, before), status=Status.INCONSISTENT)
    stopping = Stopping(SITE)
    stopping.follow(some(before, heard), replace(wrong, status=Status.OK))
    assert (stopping.follow(some(after, heard), wrong).status is Status.WEAK) == told


def some(whole, count):
    """The same of the first few beacons."""
    return replace(whole, beacons=whole.beacons[:count], field_T=whole.field_T[:count], sigma_T=whole.sigma_T[:count])

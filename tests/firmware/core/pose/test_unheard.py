"""Fields that fit no place, on the sensor: no pose from which no beacon would be heard."""

import numpy as np
import pytest

from tests.bench.integrity_coils import Coils
from tests.bench.integrity_sites import cube, hall, told
from tests.bench.locate_trials import cube_positions
from tests.firmware.core.pose.test_pose import FAILED, Sensor, position_of
from tests.host.locate.test_unheard import ANY_SITE_M, epochs

NO_POSE, UNEXPLAINED = 3, 6
"""POSE_REASON_ of `pose_result.h`."""


def absurd(name):
    rng = np.random.default_rng([14, 98])
    if name == "a thousandth":
        site = cube(2e-8)
        return site, epochs(site, cube_positions(rng, 80), rng, lambda field: 1e-3 * field)
    site = hall(rng, 8)
    position = rng.uniform(0.0, 1.0, (80, 3)) * [10.0, 10.0, 3.5]
    if name == "two axes dead":
        return site, epochs(site, position, rng, lambda field: field * [1.0, 0.0, 0.0])
    return site, epochs(site, position, rng, lambda field: field[rng.permutation(8)])


@pytest.mark.parametrize("name", ["a thousandth", "two axes dead", "of other beacons"])
def test_absurd_fields_have_no_absurd_place(core, name):
    """What a place is worth is computed by magpylib. Some were 100 to 400 m away, where no beacon is heard."""
    site, fields = absurd(name)
    sensor = Sensor(core, told(site, None))
    reasons, heard = [], []
    for one in fields:
        pose = sensor.locate(one.field_T, one.sigma_T)
        if pose.status == FAILED:
            reasons.append(pose.reason)
            continue
        place = position_of(pose)
        assert np.linalg.norm(place) < ANY_SITE_M
        field = Coils.of(site, 1).field(place[None])[0]
        heard.append(((field / one.sigma_T[:, None]) ** 2).sum())
    assert heard
    assert min(heard) > 1.0
    assert {NO_POSE, UNEXPLAINED} & set(reasons)

"""The map of the expected error, beside what the locator states for a pose of measured fields."""

import math

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.errors import UserError
from goldfield.page.expected_error import POINTS, ExpectedError
from goldfield.sensor.opening import open_sensor
from tests.host.fake_sensor import POSITION_M, SITE, log_of

ROOM = sites.load(SITE)


@pytest.fixture(scope="module")
def maps():
    return ExpectedError(ROOM)


def test_it_is_what_the_locator_states_there(maps, tmp_path):
    log = tmp_path / "run.log"
    log.write_text(log_of(range(2)))
    with open_sensor("log", str(log), ROOM) as sensor:
        pose = next(sensor.poses())
    table = maps(POSITION_M[2])
    x, y = np.array(table["x_m"]), np.array(table["y_m"])
    error_m = np.array(table["position_sd_m"], dtype=float)
    assert error_m.shape == (len(y), len(x))
    assert max(error_m.shape) in (POINTS, POINTS + 1)
    here = error_m[np.abs(y - POSITION_M[1]).argmin(), np.abs(x - POSITION_M[0]).argmin()]
    assert here == pytest.approx(math.sqrt(np.trace(pose.position_cov_m2)), rel=0.3)


def test_it_covers_every_coil(maps):
    table = maps(1.0)
    for beacon in ROOM.beacons:
        assert table["x_m"][0] <= beacon.position_m[0] - 0.149
        assert beacon.position_m[0] + 0.149 <= table["x_m"][-1] + 0.1
        assert table["y_m"][0] <= beacon.position_m[1] - 0.149


def test_heights_within_a_step_share_a_map(maps):
    assert maps(0.81) is maps(0.84)
    assert maps(0.84)["z_m"] == 0.8
    assert maps(0.86)["z_m"] == 0.9


@pytest.mark.parametrize("height_m", [-5.0, 10.0, math.nan, math.inf])
def test_a_height_that_is_far_away_is_refused(maps, height_m):
    with pytest.raises(UserError, match="far from the beacons"):
        maps(height_m)

"""Tables of points and files of known values: what they mean, and the sentence that each mistake gets."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.errors import UserError
from goldfield.survey.data import Current, Direction, Distance, Place, SensorPlace
from goldfield.survey.known_files import POINT_SIGMA_M, read_known, read_points
from tests.bench.survey_trials import cube, fields_of

SITE = cube().site
EPOCHS = fields_of(("b0",), np.zeros((5, 1, 3)), 1e-9)


def points(tmp_path, text):
    path = tmp_path / "points.csv"
    path.write_text(text)
    return read_points(path, EPOCHS)


def known(tmp_path, text):
    path = tmp_path / "known.toml"
    path.write_text(text)
    return read_known(path, SITE)


def test_points_have_empty_cells_and_a_default_deviation(tmp_path):
    first, second = points(tmp_path, "epoch,x_m,y_m,z_m,sigma_m\n0,1,2,3,\n4,,,0.5,0.01\n")
    assert first.epoch == 0
    assert first.position_m.tolist() == [1.0, 2.0, 3.0]
    assert first.sigma_m == POINT_SIGMA_M
    assert np.isnan(second.position_m).tolist() == [True, True, False]
    assert second.sigma_m == 0.01


def test_epochs_at_one_point_share_its_error(tmp_path):
    found = points(tmp_path, "epoch,x_m,y_m,z_m\n0,1,2,3\n1,1,2,3\n2,1,2,3\n3,1,2,3\n4,5,2,3\n")
    assert [point.sigma_m for point in found] == [2.0 * POINT_SIGMA_M] * 4 + [POINT_SIGMA_M]


@pytest.mark.parametrize(
    ("rows", "complaint"),
    [
        ("7,1,2,3\n", ":2: epoch 7 is not among the epochs with fields"),
        ("1,1,2,3\n1,1,2,3\n", ":3: epoch 1 comes twice"),
        ("1,,,\n", ":2: x_m is empty, as are y_m and z_m"),
        ("1,1e5,0,0\n", ":2: x_m is 100000, far outside"),
        ("1,a,0,0\n", ":2: x_m is .a., not a number"),
        ("", "has a header but no rows"),
    ],
)
def test_wrong_points_are_told(tmp_path, rows, complaint):
    with pytest.raises(UserError, match=complaint):
        points(tmp_path, "epoch,x_m,y_m,z_m\n" + rows)


def test_each_kind_of_known_value_is_read(tmp_path):
    distance, height, place, direction, current, sensor = known(
        tmp_path,
        """[known]
distance = [{between = ["b0", "b7"], m = 3.5, sd_m = 0.002}]
height = [{beacon = "b1", m = 2.5, sd_m = 0.01}]
position = [{beacon = "b2", m = [1, 2, 3], sd_m = 0.001}]
direction = [{beacon = "b3", axis = [0, 0, 2], sd_rad = 0.01}]
current = [{beacon = "b4", A = 9.9, sd = 0.001}]
sensor = [{beacon = "b5", m = [0.01, 0, -0.02], sd_m = 0.0005}]
""",
    )
    assert distance == Distance(("b0", "b7"), 3.5, 0.002)
    assert isinstance(height, Place)
    assert np.isnan(height.position_m[:2]).all()
    assert height.position_m[2] == 2.5
    assert isinstance(place, Place)
    assert place.position_m.tolist() == [1.0, 2.0, 3.0]
    assert isinstance(direction, Direction)
    assert direction.axis.tolist() == [0.0, 0.0, 1.0]
    assert current == Current("b4", 9.9, 0.001)
    assert isinstance(sensor, SensorPlace)
    assert (sensor.beacon, sensor.lever_m.tolist(), sensor.sd_m) == ("b5", [0.01, 0.0, -0.02], 0.0005)


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ('distance = [{between = ["b0", "b9"], m = 1, sd_m = 1}]', ':2: .*between names "b9", which the site does not'),
        ('distance = [{between = ["b0", "b0"], m = 1, sd_m = 1}]', "between must name two different beacons"),
        ('distance = [{between = "b0", m = 1, sd_m = 1}]', "between must be a list of names"),
        ('height = [{beacon = "b0", m = 1}]', "sd_m is missing"),
        ('height = [{beacon = "b0", m = 1, sd_m = 0}]', "sd_m is 0; a standard deviation is 0.000001 to 10 m"),
        ('height = [{beacon = "b0", m = 1, sd_m = 1e-99}]', "sd_m is 1e-99; a standard deviation is 0.000001 to 10 m"),
        ('height = [{beacon = "b0", m = 27000, sd_m = 2}]', "m is 27000, far outside of any room: give metres"),
        ('distance = [{between = ["b0", "b1"], m = 21300, sd_m = 2}]', "m is 21300, far outside of any room"),
        ('position = [{beacon = "b0", m = [0, 27000, 0], sd_m = 2}]', "far outside of any room"),
        ('direction = [{beacon = "b0", axis = [0, 0, 1], sd_rad = 9}]', "sd_rad is 9; .* is 0.000001 to 1 rad"),
        ('current = [{beacon = "b0", A = 9990, sd = 0.1}]', "A is 9990, and the site file says 10 A of b0"),
        ('current = [{beacon = "b0", A = 10, sd = 0}]', "sd is 0; a standard deviation is 0.000001 to 1"),
        ('current = [{beacon = "b0", A = -3, sd = 0.1}]', "has not the sign of b0's current"),
        ('sensor = [{beacon = "b0", m = [12, 0, 0], sd_m = 0.5}]', "m is 12 m from the centre of the coil"),
        ("hight = []", 'hight is no known key; did you mean "height"'),
        ("", "is empty: its keys are"),
    ],
)
def test_wrong_values_are_told(tmp_path, line, complaint):
    with pytest.raises(UserError, match=complaint):
        known(tmp_path, f"[known]\n{line}\n")

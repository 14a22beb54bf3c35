"""The file of sensors, and what a board needs to read the field itself."""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from goldfield.calibration.kept import KeptSensor, checked_id, corrected, keep, load_kept
from goldfield.errors import UserError

ONE, OTHER = "0102030405060708090a0b0c", "ffffffffffffffffffffffff"
AXES = np.array([[1.01, 0.002, -0.003], [0.0, 0.99, 0.004], [0.0, 0.0, 1.02]])


def kept(unique_id, **values):
    return KeptSensor(unique_id, AXES, np.array([1e-6, 2e-6, 3e-6]), 1e-3, 2e-4, **values)


def test_several_boards_are_kept_at_once_and_none_is_lost(tmp_path):
    ids = [f"{number:024x}" for number in range(8)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda unique_id: keep(tmp_path / "sensors.toml", kept(unique_id)), ids))
    assert set(load_kept(tmp_path / "sensors.toml")) == set(ids)


def test_a_corrected_board_reads_the_field():
    zero, matrix = np.array([2050.0, 2040.0, 2048.0]), 1e-7 * np.array([[1, 0.01, 0], [0, 0.98, 0], [0.01, 0, 1.0]])
    offset_T, field_T = np.array([1e-6, -2e-6, 0.5e-6]), np.array([2e-5, -3e-5, 4e-5])
    counts = zero + np.linalg.solve(matrix, AXES @ field_T + offset_T)
    new_zero, new_matrix = corrected(zero, matrix, AXES, offset_T)
    np.testing.assert_allclose(new_matrix @ (counts - new_zero), field_T, rtol=1e-12)


def test_a_sensor_is_kept_in_place_of_its_older_self(tmp_path):
    path = tmp_path / "sensors.toml"
    keep(path, kept(ONE))
    keep(path, kept(OTHER))
    keep(path, kept(ONE, zero=np.array([1.0, 2.0, 3.0]), calibration=1e-7 * np.eye(3)))
    found = load_kept(path)
    assert set(found) == {ONE, OTHER}
    np.testing.assert_array_equal(found[ONE].axes, AXES)
    np.testing.assert_array_equal(found[ONE].offset_T, [1e-6, 2e-6, 3e-6])
    np.testing.assert_array_equal(found[ONE].calibration, 1e-7 * np.eye(3))
    assert (found[ONE].gain_sd, found[ONE].axis_sd_rad) == (1e-3, 2e-4)
    assert found[OTHER].zero is None


def test_an_unknown_offset_is_left_out(tmp_path):
    path = tmp_path / "sensors.toml"
    keep(path, KeptSensor(ONE, AXES, np.full(3, np.nan), 1e-3, 2e-4))
    assert "offset_T" not in path.read_text()
    assert np.isnan(load_kept(path)[ONE].offset_T).all()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (ONE, "12", 'unique_id is "12"; it has 24 hexadecimal digits'),
        ("gain_sd", "gain_var", 'gain_var is no known key; did you mean "gain_sd"?'),
        ("axes = [[1.01", "axes = [[0.0, 0.0, 0.0], [1.01", "axes must be three rows of three numbers"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, old, new, words):
    path = tmp_path / "sensors.toml"
    keep(path, kept(ONE))
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(UserError, match=re.escape(words)):
        load_kept(path)


def test_unique_ids():
    assert checked_id(ONE.upper()) == ONE
    with pytest.raises(UserError, match="'12' is no unique id: 24 hexadecimal digits"):
        checked_id("12")

"""Errors of installation: the bench that is there differs from what site file and boards are told, as declared."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from goldfield.errors import UserError
from goldfield_protocol.parameters import parse_page
from hil_sim import scenario
from hil_sim.rig import Rig
from hil_sim.world import path
from tests.hil_sim.rig.fakes import FakeBoards, write_scenario

INSTALLATION = """
[installation]
seed = {seed}
position_sd_m = 0.01
axis_sd_rad = 0.02
current_sd = 0.005
sensor_gain_sd = 0.01
sensor_axis_sd_rad = 0.015
sensor_offset_sd_T = 1e-6
"""
BALL = """
[[metal]]
shape = "ball"
centre_m = [0.5, 0.6, 0.1]
radius_m = 0.1
material = "iron"
"""


def errant(directory, seed=1, more="", text=INSTALLATION):
    file = write_scenario(directory)
    file.write_text(file.read_text() + text.format(seed=seed) + more)
    return scenario.load(file)


def drawn(scene):
    """Return shifts, turns (two angles) and relative errors of the currents, of all beacons, one array each."""
    true = tomllib.loads(scenario.true_site_toml(scene))["beacon"]
    told = tomllib.loads(scenario.site_toml(scene))["beacon"]
    shifts = [np.subtract(a["position_m"], b["position_m"]) for a, b in zip(true, told, strict=True)]
    leans = [np.array(a["axis"])[:2] for a in true]
    currents = [a["current_A"] / b["current_A"] - 1.0 for a, b in zip(true, told, strict=True)]
    return np.concatenate(shifts), np.concatenate(leans), np.array(currents)


def test_the_errors_have_the_declared_deviations(tmp_path):
    """All coils point up, so that a turn shows in two of its three angles. 40 draws of three beacons."""
    benches = [drawn(errant(tmp_path, seed)) for seed in range(40)]
    for errors, declared in zip(zip(*benches, strict=True), (0.01, 0.02, 0.005), strict=True):
        found = np.concatenate(errors)
        assert found.std() == pytest.approx(declared, rel=4.0 / np.sqrt(2.0 * len(found)))
        assert abs(found.mean()) < 4.0 * declared / np.sqrt(len(found))


def test_site_and_boards_are_told_the_declared_deviations_and_not_the_errors(tmp_path):
    scene, exact = errant(tmp_path), errant(tmp_path, text="")
    told, page = tomllib.loads(scenario.site_toml(scene)), parse_page(scenario.parameter_page(scene, 0))
    assert told["survey"] == {"position_sd_m": 0.01, "axis_sd_rad": 0.02, "current_sd": 0.005}
    assert told["sensor"]["gain_sd"] == 0.01
    assert told["sensor"]["axis_sd_rad"] == pytest.approx(0.015 / np.sqrt(2.0))  # three angles of six are drawn
    assert told["beacon"] == tomllib.loads(scenario.site_toml(exact))["beacon"]
    np.testing.assert_allclose(page["survey"][:6], [0.01, 0.02, 0.005] * 2, rtol=1e-6)
    assert page["beacons"] == parse_page(scenario.parameter_page(exact, 0))["beacons"]
    assert page["calibration"] == parse_page(scenario.parameter_page(exact, 0))["calibration"]


def test_the_true_site_tells_the_sensors_matrix(tmp_path):
    """Its spread is that of gains and of the leaning; the lower triangle is zero, which fixes the sensor's frame."""
    matrices = []
    for seed in range(40):
        sensor = tomllib.loads(scenario.true_site_toml(errant(tmp_path, seed)))["sensor"]
        assert (sensor["gain_sd"], sensor["axis_sd_rad"]) == (0.0, 0.0)
        matrices.append(np.array(sensor["axes"]) - np.eye(3))
    matrices = np.array(matrices)
    assert np.abs(matrices[:, *np.tril_indices(3, -1)]).max() < 1e-15
    assert np.diagonal(matrices, axis1=1, axis2=2).std() == pytest.approx(0.01, rel=0.25)
    assert matrices[:, *np.triu_indices(3, 1)].std() == pytest.approx(0.015, rel=0.25)


def test_an_exact_bench_is_the_one_that_is_told(tmp_path):
    scene = errant(tmp_path, text="")
    assert tomllib.loads(scenario.true_site_toml(scene)) == tomllib.loads(scenario.site_toml(scene))


def test_the_field_at_the_sensor_is_that_of_the_true_coils_and_the_metal(tmp_path):
    """From the true site file alone, without the code that draws the errors."""
    file = write_scenario(tmp_path, bandwidth_Hz="0.0")
    file.write_text(file.read_text() + INSTALLATION.format(seed=3))
    bare = scenario.load(file)
    file.write_text(file.read_text() + BALL)
    scene = scenario.load(file)
    true = tomllib.loads(scenario.true_site_toml(scene))["beacon"]
    coils = [path.CoilGeometry(b["turns"], b["radius_m"], np.array(b["position_m"]), np.array(b["axis"])) for b in true]
    with Rig(bare, FakeBoards()) as rig, Rig(scene, FakeBoards()) as beside:
        for one in (rig, beside):
            one.run_until(round(0.0119 * 1e12))
        columns = path.columns(coils, bare.motion, np.array([rig.now_s]))[0]
        earth = columns[9:18].reshape(3, 3) @ [2e-5, 0.0, -4.5e-5]
        own = np.array([rig.coil_current_A(board) for board in (1, 2, 3)]) @ columns[:9].reshape(3, 3)
        np.testing.assert_allclose(rig.sensor_field_T(), own + earth, rtol=1e-6)
        added = beside.sensor_field_T() - rig.sensor_field_T()
        assert 0.005 < np.linalg.norm(added) / np.linalg.norm(own) < 0.5


def test_the_seed_is_the_scenarios_unless_given(tmp_path):
    text = INSTALLATION.replace("seed = {seed}\n", "")
    file = write_scenario(tmp_path)
    file.write_text(file.read_text() + text)
    assert scenario.load(file).installation.seed == 7
    other = scenario.load(file, seed=8)
    assert (other.seed, other.installation.seed) == (8, 8)
    assert np.abs(drawn(other)[0] - drawn(scenario.load(file))[0]).max() > 1e-3


def test_an_anchor_is_shifted_and_turned_with_its_coil():
    scene = scenario.load(scenario.SCENARIOS / "anchors4.toml")
    errors = scenario.Installation(seed=2, position_sd_m=0.02, axis_sd_rad=0.05)
    scene = replace(scene, installation=errors)
    for told, true in zip(scene.beacons, scene.installed.beacons, strict=True):
        apart = [np.linalg.norm(one.sensor.position_m - one.geometry.position_m) for one in (told, true)]
        assert apart[0] == pytest.approx(apart[1], rel=1e-12)
        up = [one.sensor.motion.poses(np.zeros(1))[1].inv().apply(one.geometry.axis)[0] for one in (told, true)]
        np.testing.assert_allclose(up[0], up[1], atol=1e-12)
        assert np.linalg.norm(true.geometry.position_m - told.geometry.position_m) > 1e-3


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("position_sd_m = 0.01", "position_sd_m = 10.0", "position_sd_m is 10; it is a standard deviation, from 0 to"),
        (
            "current_sd = 0.005",
            "current_sd = -0.1",
            "current_sd is -0.1; it is a standard deviation, from 0 to below 0.5",
        ),
        ("current_sd = 0.005", "current_sd = 1e-13", "current_sd is 1e-13; nothing is known so well: write 0 for"),
        ("axis_sd_rad = 0.02", "axis_sd_deg = 2", 'axis_sd_deg is no known key; did you mean "axis_sd_rad"?'),
        ('shape = "ball"', 'shape = "beam"', 'shape is "beam"; it must be one of sheet, ball'),
        ('material = "iron"', 'material = "gold"', 'material is "gold"; it must be one of conductor, iron'),
        ("radius_m = 0.1\n", "radius_m = 0.1\nside_m = 2.0\n", "side_m is no known key"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, old, new, words):
    assert old in INSTALLATION + BALL
    with pytest.raises(UserError, match=re.escape(words)):
        errant(tmp_path, text=(INSTALLATION + BALL).replace(old, new))

"""Walks, known points and turning in scenario files, and the table of known points."""

from __future__ import annotations

import re

import numpy as np
import pytest

from goldfield.errors import UserError
from hil_sim import command, scenario
from hil_sim.rig import point_row
from hil_sim.rig.truth import truth_at
from tests.hil_sim.rig.fakes import write_scenario

WALK = '"walk"\nlow_m = [0.2, 0.2, 0.2]\nhigh_m = [0.8, 0.8, 0.8]\nseconds = 20.0\nstart_s = 0.0'
POINTS = """
[[known_point]]
position_m = [0.5, 0.5, 0.3]
sigma_m = 0.002
cycles = 5

[[known_point]]
position_m = [0.3, 0.7, 0.5]
"""


def walking(directory, old="", new="", more=POINTS):
    file = write_scenario(directory, kind=WALK)
    text = (file.read_text() + more).replace('kind = "walk"', 'kind = "walk"', 1)
    text = re.sub(r"(?m)^ *position_m = \[0.5, 0.6, 0.4\]\n *rotation_vector_rad = .*\n", "", text)
    assert old in text
    file.write_text(text.replace(old, new))
    return file


def test_the_table_has_the_whole_cycles_at_each_point(tmp_path):
    scene = scenario.load(walking(tmp_path))
    cycle_s = scene.chips * scenario.CHIP_PERIOD_S
    truths = [truth_at(scene.motion, cycle, (cycle + 0.37) * cycle_s, cycle_s) for cycle in range(400)]
    rows = [row.split(",") for truth in truths if (row := point_row(scene, truth))]
    for position, sigma, count in (([0.5, 0.5, 0.3], 0.002, 5), ([0.3, 0.7, 0.5], 0.0, 20)):
        at_it = [row for row in rows if np.allclose([float(cell) for cell in row[1:4]], position)]
        assert len(at_it) in (count, count + 1)
        assert {float(row[4]) for row in at_it} == {sigma}
        epochs = [int(row[0]) for row in at_it]
        assert epochs == list(range(epochs[0], epochs[0] + len(epochs)))
        for epoch in epochs:
            middle_s = truths[epoch].time_s
            inside, _ = scene.motion.poses(middle_s + cycle_s * np.array([-0.5, 0.0, 0.5]))
            assert np.ptp(inside, axis=0).max() < 1e-12
            off = inside[1] - position
            assert np.linalg.norm(off) < 5.0 * sigma + 1e-12
            assert (np.linalg.norm(off) > 1e-5) == (sigma > 0.0)


def test_the_bench_writes_points_and_both_site_files(tmp_path):
    """The boards of the bench count cycles as the table does: the wire's first edge starts cycle 0."""
    file = walking(
        tmp_path, "seconds = 20.0", "seconds = 0.1", more=POINTS.replace("[0.3, 0.7, 0.5]", "[0.5, 0.5, 0.3]")
    )
    points, site, true = tmp_path / "points.csv", tmp_path / "site.toml", tmp_path / "true.toml"
    options = [str(file), "--boards", "host", "--seconds", "7", "--pace", "100"]
    options += ["--points", str(points), "--site", str(site), "--true-site", str(true)]
    assert command.main(options) == 0
    header, *rows = points.read_text().splitlines()
    assert header == "epoch,x_m,y_m,z_m,sigma_m"
    assert len(rows) >= 5
    assert rows[0].endswith(",0.500000,0.500000,0.300000,0.002000")
    assert site.read_text() != true.read_text()


def test_points_without_known_points_are_an_error(tmp_path, capsys):
    points = tmp_path / "points.csv"
    assert command.main(["prigge8", "--boards", "host", "--seconds", "0.01", "--points", str(points)]) == 2
    assert "has no [[known_point]] at which a walk stands still" in capsys.readouterr().err
    assert not points.exists()


def test_turning_in_a_scenario(tmp_path):
    file = walking(tmp_path, WALK, '"turning"\nposition_m = [0.5, 0.6, 0.4]\nseconds = 60.0\nsway_m = 0.01', more="")
    positions, rotations = scenario.load(file).motion.poses(np.linspace(0.0, 60.0, 500))
    assert np.linalg.norm(positions.mean(axis=0) - [0.5, 0.6, 0.4]) < 0.02
    assert rotations.magnitude().max() > 2.5


ROAMING = '"roaming"\nlow_m = [0.2, 0.2, 0.2]\nhigh_m = [0.8, 0.8, 0.8]\nspeed_m_per_s = 1.0'


def test_roaming_in_a_scenario(tmp_path):
    shake = "rate_rad_per_s = 0.0\nshake_Hz = 2.0\nshake_m = 0.05"
    motion = scenario.load(walking(tmp_path, WALK, f"{ROAMING}\n{shake}", more="")).motion
    positions, rotations = motion.poses(np.arange(0.0, 30.0, 1e-3))
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) / 1e-3
    assert 1.0 < np.sqrt((speed**2).mean()) < 1.3
    assert (rotations[0].inv() * rotations).magnitude().max() < 1e-7


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("shake_m = 0.05", "shake_Hz is missing or 0, and there is something to shake: say how often"),
        ("shake_rad = -1.0", "shake_rad is -1; it must not be negative"),
        ("seconds = 3.0", "seconds is no known key"),
    ],
)
def test_what_is_wrong_with_roaming_is_said(tmp_path, key, words):
    with pytest.raises(UserError, match=re.escape(words)):
        scenario.load(walking(tmp_path, WALK, f"{ROAMING}\n{key}", more=""))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("low_m = [0.2, 0.2, 0.2]", "low_m = [0.9, 0.2, 0.2]", "high_m is below low_m: give the corner of the box"),
        ("seconds = 20.0", "seconds = 20000.0", "seconds is 20000; at most 3600 are possible"),
        ("seconds = 20.0", "seconds = 20.0\ntilt_rad = 20.0", "tilt_rad is 20; it is an angle in radians, at most pi"),
        ("seconds = 20.0", "seconds = 20.0\nspeed_m_per_s = 0.0", "speed_m_per_s is 0; it must be greater than zero"),
        ("cycles = 5", "cycles = 0", "[[known_point]] 1: cycles is 0; it must lie in 1 to 10000"),
        ("cycles = 5", "weeks = 5", "[[known_point]] 1: weeks is no known key"),
        ("low_m = [0.2, 0.2, 0.2]", "low_m = [-2e4, 0, 0]", "low_m has 20000; a sensor is at most 10000 m from the"),
        ("[0.5, 0.5, 0.3]", "[0.5, 1e12, 0.3]", "[[known_point]] 1: position_m has 1e+12; a sensor is at most"),
        (
            "seconds = 20.0",
            "seconds = 20.0\nspeed_m_per_s = 1001.0",
            "speed_m_per_s is 1001; at most 1000 are possible",
        ),
        ("sigma_m = 0.002", "sigma_m = 1.0", "sigma_m is 1; it is a standard deviation, from 0 to below 1"),
        (
            WALK,
            '"still"\nposition_m = [0.5, 0.6, 0.4]',
            'are stops of a walk, and the motion is "still": make it "walk"',
        ),
    ],
)
def test_what_is_wrong_is_said(tmp_path, old, new, words):
    with pytest.raises(UserError, match=re.escape(words)):
        scenario.load(walking(tmp_path, old, new))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("sway_m = 0.01", "sway_m = 1e9", "sway_m is 1e+09; at most 1 are possible"),
        ("sway_m = 0.01", "rate_rad_per_s = 1e9", "rate_rad_per_s is 1e+09; at most 1000 are possible"),
        ("[0.5, 0.6, 0.4]", "[1e12, 0, 0]", "position_m has 1e+12; a sensor is at most 10000 m from the origin"),
        ("[0.5, 0.6, 0.4]", "[1, 2]", "position_m must be three finite numbers [x, y, z], not [1, 2]"),
        ("sway_m = 0.01", "seed = -1", "seed must lie in 0 to 2^63 - 1"),
        ("sway_m = 0.01", "sway = 0.01", 'sway is no known key; did you mean "sway_m"?'),
        ("seconds = 60.0", "seconds = 1979-05-27", "must be a finite number, not the date or time 1979-05-27"),
        ('"turning"', '"turnin"', 'kind is "turnin"; it must be one of still, line'),
    ],
)
def test_what_is_wrong_with_turning_is_said(tmp_path, old, new, words):
    turning = '"turning"\nposition_m = [0.5, 0.6, 0.4]\nseconds = 60.0\nsway_m = 0.01'
    with pytest.raises(UserError, match=re.escape(words)):
        scenario.load(walking(tmp_path, WALK, turning.replace(old, new), more=""))


@pytest.mark.parametrize("key", ["velocity_m_per_s", "rate_rad_per_s"])
def test_a_line_that_nothing_can_follow_is_refused(tmp_path, key):
    line = '"line"\nposition_m = [0.5, 0.6, 0.4]\n' + key
    with pytest.raises(UserError, match=f"{key} has 2000; at most 1000 are possible"):
        scenario.load(walking(tmp_path, WALK, f"{line} = [0.0, -2000.0, 0.0]", more=""))
    scenario.load(walking(tmp_path, WALK, f"{line} = [0.0, -1000.0, 0.0]", more=""))


def test_the_truth_of_a_walk_has_its_course_and_that_of_a_stop_none(tmp_path):
    scene = scenario.load(walking(tmp_path))
    cycle_s = scene.chips * scenario.CHIP_PERIOD_S
    moving = standing = 0
    for cycle in range(0, 400, 7):
        truth = truth_at(scene.motion, cycle, (cycle + 0.5) * cycle_s, cycle_s)
        moving += len(truth.course) > 0
        standing += "course" not in truth.as_dict()
        if not len(truth.course):
            continue
        np.testing.assert_allclose(truth.course[[0, -1], 0], [cycle * cycle_s, (cycle + 1) * cycle_s])
        assert np.diff(truth.course[:, 0]).max() <= 0.003
        positions, attitudes = scene.motion.poses(truth.course[:, 0])
        np.testing.assert_allclose(truth.course[:, 1:4], positions)
        np.testing.assert_allclose(truth.course[:, 4:], attitudes.as_quat(canonical=True))
    assert moving > 10
    assert standing > 3

"""Coils with a shape: their wires against magpylib, by generators of their own, formulas and current sheets."""

import math
import re
import tomllib
from pathlib import Path

import magpylib
import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.spatial.transform import Rotation

from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.site import load
from goldfield.site.coil_shapes import SHAPES
from goldfield.site.revision import BeaconRevision, revised

HEAD = """\
[site]
name = "shapes"
chip_period_s = 97.75e-6
degree = 10

[sensor]
noise_T = 1e-7

[[beacon]]
id = "a"
code = 1
"""
PLACE = """\
position_m = [0.3, -0.2, 1.0]
axis = [1.0, 2.0, 2.0]
angle_rad = 0.7
current_A = 2.0
"""
HERE = "position_m = [0, 0, 0]\naxis = [0, 0, 1]\ncurrent_A = 2.0\n"
SQUARE = 'shape = "square_spiral"\nsides_m = [0.07, 0.05]\npitch_m = 0.0025\nturns = 8\n'
ROUND = 'shape = "round_spiral"\nradius_m = 0.05\npitch_m = 0.002\nturns = 12\n'
RECTANGLE = 'shape = "rectangle"\nsides_m = [0.6, 0.4]\nturns = 19\n'
SOLENOID = 'shape = "solenoid"\nradius_m = 0.02\nlength_m = 0.1\nturns = 100\n'
TWO = "layers = 2\nlayer_pitch_m = 0.0016\n"
DOCS = Path(__file__).resolve().parents[3] / "docs" / "site_file.md"


@pytest.fixture
def coil(tmp_path):
    """Return a function from a beacon's lines to the beacon."""

    def read(*lines):
        path = tmp_path / "site.toml"
        path.write_text(HEAD + "".join(lines))
        return load(path).beacons[0]

    return read


def around(rng, nearest, farthest, count=200):
    direction = rng.normal(size=(count, 3))
    return direction / np.linalg.norm(direction, axis=1)[:, None] * rng.uniform(nearest, farthest, size=(count, 1))


def model_field(beacon, points):
    return FieldModel((beacon,)).evaluate(points.T)[0][..., 0].T


def agree(found, truth, tolerance):
    worst = np.linalg.norm(found - truth, axis=1) / np.linalg.norm(truth, axis=1)
    assert worst.max() < tolerance


def test_a_square_spiral_is_the_wire_that_is_drawn_by_hand(coil):
    """Two turns of 10 x 8 mm with a pitch of 1 mm: every corner, then straight back to the first one."""
    beacon = coil('shape = "square_spiral"\nsides_m = [0.010, 0.008]\npitch_m = 0.001\nturns = 2\n', HERE)
    by_hand = [(5, 4), (-5, 4), (-5, -4), (5, -4), (5, 3), (-4, 3), (-4, -3), (4, -3), (4, 2), (5, 4)]
    np.testing.assert_allclose(beacon.points_m[:, :2], 1e-3 * np.array(by_hand), atol=1e-15)
    np.testing.assert_array_equal(beacon.points_m[:, 2], 0.0)


def test_the_second_layer_of_a_square_spiral_runs_outward_in_the_same_sense(coil):
    beacon = coil('shape = "square_spiral"\nsides_m = [0.010, 0.008]\npitch_m = 0.001\nturns = 2\n', TWO, HERE)
    lower, upper = beacon.points_m[:9], beacon.points_m[9:18]
    np.testing.assert_allclose([lower[0, 2], upper[0, 2]], [-0.0008, 0.0008])
    area = [0.5 * np.sum(p[:-1, 0] * p[1:, 1] - p[1:, 0] * p[:-1, 1]) for p in (lower, upper)]
    assert min(area) > 0.0
    np.testing.assert_allclose(upper[-1, :2], lower[0, :2])
    np.testing.assert_allclose(np.linalg.norm(upper[0, :2] - lower[-1, :2]), 0.001 * math.sqrt(2.0))
    along = np.abs(np.diff(upper[:, :2], axis=0)).min(axis=1)
    np.testing.assert_allclose(along, 0.0, atol=1e-15)  # each side is parallel to x or y


@pytest.mark.parametrize("layers", ["", TWO])
def test_a_round_spiral_is_magpylibs_spiral(coil, layers):
    """A curve of 720 pieces a turn: r falls by a pitch a turn, in the next layer it rises again."""
    beacon = coil(ROUND, layers, HERE)
    turned = np.linspace(0.0, 12.0, 12 * 720 + 1)
    radius, angle = 0.05 - 0.002 * turned, 2.0 * np.pi * turned
    wire = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(len(angle))])
    if layers:
        back = np.column_stack([radius[::-1] * np.cos(angle), radius[::-1] * np.sin(angle), np.full(len(angle), 8e-4)])
        wire = np.concatenate([wire - [0.0, 0.0, 8e-4], back])
    wire = np.concatenate([wire, wire[:1]])
    points = around(np.random.default_rng(1), 0.07, 0.12)
    agree(model_field(beacon, points), magpylib.current.Polyline(current=2.0, vertices=wire).getB(points), 1e-3)


def test_a_round_spiral_is_nearly_a_set_of_circles(coil):
    points = around(np.random.default_rng(2), 0.3, 0.5)
    circles = [magpylib.current.Circle(diameter=2 * (0.05 - 0.002 * (k + 0.5)), current=2.0) for k in range(12)]
    agree(model_field(coil(ROUND, HERE), points), magpylib.getB(circles, points, sumup=True), 0.02)


def test_a_rectangle_is_magpylibs_in_the_frame_that_the_file_says(coil):
    beacon = coil(RECTANGLE, PLACE)
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    across = np.cross([0.0, 0.0, 1.0], axis)
    tilt = Rotation.from_rotvec(across / np.linalg.norm(across) * math.acos(axis[2]))
    corners = np.array([[0.3, 0.2, 0], [-0.3, 0.2, 0], [-0.3, -0.2, 0], [0.3, -0.2, 0], [0.3, 0.2, 0]])
    truth = magpylib.current.Polyline(
        current=38.0,
        vertices=corners,
        position=[0.3, -0.2, 1.0],
        orientation=tilt * Rotation.from_rotvec([0.0, 0.0, 0.7]),
    )
    points = np.array([0.3, -0.2, 1.0]) + around(np.random.default_rng(3), 0.5, 1.0)
    agree(model_field(beacon, points), truth.getB(points), 1e-9)
    np.testing.assert_allclose(beacon.moment_A_m2, 38.0 * 0.24 * axis, rtol=1e-12)


def test_a_solenoid_on_its_axis_is_the_formula(coil):
    z = np.linspace(-0.15, 0.15, 31)
    half, radius = 0.05, 0.02
    wanted = (
        0.5
        * mu_0
        * 2.0
        * 100
        / 0.1
        * ((z + half) / np.hypot(z + half, radius) - (z - half) / np.hypot(z - half, radius))
    )
    points = np.column_stack([np.zeros((31, 2)), z])
    found = model_field(coil(SOLENOID, HERE), points)
    np.testing.assert_allclose(found[:, 2], wanted, rtol=2e-3)


def test_a_solenoid_of_two_layers_is_two_current_sheets(coil):
    """A uniformly magnetised cylinder has the field of a current sheet around it, outside."""
    beacon = coil(SOLENOID, TWO, HERE)
    points = around(np.random.default_rng(4), 0.08, 0.2)
    sheets = [
        magpylib.magnet.Cylinder(polarization=(0, 0, mu_0 * 100 * 2.0 / 0.1), dimension=(2 * radius, 0.1))
        for radius in (0.02, 0.0216)
    ]
    agree(model_field(beacon, points), magpylib.getB(sheets, points, sumup=True), 2e-3)


@pytest.mark.parametrize(
    ("lines", "area"),
    [
        (RECTANGLE.replace("turns = 19", "turns = 1"), 0.24),
        (ROUND, sum(math.pi / 3.0 * ((0.05 - 0.002 * k) ** 3 - (0.048 - 0.002 * k) ** 3) / 0.002 for k in range(12))),
        (ROUND + TWO, 2 * math.pi / 3.0 * (0.05**3 - 0.026**3) / 0.002),
        (SOLENOID, 100 * math.pi * 0.02**2),
        (SOLENOID + "layers = 3\nlayer_pitch_m = 0.001\n", 100 * math.pi * (0.02**2 + 0.021**2 + 0.022**2)),
    ],
)
def test_the_moment_is_the_sum_of_the_areas(coil, lines, area):
    np.testing.assert_allclose(coil(lines, HERE).moment_A_m2[2], 2.0 * area, rtol=3e-4)


@pytest.mark.parametrize(("layers", "tolerance"), [(1, 1e-12), (2, 0.02), (3, 0.02)])
def test_the_moment_of_a_square_spiral(coil, layers, tolerance):
    """What the inner ends of the turns lack the way back adds: one layer has just the squares of its outer sides."""
    square = SQUARE.replace("0.05]", "0.07]")
    beacon = coil(square, f"layers = {layers}\nlayer_pitch_m = 0.0016\n", HERE)
    area = layers * sum((0.07 - 0.005 * k) ** 2 for k in range(8))
    np.testing.assert_allclose(beacon.moment_A_m2[2], 2.0 * area, rtol=tolerance)


@pytest.mark.parametrize("lines", [RECTANGLE, SQUARE, SQUARE + TWO, ROUND, ROUND + TWO, SOLENOID, SOLENOID + TWO])
def test_every_wire_returns_and_a_beacon_is_where_the_file_says(coil, lines):
    beacon = coil(lines, PLACE)
    np.testing.assert_array_equal(beacon.points_m[0], beacon.points_m[-1])
    np.testing.assert_array_equal(beacon.position_m, [0.3, -0.2, 1.0])
    np.testing.assert_allclose(beacon.axis, np.array([1.0, 2.0, 2.0]) / 3.0)
    assert beacon.moment_A_m2 @ beacon.axis > 0.99 * np.linalg.norm(beacon.moment_A_m2)


def test_a_revised_coil_turns_as_a_rigid_body(coil, tmp_path):
    before, new = coil(SQUARE, TWO, PLACE), np.array([-0.6, 0.0, 0.8])
    position = np.array([1.0, 2.0, 3.0])
    path = tmp_path / "new.toml"
    path.write_text(revised(tmp_path / "site.toml", {"a": BeaconRevision(position, new)}))
    after = load(path).beacons[0]
    turn, _ = Rotation.align_vectors(after.points_m - position, before.points_m - before.position_m)
    np.testing.assert_allclose(turn.apply(before.points_m - before.position_m), after.points_m - position, atol=1e-12)
    np.testing.assert_allclose(turn.magnitude(), math.acos(before.axis @ new), atol=1e-9)
    assert 'shape = "square_spiral"' in path.read_text()


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (HERE + 'shape = "spiral"\n', 'shape is "spiral"; shapes are rectangle, square_spiral'),
        (HERE + SQUARE.replace("turns = 8", "turns = 10"), "turns are 10 with a pitch of 0.0025 m"),
        (
            HERE + ROUND.replace("turns = 12", "turns = 2.5"),
            "turns is 2.5; a wire that is drawn turn by turn has whole",
        ),
        (HERE + SOLENOID.replace("turns = 100", "turns = 312"), "at most 311 are drawn"),
        (HERE + SOLENOID + "layers = 4\nlayer_pitch_m = 0.001\n", "are 400 with all layers"),
        (HERE + SOLENOID + "layers = 2\n", "layer_pitch_m is missing"),
        (HERE + SOLENOID + "sides_m = [0.1, 0.1]\n", "sides_m is no key of a solenoid"),
        (HERE + RECTANGLE + "radius_m = 0.1\n", "radius_m is no key of a rectangle"),
        (HERE + RECTANGLE.replace("[0.6, 0.4]", "[0.6]"), "sides_m must be two lengths"),
        (HERE + RECTANGLE.replace("[0.6, 0.4]", "[600, 400]"), "if it is in millimetres, that is 0.6 m"),
        (HERE + "turns = 3\nradius_m = 0.1\npitch_m = 0.01\n", "pitch_m is only for a coil with a shape"),
        (HERE.replace("axis = [0, 0, 1]\n", "") + RECTANGLE, "axis is missing"),
    ],
)
def test_what_cannot_be_drawn_is_refused(coil, lines, words):
    with pytest.raises(UserError, match=re.escape(words)):
        coil(lines)


def test_the_examples_of_the_docs_are_whole_and_name_every_shape(tmp_path):
    blocks = [block for block in re.findall(r"```toml\n(.*?)```", DOCS.read_text(), re.DOTALL) if "shape = " in block]
    blocks = [block for block in blocks if "[[beacon]]" in block]
    path = tmp_path / "site.toml"
    path.write_text(HEAD.split("[[beacon]]")[0] + "".join(blocks))
    beacons = load(path).beacons
    assert all(np.linalg.norm(beacon.moment_A_m2) > 0.0 for beacon in beacons)
    shapes = {table["shape"] for table in tomllib.loads(path.read_text())["beacon"]}
    assert shapes == set(SHAPES)

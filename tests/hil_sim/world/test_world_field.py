"""Coil fields along a path, against textbook formulas and against direct evaluation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil_sim import clib
from hil_sim.world import path
from hil_sim.world.motion import Line, Still, Waypoints

MU0 = 1.25663706127e-6
ORIGIN, UP = np.zeros(3), np.array([0.0, 0.0, 1.0])


def loop(axis=UP, position=ORIGIN, turns=19.0, radius=0.149):
    return path.CoilGeometry(turns=turns, radius_m=radius, position_m=np.asarray(position), axis=np.asarray(axis))


def on_axis(distance, turns=19.0, radius=0.149):
    """Jackson, 5.5: field of a loop on its axis."""
    return MU0 * turns * radius**2 / (2.0 * (radius**2 + distance**2) ** 1.5)


@pytest.mark.parametrize("axis", [UP, -UP, [1.0, 0.0, 0.0], [0.6, 0.0, -0.8], [2 / 3, -2 / 3, 1 / 3]])
@pytest.mark.parametrize("distance", [0.05, 0.5, 2.0])
def test_loop_on_its_axis(axis, distance):
    axis = np.asarray(axis, dtype=float)
    center = np.array([0.3, -0.2, 0.1])
    field = loop(axis, center).field_per_ampere((center + distance * axis)[None, :])[0]
    np.testing.assert_allclose(field, on_axis(distance) * axis, rtol=1e-9, atol=1e-18)


def test_square_wire_at_its_center():
    side = 0.4
    corners = side / 2 * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0], [1, 1, 0]], dtype=float)
    wire = path.CoilGeometry(turns=3.0, radius_m=None, position_m=ORIGIN, axis=UP, points_m=corners)
    expected = 3.0 * 2.0 * np.sqrt(2.0) * MU0 / (np.pi * side)
    np.testing.assert_allclose(wire.field_per_ampere(np.zeros((1, 3)))[0], [0.0, 0.0, expected], rtol=1e-9, atol=1e-18)


def test_many_coils_at_once_are_each_alone(monkeypatch):
    """Loops any way up, on their axis and off it, and a wire among them, in one call of magpylib and in several."""
    random = np.random.default_rng(5)
    coils = [loop(random.normal(size=3), random.normal(size=3), 19.0 + i, 0.1 + 0.01 * i) for i in range(7)]
    corners = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, 1, 0]], dtype=float)
    coils.insert(3, path.CoilGeometry(turns=2.0, radius_m=None, position_m=ORIGIN, axis=UP, points_m=corners))
    points = np.vstack([random.normal(0.0, 3.0, (20, 3)), coils[1].position_m + np.outer([0.0, 0.4], coils[1].axis)])
    alone = np.stack([coil.field_per_ampere(points) for coil in coils], axis=1)
    size = np.linalg.norm(alone, axis=2, keepdims=True)
    for at_once in (path.FIELDS_AT_ONCE, 3 * len(points), 1):
        monkeypatch.setattr(path, "FIELDS_AT_ONCE", at_once)
        assert np.max(np.abs(path.fields_per_ampere(coils, points) - alone) / size) < 1e-12


def test_columns_are_in_the_sensors_frame():
    motion = Still(np.array([0.0, 0.0, 0.7]), np.array([np.pi / 2, 0.0, 0.0]))
    values = path.columns([loop()], motion, np.array([0.0]))[0]
    # The sensor is turned by a quarter about x: the site's z is its own y.
    np.testing.assert_allclose(values[:3], [0.0, on_axis(0.7), 0.0], rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(values[3:12].reshape(3, 3), [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-15)


MOTIONS = {
    "line": Line(
        np.array([0.2, 0.1, 0.5]), np.array([0.1, 0.2, 0.3]), np.array([1.5, 0.5, -0.2]), np.array([1.0, 2.0, -3.0])
    ),
    "waypoints": Waypoints(
        np.array([0.1, 0.45, 1.3]),
        np.array([[0.0, 0.3, 0.4], [0.5, 0.5, 0.5], [0.4, 1.0, 0.6]]),
        np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.5], [1.0, 1.0, 1.0]]),
    ),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_interpolation_error_is_below_its_bound(name):
    coils = [loop(), loop([0.6, 0.0, 0.8], [1.0, 0.2, 0.0])]
    computed = path.compute(coils, MOTIONS[name], -0.001, 1.001)
    ffi, library = clib.load("build/libgf_rig.so", ["world/path.h"])
    table = np.ascontiguousarray(computed.coefficients)
    handed = ffi.new("path_t *")
    handed.start_ps, handed.interval_ps = round(computed.start_s * 1e12), round(computed.interval_s * 1e12)
    handed.intervals, handed.columns = table.shape[:2]
    handed.coefficients = ffi.from_buffer("double[]", table)
    times_ps = np.sort(np.random.default_rng(3).integers(0, 10**12, 2000))
    got, x = np.empty((len(times_ps), table.shape[1])), ffi.new("double *")
    for row, time_ps in zip(got, times_ps, strict=True):
        interval = table[library.path_interval(handed, int(time_ps), x)]
        library.path_columns(ffi.from_buffer("double[]", interval), len(row), x[0], ffi.from_buffer("double[]", row))
    truth = path.columns(coils, MOTIONS[name], times_ps * 1e-12)
    for group in range(truth.shape[1] // 3 - 1):  # The last one is that of magnets, of which there are none.
        part = slice(3 * group, 3 * group + 3)
        error = np.linalg.norm(got[:, part] - truth[:, part], axis=1) / np.linalg.norm(truth[:, part], axis=1)
        assert error.max() < 1e-5


def test_waypoints_are_met_and_held():
    motion = MOTIONS["waypoints"]
    positions, rotations = motion.poses(np.array([-1.0, 0.1, 0.45, 1.3, 9.0]))
    np.testing.assert_allclose(positions[[0, 1]], [[0.0, 0.3, 0.4]] * 2, atol=1e-12)
    np.testing.assert_allclose(positions[[3, 4]], [[0.4, 1.0, 0.6]] * 2, atol=1e-12)
    np.testing.assert_allclose(positions[2], [0.5, 0.5, 0.5], atol=1e-12)
    expected = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.0, 1.0, 0.5], [1.0, 1.0, 1.0]])
    np.testing.assert_allclose((rotations[[1, 2, 3]] * expected.inv()).magnitude(), 0.0, atol=1e-7)


def test_line_turns_in_the_sites_frame():
    motion = Line(ORIGIN, np.array([np.pi / 2, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, np.pi / 2]))
    position, rotation = motion.poses(np.array([1.0]))
    np.testing.assert_allclose(position[0], [1.0, 0.0, 0.0])
    # The sensor's y points along the site's z at first, and stays there: the turn is about the site's z.
    np.testing.assert_allclose(rotation.apply([0.0, 1.0, 0.0])[0], [0.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("place", [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.3, -7.1, 2.9]])
@pytest.mark.parametrize("angle", np.linspace(0.0, 6.0, 7))
def test_through_the_wire_is_an_error(place, angle):
    """Wherever the coil is: its place added and taken off rounds."""
    on_wire = place + 0.149 * np.array([np.cos(angle), np.sin(angle), 0.0])
    with pytest.raises(path.PathError, match="through a coil's wire"):
        path.compute([loop(position=place)], Still(on_wire, ORIGIN), 0.0, 1.0)
    path.compute([loop(position=place)], Still(on_wire + 1e-6 * UP, ORIGIN), 0.0, 1.0)

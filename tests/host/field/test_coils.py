"""Coil fields against magpylib (independent code), gradients against complex steps."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest

from goldfield.field import FieldModel
from goldfield.field.dipole import dipole
from goldfield.field.loop import loop
from goldfield.field.polyline import polyline
from goldfield.site import Beacon
from goldfield.site.constants import MU_0

RADIUS = 0.149


def test_the_magnetic_constant_is_that_of_magpylib():
    assert magpylib.mu_0 == MU_0


def relative(ours, theirs):
    scale = np.linalg.norm(theirs, axis=-1, keepdims=True)
    return np.max(np.abs(ours - theirs) / scale)


def random_directions(rng, n):
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def loop_points(kind):
    rng = np.random.default_rng(7)
    n = 300
    if kind == "anywhere":
        return random_directions(rng, n) * rng.uniform(0.01, 3.0, size=(n, 1))
    if kind == "far":
        return random_directions(rng, n) * np.geomspace(3.0, 300.0, n)[:, None]
    if kind == "near axis":
        p = rng.normal(size=(n, 3)) * [1.0, 1.0, 0.0] * np.geomspace(1e-12, 1e-3, n)[:, None]
        return p + [0.0, 0.0, 1.0] * rng.uniform(-1.0, 1.0, size=(n, 1))
    if kind == "near wire":
        angle = rng.uniform(0, 2 * np.pi, n)
        ring = RADIUS * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        return ring + random_directions(rng, n) * np.geomspace(1e-3, 1e-2, n)[:, None]
    return rng.uniform(-1, 1, size=(n, 3)) * [1.0, 1.0, 0.0]  # in the plane


def turned_loop(points, **extra):
    """Place our loop obliquely, magpylib's likewise; returns both fields."""
    rotation = magpylib_rotation()
    axis = rotation.apply([0.0, 0.0, 1.0])
    at = rotation.apply(points)
    ours, gradient = loop(at.T, axis[:, None], np.array(RADIUS), np.array(190.0))
    theirs = magpylib.current.Circle(diameter=2 * RADIUS, current=190.0, orientation=rotation).getB(at)
    return ours, gradient, theirs, at, axis


def magpylib_rotation():
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec([0.3, -0.8, 0.4])


@pytest.mark.parametrize("kind", ["anywhere", "far", "near axis", "near wire", "in the plane"])
def test_loop_agrees_with_magpylib(kind):
    ours, _, theirs, _, _ = turned_loop(loop_points(kind))
    assert relative(ours.T, theirs) < 1e-9


@pytest.mark.parametrize("kind", ["anywhere", "far", "near axis", "near wire", "in the plane"])
def test_loop_gradient_agrees_with_complex_step(kind):
    _, gradient, _, at, axis = turned_loop(loop_points(kind))
    size = np.linalg.norm(gradient, axis=(0, 1))
    for j in range(3):
        stepped = at.T.astype(complex)
        stepped[j] += 1e-30j
        # Complex lengths need the plain square root of the sum of squares, which the loop uses throughout.
        column = loop(stepped, axis[:, None], np.array(RADIUS), np.array(190.0))[0].imag / 1e-30
        assert np.max(np.abs(column - gradient[:, j]) / size) < (1e-6 if kind == "near axis" else 1e-9)


@pytest.mark.parametrize("kind", ["anywhere", "far", "near axis", "near wire", "in the plane"])
def test_loop_gradient_is_free_of_curl_and_divergence(kind):
    _, gradient, _, _, _ = turned_loop(loop_points(kind))
    size = np.linalg.norm(gradient, axis=(0, 1))
    assert np.max(np.abs(np.trace(gradient)) / size) < 1e-9
    assert np.max(np.abs(gradient - gradient.swapaxes(0, 1)) / size) < 1e-9


def test_loop_on_its_axis_and_at_its_centre_is_textbook():
    z = np.array([0.0, 0.05, 0.149, 1.0, 30.0])
    points = np.stack([0 * z, 0 * z, z])
    field, gradient = loop(points, np.array([0.0, 0.0, 1.0])[:, None], np.array(RADIUS), np.array(10.0))
    expected = 2e-7 * np.pi * 10.0 * RADIUS**2 / (RADIUS**2 + z**2) ** 1.5
    slope = -3.0 * z * expected / (RADIUS**2 + z**2)
    np.testing.assert_allclose(field[2], expected, rtol=1e-9)
    np.testing.assert_allclose(field[:2], 0.0, atol=1e-30)
    np.testing.assert_allclose(gradient[2, 2], slope, rtol=1e-9, atol=1e-20)
    np.testing.assert_allclose(gradient[0, 0], -slope / 2, rtol=1e-9, atol=1e-20)


def test_dipole_agrees_with_magpylib():
    rng = np.random.default_rng(1)
    points, moment = rng.normal(size=(200, 3)), np.array([1.0, -4.0, 13.0])
    ours, gradient = dipole(points.T, moment[:, None])
    assert relative(ours.T, magpylib.misc.Dipole(moment=moment).getB(points)) < 1e-9
    for j in range(3):
        stepped = points.T.astype(complex)
        stepped[j] += 1e-30j
        column = dipole(stepped, moment[:, None])[0].imag / 1e-30
        np.testing.assert_allclose(column, gradient[:, j], rtol=0, atol=1e-9 * np.abs(gradient).max())


def spiral(turns=9, side=0.07, pitch=0.003, centre=(0.0, 0.0, 0.0)):
    """A square spiral inward, in the plane of its centre."""
    half = side / 2 - pitch * np.arange(4 * turns + 1) / 4
    corner = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    xy = half[:, None] * corner[np.arange(4 * turns + 1) % 4]
    return np.column_stack([xy, np.zeros(len(xy))]) + np.asarray(centre)


def test_polyline_agrees_with_magpylib():
    rng = np.random.default_rng(2)
    wires = [spiral(), spiral(5, 0.05, 0.004, (0.1, 0.0, 0.02))]
    points = rng.uniform(-0.3, 0.3, size=(200, 3))
    for wire in wires:
        model = FieldModel([wire_beacon(wire)])
        theirs = magpylib.current.Polyline(current=2.5, vertices=wire).getB(points)
        assert relative(model.field(points)[:, 0], theirs) < 1e-9
    together = FieldModel([wire_beacon(wire) for wire in wires])
    np.testing.assert_array_equal(together.field(points)[:, 0], FieldModel([wire_beacon(wires[0])]).field(points)[:, 0])


def test_polyline_gradient_agrees_with_complex_step():
    rng = np.random.default_rng(3)
    wire = spiral()
    start, end = wire[:-1].T[:, None, :], wire[1:].T[:, None, :]
    points = rng.uniform(-0.3, 0.3, size=(100, 3)).T
    _, gradient = polyline(points[..., None], start[:, None], end[:, None], np.array([2.5]))
    size = np.linalg.norm(gradient, axis=(0, 1))
    for j in range(3):
        stepped = points.astype(complex)
        stepped[j] += 1e-30j
        column = polyline(stepped[..., None], start[:, None], end[:, None], np.array([2.5]))[0].imag / 1e-30
        assert np.max(np.abs(column - gradient[:, j]) / size) < 1e-9


def wire_beacon(points, current=2.5):
    from goldfield.site import area_vector

    area = area_vector(points)
    return Beacon("w", points.mean(axis=0), area / np.linalg.norm(area), 1.0, None, points, current, 2)


def loop_beacon(position, axis=(0.0, 0.0, 1.0)):
    return Beacon("l", np.array(position), np.array(axis), 19.0, RADIUS, None, 10.0, 3)


def test_model_puts_each_kind_of_coil_in_its_place():
    rng = np.random.default_rng(4)
    beacons = [
        loop_beacon([0.0, 0.0, 0.0]),
        wire_beacon(spiral(centre=(1.0, 0, 0))),
        loop_beacon([0, 1, 1], (0.6, 0, 0.8)),
    ]
    points = rng.uniform(-1, 2, size=(5, 7, 3))
    field, gradient = FieldModel(beacons).field_and_gradient(points)
    assert field.shape == (5, 7, 3, 3)
    assert gradient.shape == (5, 7, 3, 3, 3)
    for i, beacon in enumerate(beacons):
        alone, alone_gradient = FieldModel([beacon]).field_and_gradient(points)
        np.testing.assert_allclose(field[:, :, i], alone[:, :, 0], rtol=1e-12)
        np.testing.assert_allclose(gradient[:, :, i], alone_gradient[:, :, 0], rtol=1e-12)
    one = FieldModel(beacons).field(points[2, 3])
    np.testing.assert_allclose(one, field[2, 3], rtol=1e-12)


def test_a_wire_far_away_is_its_dipole_and_the_choice_is_seamless():
    wire = np.concatenate([spiral(turns=1, pitch=0.0)])  # closed square
    beacon = wire_beacon(wire)
    model, as_dipole = FieldModel([beacon]), FieldModel([beacon], kind="dipole")
    reach = 0.035 * np.sqrt(2.0)
    direction = np.array([0.5, 0.3, 0.8]) / np.linalg.norm([0.5, 0.3, 0.8])
    near, far = (99.0 * reach * direction, 101.0 * reach * direction)
    np.testing.assert_array_equal(model.field(far), as_dipole.field(far))
    assert 0 < relative(as_dipole.field(near), model.field(near)) < 2e-4
    both = model.field(np.stack([near, far]))
    np.testing.assert_array_equal(both[1], model.field(far))
    np.testing.assert_array_equal(both[0], model.field(near))

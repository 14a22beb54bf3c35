"""Fields of dual-axis beacons: against magpylib, against the ellipse drawn point by point, and the paper's branches."""

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil_sim.papers.zheng.methods.field_ellipse import (
    direction_from_normal,
    dual_axis_dipole,
    normal_vector,
    range_and_polar_angle,
    rms_strength,
    semi_axes,
)

MOMENT = 73.0
K = 1e-7 * MOMENT


def random_units(seed, count=500):
    unit = np.random.default_rng(seed).normal(size=(count, 3))
    return unit / np.linalg.norm(unit, axis=1, keepdims=True)


def truth(offset):
    """Bc and Bs of magpylib's dipoles."""
    coils = [magpylib.misc.Dipole(moment=moment) for moment in ((MOMENT, 0, 0), (0, MOMENT, 0))]
    return np.stack([coil.getB(offset) for coil in coils], axis=1)


def test_field_is_that_of_two_crossed_dipoles():
    offset = 4.0 * random_units(1)
    np.testing.assert_allclose(dual_axis_dipole(offset, K), truth(offset), rtol=1e-7, atol=1e-16)


def test_normal_is_as_the_paper_says():
    u = random_units(2)
    expected = (K / 8.0) ** 2 * np.stack([3 * u[:, 0] * u[:, 2], 3 * u[:, 1] * u[:, 2], 3 * u[:, 2] ** 2 - 2], axis=1)
    np.testing.assert_allclose(normal_vector(truth(2.0 * u)), expected, rtol=0, atol=1e-6 * (K / 8.0) ** 2)


def test_direction_is_exact_above_the_plane_and_the_antipode_below():
    u = random_units(3)
    found = direction_from_normal(normal_vector(truth(3.0 * u)))
    np.testing.assert_allclose(found, u * np.sign(u[:, 2:]), atol=1e-6)


@pytest.mark.parametrize("polar_deg", [5.0, 30.0, 35.2644, 36.0, 60.0, 85.0])
def test_one_formula_holds_for_the_three_branches_of_equation_7(polar_deg):
    phi = np.radians(polar_deg)
    normal = np.array([3 * np.sin(phi) * np.cos(phi), 0.0, 3 * np.cos(phi) ** 2 - 2])
    np.testing.assert_allclose(direction_from_normal(normal), [np.sin(phi), 0.0, np.cos(phi)], atol=1e-9)


def test_semi_axes_bound_the_field_over_a_turn_in_any_attitude():
    rng = np.random.default_rng(4)
    field = truth(rng.uniform(1, 5, (50, 1)) * random_units(5, 50))
    turned = np.einsum("eij,ekj->eki", Rotation.random(50, rng=rng).as_matrix(), field)
    angle = np.linspace(0, np.pi, 20001)
    wave = np.stack([np.cos(angle), np.sin(angle)])
    size = np.linalg.norm(np.einsum("ekj,kt->etj", turned, wave), axis=2)
    major, minor = semi_axes(turned)
    np.testing.assert_allclose(major, size.max(axis=1), rtol=1e-7)
    np.testing.assert_allclose(minor, size.min(axis=1), rtol=1e-6)
    np.testing.assert_allclose(rms_strength(turned), np.sqrt(np.mean(size[:, :-1] ** 2, axis=1)), rtol=1e-9)


def test_range_and_elevation_need_no_attitude():
    rng = np.random.default_rng(6)
    u, distance = random_units(7), rng.uniform(0.5, 15, 500)
    turned = np.einsum("eij,ekj->eki", Rotation.random(500, rng=rng).as_matrix(), truth(distance[:, None] * u))
    range_m, polar = range_and_polar_angle(turned, K)
    np.testing.assert_allclose(range_m, distance, rtol=1e-7)
    np.testing.assert_allclose(polar, np.arccos(np.abs(u[:, 2])), atol=1e-4)


def test_axes_that_noise_makes_impossible_give_the_nearest_angle():
    longer_than_twice = np.array([[3.0, 0, 0], [0, 1.0, 0]]) * 1e-9
    round_one = np.array([[1.0, 0, 0], [0, 1.0, 0]]) * 1e-9
    assert range_and_polar_angle(longer_than_twice, K)[1] == pytest.approx(np.pi / 2)
    assert range_and_polar_angle(round_one, K)[1] == pytest.approx(0.0, abs=1e-7)

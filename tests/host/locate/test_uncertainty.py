"""The inverse of information that may be of any scale, incomplete or no number, against NumPy's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.fit import Measurements
from goldfield.locate.site_errors import errors_of
from goldfield.locate.uncertainty import (
    FREE_POSITION_M2,
    FREE_TURN_RAD2,
    UNOBSERVABLE,
    cramer_rao_bound,
    dilution_of_precision,
    gauss_newton_covariance,
    root_covariance,
    second_order_covariance,
)
from goldfield.site import Survey
from tests.bench import locate_trials as bench
from tests.host.locate import built_sites as built

FREE = np.diag(np.repeat([FREE_POSITION_M2, FREE_TURN_RAD2], 3))


def whole(seed, count=3):
    slope = np.random.default_rng(seed).normal(size=(count, 6, 12))
    return slope @ slope.swapaxes(1, 2)


@pytest.mark.parametrize("scale", [np.ones(6), np.geomspace(1e-9, 1e9, 6), np.geomspace(1e9, 1e-9, 6)])
def test_information_of_any_units_has_its_inverse(scale):
    information = whole(1)
    told = information * np.outer(scale, scale)
    root, free = root_covariance(told)
    expected = np.linalg.inv(information)
    np.testing.assert_allclose(root @ root.swapaxes(1, 2) * np.outer(scale, scale), expected, rtol=1e-9)
    np.testing.assert_array_equal(free, np.zeros((3, 6, 6)))
    np.testing.assert_allclose(gauss_newton_covariance(told) * np.outer(scale, scale), expected, rtol=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_no_number_tells_nothing_of_its_epoch_alone(bad):
    information = whole(2)
    information[1, 2, 3] = bad
    found = gauss_newton_covariance(information)
    np.testing.assert_allclose(found[1], FREE)
    for e in (0, 2):
        np.testing.assert_allclose(found[e], np.linalg.inv(information[e]), rtol=1e-9)


@pytest.mark.parametrize(("share", "seen"), [(0.95, False), (1.05, True)])
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_a_direction_is_told_above_rounding_of_a_unit_diagonal(share, seen, scale):
    """Two unknowns whose difference hardly shows: the eigenvalue is what their correlation lacks of 1."""
    information = scale * np.eye(6)[None]
    information[0, 0, 1] = information[0, 1, 0] = scale * (1.0 - share * UNOBSERVABLE)
    root, free = root_covariance(information)
    assert (np.linalg.matrix_rank(root[0] * np.sqrt(scale), tol=1e-3) == 6) == seen
    across = np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0]) / np.sqrt(2.0)
    expected = np.zeros((6, 6)) if seen else FREE_POSITION_M2 * np.outer(across, across)
    np.testing.assert_allclose(free[0], expected, atol=1e-6 * FREE_POSITION_M2)


@pytest.mark.parametrize("scale", [np.ones(6), np.array([1.0, 1.0, 1.0, 30.0, 30.0, 30.0])])
def test_directions_that_nothing_tells_are_free(scale):
    """One of a shift alone, one of a turn alone, and a third of both; the rest has its pseudoinverse."""
    free_ways = np.zeros((3, 6))
    free_ways[0, :3] = [0.6, 0.0, 0.8]
    free_ways[1, 3:] = [0.0, 1.0, 0.0]
    free_ways[2] = [0.0, 0.5, 0.0, 0.5, 0.0, 0.5]
    for ways in (free_ways[:1], free_ways[1:2], free_ways[2:], free_ways[:2]):
        slope = np.random.default_rng(3).normal(size=(6, 12))
        slope -= ways.T @ np.linalg.pinv(ways.T) @ slope
        slope *= scale[:, None]
        way = ways / scale
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        root, free = root_covariance((slope @ slope.T)[None])
        np.testing.assert_allclose(slope.T @ root[0] @ root[0].T @ slope, np.linalg.pinv(slope) @ slope, atol=1e-9)
        size = np.sqrt(np.diag(FREE))
        if len(ways) == 1:
            np.testing.assert_allclose(free[0], np.outer(way[0] * size, way[0] * size), rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(np.trace(free[0]), ((way * size) ** 2).sum(), rtol=1e-6)
        both = gauss_newton_covariance((slope @ slope.T)[None])
        np.testing.assert_allclose(both, root @ root.swapaxes(1, 2) + free)


@pytest.mark.parametrize("quick", [False, True])
def test_a_ridge_that_bends_widens_the_covariance(monkeypatch, quick):
    """Against draws: the error of a pose with its second order, by differences of the fields, one coil very near.

    There the range is known to micrometres and the direction to centimetres. The covariance of 40,000 draws is within
    5 % of it along its axes.
    """
    if not quick:
        monkeypatch.setattr(kernel, "_library", lambda: None)
    rng, site = np.random.default_rng(6), built.mixed_cube(2e-7)
    model = FieldModel(site.beacons)
    position = model.centre_m[:1] + np.array([0.25, 0.2, 0.15])
    run = bench.trials(site, position, rng)
    sigma = np.full((1, 8), 2.5e-9)
    sigma[0, 0] = 1e-9
    found = second_order_covariance(model, Measurements(run.field_T, sigma), position, run.rotation)[0]

    def read(step):
        turn = Rotation.from_rotvec(step[3:]).as_matrix() @ run.rotation[0]
        return ((model.field(position[0] + step[:3]) @ turn) / sigma[0, :, None]).ravel()

    slope = np.stack([(read(s) - read(-s)) / 2e-6 for s in np.eye(6) * 1e-6], axis=1)
    root = np.linalg.svd(slope, full_matrices=False)
    axes = root[2].T / root[1]
    bend = np.empty((6, 6, len(slope)))
    for i in range(6):
        for j in range(6):
            ends = [read(a * axes[:, i] + b * axes[:, j]) * a * b for a in (1.0, -1.0) for b in (1.0, -1.0)]
            bend[i, j] = 0.25 * sum(ends)
    draws = rng.normal(size=(40_000, 6))
    second = np.einsum("di,dj,ijm->dm", draws, draws, bend) @ root[0]
    errors = (draws - 0.5 * second) @ axes.T
    sampled = errors.T @ errors / len(errors)
    inner = np.linalg.inv(axes)
    assert np.linalg.eigvalsh(inner @ sampled @ inner.T)[-1] > 2.0  # along the range it is far from what is linear
    inner = np.linalg.inv(np.linalg.cholesky(found))
    np.testing.assert_allclose(np.linalg.eigvalsh(inner @ sampled @ inner.T), 1.0, atol=0.05)


CASES = {"noise": {}, "errors": {"gain": 0.01, "lean": 0.02}, "one axis": {"axes": (2,)}, "two axes": {"axes": (0, 2)}}


@pytest.mark.parametrize("name", CASES)
def test_the_kernel_and_numpy_have_one_covariance(monkeypatch, name):
    rng, case = np.random.default_rng(7), CASES[name]
    site = built.mixed_cube(2e-7)
    if "gain" in case:
        site = built.declared(site, built.DECLARED, case["gain"], case["lean"])
    model = FieldModel(site.beacons)
    run = bench.trials(site, built.inside(site, rng, 4), rng, axes=case.get("axes", (0, 1, 2)))
    measurements = Measurements(run.field_T, 20.0 * run.sigma_T)
    measurements = measurements.with_errors(model, errors_of(site.beacons, site.sensor))
    quick = second_order_covariance(model, measurements, run.position_m, run.rotation)
    monkeypatch.setattr(kernel, "_library", lambda: None)
    slow = second_order_covariance(model, measurements, run.position_m, run.rotation)
    size = np.sqrt(np.einsum("ekk->ek", slow))
    both = size[:, :, None] * size[:, None, :]
    np.testing.assert_allclose(quick / both, slow / both, atol=1e-5)


@pytest.mark.parametrize("quick", [False, True])
def test_on_a_wire_nothing_is_told_of_the_pose(monkeypatch, quick):
    if not quick:
        monkeypatch.setattr(kernel, "_library", lambda: None)
    site, rng = bench.prigge_cube(), np.random.default_rng(8)
    run = bench.trials(site, bench.cube_positions(rng, 2), rng)
    position = run.position_m.copy()
    position[0] = [site.beacons[0].radius_m, 0.0, 0.0]
    with np.errstate(all="ignore"):
        found = second_order_covariance(
            FieldModel(site.beacons), Measurements(run.field_T, run.sigma_T), position, run.rotation
        )
    np.testing.assert_allclose(found[0], FREE)
    assert np.trace(found[1]) < 1e-2


def test_axes_that_lean_alike_add_to_the_turn_alone():
    """Half the variance of one axis that leans; nothing but the attitude has it."""
    site = built.mixed_cube(2e-7)
    leaning, position = built.declared(site, Survey(1e-6, 1e-6, 1e-6), 0.0, 0.02), np.array([[0.9, 1.1, 0.8]])
    run = bench.trials(site, position, np.random.default_rng(9))
    model = FieldModel(site.beacons)
    told = errors_of(leaning.beacons, leaning.sensor)
    measurements = Measurements(run.field_T, run.sigma_T).with_errors(model, told)
    whole = second_order_covariance(model, measurements, position, run.rotation)
    bound = cramer_rao_bound(leaning, position, run.rotation)
    size = np.sqrt(np.einsum("ekk->ek", bound))
    np.testing.assert_allclose(whole / size[:, :, None] / size[:, None, :], bound / size[:, :, None] / size[:, None, :],
                               atol=0.02)  # fmt: skip
    least = np.linalg.eigvalsh(bound[0, 3:, 3:])[0]
    assert 0.5 * 0.02**2 < least < 0.7 * 0.02**2
    noise = cramer_rao_bound(leaning, position, run.rotation, noise_only=True)
    np.testing.assert_allclose(noise, cramer_rao_bound(site, position, run.rotation))


def test_the_bound_of_a_component_that_is_not_measured_and_of_one_noise():
    site, position = built.mixed_cube(2e-7), np.array([[0.9, 1.1, 0.8], [0.4, 0.6, 1.2]])
    one = cramer_rao_bound(site, position, sigma_T=np.array(3e-9))
    np.testing.assert_allclose(
        dilution_of_precision(site, position), np.sqrt(np.einsum("ekk->e", one[:, :3, :3])) / 3e-9
    )
    declared = built.declared(site, built.DECLARED, 0.01, 0.02)
    np.testing.assert_array_equal(dilution_of_precision(declared, position), dilution_of_precision(site, position))
    sigma = np.full((2, 8, 3), 3e-9)
    sigma[:, 4:] = np.inf
    fewer = cramer_rao_bound(site, position, sigma_T=sigma)
    half = replace(site, beacons=site.beacons[:4])
    np.testing.assert_allclose(fewer, cramer_rao_bound(half, position, sigma_T=np.array(3e-9)), rtol=1e-9)


def test_axes_of_twice_the_gain_have_half_the_noise():
    site, position = built.mixed_cube(2e-7), np.array([[0.9, 1.1, 0.8]])
    louder = replace(site, sensor=replace(site.sensor, axes=2.0 * np.eye(3)))
    np.testing.assert_allclose(cramer_rao_bound(louder, position), 0.25 * cramer_rao_bound(site, position), rtol=1e-9)

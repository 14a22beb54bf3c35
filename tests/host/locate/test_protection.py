"""Protection level: solution separation against fits without the beacon, and its risk with the worst faults."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from scipy.stats import norm

from goldfield.field import FieldModel
from goldfield.locate.fault_statistics import FaultStatistics, fault_statistics
from goldfield.locate.fit import Measurements, fit_pose
from goldfield.locate.protection import MISSED_DETECTION, SOUND_RISK, level_of, protection_level, radius_m
from goldfield.locate.uncertainty import gauss_newton_covariance
from tests.bench import locate_trials as bench


def test_the_separation_is_that_from_a_fit_without_the_beacon():
    site, rng = bench.prigge_cube(2e-9), np.random.default_rng(71)
    run = bench.trials(site, bench.cube_positions(rng, 40, 0.8), rng)
    model = FieldModel(site.beacons)
    measurements = Measurements(run.field_T, run.sigma_T)
    whole = fit_pose(model, measurements, run.position_m, run.rotation)
    told = fault_statistics(model, measurements, whole)
    kept = np.arange(1, 8)
    part = fit_pose(
        FieldModel(site.beacons[1:]),
        Measurements(run.field_T[:, kept], run.sigma_T[:, kept]),
        run.position_m,
        run.rotation,
    )
    size = np.sqrt(np.einsum("ekk->e", told.separation_cov_m2[:, 0]))[:, None]
    np.testing.assert_allclose(told.separation_m[:, 0] / size, (whole.position_m - part.position_m) / size, atol=0.03)
    more = gauss_newton_covariance(part.information) - gauss_newton_covariance(whole.information)
    square = size[..., None] ** 2
    np.testing.assert_allclose(told.separation_cov_m2[:, 0] / square, more[:, :3, :3] / square, atol=0.03)


SHAPES = [(1.0, 1e-6, 1e-6), (1.0, 1.0, 1.0), (1.0, 0.3, 0.01), (1.0, 0.9, 1e-4)]


@pytest.mark.parametrize("variances", SHAPES)
@pytest.mark.parametrize("mean", [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (1.0, 1.0, 0.5), (6.0, 0.0, 0.0)])
def test_the_radius_is_exceeded_as_rarely_as_said(variances, mean):
    rng = np.random.default_rng(72)
    vector = np.array(mean) + rng.normal(size=(400_000, 3)) * np.sqrt(variances)
    radius = radius_m(np.array(mean), np.diag(variances), np.array(1e-3))
    assert 6e-4 < (np.linalg.norm(vector, axis=1) > radius).mean() < 1.15e-3
    assert radius_m(2.0 * np.array(mean), 4.0 * np.diag(variances), np.array(1e-3)) == pytest.approx(2.0 * radius)


def imhof_radius(mean, covariance, risk):
    """The quantile of a scaled and shifted chi-square with the cumulants of the squared length, by its main axes."""
    variance, axes = np.linalg.eigh(covariance)
    along = (axes.T @ mean) ** 2
    first, second, third = (
        2 ** (r - 1) * factorial(r - 1) * (variance ** (r - 1) * (variance + r * along)).sum() for r in (1, 2, 3)
    )
    freedom = 8.0 * second**3 / third**2
    quantile = freedom * (1.0 - 2.0 / (9.0 * freedom) + norm.isf(risk) * np.sqrt(2.0 / (9.0 * freedom))) ** 3
    return np.sqrt(first + np.sqrt(second / (2.0 * freedom)) * (quantile - freedom))


def turned_covariance(rng):
    """A covariance whose axes are no coordinates."""
    root = rng.normal(size=(3, 3)) * rng.uniform(0.1, 1.0, 3)
    return root @ root.T


@pytest.mark.parametrize("risk", [1e-7, 1e-3, 0.2])
def test_the_radius_is_that_of_three_cumulants(risk):
    rng = np.random.default_rng(73)
    for _ in range(20):
        mean, covariance = rng.normal(size=3), turned_covariance(rng)
        assert radius_m(mean, covariance, np.array(risk)) == pytest.approx(imhof_radius(mean, covariance, risk), 1e-9)


@pytest.mark.parametrize("freedom", [(3, 2, 3), (3, 2, 2), (3, 1, 3)])
def test_the_level_is_the_greatest_radius_of_any_beacon_and_of_noise(freedom):
    """The second beacon was measured on two axes; what all a beacon measured can show hides nothing."""
    rng = np.random.default_rng(74)
    measured = np.ones((2, 3, 3))
    measured[:, 1, 2] = np.nan
    hidden = np.array(freedom) < (3, 2, 3)
    for scale in (0.0, 0.1, 1.0):
        separation, sound = scale * rng.normal(size=(2, 3, 3)), np.array([turned_covariance(rng) for _ in range(2)])
        spread = scale * np.array([[turned_covariance(rng) for _ in range(3)] for _ in range(2)])
        statistics = FaultStatistics(
            np.zeros((2, 3)), np.tile(freedom, (2, 1)), np.zeros((2, 3)), separation, spread, np.zeros((2, 4)), None
        )
        level, beacon = protection_level(Measurements(measured, np.ones((2, 3))), statistics, sound)
        for e in range(2):
            of_fault = [imhof_radius(separation[e, i], sound[e] + spread[e, i], 1e-3) for i in range(3)]
            of_fault = np.where(hidden, np.inf, of_fault)
            assert level[e] == pytest.approx(max(*of_fault, imhof_radius(np.zeros(3), sound[e], 1e-7)), 1e-9)
            assert beacon[e] == of_fault.argmax()


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_no_fault_of_any_size_is_beyond_the_level_more_often_than_said(seed):
    """In the linear model: the error has the noise of the pose, and a fault moves it as it moves the separation."""
    rng = np.random.default_rng(seed)
    count = 100_000
    noise = rng.normal(size=(3, 3)) * rng.uniform(0.1, 1.0, 3)
    move = rng.normal(size=(3, 3)) * rng.uniform(0.1, 3.0, 3)
    covariance = np.broadcast_to(noise @ noise.T, (count, 3, 3))
    spread = np.broadcast_to(move @ move.T, (count, 1, 3, 3))
    shown = np.zeros((count, 1), dtype=bool)
    worst = np.linalg.svd(move)[2][0]
    risks = []
    for size in (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0):
        separation = (size * worst + rng.normal(size=(count, 3))) @ move.T
        error = rng.normal(size=(count, 3)) @ noise.T + size * move @ worst
        level, _ = level_of(separation[:, None], spread, shown, covariance)
        risks.append((np.linalg.norm(error, axis=1) > level).mean())
    assert max(risks) < MISSED_DETECTION + 4.0 * np.sqrt(MISSED_DETECTION / count)
    assert max(risks) > 0.5 * MISSED_DETECTION  # a level that promises more than it says is too large


def test_noise_alone_counts_where_no_fault_can_do_much():
    covariance = np.diag([4e-4, 1e-4, 1e-4])[None]
    level, _ = level_of(np.zeros((1, 2, 3)), np.zeros((1, 2, 3, 3)), np.zeros((1, 2), dtype=bool), covariance)
    assert level[0] == radius_m(np.zeros(3), covariance[0], np.array(SOUND_RISK))
    assert level[0] > 5.3 * 0.02


def test_a_fault_that_cannot_show_has_no_level():
    hidden = np.array([[False, True]])
    level, beacon = level_of(np.zeros((1, 2, 3)), np.zeros((1, 2, 3, 3)), hidden, np.eye(3)[None])
    assert (level[0], beacon[0]) == (np.inf, 1)

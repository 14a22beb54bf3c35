"""Each start on its own: what the sources promise of it, in seeded trials on fields of magpylib."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from goldfield.field import FieldModel
from goldfield.locate.starts import log_magnitudes, simple_magnitudes, simple_ranges
from tests.bench import locate_trials as bench


@pytest.fixture(scope="module")
def cube():
    site = bench.prigge_cube()
    rng = np.random.default_rng(21)
    return site, FieldModel(site.beacons), bench.trials(site, bench.cube_positions(rng, 300), rng)


def magnitudes(run):
    return np.linalg.norm(run.field_T, axis=2), run.sigma_T, np.ones(run.sigma_T.shape, dtype=bool)


def rms(position, run):
    return np.sqrt(np.mean(np.sum((position - run.position_m) ** 2, axis=1)))


def test_simple_ranges_are_within_their_stated_error(cube):
    site, model, run = cube
    strong = bench.magpylib_fields(site, run.position_m)
    distance = np.linalg.norm(run.position_m[:, None] - model.centre_m, axis=2)
    ratio = simple_ranges(model, np.linalg.norm(strong, axis=2)) / distance
    far = distance > 1.0  # where the coil is a dipole
    assert ratio[far].min() > (1.5 / 2.0) ** (1 / 3) - 0.01
    assert ratio[far].max() < 1.5 ** (1 / 3) + 0.01


def test_each_step_of_the_sources_improves_on_the_one_before(cube):
    _, model, run = cube
    simple = simple_magnitudes(model, *magnitudes(run), weighted=False)
    full = bench.full_magnitudes(model, *magnitudes(run), simple)
    logarithmic = log_magnitudes(model, *magnitudes(run), simple_magnitudes(model, *magnitudes(run)))
    error = np.linalg.norm(full - run.position_m, axis=1)
    # decimetres (the patent says typically 20 cm), then centimetres wherever the iteration found the right valley
    assert np.median(np.linalg.norm(simple - run.position_m, axis=1)) < 0.3
    assert np.median(error) < 0.02
    assert np.median(np.linalg.norm(logarithmic - run.position_m, axis=1)) < 0.05
    assert np.linalg.norm(logarithmic - run.position_m, axis=1).max() < 0.6


def scattered(seed=22, count=7):
    """Coils that are in no plane, and places among them."""
    rng = np.random.default_rng(seed)
    coils = [bench.loop_beacon(i, rng.uniform(0, 3, 3), rng.normal(size=3), radius=0.05) for i in range(count)]
    return FieldModel(bench.site_of(coils).beacons), rng.uniform(0.7, 2.3, size=(6, 3))


@pytest.mark.parametrize("weighted", [True, False])
def test_ranges_that_agree_lead_to_their_place(weighted):
    """Magnitudes of 1.5 k/r^3, from which ranges are told, of some of the beacons, and with any noise."""
    model, place = scattered()
    moment = np.linalg.norm(model.moment_A_m2, axis=1)
    distance = np.linalg.norm(place[:, None] - model.centre_m, axis=2)
    magnitude = 1.5e-7 * moment / distance**3
    known = np.ones(magnitude.shape, dtype=bool)
    known[::2, 1] = False
    spoiled = np.where(known, magnitude, 1e-3)
    np.testing.assert_allclose(simple_ranges(model, magnitude), distance, rtol=1e-9)
    sigma = 0.3 * magnitude * np.arange(1.0, 8.0)
    found = simple_magnitudes(model, spoiled, sigma, known, weighted=weighted)
    apart = np.linalg.norm(found - place, axis=1)
    assert (apart < 2e-3).sum() >= 5  # one of six has another minimum
    near = simple_magnitudes(model, spoiled, sigma, known, weighted=weighted, start_m=place + 0.05)
    np.testing.assert_allclose(near, place, atol=2e-3)


@pytest.mark.parametrize("weighted", [True, False])
def test_a_range_counts_by_its_relative_error_or_as_all_do(weighted):
    """A beacon whose magnitude is as good as noise is hardly believed, unless all count alike.

    The patent's sum of squares is minimised by SciPy; ours has an error of .12 of each range and that of the noise.
    """
    model, place = scattered()
    field = np.linalg.norm(model.field(place), axis=2)
    known = np.ones(field.shape, dtype=bool)
    sigma = np.full(field.shape, 2e-8)
    sigma[:, 2] = 3.0 * field[:, 2]
    distance = np.cbrt(1.5e-7 * np.linalg.norm(model.moment_A_m2, axis=1) / field)
    error = distance * np.hypot(0.12, sigma / field / 3.0) if weighted else np.ones(field.shape)
    found = simple_magnitudes(model, field, sigma, known, weighted=weighted, start_m=place)
    for e in range(len(place)):

        def misfit(x, e=e):
            return (distance[e] - np.linalg.norm(x - model.centre_m, axis=1)) / error[e]

        theirs = least_squares(misfit, place[e], xtol=1e-12)
        assert (misfit(found[e]) ** 2).sum() <= 2 * theirs.cost + 1e-2  # as the fit promises
        np.testing.assert_allclose(found[e], theirs.x, atol=0.015 if weighted else 5e-3)


def test_logarithms_of_true_magnitudes_lead_to_the_true_place():
    """Those of some of the beacons suffice, with any noise."""
    model, place = scattered()
    magnitude = np.linalg.norm(model.field(place), axis=2)
    known = np.ones(magnitude.shape, dtype=bool)
    known[::2, 1] = False
    spoiled = np.where(known, magnitude, 1e-3)
    sigma = 0.3 * magnitude * np.arange(1.0, 8.0)
    found = log_magnitudes(model, spoiled, sigma, known, place + 0.1)
    np.testing.assert_allclose(found, place, atol=2e-3)


def test_logarithms_count_by_the_noise_and_a_tenth():
    model, place = scattered()
    magnitude = np.linalg.norm(model.field(place), axis=2) * np.exp(0.2 * np.cos(np.arange(42)).reshape(6, 7))
    sigma = 0.1 * magnitude * np.arange(1.0, 8.0)
    found = log_magnitudes(model, magnitude, sigma, np.ones((6, 7), dtype=bool), place)
    error = np.hypot(0.1, sigma / magnitude)
    for e in range(len(place)):

        def misfit(x, e=e):
            return (np.log(magnitude[e]) - np.log(np.linalg.norm(model.field(x), axis=-1))) / error[e]

        theirs = least_squares(misfit, found[e], xtol=1e-12)
        np.testing.assert_allclose(found[e], theirs.x, atol=5e-3)


def test_coplanar_beacons_are_not_left_in_their_plane():
    """There the sum of squares has no slope across it."""
    corners = [(0.0, 0.0, 1.0), (2.0, 0.0, 1.0), (0.0, 2.0, 1.0), (2.0, 2.0, 1.0)]
    model = FieldModel([bench.loop_beacon(i, corner) for i, corner in enumerate(corners)])
    place = np.array([[0.8, 1.1, 1.7], [0.8, 1.1, 0.3]])
    distance = np.linalg.norm(place[:, None] - model.centre_m, axis=2)
    magnitude = 1.5e-7 * np.linalg.norm(model.moment_A_m2, axis=1) / distance**3
    found = simple_magnitudes(model, magnitude, np.full((2, 4), 1e-9), np.ones((2, 4), dtype=bool))
    np.testing.assert_allclose(found[:, :2], place[:, :2], atol=5e-3)
    np.testing.assert_allclose(np.abs(found[:, 2] - 1.0), 0.7, atol=5e-3)


def test_missing_beacons_do_not_matter_to_the_magnitudes(cube):
    _, model, run = cube
    magnitude, sigma, known = magnitudes(run)
    known[:, 3] = False
    spoiled = magnitude.copy()
    spoiled[:, 3] = 1.0
    without = simple_magnitudes(model, spoiled, sigma, known)
    other = spoiled.copy()
    other[:, 3] = 1e-3
    np.testing.assert_allclose(simple_magnitudes(model, other, sigma, known), without, atol=1e-9)

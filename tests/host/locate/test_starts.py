"""Each start on its own: what the sources promise of it, in seeded trials on fields of magpylib."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.field import FieldModel
from goldfield.locate.field_shell_search import (
    Shell,
    best_apart,
    directions,
    profiled_attitude,
    profiled_loss,
    unit_vector_fit,
)
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


def test_directions_are_evenly_spread():
    unit = directions(300)
    np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1.0, rtol=1e-12)
    gap = np.arccos(np.clip(unit @ unit.T - 2 * np.eye(300), -1, 1)).min(axis=1)
    assert gap.min() > 0.5 * np.sqrt(4 * np.pi / 300)
    assert gap.max() < 1.5 * np.sqrt(4 * np.pi / 300)


def test_shell_holds_a_candidate_near_the_truth(cube):
    _, model, run = cube
    shell = Shell(model)
    worst = 0.0
    for e in range(60):
        position, modelled = shell.candidates(run.field_T[e])
        loss = profiled_loss(modelled, run.field_T[e], run.sigma_T[e])
        best = best_apart(position, loss, 8, np.full(len(position), 0.1))
        distance = np.linalg.norm(position[best] - run.position_m[e], axis=1)
        nearest = np.linalg.norm(run.position_m[e] - model.centre_m, axis=1).min()
        worst = max(worst, distance.min() / nearest)
        attitude = profiled_attitude(modelled[best[distance.argmin()]][None], run.field_T[e], run.sigma_T[e])[0]
        assert np.abs(attitude - run.rotation[e]).max() < 0.8
    assert worst < 0.5


def test_unit_vector_fit_is_the_constrained_minimum():
    rng = np.random.default_rng(5)
    field, weight = rng.normal(size=(50, 6, 3)), rng.uniform(0.1, 1.0, 6)
    value = rng.normal(size=6)
    direction, misfit = unit_vector_fit(field, value, weight)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, rtol=1e-9)
    sphere = directions(4000)
    everywhere = np.stack([(weight[:, None] * (value[:, None] - b @ sphere.T) ** 2).sum(axis=0) for b in field])
    assert (misfit <= everywhere.min(axis=1) + 1e-9).all()
    assert (misfit >= everywhere.min(axis=1) - 0.05).all()


def test_best_apart_keeps_its_distance():
    position = np.array([[0.0, 0, 0], [0.05, 0, 0], [1.0, 0, 0], [2.0, 0, 0]])
    kept = best_apart(position, np.array([1.0, 1.1, 3.0, 2.0]), 3, np.full(4, 0.1))
    assert kept.tolist() == [0, 3, 2]
    assert best_apart(position, np.full(4, np.inf), 3, np.full(4, 0.1)).tolist() == []

"""The search in the shell of the strongest beacon: its points, loss and attitude at each, and the best apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate import field_shell_search
from goldfield.locate.field_shell_search import (
    DISTANCE_RATIO,
    FULL_WINDOW,
    PARTIAL_WINDOW,
    Shell,
    best_apart,
    directions,
    profiled_attitude,
    profiled_loss,
    unit_vector_fit,
)
from tests.bench import locate_trials as bench


def test_directions_are_evenly_spread():
    unit = directions(300)
    np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(unit[:, 2].sum(), 0.0, atol=1e-9)
    gap = np.arccos(np.clip(unit @ unit.T - 2 * np.eye(300), -1, 1)).min(axis=1)
    assert gap.min() > 0.5 * np.sqrt(4 * np.pi / 300)
    assert gap.max() < 1.5 * np.sqrt(4 * np.pi / 300)


def test_shell_holds_a_candidate_near_the_truth():
    site, rng = bench.prigge_cube(), np.random.default_rng(21)
    model, run = FieldModel(site.beacons), bench.trials(site, bench.cube_positions(rng, 20), rng)
    shell = Shell(model)
    worst = 0.0
    for e in range(20):
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


@pytest.mark.parametrize("scale", [1.0, 1e-7])
def test_what_no_field_tells_of_a_unit_vector_is_what_is_left_of_its_length(scale):
    """Fields in a plane, along a line, and of whatever direction with values of zero, as of an axis that is dead."""
    rng = np.random.default_rng(6)
    field, weight = scale * rng.normal(size=(3, 6, 3)), np.ones(6) / scale**2
    field[0, :, 1] = 0.0
    field[1, :, :2] = 0.0
    for k, truth in ((0, [0.48, 0.6, -0.64]), (1, [0.8, 0.36, 0.48])):
        direction, misfit = unit_vector_fit(field[k][None], field[k] @ truth, weight)
        seen = field[k].any(axis=0)
        np.testing.assert_allclose(direction[0, seen], np.array(truth)[seen], atol=1e-6)
        assert np.linalg.norm(direction) == pytest.approx(1.0)
        assert misfit[0] == pytest.approx(0.0, abs=1e-9)
    direction, misfit = unit_vector_fit(field, np.zeros(6), weight)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0)
    weakest = np.linalg.svd(field / scale, compute_uv=False)[:, -1] ** 2  # along what is seen least
    np.testing.assert_allclose(misfit, weakest, atol=1e-9)


def test_best_apart_keeps_its_distance():
    position = np.array([[0.0, 0, 0], [0.05, 0, 0], [1.0, 0, 0], [2.0, 0, 0]])
    kept = best_apart(position, np.array([1.0, 1.1, 3.0, 2.0]), 3, np.full(4, 0.1))
    assert kept.tolist() == [0, 3, 2]
    assert best_apart(position, np.array([1.0, 1.1, 3.0, 2.0]), 2, np.full(4, 0.1)).tolist() == [0, 3]
    assert best_apart(position, np.full(4, np.inf), 3, np.full(4, 0.1)).tolist() == []
    exactly = best_apart(position, np.array([1.0, 1.1, 3.0, 2.0]), 4, np.array([0.05, 0.1, 0.1, 0.1]))
    assert exactly.tolist() == [0, 3, 2]  # what is just as far is not further
    assert best_apart(position, np.array([1.0, 1.1, np.nan, 2.0]), 4, np.zeros(4)).tolist() == [0, 1, 3]


TWENTIETH_M = 0.05 * 1.25**20


def coils(*places, radius=0.1):
    return FieldModel([bench.loop_beacon(i, place, radius=radius) for i, place in enumerate(places)])


@pytest.mark.parametrize(
    ("places", "furthest_m"),
    [
        # Three times the site, which is just within the twentieth distance, or just beyond it.
        ([(1.0, 0.0, 0.0), (0.0, 0.5, 0.0), (1.0, 0.999 * TWENTIETH_M / 3.0, 0.0)], 0.999 * TWENTIETH_M),
        ([(1.0, 0.0, 0.0), (0.0, 0.5, 0.0), (1.0, 1.001 * TWENTIETH_M / 3.0, 0.0)], 1.001 * TWENTIETH_M),
        ([(1.0, 0.0, 0.0), (1.0, 0.1, 0.0), (1.1, 0.0, 0.0)], 1.0),  # ten radii
    ],
)
def test_points_around_the_strongest_beacon_reach_from_its_wire_to_beyond_the_site(monkeypatch, places, furthest_m):
    monkeypatch.setattr(field_shell_search, "FULL_WINDOW", (0.0, np.inf))
    model = coils(*places)
    field = np.array([[-5e-6, 0.0, 0.0], [1e-6, 1e-6, 1e-6], [0.0, 3e-6, 3e-6]])
    position, modelled = Shell(model).candidates(field)
    np.testing.assert_allclose(modelled, model.field(position), rtol=1e-12)
    away = (position - places[0]).reshape(-1, 300, 3)
    distance = np.linalg.norm(away, axis=2)
    np.testing.assert_allclose(distance, distance[:, :1] * np.ones(300), rtol=1e-9)
    np.testing.assert_allclose(away / distance[..., None], np.broadcast_to(directions(300), away.shape), atol=1e-12)
    assert distance[0, 0] == pytest.approx(0.05)
    np.testing.assert_allclose(distance[1:, 0] / distance[:-1, 0], DISTANCE_RATIO)
    assert distance[-1, 0] >= furthest_m > distance[-2, 0]


def test_candidates_are_about_as_strong_as_measured(monkeypatch):
    """The strongest of all that is measured counts; what a sensor with fewer axes sees may be a small part."""
    model = coils((0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.5))
    field = np.array([[np.nan, np.nan, 1e-7], [1e-7, -6e-6, 2e-7], [3e-7, 0.0, 0.0]])
    for window, axis_missing in ((FULL_WINDOW, False), (PARTIAL_WINDOW, True)):
        measured = field.copy()
        measured[1, 2] = np.nan if axis_missing else measured[1, 2]
        position, modelled = Shell(model).candidates(measured)
        ratio = np.linalg.norm(model.field(position)[:, 1], axis=1) / np.sqrt(np.nansum(measured[1] ** 2))
        assert window[0] < ratio.min() < 1.2 * window[0]
        assert 0.6 * window[1] < ratio.max() < window[1]
        np.testing.assert_allclose(modelled, model.field(position), rtol=1e-12)
    assert len(Shell(model).candidates(np.zeros((3, 3)))[0]) == 0
    # A field of 1 T makes the ratio that of the norms: one on an edge of the window is no candidate.
    whole = Shell(model)
    monkeypatch.setattr(field_shell_search, "FULL_WINDOW", (0.0, np.inf))
    unit = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    strength = np.linalg.norm(whole.candidates(unit)[1][:, 1], axis=1)
    low, high = np.sort(strength)[[100, 5000]]
    monkeypatch.setattr(field_shell_search, "FULL_WINDOW", (low, high))
    within = np.linalg.norm(whole.candidates(unit)[1][:, 1], axis=1)
    assert len(within) == ((strength > low) & (strength < high)).sum()
    assert (low < within).all()
    assert (within < high).all()


def test_fields_around_a_beacon_are_computed_once_for_all_subsets(monkeypatch):
    model = coils((0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.5), (2.0, 2.0, 1.0))
    whole, calls, compute = Shell(model), [], FieldModel.field

    def counted(self, position):
        calls.append(len(position))
        return compute(self, position)

    monkeypatch.setattr(FieldModel, "field", counted)
    field = np.array([[1e-7, 0.0, 0.0], [1e-7, 0.0, 1e-7], [6e-6, 1e-6, 0.0], [0.0, 0.0, 2e-7]])
    position, modelled = whole.candidates(field)
    once = len(calls)
    assert once > 1  # in parts
    rows = np.array([3, 2, 0])
    part = Shell(model.subset(rows), whole, rows)
    for shell, kept in (
        (whole, np.arange(4)),
        (part, rows),
        (Shell(model.subset(rows[1:]), part, np.array([1, 2])), rows[1:]),
    ):
        again, of_kept = shell.candidates(field[kept])
        np.testing.assert_array_equal(again, position)
        np.testing.assert_array_equal(of_kept, modelled[:, kept])
    assert len(calls) == once


@pytest.mark.parametrize(
    ("factor", "sigma_T", "strength_T", "loss"),
    [(1.3, 1e-12, 1e-6, 1.0), (1.6, 1e-12, 1e-6, 4.0), (2.0, 1e-6, 1e-9, 1e-6)],
)
def test_a_field_is_off_by_one_deviation_where_it_is_off_by_three_tenths_or_by_the_noise(
    factor, sigma_T, strength_T, loss
):
    """Three beacons across each other, of which the last is modelled by a factor stronger."""
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    modelled = strength_T * np.array([[[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, factor]]])
    measured, noise = strength_T * np.diag([1.0, -1.0, 1.0]) @ turn, np.full(3, sigma_T)
    assert profiled_loss(modelled, measured, noise)[0] == pytest.approx(loss, rel=1e-3)
    np.testing.assert_allclose(profiled_attitude(modelled, measured, noise)[0], turn, atol=1e-9)


@pytest.mark.parametrize("scale", [1.0, 1e-6])
@pytest.mark.parametrize("axes", [(0, 1, 2), (0, 1), (0, 2), (1, 2), (0,), (2,)])
def test_at_the_true_place_nothing_is_lost_and_the_attitude_is_the_true_one(axes, scale):
    """Some beacons, one not measured and one by two axes only; with one axis, where that points."""
    rng = np.random.default_rng(23)
    turns = Rotation.random(6, rng=rng).as_matrix()
    for turn in turns:
        modelled = scale * rng.normal(size=(4, 7, 3))
        measured = modelled[2] @ turn
        measured[:, [axis for axis in range(3) if axis not in axes]] = np.nan
        measured[5] = np.nan
        for partly in (False, True):
            if partly:
                measured[3, axes[0]] = np.nan
            loss = profiled_loss(modelled, measured, np.full(7, 1e-3 * scale))
            assert loss[2] < 1e-6
            assert np.delete(loss, 2).min() > 0.1
            found = profiled_attitude(modelled, measured, np.full(7, 1e-3 * scale))
            np.testing.assert_allclose(found[2][:, axes], turn[:, axes], atol=1e-4)
            np.testing.assert_allclose(np.linalg.det(found), 1.0)
            np.testing.assert_allclose(found @ found.swapaxes(1, 2), np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-9)


def test_the_loss_of_three_axes_is_scipys_of_the_same_weights():
    rng = np.random.default_rng(24)
    modelled, measured, sigma = (
        1e-6 * rng.normal(size=(5, 6, 3)),
        1e-6 * rng.normal(size=(6, 3)),
        1e-7 * np.arange(1, 7),
    )
    weight = 1.0 / (sigma**2 + 0.09 * (measured**2).sum(axis=1))
    loss = profiled_loss(modelled, measured, sigma)
    for k in range(5):
        attitude, root = Rotation.align_vectors(modelled[k], measured, weights=weight)
        assert loss[k] == pytest.approx(root**2, rel=1e-9)
        found = profiled_attitude(modelled[k : k + 1], measured, sigma)[0]
        np.testing.assert_allclose(found, attitude.as_matrix(), atol=1e-6)


def test_without_any_field_there_is_a_unit_vector_all_the_same():
    direction, misfit = unit_vector_fit(
        np.zeros((1, 4, 3)), np.array([1.0, 2.0, 0.0, -1.0]), np.array([1.0, 0.5, 1.0, 2.0])
    )
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    assert misfit == pytest.approx(1.0 + 0.5 * 4.0 + 2.0)

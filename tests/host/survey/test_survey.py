"""Surveys of simulated rooms: the truth's fields are magpylib's, the site's file is 20 cm and 10 degrees off."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.errors import SystemFailure, UserError
from goldfield.field import FieldModel
from goldfield.locate import Locator
from goldfield.site import load
from goldfield.survey import Free, SurveyData, adjustment, survey
from goldfield.survey.adjustment import evaluate
from goldfield.survey.data import Current, Direction, Distance, Place
from goldfield.survey.equations import derivatives
from goldfield.survey.parameters import ANCHOR, BEACON, SENSOR, beacons_of, default_free, start_of
from goldfield.survey.problem import problem_of
from goldfield.survey.procedure import solve
from tests.bench.integrity_sites import Errors, text_of, told
from tests.bench.survey_trials import ASTRAY, cube, errors_of, fields_of, lattice, measured, score, trial

SIGMA_T = 2e-8 / np.sqrt(1023)


@pytest.fixture(scope="module")
def walked():
    made = trial(cube(), 1, epochs=150, points=6)
    return made, survey(made.site, made.data)


def test_beacons_are_found_from_20_cm_and_10_degrees_off(walked):
    made, result = walked
    found = score(result, made)
    before = np.linalg.norm([b.position_m for b in made.site.beacons] - made.coils.position_m[0], axis=1)
    assert before.max() > 0.15
    assert found.rms_m < 1.6 * found.bound_m < 0.02
    assert 0.4 < found.nees < 1.8  # 48 degrees of freedom, few of which the datum has
    assert result.residual_before > 20.0
    assert result.residual_after == pytest.approx(1.0, abs=0.05)
    assert not result.outliers


def test_parameters_tell_value_deviation_and_what_was_before(walked):
    made, result = walked
    assert len(result.parameters) == 8 * 7
    first = result.parameters["b0.x_m"]
    assert first.value == result.site.beacons[0].position_m[0]
    assert first.before == made.site.beacons[0].position_m[0]
    assert 0.0 < first.sd < 0.02
    error = [result.parameters[f"b3.axis_{k}"].value - made.coils.axis[0, 3, i] for i, k in enumerate("xyz")]
    deviation = [result.parameters[f"b3.axis_{k}"].sd for k in "xyz"]
    assert (np.abs(error) < 4.0 * np.array(deviation)).all()


def test_poses_on_the_surveyed_site_are_near_the_truth(walked):
    made, result = walked
    rng = np.random.default_rng(7)
    position = np.array([1.0, 1.0, 0.9]) + rng.uniform(-0.5, 0.5, size=(20, 3))
    rotation = np.broadcast_to(np.eye(3), (20, 3, 3))
    field = measured(made.coils, position, rotation, np.eye(3), SIGMA_T, rng)
    poses = Locator(result.site).locate_many(fields_of(tuple(b.id for b in result.site.beacons), field, SIGMA_T))
    error = np.linalg.norm(np.array([pose.position_m for pose in poses]) - position, axis=1)
    assert error.max() < 0.01
    assert {pose.status.value for pose in poses} == {"ok"}


def test_the_lattice_of_a_ceiling_is_found():
    made = trial(lattice(), 2, epochs=200, points=10)
    found = score(survey(made.site, made.data), made)
    assert found.rms_m < 1.6 * found.bound_m < 0.06
    assert 0.5 < found.nees < 1.6


def test_corrupted_epochs_are_named_with_their_beacons_and_spoil_nothing():
    made = trial(cube(), 3, epochs=150, points=6, corrupted=0.2)
    result = survey(made.site, made.data)
    out = {outlier.epoch: outlier for outlier in result.outliers}
    wrong = set(np.flatnonzero(made.corrupted).tolist())
    assert len(wrong) > 20
    assert wrong <= set(out)
    assert len(out) <= len(wrong) + 1
    assert sum(bool(outlier.beacons) for outlier in out.values()) > 0.5 * len(out)
    assert score(result, made).rms_m < 1.6 * score(result, made).bound_m < 0.02


def test_the_sensor_is_found_together_with_the_beacons():
    errors = Errors(position_m=0.01, axis_rad=0.0175, current=0.01, gain=0.01, sensor_axis_rad=0.01)
    made = trial(cube(), 4, epochs=200, points=10, errors=errors)
    result = survey(made.site, made.data)
    assert score(result, made).nees < 1.8
    triangle = np.linalg.qr(made.sensor.T @ np.fliplr(np.eye(3)))[1]  # the upper triangle of A = U Q by its rows
    upper = np.flipud(np.fliplr(triangle.T))
    upper = upper * np.sign(np.diag(upper))
    for name, value in (
        ("gain_x", upper[0, 0]),
        ("gain_z", upper[2, 2]),
        ("tilt_xy_rad", upper[0, 1]),
        ("tilt_yz_rad", upper[1, 2]),
    ):
        one = result.parameters[f"sensor.{name}"]
        assert abs(one.value - value) < 4.0 * one.sd + 2e-4
    assert result.site.sensor.axes is not None


def test_anchors_replace_the_walk():
    made = trial(cube(), 5, epochs=10, points=10, anchors=True)
    result = survey(made.site, made.data)
    assert score(result, made).rms_m < 0.008
    assert score(result, made).nees < 1.6


def test_anchors_alone_tell_the_shape():
    made = trial(cube(), 6, epochs=0, points=0, anchors=True)
    result = survey(made.site, made.data)
    place = np.array([beacon.position_m for beacon in result.site.beacons])
    truth = made.coils.position_m[0]

    def distances(points):
        return np.linalg.norm(points[:, None] - points, axis=2)

    off = distances(place) - distances(truth)
    assert np.abs(off).max() < 0.05  # the scale is that of the currents, 3 % each
    assert any("origin" in line and "site file" in line for line in result.advice)


def test_the_deviations_of_anchors_alone_hold_although_the_whole_site_is_turned_by_degrees():
    """The turn of the whole site is known through the file alone, and its square is more than the shape is off."""
    nees = []
    for seed in range(5):
        made = trial(cube(), seed, epochs=0, points=0, anchors=True)
        nees.append(score(survey(made.site, made.data), made).nees)
    assert 0.6 < np.mean(nees) < 1.4


@pytest.mark.parametrize(("off", "least", "most"), [(0.0, 0.0, 2.1e-4), (2e-3, 1e-3, 3e-3)])
def test_how_far_the_model_is_off_at_anchors_is_told_by_how_they_fit(off, least, most):
    made = trial(cube(), 0, epochs=0, points=0, anchors=True)
    rng = np.random.default_rng(1)
    bent = tuple(
        replace(one, fields=replace(one.fields, field_T=one.fields.field_T * (1.0 + off * rng.normal(size=(8, 3)))))
        for one in made.data.anchors
    )
    solution = solve(made.site, replace(made.data, anchors=bent), default_free(made.site))
    assert least < solution.problem.anchor_error < most


@pytest.mark.parametrize(("off_m", "least_m", "most_m"), [(1e-4, 2e-5, 6e-4), (0.012, 0.008, 0.017)])
def test_where_the_sensors_of_anchors_stand_beside_their_coils_is_found(off_m, least_m, most_m):
    """Boards have the sensor beside the coil: each lever is found, in the sensor's frame, and their size is learned."""
    made = trial(cube(), 3, epochs=0, points=0, anchors=True, anchor_lever_m=off_m)
    true = trial(cube(), 3, epochs=0, points=0, anchors=True, anchor_lever_m=off_m, levers_told_m=1e-9).data.anchors
    solution = solve(made.site, made.data, default_free(made.site))
    assert least_m < solution.problem.anchor_sd[0, -1] < most_m
    wrong = solution.state.anchor_lever_m - np.array([one.lever_m for one in true])
    assert np.sqrt(np.mean(wrong**2)) < 0.2 * off_m + 5e-4  # some lie along fields that hardly change
    assert solution.problem.anchor_error < 4e-4


def test_beacons_are_honest_where_the_sensors_of_anchors_stand_beside_their_coils():
    """Told or found, a lever of 12 mm costs nothing, and is no error of the model."""
    for told_m in (None, 3e-4):
        nees = []
        for seed in range(5):
            made = trial(cube(), seed, epochs=10, points=10, anchors=True, anchor_lever_m=0.012, levers_told_m=told_m)
            result = survey(made.site, made.data)
            assert score(result, made).rms_m < 0.008
            nees.append(score(result, made).nees)
        assert 0.6 < np.mean(nees) < 1.4


def test_the_gradient_by_the_unknowns_of_anchors_is_that_of_differences():
    made = trial(cube(), 1, epochs=0, points=0, anchors=True, anchor_lever_m=0.012)
    free = default_free(made.site)
    problem = problem_of(made.site, made.data, free)
    rng = np.random.default_rng(2)
    start = start_of(made.site, 0, 8)
    start = replace(
        start,
        anchor_rotation=Rotation.random(8, rng=rng).as_matrix(),
        anchor_terms=0.01 * rng.normal(size=(8, 6)),
        anchor_lever_m=0.01 * rng.normal(size=(8, 3)),
    )
    now = evaluate(problem, start, 0.05)
    (group,) = [one for one in now.equations.groups if len(one.own) == 8]
    step = 1e-4 / np.sqrt(np.einsum("akk->ak", group.own))
    for anchor, unknown in ((0, 0), (1, 2), (2, 3), (3, 8), (4, 9), (5, 10), (7, 11)):
        move = np.zeros((8, ANCHOR))
        move[anchor, unknown] = step[anchor, unknown]
        none = np.zeros(len(problem.prior.free)), np.zeros((0, 6))
        costs = [evaluate(problem, start.moved(*none, sign * move), 0.05).cost for sign in (1.0, -1.0)]
        slope = (costs[1] - costs[0]) / (2.0 * step[anchor, unknown])
        assert slope == pytest.approx(2.0 * group.gradient[anchor, unknown], rel=2e-3)


def test_a_site_that_denies_its_errors_is_refused_in_words():
    made = trial(cube(), 1, epochs=100, points=6)
    proud = told(cube().site, Errors(position_m=0.001, axis_rad=0.001, current=0.001))
    with pytest.raises(SystemFailure, match=r"no survey fits the fields: .* allow for how wrong"):
        survey(proud, made.data)


def test_a_site_that_is_exact_needs_to_be_told_what_is_free():
    made = trial(cube(), 1, epochs=60, points=6)
    exact = told(cube().site, Errors())
    with pytest.raises(UserError, match="nothing to estimate: say with --free"):
        survey(exact, made.data)
    result = survey(exact, made.data, frozenset((Free.POSITION, Free.AXIS, Free.CURRENT)))
    assert score(result, made).rms_m < 0.03


def test_what_knows_the_scale_is_said_in_words():
    made = trial(cube(), 1, epochs=60, points=0)
    exact = Current("b3", float(made.coils.ampere_turns[0, 3]) / 19.0, 1e-4)
    data = SurveyData(made.data.epochs, known=(exact,))
    (line,) = [line for line in survey(made.site, data).advice if "scale" in line]
    assert "only through the current of b3: give one distance" in line
    far = np.linalg.norm(made.coils.position_m[0, 0] - made.coils.position_m[0, 7])
    data = SurveyData(made.data.epochs, known=(Distance(("b0", "b7"), float(far), 1e-4),))
    (line,) = [line for line in survey(made.site, data).advice if "scale" in line]
    assert line.endswith("through the distance from b0 to b7")


def test_known_values_of_beacons_count():
    made = trial(cube(), 2, epochs=60, points=0)
    truth = made.coils.position_m[0]
    known = (
        Place("b0", truth[0], 1e-4),
        Place("b1", np.array([np.nan, np.nan, truth[1, 2]]), 1e-4),
        Place("b7", truth[7], 1e-4),
        Direction("b0", made.coils.axis[0, 0], 1e-4),
    )
    result = survey(made.site, SurveyData(made.data.epochs, known=known))
    error = errors_of(result, made).reshape(-1, BEACON)
    assert np.abs(error[[0, 7], :3]).max() < 5e-4
    assert np.linalg.norm(error[:, :3], axis=1).max() < 0.02


def test_fields_that_scatter_more_than_they_say_widen_the_deviations():
    made = trial(cube(), 1, epochs=100, points=6)
    bold = tuple(replace(fields, sigma_T=0.5 * fields.sigma_T) for fields in made.data.epochs)
    plain = survey(made.site, made.data)
    result = survey(made.site, replace(made.data, epochs=bold))
    (line,) = [line for line in result.advice if "the fields scatter 2 times" in line]
    assert line.endswith("; if metal is near, find it with --free field added")
    ratio = np.sqrt(np.diag(result.covariance)) / np.sqrt(np.diag(plain.covariance))
    assert ratio == pytest.approx(np.ones(len(ratio)), rel=0.1)


def test_whoever_looked_for_metal_is_not_told_to_look_for_it():
    made = trial(cube(), 1, epochs=100, points=6)
    bold = tuple(replace(fields, sigma_T=0.5 * fields.sigma_T) for fields in made.data.epochs)
    result = survey(made.site, replace(made.data, epochs=bold), default_free(made.site) | {Free.FIELD})
    (line,) = [line for line in result.advice if "the fields scatter 2 times" in line]
    assert line.endswith("all deviations were widened so")


def test_derivatives_are_those_of_differences():
    site = told(cube().site, ASTRAY)
    rng = np.random.default_rng(0)
    state = replace(
        start_of(site, 3, 0),
        sensor_m=np.array([0.5, 0.6, 0.7]) + rng.uniform(size=(3, 3)),
        terms=0.02 * rng.normal(size=6),
        lever_m=0.05 * rng.normal(size=(3, 3)),
        rotation=Rotation.random(3, rng=rng).as_matrix(),
    )
    axes = np.eye(3) + 0.1 * rng.normal(size=(3, 3))
    measured_T = np.zeros((3, 8, 3))

    def parts_of(one):
        return derivatives(
            FieldModel(beacons_of(site, one)), one, axes, measured_T, one.sensor_m, one.rotation, one.matrix()
        )

    here = parts_of(state)
    size, step = BEACON * 8 + SENSOR, 1e-6
    for k in (
        0,
        1,
        2,
        3,
        4,
        5,
        6 * 7 + 2,
        6 * 7 + 4,
        size - 18,
        size - 15,
        size - 14,
        size - 11,
        size - 9,
        size - 4,
        size - 1,
    ):
        common = np.zeros(size)
        common[k] = step
        there = parts_of(state.moved(common, np.zeros((3, 6)), np.zeros((0, ANCHOR))))
        back = parts_of(state.moved(-common, np.zeros((3, 6)), np.zeros((0, ANCHOR))))
        slope = (back.residual - there.residual) / (2.0 * step)
        expected = np.zeros_like(slope)
        if k < BEACON * 8:
            expected[:, k // BEACON] = here.beacon[:, k // BEACON, :, k % BEACON]
        else:
            expected = here.sensor[..., k - BEACON * 8]
        assert slope == pytest.approx(expected, rel=1e-4, abs=1e-5 * np.abs(slope).max())
    for k in range(6):
        poses = np.zeros((3, 6))
        poses[:, k] = step
        there = parts_of(state.moved(np.zeros(size), poses, np.zeros((0, ANCHOR))))
        back = parts_of(state.moved(np.zeros(size), -poses, np.zeros((0, ANCHOR))))
        slope = (back.residual - there.residual) / (2.0 * step)
        assert slope == pytest.approx(here.pose[..., k], rel=1e-4, abs=1e-5 * np.abs(slope).max())


def test_a_reversed_coil_and_left_handed_axes_are_found_and_said():
    made = trial(cube(), 1, epochs=100, points=6)
    site = made.site
    wrong = replace(site.beacons[2], current_A=-site.beacons[2].current_A)
    reversed_site = replace(site, beacons=(*site.beacons[:2], wrong, *site.beacons[3:]))
    result = survey(reversed_site, made.data)
    assert result.advice[0].startswith("b2 is reversed: its current has the other sign")
    assert result.site.beacons[2].current_A * site.beacons[2].current_A > 0.0
    assert result.parameters["b2.current_A"].before == wrong.current_A
    assert score(result, made).rms_m < 0.02
    mirrored = tuple(replace(fields, field_T=fields.field_T * [1.0, 1.0, -1.0]) for fields in made.data.epochs)
    result = survey(site, replace(made.data, epochs=mirrored))
    assert result.advice[0] == "the axes of the sensor are left-handed: axes in the new site file say so"
    assert result.site.sensor.axes == pytest.approx(-np.eye(3))
    assert score(result, made).rms_m < 0.02


def test_a_wrong_point_is_named_and_left_out():
    made = trial(cube(), 1, epochs=100, points=7)
    slip = replace(made.data.points[3], position_m=made.data.points[3].position_m + np.array([0, 0.5, 0]))
    points = (*made.data.points[:3], slip, *made.data.points[4:])
    result = survey(made.site, replace(made.data, points=points))
    (line,) = [line for line in result.advice if "known point of" in line]
    assert line.startswith(f"the known point of epoch {slip.epoch} is 0.499 m from")
    assert score(result, made).rms_m < 0.02
    assert not any("known point of" in line for line in survey(made.site, made.data).advice)


def test_a_wrong_distance_is_told():
    made = trial(cube(), 1, epochs=100, points=7)
    far = np.linalg.norm(made.coils.position_m[0, 0] - made.coils.position_m[0, 7])
    right, wrong = (Distance(("b0", "b7"), float(far) + off, 0.02) for off in (0.0, 0.3))
    advice = survey(made.site, replace(made.data, known=(wrong,))).advice
    assert any("the distance from b0 to b7 does not fit" in line for line in advice)
    advice = survey(made.site, replace(made.data, known=(right,))).advice
    assert not any("does not fit" in line for line in advice)


def test_a_site_file_that_says_nothing_of_its_errors_may_be_far_off(tmp_path):
    made = trial(cube(), 1, epochs=100, points=7)
    silent = tmp_path / "site.toml"
    silent.write_text(text_of(cube().site, None))
    result = survey(load(silent), made.data)
    assert score(result, made).rms_m < 0.02


def whole_of(evaluation):
    """Return all numbers of an evaluation."""
    equations = evaluation.equations
    groups = [part for group in equations.groups for part in (group.own, group.cross, group.gradient)]
    own = (evaluation.cost, evaluation.squares, evaluation.anchor_squares, evaluation.by_beacon)
    return [*own, equations.common, equations.gradient, *groups]


@pytest.mark.parametrize("at_once", [1, 49, 50, 51])
def test_a_walk_is_evaluated_in_pieces_of_any_size(monkeypatch, at_once):
    made = trial(cube(), 2, epochs=50, points=6)
    problem = problem_of(made.site, made.data, default_free(made.site), None)
    state = start_of(made.site, 50, 0, None)
    for robust in (False, True):
        whole = whole_of(evaluate(problem, state, 0.02, robust=robust))
        monkeypatch.setattr(adjustment, "AT_ONCE", at_once)
        for one, other in zip(whole, whole_of(evaluate(problem, state, 0.02, robust=robust)), strict=True):
            np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-12 * np.abs(one).max(initial=0.0))
        monkeypatch.undo()


def test_pieces_take_less_memory_than_a_whole_walk(monkeypatch):
    made = trial(cube(), 2, epochs=150, points=6)
    problem = problem_of(made.site, made.data, default_free(made.site), None)
    state = start_of(made.site, 150, 0, None)
    peaks = []
    for at_once in (10, 150):
        monkeypatch.setattr(adjustment, "AT_ONCE", at_once)
        tracemalloc.start()
        evaluate(problem, state)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[0] < 2 / 3 * peaks[1]

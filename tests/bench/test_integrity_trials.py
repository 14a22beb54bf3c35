"""The generator of the integrity figures: faults, bound and limits are what they say."""

from __future__ import annotations

from dataclasses import replace

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.locate.fit import Measurements, fit_pose
from goldfield.site import load
from goldfield.types import Pose, Status
from tests.bench import (
    integrity_beacon_tables,
    integrity_figures,
    integrity_rated,
    integrity_risk_tables,
    integrity_room_tables,
    integrity_sites,
)
from tests.bench.integrity_adversary import TWO_SIDED, worst_faults
from tests.bench.integrity_coils import Coils, measured
from tests.bench.integrity_faults import SINGLE, faulty_rows, systematic, with_faults
from tests.bench.integrity_floor import FALSE_ALARMS, fault_size, fewest_missed
from tests.bench.integrity_outcome import evaluations, outcome_of
from tests.bench.integrity_risk import per_hour, upper_limit
from tests.bench.integrity_risk_tables import Histogram
from tests.bench.integrity_run import Run
from tests.bench.integrity_sites import EXACT, Errors, KeysUnknown, cube, hall, places, sigma_of, told, wire_distance
from tests.bench.integrity_survey import bound_m, really
from tests.bench.locate_trials import Trials, bound_of, cube_positions, magpylib_fields


def room(seed, count=5):
    rng = np.random.default_rng(seed)
    site = hall(rng, 4)
    return site, places(rng, site, count, near=False), rng


# ---- coils and measurements ----


def test_coils_of_a_site_have_the_fields_of_magpylibs_objects():
    site, position, _ = room(1)
    expected = magpylib_fields(site, position)
    assert np.allclose(Coils.of(site, 5).field(position), expected, rtol=1e-9, atol=0.0)


def test_moved_turned_and_stronger_coils_have_the_fields_of_such_objects():
    site, position, rng = room(2)
    step, turn = rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    coils = Coils.of(site, 5).moved(step).turned(turn).scaled(np.array([1.0, -1.0, 0.0, 1.2]))
    field = coils.field(position)
    for row, (beacon, factor) in enumerate(zip(site.beacons, (1.0, -1.0, 0.0, 1.2), strict=True)):
        stand = Rotation.align_vectors(beacon.axis[None], [[0.0, 0.0, 1.0]])[0]
        real = magpylib.current.Circle(
            diameter=2 * beacon.radius_m,
            current=beacon.turns * beacon.current_A * factor,
            position=beacon.position_m + step[row],
            orientation=Rotation.from_rotvec(turn[row]) * stand,
        )
        assert np.allclose(field[:, row], real.getB(position), rtol=1e-9, atol=1e-20)


def test_a_coil_that_points_down_is_turned_over():
    site = cube(2e-7)
    coils = Coils.of(site, 1).turned(np.array([np.pi, 0.0, 0.0]))
    point = np.array([[0.4, 0.5, 0.6]])
    assert np.allclose(coils.field(point), -Coils.of(site, 1).field(point), rtol=1e-6)


def test_the_sensors_matrix_acts_in_its_frame_and_noise_does_not_pass_it():
    site, position, rng = room(3, 400)
    field = Coils.of(site, 400).field(position)
    matrix = np.diag([0.0, 0.0, -2.0])
    run = measured(field, position, 1e-9, rng, matrix)
    seen = np.einsum("eki,enk->eni", run.rotation, field)
    assert np.std(run.field_T[:, :, 0]) == pytest.approx(1e-9, rel=0.1)
    assert np.std(run.field_T[:, :, 2] + 2.0 * seen[:, :, 2]) == pytest.approx(1e-9, rel=0.1)


# ---- faults ----


def test_reversed_and_swapped_axes_are_left_handed_and_nothing_else_is():
    for name, fault in systematic().items():
        if fault.sensor is not None:
            left = np.linalg.det(fault.sensor) < 0.0
            assert left == (fault.kind == "mirrored"), name
    assert sum(fault.kind == "mirrored" for fault in systematic().values()) == 7
    assert np.array_equal(systematic()["axes x and z swapped"].sensor @ [1, 2, 3], [3, 2, 1])
    assert np.array_equal(systematic()["gain of y -20%"].sensor @ [1, 1, 1], [1, 0.8, 1])


def test_a_site_in_feet_tells_its_places_in_feet():
    site = cube(2e-7)
    there = systematic()["positions in feet"].tells(site).beacons[-1]
    assert there.position_m == pytest.approx(np.array([2.13, 2.13, 1.78]) / 0.3048)
    assert there.radius_m == 0.149
    assert systematic()["all lengths in cm"].tells(site).beacons[-1].radius_m == pytest.approx(14.9)
    assert systematic()["sound"].tells(site) is site


def test_single_faults_change_one_beacon_as_they_say():
    site, position, rng = room(4)
    sound = Coils.of(site, 5)
    before = sound.field(position)
    factors = {
        "dead": 0.0,
        "reversed": -1.0,
        "wrong code": -1.0 / 1023.0,
        "current +20%": 1.2,
        "current -20%": 0.8,
    }
    rows = np.array([[0], [1], [2], [3], [0]])
    for kind in SINGLE:
        coils = with_faults(sound, rows, np.full(rows.shape, kind), rng)
        after = coils.field(position)
        hit = np.arange(4) == rows
        assert np.array_equal(after[~hit], before[~hit]), kind
        if kind in factors:
            assert np.allclose(after[hit], factors[kind] * before[hit], rtol=1e-12), kind
        else:
            step = np.linalg.norm(coils.position_m[hit] - sound.position_m[hit], axis=1)
            assert step == pytest.approx(0.01 * float(kind.split()[1]), rel=1e-9)


def test_two_faults_are_of_two_beacons_that_are_heard():
    rng = np.random.default_rng(5)
    field = np.zeros((300, 4, 3))
    field[:, :, 0] = [21.0, 19.0, 40.0, 1.0]
    rows = faulty_rows(field, 1.0, 2, rng)
    assert {tuple(sorted(row)) for row in rows.tolist()} == {(0, 2)}
    assert set(faulty_rows(field, 1.0, 1, rng)[:, 0].tolist()) == {0, 2}
    assert set(faulty_rows(field, 100.0, 1, rng)[:, 0].tolist()) == {2}


# ---- sites ----


def test_a_site_comes_back_from_its_file():
    site, _, _ = room(6)
    back = told(site)
    for one, other in zip(site.beacons, back.beacons, strict=True):
        assert other.position_m == pytest.approx(one.position_m, rel=1e-14)
        assert other.axis == pytest.approx(one.axis, rel=1e-14)
        assert (other.id, other.turns, other.radius_m, other.code) == (one.id, one.turns, one.radius_m, one.code)
        assert other.current_A == pytest.approx(one.current_A, rel=1e-14)
    assert back.sensor.noise_T == site.sensor.noise_T


def test_unknown_keys_of_errors_are_left_out_only_where_there_are_none(monkeypatch):
    def refuse(path):
        if "position_sd_m" in path.read_text(encoding="utf-8"):
            raise UserError('site.toml: "survey" is unknown')
        return load(path)

    monkeypatch.setattr(integrity_sites, "load", refuse)
    assert len(told(cube(2e-7), EXACT).beacons) == 8
    assert len(told(cube(2e-7), None).beacons) == 8
    with pytest.raises(KeysUnknown):
        told(cube(2e-7), Errors(position_m=0.01))


def test_places_near_coils_are_within_a_radius_and_off_the_wire():
    rng = np.random.default_rng(7)
    site = hall(rng, 5)
    position = places(rng, site, 200, near=True)
    from_centres = [np.linalg.norm(position - b.position_m, axis=1) / b.radius_m for b in site.beacons]
    assert np.min(from_centres, axis=0).max() <= 1.0
    assert min(wire_distance(b, position).min() for b in site.beacons) > 0.01


def test_the_distance_from_a_wire():
    beacon = cube(2e-7).beacons[0]
    points = np.array([[0.0, 0.0, 0.0], [0.149, 0.0, 0.1], [0.0, 0.249, 0.0]])
    assert wire_distance(beacon, points) == pytest.approx([0.149, 0.1, 0.1])


# ---- outcome ----


def pose(status, error_m, sd_m, **given):
    return Pose(
        epoch=0,
        time_s=0.0,
        position_m=np.array([error_m, 0.0, 0.0]),
        orientation_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        position_cov_m2=sd_m**2 * np.eye(3),
        attitude_cov_rad2=np.eye(3),
        residual=1.0,
        status=status,
        used=(),
        **given,
    )


def test_wrong_by_either_rule_on_both_sides():
    errors = [(0.0489, 0.01), (0.0491, 0.01), (0.0499, 1.0), (0.0501, 1.0)]  # sqrt(24) = 4.899
    poses = [pose(Status.OK, *one) for one in errors] + [pose(Status.WEAK, 1.0, 0.01)]
    outcome = outcome_of(poses, np.zeros((5, 3)))
    assert outcome.wrong_by_covariance.tolist() == [False, True, False, False, False]
    assert outcome.wrong_by_distance.tolist() == [False, False, False, True, False]


def test_the_normalised_error_knows_the_directions_and_a_covariance_that_is_none():
    covariance = np.array([[4.0, 1.9, 0.0], [1.9, 1.0, 0.0], [0.0, 0.0, 9.0]])
    given = [covariance, covariance - 2.0 * np.eye(3), np.zeros((3, 3))]
    poses = [replace(pose(Status.OK, 1.0, 1.0), position_cov_m2=one) for one in given]
    found = outcome_of(poses, np.zeros((3, 3))).nees
    assert found[0] == pytest.approx(np.linalg.inv(covariance)[0, 0] / 3.0)
    assert found[1:].tolist() == [np.inf, np.inf]


def test_beacons_left_out_are_an_alarm():
    poses = [pose(Status.OK, 0.0, 0.01), pose(Status.OK, 0.0, 0.01, excluded=("b1",))]
    poses.append(pose(Status.INCONSISTENT, 0.0, 0.01))
    assert outcome_of(poses, np.zeros((3, 3))).alarmed.tolist() == [False, True, True]


# ---- limits of a risk ----


def test_evaluations_are_what_the_search_and_the_explanation_of_an_epoch_take():
    """Four coils let all poses be searched, eight in the cube none; an axis that is reversed is searched for."""
    rng = np.random.default_rng(3)
    few, many = hall(rng, 4), cube(2e-8)
    counted = []
    for site, sensor in ((few, None), (many, None), (many, np.diag([1.0, 1.0, -1.0]))):
        position = cube_positions(rng, 20)
        run = measured(Coils.of(site, 20).field(position), position, sigma_of(site), rng, sensor)
        counted.append(evaluations(told(site, EXACT), run, 15))
    assert [len(each) for each in counted] == [15, 15, 15]
    assert 5 < np.median(counted[1]) < 50 < 200 < min(counted[0])
    assert min(counted[2]) > 200
    assert max(max(each) for each in counted) < 25_000


def test_upper_limits_are_the_published_ones():
    assert upper_limit(0, 10) == pytest.approx(0.2589, abs=1e-4)  # 1 - 0.05^(1/10): the rule of three, exact
    assert upper_limit(0, 1_000_000) == pytest.approx(2.9957e-6, rel=1e-4)
    assert 1e6 * upper_limit(1, 1_000_000) == pytest.approx(4.7439, rel=1e-4)  # Poisson's, one-sided 95 %
    assert 1e6 * upper_limit(10, 1_000_000) == pytest.approx(16.962, rel=1e-4)
    assert upper_limit(3, 3) == 1.0


def test_an_hour_has_one_independent_epoch_in_ten_seconds():
    assert per_hour(1e-6) == pytest.approx(3.6e-4, rel=1e-3)
    assert per_hour(1.0) == 1.0


# ---- errors of survey and sensor ----


def test_without_errors_the_bound_is_the_usual_one():
    rng = np.random.default_rng(10)
    site = cube(2e-7)
    position = cube_positions(rng, 20)
    run = measured(Coils.of(site, 20).field(position), position, 2e-7 / np.sqrt(1023), rng)
    least = bound_m(site, position, run.rotation, 2e-7 / np.sqrt(1023), EXACT)
    assert least == pytest.approx(bound_of(site, run), rel=1e-3)


@pytest.mark.parametrize(
    "errors",
    [
        Errors(position_m=1e-3),
        Errors(axis_rad=2e-3),
        Errors(current=2e-3),
        Errors(gain=2e-3),
        Errors(sensor_axis_rad=2e-3),
    ],
)
def test_the_bound_with_errors_is_reached_by_weighted_least_squares(errors):
    """One step of least squares with the true covariance, taken from many draws, has the errors that the bound says."""
    rng = np.random.default_rng(11)
    site, count, sigma = cube(2e-8), 4000, 1e-10
    position = np.tile([[0.9, 1.2, 0.8]], (count, 1))
    rotation = np.tile(Rotation.from_rotvec([0.3, -0.2, 1.1]).as_matrix(), (count, 1, 1))
    coils, sensor = really(site, count, errors, rng)
    run = measured(coils.field(position), position, sigma, rng, sensor, rotation)
    clean = np.einsum("eki,enk->eni", rotation[:1], Coils.of(site, 1).field(position[:1]))
    residual = (run.field_T - clean).reshape(count, -1)
    columns = []
    for k in range(6):
        ends = []
        for step in (1e-5, -1e-5):
            place = position[:1] + step * np.eye(3)[k] if k < 3 else position[:1]
            turn = Rotation.from_rotvec(step * np.eye(3)[k - 3]).as_matrix() if k >= 3 else np.eye(3)
            field = Coils.of(site, 1).field(place)
            ends.append(np.einsum("eki,enk->eni", turn @ rotation[:1], field).ravel())
        columns.append((ends[0] - ends[1]) / 2e-5)
    jacobian = np.stack(columns, axis=1)
    inverse = np.linalg.inv(np.cov(residual.T))
    solve = np.linalg.solve(jacobian.T @ inverse @ jacobian, jacobian.T @ inverse)
    error = np.sqrt(np.mean(((residual @ solve.T)[:, :3] ** 2).sum(axis=1)))
    assert error == pytest.approx(bound_m(site, position[:1], rotation[:1], sigma, errors)[0], rel=0.06)


# ---- the worst faults ----


def test_the_worst_fault_adds_one_to_the_cost_and_moves_the_position_most():
    site, rng = cube(2e-8), np.random.default_rng(31)
    position = cube_positions(rng, 20)
    sound = measured(Coils.of(site, 20).field(position), position, 1e-12, rng)  # all but without noise
    trials = replace(sound, sigma_T=np.full((20, 8), 1e-10))
    fault, floor = worst_faults(site, trials)
    assert (np.abs(fault).sum(axis=2) > 0.0).sum(axis=1).tolist() == [1] * 20
    model = FieldModel(site.beacons)

    def fitted(field_T):
        return fit_pose(model, Measurements(field_T, trials.sigma_T), position, trials.rotation)

    bad = fitted(trials.field_T + 3.0 * fault)
    assert np.allclose(bad.cost, 9.0, rtol=0.05)
    moved = np.linalg.norm(bad.position_m - position, axis=1) / 3.0
    assert (moved < floor / TWO_SIDED).all()
    for _ in range(20):
        other = rng.normal(size=fault.shape) * (fault != 0.0) * 1e-9
        some = fitted(trials.field_T + other)
        size = np.sqrt(some.cost)
        assert (np.linalg.norm(some.position_m - position, axis=1) / size < 1.05 * moved).all()


def test_quantiles_of_a_histogram_are_right_to_a_hundredth():
    values = np.random.default_rng(32).lognormal(sigma=2.0, size=10_000)
    told = Histogram()
    for part in np.split(values, 10):
        told.add(part)
    for share in (0.05, 0.5, 0.95):
        assert told.quantile(share) == pytest.approx(np.quantile(values, share), rel=0.015)
    assert np.isnan(Histogram().quantile(0.5))


# ---- tracks by blocks ----


@pytest.mark.long
def test_a_track_at_rest_is_right_and_tells_a_large_fault_once_it_has_begun():
    run = Run(1, 1, 1, 33)
    sound, late = (integrity_rated.tracks(run, 2e-8, size, 66, 1) for size in (0.0, 30.0))
    assert len(sound) == integrity_rated.BLOCKS
    assert not sound.unprotected.any()
    assert (sound.error_m[sound.ok] < 0.03).all()
    assert sound.ok.mean() > 0.9
    assert late.ok[40:66].all()
    assert late.alarmed[66 + 40 :].any()


# ---- the program ----


def test_every_table_fits_a_hundred_columns(capsys, monkeypatch):
    for module in (integrity_beacon_tables, integrity_rated, integrity_risk_tables, integrity_room_tables):
        monkeypatch.setattr(module, "progress", lambda rows, what: [])
    assert integrity_figures.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(not line for line in lines) == len(integrity_figures.TABLES) + 1  # systematic faults at two noises
    assert [line for line in lines if len(line) > 100] == []


def test_rows_of_a_table_are_printed(capsys):
    assert integrity_figures.main(["systematic", "--poses", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("axis x reversed ") for line in lines) == 2
    assert [line for line in lines if len(line) > 100] == []


def test_an_unknown_table_is_refused():
    with pytest.raises(SystemExit):
        integrity_figures.main(["everything"])


def test_the_best_test_of_an_axis_gain_misses_as_often_as_computed():
    """By brute force: the gain is fitted beside the pose to thousands of noises, linear around the truth."""
    site, rng = cube(2e-7), np.random.default_rng(31)
    gain = np.diag([1.0, 1.2, 1.0])
    position = cube_positions(rng, 400)
    run = measured(Coils.of(site, 400).field(position), position, sigma_of(site), rng, gain)
    hardest = np.argmin(fault_size(site, run, gain), keepdims=True)
    one = Trials(*(getattr(run, part)[hardest] for part in ("position_m", "rotation", "field_T", "sigma_T")))
    model = FieldModel(site.beacons)
    seen = model.field(one.position_m)[0] @ one.rotation[0]
    columns = [(seen @ (gain - np.eye(3))).ravel()]
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        shifted = model.field(one.position_m + step)[0] - model.field(one.position_m - step)[0]
        columns.append((shifted @ one.rotation[0] / 2e-6).ravel())
        columns.append(np.cross(seen, np.eye(3)[k]).ravel())
    design = np.stack(columns, axis=1) / one.sigma_T[0, 0]
    estimate = np.linalg.pinv(design)[0]
    found = (1.0 + estimate @ rng.normal(size=(len(design), 20_000))) / np.linalg.norm(estimate)
    missed = (found < norm.isf(FALSE_ALARMS)).mean()
    assert 0.02 < missed < 0.98
    assert fewest_missed(site, one, gain) == pytest.approx(missed, abs=0.015)

"""A survey that learns metal: derivatives against differences, rooms whose metal is of another kind than is fitted."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import goldfield
from goldfield import cli
from goldfield.cli.surveying import table_of
from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.locate import Locator
from goldfield.site import Site
from goldfield.site.model import Survey
from goldfield.survey import Free, SurveyData, survey
from goldfield.survey.adjustment import evaluate
from goldfield.survey.metal import MetalState, effects_of_bodies, effects_of_harmonics, no_metal
from goldfield.survey.metal_choice import walked_room
from goldfield.survey.metal_picture import png, residuals
from goldfield.survey.metal_rest import trusted
from goldfield.survey.parameters import ANCHOR, beacons_of, start_of
from goldfield.survey.problem import problem_of
from goldfield.survey.procedure import solve
from goldfield.types import Status
from tests.bench.integrity_sites import EXACT, text_of
from tests.bench.metal_trials import MetalTrial, metal_trial

FIELD = frozenset({Free.FIELD})


def _state(site: Site, degree: int = 3, bodies: int = 2) -> MetalState:
    rng = np.random.default_rng(5)
    count = (degree + 1) ** 2 - 1
    return MetalState(
        np.array([1.0, 1.1, 0.9]),
        1.2,
        degree,
        2e-9 * rng.normal(size=(len(site.beacons), count)),
        np.array([[-0.5, 1.0, 1.2], [2.6, 1.8, 0.4]])[:bodies],
        1e5 * rng.normal(size=(bodies, 6)),
    )


def test_effects_are_those_of_differences() -> None:
    """Each unknown of metal is moved a little; the fields of the model change as the effects say."""
    site = metal_trial("none", 1, epochs=120, later=40).site
    metal = _state(site)
    point = np.random.default_rng(6).uniform(0.4, 1.7, (9, 3))
    start = replace(
        start_of(site, 0, 0, metal), log_current=0.1 * np.random.default_rng(7).normal(size=len(site.beacons))
    )

    def field(values: MetalState) -> np.ndarray:
        return FieldModel(beacons_of(site, replace(start, metal=values))).field(point)

    bare = FieldModel([replace(beacon, metal=None) for beacon in beacons_of(site, start)])
    of_bodies = effects_of_bodies(metal, bare, point)
    of_harmonics = effects_of_harmonics(metal, np.exp(start.log_current), point)
    count = metal.harmonics_T.size
    for unknown in (0, 7, count - 1, *range(count, metal.size)):
        step = np.zeros(metal.size)
        step[unknown] = 1e-10 if unknown < count else 1e-6 if (unknown - count) % 9 < 3 else 1.0
        slope = (field(metal.moved(step)) - field(metal.moved(-step))) / (2.0 * step[unknown])
        expected = np.zeros_like(slope)
        if unknown < count:
            beacon, coefficient = divmod(unknown, metal.harmonics_T.shape[1])
            expected[:, beacon] = of_harmonics[:, beacon, :, coefficient]
        else:
            expected = of_bodies[..., unknown - count]
        np.testing.assert_allclose(slope, expected, rtol=0.0, atol=1e-5 * np.abs(expected).max())


def test_the_gradient_of_the_cost_is_that_of_differences() -> None:
    """The whole chain from unknowns of metal to the normal equations, poses and beacons free as well."""
    trial = metal_trial("spheres", 1, epochs=120, later=40)
    free = frozenset({Free.FIELD, Free.POSITION, Free.CURRENT})
    problem = problem_of(trial.site, trial.data, free, _state(trial.site))
    rng = np.random.default_rng(8)
    start = replace(
        start_of(trial.site, len(trial.data.epochs), 0, _state(trial.site)),
        sensor_m=rng.uniform(0.5, 1.6, (len(trial.data.epochs), 3)),
    )
    now = evaluate(problem, start, 0.05)
    gradient = np.zeros(len(problem.prior.free))
    gradient[problem.prior.free] = now.equations.gradient
    first = len(gradient) - start.metal.size
    scale = 1.0 / np.sqrt(np.diag(now.equations.common))
    steps = np.zeros(len(gradient))
    steps[problem.prior.free] = 1e-4 * scale
    nothing = np.zeros((len(trial.data.epochs), 6)), np.empty((0, ANCHOR))
    for unknown in (first, first + 40, len(gradient) - 18, len(gradient) - 12, len(gradient) - 1):
        move = np.zeros(len(gradient))
        move[unknown] = steps[unknown]
        costs = [evaluate(problem, start.moved(sign * move, *nothing), 0.05).cost for sign in (1.0, -1.0)]
        slope = (costs[1] - costs[0]) / (2.0 * steps[unknown])
        assert slope == pytest.approx(2.0 * gradient[unknown], rel=1e-3, abs=2e-2 / steps[unknown])


def _errors_m(site: Site, trial: MetalTrial) -> np.ndarray:
    poses = Locator(site).locate_many(trial.later)
    return np.array([np.linalg.norm(pose.position_m - true) for pose, true in zip(poses, trial.later_m, strict=True)])


@pytest.mark.slow  # the next test learns the same plates of fewer epochs, four of them spoilt
def test_plates_are_learned_from_a_walk() -> None:
    """Sheets beside the room: poses five times nearer to the truth, and their covariances can be believed."""
    trial = metal_trial("plates", 3)
    result = survey(trial.site, trial.data, FIELD)
    before, after = np.median(_errors_m(trial.site, trial)), np.median(_errors_m(result.site, trial))
    assert before > 3e-3
    assert after < before / 5.0
    assert 0.7 < np.mean(_nees(result.site, trial)) < 1.3
    assert result.metal is not None
    assert result.metal.residual_with < 0.2 * result.metal.residual_without


def test_epochs_of_a_sensor_that_is_just_switched_on_bend_no_map() -> None:
    """Two of noise alone, two in which the coils had just come on: a map explains them far out, where nobody was."""
    trial = metal_trial("plates", 3, epochs=160)
    rng = np.random.default_rng(17)
    walk = trial.data.epochs
    spoilt = [replace(walk[row], field_T=3e-9 * rng.normal(size=walk[row].field_T.shape)) for row in range(2)]
    for row in range(2, 4):
        share = rng.uniform(-0.2, 0.2, (len(walk[row].beacons), 1))
        turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        spoilt.append(replace(walk[row], field_T=share * walk[row].field_T @ turned))
    result = survey(trial.site, replace(trial.data, epochs=(*spoilt, *walk[4:])), FIELD)
    assert {fields.epoch for fields in spoilt} <= {outlier.epoch for outlier in result.outliers}
    assert np.isnan(result.position_m[:4]).all()
    assert np.isfinite(result.position_m[4:]).all(axis=1).mean() > 0.95
    assert result.site.metal is not None
    assert np.abs(result.site.metal.walked_m - np.mean(trial.later_m, axis=0)).max() < 1.0
    assert np.median(_errors_m(result.site, trial)) < np.median(_errors_m(trial.site, trial)) / 5.0


def _nees(site: Site, trial: MetalTrial) -> np.ndarray:
    """Return the normalised squares of the errors of poses that are ``ok``, an axis: 1 on the average."""
    pairs = zip(Locator(site).locate_many(trial.later), trial.later_m, strict=True)
    sound = [(pose, pose.position_m - true) for pose, true in pairs if pose.status is Status.OK]
    return np.array([error @ np.linalg.solve(pose.position_cov_m2, error) / 3.0 for pose, error in sound])


def test_poses_beside_metal_that_no_body_explains_say_how_good_they_are() -> None:
    """Large spheres: what the walk does not tell of the map counts in the covariance (1.6 without)."""
    trial = metal_trial("spheres", 12)
    site = survey(trial.site, trial.data, FIELD).site
    assert site.metal is not None
    assert site.metal.sd_T_A > 0.0
    nees = _nees(site, trial)
    assert len(nees) > 80
    assert 0.7 < nees.mean() < 1.3


def test_the_deviations_of_a_site_are_brought_to_what_is_known() -> None:
    """Noise that the epochs kept out show goes into ``sd_T_A``; of deviations that count twice a part is taken away."""
    trial = metal_trial("none", 1, epochs=120, points=10, later=40)
    data = SurveyData(trial.data.epochs)
    solution = solve(trial.site, data, FIELD, metal=_state(trial.site, bodies=0))
    metal = solution.state.metal.metal()
    exact = replace(
        trial.site, metal=metal, beacons=solution.state.metal.added_to(trial.site.beacons, trial.site.beacons, metal)
    )
    kept_out = [trusted(exact, solution, residual).metal for residual in (1.0, 2.0)]
    few, many = (one.sd_T_A * abs(exact.beacons[0].current_A) for one in kept_out if one is not None)
    sigma = trial.later[0].sigma_T[0]
    assert few < many
    assert many == pytest.approx(np.hypot(few, np.sqrt(3.0) * sigma), rel=0.1)
    # The adjustment took the beacons for exact: what the file says of them is not its to change.
    declared = tuple(replace(beacon, survey=Survey(0.005, 0.01, 0.01)) for beacon in exact.beacons)
    assert trusted(replace(exact, beacons=declared), solution, 1.0).beacons[0].survey == Survey(0.005, 0.01, 0.01)
    # With known points it knows beacons to millimetres: deviations of 5 cm are made as small as they need be.
    free = frozenset({Free.FIELD, Free.POSITION})
    known = solve(trial.site, trial.data, free, metal=_state(trial.site, bodies=0))
    wide = tuple(replace(beacon, survey=Survey(0.05)) for beacon in exact.beacons)
    assert 0.0 < trusted(replace(exact, beacons=wide), known, 1.0).beacons[0].survey.position_sd_m < 0.05


def test_without_metal_nothing_is_lost() -> None:
    trial = metal_trial("none", 2)
    result = survey(trial.site, trial.data, FIELD)
    assert result.site.metal is None
    assert result.metal is not None
    assert 0.1 < result.metal.unseen_T / trial.later[0].sigma_T[0] < 0.6
    np.testing.assert_allclose(_errors_m(result.site, trial), _errors_m(trial.site, trial), rtol=0.0, atol=1e-9)


def test_too_short_a_walk_is_refused() -> None:
    trial = metal_trial("none", 1, epochs=99, later=40)
    with pytest.raises(UserError, match="a walk of at least 100 epochs, and there are 99"):
        survey(trial.site, SurveyData(trial.data.epochs), FIELD)


def test_the_walked_room_holds_the_walk_and_little_more() -> None:
    points = np.random.default_rng(3).uniform((0.0, 0.0, 1.0), (2.0, 2.0, 1.0), (200, 3))  # flat
    corners = walked_room(points, 1.0)
    assert len(corners) <= 42
    assert np.linalg.matrix_rank(corners - corners.mean(axis=0)) == 3
    assert (corners.min(axis=0) >= points.min(axis=0) - 0.0501).all()
    assert (corners.max(axis=0) <= points.max(axis=0) + 0.0501).all()


def test_no_metal_has_no_unknowns() -> None:
    assert no_metal(8).is_none
    assert no_metal(8).vector().shape == (0,)


def test_the_command_writes_what_locate_applies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From table and site file to a new site file, through the command line; comments stay."""
    trial = metal_trial("spheres", 1, epochs=120, later=60)
    site = tmp_path / "room.toml"
    site.write_text(f"# my hall\n{text_of(trial.site, EXACT)}")
    table = tmp_path / "walk.csv"
    rows = ["epoch,t_s,beacon,bx_T,by_T,bz_T,sigma_T"]
    for fields in trial.data.epochs:
        for name, b, sigma in zip(fields.beacons, fields.field_T.tolist(), fields.sigma_T.tolist(), strict=True):
            rows.append(f"{fields.epoch},{fields.time_s},{name},{b[0]!r},{b[1]!r},{b[2]!r},{sigma!r}")
    table.write_text("\n".join(rows) + "\n")
    out, drawn = tmp_path / "new.toml", tmp_path / "map.png"
    arguments = ["survey", "--site", str(site), str(table), "--free", "field", "--out", str(out), "--json"]
    assert cli.main([*arguments, "--map", str(drawn)]) == 0
    printed = capsys.readouterr().out
    assert drawn.read_bytes().startswith(b"\x89PNG")
    assert cli.main([*arguments, "--force", "--map", str(tmp_path / "map.pdf")]) == 2
    assert "map.pdf: the residual map is a picture: give a name that ends with .png" in capsys.readouterr().err
    told = json.loads(printed)["metal"]
    assert told["residual_with"] < 0.3 * told["residual_without"]
    assert out.read_text().startswith("# my hall\n")
    new = goldfield.load_site(out)
    assert new.metal is not None
    assert len(new.metal.body_m) == len(told["bodies_m"])
    assert np.median(_errors_m(new, trial)) < 0.3 * np.median(_errors_m(trial.site, trial))


def test_residuals_tell_places_and_beacons() -> None:
    """Noise alone leaves 1; a beacon that stands 2 cm elsewhere stands out, and its neighbourhood with it."""
    trial = metal_trial("none", 1, epochs=120, later=40)
    sound = residuals(trial.site, trial.data.epochs)
    assert np.abs(sound.position_m - _walked(trial)).max() < 0.01
    assert np.sqrt(np.mean(sound.of_field**2)) == pytest.approx(1.0, abs=0.05)
    moved = replace(trial.site.beacons[3], position_m=trial.site.beacons[3].position_m + np.array([0.0, 0.0, 0.02]))
    wrong = residuals(
        replace(trial.site, beacons=(*trial.site.beacons[:3], moved, *trial.site.beacons[4:])), trial.data.epochs
    )
    assert wrong.of_beacon.argmax() == 3
    distance = np.linalg.norm(wrong.position_m - moved.position_m, axis=1)
    near = distance < np.quantile(distance, 0.25)
    assert wrong.of_epoch[near].mean() > 1.5 * wrong.of_epoch[~near].mean()
    few = replace(trial.data.epochs[0], field_T=np.full((8, 3), np.nan))
    assert np.isnan(residuals(trial.site, [few, *trial.data.epochs[1:4]]).of_epoch).tolist() == [True] + 3 * [False]


def _walked(trial: MetalTrial) -> np.ndarray:
    poses = Locator(trial.site).locate_many(trial.data.epochs)
    return np.array([pose.position_m for pose in poses])


def test_the_picture_is_the_same_each_time_and_shows_both_sites() -> None:
    trial = metal_trial("none", 1, epochs=120, later=40)
    epochs = trial.data.epochs[:30]
    metal = replace(_state(trial.site).metal(), walked_m=walked_room(trial.later_m, 1.0))
    beacons = _state(trial.site).added_to(trial.site.beacons, trial.site.beacons, metal)
    other = replace(trial.site, beacons=beacons, metal=metal)
    assert png(trial.site, other, epochs) == png(trial.site, other, epochs)
    assert png(trial.site, other, epochs) != png(other, trial.site, epochs)


def test_metal_that_is_not_told_from_noise_is_said_to_be_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A sheet at ten times the noise: nothing is written, and the words tell what may be hidden, and where."""
    trial = metal_trial("beams", 11, epochs=120, points=4, later=40)
    noisy = np.random.default_rng(9)
    sigma = 20.0 * trial.later[0].sigma_T
    epochs = tuple(
        replace(one, field_T=one.field_T + sigma[:, None] * noisy.normal(size=(8, 3)), sigma_T=sigma)
        for one in trial.data.epochs
    )
    free = frozenset({Free.FIELD, Free.CURRENT})
    result = survey(trial.site, replace(trial.data, epochs=epochs), free)
    assert result.site.metal is None
    text = table_of(trial.site, result)
    told = re.search(r"metal was looked for and not told from noise: .* less than about ([\d.]+) nT to a comp", text)
    assert told is not None
    assert result.metal is not None
    assert float(told[1]) == pytest.approx(1e9 * result.metal.unseen_T, rel=0.06)
    assert 0.1 < result.metal.unseen_T / sigma[0] < 1.0
    assert "what such metal adds is then in the places, axes and currents that were found" in text

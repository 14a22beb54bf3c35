"""Errors of the site and the sensor: the bound, honest covariances, and tests that judge by what is declared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate import Locator, kernel
from goldfield.locate.constellation import Constellation
from goldfield.locate.fault_statistics import fault_statistics
from goldfield.locate.fit import Measurements, fit_pose
from goldfield.locate.protection import protection_level
from goldfield.locate.sensor_axes import levers_of
from goldfield.locate.site_errors import SiteErrors, errors_of
from goldfield.locate.uncertainty import cramer_rao_bound, dilution_of_precision, second_order_covariance
from goldfield.site import SensorSite, Survey
from goldfield.types import Status
from tests.bench import locate_trials as bench
from tests.host.locate import built_sites as built

LEAN = np.radians(1.0)
SITES = {"cube": built.mixed_cube, "hall of 8": lambda noise: built.hall(8, noise)}
SITES["hall of 5"] = lambda noise: built.hall(5, noise)


def judged(site, told, rng, count, real=None, sensor=None):
    """Share of sound poses and, among those, NEES/3 of position and attitude and the error beside the bound.

    No error alerts: the protection level is not what is judged here.
    """
    told = replace(told, alert_limit_m=1e6)
    position = built.inside(site, rng, count)
    run = built.measured(site, position, rng, real, sensor)
    poses = Locator(told).locate_many(bench.fields_of(told, run))
    sound = np.array([pose.status is Status.OK for pose in poses])
    error = np.array([pose.position_m for pose in poses]) - position
    rotation = Rotation.from_quat([pose.orientation_xyzw for pose in poses]).as_matrix()
    turn = bench.turn_error(run.rotation, rotation)
    of_position = bench.normalised_error(error, np.array([pose.position_cov_m2 for pose in poses]))
    of_attitude = bench.normalised_error(turn, np.array([pose.attitude_cov_rad2 for pose in poses]))
    bound = cramer_rao_bound(told, position, run.rotation)[:, :3, :3]
    excess = np.sqrt((error[sound] ** 2).sum(axis=1).mean() / np.einsum("ekk->e", bound)[sound].mean())
    return sound.mean(), of_position[sound].mean(), of_attitude[sound].mean(), excess


def test_the_bound_is_that_of_finite_differences():
    """All effects by differences of magpylib's fields, the sensor's as nine elements of a matrix."""
    rng = np.random.default_rng(11)
    surveys = [Survey(*(rng.uniform(0.2, 2.0, size=3) * [0.01, LEAN, 0.01])) for _ in range(6)]
    site = bench.site_of(built.mixed_cube(2e-7).beacons[:6])
    site = replace(site, beacons=tuple(replace(b, survey=s) for b, s in zip(site.beacons, surveys, strict=True)))
    site = replace(site, sensor=replace(site.sensor, gain_sd=0.01, axis_sd_rad=0.02))
    sigma = site.sensor.noise_T / np.sqrt(bench.CHIPS)
    for _ in range(3):
        position, rotation = built.inside(site, rng, 1)[0], Rotation.random(rng=rng).as_matrix()
        field = bench.magpylib_fields(site, position[None])[0]

        def components(site=site, position=position, turn=(0.0, 0.0, 0.0), rotation=rotation):
            attitude = Rotation.from_rotvec(turn).as_matrix() @ rotation
            return (bench.magpylib_fields(site, position[None])[0] @ attitude).ravel()

        steps = [1e-5 * row for row in np.eye(3)]
        slope = [components(position=position + d) - components(position=position - d) for d in steps]
        slope += [components(turn=d) - components(turn=-d) for d in steps]
        jacobian = np.array(slope).T / 2e-5
        covariance = sigma**2 * np.eye(18)
        for row, beacon in enumerate(site.beacons):

            def changed(row=row, **values):
                beacons = list(site.beacons)
                beacons[row] = replace(beacons[row], **values)
                return components(replace(site, beacons=tuple(beacons)))

            survey, difference = beacon.survey, []
            for d in steps:
                place = [changed(position_m=beacon.position_m + sign * d) for sign in (1, -1)]
                axis = [changed(axis=Rotation.from_rotvec(sign * d).apply(beacon.axis)) for sign in (1, -1)]
                difference.append((place[0] - place[1]) * survey.position_sd_m / 2e-5)
                difference.append((axis[0] - axis[1]) * survey.axis_sd_rad / 2e-5)
            current = [changed(current_A=beacon.current_A * (1.0 + sign * 1e-5)) for sign in (1, -1)]
            difference.append((current[0] - current[1]) * survey.current_sd / 2e-5)
            covariance += np.array(difference).T @ np.array(difference)
        for i, j in np.ndindex(3, 3):
            effect = np.zeros((6, 3))
            effect[:, i] = (field @ rotation)[:, j] * (0.01 if i == j else 0.02)
            covariance += np.outer(effect.ravel(), effect.ravel())
        expected = np.linalg.inv(jacobian.T @ np.linalg.solve(covariance, jacobian))
        found = cramer_rao_bound(site, position[None], rotation[None])[0]
        scale = 1.0 / np.sqrt(np.diag(expected))
        np.testing.assert_allclose(found * np.outer(scale, scale), expected * np.outer(scale, scale), atol=2e-4)


def test_noise_alone_is_an_option_of_the_bound():
    plain = built.mixed_cube()
    told, position = built.declared(plain, gain_sd=0.01), np.array([[1.0, 0.8, 0.7]])
    exact = cramer_rao_bound(plain, position)
    np.testing.assert_array_equal(cramer_rao_bound(told, position, noise_only=True), exact)
    assert (np.diag(cramer_rao_bound(told, position)[0]) > 1.5 * np.diag(exact[0])).all()
    np.testing.assert_array_equal(dilution_of_precision(told, position), dilution_of_precision(plain, position))


@pytest.mark.parametrize("sensor", [None, (0.01, LEAN)], ids=["exact sensor", "1 % and 1 degree"])
@pytest.mark.parametrize("noise", [2e-8, 2e-7])
@pytest.mark.parametrize("name", SITES)
def test_declared_errors_make_the_covariance_honest(name, noise, sensor):
    site = SITES[name](noise)
    told = built.declared(site, built.DECLARED, *(sensor or ()))
    sound, position, attitude, excess = judged(site, told, np.random.default_rng(12), 1000, built.DECLARED, sensor)
    assert sound >= 0.98
    assert 0.7 < position < 1.3
    assert 0.7 < attitude < 1.3
    assert 0.85 < excess < 1.15


@pytest.mark.parametrize(("factor", "least", "most"), [(0.5, 0.2, 0.5), (1.0, 0.85, 1.15), (2.0, 2.8, 4.5)])
def test_errors_other_than_declared_scale_the_normalised_error(factor, least, most):
    """At .2 mG the errors of the site are all that counts: half of them is a quarter of the square."""
    site, d = built.mixed_cube(2e-8), built.DEFAULT
    told = built.declared(site, d, 0.003, 0.005)
    real = Survey(factor * d.position_sd_m, factor * d.axis_sd_rad, factor * d.current_sd)
    rng = np.random.default_rng(13)
    position = built.inside(site, rng, 1000)
    run = built.measured(site, position, rng, real, (factor * 0.003, factor * 0.005))
    model, errors = FieldModel(site.beacons), errors_of(told.beacons, told.sensor)
    measurements = Measurements(run.field_T, run.sigma_T).with_errors(model, errors)
    fit = fit_pose(model, measurements, position, run.rotation)
    assert fit.converged.all()
    covariance = second_order_covariance(model, measurements, fit.position_m, fit.rotation)
    error = bench.normalised_error(fit.position_m - position, covariance[:, :3, :3])
    turn = bench.normalised_error(bench.turn_error(run.rotation, fit.rotation), covariance[:, 3:, 3:])
    chi2 = fit.cost.mean() / 18
    for found in (error.mean(), turn.mean(), chi2):
        assert least < found < most


def test_half_the_default_is_sound_and_an_exact_site_too():
    site, d = built.mixed_cube(2e-7), built.DEFAULT
    told = built.declared(site, d, 0.003, 0.005)
    for real in (Survey(), Survey(d.position_sd_m / 2, d.axis_sd_rad / 2, d.current_sd / 2)):
        sound, position, _, _ = judged(site, told, np.random.default_rng(14), 1000, real)
        assert sound >= 0.998
        assert 0.5 < position < 1.0


def test_faults_beyond_the_declared_errors_are_found_and_errors_within_are_not():
    site = built.mixed_cube(2e-7)
    told, rng = built.declared(site, gain_sd=0.003, axis_sd_rad=0.005), np.random.default_rng(15)
    position = built.inside(site, rng, 1000)
    run = built.measured(site, position, rng, built.DECLARED, (0.003, 0.005))
    model, errors = FieldModel(site.beacons), errors_of(told.beacons, told.sensor)

    def statistics(field):
        measurements = Measurements(field, run.sigma_T).with_errors(model, errors)
        fit = fit_pose(model, measurements, position, run.rotation)
        return fault_statistics(model, measurements, fit)

    sound = statistics(run.field_T)
    assert (sound.freedom == 3).all()
    assert sound.drop.mean() == pytest.approx(3.0, abs=0.15)  # means of chi-square with as many degrees
    assert sound.scale.mean() == pytest.approx(1.0, abs=0.1)
    for mean, degrees in zip(sound.distortion.mean(axis=0)[:3], (1, 3, 6), strict=True):
        assert mean == pytest.approx(degrees, abs=4.0 * np.sqrt(2.0 * degrees / len(position)))
    weak = run.field_T.copy()
    weak[:, 2] *= 0.7
    scale = statistics(weak).scale
    strong = np.linalg.norm(weak[:, 2], axis=1) > 1e-7
    assert strong.sum() > 100
    assert (np.argmax(scale, axis=1)[strong] == 2).mean() > 0.9
    assert (scale[strong, 2] > 12.0).mean() > 0.9


def test_tiny_errors_are_no_errors():
    """The two paths, with and without covariances, end in the same poses, statistics and levels."""
    site, rng = built.mixed_cube(2e-7), np.random.default_rng(16)
    run = built.measured(site, built.inside(site, rng, 50), rng)
    tiny = built.declared(site, Survey(1e-9, 1e-9, 1e-9), 1e-9, 1e-9)
    for one, other in zip(
        Locator(site).locate_many(bench.fields_of(site, run)),
        Locator(tiny).locate_many(bench.fields_of(site, run)),
        strict=True,
    ):
        np.testing.assert_allclose(other.position_m, one.position_m, atol=1e-6)
        np.testing.assert_allclose(other.position_cov_m2, one.position_cov_m2, rtol=1e-3, atol=1e-9)
        assert other.residual == pytest.approx(one.residual, rel=1e-4)
    assert errors_of(site.beacons, site.sensor) is None


@pytest.mark.parametrize("spoiled", ["nothing", "a beacon", "an axis", "a component"])
@pytest.mark.parametrize("sensor", [(), (0.01, 0.02)])
def test_the_kernel_and_numpy_agree(monkeypatch, spoiled, sensor):
    site, rng = built.declared(built.mixed_cube(2e-8), built.DECLARED, *sensor), np.random.default_rng(17)
    run = built.measured(site, built.inside(site, rng, 40), rng, built.DECLARED)
    field = run.field_T.copy()
    if spoiled == "a beacon":
        field[:, 3] = np.nan
    elif spoiled == "an axis":
        field[:, :, 1] = np.nan
    elif spoiled == "a component":
        field[:, 5, 2] = np.nan
    model = FieldModel(site.beacons)
    measurements = Measurements(field, run.sigma_T).with_errors(model, errors_of(site.beacons, site.sensor))
    constellation = Constellation(model)

    def everything():
        fit = fit_pose(model, measurements, run.position_m + 0.01, run.rotation)
        at = constellation.at(measurements, run.position_m, run.rotation)
        told = fault_statistics(model, measurements, at)
        covariance = second_order_covariance(model, measurements, run.position_m, run.rotation)
        level, _ = protection_level(measurements, told, covariance[:, :3, :3])
        return fit, at, told, covariance, level

    assert kernel.of(model) is not None
    fit, at, told, covariance, level = everything()
    monkeypatch.setattr(kernel, "_library", lambda: None)
    slow_fit, slow_at, slow, slow_covariance, slow_level = everything()
    np.testing.assert_allclose(fit.position_m, slow_fit.position_m, atol=1e-5)
    np.testing.assert_allclose(fit.cost, slow_fit.cost, rtol=1e-4)
    np.testing.assert_allclose(at.cost, slow_at.cost, rtol=1e-8)
    size = np.sqrt(np.einsum("ekk->ek", slow_at.information))
    both = size[:, :, None] * size[:, None, :]
    np.testing.assert_allclose(at.information / both, slow_at.information / both, atol=1e-8)
    np.testing.assert_array_equal(told.freedom, slow.freedom)
    np.testing.assert_array_equal(told.distortion_freedom, slow.distortion_freedom)
    np.testing.assert_allclose(told.drop, slow.drop, rtol=1e-5, atol=1e-7 * slow.drop.max())
    np.testing.assert_allclose(told.scale, slow.scale, rtol=1e-5, atol=1e-7 * slow.drop.max())
    np.testing.assert_allclose(told.distortion, slow.distortion, rtol=1e-5, atol=1e-7 * slow.drop.max())
    largest = np.sqrt(np.einsum("enkk->en", slow.separation_cov_m2) + 1e-30)[..., None]
    np.testing.assert_allclose(told.separation_m / largest, slow.separation_m / largest, atol=1e-5)
    both = largest[..., None] * largest[..., None]
    np.testing.assert_allclose(told.separation_cov_m2 / both, slow.separation_cov_m2 / both, atol=1e-6)
    scale = np.sqrt(np.einsum("ekk->ek", slow_covariance))
    both = scale[:, :, None] * scale[:, None, :]
    np.testing.assert_allclose(covariance / both, slow_covariance / both, atol=1e-5)
    np.testing.assert_allclose(level, slow_level, rtol=1e-6)


def isotropic(magnitude_T, moment_radius=(1.0, 1e-3), levers=None, **deviations):
    """The standard deviation by errors of one coil of a moment, A m^2, and a radius, m."""
    moment, radius = moment_radius
    coil = bench.loop_beacon(0, (0, 0, 0), turns=1.0, radius=radius, current=moment / (np.pi * radius**2))
    each = {"position_sd_m": 0.0, "axis_sd_rad": 0.0, "current_sd": 0.0}
    each = {name: np.array([deviations.get(name, value)]) for name, value in each.items()}
    sensor = deviations.get("gain_sd", 0.0), deviations.get("sensor_axis_sd_rad", 0.0)
    errors = SiteErrors(*each.values(), *sensor, levers=levers)
    return errors.isotropic(FieldModel([coil]), np.atleast_2d(magnitude_T))


@pytest.mark.parametrize(
    ("name", "share"),
    [
        ("current_sd", 1.0 / np.sqrt(3.0)),  # along the field
        ("gain_sd", 1.0 / np.sqrt(3.0)),  # of all axes, in the mean over directions
        ("axis_sd_rad", 1.0),
        ("sensor_axis_sd_rad", np.sqrt(2.0 / 3.0)),  # across the field
    ],
)
def test_a_search_takes_errors_for_a_share_of_the_magnitude(name, share):
    magnitude = np.array([1e-9, 1e-6])
    found = isotropic(magnitude[:, None], **{name: 0.01})
    np.testing.assert_allclose(found[:, 0], 0.01 * share * magnitude)


def test_a_search_takes_a_shift_for_what_it_does_in_any_direction_nearly():
    """The root mean square of the gradient's components of a dipole, within the third that the direction is worth."""
    rng = np.random.default_rng(21)
    way = rng.normal(size=(200, 3))
    way *= 3.0 / np.linalg.norm(way, axis=1, keepdims=True)
    model = FieldModel([bench.loop_beacon(0, (0, 0, 0), turns=1.0, radius=1e-3, current=1.0 / (np.pi * 1e-6))])
    gradient = np.stack([(model.field(way + s) - model.field(way - s))[:, 0] / 2e-4 for s in np.eye(3) * 1e-4])
    real = 0.01 * np.sqrt((gradient**2).sum(axis=(0, 2)) / 3.0)
    found = isotropic(np.linalg.norm(model.field(way)[:, 0], axis=1)[:, None], position_sd_m=0.01)[:, 0]
    assert (found / real).min() > 0.8
    assert (found / real).max() < 1.25
    assert (found / real).mean() == pytest.approx(1.0, abs=0.04)


def test_a_lever_is_a_shift_along_any_axis_and_errors_add_up_by_squares():
    lever = levers_of(SensorSite(1e-7, lever_m=0.003 * np.sqrt(3.0) * np.eye(3)))
    magnitude = np.array([[1e-9], [1e-8]])
    shifted = isotropic(magnitude, position_sd_m=0.004)
    np.testing.assert_allclose(isotropic(magnitude, levers=lever), 0.75 * shifted)
    np.testing.assert_allclose(isotropic(magnitude, position_sd_m=0.004, levers=lever), 1.25 * shifted)
    parts = ["position_sd_m", "current_sd", "gain_sd", "axis_sd_rad", "sensor_axis_sd_rad"]
    each = [isotropic(magnitude, **{name: 0.01}) for name in parts]
    together = isotropic(magnitude, **dict.fromkeys(parts, 0.01))
    np.testing.assert_allclose(together, np.sqrt(np.square(each).sum(axis=0)))


def test_no_field_is_so_strong_that_its_coil_is_nearer_than_its_reach():
    """And a field of nothing has no error, without a complaint."""
    reach = FieldModel([bench.loop_beacon(0, (0, 0, 0), turns=1.0, radius=0.1, current=1.0)]).reach_m[0]
    moment = np.pi * 0.01
    near = 1.5e-7 * moment / reach**3
    found = isotropic(np.array([[0.5 * near], [near], [8.0 * near], [0.0]]), (moment, 0.1), position_sd_m=0.01)
    np.testing.assert_allclose(found[2] / found[1], 8.0)
    np.testing.assert_allclose(found[0] / found[1], 0.5 ** (4.0 / 3.0))
    assert found[3] == 0.0


@pytest.mark.parametrize(
    "sensor",
    [
        {"gain_sd": 0.01},
        {"axis_sd_rad": 0.01},
        {"lever_m": 0.01 * np.eye(3)},
        {"axes": np.diag([1.0, 2.0, 1.0])},
    ],
    ids=lambda sensor: next(iter(sensor)),
)
def test_each_thing_that_is_said_of_a_sensor_counts_on_an_exact_site(sensor):
    site = built.mixed_cube()
    assert errors_of(site.beacons, site.sensor) is None
    assert errors_of(site.beacons, SensorSite(1e-7, **sensor)) is not None

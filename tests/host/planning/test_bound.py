"""The bound at a point against brute force on magpylib's fields, against the real locator, and its truncation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.locate import Locator
from goldfield.locate.fault_statistics import fault_statistics
from goldfield.locate.fit import Fit, Measurements
from goldfield.locate.site_errors import errors_of
from goldfield.locate.uncertainty import dilution_of_precision
from goldfield.planning import Grid, Request, Settings
from goldfield.planning.information import ORIENTATIONS, gram, joint_covariance
from goldfield.planning.neighbours import ranked
from goldfield.planning.single_beacons import contributions
from goldfield.planning.tile import TileEngine, noise_of
from goldfield.site.model import EXACT, SensorSite
from goldfield.types import Fields
from tests.host.planning.built import SENSOR, beacon, ceiling, cube, site_of, true_components

POINTS = np.array([[1.0, 1.1, 0.9], [0.4, 0.3, 0.5], [1.7, 0.2, 1.5]])


def figures_at(site, points, settings=None):
    """Return the figures of single points, each as a grid of its own."""
    settings = Settings() if settings is None else settings
    found = []
    for point in np.asarray(points):
        request = Request(site, Grid.of_box(point, point, 1.0), settings)
        (tile,) = request.grid.tiles()
        found.append(TileEngine(request).compute(tile).figures)
    return found


def turned_axis(one, vector):
    return replace(one, axis=Rotation.from_rotvec(vector).apply(one.axis))


def slope(of, size, step):
    """Return the derivatives of a function of a vector around zero, by central differences, shape (m, size)."""
    moved = [(of(step * unit) - of(-step * unit)) / (2.0 * step) for unit in np.eye(size)]
    return np.array(moved).T


def brute_force(site, position):
    """Return a function of the rotation that returns the bound's covariance, shape (6, 6).

    Every error is a column of one big covariance, which is inverted; the derivatives are differences of magpylib's
    fields. No code of goldfield is used.
    """

    def surveyed(one, x):
        survey = one.survey
        moved = replace(one, position_m=one.position_m + survey.position_sd_m * x[:3])
        moved = turned_axis(moved, survey.axis_sd_rad * x[3:6])
        moved = replace(moved, current_A=one.current_A * (1.0 + survey.current_sd * x[6]))
        return true_components(replace(site, beacons=(moved,)), position, np.eye(3))

    field = true_components(site, position, np.eye(3)).reshape(-1, 3)
    place = slope(lambda x: true_components(site, position + x, np.eye(3)), 3, 1e-5).reshape(-1, 3, 3)
    errors = [slope(lambda x, one=one: surveyed(one, x), 7, 1e-2) for one in site.beacons]

    def bound(rotation):
        covariance = (site.sensor.noise_T**2 / site.chips) * np.eye(field.size)
        for index, effect in enumerate(errors):
            own = slice(3 * index, 3 * index + 3)
            covariance[own, own] += rotation.T @ effect @ effect.T @ rotation
        deviation = np.full((3, 3), site.sensor.axis_sd_rad)
        np.fill_diagonal(deviation, site.sensor.gain_sd)
        measured = field @ rotation
        sensed = slope(lambda x: (measured @ (deviation * x.reshape(3, 3)).T).ravel(), 9, 1.0)
        covariance += sensed @ sensed.T
        turned = slope(lambda x: (field @ (Rotation.from_rotvec(x).as_matrix() @ rotation)).ravel(), 3, 1e-5)
        jacobian = np.hstack([(rotation.T @ place).reshape(-1, 3), turned])
        return np.linalg.inv(jacobian.T @ np.linalg.inv(covariance) @ jacobian)

    return bound


@pytest.mark.parametrize(
    "site",
    [
        cube(),
        cube(sensor=SensorSite(2e-7)),
        cube(sensor=SensorSite(2e-7, gain_sd=0.01)),
        cube(sensor=SensorSite(2e-7, axis_sd_rad=0.02)),
        site_of([beacon(i, p, a) for i, (p, a) in enumerate(
            [((0, 0, 2.5), (0, 0, 1)), ((2, 0, 2.5), (1, 0, 1)), ((0, 2, 2.5), (0, 1, 1)), ((2, 2, 2.0), (1, 1, 0))]
        )]),
    ],
    ids=["declared errors", "exact sensor", "gains alone", "axes alone", "four tilted coils"],
)  # fmt: skip
def test_bound_is_that_of_brute_force(site):
    for point, figures in zip(POINTS, figures_at(site, POINTS), strict=True):
        bound = brute_force(site, point)
        truth = np.array([np.diag(bound(rotation)) for rotation in ORIENTATIONS])
        position, attitude = truth[:, :3].sum(axis=1), truth[:, 3:].sum(axis=1)
        assert figures.position_sd_m.item() == pytest.approx(np.sqrt(position.mean()), rel=1e-5)
        assert figures.attitude_sd_rad.item() == pytest.approx(np.sqrt(attitude.mean()), rel=1e-5)
        assert figures.orientation_spread.item() == pytest.approx(np.sqrt(position.max() / position.mean()), abs=1e-5)


def test_orientation_does_not_matter_to_an_isotropic_sensor():
    """Gains and axes that are alike make no direction special; neither does noise alone."""
    for sensor, spread in ((SensorSite(2e-7, 0.004, 0.004), 0.0), (SensorSite(2e-7), 0.0), (SENSOR, 1e-3)):
        figures = figures_at(cube(sensor=sensor), POINTS)
        found = max(one.orientation_spread.item() - 1.0 for one in figures)
        assert found < 1e-9 if spread == 0.0 else found > spread


def test_dilution_is_that_of_the_locator():
    site = cube()
    found = [figures.dilution_m_T.item() for figures in figures_at(site, POINTS)]
    assert found == pytest.approx(dilution_of_precision(site, POINTS), rel=1e-8)


def test_best_set_alone_is_a_plan_of_these_beacons():
    site = ceiling(5, 5)
    point = np.array([[5.0, 6.5, 1.0]])
    (figures,) = figures_at(site, point, Settings(best=5))
    some = replace(site, beacons=tuple(site.beacons[i] for i in figures.best[0]))
    (alone,) = figures_at(some, point)
    assert figures.best_position_sd_m.item() == pytest.approx(alone.position_sd_m.item(), rel=1e-9)
    others = [i for i in range(25) if i not in figures.best[0]][:5]
    (without,) = figures_at(replace(site, beacons=tuple(site.beacons[i] for i in others)), point)
    assert without.position_sd_m.item() > figures.best_position_sd_m.item()


def epochs_of(site, point, rng, count):
    """Return epochs of sensors of random attitude on sites that are off as declared, and their true rotations."""
    noise, epochs, rotations = noise_of(site), [], Rotation.random(count, rng=rng).as_matrix()
    for epoch, rotation in enumerate(rotations):
        off = []
        for one in site.beacons:
            survey = one.survey
            moved = replace(one, position_m=one.position_m + survey.position_sd_m * rng.normal(size=3))
            moved = turned_axis(moved, survey.axis_sd_rad * rng.normal(size=3))
            off.append(replace(moved, current_A=one.current_A * (1.0 + survey.current_sd * rng.normal())))
        deviation = np.full((3, 3), site.sensor.axis_sd_rad)
        np.fill_diagonal(deviation, site.sensor.gain_sd)
        axes = np.eye(3) + deviation * rng.normal(size=(3, 3))
        field = true_components(replace(site, beacons=tuple(off)), point, rotation).reshape(-1, 3) @ axes.T
        field = field + noise[:, None] * rng.normal(size=field.shape)
        epochs.append(Fields(epoch, 0.1 * epoch, tuple(one.id for one in site.beacons), field, noise))
    return epochs, rotations


@pytest.mark.parametrize(("site", "points"), [(cube(), POINTS), (ceiling(4, 4), [[3.4, 4.1, 1.2], [5.0, 2.0, 0.5]])])
def test_locator_reaches_the_bound_and_its_protection_level_is_the_planned_one(site, points):
    rng, count = np.random.default_rng(11), 150
    for point, figures in zip(points, figures_at(site, np.array(points)), strict=True):
        epochs, rotations = epochs_of(site, point, rng, count)
        poses = Locator(site).locate_many(epochs)
        square = np.mean([np.sum((pose.position_m - point) ** 2) for pose in poses])
        turns = [
            Rotation.from_quat(pose.orientation_xyzw) * Rotation.from_matrix(rotation).inv()
            for pose, rotation in zip(poses, rotations, strict=True)
        ]
        turn = np.mean([one.magnitude() ** 2 for one in turns])
        # The square of an error of three components has a relative deviation of at most sqrt(2): 12 % in the mean.
        assert np.sqrt(square) / figures.position_sd_m.item() == pytest.approx(1.0, abs=0.15)
        assert np.sqrt(turn) / figures.attitude_sd_rad.item() == pytest.approx(1.0, abs=0.15)
        levels = np.median([pose.protection_m for pose in poses])
        assert levels / figures.protection_m.item() == pytest.approx(1.0, abs=0.15)


def test_what_a_fault_could_hide_is_that_of_the_locator():
    site = cube()
    sigma = noise_of(site)
    request = Request(site, Grid.of_box(POINTS[0], POINTS[0], 1.0))
    engine = TileEngine(request)
    near = engine.near(ranked(engine.model, sigma, POINTS[0], POINTS[0]), 8)
    _, column, _ = near.columns(POINTS)
    joint = joint_covariance(gram(column), near.distortion)
    influence, _ = contributions(column, joint.covariance)
    gap = np.linalg.inv(np.eye(3) - influence @ column.swapaxes(2, 3))
    place = influence[..., :3]
    separation = place.swapaxes(2, 3) @ gap @ place

    unit = np.tile(np.eye(3), (len(POINTS), 1, 1))
    field = near.model.field(POINTS)
    measured = Measurements(field, np.tile(sigma, (len(POINTS), 1)))
    measured = measured.with_errors(near.model, errors_of(near.model.beacons, site.sensor))
    information = np.linalg.inv(joint.covariance[:, :6, :6])
    fit = Fit(POINTS, unit, np.zeros(len(POINTS)), information, np.ones(len(POINTS), dtype=bool))
    truth = fault_statistics(near.model, measured, fit).separation_cov_m2
    assert separation == pytest.approx(truth, rel=1e-6, abs=1e-9 * truth.max())


def test_a_fault_that_cannot_show_leaves_no_protection():
    """Six components of two beacons fix a pose with nothing left over; nine of three leave three."""
    tilted = [((0, 0, 0), (0, 0, 1)), ((2, 0, 0), (1, 2, 0)), ((0, 2, 0), (0, 1, 3))]
    beacons = [beacon(i, place, axis) for i, (place, axis) in enumerate(tilted)]
    (two,), (three,) = (figures_at(site_of(beacons[:count]), POINTS[:1]) for count in (2, 3))
    assert two.position_sd_m.item() < 1.0
    assert two.protection_m.item() == np.inf
    assert three.position_sd_m.item() < three.protection_m.item() < 10.0


@pytest.mark.parametrize("tolerance", [0.1, 0.01, 0.001])
def test_far_beacons_are_missed_by_no_more_than_is_said(tolerance):
    site = ceiling(20, 20)
    points = np.array([[30.3, 27.1, 1.0], [1.0, 2.0, 0.5], [28.0, 0.0, 2.5]])
    for some, whole in zip(
        figures_at(site, points, Settings(truncation=tolerance)),
        figures_at(site, points, Settings(truncation=0.0)),
        strict=True,
    ):
        assert 0.0 < some.truncation.item() <= tolerance
        assert whole.truncation.item() == 0.0
        for key in ("position_sd_m", "attitude_sd_rad"):
            ratio = getattr(some, key).item() / getattr(whole, key).item()
            assert 1.0 - 1e-9 <= ratio <= 1.0 + some.truncation.item()


def test_beacons_out_of_hearing_leave_a_pose_weak_and_a_place_in_a_wire_without_a_bound():
    figures = figures_at(cube(), [[40.0, 3.0, 1.0], [0.149, 0.0, 0.0], [1.0, 1.0, 1.0]])
    assert [one.weak.item() for one in figures] == [True, True, False]
    assert [np.isfinite(one.position_sd_m).item() for one in figures] == [True, False, True]


@pytest.mark.parametrize("limit", ["position", "attitude"])
def test_weak_begins_at_the_locators_limits(limit):
    """With noise alone the deviations grow as it does: the noise that just reaches a limit is known from the bound."""
    site = cube(sensor=SensorSite(2e-7))
    site = replace(site, beacons=tuple(replace(one, survey=EXACT) for one in site.beacons))
    point = np.array([1.0, 1.1, 0.9]) if limit == "position" else np.array([4.2, 1.0, 0.9])
    truth = brute_force(site, point)(np.eye(3))
    nearest = min(np.linalg.norm(point - one.position_m) for one in site.beacons)
    reach = {
        "position": 0.25 * nearest / np.sqrt(np.linalg.eigvalsh(truth[:3, :3])[2]),
        "attitude": 0.5 / np.sqrt(np.linalg.eigvalsh(truth[3:, 3:])[2]),
    }
    factor = min(reach.values())
    for more, weak in ((0.999, False), (1.001, True)):
        louder = replace(site, sensor=SensorSite(2e-7 * factor * more))
        (figures,) = figures_at(louder, [point])
        assert figures.weak.item() is weak

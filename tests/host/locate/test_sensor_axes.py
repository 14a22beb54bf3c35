"""Sensors whose axes have gains of their own, lean or are left-handed, and have noise of their own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.errors import UserError
from goldfield.locate import Locator, kernel
from goldfield.locate.own_body import locate_beside
from goldfield.locate.sensor_axes import axes_of
from goldfield.locate.uncertainty import cramer_rao_bound
from goldfield.sensor.options import Method, Options
from goldfield.site import SensorSite, load
from goldfield.track import CycleData, CycleLocator, EpochObserver, Tracker
from goldfield.types import Fields
from tests.bench import locate_trials as bench
from tests.bench.motion_trials import Room, flight_poses, random_flight
from tests.host.locate import built_sites as built
from tests.host.site.test_reading import GOOD

LEFT = np.array([[1.02, 0.03, -0.01], [0.0, -0.95, 0.04], [0.02, 0.0, 1.1]])
ODD = np.array([[1.0, 0.0, 0.0], [0.6, -0.8, 0.0], [0.1, 0.0, 0.2]])
"""The second axis leans by 37 degrees and is reversed; the third has a fifth of the others' gain."""


def with_sensor(site, axes=None, noise_ratio=None, **errors):
    ratio = None if noise_ratio is None else np.array(noise_ratio)
    return replace(site, sensor=SensorSite(site.sensor.noise_T, axes=axes, noise_ratio=ratio, **errors))


def read(site, run, rng, axes, noise_ratio=(1.0, 1.0, 1.0)):
    """What the axes read, as epochs; the run's own noise is none."""
    names = tuple(beacon.id for beacon in site.beacons)
    sigma = site.sensor.noise_T / np.sqrt(bench.CHIPS)
    readings = np.full(run.field_T.shape, np.nan)
    count = len(axes)
    noise = sigma * np.array(noise_ratio)[:count] * rng.normal(size=run.field_T[..., :count].shape)
    readings[..., :count] = run.field_T @ axes.T + noise
    return [Fields(e, 0.1 * e, names, field, np.full(len(names), sigma)) for e, field in enumerate(readings)]


def quiet(site, rng, count):
    return bench.trials(site, built.inside(site, rng, count), rng, sigma_T=0.0)


def errors_over_covariance(poses, run):
    position = np.array([pose.position_m for pose in poses]) - run.position_m
    turn = bench.turn_error(run.rotation, Rotation.from_quat([p.orientation_xyzw for p in poses]).as_matrix())
    return (
        bench.normalised_error(position, np.array([pose.position_cov_m2 for pose in poses])).mean(),
        bench.normalised_error(turn, np.array([pose.attitude_cov_rad2 for pose in poses])).mean(),
    )


@pytest.mark.parametrize("library", [True, False])
@pytest.mark.parametrize(
    ("axes", "noise_ratio"),
    [(LEFT, None), (ODD, None), (np.eye(3), (0.3, 0.3, 1.68)), (ODD, (0.5, 0.5, 1.58))],
)
def test_poses_are_sound_and_as_uncertain_as_they_say(monkeypatch, library, axes, noise_ratio):
    if not library:
        monkeypatch.setattr(kernel, "_library", lambda: None)
    rng = np.random.default_rng(1)
    site = built.mixed_cube(2e-8)
    run = quiet(site, rng, 120 if library else 40)
    told = with_sensor(site, axes, noise_ratio)
    poses = Locator(told).locate_many(read(site, run, rng, axes, noise_ratio or (1.0, 1.0, 1.0)))
    assert np.mean([pose.status == "ok" for pose in poses]) >= 0.97
    for mean in errors_over_covariance(poses, run):
        assert 0.75 < mean < 1.3
    residual = np.mean([pose.residual**2 for pose in poses])
    assert 0.9 < residual < 1.1


def test_without_the_matrix_the_same_fields_are_inconsistent():
    rng = np.random.default_rng(2)
    site = built.mixed_cube(2e-8)
    poses = Locator(site).locate_many(read(site, quiet(site, rng, 20), rng, LEFT))
    assert all(pose.status != "ok" for pose in poses)


def test_a_sensor_with_square_axes_and_gains_of_one_is_the_same_as_one_without_a_matrix():
    rng = np.random.default_rng(3)
    site = built.mixed_cube()
    epochs = read(site, quiet(site, rng, 10), rng, np.eye(3))
    for mine, plain in zip(
        Locator(with_sensor(site, np.eye(3))).locate_many(epochs), Locator(site).locate_many(epochs), strict=True
    ):
        np.testing.assert_allclose(mine.position_m, plain.position_m, atol=1e-6)
        np.testing.assert_allclose(mine.position_cov_m2, plain.position_cov_m2, rtol=1e-3, atol=1e-12)


def test_the_bound_is_that_of_the_noise_that_is_left():
    """The information of readings y = A B + noise is J' A' A J, formed here without any undoing."""
    site = built.mixed_cube()
    position, step = np.array([[0.9, 1.1, 0.8]]), 1e-6
    sigma = site.sensor.noise_T / np.sqrt(site.chips)
    weights = np.array([1.0, 0.5, 2.0])

    def readings(unknowns):
        field = bench.magpylib_fields(site, position + unknowns[:3])[0]
        return (Rotation.from_rotvec(unknowns[3:]).inv().apply(field) @ ODD.T / weights / sigma).ravel()

    slopes = np.array([(readings(step * unit) - readings(-step * unit)) / (2 * step) for unit in np.eye(6)])
    mean_square = np.sqrt(np.mean(weights**2))
    told = with_sensor(site, ODD, weights / mean_square)
    told = replace(told, sensor=replace(told.sensor, noise_T=site.sensor.noise_T * mean_square))
    np.testing.assert_allclose(cramer_rao_bound(told, position)[0], np.linalg.inv(slopes @ slopes.T), rtol=1e-4)


@pytest.mark.parametrize("axes", [np.array([[2.0, 0.0, 0.0]]), np.array([[1.1, 0.0, 0.0], [0.3, -0.9, 0.0]])])
def test_sensors_with_fewer_axes(axes):
    rng = np.random.default_rng(4)
    site = bench.spiral_board(noise_T=1e-9)
    rng_positions = rng.uniform([0.0, 0.0, 0.05], [0.24, 0.08, 0.15], size=(12, 3))
    run = bench.trials(site, rng_positions, rng, sigma_T=0.0)
    poses = Locator(with_sensor(site, axes)).locate_many(read(site, run, rng, axes))
    found = np.array([pose.position_m for pose in poses])
    assert np.median(np.linalg.norm(found - run.position_m, axis=1)) < 1e-3
    along = Rotation.from_quat([pose.orientation_xyzw for pose in poses]).apply([1.0, 0.0, 0.0])
    assert np.median(np.linalg.norm(along - run.rotation[:, :, 0], axis=1)) < 0.02


def test_a_missing_reading_costs_its_component_or_with_leaning_axes_the_field():
    readings = np.array([[1.0, 2.0, np.nan], [1.0, 2.0, 3.0]])
    square = axes_of(SensorSite(1e-7, axes=np.diag([2.0, -1.0, 1.0])))
    np.testing.assert_array_equal(square.components(readings), [[0.5, -2.0, np.nan], [0.5, -2.0, 3.0]])
    leaning = axes_of(SensorSite(1e-7, axes=LEFT)).components(readings)
    assert np.isnan(leaning[0]).all()
    np.testing.assert_allclose(LEFT @ leaning[1], readings[1])


def test_a_track_undoes_the_matrix():
    rng = np.random.default_rng(5)
    site = built.mixed_cube(2e-7)
    position = np.repeat([[0.9, 1.2, 0.7]], 12, axis=0)
    run = bench.trials(site, position, rng, sigma_T=0.0)
    run = replace(run, rotation=run.rotation[:1].repeat(12, axis=0), field_T=run.field_T[:1].repeat(12, axis=0))
    told = with_sensor(site, LEFT)
    tracker = Tracker(told, EpochObserver(told))
    poses = [tracker.step(fields).pose for fields in read(site, run, rng, LEFT)]
    assert {pose.status.value for pose in poses} == {"ok"}
    last = slice(-1, None)
    for normalised in errors_over_covariance(poses[last], bench.Trials(position[last], run.rotation[last], None, None)):
        assert normalised < 5.0


@pytest.mark.parametrize("axes", [None, LEFT])
def test_all_samples_of_a_cycle_give_the_same_pose_by_any_axes(axes):
    site, rng = bench.prigge_cube(2e-7), np.random.default_rng(7)
    names = tuple(beacon.id for beacon in site.beacons)
    room, locator = Room(site), CycleLocator(with_sensor(site, axes))
    normalised = []
    for epoch in range(12):
        flight = random_flight(site, rng, 1.0, 1.0)
        samples = room.samples(flight, 0.0, 0.0, rng) @ (np.eye(3) if axes is None else axes).T
        samples += 2e-7 * rng.normal(size=samples.shape)
        moving = locator.locate(CycleData(epoch, 0.0, names, samples))
        assert moving.pose.status == "ok"
        error = moving.pose.position_m - flight_poses(flight, 0.0)[0]
        normalised.append(error @ np.linalg.solve(moving.pose.position_cov_m2, error) / 3)
    assert 0.4 < np.mean(normalised) < 1.8


class Body:
    """A body whose field is a fixed small part of the beacons', in the sensor's frame."""

    def __init__(self, site):
        self._site = site

    def secondary(self, position_m, rotation):
        return 0.05 * bench.magpylib_fields(self._site, position_m[None])[0] @ rotation[:, [1, 0, 2]]


def test_what_the_own_body_adds_is_read_by_the_same_axes():
    rng = np.random.default_rng(6)
    site = built.mixed_cube(2e-9)
    run = quiet(site, rng, 1)
    body = Body(site)
    run.field_T[0] += body.secondary(run.position_m[0], run.rotation[0])
    (fields,) = read(site, run, rng, LEFT)
    pose = locate_beside(Locator(with_sensor(site, LEFT)), body, fields)
    assert np.linalg.norm(pose.position_m - run.position_m[0]) < 1e-3


@pytest.mark.parametrize("lines", ["axes = [[1, 0, 0], [0, -1, 0], [0, 0, 1]]", "noise_T = [1e-7, 1e-7, 2e-7]"])
def test_a_board_does_not_know_the_axes(tmp_path, lines):
    path = tmp_path / "site.toml"
    path.write_text(GOOD.replace("noise_T = 2.0e-7", lines if "noise_T" in lines else f"noise_T = 2e-7\n{lines}"))
    Options().check(load(path))
    with pytest.raises(UserError, match="takes what its axes read for the field"):
        Options(method=Method.ON_SENSOR).check(load(path))

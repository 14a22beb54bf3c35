"""Sensors whose axes read at different points: readings by magpylib at each, poses by the fit that knows of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.locate import Locator, kernel
from goldfield.locate.fit import Measurements, sensor_jacobian
from goldfield.locate.rotations import turned
from goldfield.locate.sensor_axes import levers_of
from goldfield.locate.site_errors import errors_of
from goldfield.locate.uncertainty import cramer_rao_bound, second_order_covariance
from goldfield.sensor.location import location
from goldfield.sensor.options import Method
from goldfield.site import SensorSite, load
from goldfield.track import CycleLocator, Tracker
from goldfield.types import Fields
from tests.bench import locate_trials as bench
from tests.host.locate import built_sites as built
from tests.host.site.test_reading import GOOD

LEVERS = 1e-3 * np.array([[12.0, -3.0, 5.0], [-4.0, 15.0, 2.0], [6.0, 2.0, -14.0]])
AXES = np.array([[1.02, 0.05, 0.0], [0.1, -0.95, 0.04], [0.0, 0.0, 1.1]])


def with_levers(site, lever_m=LEVERS, axes=None):
    return replace(site, sensor=SensorSite(site.sensor.noise_T, axes=axes, lever_m=lever_m))


def read(site, position, rotation, lever_m=LEVERS, axes=None):
    """What each axis reads of each beacon at its own place, shape (e, n, 3)."""
    rows = np.eye(3) if axes is None else axes
    return np.stack(
        [
            np.einsum("eck,enc->enk", rotation, bench.magpylib_fields(site, position + rotation @ lever)) @ row
            for lever, row in zip(lever_m, rows, strict=True)
        ],
        axis=2,
    )


def epochs_of(site, position, rotation, rng, **sensor):
    names = tuple(beacon.id for beacon in site.beacons)
    sigma = site.sensor.noise_T / np.sqrt(bench.CHIPS)
    readings = read(site, position, rotation, **sensor)
    readings = readings + sigma * rng.normal(size=readings.shape)
    return [Fields(e, 0.1 * e, names, field, np.full(len(names), sigma)) for e, field in enumerate(readings)]


def poses_at(rng, site, count):
    return built.inside(site, rng, count), Rotation.random(count, rng=rng).as_matrix()


@pytest.mark.parametrize("axes", [None, AXES])
def test_jacobian_and_fields_of_a_sensor_with_levers(axes):
    rng, site = np.random.default_rng(1), built.mixed_cube()
    position, rotation = poses_at(rng, site, 4)
    levers, model = levers_of(SensorSite(1e-7, axes=axes, lever_m=LEVERS)), FieldModel(site.beacons)
    jacobian, field = sensor_jacobian(model, position, rotation, levers)
    undo = np.eye(3) if axes is None else np.linalg.inv(axes)
    truth = read(site, position, rotation, axes=axes) @ undo.T
    np.testing.assert_allclose(field.swapaxes(1, 2), truth, rtol=1e-7, atol=1e-13)
    for k in range(6):
        step = np.zeros((4, 6))
        step[:, k] = 1e-6
        ahead, behind = (
            sensor_jacobian(model, position + s[:, :3], turned(rotation, s[:, 3:]), levers)[1] for s in (step, -step)
        )
        slope = (ahead - behind) / 2e-6
        np.testing.assert_allclose(jacobian[:, k], slope, rtol=1e-5, atol=1e-6 * np.abs(slope).max())


def test_the_covariance_is_that_of_what_is_read_at_the_levers():
    """Where the noise is small: the inverse information by differences of magpylib's fields, read at each place."""
    rng, site = np.random.default_rng(5), with_levers(built.mixed_cube())
    position, rotation = poses_at(rng, site, 3)
    model, sigma = FieldModel(site.beacons), 1e-12
    measurements = Measurements(read(site, position, rotation), np.full((3, 8), sigma))
    measurements = measurements.with_errors(model, errors_of(site.beacons, site.sensor))
    found = second_order_covariance(model, measurements, position, rotation)
    slope = []
    for step in np.eye(6) * 1e-5:
        ends = [read(site, position + s[:3], turned(rotation, np.tile(s[3:], (3, 1)))) for s in (step, -step)]
        slope.append((ends[0] - ends[1]).reshape(3, -1) / 2e-5 / sigma)
    slope = np.stack(slope, axis=1)
    expected = np.linalg.inv(slope @ slope.swapaxes(1, 2))
    size = np.sqrt(np.einsum("ekk->ek", expected))
    both = size[:, :, None] * size[:, None, :]
    np.testing.assert_allclose(found / both, expected / both, atol=1e-4)


@pytest.mark.parametrize("library", [True, False])
@pytest.mark.parametrize("axes", [None, AXES])
def test_poses_are_sound_and_as_uncertain_as_they_say(monkeypatch, library, axes):
    if not library:
        monkeypatch.setattr(kernel, "_library", lambda: None)
    rng, site = np.random.default_rng(2), built.mixed_cube(2e-8)
    position, rotation = poses_at(rng, site, 80 if library else 20)
    poses = Locator(with_levers(site, axes=axes)).locate_many(epochs_of(site, position, rotation, rng, axes=axes))
    assert np.mean([pose.status == "ok" for pose in poses]) >= 0.95
    error = np.array([pose.position_m for pose in poses]) - position
    turn = bench.turn_error(rotation, Rotation.from_quat([pose.orientation_xyzw for pose in poses]).as_matrix())
    low, high = (0.75, 1.3) if library else (0.5, 1.6)
    assert low < bench.normalised_error(error, np.array([p.position_cov_m2 for p in poses])).mean() < high
    assert low < bench.normalised_error(turn, np.array([p.attitude_cov_rad2 for p in poses])).mean() < high
    assert np.mean([pose.residual**2 for pose in poses]) == pytest.approx(1.0, abs=0.15)


def test_without_the_levers_the_same_fields_do_not_fit():
    rng, site = np.random.default_rng(3), built.mixed_cube(2e-8)
    poses = Locator(site).locate_many(epochs_of(site, *poses_at(rng, site, 20), rng))
    assert np.mean([pose.status == "ok" for pose in poses]) < 0.1


def test_coils_given_by_their_wire():
    rng, site = np.random.default_rng(4), bench.spiral_board(noise_T=1e-9)
    position = rng.uniform([0.0, 0.0, 0.06], [0.24, 0.08, 0.15], size=(10, 3))
    rotation = Rotation.random(10, rng=rng).as_matrix()
    small = 0.2 * LEVERS
    poses = Locator(with_levers(site, small)).locate_many(epochs_of(site, position, rotation, rng, lever_m=small))
    assert np.median([np.linalg.norm(pose.position_m - p) for pose, p in zip(poses, position, strict=True)]) < 1e-4


def test_a_common_lever_is_a_shifted_reference_point():
    rng, site = np.random.default_rng(5), built.mixed_cube(2e-8)
    position, rotation = poses_at(rng, site, 10)
    common = np.tile([0.02, -0.01, 0.015], (3, 1))
    told = with_levers(site, common)
    assert len(levers_of(told.sensor).lever_m) == 1
    epochs = epochs_of(site, position, rotation, rng, lever_m=common)
    moved = [pose.position_m for pose in Locator(site).locate_many(epochs)] - rotation @ common[0]
    found = [pose.position_m for pose in Locator(told).locate_many(epochs)]
    np.testing.assert_allclose(found, moved, atol=2e-4)


def test_the_bound_knows_of_the_levers():
    site, step = built.mixed_cube(), 1e-6
    position, rotation = np.array([[0.9, 1.1, 0.8]]), Rotation.from_rotvec([[0.4, 0.1, -0.3]]).as_matrix()
    sigma = site.sensor.noise_T / np.sqrt(site.chips)

    def readings(u):
        turn = Rotation.from_rotvec(u[3:]).as_matrix() @ rotation
        return read(site, position + u[:3], turn, lever_m=5 * LEVERS).ravel() / sigma

    slopes = np.array([(readings(step * unit) - readings(-step * unit)) / (2 * step) for unit in np.eye(6)])
    found = cramer_rao_bound(with_levers(site, 5 * LEVERS), position, rotation)[0]
    np.testing.assert_allclose(found, np.linalg.inv(slopes @ slopes.T), rtol=1e-4, atol=1e-14)


def test_every_command_s_poses_know_them_and_tracks_refuse_them():
    rng, site = np.random.default_rng(6), built.mixed_cube(2e-8)
    position, rotation = (part.repeat(4, axis=0) for part in poses_at(rng, site, 1))
    told = with_levers(site)
    locate = location(told, Method.EACH)
    for fields in epochs_of(site, position, rotation, rng):
        pose = locate(fields, None)
        assert (pose.status, pose.findings) == ("ok", ())
    for make in (Tracker, CycleLocator):
        with pytest.raises(UserError, match="takes all axes of the sensor to be at one point"):
            make(told)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("lever_m = [[0, 0, 0.01]]", "lever_m has 1 row; the sensor has 3 axes"),
        ("lever_m = [[0, 0, 0.3], [0, 0, 0], [0, 0, 0]]", "lever_m has one of 0.3 m; levers are below 0.3 m"),
    ],
)
def test_levers_have_limits(tmp_path, lines, words):
    path = tmp_path / "site.toml"
    path.write_text(GOOD.replace("noise_T = 2.0e-7", f"noise_T = 2e-7\n{lines}"))
    with pytest.raises(UserError) as caught:
        load(path)
    assert words in str(caught.value)


def test_levers_of_zero_are_none(tmp_path):
    path = tmp_path / "site.toml"
    path.write_text(GOOD.replace("noise_T = 2.0e-7", "noise_T = 2e-7\nlever_m = [[0, 0, 0], [0, 0, 0], [0, 0, 0]]"))
    assert load(path).sensor.lever_m is None

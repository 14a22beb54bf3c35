"""The weights of a fit against the inverse factors of covariances from differences of magpylib's fields."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.site.model import Survey
from tests.firmware.core.pose.explaining import SIGMA_T, Explaining, Place
from tests.firmware.core.pose.fault_truth import Truth, derivatives

SURVEYS = [(0.0, 0.0, 0.0), (2e-3, 0.0, 0.0), (0.0, 5e-3, 0.0), (0.0, 0.0, 4e-3)]
SURVEYS += [(1e-3, 4e-3, 0.0), (2e-3, 0.0, 3e-3), (0.0, 3e-3, 4e-3), (1e-3, 3e-3, 3e-3)]


@pytest.fixture(scope="module")
def declared(mixed_cube):
    """Each beacon has another combination of errors."""
    rows = [dataclasses.replace(b, survey=Survey(*s)) for b, s in zip(mixed_cube.beacons, SURVEYS, strict=True)]
    sensor = dataclasses.replace(mixed_cube.sensor, gain_sd=0.004, axis_sd_rad=0.006)
    site = dataclasses.replace(mixed_cube, beacons=tuple(rows), sensor=sensor)
    return Place(site, [0.8, 1.3, 0.7], Rotation.from_rotvec([0.4, -0.9, 1.7]))


class Weights(Explaining):
    """A board whose last beacon is not heard, with the truth around its pose."""

    def __init__(self, core, place, count=8):
        super().__init__(core, place)
        self.problem.count = count
        for heard in list(self.problem.heard)[:8]:
            heard.whitening = [7.0] * 6
        self.position = (place.position - np.array(list(self.problem.origin_m))).tolist()
        sigma = np.full(8, SIGMA_T)
        self.truth = Truth.around(place.site, place.fields, sigma, place.position, place.rotation)

    def whitening(self, i):
        """The triangle of a beacon, 1/T."""
        w = self.problem.heard[i].whitening
        return 1e6 * np.array([[w[0], 0.0, 0.0], [w[1], w[2], 0.0], [w[3], w[4], w[5]]])


def test_weights_around_a_pose(core, declared):
    board = Weights(core, declared, 7)
    board.lib.pose_weights_at(board.problem, board.position)
    for i in range(7):
        true = board.truth.whitening[i]
        assert board.whitening(i) == pytest.approx(true, abs=2e-4 * np.abs(true).max())
    assert list(board.problem.heard[7].whitening) == [7.0] * 6


def test_rounding_is_part_of_the_noise(core, declared):
    """A millionth of the field, with as much noise and without."""
    board = Weights(core, declared)
    size_uT = 1e6 * np.linalg.norm(declared.fields[0])
    board.problem.heard[0].position_sd_m = board.problem.heard[0].axis_sd_rad = board.problem.heard[0].current_sd = 0.0
    for noise in (1.0, 1e-3):
        board.problem.heard[0].sigma_uT = noise * 1e-6 * size_uT
        for exact in (True, False):
            if exact:
                board.lib.pose_weights_at(board.problem, board.position)
            else:
                board.lib.pose_weights_rough(board.problem, 0.0)
            found = board.problem.heard[0].whitening[0]
            sensor2 = 0.0 if exact else (0.004**2 + 2.0 * 0.006**2) / 3.0
            assert found == pytest.approx(((1.0 + noise**2) * 1e-12 + sensor2) ** -0.5 / size_uT, rel=1e-4)


def test_a_covariance_of_nearly_one_direction_is_bounded_by_the_noise(core, declared):
    """A current that nobody knows, of a field a million times the noise: the rest is rounding, never more exact."""
    board = Weights(core, declared)
    rng = np.random.default_rng(2)
    for _ in range(30):
        heard, way = board.problem.heard[0], rng.normal(size=3)
        heard.loop.axis = (way / np.linalg.norm(way)).tolist()
        heard.position_sd_m, heard.axis_sd_rad, heard.current_sd, heard.magnitude_uT = 0.0, 0.0, 100.0, 1e-9
        heard.sigma_uT = 1e-5
        board.lib.pose_weights_at(board.problem, board.position)
        w = 1e-6 * board.whitening(0)
        assert np.isfinite(w).all()
        assert (np.diag(w) > 0.0).all()
        assert (np.diag(w) < 1.0001e5).all()


def test_what_the_sensors_errors_do(core, declared):
    board = Weights(core, declared)
    board.lib.pose_weights_at(board.problem, board.position)
    attitude = board.ffi.new("float[3][3]", declared.rotation.as_matrix().tolist())
    for i in range(8):
        effects = board.ffi.new("float[4][6]")
        effects[3][0] = 7.0
        heard = board.ffi.addressof(board.problem.heard[i])
        board.lib.pose_weights_sensor(board.problem, heard, attitude, effects)
        true = board.truth.sensor[3 * i : 3 * i + 3]
        found = np.array([list(row) for row in effects])
        assert found[:3] == pytest.approx(true, abs=5e-4 * np.abs(true).max())
        assert list(found[3]) == [7.0] + [0.0] * 5


def mean_error2(beacon, magnitude_T, rng):
    """The mean over directions of the trace of the declared covariance over the square of the field, a third of it."""
    shares = []
    for way in rng.normal(size=(100, 3)):
        way /= np.linalg.norm(way)
        cosine = way @ beacon.axis
        k = 1e-7 * np.linalg.norm(beacon.moment_A_m2)
        distance = (k * np.sqrt(1.0 + 3.0 * cosine**2) / magnitude_T) ** (1 / 3)
        here, gradient, leaning = derivatives(beacon, beacon.position_m + distance * way)
        survey = beacon.survey
        errors = survey.position_sd_m * gradient, survey.axis_sd_rad * leaning, survey.current_sd * here
        shares.append(sum(np.sum(e**2) for e in errors) / np.sum(here**2) / 3.0)
    return np.mean(shares)


@pytest.mark.parametrize("survey", [(0.02, 0.0, 0.0), (0.0, 0.03, 0.0), (0.0, 0.0, 0.03), (0.02, 0.03, 0.03)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rough_weights_are_those_of_a_mean_direction(core, place, survey, sign):
    """Within a sixth; the mean is over all directions in which the field is as strong."""
    beacon = dataclasses.replace(place.site.beacons[1], survey=Survey(*survey))
    here = Place(dataclasses.replace(place.site, beacons=(beacon,)), place.position, place.rotation)
    board = Weights(core, Place(place.site, place.position, place.rotation))
    heard = board.problem.heard[1]
    heard.position_sd_m, heard.axis_sd_rad, heard.current_sd = survey
    heard.loop.k_uT_m3 *= sign
    board.lib.pose_weights_rough(board.problem, 0.0)
    magnitude = np.linalg.norm(here.fields[0])
    w = board.whitening(1)
    assert np.array_equal(w, w[0, 0] * np.eye(3))
    share2 = (1.0 / w[0, 0] ** 2 - SIGMA_T**2) / magnitude**2
    assert np.sqrt(share2) == pytest.approx(
        np.sqrt(mean_error2(beacon, magnitude, np.random.default_rng(5))), rel=1 / 6
    )


@pytest.mark.parametrize("sensor", [(0.02, 0.0), (0.0, 0.03), (0.02, 0.03)])
def test_rough_weights_of_noise_the_model_and_the_sensor(core, place, sensor):
    """A third of what three gains and three axes that lean, each in its own way, do to a field of any direction."""
    board, rng = Weights(core, place, 7), np.random.default_rng(6)
    board.problem.gain_sd, board.problem.axis_sd_rad = sensor
    off = rng.normal(size=(4000, 3, 3)) * np.where(np.eye(3, dtype=bool), *sensor)
    ways = rng.normal(size=(4000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    error2 = np.mean(np.einsum("nij,nj->ni", off, ways) ** 2)
    for model in (0.0, 0.03):
        for i, noise in enumerate((1e3, 1.0, 2.0, 1e5, 1.0, 1e4, 1.0)):
            board.problem.heard[i].sigma_uT = noise * 1e6 * SIGMA_T
        board.lib.pose_weights_rough(board.problem, model)
        for i, noise in enumerate((1e3, 1.0, 2.0, 1e5, 1.0, 1e4, 1.0)):
            var2 = (noise * SIGMA_T) ** 2 + (model**2 + error2) * np.sum(place.fields[i] ** 2)
            assert board.whitening(i)[0, 0] == pytest.approx(var2**-0.5, rel=0.03)
    assert list(board.problem.heard[7].whitening) == [7.0] * 6


def test_within_a_coil_the_gradient_no_longer_grows(core, place):
    board = Weights(core, place)
    heard = board.problem.heard[0]
    heard.position_sd_m, heard.sigma_uT = 0.01, 1e-6
    shares = []
    for stronger in (0.125, 1.0, 1.01, 8.0, 100.0, 0.9):
        heard.magnitude_uT = stronger * 1.5 * heard.loop.k_uT_m3 / heard.loop.radius_m**3
        board.lib.pose_weights_rough(board.problem, 0.0)
        shares.append(1.0 / (heard.whitening[0] * heard.magnitude_uT))
    assert shares[0] == pytest.approx(0.5 * shares[1], rel=1e-3)
    assert shares[1:5] == pytest.approx([shares[1]] * 4, rel=1e-3)
    assert shares[5] == pytest.approx(0.9 ** (1 / 3) * shares[1], rel=1e-3)

"""The fit of a pose against linear least squares around it in double precision, by differences of magpylib's fields."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.site.model import Survey
from tests.firmware.core.pose.explaining import HOPELESS, SIGMA_T, Explaining, Place
from tests.firmware.core.pose.fault_truth import Truth, derivatives


def place_of(mixed_cube, beacons=True, sensor=True):
    """A pose in the cube with declared errors of its beacons, its sensor, both or none."""
    rows = [
        dataclasses.replace(b, survey=Survey(*(beacons * np.array([1e-3 * (1 + i % 3), 2e-3 * (1 + i % 2), 3e-3]))))
        for i, b in enumerate(mixed_cube.beacons)
    ]
    known = dataclasses.replace(mixed_cube.sensor, gain_sd=0.004 * sensor, axis_sd_rad=0.006 * sensor)
    site = dataclasses.replace(mixed_cube, beacons=tuple(rows), sensor=known)
    return Place(site, [0.8, 1.3, 0.7], Rotation.from_rotvec([0.4, -0.9, 1.7]))


class Fitting(Explaining):
    """A board that fits noisy fields, from so far off the true pose; the last beacon is not heard."""

    def __init__(self, core, place, noise=0.0, count=8, offset_m=(0.0, 0.0, 0.0), turn_rad=0.0):
        self.fields = place.fields + noise * SIGMA_T * np.random.default_rng(3).normal(size=place.fields.shape)
        super().__init__(core, place, self.fields)
        self.problem.count = self.count = count
        for heard in self.problem.heard:
            heard.whitening = [3e4] * 6
        self.fit = self.ffi.new("pose_fit_t *")
        self.ffi.memmove(self.fit, b"\x7f" * self.ffi.sizeof("pose_fit_t"), self.ffi.sizeof("pose_fit_t"))
        self.start(self.fit, offset_m)
        turn = Rotation.from_rotvec(turn_rad * np.array([0.6, -0.48, 0.64]))
        self.fit.quaternion = (turn * place.rotation).as_quat().tolist()

    def run(self, limit=40):
        """Fit; returns the evaluations."""
        return self.lib.pose_fit(self.problem, limit, self.fit)

    def truth(self):
        """The problem around the fit."""
        site = dataclasses.replace(self.place.site, beacons=self.place.site.beacons[: self.count])
        position = np.array(list(self.problem.origin_m)) + np.array(list(self.fit.position_m))
        rotation = Rotation.from_quat(list(self.fit.quaternion))
        return Truth.around(site, self.fields[: self.count], np.full(self.count, SIGMA_T), position, rotation)

    def near(self):
        """Whether the fit is at the true place."""
        position = np.array(list(self.problem.origin_m)) + np.array(list(self.fit.position_m))
        return bool(np.linalg.norm(position - self.place.position) < 2e-3)

    def promise(self):
        """What a step would take away of the cost of the fit if all were linear."""
        return np.sum(matrix(self.fit.triangle.r, 7)[:, 6] ** 2)

    def cost(self):
        """What is left at the fit itself, by the best values of the sensor's errors."""
        truth = self.truth()
        return truth.residual @ np.linalg.solve(np.eye(3 * self.count) + truth.sensor @ truth.sensor.T, truth.residual)


def matrix(rows, columns=6):
    return np.array([list(row) for row in rows])[:, :columns]


def test_the_model_of_a_beacon(core, mixed_cube):
    """What lies behind it stays as it is: the seventh column and a fourth row."""
    place = place_of(mixed_cube)
    board = Fitting(core, place)
    for i in range(8):
        rows, field = board.ffi.new("float[4][7]", [[9.0] * 7] * 4), board.ffi.new("float[4]", [9.0] * 4)
        board.lib.pose_fit_model(board.ffi.addressof(board.problem.heard[i]), board.fit.position_m, rows, field)
        here, gradient, _ = derivatives(place.site.beacons[i], place.position)
        turn = np.cross(here, np.eye(3)).T
        true = 1e6 * np.hstack([gradient, turn])
        found = matrix(rows, 7)
        assert found[:3, :6] == pytest.approx(true, abs=1e-4 * np.abs(true).max())
        assert (found[:, 6] == 9.0).all()
        assert (found[3] == 9.0).all()
        assert list(field) == pytest.approx([*(1e6 * here), 9.0], rel=1e-4)


@pytest.mark.parametrize("sensor", [True, False])
def test_the_whitened_rows_of_a_beacon(core, mixed_cube, sensor):
    place = place_of(mixed_cube, sensor=sensor)
    board = Fitting(core, place, noise=1e4)
    truth = board.truth()
    board.lib.pose_weights_at(board.problem, board.fit.position_m)
    attitude = board.ffi.new("float[3][3]", place.rotation.as_matrix().tolist())
    for i in range(8):
        rows, effects, field = board.ffi.new("float[3][7]"), board.ffi.new("float[3][6]"), board.ffi.new("float[3]")
        heard = board.ffi.addressof(board.problem.heard[i])
        board.lib.pose_fit_rows(board.problem, heard, board.fit.position_m, attitude, rows, effects, field)
        mine = slice(3 * i, 3 * i + 3)
        for found, true in (
            (matrix(rows), truth.rows[mine]),
            (matrix(rows, 7)[:, 6], truth.residual[mine]),
            (matrix(effects), truth.sensor[mine]),
            (1e-6 * np.array(list(field)), truth.model[i]),
        ):
            assert found == pytest.approx(true, abs=5e-4 * np.abs(true).max())


KINDS = [(False, False), (True, False), (False, True), (True, True)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [4, 7])
def test_a_fit_is_the_least_squares_of_all_errors(core, mixed_cube, kind, count):
    """Cost, information and what is eliminated are those of the pose, from where no step leads anywhere."""
    board = Fitting(core, place_of(mixed_cube, *kind), 1.0, count, [0.03, -0.02, 0.04], 0.05)
    taken = board.run()
    cost, step, _, covariance = board.truth().solve()
    assert 1 < taken <= 8
    assert board.fit.cost == pytest.approx(cost, rel=2e-3, abs=0.02)
    assert step @ np.linalg.solve(covariance, step) < 0.02
    r = matrix(board.fit.triangle.r)
    sd = np.sqrt(np.diag(covariance))
    assert sd[:, None] * (r.T @ r) * sd == pytest.approx(
        sd[:, None] * np.linalg.inv(covariance) * sd, rel=0.02, abs=0.02
    )
    n, sensor = matrix(board.fit.sensor.n), board.truth().sensor
    assert n.T @ n == pytest.approx(np.eye(6) + sensor.T @ sensor, rel=1e-2, abs=1e-2 * np.abs(sensor.T @ sensor).max())


@pytest.mark.parametrize("kind", KINDS)
def test_whatever_the_limit_the_cost_is_that_of_the_place(core, mixed_cube, kind):
    """With weights around it. No more evaluations are taken than there may be; more are not worse."""
    before = HOPELESS
    for limit in range(1, 16):
        board = Fitting(core, place_of(mixed_cube, *kind), 1.0, 8, [0.1, -0.06, 0.08], 0.15)
        taken = board.run(limit)
        assert 1 <= taken <= limit
        assert board.fit.cost == pytest.approx(board.cost(), rel=2e-3, abs=0.05)
        assert board.fit.cost <= before * (1.0 + 1e-3)
        before = board.fit.cost


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("first", [0, 3])
def test_rounding_is_that_of_the_clearest_field(core, mixed_cube, kind, first):
    """3e-7 of it, in standard deviations of its most exact component; by the factors of the true covariances."""
    site = place_of(mixed_cube, *kind).site
    rows = site.beacons[first:] + site.beacons[:first]
    for turn in ([0.4, -0.9, 1.7], [1.4, 0.2, -0.3]):
        for position in ([0.8, 1.3, 0.7], [0.5, 0.6, 1.0], [1.1, 0.4, 1.3], [0.3, 1.4, 0.9]):
            place = Place(dataclasses.replace(site, beacons=rows), position, Rotation.from_rotvec(turn))
            board = Fitting(core, place, count=7)
            board.run(1)
            most = np.linalg.norm(board.fields[:7], axis=1) * board.truth().whitening.diagonal(0, 1, 2).max(axis=1)
            assert board.fit.rounding == pytest.approx(3e-7 * most.max(), rel=1e-3)


@pytest.mark.parametrize("noise", [20.0, 0.03])
def test_a_fit_ends_after_the_step_that_promises_next_to_nothing(core, mixed_cube, noise):
    """Less than 1e-3 in cost and what rounding makes of it, along any unknowns. The step is taken."""
    place, seen = place_of(mixed_cube, False, False), []
    for unknown in range(6):
        for share in (0.0, 0.3, 0.8, 1.25, 3.0, 10.0):
            board = Fitting(core, place)
            for heard in list(board.problem.heard)[:8]:
                heard.sigma_uT *= noise
            board.run(1)
            enough = 1e-3 + board.fit.rounding**2
            step = np.sqrt(share * enough) * np.linalg.inv(matrix(board.fit.triangle.r))[:, unknown]
            board.start(board.fit, step[:3])
            board.fit.quaternion = (Rotation.from_rotvec(step[3:]) * place.rotation).as_quat().tolist()
            board.run(1)
            promise = board.promise() / enough
            taken = board.run(30)
            assert (taken == 2) == (promise < 1.0)
            assert noise < 1.0 or board.promise() < 1e-3 * enough
            seen.append(promise < 1.0)
    assert 5 < sum(seen) < 31


@pytest.mark.parametrize("way", ["declared", "robust"])
def test_a_fit_that_begins_settled_ends_at_once(core, mixed_cube, way):
    """With declared errors it takes no step; a robust one takes that which promises less than 1e-3, as an exact one."""
    robust = way == "robust"
    place = place_of(mixed_cube, not robust, False)
    for share in (0.3, 0.8, 0.97, 1.04, 1.3, 3.0):
        for unknown in range(6):
            board = Fitting(core, place)
            fit = board.lib.pose_fit_robust if robust else board.lib.pose_fit
            promise = off_by(board, fit, share * 1e-3, unknown) / (1e-3 + board.fit.rounding**2)
            taken = fit(board.problem, 30, board.fit)
            assert (taken == (2 if robust else 1)) == (promise < 1.0)


def off_by(board, fit, promise, unknown):
    """Put a fit beside the true pose along an unknown, where a step promises about so much; returns what it does."""
    fit(board.problem, 1, board.fit)
    step = np.sqrt(promise) * np.linalg.inv(matrix(board.fit.triangle.r))[:, unknown]
    board.start(board.fit, step[:3])
    board.fit.quaternion = (Rotation.from_rotvec(step[3:]) * board.place.rotation).as_quat().tolist()
    fit(board.problem, 1, board.fit)
    return board.promise()


@pytest.mark.parametrize("share", [0.7, 0.97, 1.04, 1.5])
def test_weights_are_taken_again_after_a_step_that_promises_less_than_one(core, mixed_cube, share):
    """A start, a step and the weights of where it led; from farther one more step before."""
    for unknown in range(6):
        board = Fitting(core, place_of(mixed_cube, True, False))
        promise = off_by(board, board.lib.pose_fit, share, unknown)
        assert board.run(30) == (3 if promise < 1.0 else 4)


def test_where_one_step_has_no_room_none_is_taken(core, mixed_cube):
    """With declared errors a step needs an evaluation of its own and one with weights of where it leads."""
    taken = [Fitting(core, place_of(mixed_cube), 1.0, 8, [0.1, 0.0, 0.0]).run(limit) for limit in (1, 2, 3, 4)]
    assert taken == [1, 1, 3, 4]


@pytest.mark.parametrize("seed", [10, 40])
def test_weights_are_taken_again_three_times_at_most(core, mixed_cube, seed):
    """Two beacons determine no pose: each time that weights are taken another one is the best, and none settles."""
    rng = np.random.default_rng(seed)
    rows = [dataclasses.replace(b, survey=Survey(0.015, 0.025, 0.015)) for b in mixed_cube.beacons]
    site = dataclasses.replace(mixed_cube, beacons=tuple(rows))
    place = Place(site, rng.uniform(0.2, 1.6, 3), Rotation.random(random_state=rng))
    board = Fitting(core, place, 1.0, 2, 0.1 * rng.normal(size=3), 0.2)
    board.run(60)
    assert board.run(60) == 1 + 3 * 2
    assert board.promise() > 1e-3 + board.fit.rounding**2


def test_the_clearest_component_may_be_the_third_though_the_second_is_clearer_than_the_first(core, mixed_cube):
    """On the axis of a coil between x and y, with an error of its current, only noise is across the field."""
    axis = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    coil = dataclasses.replace(mixed_cube.beacons[0], axis=axis, survey=Survey(0.0, 0.0, 0.02))
    site = dataclasses.replace(mixed_cube, beacons=(coil, *mixed_cube.beacons[1:]))
    place = Place(site, coil.position_m + 1.5 * axis, Rotation.identity())
    board = Fitting(core, place, count=1)
    board.run(1)
    field = np.linalg.norm(place.fields[0])
    assert board.fit.rounding == pytest.approx(3e-7 * field / np.hypot(SIGMA_T, 1e-6 * field), rel=1e-2)


@pytest.mark.parametrize("seed", [1, 9])
def test_a_step_that_raises_the_cost_is_not_taken(core, mixed_cube, seed):
    """The next one is shorter, and the fit goes on to the true place; with more evaluations it is never worse."""
    rng = np.random.default_rng(seed)
    offset, turn, costs, taken = 0.5 * rng.normal(size=3), rng.uniform(0.5, 3.0), [], []
    for limit in range(1, 20):
        board = Fitting(core, place_of(mixed_cube, False, False), 1.0, 8, offset, turn)
        taken.append(board.lib.pose_fit_robust(board.problem, limit, board.fit))
        costs.append(board.fit.cost)
    stays = (np.diff(costs) == 0.0) & (np.diff(taken) > 0)
    assert stays.any()
    assert (np.diff(costs) <= 1e-3).all()
    assert board.near()
    assert taken[-1] <= 11


@pytest.mark.parametrize("seed", [6, 8, 34])
def test_in_a_wrong_valley_the_cost_falls_all_the_same(core, mixed_cube, seed):
    rng = np.random.default_rng(seed)
    offset, turn, costs = 0.5 * rng.normal(size=3), rng.uniform(0.5, 3.0), []
    for limit in range(1, 26):
        board = Fitting(core, place_of(mixed_cube, False, False), 1.0, 8, offset, turn)
        assert board.lib.pose_fit_robust(board.problem, limit, board.fit) == limit
        costs.append(board.fit.cost)
    assert (np.diff(costs) <= 1e-3 * np.array(costs[1:])).all()
    assert 1e3 < costs[-1] < 0.9 * costs[0]


@pytest.mark.parametrize("robust", [False, True])
def test_a_start_whose_field_is_no_number_is_hopeless(core, mixed_cube, robust):
    board = Fitting(core, place_of(mixed_cube))
    board.problem.heard[3].loop.centre_m = list(board.fit.position_m)
    board.problem.heard[3].loop.radius_m = 0.0
    fit = board.lib.pose_fit_robust if robust else board.lib.pose_fit
    assert fit(board.problem, 20, board.fit) == 1
    assert board.fit.cost == pytest.approx(HOPELESS)


def test_a_robust_fit_has_the_rough_weights(core, mixed_cube):
    """Whatever the limit; no sensor's error is eliminated, and the fit comes to the place from afar."""
    place, before = place_of(mixed_cube), HOPELESS
    for limit in range(1, 26):
        board = Fitting(core, place, 1.0, 7, [0.25, -0.3, 0.2], 1.0)
        taken = board.lib.pose_fit_robust(board.problem, limit, board.fit)
        truth = board.truth()
        turned = truth.attitude @ board.fields[:7].T
        weights = np.array([1e6 * h.whitening[0] for h in list(board.problem.heard)[:7]])
        cost = np.sum(weights**2 * np.sum((turned.T - truth.model) ** 2, axis=1))
        assert board.fit.cost == pytest.approx(cost, rel=1e-3, abs=0.01)
        assert 1 <= taken <= limit
        assert board.fit.cost <= before * (1.0 + 1e-3)
        assert (matrix(board.fit.sensor.n) == np.eye(6)).all()
        before = board.fit.cost
    board.lib.pose_weights_rough(board.problem, 0.03)
    assert weights == pytest.approx([1e6 * h.whitening[0] for h in list(board.problem.heard)[:7]])
    assert cost < 1.0

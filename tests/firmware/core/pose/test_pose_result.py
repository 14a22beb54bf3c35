"""How a fit becomes an answer: status and reason, both sides of what is weak and of what is heard."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.firmware.core.pose.fault_truth import field_T
from tests.firmware.core.pose.test_pose import (
    AMBIGUOUS,
    FAILED,
    INCONSISTENT,
    NEGATED,
    OK,
    UNVERIFIED,
    WEAK,
    Sensor,
    covariance_of,
)

SIGMA_T = 2e-8 / np.sqrt(1023)
NO_POSE, HALF_SPACE, RIVAL, OF_WEAK, OF_UNVERIFIED = 3, 7, 8, 9, 10
PLACE, TURN = np.array([0.8, 1.3, 0.7]), Rotation.from_rotvec([0.4, -0.9, 1.7])


class Result:
    """A fit at a place in the cube and what is made of it; its uncertainty is whatever its triangle says."""

    def __init__(self, core, site, rotation=TURN):
        self.ffi, self.lib = core
        self.site, sensor = site, Sensor(core, site)
        fields = rotation.inv().apply(np.array([field_T(b, PLACE) for b in site.beacons]))
        table = self.ffi.new("pose_field_t[]", [(f.tolist(), SIGMA_T) for f in fields])
        self.problem, self.fit = self.ffi.new("pose_problem_t *"), self.ffi.new("pose_fit_t *")
        self.faults, self.pose = self.ffi.new("pose_faults_t *"), self.ffi.new("pose_t *")
        self.lib.pose_problem(sensor.site, table, self.problem)
        self.origin = np.array(list(self.problem.origin_m))
        self.fit.position_m, self.fit.quaternion = (PLACE - self.origin).tolist(), rotation.as_quat().tolist()
        self.lib.pose_fit(self.problem, 20, self.fit)
        self.faults.level_m = 0.2

    def told(self, triangle):
        """Put a triangle of the six unknowns into the fit."""
        for row in range(6):
            self.fit.triangle.r[row] = [*triangle[row].tolist(), 0.0]

    def faint(self, energy):
        """Make the noise such that the fields' energy over it is so much: terms of second order are small then."""
        heard = list(self.problem.heard)[:8]
        sigma = np.sqrt(sum(h.magnitude_uT**2 for h in heard) / energy)
        for h in heard:
            h.sigma_uT = sigma

    def answer(self, wrong=0, contested=False):
        self.lib.pose_result(self.problem, self.fit, self.faults, wrong, contested, self.pose)
        return self.pose.status, self.pose.reason


@pytest.mark.parametrize(
    ("wrong", "contested", "weak", "outside", "unsafe", "answer"),
    [
        (0, False, False, False, False, (OK, 0)),
        (0, False, False, False, True, (UNVERIFIED, OF_UNVERIFIED)),
        (0, False, True, False, True, (WEAK, OF_WEAK)),
        (0, True, True, False, True, (AMBIGUOUS, RIVAL)),
        (0, True, True, True, True, (INCONSISTENT, HALF_SPACE)),
        (0, False, False, True, False, (INCONSISTENT, HALF_SPACE)),
        (NEGATED, True, True, True, True, (INCONSISTENT, NEGATED)),
        (NEGATED, False, False, False, False, (INCONSISTENT, NEGATED)),
    ],
)
def test_what_comes_first(core, mixed_cube, wrong, contested, weak, outside, unsafe, answer):
    board = Result(core, mixed_cube)
    board.problem.alert_limit_m = 0.1 if unsafe else 0.3
    board.problem.normal = [0.0, 0.0, -1.0]
    board.problem.point_m = (PLACE - board.origin + [0.0, 0.0, -0.1 if outside else 0.1]).tolist()
    board.faint(10.0)
    board.told(np.eye(6) if weak else 100.0 * np.eye(6))
    assert board.answer(wrong, contested) == answer


@pytest.mark.parametrize(("level_m", "answer"), [(0.25, (OK, 0)), (float("nan"), (UNVERIFIED, OF_UNVERIFIED))])
def test_a_level_of_the_alert_limit_is_verified(core, mixed_cube, level_m, answer):
    board = Result(core, mixed_cube)
    board.problem.alert_limit_m, board.faults.level_m = 0.25, level_m
    assert board.answer() == answer


def test_the_answer_is_the_fit(core, mixed_cube):
    board = Result(core, mixed_cube)
    board.problem.alert_limit_m = 1.0
    board.fit.cost = 72.0
    board.pose.left_out, board.pose.iterations, board.pose.tracked = 5, 17, True
    assert board.answer() == (OK, 0)
    pose, covariance = board.pose, board.ffi.new("float[6][6]")
    assert board.lib.pose_covariance(board.problem, board.fit, covariance)
    whole = np.array([list(row) for row in covariance])
    assert np.array_equal(covariance_of(pose)[0], whole[:3, :3])
    assert np.array_equal(covariance_of(pose)[1], whole[3:, 3:])
    assert np.array(list(pose.position_m)) == pytest.approx(PLACE, abs=1e-4)
    assert pose.residual == pytest.approx(2.0)  # 72 over the 18 degrees of freedom of 24 components.
    assert (pose.protection_m, pose.used) == (pytest.approx(0.2), 8)
    assert (pose.left_out, pose.iterations, pose.tracked) == (5, 17, True)


@pytest.mark.parametrize("w", [0.3, -0.3, 0.0])
def test_the_quaternion_has_no_negative_w(core, mixed_cube, w):
    board, sign = Result(core, mixed_cube), -1.0 if w < 0.0 else 1.0
    board.fit.quaternion = [*(np.sqrt(1.0 - w * w) * np.array([0.36, -0.48, 0.8])).tolist(), w]
    board.answer()
    assert list(board.pose.quaternion) == [sign * x for x in board.fit.quaternion]


def test_what_tells_no_pose_fails(core, mixed_cube):
    board = Result(core, mixed_cube)
    board.fit.triangle.r[5][5] = 0.0
    assert board.answer(NEGATED) == (FAILED, NO_POSE)


def triangles(part, rng):
    """Triangles with one, two or three wide directions of the position (part 0) or the attitude (1)."""
    for wide in ([0], [1], [2], [0, 1], [1, 2], [0, 2], [0, 1, 2]):
        sd = np.full(6, 1e-3)
        sd[3 * part + np.array(wide)] = 0.1
        for mixed in (0.0, 0.6):
            root = np.diag(sd)
            root[3 * part : 3 * part + 3, 3 * part : 3 * part + 3] += mixed * 0.1 * np.triu(rng.normal(size=(3, 3)))
            yield np.linalg.inv(root)


@pytest.mark.parametrize("part", [0, 1], ids=["position", "attitude"])
def test_a_pose_is_weak_beyond_the_greatest_deviation(core, mixed_cube, part):
    """A quarter of the distance to the nearest beacon, or half a radian: the greatest eigenvalue decides, by LAPACK."""
    board, rng, seen = Result(core, mixed_cube), np.random.default_rng(8), []
    board.problem.alert_limit_m = 1.0
    board.faint(2.0)
    near_m = min(np.linalg.norm(PLACE - b.position_m) for b in mixed_cube.beacons)
    limit = (0.25 * near_m) ** 2 if part == 0 else 0.5**2
    for triangle in triangles(part, rng):
        for share in (0.98, 1.02):
            scaled = triangle
            for _ in range(8):
                board.told(scaled)
                answer = board.answer()
                greatest = np.linalg.eigvalsh(covariance_of(board.pose)[part])[-1] / limit
                scaled = scaled * np.sqrt(greatest / share)
            assert abs(greatest - share) < 0.015
            assert answer == ((OK, 0) if greatest < 1.0 else (WEAK, OF_WEAK))
            seen.append(answer[0])
    assert seen.count(OK) == seen.count(WEAK)


@pytest.mark.parametrize(("wrong", "answer"), [(0, (FAILED, NO_POSE)), (NEGATED, (FAILED, NEGATED))])
@pytest.mark.parametrize("energy", [0.98, 1.02])
def test_a_weak_pose_that_hears_nothing_fails(core, mixed_cube, energy, wrong, answer):
    """The sum of the squares of all fields there, magpylib's, over their noise, which is another for each beacon."""
    board = Result(core, mixed_cube)
    board.told(np.eye(6))
    rng = np.random.default_rng(9)
    for _ in range(4):
        position = PLACE + rng.normal(size=3)
        fields_T = np.array([field_T(b, position) for b in mixed_cube.beacons])
        sigma_T = np.linalg.norm(fields_T, axis=1) * rng.uniform(1.0, 3.0, 8)
        sigma_T *= np.sqrt(np.sum(fields_T**2 / sigma_T[:, None] ** 2) / energy)
        for heard, sigma in zip(board.problem.heard, sigma_T, strict=False):
            heard.sigma_uT = 1e6 * sigma
        board.fit.position_m = (position - board.origin).tolist()
        assert board.answer(wrong) == (answer if energy < 1.0 else (INCONSISTENT, wrong) if wrong else (WEAK, OF_WEAK))


def test_a_pose_that_is_not_weak_does_not_fail_by_what_it_hears(core, mixed_cube):
    board = Result(core, mixed_cube)
    board.problem.alert_limit_m = 1.0
    board.told(1e4 * np.eye(6))
    for heard in list(board.problem.heard)[:8]:
        heard.sigma_uT = 1e6
    assert board.answer() == (OK, 0)

"""Both sides of each figure that decides in the board's pose: status, alarm, exclusion, gains, images, weak poses.

The fields have no noise but float32's. Residuals are put where the fit cannot take them away, so that each statistic is
known; states that no fields lead to are put into the structs.
"""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from goldfield import site as sites
from goldfield.locate import Locator
from goldfield.types import Fields
from hil_sim.clib import ROOT
from tests.firmware.core.pose.test_pose import (
    FAILED,
    GAINS,
    INCONSISTENT,
    LEFT_OUT,
    NEGATED,
    NOBODY,
    OK,
    STRENGTH,
    UNEXPLAINED,
    WEAK,
    Sensor,
    covariance_of,
    fields_at,
    inside,
    lattice,
)

SIGMA_T = 2e-8 / np.sqrt(1023)
FALSE_ALARM = 7e-4
NOISE = 2  # POSE_REASON_NOISE
HALF_SPACE = 7


@pytest.fixture(scope="module")
def cube():
    return sites.load(ROOT / "host/sites/prigge8.toml")


class Epoch:
    """A pose in the cube with its fields, shape (8, 3), and their Jacobian by differences, in standard deviations."""

    def __init__(self, site, seed, sound=range(8)):
        rng = np.random.default_rng(seed)
        position, rotation = inside(site, 0.6, 1, rng)
        self.position_m, self.rotation, self.rng, self.sound = position[0], rotation[0], rng, list(sound)
        self.field_T = fields_at(site, position, rotation, 0.0, rng)[0]
        columns = []
        for step in np.vstack([np.eye(6)]) * 1e-4:
            ahead, behind = (
                fields_at(site, position + s * step[:3], Rotation.from_rotvec(s * step[3:]) * rotation, 0.0, rng)[0]
                for s in (1.0, -1.0)
            )
            columns.append((ahead - behind)[self.sound].ravel() / 2e-4)
        self.jacobian = np.linalg.qr(np.array(columns).T)[0]

    def residual(self, direction, cost, also=()):
        """A residual, shape (8, 3), T, along a direction, of a cost that neither pose nor ``also`` can lower."""
        explained = np.linalg.qr(np.column_stack([self.jacobian, *(a[self.sound].ravel() for a in also)]))[0]
        left = direction[self.sound].ravel()
        for _ in range(2):
            left = left - explained @ (explained.T @ left)
        result = np.zeros((8, 3))
        result[self.sound] = (left * np.sqrt(cost) * SIGMA_T / np.linalg.norm(left)).reshape(-1, 3)
        return result

    def along(self, matrix):
        """What a change of the sensor does to the fields."""
        return self.field_T @ np.asarray(matrix, dtype=float).T

    def of_beacon(self, row, vector=None):
        """The field of one beacon, or another vector in its place, alone."""
        alone = np.zeros((8, 3))
        alone[row] = self.field_T[row] if vector is None else vector
        return alone


def alarmed(pose):
    return pose.status == INCONSISTENT or pose.left_out != NOBODY


ALARMS = {
    "whole": (chi2.isf(0.1 * FALSE_ALARM, 18), lambda epoch: epoch.rng.normal(size=(8, 3))),
    "beacon": (
        chi2.isf(0.3 * FALSE_ALARM / 16, 3),
        lambda epoch: epoch.of_beacon(2, np.cross(epoch.field_T[2], [1, 2, 3])),
    ),
    "strength": (chi2.isf(0.2 * FALSE_ALARM / 16, 1), lambda epoch: epoch.of_beacon(2)),
    "gain": (chi2.isf(0.2 * FALSE_ALARM, 1), lambda epoch: epoch.along(np.eye(3))),
    "gains": (chi2.isf(0.1 * FALSE_ALARM, 3), lambda epoch: epoch.along(np.diag([1, -1, 0]))),
    "skew": (chi2.isf(0.1 * FALSE_ALARM, 6), lambda epoch: epoch.along([[0, 1, 0], [1, 0, 0], [0, 0, 0]])),
}


@pytest.mark.parametrize("test", ALARMS)
@pytest.mark.parametrize(("share", "alarm"), [(0.97, False), (1.03, True)])
def test_each_test_of_the_alarm(core, cube, test, share, alarm):
    limit, direction = ALARMS[test]
    sensor, results = Sensor(core, cube), []
    for seed in (61, 62, 63):
        epoch = Epoch(cube, seed)
        results.append(alarmed(sensor.locate(epoch.field_T + epoch.residual(direction(epoch), share * limit), SIGMA_T)))
    assert results == [alarm] * 3


def reason_of(core, site, fields):
    pose = Sensor(core, site).locate(fields, SIGMA_T)
    return pose.reason, pose.left_out


@pytest.mark.parametrize(("share", "named"), [(0.97, True), (1.03, False)])
@pytest.mark.parametrize(
    ("matrix", "reason", "freedom"),
    [(-np.eye(3), NEGATED, 18), (1.2 * np.eye(3), STRENGTH, 18), (np.diag([1.3, 1.0, 0.9]), GAINS, 18)],
    ids=["negated", "strength", "gains"],
)
def test_the_sensor_explains_what_is_likelier_than_one_in_a_hundred_thousand(
    core, cube, matrix, reason, freedom, share, named
):
    """The residual is one that no gain of an axis takes away."""
    epoch = Epoch(cube, 64)
    axes = [epoch.along(np.diag(row)) for row in np.eye(3)]
    residual = epoch.residual(epoch.rng.normal(size=(8, 3)), share * chi2.isf(1e-5, freedom), axes)
    found = reason_of(core, cube, (epoch.field_T + residual) @ matrix.T)
    assert found == (reason if named else UNEXPLAINED, NOBODY)


@pytest.mark.parametrize(("apart", "reason"), [(0.057, STRENGTH), (0.063, GAINS)])
def test_gains_within_six_per_cent_are_one_strength(core, cube, apart, reason):
    """One axis is so far from the mean of what the three are multiplied by."""
    epoch = Epoch(cube, 65)
    factor = 1.0 - 1.5 * apart / (1.0 + 0.5 * apart)
    total = 1.2 * np.array([factor, 1.0, 1.0])
    assert 1.0 - total[0] / total.mean() == pytest.approx(apart)
    assert reason_of(core, cube, epoch.field_T / total)[0] == reason


@pytest.mark.parametrize(("share", "left_out"), [(0.96, 3), (1.04, NOBODY)])
@pytest.mark.parametrize("seed", [84, 85])
def test_the_rest_without_a_beacon_must_be_likelier_than_one_in_a_hundred(core, cube, seed, share, left_out):
    epoch = Epoch(cube, seed, sound=[0, 1, 2, 4, 5, 6, 7])
    fields = epoch.field_T + epoch.residual(epoch.rng.normal(size=(8, 3)), share * chi2.isf(0.01, 15))
    fields[3] *= -1.0
    assert reason_of(core, cube, fields)[1] == left_out


class Steps(Sensor):
    """A board whose steps are done one by one, so that its state can be set between them."""

    def __init__(self, core, site, fields, sigma_T=SIGMA_T):
        super().__init__(core, site)
        table = self.ffi.new("pose_field_t[]", [(f.tolist(), float(sigma_T)) for f in fields])
        self.pose = self.ffi.new("pose_t *")
        self.lib.pose_begin(self.site, table, False, self.ffi.NULL, self.work, self.pose)
        self.solver, self.explain = self.work.solver, self.work.explain

    def step(self):
        return bool(self.lib.pose_step(self.work, self.pose))

    def until(self, reached):
        while not reached():
            assert not self.step()

    def evaluated(self, position_m, rotation, limit=1):
        """solver.best at a place, evaluated there."""
        origin = np.array(list(self.solver.problem.origin_m))
        self.solver.best.position_m = (position_m - origin).tolist()
        self.solver.best.quaternion = rotation.as_quat().tolist()
        # The address within the struct: a copy would be evaluated else.
        return self.lib.pose_fit(
            self.ffi.addressof(self.solver, "problem"), limit, self.ffi.addressof(self.solver, "best")
        )


@pytest.mark.parametrize(("margin", "named"), [(24.9, False), (25.1, True)])
def test_negated_fields_must_cost_twenty_five_less(core, cube, margin, named):
    epoch = Epoch(cube, 66)
    steps = Steps(core, cube, -epoch.field_T)
    done = lambda: steps.work.stage == steps.lib.POSE_STEP_EXPLAIN and steps.solver.stage == steps.lib.POSE_SOLVE_DONE  # noqa: E731
    steps.until(done)
    steps.explain.full.cost = steps.solver.best.cost + margin
    assert steps.step() == named
    assert (named and steps.pose.reason == NEGATED) or steps.explain.stage == steps.lib.POSE_EXPLAIN_GAINS


@pytest.mark.parametrize(("margin", "left_out"), [(24.9, NOBODY), (25.1, 3)])
def test_a_beacon_is_left_out_if_the_next_explanation_costs_twenty_five_more(core, cube, margin, left_out):
    epoch = Epoch(cube, 67)
    fields = epoch.field_T.copy()
    fields[3] *= -1.0
    steps = Steps(core, cube, fields)
    steps.until(
        lambda: steps.explain.stage == steps.lib.POSE_EXPLAIN_DECIDE and steps.work.stage == steps.lib.POSE_STEP_EXPLAIN
    )
    steps.explain.next_cost = steps.explain.rest.cost + margin
    assert steps.step()
    assert steps.pose.left_out == left_out
    assert (steps.pose.status, steps.pose.reason) == ((OK, LEFT_OUT) if left_out == 3 else (INCONSISTENT, 5))


@pytest.mark.parametrize(("gain", "taken"), [(0.25, 1.0 / 0.3), (0.35, 1.0 / 0.35), (2.9, 1.0 / 2.9), (4.0, 0.3)])
def test_a_round_of_gains_takes_no_more_than_a_factor_of_ten_thirds(core, cube, gain, taken):
    epoch = Epoch(cube, 68)
    steps = Steps(core, cube, gain * epoch.field_T)
    steps.evaluated(epoch.position_m, epoch.rotation)
    steps.work.stage, steps.explain.stage = steps.lib.POSE_STEP_EXPLAIN, steps.lib.POSE_EXPLAIN_GAINS
    steps.explain.round, steps.explain.total = 0, [1.0] * 3
    steps.step()
    assert list(steps.explain.total) == pytest.approx([taken] * 3, rel=0.01)


def test_of_thirteen_beacons_twelve_are_tried(core, tmp_path):
    site = lattice(tmp_path, False)
    rng = np.random.default_rng(69)
    beacons = [*site.beacons, *site.beacons[:4]]
    sensor = Sensor(core, site)
    sensor.site.count = len(beacons)
    for row in range(len(beacons)):
        b = sensor.site.beacons[row]
        b.position_m, b.axis = rng.uniform(0.0, 3.0, 3).tolist(), rng.normal(size=3).tolist()
        b.moment_A_m2, b.radius_m = 13.0, 0.1
    for count in (12, 13):
        sensor.site.count = count
        sensor.locate(rng.normal(size=(count, 3)) * 1e-7, SIGMA_T)
        assert sensor.work.explain.tried == 12


@pytest.mark.parametrize(("share", "failed"), [(0.98, True), (1.02, False)])
def test_fields_that_noise_makes_once_in_a_million_fail(core, cube, share, failed):
    """The limit by Wilson and Hilferty is too great by at most 1.3 %."""
    epoch = Epoch(cube, 70)
    shape = epoch.field_T / np.linalg.norm(epoch.field_T)
    pose = Sensor(core, cube).locate(shape * SIGMA_T * np.sqrt(share * 1.005 * chi2.isf(1e-6, 24)), SIGMA_T)
    assert (pose.reason == NOISE, pose.status == FAILED) == (failed, failed)


@pytest.mark.parametrize(("heard", "failed"), [(2, True), (3, False)])
def test_three_beacons_are_located_from_and_not_two(core, cube, heard, failed):
    epoch = Epoch(cube, 71)
    rows = [0, 3, 6][:heard]
    sigma = np.where(np.isin(np.arange(8), rows), SIGMA_T, 0.0)
    pose = Sensor(core, cube).locate(epoch.field_T, sigma)
    assert (pose.used, pose.status == FAILED) == (heard, failed)


@pytest.mark.parametrize(("heard", "tracked"), [(3, False), (4, True)])
def test_four_beacons_are_tracked_and_not_three(core, cube, heard, tracked):
    """With three there may be several poses: all are searched each time."""
    epoch = Epoch(cube, 71)
    sigma = np.where(np.isin(np.arange(8), [0, 3, 6, 5][:heard]), SIGMA_T, 0.0)
    sensor = Sensor(core, cube)
    pose = sensor.locate(epoch.field_T, sigma)
    assert pose.status != FAILED
    pose.position_m = epoch.position_m.tolist()
    pose.quaternion = epoch.rotation.as_quat().tolist()
    assert sensor.locate(epoch.field_T, sigma, pose).tracked == tracked


@pytest.mark.parametrize(("offset_m", "status"), [(-0.001, OK), (0.001, INCONSISTENT)])
def test_both_sides_of_the_half_space(core, cube, offset_m, status):
    """Its plane so far beyond the sensor, across a slanted normal."""
    epoch = Epoch(cube, 72)
    sensor, normal = Sensor(core, cube), np.array([0.6, 0.0, 0.8])
    sensor.site.half_space_normal = normal.tolist()
    sensor.site.half_space_point_m = (epoch.position_m + offset_m * normal + [0.8, 5.0, -0.6]).tolist()
    pose = sensor.locate(epoch.field_T, SIGMA_T)
    assert pose.status == status
    assert pose.reason == (HALF_SPACE if status == INCONSISTENT else 0)


@pytest.mark.parametrize(("margin", "contested"), [(14.9, True), (15.1, False)])
def test_a_rival_of_the_search_contests_within_a_cost_of_fifteen(core, cube, margin, contested):
    epoch = Epoch(cube, 73)
    steps = Steps(core, cube, epoch.field_T)
    steps.until(lambda: steps.solver.stage == steps.lib.POSE_SOLVE_CANDIDATE and steps.solver.best.cost < 1e3)
    steps.solver.rival = steps.solver.best.cost + margin
    steps.step()
    assert steps.solver.stage == steps.lib.POSE_SOLVE_DONE
    assert steps.solver.contested == contested


@pytest.mark.parametrize(
    ("offset", "turn_rad", "rival"),
    [(0.049, 0.0, False), (0.051, 0.0, True), (0.0, 0.198, False), (0.0, 0.203, True)],
)
def test_poses_a_twentieth_of_the_range_or_a_fifth_of_a_radian_apart_are_two(core, cube, offset, turn_rad, rival):
    epoch = Epoch(cube, 74)
    steps = Steps(core, cube, epoch.field_T)
    steps.until(lambda: steps.solver.stage == steps.lib.POSE_SOLVE_CANDIDATE)
    nearest = min(np.linalg.norm(epoch.position_m - b.position_m) for b in cube.beacons)
    beacon = min((b.position_m for b in cube.beacons), key=lambda p: np.linalg.norm(epoch.position_m - p))
    across = np.cross(epoch.position_m - beacon, [0.3, -0.5, 0.8])
    moved = epoch.position_m + offset * nearest * across / np.linalg.norm(across)
    steps.evaluated(moved, Rotation.from_rotvec([0.0, turn_rad, 0.0]) * epoch.rotation)
    steps.solver.best.cost = 1000.0
    steps.step()  # It fits the first candidate, which is the true pose.
    assert steps.solver.best.cost < 1.0
    assert (steps.solver.rival == 1000.0) == rival


@pytest.fixture(scope="module")
def under_the_lattice(core, tmp_path_factory):
    site = lattice(tmp_path_factory.mktemp("lattice"), False)
    rng = np.random.default_rng(75)
    position, rotation = np.array([[3.3, 4.1, 1.2]]), Rotation.random(1, random_state=rng)
    return site, position[0], rotation[0], fields_at(site, position, rotation, 0.0, rng)[0]


def mirrored(core, under_the_lattice, worse, normal=(0.0, 0.0, 0.0)):
    """(contested, height) after pose_solve_mirror at the pose, whose cost is so much worse than its image's."""
    site, position, rotation, fields = under_the_lattice
    steps = Steps(core, site, fields)
    steps.solver.problem.normal = list(normal)
    steps.solver.problem.point_m = [0.0, 0.0, 0.0]
    steps.evaluated(position, rotation, 10)
    steps.solver.best.cost += worse
    count = steps.ffi.new("uint32_t *")
    contested = steps.lib.pose_solve_mirror(steps.ffi.addressof(steps.work, "solver"), count)
    return bool(contested), steps.solver.best.position_m[2] + 2.7


@pytest.mark.parametrize(("worse", "contested"), [(-14.9, True), (-15.1, False)])
def test_an_image_contests_within_a_cost_of_fifteen(core, under_the_lattice, worse, contested):
    assert mirrored(core, under_the_lattice, worse)[0] == contested


@pytest.mark.parametrize(("worse", "height"), [(0.95, 1.2), (1.05, 4.2)])
def test_an_image_is_taken_if_it_costs_one_less(core, under_the_lattice, worse, height):
    contested, found = mirrored(core, under_the_lattice, worse)
    assert contested
    assert found == pytest.approx(height, abs=0.01)


@pytest.mark.parametrize(("normal", "height"), [([0.0, 0.0, -1.0], 1.2), ([0.0, 0.0, 1.0], 4.2)])
def test_the_half_space_decides_between_pose_and_image(core, under_the_lattice, normal, height):
    contested, found = mirrored(core, under_the_lattice, 0.0, normal)
    assert not contested
    assert found == pytest.approx(height, abs=0.01)


@pytest.mark.parametrize(
    ("thickness", "tilt", "flat"),
    [(0.0, 0.0, True), (0.247, 0.0, True), (0.253, 0.0, False), (0.0, 0.247, True), (0.0, 0.253, False)],
)
def test_images_of_coils_flat_to_a_quarter(core, thickness, tilt, flat):
    """Two pairs of coils, above and below a plane; all lean outwards, by the sine that is given."""
    ffi, lib = core
    problem, point, normal = ffi.new("pose_problem_t *"), ffi.new("float[3]"), ffi.new("float[3]")
    problem.count = 4
    for row, (x, y) in enumerate([(1, 0), (-1, 0), (0, 1), (0, -1)]):
        across = np.sqrt(1.0 - thickness**2) * np.array([x, y, 0.0])
        problem.heard[row].loop.centre_m = (across + np.array([5.0, 6.0, 7.0 + thickness * (1 if x else -1)])).tolist()
        problem.heard[row].loop.axis = [tilt * x, tilt * y, float(np.sqrt(1.0 - tilt**2))]
    assert bool(lib.pose_mirror_plane(problem, point, normal, ffi.new("float *"))) == flat
    assert list(normal) == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    assert list(point) == pytest.approx([5.0, 6.0, 7.0])


def bisected(locate, low):
    """The poses on both sides of where a knob, from low on, makes the pose weak: doubled, then by bisection."""
    high = 2.0 * low
    while locate(high).status == OK:
        low, high = high, 2.0 * high
    sides = [locate(low), locate(high)]
    assert [pose.status for pose in sides] == [OK, WEAK]
    for _ in range(20):
        middle = np.sqrt(low * high)
        pose = locate(middle)
        assert pose.status in (OK, WEAK)
        low, high = (middle, high) if pose.status == OK else (low, middle)
        sides[pose.status == WEAK] = pose
    return sides


def test_weak_beyond_a_quarter_of_the_range(core, cube):
    """Ever more noise, near a beacon, where the fields are still more than noise."""
    position, rotation = np.array([0.2, 0.1, 0.3]), Rotation.from_rotvec([0.3, -0.2, 1.1])
    nearest = min(np.linalg.norm(position - b.position_m) for b in cube.beacons)
    fields = fields_at(cube, position[None], Rotation.concatenate([rotation]), 0.0, np.random.default_rng(0))[0]
    sensor = Sensor(core, cube, 1e30)
    sides = bisected(lambda sigma_T: sensor.locate(fields, sigma_T), SIGMA_T)
    deviations = [np.sqrt(np.linalg.eigvalsh(covariance_of(pose)[0])[-1]) / nearest for pose in sides]
    assert deviations == pytest.approx([0.25, 0.25], rel=1e-3)
    assert sides[1].reason == 9


def test_weak_beyond_half_a_radian(core, cube):
    """Axes of the sensor that are ever less known."""
    epoch, sensor = Epoch(cube, 76), Sensor(core, cube, 1e30)

    def locate(axis_sd_rad):
        sensor.site.axis_sd_rad = axis_sd_rad
        return sensor.locate(epoch.field_T, SIGMA_T)

    sides = bisected(locate, 0.05)
    deviations = [np.sqrt(np.linalg.eigvalsh(covariance_of(pose)[1])[-1]) for pose in sides]
    assert deviations == pytest.approx([0.5, 0.5], rel=1e-3)


@pytest.mark.parametrize("beacons", [8, 24])
def test_the_protection_level_is_the_hosts(core, beacons):
    """A fault missed in a thousand rules with eight beacons; noise once in ten million with twenty-four."""
    rng = np.random.default_rng(77)
    cube = sites.load(ROOT / "host/sites/prigge8.toml")
    rows = [
        dataclasses.replace(b, id=f"b{i}", code=2 + i, position_m=b.position_m + rng.normal(0.0, 0.3, 3))
        for i, b in enumerate(cube.beacons * (beacons // 8))
    ]
    site = dataclasses.replace(cube, beacons=tuple(rows))
    sensor, locator, ratios, noise = Sensor(core, site), Locator(site), [], 0
    position, rotation = inside(cube, 0.8, 12, rng)
    for e, field in enumerate(fields_at(site, position, rotation, 10.0 * SIGMA_T, rng)):
        sigma_T = np.full(beacons, 10.0 * SIGMA_T)
        own = sensor.locate(field, sigma_T)
        host = locator.locate(Fields(e, 0.0, tuple(b.id for b in rows), field, sigma_T))
        ratios.append(own.protection_m / host.protection_m)
        radius = np.linalg.cholesky(covariance_of(own)[0])
        noise += own.protection_m < 5.5 * np.linalg.norm(radius)
    print(f"{beacons}: {np.percentile(ratios, [0, 50, 100])}, {noise} of 12 by noise alone")
    assert np.median(ratios) == pytest.approx(1.0, rel=0.005)

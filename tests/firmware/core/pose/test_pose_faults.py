"""The tests of a fit: alarm, drops, gains and protection level against least squares in double precision."""

import dataclasses
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm

from goldfield.locate.fault_statistics import FALSE_ALARM, OF_SENSOR, OF_SINGLE, OF_STRENGTH, OF_WHOLE
from goldfield.locate.protection import level_of
from goldfield.site.model import Survey
from hil_sim.clib import ROOT
from tests.firmware.core.pose.fault_truth import AXES, SKEWS, Truth, field_T
from tests.firmware.core.pose.test_pose import Sensor

SIGMA_T = 2e-8 / np.sqrt(1023)
ENDLESS = 1e30


@pytest.fixture(scope="module")
def declared(mixed_cube):
    """The cube with declared errors of site and sensor."""
    rows = [
        dataclasses.replace(b, survey=Survey(0.001 * (1 + i % 3), 0.002 * (1 + i % 2), 0.003))
        for i, b in enumerate(mixed_cube.beacons)
    ]
    sensor = dataclasses.replace(mixed_cube.sensor, gain_sd=0.004, axis_sd_rad=0.006)
    return dataclasses.replace(mixed_cube, beacons=tuple(rows), sensor=sensor)


class Fitted:
    """A fit by the board and what it says of it, at random in the middle of a site or, with ``spread`` 0, amid it."""

    def __init__(self, core, site, seed, residual_sd=0.0, spread=0.6):
        self.ffi, self.lib = core
        self.sigma_T = np.full(len(site.beacons), SIGMA_T)
        self.site, self.rng = site, np.random.default_rng(seed)
        centres = np.array([b.position_m for b in site.beacons])
        middle, size = centres.mean(axis=0), np.ptp(centres, axis=0)
        self.position = middle + spread * size * (self.rng.random(3) - 0.5)
        self.rotation = Rotation.random(random_state=self.rng)
        clean = np.array([field_T(b, self.position) for b in site.beacons])
        self.clean = self.rotation.inv().apply(clean)
        self.fit_to(self.clean + residual_sd * SIGMA_T * self.rng.normal(size=self.clean.shape))

    def fit_to(self, fields):
        """Fit fields, shape (n, 3), T, from the true pose."""
        self.fields, sensor = fields, Sensor((self.ffi, self.lib), self.site)
        table = [(f.tolist(), s) for f, s in zip(fields, self.sigma_T.tolist(), strict=True)]
        self.problem, self.fit = self.ffi.new("pose_problem_t *"), self.ffi.new("pose_fit_t *")
        self.lib.pose_problem(sensor.site, self.ffi.new("pose_field_t[]", table), self.problem)
        origin = np.array(list(self.problem.origin_m))
        self.fit.position_m = (self.position - origin).tolist()
        self.fit.quaternion = self.rotation.as_quat().tolist()
        self.lib.pose_fit(self.problem, 40, self.fit)
        self.found = origin + np.array(list(self.fit.position_m))
        self.turn = Rotation.from_quat(list(self.fit.quaternion))

    def truth(self):
        """The same around the board's pose, in double."""
        return Truth.around(self.site, self.fields, self.sigma_T, self.found, self.turn)

    def faults(self):
        """What the board says, whatever stood in the struct before, and whatever lies behind the beacons."""
        self.problem.heard[self.problem.count] = self.problem.heard[0]
        self.problem.heard[self.problem.count].field_uT[1] += 1.0
        faults = self.ffi.new("pose_faults_t *")
        self.ffi.memmove(faults, b"\x7f" * self.ffi.sizeof("pose_faults_t"), self.ffi.sizeof("pose_faults_t"))
        assert self.lib.pose_faults(self.problem, self.fit, faults)
        return faults


@pytest.mark.parametrize(("kind", "seed"), [("mixed_cube", 1), ("mixed_cube", 2), ("declared", 3), ("declared", 4)])
def test_drops_and_gains_are_those_of_further_fits(core, kind, seed, request):
    fitted = Fitted(core, request.getfixturevalue(kind), seed, 5.0)
    faults, truth = fitted.faults(), fitted.truth()
    drops = [truth.takes(truth.of_beacon(i))[0] for i in range(8)]
    assert list(faults.drop)[:8] == pytest.approx(drops, rel=2e-3)
    gains = truth.takes(truth.changed(AXES))[1]
    assert list(faults.gain) == pytest.approx(gains, abs=5e-3 * np.linalg.norm(gains))


def level_by_host(truth):
    """The protection level from positions and covariances of fits without each beacon, by the host's rule."""
    _, found, _, covariance = truth.solve()
    apart, more = [], []
    for i in range(len(truth.model)):
        _, other, _, wider = truth.solve(without=i)
        apart.append(found[:3] - other[:3])
        more.append(wider[:3, :3] - covariance[:3, :3])
    hidden = np.zeros((1, len(apart)), dtype=bool)
    return float(level_of(np.array([apart]), np.array([more]), hidden, covariance[None, :3, :3])[0][0])


@pytest.mark.parametrize(
    ("kind", "seed", "noise", "spread"),
    [("mixed_cube", 5, 3.0, 0.6), ("declared", 7, 5.0, 0.6), ("mixed_cube", 6, 0.0, 0.0)],
)
def test_the_protection_level_is_that_of_fits_without_each_beacon(core, kind, seed, noise, spread, request):
    """Amid the cube and without residuals it is that of the noise alone."""
    fitted = Fitted(core, request.getfixturevalue(kind), seed, noise, spread)
    assert fitted.faults().level_m == pytest.approx(level_by_host(fitted.truth()), rel=2e-3)


DIRECTIONS = {
    "whole": lambda fitted, _: Rotation.random(len(fitted.clean), random_state=fitted.rng).as_matrix()[..., 2].ravel(),
    "beacon 2": lambda _, truth: truth.of_beacon(2) @ np.cross(truth.whitening[2] @ truth.model[2], [1, 2, 3]),
    "strength 5": lambda _, truth: truth.strength_of(5)[:, 0],
    "gain": lambda _, truth: truth.changed([np.eye(3)])[:, 0],
    "gains": lambda _, truth: truth.changed([np.diag([1, -1, 0])])[:, 0],
    "gains of the third axis": lambda _, truth: truth.changed([np.diag([1, 1, -2])])[:, 0],
    "skew": lambda _, truth: truth.changed(SKEWS)[:, 0],
    "skew of the second pair": lambda _, truth: truth.changed(SKEWS)[:, 1],
    "skew of the third pair": lambda _, truth: truth.changed(SKEWS)[:, 2],
}
"""Residuals, shape (3n,), that raise one test's statistic more than the others'."""


def leading(fitted, direction, share):
    """The board fits fields whose residual has that test's statistic so far from its limit; returns the truth.

    A skew's is one that no gains take away, the third axis's one that neither strength nor the other two do.
    """
    fitted.fit_to(fitted.clean)
    truth, test = fitted.truth(), direction.split(" of")[0]
    column = DIRECTIONS[direction](fitted, truth)
    before = AXES if test == "skew" else [np.eye(3), np.diag([1, -1, 0])] if "third axis" in direction else []
    others = truth.changed(before) if before else truth.rows[:, :0]
    known = np.linalg.qr(np.hstack([truth.rows, others]))[0]
    truth.residual = column - known @ (known.T @ column)
    residual = np.linalg.solve(truth.whitening, truth.residual.reshape(-1, 3, 1))[..., 0] @ truth.attitude
    for _ in range(3):
        residual = residual * np.sqrt(share / truth.share(test))
        fitted.fit_to(fitted.clean + residual)
        truth = fitted.truth()
    return truth


@pytest.mark.parametrize("share", [0.99, 1.01])
@pytest.mark.parametrize("kind", ["mixed_cube", "declared"])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_alarm_is_raised_beyond_the_limit_of_each_test(core, direction, kind, share, request):
    fitted = Fitted(core, request.getfixturevalue(kind), 11)
    found, test = leading(fitted, direction, share).shares(), direction.split(" of")[0]
    assert max(found, key=found.get) == test
    assert found[test] == pytest.approx(share, abs=5e-3)
    assert sorted(found.values())[-2] < 0.98
    assert fitted.faults().alarm == (share > 1.0)


def rounding_of(share):
    """The rounding of a fit at which a direction with that share of its variance left is at the limit."""
    return float(np.sqrt((share - 3e-6) / 0.3))


@pytest.mark.parametrize(("part", "shown"), [(0.97, True), (1.03, False)])
def test_a_fault_that_rounding_hides_has_no_level(core, mixed_cube, part, shown):
    """The least pivot of what the fit leaves of any beacon's residuals decides."""
    fitted = Fitted(core, mixed_cube, 12, 3.0)
    truth = fitted.truth()
    basis = np.linalg.qr(truth.rows)[0].reshape(8, 3, 6)
    pivots = [np.linalg.cholesky(np.eye(3) - t @ t.T).diagonal() ** 2 for t in basis]
    fitted.fit.rounding = rounding_of(part * np.min(pivots))
    faults = fitted.faults()
    assert (faults.level_m < ENDLESS) == shown
    assert shown or faults.level_m == pytest.approx(ENDLESS)


def seen_of(s, least):
    """The components that are tested of residuals with covariance s: one after another, with enough left by others."""
    seen = []
    for j in range(3):
        own = s[np.ix_(seen, seen)]
        left = s[j, j] - s[j, seen] @ np.linalg.solve(own, s[seen, j]) if seen else s[j, j]
        assert abs(left / least - 1.0) > 0.01
        if left > least:
            seen.append(j)
    return seen


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.6, 0.75, 0.83])
def test_what_rounding_hides_of_a_beacon_counts_for_no_drop(core, mixed_cube, share):
    fitted = Fitted(core, mixed_cube, 12, 5.0)
    truth = fitted.truth()
    basis = np.linalg.qr(truth.rows)[0].reshape(8, 3, 6)
    fitted.fit.rounding = rounding_of(share)
    faults, whole = fitted.faults(), 0
    for i in range(8):
        seen = seen_of(np.eye(3) - basis[i] @ basis[i].T, share)
        expected = truth.takes(truth.of_beacon(i)[:, seen])[0] if seen else 0.0
        assert faults.drop[i] == pytest.approx(expected, rel=5e-3, abs=1e-3)
        whole += len(seen) == 3
    assert whole < 8


@pytest.mark.parametrize(("part", "alarm"), [(0.97, True), (1.03, False)])
@pytest.mark.parametrize("name", ["strength 5", "gain"])
def test_what_rounding_hides_raises_no_alarm(core, mixed_cube, name, part, alarm):
    """A statistic beyond its limit, its column with that share of its square left by the fit."""
    fitted = Fitted(core, mixed_cube, 11)
    truth = leading(fitted, name, 1.1)
    column = truth.columns_of(name)[:, 0]
    left = column - truth.rows @ np.linalg.lstsq(truth.rows, column, rcond=None)[0]
    fitted.fit.rounding = rounding_of(part * (left @ left) / (column @ column))
    assert fitted.faults().alarm == alarm


@pytest.fixture(scope="module")
def coaxial(mixed_cube):
    """Three beacons, two of them on one line along which they point: no turn around it shows without the third."""
    up, rows = np.array([0.0, 0.0, 1.0]), list(mixed_cube.beacons[:3])
    rows[:2] = [dataclasses.replace(b, position_m=z * up, axis=up) for b, z in zip(rows, (0.0, 1.5), strict=False)]
    return dataclasses.replace(mixed_cube, beacons=tuple(rows))


def test_a_fault_that_no_residual_shows_has_no_level(core, coaxial):
    fitted = Fitted(core, coaxial, 13, 2.0)
    faults, truth = fitted.faults(), fitted.truth()
    drops = [truth.takes(truth.of_beacon(i))[0] for i in range(3)]
    assert drops[:2] == pytest.approx([truth.solve()[0]] * 2, rel=1e-3)  # Two beacons leave no residual.
    assert drops[2] < 0.9 * drops[0]
    assert list(faults.drop)[:3] == pytest.approx(drops, rel=5e-3)
    assert faults.level_m == pytest.approx(ENDLESS)


@pytest.mark.parametrize(("share", "alarm"), [(0.98, False), (1.02, True)])
def test_more_changes_than_residuals_take_all_of_the_cost(core, coaxial, share, alarm):
    """Three beacons leave three residuals: the first three changes of the sensor explain them, no other does more."""
    fitted = Fitted(core, coaxial, 20)
    found = leading(fitted, "gains", share).shares()
    assert found["gains"] == pytest.approx(share, abs=5e-3)
    assert max(part for test, part in found.items() if test not in ("whole", "gains")) < 0.95
    assert fitted.faults().alarm == alarm


def flat(core, mixed_cube):
    """All coils lie and point in a plane with the sensor, whose third axis is across it."""
    beacons = [
        dataclasses.replace(b, position_m=b.position_m * [1, 1, 0] + [0.3 * i, 0.1 * i * i, 0], axis=axis)
        for i, (b, axis) in enumerate(zip(mixed_cube.beacons, np.eye(3)[[0, 1, 1, 0, 0, 1, 0, 1]], strict=True))
    ]
    fitted = Fitted(core, dataclasses.replace(mixed_cube, beacons=tuple(beacons)), 15)
    fitted.position, fitted.rotation = np.array([0.9, 0.7, 0.0]), Rotation.from_rotvec([0.0, 0.0, 0.7])
    fitted.clean = fitted.rotation.inv().apply(np.array([field_T(b, fitted.position) for b in beacons]))
    assert np.abs(fitted.clean[:, 2]).max() < 1e-6 * np.abs(fitted.clean).max()
    return fitted


def test_the_gain_of_an_axis_without_fields_is_the_mean_of_the_others(core, mixed_cube):
    fitted = flat(core, mixed_cube)
    fitted.fit_to(fitted.clean + 5.0 * SIGMA_T * fitted.rng.normal(size=(8, 3)) * [1.0, 1.0, 0.0])
    faults, truth = fitted.faults(), fitted.truth()
    gains = truth.takes(truth.changed(AXES[:2]))[1]
    assert list(faults.gain) == pytest.approx([*gains, gains.mean()], abs=5e-3 * np.linalg.norm(gains))


@pytest.mark.parametrize(("share", "alarm"), [(0.98, False), (1.02, True)])
@pytest.mark.parametrize("noise", [1.0, 300.0])
def test_a_gain_that_does_not_show_hides_no_skew(core, mixed_cube, share, alarm, noise):
    """Neither do the two skews of that axis: turns explain them. Whether fields are far above the noise or not."""
    fitted = flat(core, mixed_cube)
    fitted.sigma_T *= noise
    found = leading(fitted, "skew of the third pair", share).shares()
    assert max(found, key=found.get) == "skew"
    assert sorted(found.values())[-2] < 0.95
    assert fitted.faults().alarm == alarm


@pytest.mark.parametrize(("share", "alarm"), [(0.98, False), (1.02, True)])
def test_the_strength_of_a_faint_beacon(core, mixed_cube, share, alarm):
    """Its field is two deviations of its noise."""
    fitted = Fitted(core, mixed_cube, 18)
    fitted.sigma_T[5] = 0.5 * np.linalg.norm(fitted.clean[5])
    found = leading(fitted, "strength 5", share).shares()
    assert max(found, key=found.get) == "strength 5"
    assert sorted(found.values())[-2] < 0.9
    assert fitted.faults().alarm == alarm


def test_the_weights_are_those_around_the_fit(core, declared):
    """Others may have been taken since, elsewhere."""
    fitted = Fitted(core, declared, 19, 5.0)
    drops = list(fitted.faults().drop)[:8]
    fitted.lib.pose_weights_at(fitted.problem, [0.3, -0.2, 0.4])
    assert list(fitted.faults().drop)[:8] == drops


def test_unknowns_that_no_field_tells_have_no_tests(core, mixed_cube):
    fitted = Fitted(core, mixed_cube, 16)
    fitted.fit.triangle.r[5][5] = 0.0
    assert not fitted.lib.pose_faults(fitted.problem, fitted.fit, fitted.ffi.new("pose_faults_t *"))


def test_a_cost_that_is_no_number_raises_the_alarm(core, mixed_cube):
    fitted = Fitted(core, mixed_cube, 17)
    assert not fitted.faults().alarm
    fitted.fit.cost = float("nan")
    assert fitted.faults().alarm


def test_the_limits_of_the_faults_are_those_of_the_hosts_shares():
    """The host shares its false alarms by the number of beacons; the board takes the share of sixteen."""
    source = (ROOT / "firmware/core/pose/pose_faults.c").read_text()
    written = {name: float(value) for name, value in re.findall(r"#define (\w+) +([\d.]+)f", source)}
    whole = norm.isf(OF_WHOLE * FALSE_ALARM)
    beacon, strength = chi2.isf(OF_SINGLE * FALSE_ALARM / 16, 3), chi2.isf(OF_STRENGTH * FALSE_ALARM / 16, 1)
    sensor = [chi2.isf(share * FALSE_ALARM, freedom) for share, freedom in zip(OF_SENSOR, (1, 3, 6), strict=True)]
    names = ("WHOLE_DEVIATE", "LIMIT_BEACON", "LIMIT_STRENGTH", "LIMIT_COMMON", "LIMIT_AXES", "LIMIT_SKEWED")
    assert [written[name] for name in names] == pytest.approx([whole, beacon, strength, *sensor], abs=0.01)

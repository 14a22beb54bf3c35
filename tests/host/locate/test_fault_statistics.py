"""Statistics of faults against fits that admit them: what each unknown that is added takes off the sum of squares.

The reference is dense least squares with the Jacobian by differences of the model's fields, an epoch and a fault at a
time; the kernel in C and the NumPy code are both held to it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.fault_statistics import DETECTABLE, fault_statistics
from goldfield.locate.fit import Measurements, fit_pose
from goldfield.locate.site_errors import errors_of
from goldfield.site import SensorSite
from tests.host.locate import built_sites as built

EPOCHS = 3
LEVERS = 1e-3 * np.array([[12.0, -3.0, 5.0], [-4.0, 15.0, 2.0], [6.0, 2.0, -14.0]])


class Case:
    """Some epochs in the cube, about a standard deviation off their poses, and their whitening as dense matrices."""

    def __init__(self, missing=(), sensor=(), survey=None, levers=False, keep=8):
        rng = np.random.default_rng(7)
        site = built.mixed_cube(2e-7)
        if survey is not None:
            site = built.declared(site, survey, *sensor)
        if levers:
            site = replace(site, sensor=SensorSite(site.sensor.noise_T, lever_m=LEVERS))
        run = built.measured(site, built.inside(site, rng, EPOCHS), rng)
        field = run.field_T.copy()
        for part in missing:
            field[(slice(None), *part)] = np.nan
        field[:, keep:] = np.nan
        self.model, self.position, self.rotation = FieldModel(site.beacons), run.position_m, run.rotation
        # Noises that differ: a weight of the wrong beacon shows.
        sigma = run.sigma_T * np.linspace(1.0, 2.0, 8)
        self.measurements = Measurements(field, sigma).with_errors(self.model, errors_of(site.beacons, site.sensor))

    def slope(self, e):
        """Derivatives of the components of epoch e by the pose, shape (3n, 6)."""
        return np.stack([self.modelled(e, step) - self.modelled(e, -step) for step in np.eye(6) * 1e-5], axis=1) / 2e-5

    def found(self):
        fit = fit_pose(self.model, self.measurements, self.position, self.rotation, iterations=0)
        return fault_statistics(self.model, self.measurements, fit)

    def modelled(self, e, step):
        """Components of epoch e, shape (3n,), beacons last, where the pose is a step off."""
        turn = Rotation.from_rotvec(step[3:]).as_matrix() @ self.rotation[e]
        levers = LEVERS if self.measurements.levers is not None else np.zeros((3, 3))
        read = [(self.model.field(self.position[e] + step[:3] + turn @ lever) @ turn).T for lever in levers]
        return np.stack([read[axis][axis] for axis in range(3)]).ravel()

    def of_epoch(self, e):
        """The truth of one epoch, by the names of the statistics."""
        one, n = self.measurements.take(np.array([e])), len(self.model)
        whiten = one.whitening(self.model, self.position[e : e + 1], self.rotation[e : e + 1])
        dense = whiten(np.eye(3 * n).reshape(1, 3 * n, 3, n))[0].T
        h = self.modelled(e, np.zeros(6))
        residual = dense @ (one.filled_T[0].T.ravel() - np.where(one.measured[0].T.ravel(), h, 0.0))
        slope = dense @ self.slope(e)
        scale = np.linalg.norm(slope, axis=0)
        pose = Admitted(slope / scale, residual)
        told = {name: [] for name in ("drop", "freedom", "scale", "separation_m", "separation_cov_m2")}
        for i in range(n):
            own = dense @ np.eye(3 * n)[:, i::n]
            gone, strength = pose.with_fault(own), pose.with_fault(own @ h[i::n, None])
            told["drop"].append(pose.cost - gone.cost)
            told["freedom"].append(gone.rank - pose.rank)
            told["scale"].append(pose.cost - strength.cost)
            told["separation_m"].append(((pose.unknowns[:6] - gone.unknowns[:6]) / scale)[:3])
            added = (gone.covariance - pose.covariance) / np.outer(scale, scale)
            told["separation_cov_m2"].append(added[:3, :3])
        components = h.reshape(3, n)
        gains = [dense @ (np.diag(row) @ components).ravel() for row in np.eye(3)]
        pairs = [dense @ (np.eye(3)[[[0, 2, 1], [2, 1, 0], [1, 0, 2]][k]] * other @ components).ravel()
                 for k, other in enumerate(1.0 - np.eye(3))]  # fmt: skip
        admitted = [pose.with_fault(np.stack(columns, axis=1)) for columns in ([sum(gains)], gains, gains + pairs)]
        best = [pose.with_fault(gain[:, None]) for gain in gains]
        told["distortion"] = [*(pose.cost - wider.cost for wider in admitted), pose.cost - min(b.cost for b in best)]
        told["distortion_freedom"] = [*(w.rank - pose.rank for w in admitted), max(b.rank for b in best) - pose.rank]
        return told


class Admitted:
    """A sum of squares whose unknowns are a pose and what is wrong."""

    def __init__(self, columns, residual):
        self._columns, self._residual = columns, residual
        left, value, right = np.linalg.svd(columns, full_matrices=False)
        shown = value > 1e-6 * value[0]
        self.rank = int(shown.sum())
        self._left, inverse = left[:, shown], right[shown].T / value[shown]
        self.unknowns = inverse @ (self._left.T @ residual)
        self.cost = float(((residual - columns @ self.unknowns) ** 2).sum())
        self.covariance = (inverse @ inverse.T)[:6, :6]

    def with_fault(self, columns):
        """Also admit what of these columns the pose does not explain, by directions that show or do not."""
        beyond = columns - self._left @ (self._left.T @ columns)
        _, value, right = np.linalg.svd(beyond)
        shown = right[: len(value)][value > 1e-5 * (np.linalg.norm(columns) + 1e-300)]
        added = columns @ shown.T
        size = np.linalg.norm(added, axis=0)
        return Admitted(np.hstack([self._columns, added / size]), self._residual)


CASES = {
    "all": {},
    "one not heard": {"missing": [(3,)]},
    "a component missing": {"missing": [(5, 2)]},
    "two axes": {"missing": [(slice(None), 1)]},
    "one axis": {"missing": [(slice(None), 1), (slice(None), 2)]},
    "two beacons": {"keep": 2},
    "two beacons and a component": {"keep": 3, "missing": [(2, 0), (2, 2)]},
    "three beacons": {"keep": 3},
    "errors of the site": {"survey": built.DECLARED},
    "errors of the sensor": {"survey": built.DECLARED, "sensor": (0.01, 0.02)},
    "errors of the sensor, a component missing": {
        "survey": built.DECLARED, "sensor": (0.01, 0.02), "missing": [(5, 2), (3,)]
    },
    "levers": {"levers": True},
}  # fmt: skip


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_each_statistic_is_what_admitting_the_fault_does(monkeypatch, name, quick):
    if not quick:
        monkeypatch.setattr(kernel, "_library", lambda: None)
    case = Case(**CASES[name])
    found = case.found()
    for e in range(EPOCHS):
        told = {key: np.array(values) for key, values in case.of_epoch(e).items()}
        np.testing.assert_array_equal(found.freedom[e], told["freedom"])
        np.testing.assert_array_equal(found.distortion_freedom[e], told["distortion_freedom"])
        for key in ("drop", "scale", "distortion"):
            np.testing.assert_allclose(getattr(found, key)[e], told[key], rtol=1e-4, atol=1e-5)
        size = np.sqrt(np.einsum("nkk->n", told["separation_cov_m2"]))[:, None] + 1e-9
        np.testing.assert_allclose(found.separation_m[e] / size, told["separation_m"] / size, atol=1e-3)
        both = size[..., None] * size[..., None]
        np.testing.assert_allclose(found.separation_cov_m2[e] / both, told["separation_cov_m2"] / both, atol=1e-3)


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize(("share", "freedom"), [(0.95, 2), (1.05, 3)])
def test_a_fault_shows_by_a_billionth_of_its_variance(monkeypatch, quick, share, freedom):
    """What shows of a third beacon, whose noise is ever less, is least where the pose from two others says least."""
    if not quick:
        monkeypatch.setattr(kernel, "_library", lambda: None)
    case = Case(keep=3)
    for e in range(EPOCHS):
        field, sigma = case.measurements.field_T[e : e + 1], case.measurements.sigma_T[e : e + 1].copy()
        slope = case.slope(e)
        of_others = (slope.reshape(3, 8, 6)[:, 1:3] / sigma[0, 1:3, None]).reshape(6, 6)
        most = np.linalg.norm(slope[0::8] @ np.linalg.inv(of_others), 2) ** 2
        sigma[0, 0] = np.sqrt(most / (1.0 / (share * DETECTABLE) - 1.0))
        measurements = Measurements(field, sigma)
        fit = fit_pose(case.model, measurements, case.position[e : e + 1], case.rotation[e : e + 1], iterations=0)
        assert fault_statistics(case.model, measurements, fit).freedom[0, 0] == freedom


@pytest.mark.parametrize("quick", [False, True])
def test_of_what_cannot_show_nothing_is_told_however_far_off_it_is(monkeypatch, quick):
    """Two beacons fit any pose; here their fields are a hundred million standard deviations off."""
    if not quick:
        monkeypatch.setattr(kernel, "_library", lambda: None)
    case = Case(keep=2)
    case.measurements = Measurements(-case.measurements.field_T, 1e-9 * case.measurements.sigma_T)
    found = case.found()
    for nothing in (found.drop, found.scale, found.separation_m, found.distortion):
        np.testing.assert_array_equal(nothing, np.zeros_like(nothing))

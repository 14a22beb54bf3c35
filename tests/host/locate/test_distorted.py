"""Poses of a sensor that distorts: where the fits end, what they cost and what they take off a budget."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.budget import Budget
from goldfield.locate.distorted import Distorted, fit_distorted
from goldfield.locate.fault_statistics import DISTORTIONS
from goldfield.locate.fit import Measurements
from tests.bench import locate_trials as bench
from tests.host.locate import built_sites as built

SIGMA_T = 6e-9
TRUE = {
    "one gain": (DISTORTIONS[:1], None, 1.3 * np.eye(3)),
    "any": (DISTORTIONS, None, np.array([[1.2, 0.1, 0.05], [0.1, 0.9, -0.08], [0.05, -0.08, 1.1]])),
    "y": (np.diag([0.0, 1.0, 0.0])[None], np.diag([1.0, 0.0, 1.0]), np.diag([1.0, 0.7, 1.0])),
}


class Case:
    def __init__(self, distortion, noise=0.0):
        rng, site = np.random.default_rng(12), built.mixed_cube()
        self.model = FieldModel(site.beacons)
        self.run = bench.trials(site, built.inside(site, rng, 1), rng, sigma_T=0.0)
        field = self.run.field_T @ distortion + noise * rng.normal(size=self.run.field_T.shape)
        field[0, 6] = np.nan
        sigma = SIGMA_T * np.linspace(1.0, 2.0, 8)[None]
        self.measurements = Measurements(field, sigma)
        self.start = self.run.position_m + 0.05 * rng.normal(size=(3, 3)), np.repeat(self.run.rotation, 3, axis=0)

    def fit(self, measurements=None, **how):
        return fit_distorted(self.model, measurements or self.measurements, *self.start, **how)


@pytest.fixture(params=[True, False], ids=["kernel", "numpy"])
def quick(request, monkeypatch):
    if not request.param:
        monkeypatch.setattr(kernel, "_library", lambda: None)
    return request.param


@pytest.mark.parametrize("name", TRUE)
def test_fields_without_noise_have_their_pose_and_distortion(quick, name):
    basis, fixed, true = TRUE[name]
    case = Case(true)
    found = case.fit(basis=basis, fixed=fixed)
    np.testing.assert_allclose(found.position_m, np.repeat(case.run.position_m, 3, axis=0), atol=1e-6)
    np.testing.assert_allclose(found.rotation, np.repeat(case.run.rotation, 3, axis=0), atol=1e-5)
    np.testing.assert_allclose(found.distortion, np.tile(true, (3, 1, 1)), atol=1e-5)
    np.testing.assert_allclose(found.cost, 0.0, atol=1e-3)


@pytest.mark.parametrize("error", [0.0, 0.1])
@pytest.mark.parametrize("name", TRUE)
def test_the_cost_is_the_least_that_scipy_finds(quick, name, error):
    """With a model error each component's variance has that part of the beacon's magnitude more."""
    basis, fixed, true = TRUE[name]
    case = Case(true, 30.0 * SIGMA_T)
    found = case.fit(basis=basis, fixed=fixed, model_error=error).best()
    sigma = np.hypot(case.measurements.sigma_T, error * case.measurements.magnitude_T)[0]
    heard = np.isfinite(case.measurements.field_T[0, :, 0])
    base = np.zeros((3, 3)) if fixed is None else fixed

    def misfit(x):
        turn = Rotation.from_rotvec(x[3:6]).as_matrix() @ case.run.rotation[0]
        seen = case.model.field(case.run.position_m[0] + x[:3]) @ turn
        shown = seen @ (base + np.tensordot(x[6:], basis, axes=1))
        return ((case.measurements.field_T[0] - shown) / sigma[:, None])[heard].ravel()

    start = np.zeros(6 + len(basis))
    start[6] = 1.0
    theirs = least_squares(misfit, start, x_scale="jac", xtol=1e-12, ftol=1e-12, max_nfev=200)
    assert found.cost[0] == pytest.approx(2.0 * theirs.cost, rel=1e-5)
    best = base + np.tensordot(theirs.x[6:], basis, axes=1)
    np.testing.assert_allclose(found.distortion[0], best, atol=2e-3)
    np.testing.assert_allclose(found.position_m[0], case.run.position_m[0] + theirs.x[:3], atol=2e-3)


def test_what_the_fits_take_is_off_the_budget_and_within_it(quick):
    case, budget = Case(1.3 * np.eye(3)), Budget(8)
    before = budget.evaluations(1)
    case.fit(case.measurements.within(budget), basis=DISTORTIONS[:1])
    took = before - budget.evaluations(1)
    assert took % 8 == 0
    assert 3 * 8 * 2 <= took <= 3 * 8 * 61
    few = Budget(8)
    few.spend(before - 8 * 12, 1)
    case.fit(case.measurements.within(few), basis=DISTORTIONS[:1])
    assert few.spent  # each start has four evaluations, and where it ends one more or two
    few.spend(-2 * 3, 8)
    assert not few.spent


@pytest.mark.parametrize("iterations", [0, 2])
def test_no_more_than_the_iterations_are_made(quick, iterations):
    case, budget = Case(1.3 * np.eye(3)), Budget(8)
    before = budget.evaluations(1)
    case.fit(case.measurements.within(budget), basis=DISTORTIONS[:1], iterations=iterations)
    at_the_ends = 2 if quick else 1
    assert before - budget.evaluations(1) == 3 * 8 * (at_the_ends + iterations)


def test_a_hopeless_start_costs_infinitely_much(quick):
    case = Case(1.3 * np.eye(3))
    case.start[0][1] = np.nan
    with np.errstate(all="ignore"):
        found = case.fit(basis=DISTORTIONS[:1])
    assert np.isinf(found.cost).tolist() == [False, True, False]
    assert found.best().cost[0] < 1e-3


def test_the_best_are_those_of_the_lowest_costs_of_all_or_of_the_first():
    costs = np.array([5.0, 2.0, 4.0, 1.0])
    each = costs[:, None, None]
    whole = Distorted(each[:, 0] * np.ones(3), each * np.eye(3), costs, each * np.ones((3, 3)))
    answers = [(whole.best(), [1.0]), (whole.best(3), [1.0, 2.0, 4.0]), (whole.best(2, among=3), [2.0, 4.0])]
    for found, expected in answers:
        assert found.cost.tolist() == expected
        assert found.position_m[:, 0].tolist() == expected
        assert found.rotation[:, 0, 0].tolist() == expected
        assert found.distortion[:, 0, 0].tolist() == expected


def test_distortions_that_look_alike_share_what_the_fields_tell(quick):
    case = Case(1.3 * np.eye(3))
    found = case.fit(basis=np.stack([np.eye(3), np.eye(3)]))
    np.testing.assert_allclose(found.distortion, np.tile(1.3 * np.eye(3), (3, 1, 1)), atol=1e-4)
    np.testing.assert_allclose(found.cost, 0.0, atol=1e-2)

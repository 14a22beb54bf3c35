"""What is known of measurements, what a fit of them costs, and the rounds of a fit with errors of the site."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate import fit as module
from goldfield.locate import kernel
from goldfield.locate.budget import Budget
from goldfield.locate.fit import (
    MOST_ROUNDS,
    SETTLED,
    UNBOUNDED,
    Fit,
    Measurements,
    fit_pose,
    stacked,
    whitened_jacobian,
    whitened_residual,
)
from goldfield.locate.least_squares import Minimum
from goldfield.locate.site_errors import errors_of
from goldfield.locate.whitening import Correlated, Independent
from goldfield.site import SensorSite
from tests.bench import locate_trials as bench
from tests.host.locate import built_sites as built

SIGMA_T = 1e-9
SITE = built.mixed_cube(2e-8)
MODEL = FieldModel(SITE.beacons)
ERRORS = errors_of(built.declared(SITE).beacons, SensorSite(2e-8, 0.01, 0.005))
LEVERS_M = 1e-3 * np.array([[12.0, -3.0, 5.0], [-4.0, 15.0, 2.0], [6.0, 2.0, -14.0]])


@pytest.fixture(scope="module")
def run():
    rng = np.random.default_rng(81)
    return bench.trials(SITE, built.inside(SITE, rng, 4), rng, sigma_T=SIGMA_T)


@pytest.fixture
def numpy_only(monkeypatch):
    monkeypatch.setattr(kernel, "_library", lambda: None)


NONE = np.nan
FIELD_T = np.array(
    [
        [[3.0, 0.0, -4.0], [0.0, 5.0, 0.0], [NONE, NONE, NONE]],
        [[NONE, 6.0, NONE], [NONE, -8.0, NONE], [NONE, 1.0, NONE]],
        [[1.0, 2.0, 2.0], [NONE, 3.0, 4.0], [1.0, 1.0, NONE]],
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 2.0]],
    ]
)


def by_hand():
    return Measurements(FIELD_T, np.full((4, 3), 3.0))


def test_what_is_known_of_measurements_is_counted():
    some = by_hand()
    assert some.known.tolist() == [[True, True, False], [True, True, True], [True, True, True], [True, True, True]]
    assert some.count.tolist() == [6, 3, 7, 9]
    assert some.axes.tolist() == [3, 1, 3, 3]
    assert some.unknowns.tolist() == [6, 5, 6, 6]
    assert some.freedom.tolist() == [0, -2, 1, 3]
    np.testing.assert_allclose(some.magnitude_T, [[5, 5, 0], [6, 8, 1], [3, 5, np.sqrt(2.0)], [0, 1, 2]])
    np.testing.assert_array_equal(some.filled_T, np.nan_to_num(FIELD_T))
    assert [some.take(np.array([e])).complete for e in range(4)] == [True, False, False, True]
    assert not some.complete


def test_an_error_of_the_model_adds_to_that_of_the_noise():
    """The parts are 3 and half of the field: 3, 4, 5 is the oldest of triangles."""
    some = by_hand()
    weight = some.inverse_sigma(0.5)
    assert weight.shape == (4, 3, 3)
    assert weight[1].tolist() == [
        [0.0, 0.0, 0.0],
        [1 / np.hypot(3, 3), 1 / 5.0, 1 / np.hypot(3.0, 0.5)],
        [0.0, 0.0, 0.0],
    ]
    assert weight[2, :, 1].tolist() == [0.0, 1 / np.hypot(3.0, 2.5), 1 / np.hypot(3.0, 2.5)]
    np.testing.assert_allclose(some.inverse_sigma(), np.isfinite(FIELD_T.swapaxes(1, 2)) / 3.0)


def test_measurements_are_taken_in_any_order():
    some = by_hand()
    assert some.take(np.arange(4)) is some
    for rows in ([1, 0, 2, 3], [3, 3], [0, 1, 2], [0, 1, 2, 3, 3], [0, 0, 2, 3], []):
        taken = some.take(np.array(rows, dtype=np.intp))
        np.testing.assert_array_equal(taken.field_T, FIELD_T[rows])
        assert len(taken) == len(rows)
    np.testing.assert_array_equal(
        some.without(np.eye(4, 3, dtype=bool)).field_T[1], [FIELD_T[1, 0], [NONE] * 3, FIELD_T[1, 2]]
    )


def test_what_was_said_of_measurements_stays_with_those_that_are_made_of_them(run):
    """Other fields have other deviations by a factor, some beacons their own errors, and all the same budget."""
    budget = Budget(8)
    noise = SIGMA_T * np.arange(1.0, 9.0) * np.ones((4, 1))
    whole = Measurements(run.field_T, noise).within(budget).with_errors(MODEL, ERRORS)
    assert whole.with_errors(MODEL, None) is whole
    np.testing.assert_allclose(whole.sigma_T**2 - noise**2, ERRORS.isotropic(MODEL, whole.magnitude_T) ** 2)
    np.testing.assert_array_equal(whole.noise_T, noise)
    other = whole.of_fields(2.0 * run.field_T, 3.0)
    np.testing.assert_array_equal(other.field_T, 2.0 * run.field_T)
    np.testing.assert_allclose(other.sigma_T, 3.0 * whole.sigma_T)
    np.testing.assert_allclose(other.noise_T, 3.0 * noise)
    rows = np.array([6, 1])
    few = whole.of_beacons(rows)
    np.testing.assert_array_equal(few.field_T, run.field_T[:, rows])
    np.testing.assert_array_equal(few.noise_T, noise[:, rows])
    np.testing.assert_array_equal(few.errors.current_sd, ERRORS.current_sd[rows])
    assert Measurements(run.field_T, noise).of_beacons(rows).errors is None
    for made in (whole, other, few, whole.take(np.array([1])), whole.without(np.zeros((4, 8), dtype=bool))):
        assert made.budget is budget
        assert made.levers is None
    levers = errors_of(SITE.beacons, SensorSite(2e-8, lever_m=LEVERS_M))
    assert whole.with_errors(MODEL, levers).levers is levers.levers


def test_a_budget_is_shared_by_all_epochs(run):
    free = Measurements(run.field_T, run.sigma_T)
    assert (free.affordable(8, 700), free.affordable_in_all(8)) == (700, UNBOUNDED)
    free.spend(10, 8)
    budget = Budget(8)
    some = free.within(budget)
    assert (some.affordable_in_all(8), some.affordable(8, 10**9), some.affordable(8, 700)) == (25_000, 6_250, 700)
    some.spend(1000, 8)
    assert (some.affordable_in_all(8), some.affordable(8, 10**9)) == (24_000, 6_000)
    assert some.take(np.array([], dtype=np.intp)).affordable(8, 10**9) == 24_000


def test_poses_are_put_and_stacked():
    first, second = (
        Fit(np.full((n, 3), c), np.full((n, 3, 3), c), np.full(n, c), np.full((n, 6, 6), c), np.full(n, c > 1.0))
        for n, c in ((2, 1.0), (3, 2.0))
    )
    both = stacked([first, second])
    assert both.cost.tolist() == [1.0, 1.0, 2.0, 2.0, 2.0]
    assert both.converged.tolist() == [False, False, True, True, True]
    both.put(np.array([0, 4]), both.take(np.array([2, 1])))
    for part in both.parts()[:-1]:
        np.testing.assert_array_equal(part.reshape(5, -1).T, [[2.0, 1.0, 2.0, 2.0, 1.0]] * (part.size // 5))
    assert both.converged.tolist() == [True, False, True, True, False]


def spoiled(run, which):
    field = run.field_T.copy()
    if which == "two axes":
        field[:, :, 1] = np.nan
    if which == "some":
        field[:, 2, 0], field[:, 5] = np.nan, np.nan
    return field


def near(run, rng, metres=0.02, radians=0.02):
    turn = Rotation.from_rotvec(radians * rng.normal(size=(4, 3))) * Rotation.from_matrix(run.rotation)
    return run.position_m + metres * rng.normal(size=(4, 3)), turn.as_matrix()


@pytest.mark.parametrize("library", [True, False])
@pytest.mark.parametrize("which", ["all", "two axes", "some"])
@pytest.mark.parametrize("model_error", [0.0, 0.03])
def test_a_fit_is_the_minimum_that_scipy_finds(run, monkeypatch, library, which, model_error):
    """With deviations of each beacon of its own, with and without an error of the model; what it took is paid."""
    if not library:
        monkeypatch.setattr(kernel, "_library", lambda: None)
    field, sigma = spoiled(run, which), SIGMA_T * np.arange(1.0, 9.0) * np.ones((4, 1))
    position, rotation = near(run, np.random.default_rng(6))
    budget = Budget(8)
    measurements = Measurements(field, sigma, noise_T=7.0 * sigma).within(budget)
    before = budget.evaluations(8)
    found = fit_pose(MODEL, measurements, position, rotation, model_error=model_error)
    assert 4 * 3 < before - budget.evaluations(8) < 4 * 120
    assert found.converged.all()
    np.testing.assert_allclose(
        found.rotation @ found.rotation.swapaxes(1, 2), np.eye(3) * np.ones((4, 1, 1)), atol=1e-12
    )
    weight = 1.0 / np.hypot(sigma, model_error * np.sqrt(np.nansum(field**2, axis=2)))
    known = np.isfinite(field)
    for e in range(4):

        def residual(x, e=e):
            turn = Rotation.from_rotvec(x[3:]).as_matrix() @ rotation[e]
            return ((field[e] - MODEL.field(position[e] + x[:3]) @ turn) * weight[e][:, None])[known[e]]

        theirs = least_squares(residual, np.zeros(6), x_scale=[0.01] * 6, xtol=1e-12, ftol=1e-12)
        assert found.cost[e] == pytest.approx(2 * theirs.cost, rel=1e-3, abs=1e-3)
        np.testing.assert_allclose(found.position_m[e], position[e] + theirs.x[:3], atol=1e-4)
        slope = theirs.jac.T @ theirs.jac
        turned = Rotation.from_rotvec(theirs.x[3:]).as_matrix() @ rotation[e]
        np.testing.assert_allclose(found.rotation[e], turned, atol=1e-4)
        np.testing.assert_allclose(
            found.information[e, :3, :3], slope[:3, :3], rtol=0.02, atol=0.01 * slope[:3, :3].max()
        )


def test_deviations_of_the_noise_alone_count_only_beside_errors_of_the_site(run):
    """And not where the model has an error: then all errors are isotropic."""
    position, rotation = near(run, np.random.default_rng(7), 1e-3, 1e-3)
    off = (run.field_T - MODEL.field(position) @ rotation) ** 2
    noise = np.full((4, 8), SIGMA_T)
    whole = Measurements(run.field_T, noise).with_errors(MODEL, ERRORS)
    for some, model_error, variance in (
        (Measurements(run.field_T, 3.0 * noise, noise), 0.0, 9.0 * noise**2),
        (whole, 0.03, whole.sigma_T**2 + (0.03 * whole.magnitude_T) ** 2),
    ):
        at = fit_pose(MODEL, some, position, rotation, model_error=model_error, iterations=0)
        np.testing.assert_allclose(at.cost, (off / variance[:, :, None]).sum(axis=(1, 2)), rtol=1e-9)


@pytest.mark.parametrize("which", ["all", "two axes", "some"])
def test_a_fit_with_errors_of_the_site_is_the_same_with_and_without_the_library(run, monkeypatch, which):
    """As it is where the axes read at a point each, next to no way from each other."""
    position, rotation = near(run, np.random.default_rng(8))
    measurements = Measurements(spoiled(run, which), run.sigma_T).with_errors(MODEL, ERRORS)
    fits = [fit_pose(MODEL, measurements, position, rotation)]
    with monkeypatch.context() as patch:
        patch.setattr(kernel, "_library", lambda: None)
        fits.append(fit_pose(MODEL, measurements, position, rotation))
    sensor = SensorSite(2e-8, 0.01, 0.005, lever_m=1e-7 * LEVERS_M)
    at_points = errors_of(built.declared(SITE).beacons, sensor)
    fits.append(
        fit_pose(
            MODEL, Measurements(measurements.field_T, run.sigma_T).with_errors(MODEL, at_points), position, rotation
        )
    )
    quick, *others = fits
    assert quick.converged.all()
    for slow in others:
        assert slow.converged.all()
        np.testing.assert_allclose(slow.cost, quick.cost, rtol=1e-3)
        np.testing.assert_allclose(slow.position_m, quick.position_m, atol=2e-5)
        np.testing.assert_allclose(slow.rotation, quick.rotation, atol=2e-5)
        size = np.sqrt(np.einsum("ekk->ek", quick.information))
        relative = (slow.information - quick.information) / (size[:, :, None] * size[:, None, :])
        assert np.abs(relative).max() < 1e-3


def test_where_axes_read_apart_the_fit_is_of_what_they_read(run):
    levers = errors_of(SITE.beacons, SensorSite(2e-8, lever_m=LEVERS_M))
    field = np.stack(
        [
            np.einsum("eck,enc->enk", run.rotation, MODEL.field(run.position_m + run.rotation @ lever))[..., k]
            for k, lever in enumerate(LEVERS_M)
        ],
        axis=2,
    )
    measurements = Measurements(field, run.sigma_T).with_errors(MODEL, levers)
    found = fit_pose(MODEL, measurements, *near(run, np.random.default_rng(9)))
    np.testing.assert_allclose(found.position_m, run.position_m, atol=1e-6)
    np.testing.assert_allclose(found.rotation, run.rotation, atol=1e-6)
    assert (found.cost < 1e-3).all()


class Steps:
    """Stands in for least squares: each call moves the poses by the next step, and notes how many there were."""

    def __init__(self, monkeypatch, *steps, normal=None, evaluations=7):
        self.steps, self.calls = list(steps), []
        self.normal = np.eye(6) if normal is None else normal
        self.evaluations = evaluations
        monkeypatch.setattr(module, "minimise", self)

    def __call__(self, evaluate, retract, start, *, iterations, tolerance):
        count = len(start[0])
        self.calls.append(start[0].copy())
        step = self.steps.pop(0) if self.steps else np.zeros(6)
        state = retract(start, np.broadcast_to(step, (count, 6)))
        cost = np.full(count, float(len(self.calls)))
        normal = np.broadcast_to(self.normal, (count, 6, 6))
        return Minimum(state, cost, normal, np.ones(count, dtype=bool), self.evaluations)


def rounds(run, monkeypatch, *steps, **more):
    faked = Steps(monkeypatch, *steps, **more)
    measurements = Measurements(run.field_T, run.sigma_T).with_errors(MODEL, ERRORS)
    found = fit_pose(MODEL, measurements, run.position_m, run.rotation)
    return len(faked.calls), found


@pytest.mark.parametrize("unknown", range(6))
@pytest.mark.parametrize(("share", "count"), [(0.97, 1), (1.03, 2)])
def test_a_pose_that_moved_by_a_tenth_of_a_deviation_is_fitted_anew(
    run, numpy_only, monkeypatch, unknown, share, count
):
    """Along any of the six unknowns."""
    normal = np.diag(np.where(np.arange(6) == unknown, 1e4, 0.0))
    step = share * np.sqrt(SETTLED) * 1e-2 * np.eye(6)[unknown]
    assert rounds(run, monkeypatch, step, normal=normal)[0] == count


@pytest.mark.parametrize(("sign", "count"), [(1.0, 2), (-1.0, 1)])
@pytest.mark.parametrize("pair", [(0, 3), (1, 4), (2, 5), (3, 4), (4, 5), (3, 5)])
def test_what_is_fixed_of_two_unknowns_together_counts_together(run, numpy_only, monkeypatch, pair, sign, count):
    """Their sum is fixed, their difference is not."""
    both = np.eye(6)[list(pair)]
    normal = 1e4 * np.outer(both.sum(axis=0), both.sum(axis=0))
    step = 0.9e-3 * (both[0] + sign * both[1])
    assert rounds(run, monkeypatch, step, normal=normal)[0] == count


def test_a_pose_that_moved_by_just_as_much_is_not(run, numpy_only, monkeypatch):
    place = np.zeros((4, 3))
    faked = Steps(monkeypatch, 0.125 * np.eye(6)[0], normal=64.0 * SETTLED * np.eye(6))
    measurements = Measurements(run.field_T, run.sigma_T).with_errors(MODEL, ERRORS)
    fit_pose(MODEL, measurements, place, run.rotation)
    assert len(faked.calls) == 1


def test_there_is_an_end_to_the_rounds(run, numpy_only, monkeypatch):
    """Each goes on from where the last one ended; the last fit counts."""
    budget = Budget(8)
    faked = Steps(monkeypatch, *(0.3 * np.eye(6)[[0]] for _ in range(9)), evaluations=11)
    measurements = Measurements(run.field_T, run.sigma_T).within(budget).with_errors(MODEL, ERRORS)
    before, start = budget.evaluations(8), run.position_m.copy()
    found = fit_pose(MODEL, measurements, start, run.rotation)
    assert len(faked.calls) == MOST_ROUNDS
    for k, place in enumerate(faked.calls):
        np.testing.assert_allclose(place, run.position_m + 0.3 * k * np.eye(3)[0])
    np.testing.assert_allclose(found.position_m, run.position_m + 0.3 * MOST_ROUNDS * np.eye(3)[0])
    np.testing.assert_array_equal(found.cost, [MOST_ROUNDS] * 4)
    np.testing.assert_array_equal(start, run.position_m)
    assert before - budget.evaluations(8) == MOST_ROUNDS * (11 + 4)  # and the covariances of the errors, one each


def test_only_poses_that_moved_are_fitted_anew(run, numpy_only, monkeypatch):
    faked = Steps(monkeypatch, np.array([[0.0], [0.3], [0.0], [0.2]]) * np.eye(6)[[1]])
    measurements = Measurements(run.field_T, run.sigma_T).with_errors(MODEL, ERRORS)
    found = fit_pose(MODEL, measurements, run.position_m, run.rotation)
    moved = run.position_m[[1, 3]] + [[0.0, 0.3, 0.0], [0.0, 0.2, 0.0]]
    np.testing.assert_allclose(faked.calls[1], moved)
    assert len(faked.calls) == 2
    assert found.cost.tolist() == [1.0, 2.0, 1.0, 2.0]
    np.testing.assert_allclose(found.position_m[[1, 3]], moved)


def test_whitened_residuals_are_those_of_the_modelled_components(run):
    """Without errors each over its deviation; with them, of a pose that fits, squares add up to the cost."""
    position, rotation = near(run, np.random.default_rng(10), 1e-3, 1e-3)
    plain = Measurements(spoiled(run, "some"), run.sigma_T)
    fit = fit_pose(MODEL, plain, position, rotation, iterations=0)
    whitening = plain.whitening(MODEL, position, rotation)
    assert isinstance(whitening, Independent)
    residual, modelled = whitened_residual(MODEL, plain, fit, whitening)
    truth = MODEL.field(position) @ rotation
    np.testing.assert_allclose(modelled.swapaxes(1, 2), truth, rtol=1e-9)
    off = np.nan_to_num((plain.field_T - truth) / SIGMA_T).swapaxes(1, 2).reshape(4, -1)
    np.testing.assert_allclose(residual, off, rtol=1e-6, atol=1e-6)
    errors = plain.with_errors(MODEL, ERRORS)
    best = fit_pose(MODEL, errors, position, rotation)
    correlated = errors.whitening(MODEL, best.position_m, best.rotation)
    assert isinstance(correlated, Correlated)
    residual, _ = whitened_residual(MODEL, errors, best, correlated)
    np.testing.assert_allclose((residual**2).sum(axis=1), best.cost, rtol=0.02)
    jacobian = whitened_jacobian(MODEL, best.position_m, best.rotation, correlated)
    size = np.sqrt(np.einsum("ekk->ek", best.information))
    more = (jacobian @ jacobian.swapaxes(1, 2) - best.information) / (size[:, :, None] * size[:, None, :])
    assert np.abs(more).max() < 0.02

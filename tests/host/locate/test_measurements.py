"""What is measured of some epochs, and what is made of it: parts, counts, budgets; and fits of whatever there is.

The fits are compared with SciPy's, by the kernel and by the NumPy code.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.budget import Budget
from goldfield.locate.fit import UNBOUNDED, Fit, Measurements, fit_pose, stacked
from goldfield.locate.site_errors import errors_of
from goldfield.site import SensorSite
from tests.bench import locate_trials as bench
from tests.host.locate import built_sites as built

LEVERS = 1e-3 * np.array([[12.0, -3.0, 5.0], [-4.0, 15.0, 2.0], [6.0, 2.0, -14.0]])


def measurements(errors=None, budget=None):
    """Two epochs of four beacons whose every number is another; some are missing."""
    field = np.arange(24.0).reshape(2, 4, 3) + 1.0
    field[0, 1] = np.nan
    field[1, 2, 0] = np.nan
    sigma = np.arange(8.0).reshape(2, 4) + 1.0
    return Measurements(field, sigma, 0.5 * sigma, errors, budget)


def test_what_was_measured_is_counted():
    some = measurements()
    assert len(some) == 2
    assert not some.complete
    assert some.take(np.array([0])).complete
    assert some.known.tolist() == [[True, False, True, True], [True, True, True, True]]
    assert some.count.tolist() == [9, 11]
    assert some.axes.tolist() == [3, 3]
    assert some.unknowns.tolist() == [6, 6]
    assert some.freedom.tolist() == [3, 5]
    np.testing.assert_array_equal(some.filled_T[0, 1], np.zeros(3))
    np.testing.assert_allclose(some.magnitude_T[1, 2], np.hypot(20.0, 21.0))
    assert some.magnitude_T[0, 1] == 0.0


@pytest.mark.parametrize(("axes", "unknowns"), [([2], 5), ([0, 2], 6), ([0, 1, 2], 6)])
def test_the_turn_of_a_sensor_with_one_axis_about_it_is_no_unknown(axes, unknowns):
    field = np.full((1, 4, 3), np.nan)
    field[..., axes] = 1.0
    some = Measurements(field, np.ones((1, 4)))
    assert some.axes.tolist() == [len(axes)]
    assert some.unknowns.tolist() == [unknowns]
    assert some.freedom.tolist() == [4 * len(axes) - unknowns]


def test_weights_are_those_of_the_noise_and_the_models_error():
    some = measurements()
    for error in (0.0, 0.1):
        sigma = np.sqrt(some.sigma_T**2 + (error * some.magnitude_T) ** 2)
        found = some.inverse_sigma(error)
        assert found.shape == (2, 3, 4)
        np.testing.assert_allclose(found[1, 1], 1.0 / sigma[1])
        assert not found[0, :, 1].any()
        assert found[1, 0, 2] == 0.0


def test_parts_of_what_was_measured():
    site = built.declared(built.mixed_cube(), built.DECLARED)
    errors = errors_of(site.beacons[:4], site.sensor)
    errors = replace(errors, position_sd_m=np.arange(4.0))
    budget = Budget(4)
    some = measurements(errors, budget)
    assert some.take(np.arange(2)) is some
    np.testing.assert_array_equal(some.take(np.array([1, 0])).sigma_T, some.sigma_T[::-1])
    for found, rows, beacons in (
        (some.take(np.array([1, 1, 0])), [1, 1, 0], range(4)),
        (some.take(np.array([1])), [1], range(4)),
        (some.of_beacons(np.array([3, 1])), [0, 1], [3, 1]),
    ):
        for name in ("field_T", "sigma_T", "noise_T"):
            np.testing.assert_array_equal(getattr(found, name), getattr(some, name)[np.ix_(rows, beacons)])
        assert found.errors.position_sd_m.tolist() == list(beacons)
        assert found.budget is budget
    thinned = some.without(np.array([[False, False, True, False]] * 2))
    assert np.isnan(thinned.field_T[:, 2]).all()
    assert np.isfinite(thinned.field_T[:, 3]).all()
    assert (thinned.budget, thinned.errors) == (budget, errors)
    np.testing.assert_array_equal(thinned.noise_T, some.noise_T)
    larger = some.of_fields(2.0 * some.field_T, 3.0)
    np.testing.assert_array_equal(larger.field_T, 2.0 * some.field_T)
    np.testing.assert_array_equal(larger.sigma_T, 3.0 * some.sigma_T)
    np.testing.assert_array_equal(larger.noise_T, 3.0 * some.noise_T)
    assert (larger.budget, larger.errors) == (budget, errors)
    assert measurements(errors).within(budget).errors is errors
    assert some.of_beacons(np.array([0])).levers is None
    assert measurements().of_beacons(np.array([0])).errors is None


def test_errors_of_the_site_add_to_the_noise_of_a_search():
    site = built.declared(built.mixed_cube(), built.DECLARED)
    model = FieldModel(site.beacons[:4])
    errors = errors_of(site.beacons[:4], site.sensor)
    some = measurements()
    assert some.with_errors(model, None) is some
    found = some.with_errors(model, errors)
    np.testing.assert_allclose(found.sigma_T**2, some.noise_T**2 + errors.isotropic(model, some.magnitude_T) ** 2)
    np.testing.assert_array_equal(found.noise_T, some.noise_T)


def test_epochs_share_their_budget():
    free = measurements()
    assert (free.affordable(4, 120), free.affordable_in_all(4)) == (120, UNBOUNDED)
    free.spend(1000, 4)
    budget = Budget(4)
    some = measurements(budget=budget)
    left = budget.evaluations(4)
    assert some.affordable_in_all(4) == left
    assert some.affordable(4, 120) == 120
    some.spend(left - 201, 4)
    assert some.affordable(4, 120) == 100
    assert some.take(np.array([1])).affordable(4, 120) == 120
    assert some.take(np.array([], dtype=np.intp)).affordable(4, 300) == 201


def test_poses_are_taken_put_and_stacked():
    def fits(start, count):
        number = start + np.arange(count, dtype=float)
        whole = number[:, None, None]
        flags = number.astype(int) % 2 == 0
        return Fit(number[:, None] * np.ones(3), whole * np.eye(3), number.copy(), whole * np.eye(6), flags)

    both = stacked([fits(0, 2), fits(10, 3)])
    assert both.cost.tolist() == [0.0, 1.0, 10.0, 11.0, 12.0]
    both.put(np.array([1, 3]), fits(20, 2))
    for found, wanted in zip(both.take(np.array([1, 3])).parts(), fits(20, 2).parts(), strict=True):
        np.testing.assert_array_equal(found, wanted)
    assert both.position_m[:, 0].tolist() == [0.0, 20.0, 10.0, 21.0, 12.0]


CASES = {
    "noise": {},
    "model error": {"error": 0.05},
    "a component and a beacon missing": {"missing": [(5, 2), (3,)]},
    "a component missing, model error": {"missing": [(5, 2)], "error": 0.05},
    "errors of the site": {"survey": True},
    "errors of the site, model error": {"survey": True, "error": 0.05},
    "levers": {"levers": True},
}


@pytest.mark.parametrize("quick", [True, False], ids=["kernel", "numpy"])
@pytest.mark.parametrize("name", CASES)
def test_fits_end_where_scipys_do(monkeypatch, name, quick):
    """With errors of the site around the pose that was found: their covariance is that of there."""
    if not quick:
        monkeypatch.setattr(kernel, "_library", lambda: None)
    case, rng, site = CASES[name], np.random.default_rng(15), built.mixed_cube(2e-7)
    if "survey" in case:
        site = built.declared(site, built.DECLARED, 0.01, 0.02)
    if "levers" in case:
        site = replace(site, sensor=SensorSite(site.sensor.noise_T, lever_m=LEVERS))
    model, run = FieldModel(site.beacons), bench.trials(site, built.inside(site, rng, 3), rng)
    field = run.field_T.copy()
    for part in case.get("missing", ()):
        field[(slice(None), *part)] = np.nan
    some = Measurements(field, run.sigma_T * np.linspace(1.0, 2.0, 8))
    some = some.with_errors(model, errors_of(site.beacons, site.sensor))
    error = case.get("error", 0.0)
    budget = Budget(8)
    start = run.position_m + 0.03 * rng.normal(size=(3, 3))
    fit = fit_pose(model, some.within(budget), start, run.rotation, model_error=error)
    assert fit.converged.all()
    assert budget.evaluations(1) < Budget(8).evaluations(1)
    whitening = None if error else some.whitening(model, fit.position_m, fit.rotation)
    levers = LEVERS if "levers" in case else np.zeros((3, 3))
    for e in range(3):
        if whitening is None:
            dense = np.diag(some.inverse_sigma(error)[e].ravel())
        else:
            dense = whitening(np.tile(np.eye(24).reshape(1, 24, 3, 8), (3, 1, 1, 1)))[e].T

        def misfit(x, e=e, dense=dense):
            turn = Rotation.from_rotvec(x[3:]).as_matrix() @ fit.rotation[e]
            place = fit.position_m[e] + x[:3]
            read = np.stack([(model.field(place + turn @ lever) @ turn)[:, k] for k, lever in enumerate(levers)])
            return dense @ (some.filled_T[e].T - np.where(some.measured[e].T, read, 0.0)).ravel()

        theirs = least_squares(misfit, np.zeros(6), x_scale=[0.01] * 6, xtol=1e-12)
        # The last covariance is that of a place up to a tenth of a standard deviation away.
        assert fit.cost[e] == pytest.approx((misfit(np.zeros(6)) ** 2).sum(), rel=1e-3 if "survey" in case else 1e-6)
        assert fit.cost[e] <= 2.0 * theirs.cost + 1e-3 + (0.02 if "survey" in case else 0.0)
        slope = np.stack([(misfit(s) - misfit(-s)) / 2e-5 for s in np.eye(6) * 1e-5], axis=1)
        size = np.linalg.norm(slope, axis=0)
        both = np.outer(size, size)
        near = 1e-3 if "survey" in case else 1e-6
        np.testing.assert_allclose(fit.information[e] / both, slope.T @ slope / both, atol=near)
        np.testing.assert_allclose(fit.rotation[e] @ fit.rotation[e].T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize("quick", [True, False], ids=["kernel", "numpy"])
@pytest.mark.parametrize("survey", [False, True])
def test_what_fits_take_is_within_the_iterations_and_off_the_budget(monkeypatch, quick, survey):
    if not quick:
        monkeypatch.setattr(kernel, "_library", lambda: None)
    rng, site = np.random.default_rng(16), built.mixed_cube(2e-7)
    if survey:
        site = built.declared(site, built.DECLARED)
    model, run = FieldModel(site.beacons), bench.trials(site, built.inside(site, rng, 2), rng)
    some = Measurements(run.field_T, run.sigma_T).with_errors(model, errors_of(site.beacons, site.sensor))
    for iterations in (0, 1, 3):
        budget = Budget(8)
        start = run.position_m + 0.2
        fit = fit_pose(model, some.within(budget), start, run.rotation, iterations=iterations, tolerance=0.0)
        took = (Budget(8).evaluations(1) - budget.evaluations(1)) // 8
        assert 2 * (1 + iterations) <= took <= 2 * 4 * (2 + iterations)
        assert not fit.converged.any()
        assert (fit.position_m == start).all() == (iterations == 0)

"""The C kernel against the NumPy code, which shares no line with it: same poses, statistics and uncertainty."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate import Locator, exclusion, kernel
from goldfield.locate.budget import Budget
from goldfield.locate.constellation import Constellation
from goldfield.locate.distorted import fit_distorted
from goldfield.locate.fault_statistics import DISTORTIONS, alarm, fault_statistics
from goldfield.locate.fit import Fit, Measurements, fit_pose
from goldfield.locate.site_errors import errors_of
from goldfield.locate.uncertainty import second_order_covariance
from goldfield.site import HalfSpace
from tests.bench import locate_trials as bench


@pytest.fixture
def numpy_only(monkeypatch):
    """Returns a switch: as if the library had not been built."""
    return lambda: monkeypatch.setattr(kernel, "_library", lambda: None)


def random_room(rng, count):
    """Coils of any axis, size and sense around a volume of some metres, with noise that leaves a pose well known."""
    beacons = [
        bench.loop_beacon(
            i,
            rng.uniform([0, 0, 0], [3, 3, 2]),
            rng.normal(size=3),
            radius=rng.uniform(0.02, 0.3),
            current=rng.choice([-1, 1]) * rng.uniform(2, 10),
        )
        for i in range(count)
    ]
    return bench.site_of(beacons, HalfSpace(np.zeros(3), np.array([0.0, 0.0, 1.0])), 2e-8)


def measured(site, rng, count, axes=(0, 1, 2)):
    position = rng.uniform([0.2, 0.2, 0.2], [2.8, 2.8, 1.8], size=(count, 3))
    run = bench.trials(site, position, rng, axes=axes)
    return run, Measurements(run.field_T, run.sigma_T)


def scaled(covariance, by):
    """Covariance in units of the standard deviations of another."""
    scale = 1.0 / np.sqrt(np.einsum("ekk->ek", by))
    return covariance * scale[:, :, None] * scale[:, None, :]


def test_the_library_is_built_and_used():
    site = bench.prigge_cube()
    assert kernel.of(FieldModel(site.beacons)) is not None
    assert kernel.of(FieldModel(bench.spiral_board().beacons)) is None  # coils given by their wire


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(4, 10), kind=st.sampled_from(["exact", "dipole"]))
def test_fits_from_the_same_start_agree(seed, count, kind):
    rng = np.random.default_rng(seed)
    site = random_room(rng, count)
    run, measurements = measured(site, rng, 5)
    model = FieldModel(site.beacons, kind)
    position = run.position_m + 0.005 * rng.normal(size=run.position_m.shape)
    rotation = (Rotation.from_rotvec(0.01 * rng.normal(size=(5, 3))) * Rotation.from_matrix(run.rotation)).as_matrix()
    constellation = Constellation(model)

    def everything():
        at = constellation.at(measurements, position, rotation)
        statistics = fault_statistics(model, measurements, at)
        return at, statistics, second_order_covariance(model, measurements, position, rotation)

    quick, of_faults, covariance = everything()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernel, "_library", lambda: None)
        slow, of_faults_slow, covariance_slow = everything()
    np.testing.assert_allclose(quick.rotation, slow.rotation, atol=1e-12)
    np.testing.assert_allclose(quick.cost, slow.cost, rtol=1e-7)
    size = np.sqrt(np.einsum("ekk->ek", slow.information))
    relative = (quick.information - slow.information) / (size[:, :, None] * size[:, None, :])
    assert np.abs(relative).max() < 1e-8
    np.testing.assert_array_equal(of_faults.freedom, of_faults_slow.freedom)
    np.testing.assert_array_equal(of_faults.distortion_freedom, of_faults_slow.distortion_freedom)
    largest = 1.0 + of_faults_slow.drop.max()
    for name in ("drop", "scale", "distortion"):
        mine, reference = getattr(of_faults, name), getattr(of_faults_slow, name)
        np.testing.assert_allclose(mine, reference, rtol=1e-4, atol=1e-6 * largest)
    largest = np.sqrt(np.einsum("enkk->en", of_faults_slow.separation_cov_m2) + 1e-30)[..., None]
    np.testing.assert_allclose(of_faults.separation_m / largest, of_faults_slow.separation_m / largest, atol=1e-4)
    both = largest[..., None] * largest[..., None]
    np.testing.assert_allclose(of_faults.separation_cov_m2 / both, of_faults_slow.separation_cov_m2 / both, atol=1e-4)
    difference = scaled(covariance - covariance_slow, covariance_slow)
    assert np.abs(difference).max() < 1e-5


@pytest.mark.parametrize("noise", [2e-7, 2e-8])
@pytest.mark.parametrize("spoiled", ["nothing", "a beacon", "an axis", "a component"])
def test_searches_end_at_the_same_pose(numpy_only, noise, spoiled):
    site, rng = bench.prigge_cube(noise), np.random.default_rng(61)
    run = bench.trials(site, bench.cube_positions(rng, 30, 1.5), rng)
    field = run.field_T.copy()
    if spoiled == "a beacon":
        field[:, 3] = np.nan
    elif spoiled == "an axis":
        field[:, :, 1] = np.nan
    elif spoiled == "a component":
        field[:, 5, 2] = np.nan
    epochs = bench.fields_of(site, bench.Trials(run.position_m, run.rotation, field, run.sigma_T))
    quick = Locator(site).locate_many(epochs)
    numpy_only()
    slow = Locator(site).locate_many(epochs)
    for mine, reference in zip(quick, slow, strict=True):
        assert (mine.status, mine.used, mine.excluded) == (reference.status, reference.used, reference.excluded)
        sigma = np.sqrt(np.diag(reference.position_cov_m2))
        assert (np.abs(mine.position_m - reference.position_m) < 0.01 * sigma).all()
        turn = Rotation.from_quat(mine.orientation_xyzw) * Rotation.from_quat(reference.orientation_xyzw).inv()
        assert turn.magnitude() < 0.02 * np.sqrt(np.trace(reference.attitude_cov_rad2))
        # The kernel's search widens the covariance where the valley bends, which it does with much noise.
        added = np.linalg.eigvalsh(mine.position_cov_m2 - reference.position_cov_m2) / sigma.max() ** 2
        assert added.min() > -1e-3
        assert added.max() < (1e-3 if noise == 2e-8 else 1.0)
        assert mine.residual == pytest.approx(reference.residual, rel=1e-5)


@pytest.mark.parametrize("which", [slice(0, 1), slice(0, 6)], ids=["one gain", "any"])
def test_fits_of_a_distorted_sensor_agree_and_find_it(numpy_only, which):
    rng = np.random.default_rng(11)
    site = random_room(rng, 7)
    run, measurements = measured(site, rng, 1)
    distortion = np.diag([1.3, 0.9, 0.7]) if which.stop == 6 else 1.2 * np.eye(3)
    seen = measurements.of_fields(measurements.field_T @ distortion)
    model = FieldModel(site.beacons)
    starts = run.position_m + 0.1 * rng.normal(size=(4, 3)), np.repeat(run.rotation, 4, axis=0)
    quick = fit_distorted(model, seen, *starts, basis=DISTORTIONS[which]).best()
    numpy_only()
    slow = fit_distorted(model, seen, *starts, basis=DISTORTIONS[which]).best()
    np.testing.assert_allclose(quick.cost, slow.cost, rtol=1e-3)
    np.testing.assert_allclose(quick.distortion, slow.distortion, atol=1e-4)
    np.testing.assert_allclose(slow.distortion[0], distortion, atol=0.02)
    assert np.linalg.norm(quick.position_m - run.position_m) < 0.01


@pytest.mark.parametrize("starts", [0, 1, 2])
@pytest.mark.parametrize(("fault", "exact", "most"), [("dead", True, None), ("dead", False, 900), ("all", True, None)])
def test_subsets_are_compared_alike(monkeypatch, starts, fault, exact, most):
    """One beacon dead, or all fields in other places: then all is hopeless. The errors of a site count, and a budget.

    The single fits are the kernel's in both cases.
    """
    rng = np.random.default_rng(66)
    site = random_room(rng, 8)
    run, measurements = measured(site, rng, 1)
    model, everyone = FieldModel(site.beacons), np.arange(8)
    field = run.field_T.copy()
    if fault == "all":
        field = field[:, rng.permutation(8)]
    else:
        field[:, 3] = run.sigma_T[0, 0] * rng.normal(size=3)
    errors = None if exact else errors_of(site.beacons, replace(site.sensor, gain_sd=0.01, axis_sd_rad=0.01))
    measurements = Measurements(field, run.sigma_T).with_errors(model, errors)
    thinned = measurements.take(np.zeros(8, dtype=np.intp)).without(np.eye(8, dtype=bool))
    place = run.position_m + 0.2 * rng.normal(size=(8 * (starts + 1), 3))
    nothing = np.full(len(place), np.inf), np.zeros((len(place), 6, 6)), np.zeros(len(place), dtype=bool)
    fits = Fit(place, np.repeat(run.rotation, len(place), axis=0), *nothing)

    def compared():
        budget = None if most is None else Budget(8)
        if budget is not None:
            budget.spend(budget.evaluations(8) - most, 8)
        given = thinned if budget is None else thinned.within(budget)
        best = fit_pose(model, given, place[:8], fits.rotation[:8], model_error=0.03, iterations=3, tolerance=1e-2)
        found = exclusion._compared(Constellation(model), given, best, fits.take(np.arange(8, len(place))), everyone)
        return found, None if budget is None else budget.evaluations(8)

    quick, left = compared()
    monkeypatch.setattr(exclusion, "kernel", SimpleNamespace(of=lambda _: None))
    slow, left_slow = compared()
    assert quick.hopeless is slow.hopeless is (fault == "all")
    assert left == left_slow
    np.testing.assert_array_equal(quick.left_out, slow.left_out)
    for one, other in zip(quick.fit.parts(), slow.fit.parts(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_starts_are_those_of_the_steps(numpy_only):
    site, rng = bench.ceiling_lattice(), np.random.default_rng(62)
    run = bench.trials(site, bench.lattice_positions(rng, 40), rng)
    constellation, measurements = Constellation(FieldModel(site.beacons)), Measurements(run.field_T, run.sigma_T)
    quick = constellation.from_magnitudes(measurements)
    numpy_only()
    slow = constellation.from_magnitudes(measurements)
    same = np.abs(quick.position_m - slow.position_m).max(axis=1) < 1e-3
    assert same.mean() > 0.9  # a start near a watershed may end on either side
    np.testing.assert_allclose(quick.cost[same], slow.cost[same], rtol=1e-4)


def test_alarms_are_the_same(numpy_only):
    site, rng = bench.prigge_cube(), np.random.default_rng(63)
    run = bench.trials(site, bench.cube_positions(rng, 200), rng)
    bad = bench.with_fault("current", site, run, rng, 4)
    constellation, measurements = Constellation(FieldModel(site.beacons)), Measurements(bad.field_T, bad.sigma_T)
    fit = constellation.from_magnitudes(measurements)
    model = constellation.model
    quick = alarm(measurements, fit.cost, fault_statistics(model, measurements, fit))
    numpy_only()
    assert 20 < quick.sum() < 200
    np.testing.assert_array_equal(quick, alarm(measurements, fit.cost, fault_statistics(model, measurements, fit)))


def test_a_hopeless_start_is_no_pose():
    site, rng = bench.prigge_cube(), np.random.default_rng(64)
    run = bench.trials(site, bench.cube_positions(rng, 2), rng)
    quick = kernel.of(FieldModel(site.beacons))
    start = np.array([[np.nan, 0.0, 0.0], run.position_m[1]])
    fitted = quick.fit(
        run.field_T,
        run.sigma_T,
        start,
        run.rotation,
        errors=None,
        model_error=0.0,
        iterations=120,
        tolerance=1e-6,
    )
    assert not np.isfinite(fitted[2][0])
    assert not fitted[4][0]
    assert fitted[4][1]


def test_more_coils_than_the_kernel_takes_are_left_to_numpy():
    beacons = [bench.loop_beacon(i, (0.5 * i, 0.0, 0.0)) for i in range(kernel.MOST_COILS + 1)]
    assert kernel.of(FieldModel(beacons)) is None
    assert kernel.of(FieldModel(beacons[:-1])) is not None


@pytest.mark.parametrize("kind", ["exact", "dipole"])
def test_field_and_gradient_at_points_are_those_of_the_model(kind, numpy_only):
    rng = np.random.default_rng(8)
    model = FieldModel(random_room(rng, 5).beacons, kind)
    points = rng.uniform(-1.0, 3.0, size=(3, 2, 4))
    field, gradient = kernel.evaluate(model, points)
    numpy_only()
    for found, right in zip((field, gradient), kernel.evaluate(model, points), strict=True):
        assert found.shape == right.shape
        assert not np.array_equal(found, right)  # it was the kernel that found it
        assert found == pytest.approx(right, rel=1e-9, abs=1e-12 * np.abs(right).max())
    assert kernel.evaluate(model, points[:, 0, 0])[0].shape == (3, 5)


@pytest.mark.parametrize("quick", [True, False])
def test_the_uncertainty_of_a_pose_on_a_wire_is_finite(numpy_only, quick):
    """The model has no value on the wire itself: nothing is told there, and nothing fails."""
    if not quick:
        numpy_only()
    site, rng = bench.prigge_cube(), np.random.default_rng(65)
    first = site.beacons[0]
    off = np.concatenate([[0.0], 10.0 ** np.arange(-16.0, -5.0, 0.05)])
    around = rng.uniform(0.0, 2.0 * np.pi, size=len(off))
    ring = first.radius_m + off * np.cos(around)
    position = first.position_m + np.stack([ring, np.zeros(len(off)), off * np.sin(around)], axis=1)
    run, model = bench.trials(site, bench.cube_positions(rng, len(off)), rng), FieldModel(site.beacons)
    with np.errstate(all="ignore"):
        fitted = np.flatnonzero(np.isfinite(model.field(position)).all(axis=(1, 2)))  # a fit ends nowhere else
        assert 0 < len(fitted) < len(off)
        errors = errors_of(site.beacons, replace(site.sensor, gain_sd=0.03, axis_sd_rad=0.03))
        measurements = Measurements(run.field_T, run.sigma_T, errors=errors).take(fitted)
        pose = position[fitted], run.rotation[fitted]
        covariance = second_order_covariance(model, measurements, *pose)
        nothing = np.zeros(len(fitted)), np.zeros((len(fitted), 6, 6)), np.ones(len(fitted), dtype=bool)
        statistics = fault_statistics(model, measurements, Fit(*pose, *nothing))
    assert np.isfinite(covariance).all()
    assert (np.einsum("ekk->ek", covariance) >= 0.0).all()
    assert np.isfinite(statistics.drop).all()
    assert np.isfinite(statistics.separation_cov_m2).all()

"""The fit of the edge: bins by the exact response of a low-pass to a ramp, and the scatter of many fits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from hil_sim import clib

CHIP, BURST, LAG = 16422.0, 2400.0, 267.0
PHASE = (np.arange(32) + 0.5) / 32 - 0.5
AT = (np.arange(3)[:, None] + (PHASE + 0.5)) * 341.0
"""Chips of the record at which the bins are seen, shape (3, 32)."""


TRUTH = np.array([-2500.0, 1.0, 4000.0])


@pytest.fixture(scope="module")
def core():
    return clib.load("libgf_core.so", ("core/timing/edge_fit.h",))


def done(rise):
    """Return a function that gives the integral of the share of the change that is done at times behind the onset."""
    time = np.arange(-20000.0, 20000.0, 2.0)
    after, before = np.clip(time, 0.0, None), np.clip(time - rise, 0.0, None)
    height = [t - LAG * (1.0 - np.exp(-t / LAG)) for t in (after, before)]
    integral = cumulative_trapezoid((height[0] - height[1]) / rise, time, initial=0.0)
    return lambda t: np.interp(t, time, integral)


def shown(onset, slip, rise):
    """Return what the bins show of level and step, shapes (3, 32)."""
    integral = done(rise)
    t = PHASE * CHIP - onset - slip * (AT - 511.0)
    late, middle, early = integral(t + BURST / 2), integral(t), integral(t - BURST / 2)
    return (late - early) / BURST, (late - 2.0 * middle + early) * 2.0 / BURST


def fitted(core, level, step, weight=None, keep=slice(None), keep_steps=slice(None)):
    """Fit bins; return whether an edge was found, onset, slip and rise, and their covariance."""
    ffi, lib = core
    weight = np.ones((3, 32)) if weight is None else weight
    profile, fit = ffi.new("edge_profile_t *"), ffi.new("edge_fit_t *")
    for name, seen, kept in (("level", level, keep), ("step", step, keep_steps)):
        bins = np.frombuffer(ffi.buffer(getattr(profile, name)), dtype=np.float32).reshape(96, 4)
        rows = np.stack([seen * weight, weight, PHASE * weight, AT * weight], axis=-1).reshape(96, 4)
        bins[kept] = rows[kept]
    shape = ffi.new("edge_shape_t *", [CHIP, BURST, LAG])
    found = lib.edge_fit(profile, shape, fit)
    values = np.array([fit.onset_ticks, fit.slip_ticks_per_chip, fit.rise_ticks])
    return found, values, np.frombuffer(ffi.buffer(fit.covariance), dtype=np.float32).reshape(3, 3).astype(float)


@pytest.mark.parametrize("rise", [600.0, 2000.0, 5000.0, 7500.0])
@pytest.mark.parametrize(("off", "slip"), [(-1000.0, 0.0), (-300.0, 2.5), (300.0, -2.0), (1000.0, 0.5)])
def test_an_edge_without_noise_is_found(core, off, slip, rise):
    """The middle of the frame is about that of the edge. Nothing is left but the error of the short exponential; sums
    of weights bring the bins to their scale."""
    onset = off - 0.5 * rise
    for weight in (None, np.random.default_rng(1).uniform(0.5, 2.0, (3, 32)) * 1e4):
        found, values, _ = fitted(core, *shown(onset, slip, rise), weight)
        assert found
        assert values[0] == pytest.approx(onset, abs=6000.0 / rise)
        assert values[1] == pytest.approx(slip, abs=0.003)
        assert values[2] == pytest.approx(rise, abs=12000.0 / rise)


@pytest.mark.parametrize(
    ("slip", "rise", "limited"),
    [
        (0.0, 60.0, (0.0, 300.0)),
        (0.0, 11000.0, (0.0, 8000.0)),
        (6.0, 4000.0, (5.0, 4000.0)),
        (-6.0, 4000.0, (-5.0, 4000.0)),
        (4.8, 4000.0, None),
        (-4.8, 4000.0, None),
        (0.0, 380.0, None),
        (0.0, 7900.0, None),
    ],
)
def test_rise_and_slip_stay_within_their_limits(core, slip, rise, limited):
    """Beyond a limit it is the limit; within it the values are found, to the error of the short exponential."""
    _, values, _ = fitted(core, *shown(-0.5 * rise, slip, rise))
    if limited is None:
        assert values[1:] == pytest.approx([slip, rise], abs=30.0)
        assert values[1] == pytest.approx(slip, abs=0.01)
    else:
        assert (values[2] if slip == 0.0 else values[1]) == (limited[1] if slip == 0.0 else limited[0])


def scattered(core, level_noise, step_noise, weight, **keep):
    """Fit an edge many times; return the errors of onset, slip and rise, and the covariances that the fits told."""
    rng = np.random.default_rng(2)
    level, step = shown(*TRUTH)
    errors, told = [], []
    for _ in range(400):
        noisy = [
            seen + rng.normal(0.0, noise, (3, 32)) / np.sqrt(weight)
            for seen, noise in ((level, level_noise), (step, step_noise))
        ]
        found, values, covariance = fitted(core, *noisy, weight, **keep)
        assert found
        errors.append(values - TRUTH)
        told.append(covariance)
    return np.array(errors), np.mean(told, axis=0)


@pytest.mark.parametrize(("level_noise", "step_noise"), [(0.02, 0.02), (0.2, 0.01), (0.01, 0.1)])
def test_the_scatter_of_fits_is_what_they_tell_and_no_more_than_must_be(core, level_noise, step_noise):
    """Levels and steps count by the noise that they have, of which nothing is told to the fit."""
    weight = np.random.default_rng(4).uniform(0.5, 2.0, (3, 32))
    errors, told = scattered(core, level_noise, step_noise, weight)
    scatter, size = np.cov(errors.T), errors.std(axis=0)
    np.testing.assert_allclose(np.sqrt(np.diag(told)), size, rtol=0.12)
    np.testing.assert_allclose(told / np.outer(size, size), scatter / np.outer(size, size), atol=0.2)
    assert (np.abs(errors.mean(axis=0)) < 4.0 * size / 20.0 + [2.0, 0.003, 4.0]).all()
    slopes = []
    for by in np.diag([10.0, 0.05, 20.0]):
        more, less = shown(*(TRUTH + by)), shown(*(TRUTH - by))
        slopes.append(
            [
                (a - b) / (2.0 * by.sum()) * np.sqrt(weight) / noise
                for a, b, noise in zip(more, less, (level_noise, step_noise), strict=True)
            ]
        )
    jacobian = np.array(slopes).reshape(3, -1)
    np.testing.assert_allclose(size, np.sqrt(np.diag(np.linalg.inv(jacobian @ jacobian.T))), rtol=0.12)


def test_a_few_bins_tell_no_more_than_they_know(core):
    """Twelve levels lose three degrees of freedom; the steps are all noise."""
    errors, told = scattered(core, 0.02, 3.0, np.ones((3, 32)), keep=np.linspace(8, 87, 12).astype(int))
    np.testing.assert_allclose(np.sqrt(np.diag(told)), errors.std(axis=0), rtol=0.15)


@pytest.mark.parametrize("scale", [1e-3, 1.0])
def test_an_edge_is_there_while_less_than_half_of_the_levels_variance_is_unexplained(core, scale):
    """Noise of the levels alone, ever larger: where it turns, half is left by the best pose of the edge."""
    noise = np.random.default_rng(3).normal(size=(3, 32))
    level, step = shown(*TRUTH)
    low, high, weight = 0.0, 5.0, np.full((3, 32), scale)
    assert not fitted(core, level + high * noise, step, weight)[0]
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fitted(core, level + middle * noise, step, weight)[0] else (low, middle)
    seen = level + low * noise
    left = ((seen - shown(*fitted(core, seen, step, weight)[1])[0]) ** 2).sum()
    assert left / ((seen - seen.mean()) ** 2).sum() == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(("bins", "found"), [(0, False), (3, False), (4, True), (96, True)])
@pytest.mark.parametrize("which", ["keep", "keep_steps"])
def test_more_bins_than_unknowns_are_needed(core, bins, found, which):
    keep = np.linspace(8, 87, bins).astype(int) if bins < 96 else slice(None)
    told, values, _ = fitted(core, *shown(*TRUTH), **{which: keep})
    assert told == found
    if found:
        assert values[0] == pytest.approx(TRUTH[0], abs=6.0)

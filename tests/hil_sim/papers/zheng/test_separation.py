"""Separation of rotating beacons: exact in any window, honest about its noise, the FFT only where it is exact."""

import numpy as np
import pytest

from goldfield.access import Access
from goldfield.errors import UserError
from hil_sim.papers.zheng.methods.separation import RotatingSeparator, separate_by_fft

FREQUENCY = (25.0, 20.0, 30.0)
EARTH = np.array([18e-6, 2e-6, -44e-6])


def sampled(times, seed=1, noise=0.0, epochs=1):
    """Fields of any size below 1 uT beside the earth's, and their samples."""
    rng = np.random.default_rng(seed)
    field = rng.normal(size=(epochs, 3, 2, 3)) * 1e-7
    turn = 2 * np.pi * np.outer(times, FREQUENCY)
    samples = EARTH + np.einsum("tn,enj->etj", np.cos(turn), field[:, :, 0])
    samples += np.einsum("tn,enj->etj", np.sin(turn), field[:, :, 1])
    return field, samples + noise * rng.normal(size=samples.shape)


@pytest.mark.parametrize("window_s", [0.23, 0.2, 1.0, 1.037])
def test_least_squares_is_exact_in_any_window(window_s):
    times = 12.3 + np.arange(round(window_s * 200)) / 200
    field, samples = sampled(times)
    separation = RotatingSeparator(FREQUENCY, times, 3e-9).separate(samples)
    np.testing.assert_allclose(separation.field_T, field, atol=1e-17)
    np.testing.assert_allclose(separation.offset_T[0], EARTH, rtol=1e-12)


def test_least_squares_takes_times_at_any_distance():
    times = np.sort(np.random.default_rng(2).uniform(0, 1, 60))
    field, samples = sampled(times)
    np.testing.assert_allclose(RotatingSeparator(FREQUENCY, times, 3e-9).separate(samples).field_T, field, atol=1e-16)


def test_it_is_an_access_like_the_others_and_does_without_missing_samples():
    times = np.arange(100) / 200
    field, samples = sampled(times)
    samples[0, [3, 50, 51], 1] = np.nan
    access: Access = RotatingSeparator(FREQUENCY, times, 3e-9)
    separation = access.from_samples(samples[0])
    np.testing.assert_allclose(separation.field_T, field[0].reshape(6, 3), atol=1e-16)
    np.testing.assert_allclose(separation.offset_T, EARTH, rtol=1e-12)
    assert access.covariance_T2.shape == (6, 6)


@pytest.mark.parametrize("count", [31, 46, 200])
def test_sigma_is_the_spread_of_the_estimates(count):
    times = np.arange(count) / 200
    field, samples = sampled(times, noise=3e-9, epochs=3000)
    separation = RotatingSeparator(FREQUENCY, times, 3e-9).separate(samples)
    spread = (separation.field_T - field).std(axis=(0, 3)).max(axis=1)
    np.testing.assert_allclose(separation.sigma_T, spread, rtol=0.05)


@pytest.mark.parametrize("start_s", [0.0, 0.0137])
def test_fft_agrees_with_least_squares_over_whole_periods(start_s):
    times = start_s + np.arange(80) / 200  # 0.4 s
    field, samples = sampled(times, noise=3e-9)
    by_fft = separate_by_fft(samples, 200.0, FREQUENCY, 3e-9, start_s)
    by_squares = RotatingSeparator(FREQUENCY, times, 3e-9).separate(samples)
    np.testing.assert_allclose(by_fft.field_T, by_squares.field_T, atol=1e-17)
    np.testing.assert_allclose(by_fft.offset_T, by_squares.offset_T, rtol=1e-12)
    np.testing.assert_allclose(by_fft.sigma_T, by_squares.sigma_T, rtol=1e-9)
    np.testing.assert_allclose(by_fft.field_T, field, atol=5 * by_fft.sigma_T[0])


def test_fft_refuses_a_window_of_broken_periods():
    with pytest.raises(UserError, match=r"0\.23 s holds 5\.75 periods of the beacon at 25 Hz.*least squares"):
        separate_by_fft(np.zeros((1, 46, 3)), 200.0, FREQUENCY, 3e-9)


def test_fft_refuses_a_rate_below_twice_the_frequency():
    with pytest.raises(UserError, match="30 Hz needs more than 60 samples a second"):
        separate_by_fft(np.zeros((1, 60, 3)), 60.0, FREQUENCY, 3e-9)


@pytest.mark.parametrize(
    ("frequency", "times", "message"),
    [
        ((25.0, 25.0), np.arange(200) / 200, "same frequency"),
        ((25.0, -1.0), np.arange(200) / 200, "above zero"),
        (FREQUENCY, np.arange(7) / 200, "7 samples cannot be separated.*at least 8"),
        (FREQUENCY, np.arange(200) / 20000, "too short or sampled too slowly"),
        ((25.0, 75.0), np.arange(200) / 100, "sampled too slowly"),
    ],
)
def test_what_cannot_be_separated_is_refused(frequency, times, message):
    with pytest.raises(UserError, match=message):
        RotatingSeparator(frequency, times, 3e-9)

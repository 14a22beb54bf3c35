"""Ambient field and front end: statistics, spectrum, step response."""

from __future__ import annotations

import numpy as np
import pytest

from hil_sim import clib

PS = 10**12


@pytest.fixture(scope="module")
def lib():
    return clib.load("build/libgf_rig.so", ["world/front_end.h", "world/ambient.h"])


def front_end(lib, seed=3, **values):
    ffi, library = lib
    config = {"gain": np.eye(3).tolist(), "offset_T": [0.0] * 3, "range_T": 2e-4, "noise_T": 0.0}
    result = ffi.new("front_end_t *")
    library.front_end_init(result, ffi.new("front_end_config_t *", config | values), seed, 0)
    return result


def field_of(volts):
    return (np.asarray(volts) / 1.65 - 1.0) * 2e-4


def bursts(lib, sensor, count, field=(0.0, 0.0, 0.0)):
    """Volts of shape (count, 8, 3): eight conversions, 1.5 us apart, every 97.75 us."""
    ffi, library = lib
    handed = ffi.new("double[3]", list(field))
    return np.array(
        [
            [
                [library.front_end_volts(sensor, axis, handed, 97_750_000 * chip + 1_500_000 * k) for axis in range(3)]
                for k in range(8)
            ]
            for chip in range(count)
        ]
    )


def test_a_known_field_becomes_known_volts(lib):
    gain = [[1.01, 0.02, 0.0], [0.0, 0.98, -0.01], [0.0, 0.0, 1.03]]
    sensor = front_end(lib, gain=gain, offset_T=[3e-6, -2e-6, 1e-6])
    field = np.array([2e-5, -1e-5, 4e-5])
    volts = bursts(lib, sensor, 1, field)[0, 0]
    np.testing.assert_allclose(volts, 1.65 + (gain @ field + [3e-6, -2e-6, 1e-6]) * 1.65 / 2e-4, rtol=1e-12)


SOUND, HELD, LOW, HIGH, GAIN, OTHER, BIT_HIGH, BIT_LOW = range(8)
FIELD = np.array([2e-5, -1e-5, 4e-5])
STEP_V = 3.3 / 4096


def broken(lib, fault, value=0.0, field=FIELD, before=FIELD):
    """Return the volts of one burst behind one of another field, whose second axis then failed."""
    ffi, library = lib
    sensor = front_end(lib)
    bursts(lib, sensor, 1, before)
    library.front_end_break(sensor, 1, fault, value)
    handed = ffi.new("double[3]", list(field))
    return np.array([library.front_end_volts(sensor, axis, handed, PS) for axis in range(3)])


@pytest.mark.parametrize(
    ("fault", "value", "expected"),
    [(SOUND, 9.0, -1e-5), (HELD, 9.0, 3e-5), (GAIN, -1.0, 1e-5), (GAIN, 0.5, -5e-6), (OTHER, 2.0, 4e-5)],
)
def test_an_axis_that_fails_gives_another_field(lib, fault, value, expected):
    volts = broken(lib, fault, value, before=[0.0, 3e-5, 0.0])
    np.testing.assert_allclose(field_of(volts), [2e-5, expected, 4e-5], rtol=1e-9)


def test_an_axis_that_lies_at_an_end_of_the_range(lib):
    np.testing.assert_array_equal(broken(lib, LOW)[1], 0.0)
    np.testing.assert_array_equal(broken(lib, HIGH)[1], 3.3)


@pytest.mark.parametrize("bit", range(12))
def test_a_bit_of_the_converter_that_does_not_move(lib, bit):
    for field in (0.0, 1e-5, -1.7e-4, 3e-4, -3e-4):  # The last ones are beyond the range.
        result = int(np.clip(np.floor((1.65 * (1.0 + field / 2e-4)) / STEP_V), 0, 4095))
        for fault, shown in ((BIT_HIGH, result | 1 << bit), (BIT_LOW, result & ~(1 << bit))):
            volts = broken(lib, fault, bit, field=[0.0, field, 0.0])
            assert np.floor(volts[1] / STEP_V) == shown
            np.testing.assert_allclose(volts[[0, 2]], 1.65)


def test_a_fault_that_is_mended_leaves_no_trace(lib):
    library = lib[1]
    whole, mended = front_end(lib, noise_T=2e-7), front_end(lib, noise_T=2e-7)
    library.front_end_break(mended, 1, OTHER, 0.0)
    bursts(lib, mended, 1)
    bursts(lib, whole, 1)
    library.front_end_break(mended, 1, SOUND, 0.0)
    np.testing.assert_array_equal(bursts(lib, mended, 4)[1:], bursts(lib, whole, 4)[1:])


def test_chip_noise_is_shared_by_a_burst_and_survives_its_mean(lib):
    count = 3000
    field = field_of(bursts(lib, front_end(lib, noise_T=2e-7), count))
    assert np.ptp(field, axis=1).max() < 1e-18
    samples = field.mean(axis=1)
    np.testing.assert_allclose(samples.std(axis=0), 2e-7, rtol=4 / np.sqrt(2 * count))
    assert np.abs(samples.mean(axis=0)).max() < 4 * 2e-7 / np.sqrt(count)
    correlation = np.corrcoef(np.column_stack([samples[:-1], samples[1:]]).T)
    assert np.abs(correlation - np.eye(6)).max() < 5 / np.sqrt(count)


def test_converter_noise_is_independent(lib):
    count = 1000
    volts = bursts(lib, front_end(lib, converter_noise_V=4e-4), count) - 1.65
    assert volts.std() == pytest.approx(4e-4, rel=4 / np.sqrt(2 * volts.size))
    assert volts.mean(axis=1).std() == pytest.approx(4e-4 / np.sqrt(8), rel=0.08)


def test_another_seed_is_another_noise(lib):
    same = [bursts(lib, front_end(lib, seed=s, noise_T=2e-7), 5) for s in (3, 3, 4)]
    assert np.array_equal(same[0], same[1])
    assert not np.any(same[0] == same[2])


def ambient(lib, **values):
    return lib[0].new("ambient_t *", {"seed": 11, "impulse_decay_s": 1e-4} | values)


def sampled(lib, source, times_ps):
    ffi, library = lib
    out = ffi.new("double[3]")
    result = np.empty((len(times_ps), 3))
    for row, time_ps in zip(result, times_ps, strict=True):
        library.ambient_field(source, int(time_ps), out)
        row[:] = list(out)
    return result


def test_earth_and_mains_spectrum(lib):
    source = ambient(
        lib,
        earth_T=[2e-5, 0.0, -4e-5],
        mains_Hz=50.0,
        mains_T=[1e-8, 2e-8, 0.0],
        harmonics=[1.0, 0.0, 0.3],
        mains_phase_rad=0.4,
    )
    times = np.arange(4000) * (PS // 4000)
    field = sampled(lib, source, times)
    spectrum = np.fft.rfft(field, axis=0) / 4000
    np.testing.assert_allclose(spectrum[0].real, [2e-5, 0.0, -4e-5], atol=1e-15)
    # sin(w t + p) has the coefficient -i/2 exp(i p)
    np.testing.assert_allclose(spectrum[50], -0.5j * np.exp(0.4j) * np.array([1e-8, 2e-8, 0.0]), atol=1e-15)
    np.testing.assert_allclose(spectrum[150], -0.15j * np.exp(1.2j) * np.array([1e-8, 2e-8, 0.0]), atol=1e-15)
    spectrum[[0, 50, 150]] = 0.0
    assert np.abs(spectrum).max() < 1e-14


def test_mains_through_the_low_pass(lib):
    lag = 1.0 / (2.0 * np.pi * 50.0)
    source = ambient(lib, mains_Hz=50.0, mains_T=[1e-6, 0.0, 0.0], harmonics=[1.0], lag_s=lag)
    spectrum = np.fft.rfft(sampled(lib, source, np.arange(1000) * (PS // 1000))[:, 0]) / 1000
    assert spectrum[50] == pytest.approx(-0.5j * 1e-6 / (1.0 + 1.0j), abs=1e-15)  # first order at its corner


def test_impulses_come_at_their_rate_and_decay(lib):
    rate, decay, seconds = 200.0, 1e-4, 4
    source = ambient(lib, impulse_rate_Hz=rate, impulse_T=1e-6, impulse_decay_s=decay)
    step = 25_000_000
    size = np.linalg.norm(sampled(lib, source, np.arange(0, seconds * PS, step)), axis=1)
    ends = np.flatnonzero((size[1:] > 1.5 * size[:-1]) & (size[1:] > 0.2e-6))
    assert len(ends) == pytest.approx(rate * seconds, abs=4 * np.sqrt(rate * seconds))
    after = ends[(ends + 5 < len(size))] + 1
    ratio = np.median(size[after + 2] / size[after + 1])
    assert ratio == pytest.approx(np.exp(-25e-6 / decay), rel=1e-9)
    assert size.max() < 4e-6


def test_impulse_through_the_low_pass_starts_at_zero(lib):
    sharp = ambient(lib, impulse_rate_Hz=20.0, impulse_T=1e-6)
    soft = ambient(lib, impulse_rate_Hz=20.0, impulse_T=1e-6, lag_s=2e-5)
    times = np.arange(0, PS // 2, 2_000_000)
    raw, lagged = sampled(lib, sharp, times)[:, 2], sampled(lib, soft, times)[:, 2]
    # Integrate the filter over the unfiltered field; the trapezium's step is a tenth of the lag.
    state, decay = np.zeros(len(raw)), np.exp(-2e-6 / 2e-5)
    for k in range(1, len(raw)):
        state[k] = state[k - 1] * decay + (1 - decay) * 0.5 * (raw[k] + raw[k - 1])
    assert np.abs(raw).max() > 3e-7
    assert np.abs(state - lagged).max() < 0.06 * np.abs(raw).max()

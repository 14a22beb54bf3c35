"""The transform of 2048 numbers against NumPy in double precision."""

import numpy as np
import pytest

LENGTH = 2048
ORDER = [int(f"{k:011b}"[::-1], 2) for k in range(LENGTH)]


def transformed(core, name, values):
    """What a transform makes of complex values; what lies behind them stays."""
    ffi, lib = core
    x = ffi.new(f"fourier_t[{LENGTH + 2}]", [(v.real, v.imag) for v in [*values.tolist(), 3.0 + 4.0j, 5.0 + 6.0j]])
    getattr(lib, f"fourier_{name}")(x)
    assert [(x[i].re, x[i].im) for i in (LENGTH, LENGTH + 1)] == [(3.0, 4.0), (5.0, 6.0)]
    return np.frombuffer(ffi.buffer(x), np.float32).astype(float).view(complex)[:LENGTH]


@pytest.fixture(scope="module")
def noise():
    rng = np.random.default_rng(1)
    return rng.normal(size=LENGTH) + 1j * rng.normal(size=LENGTH)


def test_forward(core, noise):
    expected = np.fft.fft(noise)
    found = transformed(core, "forward", noise)[ORDER]
    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()


def test_inverse(core, noise):
    spectrum = np.empty(LENGTH, complex)
    spectrum[ORDER] = noise
    expected = LENGTH * np.fft.ifft(noise)
    assert np.abs(transformed(core, "inverse", spectrum) - expected).max() < 1e-4 * np.abs(expected).max()


def test_places(core):
    """Bins count modulo 2048."""
    lib = core[1]
    assert [lib.fourier_place(k) for k in range(LENGTH)] == ORDER
    assert lib.fourier_place(LENGTH + 5) == ORDER[5]
    assert lib.fourier_place(2**32 - 1) == ORDER[LENGTH - 1]

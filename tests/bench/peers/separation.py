"""Fields from the samples of a cycle: the transform of the firmware and exact separation beside NumPy and SciPy.

The peers of the transform do what it does, all codes of a family on three axes: a product with the matrix of codes,
and circular correlation through the fast Fourier transform. NumPy's least squares does what exact separation does.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import fft

from goldfield.access.cdma import Separator
from goldfield.access.gold import code_matrix
from hil_sim import clib
from tests.bench.peers.bench import Bench, named
from tests.bench.peers.row import Row

SUBJECT = "separation"
DEGREE, CHIPS = 10, 1023
NOISE_T = 2e-7


def samples(seed: int = 1) -> Any:
    """Return counts of a converter for each chip and axis, shape (1023, 3)."""
    return np.random.default_rng(seed).integers(-2000, 2000, (CHIPS, 3)).astype(np.int16)


class Transform:
    """The core's transform, called as the firmware calls it: chip by chip, and once at the end."""

    def __init__(self, counts: Any) -> None:
        self._ffi, self._core = clib.load("libgf_core.so", ("core/codes/despread.h",))
        self._family = self._core.gold_family(DEGREE)
        self._cycle = self._ffi.new("despread_t *")
        self._kept = np.ascontiguousarray(counts)
        first = self._ffi.cast("int16_t *", self._kept.ctypes.data)
        self._chips = [first + 3 * chip for chip in range(CHIPS)]
        words = np.array([self._core.despread_word(self._family, code) for code in range(CHIPS)])
        self._words = words

    def __call__(self) -> Any:
        """Return the correlation of each of 1023 codes on each axis, shape (1023, 3)."""
        store, cycle = self._core.despread_store, self._cycle
        self._core.despread_start(cycle, self._family)
        for chip in self._chips:
            store(cycle, chip)
        self._core.despread_transform(cycle)
        table = np.frombuffer(self._ffi.buffer(cycle.words), dtype=np.int32).reshape(3, -1)
        return table[:, self._words].T


def by_fourier(counts: Any) -> Any:
    """Return a task that correlates with all shifts: sum over t of u[t] v[t + k] y[t], for each k."""
    pair = code_matrix(DEGREE, [CHIPS, CHIPS + 1]).astype(np.float64)
    u, spectrum = pair[:, :1], fft.rfft(pair[:, 1:], axis=0)
    return lambda: fft.irfft(np.conj(fft.rfft(u * counts, axis=0)) * spectrum, n=CHIPS, axis=0)


def rows(bench: Bench) -> list[Row]:
    """Return the rows of the subject; what the peers find is compared first."""
    counts = samples()
    transform, fourier = Transform(counts), by_fourier(counts)
    codes = code_matrix(DEGREE, range(CHIPS)).astype(np.float64)
    values = counts.astype(np.float64)
    assert np.array_equal(transform(), codes.T @ values)
    assert np.allclose(fourier(), transform(), atol=1e-3)
    every = "a cycle with 1,023 codes on three axes, on the host"
    numpy, scipy = named("numpy"), named("scipy")
    found = [
        bench.pair(SUBJECT, every, transform, f"{numpy}, matrix product", lambda: codes.T @ values),
        bench.pair(SUBJECT, every, transform, f"{scipy}, fft", fourier),
    ]
    rng = np.random.default_rng(2)
    for count in (8, 100, 1000):
        chosen = tuple(range(2, 2 + count))
        separator = Separator(DEGREE, chosen, NOISE_T)
        columns = np.column_stack([code_matrix(DEGREE, chosen), np.ones(CHIPS)]).astype(np.float64)
        truth = rng.normal(scale=1e-5, size=(count, 3))
        measured = columns[:, :-1] @ truth + 5e-5 + NOISE_T * rng.normal(size=(CHIPS, 3))
        found.append(of_samples(bench, separator, columns, measured))
    return found


def of_samples(bench: Bench, separator: Separator, columns: Any, measured: Any) -> Row:
    """Return the row of exact separation of some codes from samples."""

    def ours() -> Any:
        return separator.from_samples(measured).field_T

    def theirs() -> Any:
        return np.linalg.lstsq(columns, measured)[0][:-1]

    assert np.allclose(ours(), theirs(), atol=1e-12)
    count = columns.shape[1] - 1
    what = f"exact fields of {count:,} codes, with the offset, from samples"
    return bench.pair(SUBJECT, what, ours, f"{named('numpy')}, lstsq", theirs)

"""Separation of dual-axis beacons by their frequencies: least squares with an offset, or the paper's FFT.

The sum field is offset + sum_i (Bc_i cos(2 pi f_i t) + Bs_i sin(2 pi f_i t)), with t on the beacons' clock. Least
squares on all columns at once serves any window and any sample times. The FFT (Zheng et al. 2022, 2.2) is exact only
when the window holds whole periods of every beacon: otherwise the earth's field, 1e4 times the signal, leaks into every
line, so such a window is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from goldfield.access.cdma import Separation
from goldfield.access.linear import TemplateAccess
from goldfield.access.nuisance import constant
from goldfield.errors import UserError
from goldfield.types import FloatArray

WHOLE_TOLERANCE = 1e-6
"""Largest distance of the number of periods in an FFT window from a whole number: it leaks 3e-6 of the offset, below
the noise of any sensor; the clocks of sampler and beacons agree no better."""

WORST_GROWTH = 30.0
"""Least squares refuses a window that multiplies the noise of a field by more than this against long windows: the
frequencies are then hardly distinct from each other or from the offset."""


@dataclass(frozen=True, eq=False)
class RotatingSeparation:
    """The parts of e windows.

    Attributes
    ----------
    field_T : ndarray, shape (e, n, 2, 3)
        Bc and Bs of each beacon, in the sensor's frame.
    offset_T : ndarray, shape (e, 3)
        The part that does not turn: the earth's field and the sensor's own offset.
    sigma_T : ndarray, shape (n,)
        Standard deviation of each component of a field.
    """

    field_T: FloatArray
    offset_T: FloatArray
    sigma_T: FloatArray


class RotatingSeparator:
    """Joint least squares over windows with the same sample times; an `access.Access` whose fields are Bc, Bs in turn.

    Parameters
    ----------
    frequency_Hz : sequence of float
        Frequencies of n beacons, all different and above zero.
    time_s : ndarray, shape (t,)
        Times of the samples on the beacons' clock, in any order and at any distance.
    noise_T : float
        Standard deviation of one sample on one axis.

    Raises
    ------
    UserError
        If the window cannot tell the beacons apart.
    """

    def __init__(self, frequency_Hz: Sequence[float], time_s: FloatArray, noise_T: float) -> None:
        _check_frequencies(frequency_Hz)
        turn = 2.0 * np.pi * np.outer(time_s, frequency_Hz)
        waves = np.stack([np.cos(turn), np.sin(turn)], axis=2).reshape(len(time_s), -1)
        _check_window(frequency_Hz, time_s, waves)
        names = [f"{frequency:g} Hz, {wave}" for frequency in frequency_Hz for wave in ("cosine", "sine")]
        self._access = TemplateAccess(names, waves, [constant(len(time_s))], noise_T)
        self.sigma_T: FloatArray = np.sqrt(np.diag(self.covariance_T2)).reshape(-1, 2).max(axis=1)
        """Standard deviation of each beacon's components from a complete window, shape (n,)."""

    @property
    def covariance_T2(self) -> FloatArray:
        """Covariance of Bc and Bs of each beacon in turn, on one axis, shape (2n, 2n)."""
        return self._access.covariance_T2

    def from_samples(self, samples_T: FloatArray) -> Separation:
        """Separate one window, shape (t, 3), NaN where a sample is missing; Bc and Bs of each beacon in turn."""
        return self._access.from_samples(samples_T)

    def separate(self, samples_T: FloatArray) -> RotatingSeparation:
        """Separate many windows at once.

        Parameters
        ----------
        samples_T : ndarray, shape (e, t, 3)
            Samples, which must be finite.
        """
        # The offset may be a million times the field: take its bulk out first, so that sums do not round at its size.
        mean = samples_T.mean(axis=1, keepdims=True)
        parts = self._access.weights @ (samples_T - mean)
        field = parts[:, :-1].reshape(len(samples_T), -1, 2, 3)
        return RotatingSeparation(field, parts[:, -1] + mean[:, 0], self.sigma_T)


def separate_by_fft(
    samples_T: FloatArray, rate_Hz: float, frequency_Hz: Sequence[float], noise_T: float, start_s: float = 0.0
) -> RotatingSeparation:
    """Separate windows by their discrete Fourier transform, as the paper does.

    Parameters
    ----------
    samples_T : ndarray, shape (e, t, 3)
        Samples, evenly spaced, the first at ``start_s`` on the beacons' clock.
    rate_Hz : float
    frequency_Hz : sequence of float
    noise_T : float
        Standard deviation of one sample on one axis.

    Raises
    ------
    UserError
        If the window does not hold whole periods of every beacon, or a beacon is at or above half the rate.
    """
    _check_frequencies(frequency_Hz)
    count = samples_T.shape[1]
    window_s = count / rate_Hz
    frequency = np.asarray(frequency_Hz, dtype=np.float64)
    periods = frequency * window_s
    for f, p in zip(frequency, periods, strict=True):
        if f >= 0.5 * rate_Hz:
            raise UserError(f"a beacon at {f:g} Hz needs more than {2 * f:g} samples a second; there are {rate_Hz:g}")
        if abs(p - round(p)) > WHOLE_TOLERANCE or round(p) < 1:
            raise UserError(
                f"an FFT window of {window_s:g} s holds {p:g} periods of the beacon at {f:g} Hz, where it must hold "
                "a whole number of every beacon's: choose another window, or separate by least squares, which takes any"
            )
    lines = np.fft.rfft(samples_T, axis=1) / count
    chosen = 2.0 * lines[:, np.rint(periods).astype(int)] * np.exp(-2j * np.pi * frequency * start_s)[:, None]
    field = np.stack([chosen.real, -chosen.imag], axis=2)
    sigma = np.full(len(frequency), noise_T * np.sqrt(2.0 / count))
    return RotatingSeparation(field, np.asarray(lines[:, 0].real), sigma)


def _check_frequencies(frequency_Hz: Sequence[float]) -> None:
    if any(not 0.0 < f < np.inf for f in frequency_Hz):
        raise UserError("a rotating beacon's frequency must be a finite number of hertz above zero")
    if len(set(frequency_Hz)) < len(frequency_Hz):
        raise UserError("two rotating beacons have the same frequency: nothing can tell their fields apart; change one")


def _check_window(frequency_Hz: Sequence[float], time_s: FloatArray, waves: FloatArray) -> None:
    """Refuse a window that cannot tell the waves, shape (t, 2n), from each other and from a constant."""
    if len(time_s) < waves.shape[1] + 2:
        raise UserError(
            f"{len(time_s)} samples cannot be separated into the fields of {len(frequency_Hz)} rotating beacons "
            f"and an offset: give at least {waves.shape[1] + 2}"
        )
    _, size, vt = np.linalg.svd(np.column_stack([waves, np.ones(len(time_s))]), full_matrices=False)
    spread = ((vt / np.maximum(size, 1e-300)[:, None]) ** 2).sum(axis=0)[:-1]
    growth = np.sqrt(spread * len(time_s) / 2.0)
    worst = int(np.argmax(growth))
    if growth[worst] > WORST_GROWTH:
        raise UserError(
            f"the window of {np.ptp(time_s):g} s is too short or sampled too slowly to tell the beacon at "
            f"{frequency_Hz[worst // 2]:g} Hz from the others and from the constant field (noise grows "
            f"{growth[worst]:.3g}-fold): lengthen the window or move the frequencies apart"
        )

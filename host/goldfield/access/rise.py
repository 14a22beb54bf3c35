"""Coil rise: the current follows a step as 1 - exp(-t / tau) (maths.md, 1).

With chips of length T and e = exp(-T / tau), the sample at the end of chip n sees f[n] = e f[n-1] + (1 - e) c[n] of the
drive c. Taking f for c biases the estimate; three cures:

- `filtered`: the exact templates, for a known tau of each beacon;
- `sharpened`: the samples as they would be without rise, for one tau of all beacons;
- `lagged`: regress on c[n], c[n-1] and c[n-2] and add, for unknown taus. What is left out is e^3, .019 % at
  tau / T = .35; the ratio of the coefficients tells tau.
"""

from __future__ import annotations

import math

import numpy as np

from goldfield.types import FloatArray

LAGS = 3
"""Columns that each beacon has where its rise is unknown."""


def remainder(tau_chips: float) -> float:
    """Return e = exp(-T / tau), what is left of a step after one chip; 0 for a coil that follows at once."""
    return math.exp(-1.0 / tau_chips) if tau_chips > 0.0 else 0.0


def filtered(drive: FloatArray, tau_chips: float) -> FloatArray:
    """Return what samples at the ends of the chips see of a drive that repeats with every cycle.

    Parameters
    ----------
    drive : ndarray, shape (N,) or (N, n)
    tau_chips : float
        Time constant of the coil in chips.

    Returns
    -------
    ndarray, of the same shape
        f[n] = e f[n-1] + (1 - e) c[n] with f[-1] = f[N-1], to rounding: a product in the frequency domain, as the
        cycle repeats.

    Examples
    --------
    A coil whose current falls to a half in a chip, driven for one of four chips:

    >>> filtered(np.array([1.0, 0.0, 0.0, 0.0]), 1.0 / math.log(2.0)).round(4).tolist()
    [0.5333, 0.2667, 0.1333, 0.0667]
    """
    e = remainder(tau_chips)
    if e == 0.0:
        return drive
    drive = np.asarray(drive)
    turn = np.exp(-2j * np.pi * np.arange(len(drive) // 2 + 1) / len(drive))  # of each frequency in a chip
    gain = ((1.0 - e) / (1.0 - e * turn)).reshape(-1, *[1] * (drive.ndim - 1))
    return np.fft.irfft(gain * np.fft.rfft(drive, axis=0), n=len(drive), axis=0)


def sharpened(samples_T: FloatArray, tau_chips: float) -> FloatArray:
    """Undo the rise of coils that are all alike: (y[n] - e y[n-1]) / (1 - e), with the cycle's end before its begin.

    Parameters
    ----------
    samples_T : ndarray, shape (N, 3)
        A missing sample spoils the next one too. White noise grows by sqrt(1 + e^2) / (1 - e) and is no longer white.
    """
    e = remainder(tau_chips)
    return np.asarray((samples_T - e * np.roll(samples_T, 1, axis=0)) / (1.0 - e))


def lagged(drives: FloatArray) -> FloatArray:
    """Return the columns c[n], c[n-1], c[n-2] of each drive, shape (N, n) to (N, 3 n); the lag runs fastest."""
    return np.stack([np.roll(drives, lag, axis=0) for lag in range(LAGS)], axis=2).reshape(len(drives), -1)


def tau_from_lags(coefficients_T: FloatArray) -> float:
    """Return the time constant in chips from the coefficients of one beacon's lags, shape (3, axes).

    The coefficients are (1 - e) b (1, e, e^2): e follows by least squares of the second on the first. The result is 0
    if noise makes e negative.
    """
    first, second = coefficients_T[0], coefficients_T[1]
    power = float(first @ first)
    e = float(first @ second) / power if power > 0.0 else 0.0
    return -1.0 / math.log(e) if 0.0 < e < 1.0 else 0.0

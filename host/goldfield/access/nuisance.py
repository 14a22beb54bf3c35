"""Nuisances, which are in the samples beside the beacons: a constant, and the hum of the mains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.types import FloatArray

SEARCH_HZ = 0.5
"""Largest searched difference of the mains frequency from its nominal value: grids hold 0.2 Hz, island grids 1 %."""

GRID_HZ = 0.1
"""Steps of the search before it is refined: the peak of a cycle of 0.1 s is about 10 Hz wide."""


@dataclass(frozen=True, eq=False)
class Nuisance:
    """A part of the samples that no beacon made, as columns whose coefficients are unknown.

    Attributes
    ----------
    name : str
        What messages call it.
    columns : ndarray, shape (N, k)
    """

    name: str
    columns: FloatArray


def constant(chips: int) -> Nuisance:
    """Return the one column of ambient field, sensor offset and any offset of the drives."""
    return Nuisance("a constant field", np.ones((chips, 1)))


def mains(chips: int, chip_period_s: float, frequency_Hz: float, harmonics: int = 1) -> Nuisance:
    """Return cosine and sine of a frequency and its multiples up to ``harmonics``, at the ends of the chips."""
    phase = 2.0 * np.pi * frequency_Hz * chip_period_s * (np.arange(chips) + 1.0)
    waves = [wave(order * phase) for order in range(1, harmonics + 1) for wave in (np.cos, np.sin)]
    return Nuisance(f"the mains at {frequency_Hz:g} Hz", np.stack(waves, axis=1))


def mains_frequency(
    samples_T: FloatArray, known: FloatArray, chip_period_s: float, nominal_Hz: float, harmonics: int = 1
) -> float:
    """Find the frequency near the nominal one that explains most of what other columns leave over.

    Parameters
    ----------
    samples_T : ndarray, shape (N, 3)
        Axes with a NaN are not used; if none is left the nominal frequency is returned.
    known : ndarray, shape (N, k)
        Columns of the beacons and other nuisances, independent of each other.
    chip_period_s, nominal_Hz : float
    harmonics : int
        Number of multiples of the frequency, as for `mains`.

    Notes
    -----
    Nonlinear least squares in one variable by variable projection (Golub & Pereyra 1973). The weaker the hum the worse
    its frequency is known and the less it matters.
    """
    from scipy.optimize import minimize_scalar  # a fifth of a second to import: only where there is mains to fit

    basis = np.linalg.qr(known)[0]
    complete = samples_T[:, np.isfinite(samples_T).all(axis=0)]
    if not complete.size:
        return nominal_Hz
    complete = complete - complete.mean(axis=0)
    rest = complete - basis @ (basis.T @ complete)
    scale = float((rest**2).sum()) or 1.0

    def unexplained(frequency_Hz: float) -> float:
        waves = mains(len(rest), chip_period_s, frequency_Hz, harmonics).columns
        waves = waves - basis @ (basis.T @ waves)
        orthogonal = np.linalg.qr(waves)[0]
        return -float(((orthogonal.T @ rest) ** 2).sum()) / scale

    grid = nominal_Hz + np.arange(-SEARCH_HZ, SEARCH_HZ + GRID_HZ / 2, GRID_HZ)
    best = float(grid[np.argmin([unexplained(frequency) for frequency in grid])])
    bounds = (max(best - GRID_HZ, nominal_Hz - SEARCH_HZ), min(best + GRID_HZ, nominal_Hz + SEARCH_HZ))
    return float(minimize_scalar(unexplained, bounds=bounds, method="bounded", options={"xatol": 1e-5}).x)

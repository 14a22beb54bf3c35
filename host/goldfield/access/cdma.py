"""Exact separation of synchronised Gold codes: least squares on [codes, 1] (maths.md, 1).

With the samples y = C b + offset + noise, the centring P = I - 11^T/N and A = C^T P C, the fields are
b = A^-1 C^T P y. The sensor sends the plain sums C^T y / N and 1^T y / N, which hold all that this needs:
C^T P y = N (C^T y / N) - (C^T 1)(1^T y / N).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from goldfield.access.gold import code_matrix
from goldfield.errors import UserError
from goldfield.poses import FloatArray

RANK_TOLERANCE = 1e-9
"""Relative to N. Gram matrices of codes have integer entries: a singular one shows eigenvalues of rounding size, a
regular one of at least about 1."""


@dataclass(frozen=True, eq=False)
class Separation:
    """The parts of one cycle.

    Attributes
    ----------
    field_T : ndarray, shape (n, 3)
        Of each code; NaN on an axis that was not measured.
    offset_T : ndarray, shape (3,)
        Whatever does not follow a code: the earth's field and the sensor's own offset.
    sigma_T : ndarray, shape (n,)
        Standard deviation of each component of a field; infinite if no axis was measured.
    """

    field_T: FloatArray
    offset_T: FloatArray
    sigma_T: FloatArray


class Separator:
    """Separates cycles of one fixed set of codes.

    Parameters
    ----------
    degree : int
    codes : sequence of int
        Code indices, all different.
    noise_T : float
        Standard deviation of one sample on one axis.

    Raises
    ------
    UserError
        If the codes and a constant are linearly dependent: no method can tell their fields apart.
    """

    def __init__(self, degree: int, codes: Sequence[int], noise_T: float) -> None:
        self.codes = tuple(codes)
        self.chips = (1 << degree) - 1
        self._noise_T = noise_T
        self._code_chips = code_matrix(degree, codes).astype(np.float64)
        self._sums = self._code_chips.sum(axis=0)
        self._normal = self._normal_matrix(np.ones(self.chips, dtype=np.bool_))
        rank = _rank(self._normal)
        if rank < len(codes):
            raise UserError(
                f"the {len(codes)} codes cannot be separated: with an unknown offset only {rank} of their fields are "
                f"independent in {self.chips} chips; leave out {len(codes) - rank} of the beacons or choose other codes"
            )
        self._inverse = np.linalg.inv(self._normal)

    def from_samples(self, samples_T: FloatArray) -> Separation:
        """Separate one cycle of raw samples.

        Parameters
        ----------
        samples_T : ndarray, shape (N, 3)
            One row a chip from chip 0; NaN where a sample is missing. The remaining samples of the axis are used, if
            they suffice.
        """
        count = len(self.codes)
        field = np.full((count, 3), np.nan)
        offset = np.full(3, np.nan)
        variance = np.full((count, 3), np.nan)
        for axis in range(3):
            present = np.isfinite(samples_T[:, axis])
            inverse = self._inverse
            if not present.all():
                normal = self._normal_matrix(present)
                if present.sum() <= count or _rank(normal) < count:
                    continue
                inverse = np.linalg.inv(normal)
            codes = self._code_chips[present]
            y = samples_T[present, axis]
            # The offset may be a million times the field: take it out first so that the sums do not round at its size.
            mean = y.mean()
            centred = y - mean
            field[:, axis] = inverse @ (codes.T @ (centred - centred.mean()))
            offset[axis] = mean + (centred - codes @ field[:, axis]).mean()
            variance[:, axis] = np.diag(inverse) * self._noise_T**2
        return Separation(field, offset, _worst_sigma(variance))

    def from_correlations(
        self, correlation_T: FloatArray, mean_T: FloatArray, missing_T: FloatArray, extra_T: float = 0.0
    ) -> Separation:
        """Separate the sums that the sensor sends.

        Parameters
        ----------
        correlation_T : ndarray, shape (n, 3)
            ``sum(c[t] y[t]) / N``; NaN where it did not arrive or was out of range.
        mean_T : ndarray, shape (3,)
            ``sum(y[t]) / N``; an axis where it is NaN is not measured.
        missing_T : ndarray, shape (n,)
            How strong the fields behind missing correlations may be (standard deviation): they leak into the others by
            about 1/N, which widens the sigma of the others.
        extra_T : float
            Standard deviation of further errors of each correlation (lost or saturated chips).
        """
        count = len(self.codes)
        field = np.full((count, 3), np.nan)
        offset = np.full(3, np.nan)
        variance = np.full((count, 3), np.nan)
        extra_variance = (self.chips * extra_T) ** 2
        for axis in range(3):
            known = np.isfinite(correlation_T[:, axis])
            if not known.any() or not np.isfinite(mean_T[axis]):
                continue
            right = self.chips * correlation_T[known, axis] - self._sums[known] * mean_T[axis]
            inverse = self._inverse if known.all() else np.linalg.inv(self._normal[np.ix_(known, known)])
            field[known, axis] = inverse @ right
            offset[axis] = mean_T[axis] - self._sums[known] @ field[known, axis] / self.chips
            leak = inverse @ self._normal[np.ix_(known, ~known)] * missing_T[~known]
            variance[known, axis] = (
                np.diag(inverse) * self._noise_T**2 + (leak**2).sum(axis=1) + (inverse**2).sum(axis=1) * extra_variance
            )
        return Separation(field, offset, _worst_sigma(variance))

    def _normal_matrix(self, present: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> FloatArray:
        """C^T P C over the present chips, shape (n, n); its terms are integers up to the division."""
        codes = self._code_chips[present]
        sums = codes.sum(axis=0)
        return np.asarray(codes.T @ codes - np.outer(sums, sums) / max(len(codes), 1))


def plain_correlation(samples_T: FloatArray, degree: int, codes: Sequence[int]) -> FloatArray:
    """Correlate with each code after subtracting the mean, shape (n, 3): the patent's estimate, biased by other codes.

    Parameters
    ----------
    samples_T : ndarray, shape (N, 3)
    """
    chips = code_matrix(degree, codes).astype(np.float64)
    return np.asarray(chips.T @ (samples_T - samples_T.mean(axis=0)) / len(chips))


def _rank(normal: FloatArray) -> int:
    if not len(normal):
        return 0
    return int((np.linalg.eigvalsh(normal) > RANK_TOLERANCE * max(1.0, float(normal.max()))).sum())


def _worst_sigma(variance: FloatArray) -> FloatArray:
    """Return the standard deviation on the worst measured axis, shape (n,)."""
    worst = np.where(np.isnan(variance), -np.inf, variance).max(axis=1)
    return np.where(np.isfinite(worst), np.sqrt(np.maximum(worst, 0.0)), np.inf)

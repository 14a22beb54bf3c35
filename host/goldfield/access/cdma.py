"""Exact separation of synchronised Gold codes: least squares on [codes, 1] (maths.md, 1).

With the samples y = C b + offset + noise, the centring P = I - 11^T/N and A = C^T P C, the fields are
b = A^-1 C^T P y. The sensor sends the plain sums C^T y / N and 1^T y / N, which hold all that this needs:
C^T P y = N (C^T y / N) - (C^T 1)(1^T y / N).

Coils that settle slowly show filtered codes F in place of C (`goldfield.access.rise`): then b = (C^T P F)^-1 C^T P y
from the same sums, and least squares on F from samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from goldfield.access.gold import code_matrix
from goldfield.access.rise import filtered
from goldfield.errors import UserError
from goldfield.types import FloatArray

RANK_TOLERANCE = 1e-9
"""Smallest eigenvalue of a regular Gram matrix, relative to N. Gram matrices of codes have integer entries: a singular
one shows eigenvalues of rounding size, a regular one of at least about 1."""


@dataclass(frozen=True, eq=False)
class Separation:
    """The parts of one cycle.

    Attributes
    ----------
    field_T : ndarray, shape (n, 3)
        Field of each code; NaN on an axis that was not measured.
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
    tau_chips : sequence of float, optional
        Time constant of each beacon's coil in chips; left out: all follow at once.
    some : bool, optional
        Only some of the codes are present in any cycle, and `from_correlations` alone is used: whether all of them
        together could be separated is not asked.

    Raises
    ------
    UserError
        If the codes and a constant are linearly dependent: no method can tell their fields apart.
    """

    def __init__(
        self,
        degree: int,
        codes: Sequence[int],
        noise_T: float,
        tau_chips: Sequence[float] | None = None,
        *,
        some: bool = False,
    ) -> None:
        self.codes = tuple(codes)
        self.chips = (1 << degree) - 1
        self._noise_T = noise_T
        self._code_chips = code_matrix(degree, codes).astype(np.float64)
        self._templates = self._code_chips
        if tau_chips is not None and any(tau_chips):
            filters = zip(self._code_chips.T, tau_chips, strict=True)
            self._templates = np.stack([filtered(chips, tau) for chips, tau in filters], axis=1)
        self._sums = self._code_chips.sum(axis=0)  # of the templates too: a filter of unit gain keeps the mean
        every = np.ones(self.chips, dtype=np.bool_)
        self._normal = self._normal_matrix(self._templates, every)
        self._code_normal = self._normal_matrix(self._code_chips, every)
        self._seen = self._code_chips.T @ self._templates - np.outer(self._sums, self._sums) / self.chips
        rank = len(codes) if some else _rank(self._normal)
        if rank < len(codes):
            raise UserError(
                f"the {len(codes)} codes cannot be separated: with an unknown offset only {rank} of their fields are "
                f"independent in {self.chips} chips; leave out {len(codes) - rank} of the beacons or choose other codes"
            )

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self._normal), dtype=np.float64)

    @cached_property
    def _seen_inverse(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self._seen))

    @property
    def covariance_T2(self) -> FloatArray:
        """Covariance of the fields from a complete cycle of samples, on one axis, shape (n, n)."""
        return np.asarray(self._inverse * self._noise_T**2)

    def from_samples(self, samples_T: FloatArray) -> Separation:
        """Separate one cycle of raw samples.

        Parameters
        ----------
        samples_T : ndarray, shape (N, 3)
            One row a chip from chip 0; NaN where a sample is missing. The remaining samples of the axis are used, if
            they suffice.
        """
        if np.isfinite(samples_T).all():
            return self._from_all(samples_T)
        count = len(self.codes)
        field = np.full((count, 3), np.nan)
        offset = np.full(3, np.nan)
        variance = np.full((count, 3), np.nan)
        for axis in range(3):
            present = np.isfinite(samples_T[:, axis])
            inverse = self._inverse
            if not present.all():
                normal = self._normal_matrix(self._templates, present)
                if present.sum() <= count or _rank(normal) < count:
                    continue
                inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
            templates = self._templates[present]
            y = samples_T[present, axis]
            # The offset may be a million times the field: take it out first so that the sums do not round at its size.
            mean = y.mean()
            centred = y - mean
            field[:, axis] = inverse @ (templates.T @ (centred - centred.mean()))
            offset[axis] = mean + (centred - templates @ field[:, axis]).mean()
            variance[:, axis] = np.diag(inverse) * self._noise_T**2
        return Separation(field, offset, _worst_sigma(variance))

    def _from_all(self, samples_T: FloatArray) -> Separation:
        """Separate a cycle of which every sample is there, all axes in one product."""
        mean = samples_T.mean(axis=0)
        centred = samples_T - mean  # an offset may be a million times the field: sums must not round at its size
        rest = centred.mean(axis=0)
        field = self._inverse @ (self._templates.T @ (centred - rest))
        offset = mean + rest - self._sums @ field / self.chips
        return Separation(field, offset, np.sqrt(np.diag(self._inverse)) * self._noise_T)

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
            inverse = self._seen_inverse if known.all() else np.linalg.inv(self._seen[np.ix_(known, known)])
            field[known, axis] = inverse @ right
            offset[axis] = mean_T[axis] - self._sums[known] @ field[known, axis] / self.chips
            leak = inverse @ self._seen[np.ix_(known, ~known)] * missing_T[~known]
            noise = ((inverse @ self._code_normal[np.ix_(known, known)]) * inverse).sum(axis=1) * self._noise_T**2
            variance[known, axis] = noise + (leak**2).sum(axis=1) + (inverse**2).sum(axis=1) * extra_variance
        return Separation(field, offset, _worst_sigma(variance))

    @staticmethod
    def _normal_matrix(columns: FloatArray, present: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> FloatArray:
        """C^T P C over the present chips, shape (n, n); for codes its terms are integers up to the division."""
        chosen = columns[present]
        sums = chosen.sum(axis=0)
        return np.asarray(chosen.T @ chosen - np.outer(sums, sums) / max(len(chosen), 1))


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

"""One way to tell beacons apart, whatever they drive: least squares on their templates and on the nuisances.

Samples are y = F b + H h + noise with a column of F for each beacon, of H for each nuisance. The estimate of the fields
b is the best linear one for white noise, with covariance noise^2 times the beacons' block of (X^T X)^-1, X = [F, H].

A beacon can be separated if and only if no vector of the null space of X moves its field: that is what is checked, and
tells which beacons are in conflict with which.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from goldfield.access.cdma import Separation
from goldfield.access.nuisance import Nuisance
from goldfield.errors import UserError
from goldfield.types import FloatArray

EIGENVALUE_TOLERANCE = 1e-13
"""Largest eigenvalue of X^T X that counts as zero, for each column, with columns of length 1: rounding leaves about
1e-16. The least eigenvalue of the worst regular assignment of Gold codes is 1e-3, that of two tones a thousandth of a
line apart 1e-6."""

MOVED = 1e-7
"""A field whose row of the null space's projector exceeds this depends on others; rounding is about 1e-15."""

SHOWN = 6
"""Most beacons that a message names."""


class Access(Protocol):
    """The interface of every way to tell beacons apart; location does not care which it was."""

    @property
    def covariance_T2(self) -> FloatArray:
        """Covariance of the fields from a complete cycle, on one axis, shape (n, n)."""
        ...

    def from_samples(self, samples_T: FloatArray) -> Separation:
        """Separate one cycle of samples, shape (N, 3), one row a chip; NaN where a sample is missing."""
        ...


class TemplateAccess:
    """Separates cycles by the templates of the beacons.

    Parameters
    ----------
    beacons : sequence of str
        Names, for messages.
    templates : ndarray, shape (N, n)
        What the samples hold of each beacon for a field of one.
    nuisances : sequence of Nuisance
        The first is the constant field, if there is one: its coefficient is the offset.
    noise_T : float
        Standard deviation of one sample on one axis.

    Raises
    ------
    UserError
        If fields cannot be told apart, naming the beacons in conflict.
    """

    def __init__(
        self, beacons: Sequence[str], templates: FloatArray, nuisances: Sequence[Nuisance], noise_T: float
    ) -> None:
        self._count = templates.shape[1]
        self._noise_T = noise_T
        self.columns: FloatArray = np.hstack([templates, *(nuisance.columns for nuisance in nuisances)])
        spectrum = _Spectrum(self.columns)
        names = [f'"{beacon}"' for beacon in beacons]
        names += [nuisance.name for nuisance in nuisances for _ in range(nuisance.columns.shape[1])]
        _check_separable(names, self._count, spectrum.null_projector(), len(templates))
        self._has_offset = bool(nuisances) and nuisances[0].columns.shape[1] == 1
        self.weights: FloatArray = spectrum.pseudo_inverse()

    @property
    def covariance_T2(self) -> FloatArray:
        """Covariance of the fields from a complete cycle, on one axis, shape (n, n)."""
        fields = self.weights[: self._count]
        return np.asarray(fields @ fields.T * self._noise_T**2)

    def from_samples(self, samples_T: FloatArray) -> Separation:
        """Separate one cycle of samples, shape (N, 3), one row a chip; NaN where a sample is missing.

        A field that the remaining samples do not tell is NaN, the others are as good as these samples allow.
        """
        coefficients, variance = self.coefficients(samples_T)
        offset = coefficients[self._count] if self._has_offset else np.full(3, np.nan)
        measured = np.isfinite(coefficients[: self._count])
        worst = np.where(measured, variance[: self._count], -np.inf).max(axis=1)
        sigma = np.where(np.isfinite(worst), self._noise_T * np.sqrt(np.maximum(worst, 0.0)), np.inf)
        return Separation(coefficients[: self._count], offset, sigma)

    def coefficients(self, samples_T: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the coefficients of all columns and their variances for unit noise, each of shape (columns, 3)."""
        result = np.full((self.columns.shape[1], 3), np.nan)
        variance = np.full_like(result, np.nan)
        present = np.isfinite(samples_T)
        for axis in range(3):
            rows = present[:, axis]
            if not rows.any():
                continue
            weights, known = self.weights, np.ones(len(result), dtype=np.bool_)
            if not rows.all():
                spectrum = _Spectrum(self.columns[rows])
                weights, known = spectrum.pseudo_inverse(), np.diag(spectrum.null_projector()) <= MOVED
            # The offset may be a million times the field: take most of it out first, so that no sum rounds at its size.
            middle = float(samples_T[rows, axis].mean()) if self._has_offset else 0.0
            result[known, axis] = (weights @ (samples_T[rows, axis] - middle))[known]
            variance[known, axis] = (weights**2).sum(axis=1)[known]
            if self._has_offset:
                result[self._count, axis] += middle
        return result, variance


def _check_separable(names: Sequence[str], beacons: int, null: FloatArray, chips: int) -> None:
    """Refuse columns of which the first, the beacons', depend on others; null is the projector of the null space."""
    together = np.abs(null) > MOVED  # who moves with whom, and with oneself if at all
    for first in np.flatnonzero(np.diag(together)[:beacons]).tolist():
        group = list(dict.fromkeys(names[other] for other in np.flatnonzero(together[first]).tolist()))
        if len(group) == 1:
            raise UserError(f"the beacon {group[0]} cannot be measured: its drive is zero in every chip")
        shown = group if len(group) <= SHOWN else [*group[:SHOWN], f"{len(group) - SHOWN} more"]
        raise UserError(
            f"the fields of the beacons {', '.join(shown[:-1])} and {shown[-1]} cannot be told apart in a cycle of "
            f"{chips} chips: change the code, offset, slot or frequency of one of them, or leave it out"
        )


class _Spectrum:
    """Eigenvalues of X^T X with the columns X scaled to length 1: its null space and the pseudo-inverse of X."""

    def __init__(self, columns: FloatArray) -> None:
        lengths = np.linalg.norm(columns, axis=0)
        self._lengths = np.where(lengths > 0.0, lengths, 1.0)
        self._unit = columns / self._lengths
        self._values, self._vectors = np.linalg.eigh(self._unit.T @ self._unit)
        self._small = self._values <= EIGENVALUE_TOLERANCE * len(self._values)

    def null_projector(self) -> FloatArray:
        """Projector onto the null space, shape (k, k): the rows of columns that depend on others are not zero."""
        null = self._vectors[:, self._small]
        return np.asarray(null @ null.T)

    def pseudo_inverse(self) -> FloatArray:
        """Return the pseudo-inverse, shape (k, N)."""
        vectors = self._vectors[:, ~self._small]
        rough = (vectors / self._values[~self._small]) @ vectors.T @ self._unit.T
        # One step of Newton (Schulz 1933) squares the error that the squared condition of X^T X left.
        return np.asarray((2.0 * rough - (rough @ self._unit) @ rough) / self._lengths[:, None])

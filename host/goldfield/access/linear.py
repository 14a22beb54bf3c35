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
from goldfield.poses import FloatArray

RANK_TOLERANCE = 1e-7
"""Of singular values of columns scaled to length 1. Codes that depend on each other show rounding, about 1e-15; the
worst regular assignment of Gold codes .03."""

SHOWN = 6
"""Beacons named in a message."""


class Access(Protocol):
    """What all ways to tell beacons apart have in common; location does not care which it was."""

    @property
    def covariance_T2(self) -> FloatArray:
        """Of the fields from a complete cycle, on one axis, shape (n, n)."""
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
        check_separable(beacons, templates, nuisances)
        self._count = templates.shape[1]
        self._noise_T = noise_T
        self.columns: FloatArray = np.hstack([templates, *(nuisance.columns for nuisance in nuisances)])
        self._has_offset = bool(nuisances) and nuisances[0].columns.shape[1] == 1
        self.weights: FloatArray = _solve(self.columns)[0]

    @property
    def covariance_T2(self) -> FloatArray:
        """Of the fields from a complete cycle, on one axis, shape (n, n)."""
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
        """Coefficients of all columns and their variances for unit noise, each of shape (columns, 3)."""
        result = np.full((self.columns.shape[1], 3), np.nan)
        variance = np.full_like(result, np.nan)
        present = np.isfinite(samples_T)
        for axis in range(3):
            rows = present[:, axis]
            if not rows.any():
                continue
            weights, known = self.weights, np.ones(len(result), dtype=np.bool_)
            if not rows.all():
                weights, known = _solve(self.columns[rows])
            # The offset may be a million times the field: take most of it out first, so that no sum rounds at its size.
            middle = float(samples_T[rows, axis].mean()) if self._has_offset else 0.0
            result[known, axis] = (weights @ (samples_T[rows, axis] - middle))[known]
            variance[known, axis] = (weights**2).sum(axis=1)[known]
            if self._has_offset:
                result[self._count, axis] += middle
        return result, variance


def check_separable(beacons: Sequence[str], templates: FloatArray, nuisances: Sequence[Nuisance]) -> None:
    """Refuse templates whose fields cannot be told apart.

    Raises
    ------
    UserError
        Naming the first set of beacons that depend on each other, or on a nuisance.
    """
    names = [f'"{beacon}"' for beacon in beacons]
    names += [nuisance.name for nuisance in nuisances for _ in range(nuisance.columns.shape[1])]
    columns = np.hstack([templates, *(nuisance.columns for nuisance in nuisances)])
    null = _null_space(columns)[1]
    together = np.abs(null @ null.T) > RANK_TOLERANCE  # who moves with whom, and with oneself if at all
    for first in range(len(beacons)):
        if not together[first, first]:
            continue
        group = list(dict.fromkeys(names[other] for other in np.flatnonzero(together[first])))
        shown = group if len(group) <= SHOWN else [*group[:SHOWN], f"{len(group) - SHOWN} more"]
        if len(group) == 1:
            raise UserError(f"the beacon {group[0]} cannot be measured: its drive is always zero")
        raise UserError(
            f"the fields of the beacons {', '.join(shown[:-1])} and {shown[-1]} cannot be told apart in a cycle of "
            f"{len(columns)} chips: change the code, offset, slot or frequency of one of them, or leave it out"
        )


def _null_space(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lengths of the columns, shape (k,), and an orthonormal basis of the null space of the unit columns, (k, m)."""
    lengths = np.linalg.norm(columns, axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    unit = columns / lengths
    values, vectors = np.linalg.eigh(unit.T @ unit)
    small = values <= max(RANK_TOLERANCE**2, 1e-13 * len(values))
    return lengths, np.asarray(vectors[:, small])


def _solve(columns: FloatArray) -> tuple[FloatArray, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Pseudo-inverse, shape (k, N), and which of its rows estimate what they should, shape (k,)."""
    lengths, null = _null_space(columns)
    known = np.asarray((null**2).sum(axis=1) <= RANK_TOLERANCE)
    if null.shape[1]:
        return np.asarray(np.linalg.pinv(columns / lengths, rcond=1e-6) / lengths[:, None]), known
    orthogonal, triangle = np.linalg.qr(columns)
    return np.asarray(np.linalg.solve(triangle, orthogonal.T)), known

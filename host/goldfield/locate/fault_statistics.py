"""Tests of a fitted pose: whether a faulty beacon or sensor explains the fields better than noise does.

As in receiver-autonomous integrity monitoring. If model and noise are right the cost is chi-square with as many degrees
of freedom as there are components beyond the unknowns. A fault shows with more power in the part of the cost that
admitting it would take away. With residuals r, their covariance S = 1 - A P A' and the fault's directions C, all over
the standard deviations, that part is r' C (C' S C)^-1 C' r, chi-square too, with the rank of C' S C. C is for

- a beacon left out: its three components;
- a beacon of another strength (current, polarity, dead): its modelled field;
- a distorted sensor, b = (1 + S) R'B: one gain (S a multiple of 1), one gain an axis (S diagonal), any linear
  distortion (S symmetric; its other part is a turn, which the pose has already), or the gain of one axis, each in turn.

The tests share the permitted rate of false alarms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.chances import chdtri
from goldfield.locate.fit import Fit, Measurements, whitened_jacobian, whitened_residual
from goldfield.locate.uncertainty import UNOBSERVABLE, root_covariance
from goldfield.locate.whitening import Whitening
from goldfield.types import FloatArray

FALSE_ALARM = 7e-4
"""Permitted rate of epochs with nothing wrong that are taken for faulty."""

OF_WHOLE, OF_SINGLE, OF_STRENGTH = 0.1, 0.3, 0.2
"""Parts of it for the whole cost, for single beacons, and for their strengths: single faults are what happens."""

OF_SENSOR = (0.2, 0.1, 0.1)
"""Parts of it for a sensor of another gain, of other gains along its axes, and for any linear distortion."""

OF_AXIS = 0.3
"""Part of it for the gain of one axis, beyond the others, which it overlaps: 8 of 10,000 sound epochs in the cube of
eight beacons raise an alarm in all. Where one beacon is strong and all others are weak, a gain 20 % off shows by little
more than the limit for one degree of freedom and the right axis, if at all: of 12,000 such epochs this test misses 1 %,
the others alone 1.7 %."""

DETECTABLE = 1e-9
"""Part of a fault's variance that must show in the residuals for the fault to be detectable at all; above rounding."""

DISTORTIONS = np.array(
    [
        np.diag([1.0, 1.0, 1.0]),
        np.diag([1.0, -1.0, 0.0]),
        np.diag([1.0, 1.0, -2.0]),
        [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
    ]
)
"""Basis of the symmetric matrices: the first is one gain, the first three are all gains along axes."""

AXES = np.hstack([np.linalg.inv(DISTORTIONS[:3].diagonal(axis1=1, axis2=2)), np.zeros((3, 3))])
"""The gain of each axis as a sum of these, shape (3, 6)."""

GROUPS = (1, 3, 6)
"""Numbers of these that each test of the sensor admits."""


@dataclass(frozen=True)
class FaultStatistics:
    """Statistics of faults around the poses of e epochs with n beacons, linear in the fault.

    Attributes
    ----------
    drop : ndarray, shape (e, n)
        Part of the cost that leaving out the beacon would take away; 0 where no fault of it can show.
    freedom : ndarray of int, shape (e, n)
        Its degrees of freedom.
    scale : ndarray, shape (e, n)
        Part of the cost that another strength of the beacon takes away; one degree of freedom, 0 where it cannot show.
    separation_m : ndarray, shape (e, n, 3)
        The position less that without the beacon, along the directions in which a fault of the beacon can show.
    separation_cov_m2 : ndarray, shape (e, n, 3, 3)
        Its covariance if all is sound: what the position without the beacon has more than that with it.
    distortion : ndarray, shape (e, 4)
        Part of the cost that a distortion of the sensor takes away, with the first 1, 3 and 6 of `DISTORTIONS`, and
        the largest that the gain of one axis takes away.
    distortion_freedom : ndarray of int, shape (e, 4)
    """

    drop: FloatArray
    freedom: NDArray[np.intp]
    scale: FloatArray
    separation_m: FloatArray
    separation_cov_m2: FloatArray
    distortion: FloatArray
    distortion_freedom: NDArray[np.intp]

    def take(self, rows: NDArray[np.intp]) -> FaultStatistics:
        """Return some of the epochs."""
        return FaultStatistics(
            self.drop[rows],
            self.freedom[rows],
            self.scale[rows],
            self.separation_m[rows],
            self.separation_cov_m2[rows],
            self.distortion[rows],
            self.distortion_freedom[rows],
        )

    def normalised(self) -> FloatArray:
        """Return each beacon's residual, shape (e, n), near 1 if all is sound; NaN where it cannot show."""
        return np.asarray(np.sqrt(np.where(self.freedom > 0, self.drop, np.nan) / np.maximum(self.freedom, 1)))


def alarm(measurements: Measurements, cost: FloatArray, statistics: FaultStatistics) -> NDArray[np.bool_]:
    """Tell which of e fitted epochs, whose costs have shape (e,), do not agree with the site; shape (e,)."""
    limits = limits_of(measurements.known.shape[1])
    heard = measurements.known.sum(axis=1)
    wrong = cost > limits.whole[np.maximum(measurements.freedom, 0)]
    wrong |= (statistics.drop > limits.single[heard[:, None], statistics.freedom]).any(axis=1)
    wrong |= statistics.scale.max(axis=1) > limits.strength[heard]
    wrong |= (statistics.distortion > limits.sensor[np.arange(4), statistics.distortion_freedom]).any(axis=1)
    return np.asarray(wrong)


@dataclass(frozen=True)
class Limits:
    """Chi-squares that sound epochs exceed at the permitted rates; infinite with no degree of freedom.

    ``whole``, by the degrees of freedom; ``single``, by the number of beacons heard and the degrees of freedom;
    ``strength``, by the number heard; ``sensor``, by the test and the degrees of freedom.
    """

    whole: FloatArray
    single: FloatArray
    strength: FloatArray
    sensor: FloatArray


@cache
def limits_of(beacons: int) -> Limits:
    """Return the limits for sites of so many beacons."""
    heard = np.maximum(np.arange(beacons + 1), 1)
    whole = np.append(np.inf, chdtri(np.arange(1.0, 3 * beacons + 1), OF_WHOLE * FALSE_ALARM))
    single = chdtri(np.array([1.0, 1.0, 2.0, 3.0]), OF_SINGLE * FALSE_ALARM / heard[:, None])
    single[:, 0] = np.inf
    sensor = np.full((4, 7), np.inf)
    sensor[:, 1:] = chdtri(np.arange(1.0, 7.0), np.array([*OF_SENSOR, OF_AXIS / 3.0])[:, None] * FALSE_ALARM)
    strength = chdtri(1.0, OF_STRENGTH * FALSE_ALARM / heard)
    return Limits(whole, np.asarray(single), np.asarray(strength), sensor)


def fault_statistics(model: FieldModel, measurements: Measurements, fit: Fit) -> FaultStatistics:
    """Compute the statistics of faults of fitted poses; the kernel in C does it where it knows the coils."""
    quick = kernel.of(model)
    if quick is not None and measurements.levers is None:
        return FaultStatistics(
            *quick.faults(
                measurements.field_T,
                measurements.noise_T,
                fit.position_m,
                fit.rotation,
                errors=measurements.errors,
                least_eigenvalue=UNOBSERVABLE,
                least_share=DETECTABLE,
            )
        )
    whitening = measurements.whitening(model, fit.position_m, fit.rotation)
    residual, modelled = whitened_residual(model, measurements, fit, whitening)
    jacobian = whitened_jacobian(model, fit.position_m, fit.rotation, whitening, measurements.levers)
    root, _ = root_covariance(fit.information)
    rows = root.swapaxes(1, 2) @ jacobian  # (e, 6, 3n): orthonormal, but for the rounding that one Newton step removes
    straight = 1.5 * np.eye(6) - 0.5 * rows @ rows.swapaxes(1, 2)
    rows, root = straight @ rows, root @ straight
    residual = residual - np.einsum("ekm,ekp,ep->em", rows, rows, residual)  # what the pose explains: the fit ended
    tangent = whitening.by_beacon(rows)  # (e, n, c, 6)
    r, s = whitening.by_beacon(residual[:, None])[..., 0], whitening.alone(modelled)
    gain, vector = np.linalg.eigh(whitening.gram - tangent @ tangent.swapaxes(2, 3))
    seen = gain > DETECTABLE
    safe = np.where(seen, gain, 1.0)

    along = np.einsum("enck,enc->enk", vector, r)
    drop = np.where(seen, along**2 / safe, 0.0).sum(axis=2)
    strength = np.einsum("enck,enc->enk", vector, s)
    shown = (strength**2 * gain).sum(axis=2)
    visible = shown > DETECTABLE * (strength**2).sum(axis=2)
    scale = np.where(visible, (strength * along).sum(axis=2) ** 2 / np.where(visible, shown, 1.0), 0.0)

    influence = np.einsum("epk,enck->enpc", root[:, :3], tangent)  # component -> position
    move = np.where(seen[:, :, None, :], influence @ vector / np.sqrt(safe)[:, :, None, :], 0.0)
    separation = np.einsum("enpk,enk->enp", move, along / np.sqrt(safe))
    distortion = _distortion_statistics(residual, rows, modelled, whitening)
    return FaultStatistics(drop, seen.sum(axis=2), scale, separation, move @ move.swapaxes(2, 3), *distortion)


def _distortion_statistics(
    residual: FloatArray, rows: FloatArray, modelled: FloatArray, whitening: Whitening
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return parts of the cost that distortions take away and their degrees of freedom, both of shape (e, 4).

    Whitened residuals have shape (e, 3n), the pose's orthonormal rows (e, 6, 3n), modelled components (e, 3, n). The
    distortions are eliminated one after another; one that the pose or those before it explain does not count.
    """
    count = len(residual)
    column = whitening(np.einsum("kcd,edn->ekcn", DISTORTIONS, modelled))
    square = np.einsum("ekm,ekm->ek", column, column)
    explained = rows @ column.swapaxes(1, 2)
    shown = column @ column.swapaxes(1, 2) - explained.swapaxes(1, 2) @ explained
    along = np.einsum("ekm,em->ek", column, residual)
    left = np.einsum("ak,ekl,al->ea", AXES, shown, AXES)
    apart = left > DETECTABLE * square[:, :1]  # of an axis that is not there rounding is left
    of_axis = np.where(apart, (along @ AXES.T) ** 2 / np.where(apart, left, 1.0), 0.0).max(axis=1)
    parts, counted = np.zeros((count, 6)), np.zeros((count, 6), dtype=np.intp)
    for k in range(6):
        seen = shown[:, k, k] > DETECTABLE * square[:, k]
        pivot = np.where(seen, shown[:, k, k], np.inf)
        parts[:, k], counted[:, k] = along[:, k] ** 2 / pivot, seen
        ratio = shown[:, :, k] / pivot[:, None]
        along = along - ratio * along[:, k, None]
        shown = shown - ratio[:, :, None] * shown[:, None, k]
    last = np.array(GROUPS) - 1
    return (
        np.column_stack([parts.cumsum(axis=1)[:, last], of_axis]),
        np.column_stack([counted.cumsum(axis=1)[:, last], apart.any(axis=1)]),
    )

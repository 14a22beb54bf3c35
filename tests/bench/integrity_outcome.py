"""What the locator said of poses whose truth is known, as arrays, and what counts as a wrong `ok`.

Two rules are applied side by side. By the covariance: the normalised error squared per axis of the position is above
`NEES_LIMIT`; sound noise alone exceeds it once in 40,000 poses. By the distance: the error is above `DISTANCE_M`,
which an honest pose with few or weak beacons may well have.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from goldfield.locate import Locator
from goldfield.locate.fit import Measurements
from goldfield.site import Site
from goldfield.types import Fields, Pose
from tests.bench.locate_trials import Trials, fields_of

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

STATUSES = ("ok", "unverified", "ambiguous", "weak", "inconsistent", "failed")
PASSED = ("ok", "unverified")
"""Statuses of a pose that the locator stands for; `unverified` with a protection level above the alert limit."""
NEES_LIMIT = 8.0
DISTANCE_M = 0.05


@dataclass(frozen=True)
class Outcome:
    """Poses beside their truth, one row each.

    Attributes
    ----------
    status : ndarray of str, shape (e,)
    error_m, nees : ndarray, shape (e,)
        Position error, and its normalised square per axis; NaN where the pose failed.
    protection_m : ndarray, shape (e,)
        Protection level; infinite where nothing is promised, NaN where the pose failed.
    excluded : ndarray of object, shape (e,)
        A frozenset of the beacons left out.
    named : ndarray of object, shape (e,)
        A frozenset of the kinds of explanations that the pose gives.
    """

    status: NDArray[np.str_]
    error_m: FloatArray
    nees: FloatArray
    protection_m: FloatArray
    excluded: NDArray[np.object_]
    named: NDArray[np.object_]

    def __len__(self) -> int:
        return len(self.status)

    def take(self, which: NDArray[np.intp] | BoolArray) -> Outcome:
        return Outcome(*(getattr(self, field.name)[which] for field in fields(self)))

    def counts(self) -> dict[str, int]:
        """Return how many poses have each status."""
        return {status: int((self.status == status).sum()) for status in STATUSES}

    @property
    def ok(self) -> BoolArray:
        return np.asarray(self.status == "ok")

    @property
    def passed(self) -> BoolArray:
        return np.isin(self.status, PASSED)

    @property
    def alarmed(self) -> BoolArray:
        """Tell where the locator said that something is wrong, or left out a beacon."""
        left_out = np.array([bool(names) for names in self.excluded], dtype=bool)
        return np.asarray(left_out | np.isin(self.status, ("inconsistent", "failed")))

    @property
    def wrong_by_covariance(self) -> BoolArray:
        return np.asarray(self.ok & ~(self.nees <= NEES_LIMIT))

    @property
    def wrong_by_distance(self) -> BoolArray:
        return np.asarray(self.ok & ~(self.error_m <= DISTANCE_M))

    @property
    def unprotected(self) -> BoolArray:
        """Tell where a passed pose's error is beyond its protection level."""
        return np.asarray(self.passed & (self.error_m > self.protection_m))


def joined(parts: Iterable[Outcome]) -> Outcome:
    """Return the outcomes one after another."""
    some = list(parts)
    return Outcome(*(np.concatenate([getattr(part, field.name) for part in some]) for field in fields(Outcome)))


def outcome_of(poses: Sequence[Pose], position_m: FloatArray) -> Outcome:
    """Return the outcome of poses whose true positions have shape (e, 3)."""
    error = np.array([pose.position_m for pose in poses]).reshape(-1, 3) - position_m
    covariance = np.array([pose.position_cov_m2 for pose in poses]).reshape(-1, 3, 3)
    known = np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    nees = np.full(len(poses), np.nan)
    nees[known] = [_nees(*one) for one in zip(error[known], covariance[known], strict=True)]
    return Outcome(
        np.array([str(pose.status) for pose in poses], dtype="U16"),
        np.linalg.norm(error, axis=1),
        nees,
        np.array([pose.protection_m for pose in poses], dtype=float),
        _objects(frozenset(pose.excluded) for pose in poses),
        _objects(frozenset(str(finding.kind) for finding in pose.findings) for pose in poses),
    )


def _nees(error: FloatArray, covariance: FloatArray) -> float:
    """Return the normalised error squared per axis, infinite if the covariance is none: not positive definite."""
    variance = np.diag(covariance)
    if not (variance > 0.0).all():
        return np.inf
    scale = 1.0 / np.sqrt(variance)
    eigenvalue, vector = np.linalg.eigh(covariance * scale[:, None] * scale)
    if eigenvalue[0] <= 0.0:
        return np.inf
    return float(((vector.T @ (error * scale)) ** 2 / eigenvalue).sum() / 3.0)


def _objects(values: Iterable[frozenset[str]]) -> NDArray[np.object_]:
    some = list(values)
    result = np.empty(len(some), dtype=object)
    result[:] = some
    return result


def judged(site: Site, run: Trials) -> Outcome:
    """Locate a run on a site and compare with the truth."""
    return outcome_of(Locator(site).locate_many(fields_of(site, run)), run.position_m)


def times_s(site: Site, run: Trials, most: int) -> list[float]:
    """Return the processor time of locating each of the first epochs one by one, s, the least of three times.

    As in ``timeit`` nothing of the interpreter's garbage is collected meanwhile: with all that a bench has imported,
    one collection takes 20 to 90 ms, and falls on some epoch. So does what the load of the machine adds.
    """
    locator, epochs = Locator(site), fields_of(site, run)[:most]
    collects = gc.isenabled()
    gc.disable()
    spent = [min(_time_s(locator, one) for _ in range(3)) for one in epochs]
    if collects:
        gc.enable()
    return spent


def evaluations(site: Site, run: Trials, most: int) -> list[int]:
    """Return how often the field of all coils is evaluated at one pose for each of the first epochs, one by one.

    It is what `goldfield.locate.budget` counts, in the search, the fits and the explanation of an epoch's fields.
    """
    locator, coils = Locator(site), len(site.beacons)
    counted: list[int] = []
    take = Measurements.spend

    def spend(measurements: Measurements, evaluations: int, of: int) -> None:
        counted[-1] += evaluations * of
        take(measurements, evaluations, of)

    with patch.object(Measurements, "spend", spend):
        for epoch in fields_of(site, run)[:most]:
            counted.append(0)
            locator.locate(epoch)
    return [round(fields / coils) for fields in counted]


def _time_s(locator: Locator, epoch: Fields) -> float:
    began = time.thread_time()
    locator.locate(epoch)
    return time.thread_time() - began

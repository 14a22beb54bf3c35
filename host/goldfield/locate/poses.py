"""From fitted and tested solutions to poses: covariance, protection level, status, and the reason in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate import sentences
from goldfield.locate.fault_statistics import FaultStatistics, fault_statistics
from goldfield.locate.fit import Fit, Measurements
from goldfield.locate.integrity import Verdict
from goldfield.locate.protection import protection_level
from goldfield.locate.rotations import quaternions_of
from goldfield.locate.solutions import Solutions
from goldfield.locate.uncertainty import second_order_covariance
from goldfield.site import Site
from goldfield.types import Fields, Finding, FloatArray, Pose, Status

WEAK_POSITION = 0.25
"""A pose is weak if the standard deviation of its position along the worst axis exceeds this part of the distance to
the nearest coil (`FieldModel.nearest_m`): the field then changes its shape within the error and nothing computed from
a linear model can be trusted."""

WEAK_ATTITUDE_RAD = 0.5
"""A pose is weak, too, if the standard deviation of its attitude exceeds this, 29 degrees; the free turn of a sensor
with one axis does not count."""


HEARD = 1.0
"""Energy over the noise, the sum of squares, that all beacons together must have at a pose, or it explains nothing of
the fields: a fit that finds no place for them goes off to where there is none. Real poses have 30 and more."""


@dataclass(frozen=True, eq=False)
class Judged:
    """Solutions of e epochs that heard the same n beacons, and what the tests said of them.

    Attributes
    ----------
    site : Site
    model : FieldModel
        The n beacons.
    names : tuple of str
        Their ids.
    measurements : Measurements
    solutions : Solutions
    statistics : FaultStatistics
        Those of the best poses.
    verdicts : mapping of int to Verdict
        Those of the epochs that raised the alarm.
    images_m : ndarray, shape (e, n)
        How far an image of the best pose is that fits all beacons but one; 0: there is none.
    """

    site: Site
    model: FieldModel
    names: tuple[str, ...]
    measurements: Measurements
    solutions: Solutions
    statistics: FaultStatistics
    verdicts: Mapping[int, Verdict]
    images_m: FloatArray

    def take(self, rows: NDArray[np.intp]) -> Judged:
        """Return some of the epochs."""
        return Judged(
            self.site,
            self.model,
            self.names,
            self.measurements.take(rows),
            self.solutions.take(rows),
            self.statistics.take(rows),
            {k: self.verdicts[i] for k, i in enumerate(rows.tolist()) if i in self.verdicts},
            self.images_m[rows],
        )


@dataclass(frozen=True)
class _Figures:
    """What is computed for the poses of e epochs at once."""

    covariance: FloatArray  # (e, 6, 6)
    protection_m: FloatArray  # (e,)
    worst_beacon: NDArray[np.intp]  # (e,)
    position_sd_m: FloatArray  # (e,), along the worst axis
    turn_sd_rad: FloatArray  # (e,)
    nearest_m: FloatArray  # (e,), `FieldModel.nearest_m`
    strange: NDArray[np.bool_]  # (e,), outside the room in which the metal was learned

    @cached_property
    def weak(self) -> NDArray[np.bool_]:
        far = self.position_sd_m > WEAK_POSITION * self.nearest_m
        return np.asarray(far | (self.turn_sd_rad > WEAK_ATTITUDE_RAD))


def poses_of(epochs: Sequence[Fields], judged: Judged) -> list[Pose]:
    """Return the pose of each epoch."""
    solutions = judged.solutions
    figures = _figures(judged, judged.measurements, solutions.best, judged.statistics, solutions.covariance_widening)
    figures = _with_images(figures, judged.images_m)
    told = [_told(judged, figures, e) for e in range(len(epochs))]
    alternatives: dict[int, Pose] = {}
    contested = np.flatnonzero(solutions.contested)
    if len(contested):
        given, rival = judged.measurements.take(contested), solutions.rival.take(contested)
        statistics = fault_statistics(judged.model, given, rival)
        others = _figures(judged, given, rival, statistics, np.zeros((6, 6)))
        rows = contested.tolist()
        poses = _built(
            [epochs[e] for e in rows], judged.names, given, rival, statistics, others, [told[e] for e in rows], {}
        )
        alternatives.update(zip(rows, poses, strict=True))
    poses = _built(
        epochs, judged.names, judged.measurements, solutions.best, judged.statistics, figures, told, alternatives
    )
    for e in _unheard(judged, np.flatnonzero(figures.weak)):
        verdict = judged.verdicts.get(e)
        reason = sentences.unheard(None if verdict is None else verdict.reason)
        failed = Pose.failed(epochs[e], used=judged.names, reason=reason)
        poses[e] = replace(failed, findings=() if verdict is None else verdict.findings)
    return poses


def _unheard(judged: Judged, weak: NDArray[np.intp]) -> list[int]:
    """Return the epochs at whose pose no beacon would be heard: of the weak ones, as the attitude is unknown there."""
    if not len(weak):
        return []
    modelled = judged.model.field(judged.solutions.best.position_m[weak])
    given = judged.measurements.take(weak)
    energy = np.where(given.measured.any(axis=2), ((modelled / given.noise_T[:, :, None]) ** 2).sum(axis=2), 0.0)
    return [int(e) for e in weak[~(energy.sum(axis=1) > HEARD)]]


def _figures(
    judged: Judged, measurements: Measurements, fit: Fit, statistics: FaultStatistics, widening: FloatArray
) -> _Figures:
    covariance = second_order_covariance(judged.model, measurements, fit.position_m, fit.rotation) + widening
    protection_m, worst = protection_level(measurements, statistics, covariance[:, :3, :3])
    nearest = judged.model.nearest_m(fit.position_m)
    shifts, turns = np.linalg.eigvalsh(np.stack([covariance[:, :3, :3], covariance[:, 3:, 3:]]))
    turn = np.sqrt(np.where(measurements.axes == 1, turns[:, 1], turns[:, 2]))
    metal = judged.model.metal
    strange = np.zeros(len(nearest), dtype=bool) if metal is None else ~metal.learned(fit.position_m)
    protection_m = np.where(strange, np.inf, protection_m)
    return _Figures(covariance, protection_m, worst, np.sqrt(shifts[:, 2]), turn, nearest, strange)


def _with_images(figures: _Figures, images_m: FloatArray) -> _Figures:
    """Let the protection levels reach to the images that one beacon alone rules out."""
    if not images_m.any():  # nearly always
        return figures
    far = images_m.max(axis=1, initial=0.0)
    worst = np.where(far > 0.0, images_m.argmax(axis=1), figures.worst_beacon)
    return replace(figures, protection_m=figures.protection_m + far, worst_beacon=worst)


@dataclass(frozen=True)
class _Told:
    """What is told of an epoch beside its figures."""

    status: Status
    reason: str | None = None
    findings: tuple[Finding, ...] = ()


def _told(judged: Judged, figures: _Figures, e: int) -> _Told:
    """Return what is told of an epoch: the first that holds."""
    solutions, limit = judged.solutions, judged.site.alert_limit_m
    verdict = judged.verdicts.get(e)
    if verdict is not None:
        return _Told(Status.INCONSISTENT, verdict.reason, verdict.findings)
    if solutions.outside[e]:
        return _Told(Status.INCONSISTENT, sentences.OUTSIDE)
    if solutions.contested[e]:
        return _Told(Status.AMBIGUOUS, sentences.ambiguous(solutions.rival.position_m[e]))
    if figures.weak[e]:
        size = (figures.position_sd_m[e], figures.nearest_m[e], figures.turn_sd_rad[e])
        return _Told(Status.WEAK, sentences.weak(*map(float, size)))
    if solutions.bounded[e]:
        return _Told(Status.WEAK, sentences.BOUNDED)
    if figures.strange[e]:
        return _Told(Status.UNVERIFIED, sentences.STRANGE)
    level, beacon = float(figures.protection_m[e]), judged.names[int(figures.worst_beacon[e])]
    if not level <= limit:  # a limit that is no number allows nothing
        return _Told(Status.UNVERIFIED, sentences.unverified(beacon, level, limit))
    return _Told(Status.OK)


def _built(
    epochs: Sequence[Fields],
    names: tuple[str, ...],
    measurements: Measurements,
    fit: Fit,
    statistics: FaultStatistics,
    figures: _Figures,
    told: Sequence[_Told],
    alternatives: Mapping[int, Pose],
) -> list[Pose]:
    freedom = measurements.freedom
    residual = np.sqrt(np.where(freedom > 0, fit.cost / np.maximum(freedom, 1), 0.0)).tolist()
    quaternions = quaternions_of(fit.rotation)
    normalised, protection_m = statistics.normalised().tolist(), figures.protection_m.tolist()
    return [
        Pose(
            epoch=fields.epoch,
            time_s=fields.time_s,
            position_m=fit.position_m[e],
            orientation_xyzw=quaternions[e],
            position_cov_m2=figures.covariance[e, :3, :3],
            attitude_cov_rad2=figures.covariance[e, 3:, 3:],
            residual=residual[e],
            status=told[e].status,
            used=names,
            alternative=alternatives.get(e),
            reason=told[e].reason,
            protection_m=protection_m[e],
            residuals=dict(zip(names, normalised[e], strict=True)),
            findings=told[e].findings,
        )
        for e, fields in enumerate(epochs)
    ]

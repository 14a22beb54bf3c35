"""Location: turns the fields of epochs into poses with status and uncertainty."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate.constellation import Constellation, Solutions
from goldfield.locate.fit import Fit, Measurements
from goldfield.locate.integrity import alarm, exclude, protection_level
from goldfield.locate.site_errors import errors_of
from goldfield.locate.uncertainty import second_order_covariance
from goldfield.site import Site
from goldfield.types import Fields, FloatArray, Pose, Status

WEAK_POSITION = 0.25
"""A pose is weak if the standard deviation of its position along the worst axis exceeds this part of the distance to
the nearest beacon: the field then changes its shape within the error and nothing computed from a linear model can be
trusted."""

WEAK_ATTITUDE_RAD = 0.5
"""A pose is weak, too, if the standard deviation of its attitude exceeds this, 29 degrees; the free turn of a sensor
with one axis does not count."""

LEAST_BEACONS = 3
"""With fewer beacons no pose is computed."""

BATCH = 512
"""Epochs computed at once: enough to hide the interpreter, few enough to stay in the cache."""


class Locator:
    """Locates a sensor on a site; keeps what does not change between epochs.

    Parameters
    ----------
    site : Site
    """

    def __init__(self, site: Site) -> None:
        self.site = site
        self.model = FieldModel(site.beacons)
        self._all = Constellation(self.model, site.half_space)
        self._errors = errors_of(site.beacons, site.sensor)
        self._row = {beacon.id: index for index, beacon in enumerate(site.beacons)}

    def locate(self, fields: Fields) -> Pose:
        """Locate one epoch, with no prior; bad data never raise, the status tells.

        - ``failed``: fewer than three beacons, fewer components than unknowns, fields that are nothing but noise
          (`constellation.SILENCE`), or no finite solution; position NaN.
        - ``inconsistent``: the residual is improbable (`integrity`) and the evidence is too weak to leave out a beacon,
          or leaving out some does not mend it, or the only solution lies outside the site's half-space.
        - ``ambiguous``: another pose explains the fields as well; it is given as ``alternative``.
        - ``weak``: the standard deviation exceeds `WEAK_POSITION` of the range or `WEAK_ATTITUDE_RAD`, or the search
          came to the end of its evaluations.
        - ``ok``: none of these; ``excluded`` lists beacons that did not agree with the site and were left out.
        """
        return self.locate_many([fields])[0]

    @np.errstate(all="ignore")  # nonsense in the data overflows somewhere: what is not finite is then not used
    def locate_many(self, epochs: Sequence[Fields]) -> list[Pose]:
        """Locate many epochs, each with no prior, in the order given; several times quicker than one by one."""
        poses: dict[int, Pose] = {}
        for some, rows, constellation, measurements in self._grouped(epochs):
            members = [epochs[index] for index in some]
            if constellation is None:
                located = [Pose.failed(fields, used=self._names(rows)) for fields in members]
            else:
                located = self._locate(members, rows, constellation, measurements)
            poses.update(zip(some, located, strict=True))
        return [poses[index] for index in range(len(epochs))]

    @np.errstate(all="ignore")
    def fit_all(self, epochs: Sequence[Fields]) -> FloatArray:
        """Return the positions of many epochs, shape (e, 3), trusting every beacon.

        Nothing is tested and no uncertainty computed; a row is NaN where location failed.
        """
        position = np.full((len(epochs), 3), np.nan)
        for some, _, constellation, measurements in self._grouped(epochs):
            if constellation is not None:
                best = constellation.solve(measurements).best
                position[some] = np.where(np.isfinite(best.cost)[:, None], best.position_m, np.nan)
        return position

    @np.errstate(all="ignore")
    def protection_level_m(self, fields: Fields, pose: Pose) -> float:
        """Return the radius, m, that the error of a located epoch exceeds undetected only rarely.

        It is infinite if some beacon's fault could not be detected, and NaN if the pose failed; see
        `integrity.protection_level`.
        """
        if pose.status is Status.FAILED:
            return float("nan")
        rows = np.array([self._row[name] for name in pose.used], dtype=np.intp)
        field, sigma = self._tables([fields])
        constellation = self._all.subset(rows)
        errors = None if self._errors is None else self._errors.subset(rows)
        measurements = Measurements(field[:, rows], sigma[:, rows]).with_errors(constellation.model, errors)
        rotation = Rotation.from_quat(pose.orientation_xyzw).as_matrix()
        fit = constellation.at(measurements, pose.position_m[None], rotation[None])
        return float(protection_level(constellation, measurements, fit)[0])

    def _tables(self, epochs: Sequence[Fields]) -> tuple[FloatArray, FloatArray]:
        """Put the fields in the order of the site's beacons; unknown ids and unusable noise are left out.

        Fields, shape (e, beacons, 3), NaN where not measured, and their standard deviations,
        shape (e, beacons).
        """
        field = np.full((len(epochs), len(self.site.beacons), 3), np.nan)
        sigma = np.ones(field.shape[:2])
        alike: dict[tuple[str, ...], list[int]] = {}
        for index, fields in enumerate(epochs):
            alike.setdefault(fields.beacons, []).append(index)
        for names, members in alike.items():
            given = [index for index, name in enumerate(names) if name in self._row]
            target = np.array(members)[:, None], np.array([self._row[names[index]] for index in given], dtype=np.intp)
            field[target] = np.array([epochs[index].field_T for index in members])[:, given]
            sigma[target] = np.array([epochs[index].sigma_T for index in members])[:, given]
        usable = np.isfinite(sigma) & (sigma > 0.0)
        field[~(usable[:, :, None] & np.isfinite(field))] = np.nan
        sigma[~usable] = 1.0
        return field, sigma

    def _grouped(
        self, epochs: Sequence[Fields]
    ) -> Iterator[tuple[list[int], NDArray[np.intp], Constellation | None, Measurements]]:
        """Group epochs that heard the same beacons: their indices, the beacons' rows, constellation, measurements.

        The constellation is None if the beacons are too few.
        """
        field, sigma = self._tables(epochs)
        heard = np.asarray(np.isfinite(field).any(axis=2))
        groups: dict[bytes, list[int]] = {}
        for index in range(len(epochs)):
            groups.setdefault(heard[index].tobytes(), []).append(index)
        for key, members in groups.items():
            rows = np.flatnonzero(np.frombuffer(key, dtype=bool))
            constellation = self._all.subset(rows) if len(rows) >= LEAST_BEACONS else None
            errors = None if self._errors is None else self._errors.subset(rows)
            for first in range(0, len(members), BATCH):
                some = members[first : first + BATCH]
                measurements = Measurements(field[some][:, rows], sigma[some][:, rows])
                if constellation is not None:
                    measurements = measurements.with_errors(constellation.model, errors)
                yield some, rows, constellation, measurements

    def _names(self, rows: NDArray[np.intp]) -> tuple[str, ...]:
        return tuple(self.site.beacons[int(row)].id for row in rows)

    def _locate(
        self,
        epochs: Sequence[Fields],
        rows: NDArray[np.intp],
        constellation: Constellation,
        measurements: Measurements,
    ) -> list[Pose]:
        """Locate epochs that heard the same beacons, given by their rows."""
        nothing = np.array([], dtype=np.intp)
        solutions = constellation.solve(measurements)
        solved = (measurements.freedom >= 0) & np.isfinite(solutions.best.cost)
        poses = {int(e): Pose.failed(epochs[int(e)], used=self._names(rows)) for e in np.flatnonzero(~solved)}
        some = np.flatnonzero(solved)
        if len(some):
            wrong = alarm(constellation, measurements.take(some), solutions.best.take(some))
            trusted = ~wrong
            for i in np.flatnonzero(wrong):
                e = some[i : i + 1]
                mended = exclude(constellation, measurements.take(e), float(solutions.best.cost[e[0]]))
                if mended is None:
                    trusted[i] = True  # with the alarm: inconsistent
                    continue
                other, excluded = mended
                kept = np.delete(np.arange(len(rows)), excluded)
                thinned = measurements.take(e).of_beacons(kept)
                sound = np.array([False])
                poses[int(e[0])] = self._poses([epochs[int(e[0])]], rows[kept], thinned, other, rows[excluded], sound)[
                    0
                ]
            left = some[trusted]
            if len(left):
                members = [epochs[int(e)] for e in left]
                found = self._poses(
                    members, rows, measurements.take(left), solutions.take(left), nothing, wrong[trusted]
                )
                poses.update(zip((int(e) for e in left), found, strict=True))
        return [poses[e] for e in range(len(epochs))]

    def _poses(
        self,
        epochs: Sequence[Fields],
        rows: NDArray[np.intp],
        measurements: Measurements,
        solutions: Solutions,
        excluded: NDArray[np.intp],
        wrong: NDArray[np.bool_],
    ) -> list[Pose]:
        model = self._all.subset(rows).model
        used, left_out = self._names(rows), self._names(excluded)
        freedom = measurements.freedom

        def build(fit: Fit, which: NDArray[np.intp], status: list[Status], others: list[Pose | None]) -> list[Pose]:
            covariance = second_order_covariance(model, measurements.take(which), fit.position_m, fit.rotation)
            if fit is solutions.best:
                covariance += solutions.covariance_widening
            weak = self._weak(model, measurements.take(which), fit, covariance)
            quaternions = Rotation.from_matrix(fit.rotation, assume_valid=True).as_quat(canonical=True)
            return [
                Pose(
                    epoch=epochs[e].epoch,
                    time_s=epochs[e].time_s,
                    position_m=fit.position_m[i],
                    orientation_xyzw=quaternions[i],
                    position_cov_m2=covariance[i, :3, :3],
                    attitude_cov_rad2=covariance[i, 3:, 3:],
                    residual=float(np.sqrt(fit.cost[i] / freedom[e])) if freedom[e] > 0 else 0.0,
                    status=Status.WEAK if weak[i] and status[i] is Status.OK else status[i],
                    used=used,
                    excluded=left_out,
                    alternative=others[i],
                )
                for i, e in enumerate(which)
            ]

        status = [
            Status.INCONSISTENT
            if out or (bad and not capped)
            else Status.AMBIGUOUS
            if two
            else Status.WEAK
            if capped
            else Status.OK
            for bad, out, two, capped in zip(
                wrong, solutions.outside, solutions.contested, solutions.bounded, strict=True
            )
        ]
        others: list[Pose | None] = [None] * len(epochs)
        contested = np.flatnonzero(solutions.contested)
        if len(contested):
            rivals = build(
                solutions.rival.take(contested), contested, [status[e] for e in contested], [None] * len(contested)
            )
            for e, pose in zip(contested, rivals, strict=True):
                others[e] = pose
        return build(solutions.best, np.arange(len(epochs)), status, others)

    @staticmethod
    def _weak(model: FieldModel, measurements: Measurements, fit: Fit, covariance: FloatArray) -> NDArray[np.bool_]:
        nearest = np.linalg.norm(fit.position_m[:, None] - model.centre_m, axis=2).min(axis=1)
        shifts, turns = np.linalg.eigvalsh(np.stack([covariance[:, :3, :3], covariance[:, 3:, 3:]]))
        worst = np.sqrt(shifts[:, 2])
        turn = np.sqrt(np.where(measurements.axes == 1, turns[:, 1], turns[:, 2]))
        return np.asarray((worst > WEAK_POSITION * nearest) | (turn > WEAK_ATTITUDE_RAD))


@lru_cache(maxsize=8)
def _locator(site: Site) -> Locator:
    return Locator(site)


def locate(site: Site, fields: Fields) -> Pose:
    """Locate the sensor of one epoch on a site, with no prior; `Locator.locate` tells the statuses."""
    return _locator(site).locate(fields)

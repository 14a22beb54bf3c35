"""Location: turns the fields of epochs into poses with status and uncertainty."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate import sentences
from goldfield.locate.budget import Budget
from goldfield.locate.constellation import Constellation
from goldfield.locate.fault_statistics import alarm, fault_statistics
from goldfield.locate.fit import Measurements
from goldfield.locate.images import image_distance_m
from goldfield.locate.integrity import Verdict, explain
from goldfield.locate.poses import Judged, poses_of
from goldfield.locate.sensor_axes import axes_of
from goldfield.locate.silence import audible
from goldfield.locate.site_errors import errors_of
from goldfield.site import Site
from goldfield.types import LEAST_SIGMA_T, Fields, FloatArray, Pose, usable_components

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
        self._axes = axes_of(site.sensor)
        self._row = {beacon.id: index for index, beacon in enumerate(site.beacons)}

    def locate(self, fields: Fields) -> Pose:
        """Locate one epoch, with no prior; bad data never raise, the status tells.

        - ``failed``: fewer than three beacons, fewer components than unknowns, fields that are nothing but noise
          (`silence.SILENCE`), no finite solution, or one from which nothing would be heard (`poses.HEARD`);
          position NaN.
        - ``inconsistent``: the fields do not agree with the site (`fault_statistics`) and leaving out one beacon or two
          does not clearly mend it (`integrity`), or the only solution lies outside the site's half-space.
        - ``ambiguous``: another pose explains the fields as well; it is given as ``alternative``.
        - ``weak``: the standard deviation exceeds `poses.WEAK_POSITION` of the range or `poses.WEAK_ATTITUDE_RAD`, or
          the search came to the end of its evaluations, or nothing explains the fields of a sensor without three axes,
          for which the search is not global.
        - ``unverified``: the protection level (`protection`) exceeds the site's alert limit.
        - ``ok``: none of these; ``excluded`` lists beacons that did not agree with the site and were left out.

        Where several hold the first of them is told; ``reason`` says why.
        """
        return self.locate_many([fields])[0]

    @np.errstate(all="ignore")  # nonsense in the data overflows somewhere: what is not finite is then not used
    def locate_many(self, epochs: Sequence[Fields]) -> list[Pose]:
        """Locate many epochs, each with no prior, in the order given; several times quicker than one by one."""
        poses: dict[int, Pose] = {}
        for some, rows, constellation, measurements in self._grouped(epochs):
            members = [epochs[index] for index in some]
            if constellation is None:
                reason = sentences.few_heard(len(rows), LEAST_BEACONS)
                located = [Pose.failed(fields, used=self._names(rows), reason=reason) for fields in members]
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

    def _tables(self, epochs: Sequence[Fields]) -> tuple[FloatArray, FloatArray]:
        """Put the fields in the order of the site's beacons; unknown ids and unusable noise are left out.

        Fields in the sensor's frame, shape (e, beacons, 3), NaN where not measured, and their standard deviations,
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
        usable = usable_components(field, sigma)
        field[~usable] = np.nan
        sigma = np.where(usable.any(axis=2), np.maximum(sigma, LEAST_SIGMA_T), 1.0)
        if self._axes is not None:
            field, sigma = self._axes.components(field), self._axes.noise_ratio * sigma
        return field, np.hypot(sigma, [beacon.unknown_T for beacon in self.site.beacons])

    def _grouped(
        self, epochs: Sequence[Fields]
    ) -> Iterator[tuple[list[int], NDArray[np.intp], Constellation | None, Measurements]]:
        """Group epochs that heard the same beacons: their indices, the beacons' rows, constellation, measurements.

        The constellation is None if the beacons are too few.
        """
        field, sigma = self._tables(epochs)
        heard = np.asarray(np.isfinite(field).any(axis=2))
        groups: dict[bytes, list[int]] = {}
        flags, width = heard.tobytes(), heard.shape[1]
        for index in range(len(epochs)):
            groups.setdefault(flags[index * width : (index + 1) * width], []).append(index)
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
        names = self._names(rows)
        solutions = constellation.solve(measurements)
        solved = (measurements.freedom >= 0) & np.isfinite(solutions.best.cost)
        poses = {
            int(e): Pose.failed(epochs[int(e)], used=names, reason=self._no_pose(measurements, int(e)))
            for e in np.flatnonzero(~solved)
        }
        some = np.flatnonzero(solved)
        if len(some):
            given, found = measurements.take(some), solutions if solved.all() else solutions.take(some)
            statistics = fault_statistics(constellation.model, given, found.best)
            # A search that came to its end proves nothing by its cost.
            wrong = np.flatnonzero(alarm(given, found.best.cost, statistics) & ~found.bounded)
            verdicts = {}
            for i in wrong.tolist():
                one, budget = np.array([i]), Budget(len(rows))
                budget.spend(int(found.evaluations[i]), len(rows))
                verdict = explain(constellation, given.take(one).within(budget), found.take(one), names)
                if verdict.unknown and not given.complete:
                    # The search for sensors without three axes may miss the best pose, and no rival fits either.
                    found.bounded[i], found.contested[i] = True, False
                else:
                    verdicts[i] = verdict
            for i, verdict in verdicts.items():
                if verdict.rest is not None:
                    e = int(some[i])
                    poses[e] = self._pose_of_rest(epochs[e], rows, constellation, given.take(np.array([i])), verdict)
            images = image_distance_m(constellation, given, found.best, statistics)
            judged = Judged(self.site, constellation.model, names, given, found, statistics, verdicts, images)
            whole = [i for i, e in enumerate(some.tolist()) if e not in poses]
            if len(whole) < len(some):
                judged = judged.take(np.array(whole, dtype=np.intp))
            some = some[whole].tolist()
            poses.update(zip(some, poses_of([epochs[e] for e in some], judged) if some else [], strict=True))
        return [poses[e] for e in range(len(epochs))]

    def _pose_of_rest(
        self,
        fields: Fields,
        rows: NDArray[np.intp],
        constellation: Constellation,
        measurements: Measurements,
        verdict: Verdict,
    ) -> Pose:
        """Return the pose of one epoch without the beacons that its verdict leaves out."""
        assert verdict.rest is not None
        assert verdict.statistics is not None
        kept = np.delete(np.arange(len(rows)), verdict.left_out)
        thinned, others = measurements.of_beacons(kept), constellation.subset(kept)
        names, statistics = self._names(rows[kept]), verdict.statistics
        images = image_distance_m(others, thinned, verdict.rest.best, statistics)
        judged = Judged(self.site, others.model, names, thinned, verdict.rest, statistics, {}, images)
        (pose,) = poses_of([fields], judged)
        left_out = {self._names(rows[[row]])[0]: residual for row, residual in verdict.residuals.items()}
        return replace(
            pose,
            excluded=tuple(left_out),
            reason=verdict.reason if pose.reason is None else f"{pose.reason}; {verdict.reason}",
            residuals={**pose.residuals, **left_out},
            findings=verdict.findings,
        )

    @staticmethod
    def _no_pose(measurements: Measurements, epoch: int) -> str:
        """Say why an epoch has no pose."""
        if measurements.freedom[epoch] < 0:
            return sentences.few_components(int(measurements.count[epoch]), int(measurements.unknowns[epoch]))
        heard = audible(measurements.take(np.array([epoch])))[0]
        return sentences.NO_FIT if heard else sentences.NOISE


@lru_cache(maxsize=8)
def _locator(site: Site) -> Locator:
    return Locator(site)


def locate(site: Site, fields: Fields) -> Pose:
    """Locate the sensor of one epoch on a site, with no prior; `Locator.locate` tells the statuses."""
    return _locator(site).locate(fields)

"""Anchors as witnesses: beacons with a sensor see when one of them is moved, or metal is brought near.

An anchor stands still, so that the field of each beacon at it is a constant. The first cycles tell that constant, later
ones are compared with it: no survey is as exact, and none is needed. The own field of an anchor is a thousand times
that of another one and tells a shift of the coil against its sensor by a tenth of a millimetre; those of the others
tell it if the whole mast was moved, as far as they are strong enough.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.access.epoch import EpochSeparator
from goldfield.field import FieldModel
from goldfield.link.heartbeat import ROLE_ANCHOR
from goldfield.link.reports import Assembler
from goldfield.locate import locate
from goldfield.locate.chances import chdtri
from goldfield.locate.rotations import matrix_of
from goldfield.sensor.moved_together import moved_together
from goldfield.site import Beacon, Site
from goldfield.track.witness import strength_finding
from goldfield.types import Explanation, Fields, Finding, FloatArray, Status
from goldfield_protocol.messages import Message

REFERENCE_S = 2.0
"""Time over which an anchor's fields are averaged before anything is compared with them."""
LONGEST_REFERENCE_S = 600.0
"""Time over which the reference goes on to be averaged: slower changes are not noticed."""

RECENT_S = 2.0
"""Time over which the later fields are averaged; every shorter time is tried too."""

DRIFT = 5e-4
"""Part of a field by which it may change by itself: coils warm up, and a step of a set-point is 0.02 %."""

FALSE_ALARMS_PER_HOUR = 0.01
"""Permitted rate of findings though nothing was changed."""

CLEAR = 20.0
"""A beacon is named only if the changes at it and of it cost more, by this, than those of any other."""

ELSEWHERE = 0.02
"""Nor is it if a pair of others has changed at a cost above this part of its own: metal near it reaches them so little,
another beacon that was moved, too, does not."""

UNEXPLAINED = 1e-6
"""A change of current explains the changes of all anchors if they leave a cost of more than this probability."""

HEARD = 5.0
"""A beacon whose mean field is weaker than so many standard deviations has no reference: it may be off."""
UNSTEADY = 1e-6
"""Nor has one whose fields scatter as much only with this probability: it may just be switched on."""
ALIKE = 30.0
"""Fields that differ from their reference by a chi-square above this do not go into it."""

SILENT_CYCLES = 3
"""An anchor that is so many cycles behind the others is silent: what it saw last does not count."""

LEAST_SHIFT_M = 0.005
"""A shift below this is not told as one: metal near a coil looks the same."""


def left_out(finding: Finding | None) -> tuple[str, ...]:
    """Return the beacons that a finding leaves out: none if it does not tell which of them are wrong."""
    return () if finding is None or finding.kind is Explanation.UNKNOWN else finding.beacons


class AnchorWatch:
    """Listens to the anchors on a link.

    Parameters
    ----------
    site : Site

    Attributes
    ----------
    finding : Finding or None
        The beacon whose fields have changed, ``moved`` with the place where it fits better, or ``beacon``; of several
        that were moved together see `moved_together`.
    """

    def __init__(self, site: Site) -> None:
        self.finding: Finding | None = None
        self._site = site
        self._row = {beacon.id: row for row, beacon in enumerate(site.beacons)}
        self._anchors: dict[int, _Anchor] = {}
        self._cycle = 0

    @property
    def named(self) -> tuple[str, ...]:
        """Ids of the beacons whose fields do not count because of that."""
        return left_out(self.finding)

    def take(self, message: Message) -> None:
        """Take any message of the link, in the order of arrival."""
        if message.name == "HEARTBEAT":
            if message.signals["role"] == ROLE_ANCHOR and message.node not in self._anchors:
                self._anchors[message.node] = _Anchor(self._site)
            return
        anchor = self._anchors.get(message.node)
        if anchor is not None and anchor.take(message):
            self._cycle = anchor.cycle
            self.finding = self._found()

    def _found(self) -> Finding | None:
        """Judge the changes at all anchors that speak, over the same time at each."""
        anchors = [one for one in self._anchors.values() if one.ready and abs(self._cycle - one.cycle) < SILENT_CYCLES]
        if not anchors:
            return None
        starts = min(len(anchor.changes.cost) for anchor in anchors)
        costs = np.array([anchor.changes.cost[:starts] for anchor in anchors])  # (anchors, starts, n)
        tests = 3600.0 / self._site.cycle_s * costs[:, 0].size * len(anchors[0].starts)
        limit = float(chdtri(3.0, FALSE_ALARMS_PER_HOUR / tests))
        if costs.max() <= limit:
            return None
        start = int(costs.max(axis=(0, 2)).argmax())
        cost = costs[:, start]
        touched = cost.sum(axis=0)
        for place, anchor in enumerate(anchors):
            touched[anchor.own] += np.delete(cost[place], anchor.own).sum()
        row = int(np.argmax(touched))
        own = np.array([anchor.own for anchor in anchors])
        others = np.delete(cost[own != row], row, axis=1).max(initial=0.0)
        alone = others <= max(limit, ELSEWHERE * max(cost[:, row].max(), cost[own == row].max(initial=0.0)))
        if len(touched) > 1 and not (alone and touched[row] > np.delete(touched, row).max() + CLEAR):
            changed = np.zeros((len(touched), len(touched)), dtype=bool)
            changed[own] = cost > limit
            return moved_together(changed, tuple(self._row))
        return self._explained(row, anchors, [anchor.changes.over(start) for anchor in anchors])

    def _explained(self, row: int, anchors: list[_Anchor], windows: list[_Changes]) -> Finding:
        """Say what explains the changed fields of a beacon: another current, else another place, else metal."""
        beacon = self._site.beacons[row]
        seen = [(a, w) for a, w in zip(anchors, windows, strict=True) if a.learned[row]]
        part, left = _current_part(row, [changes for _, changes in seen])
        if left <= chdtri(3.0 * len(seen) - 1.0, UNEXPLAINED):
            found = strength_finding(beacon.id, 1.0 + part)
            if found.kind is not Explanation.CURRENT:
                return found
            text = f"anchors see {found.factor:.3g} times the former field of {beacon.id}: check its current, or metal"
            return replace(found, text=f"{text} is near")
        d = _shift(beacon, row, seen)
        far = float(np.linalg.norm(d))
        what = f"anchors see that the fields of {beacon.id} have changed"
        if far < LEAST_SHIFT_M:
            text = f"{what}: metal near it, or it was moved together with its sensor"
            return Finding(Explanation.BEACON, (beacon.id,), text)
        place = beacon.position_m + d
        where = ", ".join(f"{value:.3f}" for value in place)
        text = f"{what}: its position fits better at {where} m, {100.0 * far:.1f} cm from the site's, or metal is near"
        return Finding(Explanation.MOVED, (beacon.id,), text, position_m=place)


def _current_part(row: int, windows: list[_Changes]) -> tuple[float, float]:
    """Return by which part of itself a beacon's current would have changed, and the cost that this leaves."""
    information = sum(float(w.mean_T[row] @ w.mean_T[row] / w.variance_T2[row]) for w in windows)
    score = sum(float(w.mean_T[row] @ w.change_T[row] / w.variance_T2[row]) for w in windows)
    part = score / max(information, 1e-300)
    return part, sum(float(w.cost[row]) for w in windows) - part * score


def _shift(beacon: Beacon, row: int, seen: list[tuple[_Anchor, _Changes]]) -> FloatArray:
    """Return by how much a beacon was moved, shape (3,), m; zero if the anchors do not tell it to `LEAST_SHIFT_M`.

    The field of each pair changes by -R' G d if its coil is shifted by d.
    """
    information, score = np.zeros((3, 3)), np.zeros(3)
    for anchor, changes in seen:
        if anchor.place is None:
            continue
        position, rotation = anchor.place
        _, gradient = FieldModel([beacon]).evaluate(position)
        shift = -rotation.T @ gradient[:, :, 0]
        information += shift.T @ shift / changes.variance_T2[row]
        score += shift.T @ changes.change_T[row] / changes.variance_T2[row]
    told = np.linalg.eigvalsh(information)[0] > LEAST_SHIFT_M**-2
    return np.asarray(np.linalg.solve(information, score) if told else np.zeros(3))


@dataclass(frozen=True, eq=False)
class _Changes:
    """Changes of n beacons' fields at an anchor from their means; the latest fields are averaged over several times.

    ``change_T`` has the shape (times, n, 3), ``variance_T2`` and the chi-square ``cost`` (times, n), ``mean_T`` (n, 3).
    """

    change_T: FloatArray
    variance_T2: FloatArray
    cost: FloatArray
    mean_T: FloatArray

    def over(self, time: int) -> _Changes:
        """Return those of one time, without the leading axis."""
        return _Changes(self.change_T[time], self.variance_T2[time], self.cost[time], self.mean_T)


class _Anchor:
    """One anchor: its references and its latest fields.

    A reference is the mean of a beacon's fields over `REFERENCE_S` in which they agree and are not nothing; one that is
    switched on later gets its reference then.

    Attributes
    ----------
    cycle : int
        The latest cycle.
    learned : ndarray of bool, shape (n,)
        Which beacons have a reference.
    own : int
        The row of its own beacon: the strongest.
    place : (position, rotation) or None
        The pose of its sensor; None: the beacons do not tell it.
    changes : _Changes
        The latest fields against the references; only if it is ``ready``.
    """

    changes: _Changes

    def __init__(self, site: Site) -> None:
        self._site = site
        self._assembler = Assembler()
        self._separator = EpochSeparator(site)
        self._row = {beacon.id: row for row, beacon in enumerate(site.beacons)}
        recent, self._least, self._longest = (
            max(round(seconds / site.cycle_s), 1) for seconds in (RECENT_S, REFERENCE_S, LONGEST_REFERENCE_S)
        )
        self.starts = np.unique(np.linspace(1, recent, 20).round().astype(int))
        self._recent: deque[FloatArray] = deque(maxlen=recent)
        n = len(site.beacons)
        self._mean, self._square = np.zeros((n, 3)), np.zeros(n)
        self._sigma_T = np.zeros(n)
        self._count = np.zeros(n, dtype=int)
        self.cycle, self.own = 0, 0
        self.learned = np.zeros(n, dtype=bool)
        self.place: tuple[FloatArray, FloatArray] | None = None

    @property
    def ready(self) -> bool:
        """Whether there is a reference, and something to compare with it."""
        return bool(self._recent)

    def take(self, message: Message) -> bool:
        """Take one of its messages; return whether that ended a cycle."""
        reports = list(self._assembler.feed(message, 0.0))
        for report in reports:
            whole = report.chips == self._site.chips and not report.saturated and report.locked is not False
            if report.complete and whole:
                fields = self._separator.fields(report)
                if len(fields.beacons) == len(self._row):
                    self._add(report.cycle, fields)
        return bool(reports)

    def _add(self, cycle: int, fields: Fields) -> None:
        rows = [self._row[name] for name in fields.beacons]
        latest = np.empty_like(self._mean)
        latest[rows], self._sigma_T[rows] = fields.field_T, fields.sigma_T
        if abs(cycle - self.cycle) >= SILENT_CYCLES:
            self._recent.clear()
        self.cycle = cycle
        if self.ready and len(self._recent) == self._recent.maxlen:
            self._follow(self._recent[0])
        self._learn(latest)
        if self.learned.any():
            self._recent.append(latest)
            self.changes = self._changes()

    def _learn(self, latest: FloatArray) -> None:
        """Add fields to the references that are not complete; judge those that are complete now."""
        new = ~self.learned
        self._average(latest, new)
        deviation = ((latest - self._mean) ** 2).sum(axis=1)
        self._square[new] += (deviation * self._count / np.maximum(self._count - 1, 1))[new]
        full = new & (self._count >= self._least)
        if not full.any():
            return
        heard = (self._mean**2).sum(axis=1) > HEARD**2 * self._sigma_T**2 / self._least
        noise = self._sigma_T**2 + self._floor()
        steady = self._square < chdtri(3.0 * (self._least - 1), UNSTEADY) * noise
        self.learned |= full & heard & steady
        again = full & ~(heard & steady)
        self._count[again], self._mean[again], self._square[again] = 0, 0.0, 0.0
        if (full & self.learned).any():
            self._recent.clear()
            self._settle()

    def _follow(self, old: FloatArray) -> None:
        """Let what leaves the latest fields go into the reference of each beacon, unless it or they differ from it."""
        cost = ((old - self._mean) ** 2).sum(axis=1) / (self._sigma_T**2 + self._floor())
        alike = (cost <= ALIKE) & (self.changes.cost.max(axis=0) <= ALIKE)
        self._average(old, self.learned & alike)

    def _average(self, fields_T: FloatArray, which: NDArray[np.bool_]) -> None:
        self._count[which] = np.minimum(self._count[which] + 1, self._longest)
        self._mean[which] += (fields_T - self._mean)[which] / self._count[which, None]

    def _floor(self) -> FloatArray:
        return np.asarray(DRIFT**2 * (self._mean**2).sum(axis=1))

    def _changes(self) -> _Changes:
        latest = np.array(self._recent)[::-1]
        epochs = self.starts[self.starts <= len(latest)]
        change = np.cumsum(latest, axis=0)[epochs - 1] / epochs[:, None, None] - self._mean
        variance = self._sigma_T**2 * (1.0 / epochs[:, None] + 1.0 / np.maximum(self._count, 1)) + self._floor()
        cost = np.where(self.learned, (change**2).sum(axis=2) / variance, 0.0)
        return _Changes(change, variance, cost, self._mean.copy())

    def _settle(self) -> None:
        """Tell from the references which beacon the anchor itself is, and where its sensor stands."""
        size = np.where(self.learned, np.linalg.norm(self._mean, axis=1), 0.0)
        self.own = int(np.argmax(size))
        ids = tuple(beacon.id for beacon, known in zip(self._site.beacons, self.learned, strict=True) if known)
        sigma = np.hypot(self._sigma_T / np.sqrt(np.maximum(self._count, 1)), DRIFT * size)
        pose = locate(self._site, Fields(0, 0.0, ids, self._mean[self.learned], sigma[self.learned]))
        known = pose.status is not Status.FAILED
        self.place = (pose.position_m, matrix_of(pose.orientation_xyzw)) if known else None

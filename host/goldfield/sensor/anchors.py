"""Anchors as witnesses: beacons with a sensor see when one of them is moved, or metal is brought near.

An anchor stands still, so that the field of each beacon at it is a constant. The first cycles tell that constant, later
ones are compared with it: no survey is as exact, and none is needed. The own field of an anchor is a thousand times
that of another one and tells a shift of the coil against its sensor by a tenth of a millimetre; those of the others
tell it if the whole mast was moved, as far as they are strong enough.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from goldfield.access.epoch import EpochSeparator
from goldfield.field import FieldModel
from goldfield.link.reports import Assembler
from goldfield.locate import locate
from goldfield.site import Site
from goldfield.types import Explanation, Fields, Finding, FloatArray, Status
from goldfield_protocol.messages import Message

ROLE_ANCHOR = 3

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

LEAST_SHIFT_M = 0.005
"""A shift below this is not told as one: metal near a coil looks the same."""


class AnchorWatch:
    """Listens to the anchors on a link.

    Parameters
    ----------
    site : Site

    Attributes
    ----------
    finding : Finding or None
        The beacon whose fields have changed, ``moved`` with the place where it fits better, or ``beacon``.
    """

    def __init__(self, site: Site) -> None:
        self.finding: Finding | None = None
        self._site = site
        self._row = {beacon.id: row for row, beacon in enumerate(site.beacons)}
        self._anchors: dict[int, _Anchor] = {}

    @property
    def named(self) -> tuple[str, ...]:
        """Id of the beacon whose fields have changed, if there is one."""
        return () if self.finding is None else self.finding.beacons

    def take(self, message: Message) -> None:
        """Take any message of the link, in the order of arrival."""
        if message.name == "HEARTBEAT":
            if message.signals["role"] == ROLE_ANCHOR and message.node not in self._anchors:
                self._anchors[message.node] = _Anchor(self._site)
            return
        anchor = self._anchors.get(message.node)
        if anchor is not None and anchor.take(message):
            self.finding = self._found()

    def _found(self) -> Finding | None:
        """Judge the changes at all anchors."""
        count = len(self._row)
        windows = [anchor.changes() for anchor in self._anchors.values() if anchor.ready]
        if not windows:
            return None
        anchors = [anchor for anchor in self._anchors.values() if anchor.ready]
        cost = np.array([changes.cost for changes in windows])  # (anchors, n)
        tests = 3600.0 / self._site.cycle_s * cost.size * len(anchors[0].starts)
        if cost.max() <= chdtri(3.0, FALSE_ALARMS_PER_HOUR / tests):
            return None
        touched = cost.sum(axis=0)
        for place, anchor in enumerate(anchors):
            if anchor.own is not None:
                touched[anchor.own] += np.delete(cost[place], anchor.own).sum()
        row = int(np.argmax(touched))
        if count > 1 and touched[row] <= np.delete(touched, row).max() + CLEAR:
            return None
        return self._explained(row, anchors, windows)

    def _explained(self, row: int, anchors: list[_Anchor], windows: list[_Changes]) -> Finding:
        """Say where a beacon fits better; the field of each pair changes by -R' G d if its coil is shifted by d."""
        beacon = self._site.beacons[row]
        information, score = np.zeros((3, 3)), np.zeros(3)
        for anchor, changes in zip(anchors, windows, strict=True):
            if anchor.place is None or not np.isfinite(changes.change_T[row]).all():
                continue
            position, rotation = anchor.place
            _, gradient = FieldModel([beacon]).evaluate(position)
            shift = -rotation.T @ gradient[:, :, 0]
            information += shift.T @ shift / changes.variance_T2[row]
            score += shift.T @ changes.change_T[row] / changes.variance_T2[row]
        seen = np.linalg.eigvalsh(information)[0] > LEAST_SHIFT_M**-2
        d = np.linalg.solve(information, score) if seen else np.zeros(3)
        far = float(np.linalg.norm(d))
        what = f"anchors see that the fields of {beacon.id} have changed"
        if far < LEAST_SHIFT_M:
            text = f"{what}: metal near it, or it was moved together with its sensor"
            return Finding(Explanation.BEACON, (beacon.id,), text)
        place = beacon.position_m + d
        where = ", ".join(f"{value:.3f}" for value in place)
        text = f"{what}: its position fits better at {where} m, {100.0 * far:.1f} cm from the site's, or metal is near"
        return Finding(Explanation.MOVED, (beacon.id,), text, position_m=place)


class _Changes:
    """Change of each beacon's field at an anchor, shape (n, 3), T; its variance, T^2, and cost, both of shape (n,)."""

    def __init__(self, change_T: FloatArray, variance_T2: FloatArray) -> None:
        self.change_T, self.variance_T2 = change_T, variance_T2
        self.cost: FloatArray = np.nan_to_num((change_T**2).sum(axis=1) / variance_T2)


class _Anchor:
    """One anchor: its reference and its latest fields; ``own`` is its beacon's row, ``place`` its sensor's pose."""

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
        self._mean = np.full((len(site.beacons), 3), np.nan)
        self._sigma_T = np.full(len(site.beacons), np.nan)
        self._count = 0
        self.own: int | None = None
        self.place: tuple[FloatArray, FloatArray] | None = None

    @property
    def ready(self) -> bool:
        """Whether there is a reference, and something to compare with it."""
        return self._count >= self._least and bool(self._recent)

    def take(self, message: Message) -> bool:
        """Take one of its messages; return whether it ended a cycle."""
        reports = list(self._assembler.feed(message, 0.0))
        for report in reports:
            whole = report.chips == self._site.chips and not report.saturated and report.locked is not False
            if report.complete and whole:
                self._add(self._separator.fields(report))
        return bool(reports)

    def changes(self) -> _Changes:
        """Return the change over the time, up to `RECENT_S`, that shows it best."""
        latest = np.array(self._recent)[::-1]
        means = np.cumsum(latest, axis=0) / np.arange(1, len(latest) + 1)[:, None, None]
        best: _Changes | None = None
        floor = DRIFT**2 * (self._mean**2).sum(axis=1)
        for epochs in self.starts[self.starts <= len(latest)]:
            variance = self._sigma_T**2 * (1.0 / epochs + 1.0 / self._count) + floor
            found = _Changes(means[epochs - 1] - self._mean, variance)
            if best is None or found.cost.max() > best.cost.max():
                best = found
        assert best is not None
        return best

    def _add(self, fields: Fields) -> None:
        latest = np.full_like(self._mean, np.nan)
        rows = [self._row[name] for name in fields.beacons]
        latest[rows] = fields.field_T
        self._sigma_T[rows] = fields.sigma_T
        if len(self._recent) == self._recent.maxlen or self._count < self._least:
            # What leaves the latest ones goes into the reference, unless it differs from it.
            old = latest if self._count < self._least else self._recent[0]
            if self._count < self._least or not self._changed(old):
                self._count = min(self._count + 1, self._longest)
                self._mean = old if self._count == 1 else self._mean + (old - self._mean) / self._count
            if self._count == self._least and self.own is None:
                self._settle()
                return
        if self._count >= self._least and self.own is not None:
            self._recent.append(latest)

    def _changed(self, fields_T: FloatArray) -> bool:
        variance = self._sigma_T**2 + DRIFT**2 * (self._mean**2).sum(axis=1)
        return bool(_Changes(fields_T - self._mean, variance).cost.max() > 30.0 or self.changes().cost.max() > 30.0)

    def _settle(self) -> None:
        """Tell from the reference which beacon the anchor itself is, and where its sensor stands."""
        self.own = int(np.nanargmax(np.nan_to_num(np.linalg.norm(self._mean, axis=1))))
        measured = np.isfinite(self._mean).all(axis=1)
        ids = tuple(beacon.id for beacon, known in zip(self._site.beacons, measured, strict=True) if known)
        sigma = np.hypot(self._sigma_T / np.sqrt(self._count), DRIFT * np.linalg.norm(self._mean, axis=1))
        pose = locate(self._site, Fields(0, 0.0, ids, self._mean[measured], sigma[measured]))
        if pose.status is not Status.FAILED:
            self.place = pose.position_m, Rotation.from_quat(pose.orientation_xyzw).as_matrix()

"""The recording of a sensor that was turned by hand, as arrays: beacons' fields and the mean field of each cycle.

A sensor that turns sweeps the earth's field over its axes, which codes do not cancel: of each cycle the ramp and the
curve of the mean field, by its neighbours before and after, are taken out of the separated fields.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from goldfield.access.epoch import EpochSeparator
from goldfield.access.gold import code_matrix
from goldfield.access.moving import sample_times
from goldfield.access.sweep import cycle_weights
from goldfield.link.reports import Report
from goldfield.site import Site
from goldfield.types import Fields, FloatArray

NEIGHBOUR = 0.25
"""Largest part of a cycle by which the time between two cycles in a row may differ from a cycle."""
OFFSET_STEP_T = 1e-9
"""Step in which a board tells the mean field."""


@dataclass(frozen=True, eq=False)
class Turn:
    """Cycles of one sensor in the order of their times; k cycles, n beacons of the site.

    Attributes
    ----------
    epoch : ndarray of int, shape (k,)
    time_s : ndarray, shape (k,)
        Middle of each cycle.
    field_T : ndarray, shape (k, n, 3)
        What the sensor's axes read of each beacon's field; NaN where it was not measured.
    sigma_T : ndarray, shape (k, n)
    mean_T : ndarray, shape (k, 3)
        Mean reading of each cycle, without the beacons' part: the earth's field and the offset; NaN where not known.
    mean_sigma_T : float
    cycle_s : float
    """

    epoch: NDArray[np.int64]
    time_s: FloatArray
    field_T: FloatArray
    sigma_T: FloatArray
    mean_T: FloatArray
    mean_sigma_T: float
    cycle_s: float

    def __len__(self) -> int:
        """Return the number of cycles."""
        return len(self.epoch)

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> Turn:
        """Return some of the cycles."""
        kept = {name: getattr(self, name)[rows] for name in ("epoch", "time_s", "field_T", "sigma_T", "mean_T")}
        return replace(self, **kept)

    def fields(self, site: Site) -> list[Fields]:
        """Return the cycles for `goldfield.locate`."""
        names = tuple(beacon.id for beacon in site.beacons)
        rows = zip(self.epoch.tolist(), self.time_s.tolist(), self.field_T, self.sigma_T, strict=True)
        return [Fields(epoch, time_s, names, field, sigma) for epoch, time_s, field, sigma in rows]


def turn_of_fields(site: Site, epochs: Iterable[Fields]) -> Turn:
    """Return the recording of a table of fields, which tells nothing of the earth's field."""
    return _turn(site, [(fields, np.full(3, np.nan)) for fields in epochs])


def turn_of_reports(site: Site, reports: Iterable[Report]) -> Turn:
    """Return the recording of a sensor's reports; cycles with lost or saturated chips are left out.

    Raises
    ------
    UserError
        If the site's codes cannot be separated.
    """
    separator = EpochSeparator(site)
    sums = code_matrix(site.degree, site.codes).astype(np.float64).mean(axis=0)
    rows = []
    for report in reports:
        fields = separator.fields(report)
        sound = report.chips == site.chips and not report.saturated and report.locked and np.isfinite(fields.time_s)
        if not sound or not fields.beacons or report.offset_T is None:
            continue
        part = sums[[site.codes.index(site.beacon(name).code) for name in fields.beacons]]
        rows.append((fields, report.offset_T - part @ np.nan_to_num(fields.field_T)))
    return _without_sweep(site, _turn(site, rows))


def _turn(site: Site, rows: Sequence[tuple[Fields, FloatArray]]) -> Turn:
    index = {beacon.id: row for row, beacon in enumerate(site.beacons)}
    field_T = np.full((len(rows), len(index), 3), np.nan)
    sigma_T = np.full((len(rows), len(index)), np.inf)
    for row, (fields, _) in enumerate(rows):
        places = [index[name] for name in fields.beacons]
        field_T[row, places], sigma_T[row, places] = fields.field_T, fields.sigma_T
    noise_T = site.sensor.noise_T / np.sqrt(site.chips)
    turn = Turn(
        epoch=np.array([fields.epoch for fields, _ in rows], dtype=np.int64),
        time_s=np.array([fields.time_s for fields, _ in rows], dtype=np.float64),
        field_T=field_T,
        sigma_T=sigma_T,
        mean_T=np.array([mean for _, mean in rows], dtype=np.float64).reshape(-1, 3),
        mean_sigma_T=float(np.hypot(noise_T, OFFSET_STEP_T / np.sqrt(12.0))),
        cycle_s=site.cycle_s,
    )
    order = np.argsort(turn.time_s, kind="stable")
    return turn.take(order)


def _without_sweep(site: Site, turn: Turn) -> Turn:
    """Return the cycles with a neighbour on both sides, without what the sweep of the mean does to their fields."""
    steps = np.diff(turn.time_s) / turn.cycle_s
    close = np.abs(steps - 1.0) < NEIGHBOUR
    inner = np.zeros(len(turn), dtype=bool)
    inner[1:-1] = close[:-1] & close[1:]
    before, here, after = turn.mean_T[:-2], turn.mean_T[1:-1], turn.mean_T[2:]
    ramp, curve = np.zeros_like(turn.mean_T), np.zeros_like(turn.mean_T)
    ramp[1:-1], curve[1:-1] = 0.5 * (after - before), before - 2.0 * here + after
    times = sample_times(site.chips)
    weights, _ = cycle_weights(site, [beacon.id for beacon in site.beacons])
    leaks = np.stack([weights @ times, weights @ (0.5 * times**2)])
    swept = np.einsum("sn,skc->knc", leaks, np.stack([ramp, curve]))
    return replace(turn, field_T=turn.field_T - swept).take(inner)


def smear(turn: Turn, rotation: FloatArray) -> FloatArray:
    """Return by what matrix the mean over a cycle of a turning sensor differs from its middle, shape (k, 3, 3).

    At a constant rate w the mean over the time T of what the sensor sees of a constant vector is that in the middle,
    with the part at right angles to w times sin(w T / 2) / (w T / 2). The rate is the mean of those to the cycles
    before and after, as far as they follow each other; a cycle without any stands for one at rest.

    Parameters
    ----------
    rotation : ndarray, shape (k, 3, 3)
        From the sensor's frame to the site's.
    """
    close = np.abs(np.diff(turn.time_s) / turn.cycle_s - 1.0) < NEIGHBOUR
    steps = Rotation.from_matrix(np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]).as_rotvec() * close[:, None]
    sums, counts = np.zeros((len(turn), 3)), np.zeros(len(turn))
    for side in (slice(1, None), slice(None, -1)):
        sums[side] += steps
        counts[side] += close
    turned = sums / np.maximum(counts, 1.0)[:, None]
    angle = np.linalg.norm(turned, axis=1)
    axis = turned / np.maximum(angle, 1e-300)[:, None]
    along = axis[:, :, None] * axis[:, None, :]
    return np.asarray(along + np.sinc(angle / (2.0 * np.pi))[:, None, None] * (np.eye(3) - along))

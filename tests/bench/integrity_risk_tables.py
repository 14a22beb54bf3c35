"""Tables of the integrity figures: the risk per epoch and hour, with no fault, with one, and with the worst one.

Epochs are counted room by room and not kept: a row of 10^6 epochs needs no more memory than one of 10^4.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tests.bench.integrity_adversary import worst_faults
from tests.bench.integrity_beacon_tables import BEACONS, Located, located, rooms
from tests.bench.integrity_coils import Coils, measured
from tests.bench.integrity_faults import SINGLE
from tests.bench.integrity_outcome import judged
from tests.bench.integrity_risk import CORRELATION_S, per_hour, upper_limit
from tests.bench.integrity_run import Run
from tests.bench.integrity_sites import sigma_of
from tests.bench.integrity_tables import POSES, Cell, Column, Table, progress, within
from tests.bench.locate_trials import Trials

PLACES = ("cube 2 mG", "cube .2 mG", *(f"hall of {n}" for n in BEACONS))


class Histogram:
    """Counts of positive numbers in steps of 1 %, from 1e-9 to 1e9: quantiles of any number of numbers."""

    STEP = float(np.log(1.01))
    LEAST = 1e-9

    def __init__(self) -> None:
        self._counts = np.zeros(int(np.log(1e18) / self.STEP) + 2, dtype=np.int64)

    def add(self, values: np.ndarray) -> None:
        """Count numbers; those outside the range count as at its end."""
        steps = np.log(np.maximum(values, self.LEAST) / self.LEAST) / self.STEP
        bins = np.minimum(steps, len(self._counts) - 1).astype(np.intp)
        self._counts += np.bincount(bins, minlength=len(self._counts))

    def quantile(self, share: float) -> float:
        """Return a quantile, right to 1 %; NaN of nothing."""
        total = self._counts.cumsum()
        if not total[-1]:
            return float("nan")
        return float(self.LEAST * np.exp(self.STEP * (np.searchsorted(total, share * total[-1]) + 0.5)))


@dataclass
class Tally:
    """What is counted of a row of the table of risks."""

    epochs: int = 0
    ok: int = 0
    hazards: int = 0
    unverified: int = 0
    ratio: Histogram = field(default_factory=Histogram)
    floor: Histogram = field(default_factory=Histogram)
    level: Histogram = field(default_factory=Histogram)

    def add(self, some: Located) -> None:
        """Count epochs."""
        outcome = some.outcome
        leveled = np.isfinite(outcome.protection_m)
        wrong = outcome.unprotected | (outcome.wrong_by_covariance & ~leveled)
        self.epochs += len(outcome)
        self.ok += int(outcome.ok.sum())
        self.hazards += int((wrong & outcome.ok).sum())
        self.unverified += int((wrong & ~outcome.ok).sum())
        told = outcome.ok & leveled
        self.ratio.add((outcome.protection_m / outcome.error_m)[told])
        self.floor.add((some.floor_m / outcome.error_m)[told])
        self.level.add(outcome.protection_m[outcome.passed & leveled])


def risk(run: Run) -> None:
    """Print the integrity risk as aviation states it, with and without single faults."""
    table = Table(
        "Integrity risk: errors beyond protection_m, of epochs without and with one fault",
        "HMI: hazardously misleading, `ok` and beyond protection_m (or NEES/3 above 8, if that is infinite);\n"
        "95 %: upper limit of the risk by Clopper and Pearson, an epoch, and an hour with one independent\n"
        f"epoch every {CORRELATION_S:g} s; one fault: of one beacon in every epoch, any kind; unver: HMI of\n"
        "`unverified`; PL/err: median of `ok`, and of the floor that no level can be below\n"
        "(integrity_adversary.py); PL: protection_m of both, m; avail: share of `ok`",
        (
            Column("place", -11),
            Column("faults", -6),
            Column("epochs", 8),
            Column("HMI", 5),
            Column("95 % epoch", 10, 1),
            Column("95 % hour", 10, 1),
            Column("unver", 5),
            Column("PL/err", 6, 1),
            Column("floor", 6, 1),
            Column("PL med", 6, 3),
            Column("PL 95%", 6, 3),
            Column("avail%", 6, 2),
        ),
    )
    rows = [(place, count) for place in PLACES for count in (0, 1)]
    for place, count in progress(rows, "risk"):
        epochs = run.faulty if count else run.epochs
        tally = Tally()
        for some in located(run, run.rng("risk", place, count), epochs, place, count, list(SINGLE)):
            tally.add(some)
            within(f"risk, {place}", tally.epochs, epochs)
        limit = upper_limit(tally.hazards, tally.ok)
        table.row(
            place,
            "one" if count else "none",
            tally.epochs,
            tally.hazards,
            f"{limit:.1e}",
            f"{per_hour(limit):.1e}",
            tally.unverified,
            tally.ratio.quantile(0.5),
            tally.floor.quantile(0.5),
            tally.level.quantile(0.5),
            tally.level.quantile(0.95),
            100.0 * tally.ok / tally.epochs,
        )


SIZES = (0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0)
"""Roots of the cost that the adversary's faults add: the alarm takes those above 5 for faults more often than not."""


def adversary(run: Run) -> None:
    """Print how often the worst faults are unseen and the error beyond the protection level, by their size."""
    table = Table(
        "The worst fault of the worst beacon in the worst direction, of each size, at every pose",
        "poses: of each size; size: root of the cost that the fault adds; below it the `ok` and `unverified`\n"
        "poses whose error is beyond protection_m; 95 %: upper limit of the rate of the size with most;\n"
        "passed 4: share of those of size 4 that are `ok` or `unverified`",
        (
            Column("place", -11),
            POSES,
            *(Column(f"{size:g}", 5) for size in SIZES),
            Column("95 %", 8),
            Column("passed 4", 8, 3),
        ),
    )
    for place in progress(PLACES, "adversary"):
        beyond, passed, done = np.zeros(len(SIZES), dtype=int), 0, 0
        rng = run.rng("adversary", place)
        for site, position in rooms(rng, run.poses, place):
            sound = measured(Coils.of(site, len(position)).field(position), position, sigma_of(site), rng)
            fault, _ = worst_faults(site, sound)
            for k, size in enumerate(SIZES):
                field_T = sound.field_T + size * fault
                outcome = judged(run.told(site), Trials(position, sound.rotation, field_T, sound.sigma_T))
                beyond[k] += int(outcome.unprotected.sum())
                passed += int(outcome.passed.sum()) if size == 4.0 else 0
            done += len(position)
            within(f"adversary, {place}", done, run.poses)
        cells: list[Cell] = [int(count) for count in beyond]
        limit = upper_limit(int(beyond.max()), done)
        table.row(place, done, *cells, f"{limit:.1e}", passed / done)

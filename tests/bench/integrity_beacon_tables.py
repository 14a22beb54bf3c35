"""Tables of the integrity figures: one and two faults of beacons, and the risk per epoch and hour."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from goldfield.site import Site
from tests.bench.integrity_coils import Coils, measured
from tests.bench.integrity_faults import SINGLE, faulty_rows, with_faults
from tests.bench.integrity_outcome import DISTANCE_M, Outcome, joined, judged
from tests.bench.integrity_risk import CORRELATION_S, per_hour, upper_limit
from tests.bench.integrity_run import Run
from tests.bench.integrity_sites import cube, halls, sigma_of
from tests.bench.integrity_tables import POSES, Column, Table, largest, median, progress
from tests.bench.locate_trials import cube_positions

BEACONS = (3, 4, 5, 6, 8, 12)


def rooms(rng: np.random.Generator, poses: int, place: str) -> Iterator[tuple[Site, np.ndarray]]:
    """Yield sites and places in them: "cube 2 mG", "cube .2 mG", or "hall of N" at .2 mG."""
    if place.startswith("cube"):
        site = cube(2e-7 if place == "cube 2 mG" else 2e-8)
        for first in range(0, poses, 5000):
            yield site, cube_positions(rng, min(5000, poses - first))
    else:
        yield from halls(rng, poses, int(place.rpartition(" ")[2]))


def with_beacon_faults(
    run: Run, rng: np.random.Generator, poses: int, place: str, count: int, kinds: Sequence[str]
) -> tuple[Outcome, np.ndarray]:
    """Locate poses with faults of beacons, each of a kind drawn from some.

    Returns
    -------
    outcome : Outcome
    right : ndarray of bool, shape (e,)
        Whether exactly the faulty beacons were left out.
    """
    parts, right = [], []
    for site, position in rooms(rng, poses, place):
        sound = Coils.of(site, len(position))
        rows = faulty_rows(sound.field(position), sigma_of(site), count, rng)
        true = with_faults(sound, rows, rng.choice(list(kinds), size=rows.shape) if count else rows.astype(str), rng)
        outcome = judged(run.told(site), measured(true.field(position), position, sigma_of(site), rng))
        names = np.array([beacon.id for beacon in site.beacons])
        right += [frozenset(names[row]) == left for row, left in zip(rows, outcome.excluded, strict=True)]
        parts.append(outcome)
    return joined(parts), np.array(right, dtype=bool)


def single_faults(run: Run) -> None:
    """Print what becomes of one and two faults of beacons, with few beacons and many."""
    table = Table(
        "One and two faulty beacons, in halls at .2 mG and in the cube (8 beacons)",
        "seen: `inconsistent`, `failed` or a beacon left out; right: just the faulty ones left out, `ok` or\n"
        "`unverified`; of `ok`: normalised error squared per axis above 8, error above 5 cm, largest error;\n"
        f"hidden: nothing seen, `ok` or `unverified`, error above {100 * DISTANCE_M:g} cm; PL: protection_m of both",
        (
            Column("place", -10),
            Column("faults", -12),
            POSES,
            Column("ok"),
            Column("unver"),
            Column("seen"),
            Column("right"),
            Column("nees>8"),
            Column(">5cm", 5),
            Column("max m", 6, 2),
            Column("hidden"),
            Column("err/PL", 6, 2),
            Column("PL med", 6, 2),
        ),
    )
    places = [*(f"hall of {n}" for n in BEACONS), "cube 2 mG", "cube .2 mG"]
    rows: list[tuple[str, str, int]] = []
    for place in places:
        rows += [(place, kind, 1) for kind in SINGLE] + [(place, "any two", 2)]
    for place, kind, count in progress(rows, "faults"):
        kinds = [kind] if kind in SINGLE else list(SINGLE)
        outcome, right = with_beacon_faults(run, run.rng("faults", place, kind), run.poses, place, count, kinds)
        passed = outcome.passed
        hidden = passed & ~outcome.alarmed & (outcome.error_m > DISTANCE_M)
        counts = outcome.counts()
        table.row(
            place,
            kind,
            len(outcome),
            counts["ok"],
            counts["unverified"],
            int(outcome.alarmed.sum()),
            int((right & passed).sum()),
            int(outcome.wrong_by_covariance.sum()),
            int(outcome.wrong_by_distance.sum()),
            largest(outcome.error_m[outcome.ok]),
            int(hidden.sum()),
            largest(outcome.error_m[passed] / outcome.protection_m[passed]),
            median(outcome.protection_m[passed]),
        )


LIMITS_M = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0)


def availability(run: Run) -> None:
    """Print what share of sound poses has a protection level below each alert limit."""
    table = Table(
        "Availability: share, %, of sound poses that are `ok` or `unverified` with protection_m below a limit",
        "PL: protection_m of these; no level: share of `ok` and `unverified` with an infinite protection_m, %",
        (
            Column("place", -11),
            POSES,
            *(Column(f"{1e3 * limit:g} mm", 8, 2) for limit in LIMITS_M),
            Column("no level", 8, 2),
            Column("PL med", 7, 3),
        ),
    )
    places = ("cube 2 mG", "cube .2 mG", *(f"hall of {n}" for n in BEACONS))
    for place in progress(places, "availability"):
        outcome, _ = with_beacon_faults(run, run.rng("availability", place), run.poses, place, 0, [])
        level = np.where(outcome.passed, outcome.protection_m, np.inf)
        shares = [100.0 * float((level <= limit).mean()) for limit in LIMITS_M]
        none = 100.0 * float((outcome.passed & np.isinf(outcome.protection_m)).mean())
        table.row(place, len(outcome), *shares, none, median(outcome.protection_m[outcome.passed]))


def risk(run: Run) -> None:
    """Print the integrity risk as aviation states it, with and without single faults."""
    table = Table(
        "Integrity risk: errors beyond protection_m, of epochs without and with one fault",
        "HMI: hazardously misleading, `ok` and beyond protection_m (or NEES/3 above 8, if that is infinite);\n"
        "95 %: upper limit of the risk by Clopper and Pearson, an epoch, and an hour with one independent\n"
        f"epoch every {CORRELATION_S:g} s; one fault: of one beacon in every epoch, any kind; unver: HMI of\n"
        "`unverified`; PL/err: median of `ok`; PL: protection_m of both, m; avail: share of `ok`",
        (
            Column("place", -11),
            Column("faults", -6),
            Column("epochs", 8),
            Column("HMI", 5),
            Column("95 % epoch", 10, 1),
            Column("95 % hour", 10, 1),
            Column("unver"),
            Column("PL/err", 7, 1),
            Column("PL med", 7, 3),
            Column("PL 95%", 7, 3),
            Column("avail %", 7, 2),
        ),
    )
    places = ("cube 2 mG", "cube .2 mG", *(f"hall of {n}" for n in BEACONS))
    rows = [(place, count) for place in places for count in (0, 1)]
    for place, count in progress(rows, "risk"):
        epochs = run.faulty if count else run.epochs
        outcome, _ = with_beacon_faults(run, run.rng("risk", place, count), epochs, place, count, list(SINGLE))
        leveled = np.isfinite(outcome.protection_m)
        wrong = outcome.unprotected | (outcome.wrong_by_covariance & ~leveled)
        hazards = int((wrong & outcome.ok).sum())
        limit = upper_limit(hazards, int(outcome.ok.sum()))
        level = outcome.protection_m[outcome.passed & leveled]
        table.row(
            place,
            "one" if count else "none",
            len(outcome),
            hazards,
            f"{limit:.1e}",
            f"{per_hour(limit):.1e}",
            int((wrong & ~outcome.ok).sum()),
            median((outcome.protection_m / outcome.error_m)[outcome.ok & leveled]),
            median(level),
            float(np.quantile(level, 0.95)) if len(level) else float("nan"),
            100.0 * float(outcome.ok.mean()),
        )

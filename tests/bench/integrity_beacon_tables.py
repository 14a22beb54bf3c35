"""Tables of the integrity figures: one and two faults of beacons, and availability."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from goldfield.site import Site
from tests.bench.integrity_adversary import worst_faults
from tests.bench.integrity_coils import Coils, measured
from tests.bench.integrity_faults import SINGLE, faulty_rows, with_faults
from tests.bench.integrity_outcome import DISTANCE_M, Outcome, joined, judged
from tests.bench.integrity_run import Run
from tests.bench.integrity_sites import cube, halls, sigma_of
from tests.bench.integrity_tables import POSES, Column, Table, largest, median, progress
from tests.bench.locate_trials import cube_positions

BEACONS = (3, 4, 5, 6, 8, 12)
AT_ONCE = 5000
"""Poses in a cube that are located at once; in a hall all of it."""


def rooms(rng: np.random.Generator, poses: int, place: str) -> Iterator[tuple[Site, np.ndarray]]:
    """Yield sites and places in them: "cube 2 mG", "cube .2 mG", or "hall of N" at .2 mG."""
    if place.startswith("cube"):
        site = cube(2e-7 if place == "cube 2 mG" else 2e-8)
        for first in range(0, poses, AT_ONCE):
            yield site, cube_positions(rng, min(AT_ONCE, poses - first))
    else:
        yield from halls(rng, poses, int(place.rpartition(" ")[2]))


@dataclass(frozen=True)
class Located:
    """Some epochs with faults of beacons.

    Attributes
    ----------
    outcome : Outcome
    right : ndarray of bool, shape (e,)
        Whether exactly the faulty beacons were left out.
    floor_m : ndarray, shape (e,)
        What no protection level can be below: `worst_faults`.
    """

    outcome: Outcome
    right: np.ndarray
    floor_m: np.ndarray


def located(
    run: Run, rng: np.random.Generator, poses: int, place: str, count: int, kinds: Sequence[str]
) -> Iterator[Located]:
    """Locate poses with faults of beacons, each of a kind drawn from some; room by room, `AT_ONCE` poses at most."""
    for site, position in rooms(rng, poses, place):
        sound = Coils.of(site, len(position))
        rows = faulty_rows(sound.field(position), sigma_of(site), count, rng)
        true = with_faults(sound, rows, rng.choice(list(kinds), size=rows.shape) if count else rows.astype(str), rng)
        trials = measured(true.field(position), position, sigma_of(site), rng)
        outcome = judged(run.told(site), trials)
        names = np.array([beacon.id for beacon in site.beacons])
        right = [frozenset(names[row]) == left for row, left in zip(rows, outcome.excluded, strict=True)]
        yield Located(outcome, np.array(right, dtype=bool), worst_faults(site, trials)[1])


def with_beacon_faults(
    run: Run, rng: np.random.Generator, poses: int, place: str, count: int, kinds: Sequence[str]
) -> tuple[Outcome, np.ndarray]:
    """Locate poses with faults as `located` does; return the outcome and where just the faulty ones were left out."""
    parts = list(located(run, rng, poses, place, count, kinds))
    return joined(part.outcome for part in parts), np.concatenate([part.right for part in parts])


def single_faults(run: Run) -> None:
    """Print what becomes of one and two faults of beacons, with few beacons and many."""
    table = Table(
        "One and two faulty beacons, in halls at .2 mG and in the cube (8 beacons)",
        "seen: `inconsistent`, `failed` or a beacon left out; right: just the faulty ones left out, `ok` or\n"
        "`unverified`; of `ok`: normalised error squared per axis above 8, error above 5 cm, largest error;\n"
        f"hidden: nothing seen, `ok` or `unverified`, error above {100 * DISTANCE_M:g} cm;\n"
        "PL: protection_m of both; >PL: `ok` and beyond it, a broken promise: beyond 5 cm alone is none",
        (
            Column("place", -10),
            Column("faults", -12),
            POSES,
            Column("ok", 5),
            Column("unver", 5),
            Column("seen", 5),
            Column("right", 5),
            Column("nees>8"),
            Column(">5cm", 5),
            Column(">PL", 4),
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
            int((outcome.unprotected & outcome.ok).sum()),
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

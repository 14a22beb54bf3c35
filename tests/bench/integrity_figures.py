"""Print the integrity figures of the locator as it is: ``python -m tests.bench.integrity_figures [TABLE ...]``.

Truth is independent of the host's field model: coils by magpylib, a steel rod by `integrity_rod`. Sites reach the
locator through site files that say that they are exact, unless a table is about errors; --silent: that say nothing.
A seed belongs to a purpose: take seed 1 to tune, and another one for figures that are quoted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping

from tests.bench import integrity_beacon_tables, integrity_rated, integrity_risk_tables, integrity_room_tables
from tests.bench.integrity_run import Run
from tests.command import one_of, whole_number

TABLES: Mapping[str, Callable[[Run], None]] = {
    "systematic": integrity_room_tables.systematic_faults,
    "faults": integrity_beacon_tables.single_faults,
    "halls": integrity_room_tables.halls_of_few,
    "survey": integrity_room_tables.declared_errors,
    "availability": integrity_beacon_tables.availability,
    "risk": integrity_risk_tables.risk,
    "adversary": integrity_risk_tables.adversary,
    "rated": integrity_rated.rated,
    "rod": integrity_room_tables.steel_rod,
    "recovery": integrity_room_tables.recovery,
}


def main(argv: list[str] | None = None) -> int:
    """Print the tables asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "tables", nargs="*", type=one_of(TABLES), metavar="TABLE", help=f"some of {', '.join(TABLES)}; default: all"
    )
    parser.add_argument("--poses", type=whole_number(1), default=1000, help="poses a row (default 1000)")
    parser.add_argument(
        "--epochs", type=whole_number(1), default=10_000, help="sound epochs a row of risks (default 10000)"
    )
    parser.add_argument(
        "--faulty", type=whole_number(1), help="epochs a row of risks with a fault (default: a tenth of the sound)"
    )
    parser.add_argument("--seed", type=whole_number(), default=1, help="seed: 1, the default, is for tuning")
    parser.add_argument("--silent", action="store_true", help="the site files say nothing of errors")
    options = parser.parse_args(argv)
    faulty = max(options.epochs // 10, 1) if options.faulty is None else options.faulty
    run = Run(options.poses, options.epochs, faulty, options.seed, options.silent)
    print(f"Integrity figures: {run}")
    for name in options.tables or TABLES:
        TABLES[name](run)
    return 0


if __name__ == "__main__":
    sys.exit(main())

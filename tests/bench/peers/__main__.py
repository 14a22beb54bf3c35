"""``python -m tests.bench.peers``: measure, and print the table (README.md).

python -m tests.bench.peers                      everything, written to build/bench/history.jsonl
python -m tests.bench.peers decode location      these subjects only
python -m tests.bench.peers --compare            what changed between the last run and the one before, and the kept one
python -m tests.bench.peers --keep               keep the last run in the repository, and write the table of the page
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from importlib import import_module

from tests.bench.peers import history, page
from tests.bench.peers.bench import Bench
from tests.bench.peers.measure import ROUNDS
from tests.bench.peers.row import Row
from tests.bench.peers.table import differences, text, told_of
from tests.command import ended, whole_number

SUBJECTS = (
    *("despread", "separation", "decode", "location", "tracking", "survey", "plan", "latency", "emulator"),
    *("rig", "boards", "growth"),
)


def measure(subjects: list[str], rounds: int) -> int:
    """Measure subjects, print the table, and write the run behind the others; 1 if a goal is missed."""
    load, rows = os.getloadavg()[0], []
    for name in subjects:
        begun = time.monotonic()
        found: list[Row] = import_module(f"tests.bench.peers.{name}").rows(Bench(rounds))
        print(f"{name}: {len(found)} rows in {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)
        rows += found
    run = history.here(rows, load)
    history.append(history.HISTORY, run)
    print(text(rows))
    print(told_of(run))
    return int(any(row.met is False for row in rows))


def compare() -> int:
    """Print what changed since the run before, and since the one that is kept."""
    runs, kept = history.read(history.HISTORY), history.read(history.REFERENCE)
    if not runs:
        print("no run to compare: `make bench` makes one")
        return 1
    for name, older in (("the run before", runs[:-1]), ("the run in the repository", kept)):
        print(f"against {name}: {differences(older[-1], runs[-1]) if older else 'there is none'}")
    return 0


def keep() -> int:
    """Write the last run, of whatever number of calls, behind those of the repository, and the page's table of it."""
    runs = history.read(history.HISTORY)
    if not runs:
        print("no run to keep: `make bench` makes one")
        return 1
    run = history.newest(runs, SUBJECTS)
    history.append(history.REFERENCE, run)
    page.write(run)
    print(told_of(run))
    return 0


def main(argv: list[str] | None = None) -> int:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description="Measure how fast goldfield is beside what else one would use.")
    parser.add_argument("subjects", nargs="*", metavar="SUBJECT", help=f"of {', '.join(SUBJECTS)} (default: all)")
    parser.add_argument("--rounds", type=whole_number(1), default=ROUNDS, help=f"of each pair (default {ROUNDS})")
    parser.add_argument("--compare", action="store_true", help="the last run with the one before and the kept one")
    parser.add_argument("--keep", action="store_true", help="keep the last run, and write the page's table")
    options = parser.parse_args(argv)
    if unknown := sorted(set(options.subjects) - set(SUBJECTS)):
        parser.error(f"{unknown[0]} is none of {', '.join(SUBJECTS)}")
    if options.compare + options.keep + bool(options.subjects) > 1:
        parser.error("give subjects, --compare or --keep")
    if options.compare or options.keep:
        return compare() if options.compare else keep()
    return measure(options.subjects or list(SUBJECTS), options.rounds)


if __name__ == "__main__":
    sys.exit(ended(main))

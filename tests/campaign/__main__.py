"""``python -m tests.campaign``: run the trials that a file of results lacks, and print the table (README.md).

python -m tests.campaign --seeds 20                     every kind, 20 seeds: what is missing in the file is run
python -m tests.campaign --kind "axis held" --seed 7    one trial again, told whole
python -m tests.campaign --table                        the table of what is there
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, replace
from pathlib import Path

from goldfield.errors import SystemFailure
from tests.campaign.build import build_of
from tests.campaign.kinds import KINDS
from tests.campaign.table import shown
from tests.campaign.trial import Kind, Outcome, Trial
from tests.command import end_with_parent, ended, growing, read_results, whole_number

RESULTS = {"host": Path("build/campaign/outcomes.jsonl"), "emulated": Path("build/campaign/emulated.jsonl")}


def of_name(group: str, name: str) -> Kind:
    """Return the kind of a group and a name."""
    return next(kind for kind in KINDS if (kind.group, kind.name) == (group, name))


def tried(group: str, name: str, seed: int, boards: str) -> Outcome:
    """Run one trial; in a process of its own. Whatever ends it is told in its outcome."""
    try:
        return Trial(of_name(group, name), seed, boards).run()
    except Exception as error:
        return Outcome(group, name, seed, error=f"a defect: {type(error).__name__}: {error}")


def run_missing(path: Path, kinds: list[Kind], seeds: range, boards: str, processes: int) -> None:
    """Run what the file lacks, and write each outcome as it comes.

    Raises
    ------
    UserError, SystemFailure
        See `growing`; and if a process that runs trials has died.
    """
    with growing(path, Outcome) as (kept, append):
        done = {(one.group, one.name, one.seed) for one in kept}
        names = [(kind.group, kind.name, seed) for seed in seeds for kind in kinds]
        todo = [one for one in names if one not in done]
        build = build_of()
        pool = ProcessPoolExecutor(processes, initializer=end_with_parent)
        try:
            waiting = [pool.submit(tried, *one, boards) for one in todo]
            for number, future in enumerate(as_completed(waiting), 1):
                append(replace(future.result(), build=build))
                print(f"\r{number} of {len(todo)} trials", end="", file=sys.stderr)
        except BrokenProcessPool as error:
            raise SystemFailure("a process that runs trials has died; the same command goes on") from error
        finally:
            pool.shutdown(cancel_futures=True)
    print(file=sys.stderr)


def main(words: Sequence[str] | None = None) -> int:
    """Run the campaign; 1 if a pose was said to be right and was off by more than it promised, or a trial broke off."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=whole_number(1), default=20, help="seeds a kind (default: 20)")
    parser.add_argument("--kind", help="only the kinds whose group and name hold this")
    parser.add_argument("--seed", type=whole_number(), help="this seed alone, told whole and not kept")
    parser.add_argument("--boards", choices=("host", "emulated"), default="host")
    parser.add_argument("--results", type=Path, help="where the outcomes are kept (default: a file a kind of board)")
    parser.add_argument("--processes", type=whole_number(1), default=os.cpu_count() or 1)
    parser.add_argument("--table", action="store_true", help="run nothing")
    arguments = parser.parse_args(words)
    possible = [kind for kind in KINDS if arguments.boards == "emulated" or not kind.emulated]
    kinds = [kind for kind in possible if arguments.kind is None or arguments.kind in f"{kind.group}: {kind.name}"]
    if not kinds:
        parser.error(f'no kind has "{arguments.kind}" in its name')
    if arguments.seed is not None:
        for kind in kinds:
            print(json.dumps(asdict(Trial(kind, arguments.seed, arguments.boards).run()), indent=2))
        return 0
    results = arguments.results or RESULTS[arguments.boards]
    if not arguments.table:
        run_missing(results, kinds, range(1, 1 + arguments.seeds), arguments.boards, arguments.processes)
    outcomes = [
        one
        for one in read_results(results, Outcome)
        if arguments.kind is None or arguments.kind in f"{one.group}: {one.name}"
    ]
    print(shown(outcomes))
    return 1 if any(one.wrong or one.error for one in outcomes) else 0


if __name__ == "__main__":
    sys.exit(ended(main))

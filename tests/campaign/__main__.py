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
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from tests.campaign.kinds import KINDS
from tests.campaign.table import shown
from tests.campaign.trial import Kind, Outcome, Trial

RESULTS = {"host": Path("build/campaign/outcomes.jsonl"), "emulated": Path("build/campaign/emulated.jsonl")}


def of_name(group: str, name: str) -> Kind:
    """Return the kind of a group and a name."""
    return next(kind for kind in KINDS if (kind.group, kind.name) == (group, name))


def tried(group: str, name: str, seed: int, boards: str) -> Outcome:
    """Run one trial; in a process of its own."""
    return Trial(of_name(group, name), seed, boards).run()


def read(path: Path) -> list[Outcome]:
    """Return the outcomes that a file holds; a line that a killed run has cut off is left out."""
    found = []
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            found.append(Outcome(**json.loads(line)))
        except (ValueError, TypeError):
            continue
    return found


def run_missing(path: Path, kinds: list[Kind], seeds: range, boards: str, processes: int) -> None:
    """Run what the file lacks, and write each outcome as it comes."""
    done = {(one.group, one.name, one.seed) for one in read(path)}
    todo = [
        (kind.group, kind.name, seed) for seed in seeds for kind in kinds if (kind.group, kind.name, seed) not in done
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file, ProcessPoolExecutor(processes) as pool:
        if path.stat().st_size:
            file.write("\n")  # behind a line that was cut off; an empty one is none
        waiting = [pool.submit(tried, *one, boards) for one in todo]
        for number, future in enumerate(as_completed(waiting), 1):
            file.write(json.dumps(future.result().as_dict()) + "\n")
            file.flush()
            print(f"\r{number} of {len(todo)} trials", end="", file=sys.stderr)
    print(file=sys.stderr)


def main() -> int:
    """Run the campaign; 1 if a pose was said to be right and was off by more than it promised."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="seeds a kind (default: 20)")
    parser.add_argument("--kind", help="only the kinds whose name holds this")
    parser.add_argument("--seed", type=int, help="this seed alone, told whole and not kept")
    parser.add_argument("--boards", choices=("host", "emulated"), default="host")
    parser.add_argument("--results", type=Path, help="where the outcomes are kept (default: a file a kind of board)")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--table", action="store_true", help="run nothing")
    arguments = parser.parse_args()
    possible = [kind for kind in KINDS if arguments.boards == "emulated" or not kind.emulated]
    kinds = [kind for kind in possible if arguments.kind is None or arguments.kind in kind.name]
    if not kinds:
        parser.error(f'no kind has "{arguments.kind}" in its name')
    if arguments.seed is not None:
        for kind in kinds:
            print(json.dumps(Trial(kind, arguments.seed, arguments.boards).run().as_dict(), indent=2))
        return 0
    results = arguments.results or RESULTS[arguments.boards]
    if not arguments.table:
        run_missing(results, kinds, range(1, 1 + arguments.seeds), arguments.boards, arguments.processes)
    outcomes = [one for one in read(results) if arguments.kind is None or arguments.kind in one.name]
    print(shown(outcomes))
    return 1 if any(one.wrong for one in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())

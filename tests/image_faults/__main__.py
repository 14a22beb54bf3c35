"""``python -m tests.image_faults``: run the trials that a file of results lacks, and print the table (README.md).

python -m tests.image_faults                                   all: what is missing in the file is run
python -m tests.image_faults --workload look --every 20        every twentieth trial of some workloads
python -m tests.image_faults --case look0/skip/0802180a        one trial again, told whole
python -m tests.image_faults --table                           the table of what is there
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from tests.command import ended, growing, read_results, whole_number
from tests.image_faults.booted import booted
from tests.image_faults.driven import driven
from tests.image_faults.image import name_of
from tests.image_faults.linked import linked
from tests.image_faults.table import shown, wrong
from tests.image_faults.trial import (
    Outcome,
    Upset,
    copied,
    flips,
    flips_of_memory,
    ready,
    result_of,
    run,
    skips,
    try_one,
)
from tests.image_faults.workload import Workload

RESULTS = Path("build/image_faults/outcomes.jsonl")
ROUNDS = 1
WORKLOADS: list[Workload] = [*driven(), *linked(), *booted()]
WITH_MEMORY = "before"


def upsets_of(workload: Workload, visits: dict[int, int], kinds: tuple[str, ...]) -> list[Upset]:
    """Return all upsets of a workload."""
    found: list[Upset] = []
    if "skip" in kinds:
        found += skips(workload, visits)
    if "flip" in kinds:
        found += flips(workload, visits, ROUNDS)
    if "ram" in kinds and workload.name == WITH_MEMORY:
        found += flips_of_memory(workload)
    return found


def of_these(outcomes: list[Outcome], workloads: list[Workload]) -> list[Outcome]:
    """Return the last outcome of each trial that is of these very images."""
    images = {workload.name: name_of(workload.image) for workload in workloads}
    found = {one.id: one for one in outcomes if images.get(one.id.split("/")[0]) == one.image}
    return [one for one in found.values() if one.id.count("/") >= 2]


def run_missing(
    path: Path,
    workloads: list[Workload],
    kinds: tuple[str, ...],
    every: int,
    processes: int,
    say: Callable[[str], None],
) -> None:
    """Run what the file lacks, and write each outcome as it comes; what it raises: see `growing`."""
    with growing(path, Outcome) as (kept, append):
        done = {one.id for one in of_these(kept, workloads)}
        for workload in workloads:
            bench, visits, sound = ready(workload)
            todo = [upset for upset in upsets_of(workload, visits, kinds)[::every] if upset.id not in done]
            for number, outcome in enumerate(run(workload, bench, todo, sound, processes), 1):
                append(outcome)
                say(f"\r{workload.name}: {number} of {len(todo)} trials")


def again(case: str, workloads: list[Workload]) -> int:
    """Run one trial by its id, and tell what was seen beside what is seen without it."""
    name = case.split("/")[0]
    workload = next((one for one in workloads if one.name == name), None)
    if workload is None:
        print(f"there is no workload '{name}': {', '.join(one.name for one in workloads)}", file=sys.stderr)
        return 2
    bench, visits, sound = ready(workload)
    upset = next((one for one in upsets_of(workload, visits, ("skip", "flip", "ram")) if one.id == case), None)
    if upset is None:
        print(f"the workload has no trial '{case}' with this build of the image", file=sys.stderr)
        return 2
    chip = workload.chip(bench)
    chip.run(max(chip.now_ps, upset.time_ps - 400_000))
    result = result_of(*copied(lambda: try_one(workload, bench, upset, sound)))
    print(json.dumps({"time_s": upset.time_ps * 1e-12, "without": sound, "with": result}, indent=2))
    return 0


def main(words: Sequence[str] | None = None) -> int:
    """Run the trials; 1 if one of them was dangerous or silently wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workload", default="", help="only those whose name holds this")
    parser.add_argument("--kind", choices=("skip", "flip", "ram"), help="only upsets of this kind")
    parser.add_argument("--every", type=whole_number(1), default=1, help="only every so manieth trial of each workload")
    parser.add_argument("--case", help="this trial alone, told whole and not kept")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--processes", type=int, choices=(1, 2), default=2)
    parser.add_argument("--table", action="store_true", help="run nothing")
    arguments = parser.parse_args(words)
    workloads = [one for one in WORKLOADS if arguments.workload in one.name]
    if not workloads:
        parser.error(f'no workload has "{arguments.workload}" in its name')
    if arguments.case is not None:
        return again(arguments.case, workloads)
    kinds = (arguments.kind,) if arguments.kind else ("skip", "flip", "ram")
    if not arguments.table:
        run_missing(
            arguments.results,
            workloads,
            kinds,
            arguments.every,
            arguments.processes,
            lambda text: print(text, end="", file=sys.stderr),
        )
        print(file=sys.stderr)
    kept = of_these(read_results(arguments.results, Outcome), workloads)
    outcomes = [one for one in kept if one.id.split("/")[1] in kinds]
    print(shown(outcomes, workloads))
    return 1 if wrong(outcomes) else 0


if __name__ == "__main__":
    sys.exit(ended(main))

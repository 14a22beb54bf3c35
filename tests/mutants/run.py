"""``make mutants``: how many small changes of the firmware's core the tests notice, and which they do not.

See README.md beside this file. Exit status 1: a survivor that `survivors.toml` does not name, or a named one that was
killed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import sys
import tomllib
from collections import Counter, defaultdict
from dataclasses import asdict, dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest

from tests.command import ended, read_results, real_number, whole_number
from tests.mutants.c_build import OUT, ROOT
from tests.mutants.mutant import Mutant
from tests.mutants.parts import PARTS, Part
from tests.mutants.plugin import Ended, Tests

SURVIVORS = Path(__file__).with_name("survivors.toml")
RESULTS = OUT / "results.jsonl"


@dataclass(frozen=True)
class Result:
    """What became of a mutant. The digests tell whether it still holds."""

    name: str
    outcome: str
    test: str
    source: str
    tests: str


def _digest(paths: list[Path]) -> str:
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()[:16]


def _source_digest(mutant: Mutant) -> str:
    return _digest([ROOT / mutant.file])


def _read(path: Path) -> dict[str, Any]:
    """Return what is kept of the traces; nothing, if it is damaged."""
    try:
        kept = json.loads(path.read_text()) if path.exists() else {}
    except ValueError:
        kept = {}
    return kept if isinstance(kept, dict) else {}


def _write(path: Path, kept: dict[str, Any]) -> None:
    """Keep the traces: all or, if the run is ended meanwhile, those of before."""
    new = path.with_suffix(f".{os.getpid()}")
    new.write_text(json.dumps(kept))
    new.replace(path)


class Coverage:
    """Which test infects which mutants, and what it costs; kept by file of tests, until it or the core changes."""

    def __init__(self, tests: Tests, part: Part, file_of_it: Path):
        sources = _digest([*part.sources, Path(__file__).with_name(part.rewriter)])
        kept = _read(file_of_it)
        by_file: dict[str, list[str]] = defaultdict(list)
        for name in tests.items:
            by_file[name.split("::")[0]].append(name)
        shared = _digest([path for place in part.tests for path in sorted((ROOT / place).rglob("conftest.py"))])
        self.costs: dict[str, float] = {}
        self.by_mutant: dict[int, list[str]] = defaultdict(list)
        empty, applicable = set[int](), set[int]()
        wanted = {file: f"{sources} {shared} {_digest([ROOT / file])}" for file in by_file}
        for file in sorted(by_file):
            if kept.get(file, {}).get("digest") != wanted[file]:
                print(f"tracing {file}", flush=True)
                kept[file] = {"digest": wanted[file], "tests": tests.traced(by_file[file], part.noted)}
                _write(file_of_it, kept)
            for name, (cost, told) in kept[file]["tests"].items():
                if name in tests.items:
                    self.costs[name] = cost
                    empty.update(told["empty"])
                    applicable.update(told["applicable"])
                    for number in told["infected"]:
                        self.by_mutant[number].append(name)
        self.none = empty - applicable
        """Mutants that are nothing but the original wherever they were reached."""


def _kept(path: Path) -> dict[str, Result]:
    """Results of before, the last of each mutant."""
    return {result.name: result for result in read_results(path, Result)}


class Run:
    """A run over some mutants."""

    def __init__(self, part: Part, chosen: list[Mutant], arguments: argparse.Namespace):
        self.part, self.chosen, self.arguments = part, chosen, arguments
        self.results: dict[str, Result] = {}
        self._killers: dict[str, Counter[str]] = defaultdict(Counter)

    def __call__(self, tests: Tests) -> None:
        """Trace, then try each mutant that no kept result answers."""
        self.part.trace()
        coverage = Coverage(tests, self.part, OUT / f"coverage_{self.arguments.part}.json")
        self.chosen = [mutant for mutant in self.chosen if mutant.number not in coverage.none]
        self.part.ready()
        if self.part.warm:
            tests.warm(coverage.costs)
        kept = {} if self.arguments.fresh else _kept(RESULTS)
        digests: dict[str, str] = {}
        with RESULTS.open("a") as out:
            for i, mutant in enumerate(self.chosen):
                names = coverage.by_mutant.get(mutant.number, [])
                files = sorted({name.split("::")[0] for name in names})
                key = " ".join(files)
                digests.setdefault(key, _digest([ROOT / file for file in files]))
                result = kept.get(mutant.name)
                if result is None or not self._holds(result, mutant, digests[key]):
                    ended = self._try(tests, coverage, mutant, names, result.test if result else "")
                    outcome = ended.by if ended.failed else "survived" if names else "not reached"
                    test_file = [ROOT / ended.failed.split("::")[0]] if ended.failed else []
                    of_tests = _digest(test_file) if test_file else digests[key]
                    result = Result(mutant.name, outcome, ended.failed or "", _source_digest(mutant), of_tests)
                    out.write(json.dumps(asdict(result)) + "\n")
                    out.flush()
                    if self.arguments.verbose or (not ended.failed):
                        print(f"{i + 1}/{len(self.chosen)} {outcome} {mutant.number} {mutant.name}", flush=True)
                self.results[mutant.name] = result
                if result.test:
                    self._killers[mutant.file][result.test] += 1

    def _holds(self, result: Result, mutant: Mutant, tests: str) -> bool:
        """Whether a kept result still answers: the source and the tests that decided it are as they were."""
        if result.source != _source_digest(mutant):
            return False
        if result.test:
            file = ROOT / result.test.split("::")[0]
            return file.exists() and result.tests == _digest([file])
        return result.tests == tests

    def _try(self, tests: Tests, coverage: Coverage, mutant: Mutant, names: list[str], before: str) -> Ended:
        """Run the tests that infect a mutant up to a budget of processor time: the one that killed it before, then the
        likely and cheap ones."""
        killers = self._killers[mutant.file]
        ordered = sorted(names, key=lambda name: (name != before, coverage.costs[name] / (1 + killers[name])))
        taken, total = [], 0.0
        for name in ordered:
            total += coverage.costs[name]
            if total > self.arguments.budget and taken:
                break
            taken.append(name)
        return tests.mutated(lambda: self.part.become(mutant.number), taken, coverage.costs) if taken else Ended(None)


def named_survivors() -> dict[str, dict[str, Any]]:
    """Return the survivors that are explained, by their names."""
    entries: list[dict[str, Any]] = tomllib.loads(SURVIVORS.read_text(encoding="utf-8")).get("survivor", [])
    named = {}
    for entry in entries:
        for what in entry["what"] if isinstance(entry["what"], list) else [entry["what"]]:
            named[f"{entry['file']}: {entry['function']}: {what}"] = entry
    return named


def table(run: Run, named: dict[str, Any], all_names: set[str]) -> tuple[list[str], int]:
    """Return the lines of the table and how many are wrong: unnamed survivors, and named ones that were killed."""
    rows: dict[str, Counter[str]] = defaultdict(Counter)
    for mutant in run.chosen:
        result = run.results[mutant.name]
        row = rows[mutant.file]
        row["mutants"] += 1
        if result.test:
            row["killed"] += 1
            row["by time"] += result.outcome == "time"
            if mutant.name in named:
                row["stale"] += 1
                print(f"killed, though survivors.toml names it: {mutant.name} (by {result.test})")
        elif mutant.name in named:
            row["named"] += 1
        else:
            row["unnamed"] += 1
            where = f"{mutant.number} {mutant.file}:{mutant.line}: {mutant.function}: {mutant.what}"
            print(f"{result.outcome}, and not named: {where}")
    files = {str(path.relative_to(ROOT)) for path in run.part.sources}
    gone = {name for name, entry in named.items() if entry["file"] in files} - all_names
    print("".join(f"no such mutant, though survivors.toml names it: {name}\n" for name in sorted(gone)), end="")
    wrong = len(gone) + sum(row["unnamed"] + row["stale"] for row in rows.values())
    columns = ("mutants", "killed", "by time", "named", "unnamed", "stale")
    rows["all"] = sum(rows.values(), Counter())
    lines = [f"{'file':44}" + "".join(f"{column:>9}" for column in columns)]
    lines += [
        f"{file.removeprefix('firmware/'):44}" + "".join(f"{row[c]:9}" for c in columns) for file, row in rows.items()
    ]
    return lines, wrong


def main(words: list[str] | None = None) -> int:
    """Run; return the exit status."""
    parser = argparse.ArgumentParser(prog="make mutants", description=__doc__)
    parser.add_argument("part", choices=PARTS, help="whose mutants")
    parser.add_argument("--files", nargs="*", default=["*"], help="patterns of files, as 'link/*' or 'drive/guard.c'")
    parser.add_argument("--tests", nargs="*", help="folders or files of tests that count")
    parser.add_argument("--number", type=whole_number(), nargs="*", help="mutants by number")
    parser.add_argument("--sample", type=whole_number(1), help="so many mutants, drawn by --seed")
    parser.add_argument("--seed", type=whole_number(), default=1)
    parser.add_argument(
        "--budget", type=real_number(least=0.0), default=30.0, help="unmutated processor time of a mutant's tests, s"
    )
    parser.add_argument("--fresh", action="store_true", help="use no results of before")
    parser.add_argument("--list", action="store_true", help="print the mutants and end")
    parser.add_argument("--verbose", action="store_true", help="a line for each mutant as it is tried")
    parser.add_argument("--workers", type=whole_number(1), default=1, help="compilers at a time")
    arguments = parser.parse_args(words)
    files = [str(source.relative_to(ROOT)) for each in PARTS.values() for source in each().sources]
    for pattern in arguments.files:
        if not any(fnmatch(file, f"*{pattern}") for file in files):
            parser.error(f"no file of any part is {pattern}")
    part: Part = PARTS[arguments.part]()
    mutants = part.mutants(arguments.workers)
    chosen = [m for m in mutants if any(fnmatch(m.file, f"*{pattern}") for pattern in arguments.files)]
    if arguments.number:
        chosen = [m for m in chosen if m.number in arguments.number]
    if arguments.sample and arguments.sample < len(chosen):
        chosen = sorted(random.Random(arguments.seed).sample(chosen, arguments.sample), key=lambda m: m.number)
    if arguments.list:
        print("\n".join(f"{m.number:6} {m.file}:{m.line}: {m.function}: {m.what}" for m in chosen))
        return 0
    if not chosen:
        print(f"{arguments.part}: has none of these mutants")
        return 0  # What was asked for is in another part.
    os.chdir(ROOT)
    run = Run(part, chosen, arguments)
    ignored = [word for pattern in part.not_tests for word in ("--ignore-glob", pattern)]
    options = [
        "-q",
        "-m",
        "not slow",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "-p",
        "no:faulthandler",
        "-s",
        *ignored,
    ]
    status = pytest.main([*options, *(arguments.tests or part.tests)], plugins=[Tests(run)])
    if len(run.results) < len(run.chosen):
        print(f"the run ended before all mutants were tried (pytest: {status})")
        return 2
    lines, wrong = table(run, named_survivors(), {mutant.name for mutant in mutants})
    print("\n".join(lines))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(ended(main))

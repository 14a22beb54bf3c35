"""Prove the parts with Frama-C's Eva, and print what was proven: ``python -m tests.proofs.run [PART ...]``.

Each run is computed twice: with sums of unsigned numbers that wrap as C says, which proves that no behaviour is
undefined; and with an alarm at each that wraps, which are compared with those that are known.
"""

from __future__ import annotations

import argparse
import csv
import re
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from goldfield.errors import SystemFailure
from hil_sim.clib import ROOT
from tests.command import ended
from tests.proofs.loops import Source
from tests.proofs.parts import HERE, Part, Run, read_parts

HARNESSES = HERE / "harnesses"
MACHINE = "gcc_x86_32"
"""32 bits, the lowest byte first: as the Cortex-M4."""
BASE = ["-machdep", MACHINE, "-c11", "-cpp-frama-c-compliant", "-warn-special-float", "none"]
PRECISION = ["-eva", "-eva-slevel", "0", "-eva-split-return", "full", "-eva-interprocedural-splits"]
WRAPS = "unsigned_overflow"


@dataclass
class Outcome:
    """What came of a part."""

    alarms: list[str] = field(default_factory=list)
    """What could not be proven, a sentence each."""
    reached: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Statements that were reached, and all, by function of the part."""
    seconds: float = 0.0
    """Processor time."""

    def take(self, other: Outcome) -> None:
        """Add what came of another run; a statement counts as reached if the better of the runs has reached it."""
        self.alarms += [each for each in other.alarms if each not in self.alarms]
        for name, (count, total) in other.reached.items():
            self.reached[name] = (max(count, self.reached.get(name, (0, 0))[0]), total)
        self.seconds += other.seconds

    def covered(self) -> float:
        """Return the share of the statements that were reached, percent."""
        return 100.0 * sum(n for n, _ in self.reached.values()) / max(1, sum(n for _, n in self.reached.values()))


def command(part: Part, run: Run, firmware: Path, wraps: bool, table: Path) -> list[str]:
    """Return the command of one analysis."""
    harness = HARNESSES / part.harness
    included = f'#include "{part.sources[0]}"' in harness.read_text()
    sources = [firmware / each for each in part.sources[1 if included else 0 :]]
    prefix = f"-include {HARNESSES / part.prefix} " if part.prefix else ""
    states = ",".join(f"{name}:{count}" for name, count in run.states.items())
    return [
        "frama-c",
        *BASE,
        f"-cpp-extra-args={prefix}-I{firmware} -I{ROOT / 'build' / 'protocol'} -I{HARNESSES}",
        *PRECISION,
        *(["-warn-unsigned-overflow"] if wraps else []),
        *("-main", run.entry, "-eva-auto-loop-unroll", str(run.unroll), "-eva-slevel-function", states),
        *map(str, sources),
        *(str(HARNESSES / each) for each in part.stands_in),
        str(harness),
        *("-then", "-metrics", "-metrics-eva-cover", "-then", "-report-csv", str(table)),
    ]


def known(part: Part, row: dict[str, str], sources: dict[str, Source]) -> tuple[str, str] | None:
    """Return the wrap that a row of the report is, by function and text; None if it is none that is known."""
    line = sources[row["file"]].lines[int(row["line"]) - 1] if row["file"] in sources else ""
    for wrap in part.wraps:
        for what in wrap.what:
            if row["function"] == wrap.function and what in line:
                return wrap.function, what
    return None


def unproven(table: Path) -> list[dict[str, str]]:
    """Return the rows of a report that are neither proven nor without meaning."""
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file, delimiter="\t"))
    fine = ("Valid", "Considered valid", "Dead", "Unreachable", "Valid under hyp.")
    return [row for row in rows if row["status"] not in fine and not row["directory"].startswith("FRAMAC_SHARE")]


def analyse(part: Part, run: Run, firmware: Path, wraps: bool) -> tuple[Outcome, set[tuple[str, str]]]:
    """Compute one run; return what came of it and the known wraps that it met.

    Raises
    ------
    SystemFailure
        If Frama-C could not read the sources.
    """
    sources = {Path(each).name: Source(firmware / each) for each in part.sources}
    names = {name for source in sources.values() for name in source.functions}
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "report.csv"
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(command(part, run, firmware, wraps, table), capture_output=True, text=True, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode != 0 or not table.exists():
            raise SystemFailure(f"{part.name}: Frama-C failed: {done.stdout[-3000:]}{done.stderr[-1000:]}")
        rows = unproven(table)
    outcome, met = Outcome(seconds=after.ru_utime - before.ru_utime), set()
    for row in rows:
        wrap = known(part, row, sources) if row["property kind"] == WRAPS else None
        if wrap is not None:
            met.add(wrap)
        else:
            where = f"{row['file']}:{row['line']} ({row['function']})"
            outcome.alarms.append(f"{where}: {row['property kind']} is {row['status'].lower()}: {row['property']}")
    for name, count, total in re.findall(r"^\s+(\w+): (\d+) stmts out of (\d+)", done.stdout, re.M):
        if name in names:
            outcome.reached[name] = (int(count), int(total))
    outcome.alarms += endless(part, sources)
    return outcome, met


def endless(part: Part, sources: dict[str, Source]) -> list[str]:
    """Return the loops that neither count, nor have their turns counted by the harness, nor are argued to end."""
    known_ends = (*part.ends, *part.turns)
    return [
        f"{file}:{line} ({source.function_at(line)}): it is not known that this loop ends"
        for file, source in sources.items()
        for line in source.loops()
        if not source.counts(line) and source.function_at(line) not in known_ends
    ]


def prove(part: Part, firmware: Path = ROOT / "firmware") -> Outcome:
    """Compute all runs of a part, with and without wraps."""
    outcome = behaves(part, firmware)
    met: set[tuple[str, str]] = set()
    for run in part.runs:
        other, wrapped = analyse(part, run, firmware, wraps=True)
        outcome.take(other)
        met |= wrapped
    expected = {(wrap.function, what) for wrap in part.wraps for what in wrap.what}
    outcome.alarms += [
        f"{function}: `{what}` does not wrap, or is not there" for function, what in sorted(expected - met)
    ]
    return outcome


def behaves(part: Part, firmware: Path = ROOT / "firmware") -> Outcome:
    """Compute all runs of a part once: whether any behaviour is undefined."""
    outcome = Outcome()
    for run in part.runs:
        outcome.take(analyse(part, run, firmware, wraps=False)[0])
    return outcome


def main(words: list[str] | None = None) -> int:
    """Prove the parts that are named, or all; return 1 if any has an alarm."""
    parts = read_parts()
    parser = argparse.ArgumentParser(prog="python -m tests.proofs.run", description=__doc__.splitlines()[0])
    parser.add_argument("part", nargs="*", help=", ".join(part.name for part in parts))
    chosen = parser.parse_args(words).part
    if unknown := sorted(set(chosen) - {part.name for part in parts}):
        parser.error(f"{unknown[0]} is none of {', '.join(part.name for part in parts)}")
    print(f"{'part':14}{'functions':>10}{'statements':>12}{'alarms':>8}{'wraps':>7}{'argued':>8}{'seconds':>9}")
    failed = False
    for part in parts:
        if chosen and part.name not in chosen:
            continue
        outcome = prove(part)
        failed |= bool(outcome.alarms)
        wraps = sum(len(wrap.what) for wrap in part.wraps)
        counts = (
            f"{len(outcome.reached):10}{outcome.covered():11.1f}%{len(outcome.alarms):8}{wraps:7}{len(part.ends):8}"
        )
        print(f"{part.name:14}{counts}{outcome.seconds:9.1f}")
        for each in part.assumes:
            print(f"    assumed: {each}")
        for each in outcome.alarms:
            print(f"    ALARM {each}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(ended(main))

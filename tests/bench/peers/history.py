"""Runs of the bench as lines of JSON: where, when and of what they were, and how two of them differ."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hil_sim.clib import ROOT
from tests.bench.peers.row import Row

HISTORY = ROOT / "build/bench/history.jsonl"
"""Every run in this checkout, a line each."""
REFERENCE = Path(__file__).with_name("reference.jsonl")
"""Runs that are kept in the repository; the last of them is the table of the documentation."""


@dataclass(frozen=True)
class Run:
    """One run of the bench.

    Attributes
    ----------
    commit, date, processor : str
        The commit, with a ``+`` where the tree had changes; the day in UTC; the processor's name.
    cores : int
    load : float
        Mean number of programs that wanted a processor in the minute before the run.
    rows : tuple of Row
    """

    commit: str
    date: str
    processor: str
    cores: int
    load: float
    rows: tuple[Row, ...]

    def as_line(self) -> str:
        """Return it as a line of JSON."""
        told: dict[str, Any] = {key: getattr(self, key) for key in ("commit", "date", "processor", "cores", "load")}
        return json.dumps(told | {"rows": [row.as_dict() for row in self.rows]})

    @classmethod
    def from_line(cls, line: str) -> Run:
        """Return the run of a line."""
        told = json.loads(line)
        return cls(**(told | {"rows": tuple(Row.from_dict(row) for row in told["rows"])}))


def here(rows: Sequence[Row], load: float) -> Run:
    """Return the run of rows that were measured now, on this machine."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()

    changed = git("status", "--porcelain", "--untracked-files=no")
    commit = f"{git('rev-parse', '--short=10', 'HEAD') or 'unknown'}{'+' if changed else ''}"
    date = datetime.now(UTC).strftime("%Y-%m-%d")
    return Run(commit, date, processor(), os.cpu_count() or 1, round(load, 1), tuple(rows))


def processor() -> str:
    """Return the processor's name."""
    told = Path("/proc/cpuinfo")
    names = [line for line in told.read_text().splitlines() if line.startswith("model name")] if told.exists() else []
    return names[0].partition(":")[2].strip() if names else platform.machine()


def read(path: Path) -> list[Run]:
    """Return the runs of a file, oldest first; none if there is no file. What a killed run has cut off is left out."""
    runs = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            runs.append(Run.from_line(line))
        except (ValueError, TypeError, KeyError):
            continue
    return runs


def append(path: Path, run: Run) -> None:
    """Write a run behind those of a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cut_off = path.exists() and not path.read_bytes().endswith(b"\n") and path.stat().st_size > 0
    with path.open("a", encoding="utf-8") as file:
        file.write(("\n" if cut_off else "") + run.as_line() + "\n")


def newest(runs: Sequence[Run], subjects: Sequence[str]) -> Run:
    """Return the last run with what earlier ones of the same day and machine have of subjects that it lacks.

    Its commit is then those of all runs whose rows it has, oldest first.
    """
    last = runs[-1]
    made: dict[str, Run] = {}
    for run in runs:
        if (run.date, run.processor) == (last.date, last.processor):
            made |= {row.subject: run for row in run.rows}
    rows = tuple(row for name in subjects if name in made for row in made[name].rows if row.subject == name)
    commits = list(dict.fromkeys(run.commit for run in runs if run in made.values()))
    return replace(last, commit=" ".join(commits), load=max(run.load for run in made.values()), rows=rows)


CHANGED = 1.15
"""Ratios to a peer that differ by less are taken for the same: so much comes of where memory lies and of other work."""


def compared(before: Run, after: Run) -> list[tuple[Row, Row, float]]:
    """Return the rows that both runs have, and how many times as good the later one is, in the order of the later.

    A row with a peer is judged by its ratio, which the machine's load and speed cancel from; others by their figure,
    of which a row says by its unit or its goal which way is better.
    """
    old = {row.name: row for row in before.rows}
    found = []
    for row in after.rows:
        if (was := old.get(row.name)) is None:
            continue
        if row.ratio is not None and was.ratio is not None:
            better = row.ratio / was.ratio
        else:
            better = row.ours / was.ours if more_is_better(row) else was.ours / row.ours
        found.append((was, row, better))
    return found


def more_is_better(row: Row) -> bool:
    """Tell whether a figure is a rate, and no time or cost."""
    return row.unit.endswith("/s")

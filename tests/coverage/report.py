"""Print which lines of firmware/core and of host the tests ran: a table by folder, and the lines that none ran.

``python -m tests.coverage.report``, behind ``make coverage``. Ends with 1 if either is below `LEAST` percent.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

from goldfield.errors import UserError
from hil_sim.clib import ROOT
from tests.command import ended

COVERED = ROOT / "build/coverage"
LEAST = 95.0
"""Percent of the lines of either side."""

Lines = Mapping[str, Mapping[int, bool]]
"""By the file, relative to the checkout: each line that can run, and whether it did."""


def of_gcov(documents: Iterable[Mapping[str, object]], prefix: str) -> Lines:
    """Return the lines of sources below a prefix from what ``gcov --json-format`` says.

    A source that is compiled more than once, into several libraries or in several functions, counts as run if any was.
    """
    found: dict[str, dict[int, bool]] = defaultdict(dict)
    for document in documents:
        for source in document["files"]:  # type: ignore[attr-defined]
            if source["file"].startswith(prefix):
                lines = found[source["file"]]
                for line in source["lines"]:
                    number = line["line_number"]
                    lines[number] = lines.get(number, False) or line["count"] > 0
    return found


def of_coverage(document: Mapping[str, object], prefix: str) -> Lines:
    """Return the lines of files below a prefix from what ``coverage json`` says."""
    found: dict[str, dict[int, bool]] = {}
    for path, told in document["files"].items():  # type: ignore[attr-defined]
        place = Path(path)
        name = (place.relative_to(ROOT) if place.is_absolute() else place).as_posix()
        if name.startswith(prefix):
            found[name] = dict.fromkeys(told["executed_lines"], True) | dict.fromkeys(told["missing_lines"], False)
    return found


def percent(lines: Iterable[bool]) -> float:
    """Return the share of lines that ran; of none, all did."""
    known = list(lines)
    return 100.0 * sum(known) / len(known) if known else 100.0


def spans(numbers: Iterable[int]) -> list[str]:
    """Return sorted numbers as spans: 3, 4, 5, 9 are 3-5 and 9."""
    found: list[list[int]] = []
    for number in sorted(numbers):
        if found and number == found[-1][1] + 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return [str(first) if first == last else f"{first}-{last}" for first, last in found]


def missed(lines: Lines) -> list[str]:
    """Return a row for each file that has lines which did not run."""
    return [
        f"{name}: {', '.join(spans(gone))}"
        for name, known in sorted(lines.items())
        if (gone := [number for number, ran in known.items() if not ran])
    ]


def table(title: str, lines: Lines) -> str:
    """Return the rows of one side: its folders, and all of it."""
    folders: dict[str, list[bool]] = defaultdict(list)
    for name, known in lines.items():
        folders[str(Path(name).parent)].extend(known.values())
    every = [ran for known in folders.values() for ran in known]
    rows = [(name, known) for name, known in sorted(folders.items())] + [(title, every)]
    head = f"{'folder':40s} {'lines':>7} {'missed':>7} {'percent':>8}"
    shown = [f"{name:40s} {len(known):7d} {known.count(False):7d} {percent(known):8.1f}" for name, known in rows]
    return "\n".join([head, *shown])


def gcov_documents(folder: Path) -> list[Mapping[str, object]]:
    """Return what gcov says of all objects below a folder, whether or not a test has loaded them."""
    notes = sorted(str(path) for path in folder.rglob("*.gcno"))
    words = ["gcov", "--json-format", "--stdout", *notes]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def main() -> int:
    """Print the tables; 1 if a side is below the limit."""
    told = COVERED / "host.json"
    if not told.exists():
        raise UserError(f"{told}: is not there: `make coverage` measures it")
    host = json.loads(told.read_text(encoding="utf-8"))
    sides = {
        "firmware/core, all of it": of_gcov(gcov_documents(COVERED), "firmware/core/"),
        "host, all of it": of_coverage(host, "host/"),
    }
    low, every = 0, []
    for title, lines in sides.items():
        share = percent(ran for known in lines.values() for ran in known.values())
        low |= share < LEAST
        every += missed(lines)
        print(f"{table(title, lines)}\n{'below' if share < LEAST else 'at least'} {LEAST:g} %\n")
    (COVERED / "missed.txt").write_text("\n".join(every) + "\n", encoding="utf-8")
    print(f"lines that no test ran: {COVERED.relative_to(ROOT)}/missed.txt")
    return int(low)


if __name__ == "__main__":
    sys.exit(ended(main))

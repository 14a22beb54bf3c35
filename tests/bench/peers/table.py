"""The table of a run, as text and as Markdown, and what changed between two runs."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tests.bench.peers.history import CHANGED, Run, compared
from tests.bench.peers.row import Row

HEAD = ("subject", "what", "goldfield", "peer", "peer's", "times as good", "memory", "goal")


def number(value: float | None) -> str:
    """Return a figure with three digits that count, thousands set apart; nothing for None."""
    if value is None:
        return ""
    if value == 0.0:
        return "0"
    return f"{value:,.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def cells(row: Row) -> tuple[str, ...]:
    """Return the cells of a row, in the order of `HEAD`."""
    ratio = number(row.ratio)
    if row.quartiles is not None:
        ratio += f" ({number(row.quartiles[0])} to {number(row.quartiles[1])})"
    memory = [f"{number(value)} MB" for value in (row.memory_MB, row.peer_memory_MB) if value is not None]
    goal = "" if row.goal is None else f"{row.goal.text}: {'met' if row.met else 'NOT MET'}"
    theirs = "" if row.theirs is None else f"{number(row.theirs)} {row.unit}"
    return row.subject, row.what, f"{number(row.ours)} {row.unit}", row.peer, theirs, ratio, ", ".join(memory), goal


def text(rows: Sequence[Row]) -> str:
    """Return a table for a terminal."""
    lines = [HEAD, *(cells(row) for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(HEAD))]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines)


def markdown(rows: Sequence[Row]) -> str:
    """Return a table for a page."""
    lines = [HEAD, ("---",) * len(HEAD), *(cells(row) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def told_of(run: Run) -> str:
    """Return a sentence that says of what a run is."""
    return (
        f"Measured {run.date} at commit `{run.commit}` on {run.processor} with {run.cores} processors, "
        f"load {run.load:g} at the start."
    )


def differences(before: Run, after: Run) -> str:
    """Return what became better or worse, or that nothing did."""
    lines = []
    for was, row, better in compared(before, after):
        if 1.0 / CHANGED < better < CHANGED:
            continue
        figures = (was.ratio, row.ratio) if row.ratio is not None and was.ratio is not None else (was.ours, row.ours)
        unit = "times" if figures[0] is was.ratio else row.unit
        word = "better" if better > 1.0 else "WORSE"
        peer = f" beside {row.peer}" if row.peer else ""
        lines.append(f"{word}: {row.subject}, {row.what}{peer}: {number(figures[0])} -> {number(figures[1])} {unit}")
    both = len(compared(before, after))
    head = f"{both} rows of {before.date} ({before.commit}) and {after.date} ({after.commit})"
    return "\n".join([f"{head}: {len(lines)} differ by more than {CHANGED:g} times", *lines])

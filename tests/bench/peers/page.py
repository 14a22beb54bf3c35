"""The table of the documentation: a part of ``docs/comparison.md``, written from the last run that is kept."""

from __future__ import annotations

from hil_sim.clib import ROOT
from tests.bench.peers.history import Run
from tests.bench.peers.table import markdown, told_of

PAGE = ROOT / "docs/comparison.md"
BEGIN, END = "<!-- table of make bench -->\n", "<!-- end of the table -->\n"


def part(run: Run) -> str:
    """Return the part of the page that a run writes."""
    return f"{BEGIN}{told_of(run)}\n\n{markdown(run.rows)}{END}"


def written(text: str, run: Run) -> str:
    """Return the text of a page with the part of a run in place of what it had.

    Raises
    ------
    ValueError
        If the page has no such part.
    """
    before, found, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not (found and ended):
        raise ValueError(f"the page has no part between {BEGIN.strip()} and {END.strip()}")
    return before + part(run) + after


def write(run: Run) -> None:
    """Write the part of a run into the page."""
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), run), encoding="utf-8")

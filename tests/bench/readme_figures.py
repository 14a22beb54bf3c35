"""Compare each figure that README.md and some pages quote with what a command prints: ``make readme-figures``.

``readme_figures.toml`` lists the figures. Each entry names the ``page`` (default ``README.md``), its line (``row``, a
text that only this line has), the ``quote`` as it stands there ("0.67 cm"), the ``command`` that prints it, or ``cat``
with the page that is compared itself, and a regular expression ``pattern`` whose first group is the number. ``scale``
(default 1) brings the number to the quote's unit; ``pick`` says which of several matches counts (``only``, the default,
or ``first``, ``last``, ``least``, ``most``).

``rule`` says when a quote is right: ``rounds`` (the default): the number rounds to the quote at the quote's decimals;
``at most``, ``at least``: the quote is a limit that the number keeps; ``about``: they differ by a fifth at the most, as
a run does that starts at another moment; ``machine``: by a factor of two, as what takes a processor's time does.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, Decimal
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_suffix(".toml")
PICKS = ("only", "first", "last", "least", "most")
RULES = ("rounds", "at most", "at least", "about", "machine")
ABOUT, MACHINE = 1.2, 2.0
"""Factors that ``about`` and ``machine`` allow."""


class FigureError(Exception):
    """A figure that cannot be compared, or that is not what the command prints."""


@dataclass(frozen=True)
class Figure:
    """One figure of a page; the fields are the keys of the list."""

    row: str
    quote: str
    command: str
    pattern: str
    scale: float = 1.0
    pick: str = "only"
    rule: str = "rounds"
    page: str = "README.md"

    @property
    def quoted(self) -> Decimal:
        """The quote's number, with the decimals that it has."""
        found = re.search(r"-?\d[\d,]*(?:\.\d+)?(?:e-?\d+)?|-?\.\d+", self.quote)
        if found is None:
            raise FigureError(f'the quote "{self.quote}" holds no number')
        return Decimal(found[0].replace(",", ""))

    def measured(self, output: str) -> float:
        """Return the number that the command printed, in the quote's unit."""
        numbers = [float(match[1].replace(",", "")) for match in re.finditer(self.pattern, output)]
        if not numbers:
            raise FigureError(f"{self.command}: prints nothing like {self.pattern}")
        if self.pick == "only" and len(numbers) > 1:
            raise FigureError(f"{self.command}: prints {len(numbers)} numbers like {self.pattern}: say which in pick")
        picked = {"first": numbers[0], "last": numbers[-1], "least": min(numbers), "most": max(numbers)}
        return picked.get(self.pick, numbers[0]) * self.scale

    def is_right(self, measured: float) -> bool:
        """Tell whether the quote says what was measured."""
        if self.rule == "at most":
            return measured <= float(self.quoted)
        if self.rule == "at least":
            return measured >= float(self.quoted)
        if self.rule in ("about", "machine"):
            factor = ABOUT if self.rule == "about" else MACHINE
            return float(self.quoted) / factor <= measured <= float(self.quoted) * factor
        return Decimal(repr(measured)).quantize(self.quoted, rounding=ROUND_HALF_EVEN) == self.quoted


def read_list(path: Path = LIST) -> list[Figure]:
    """Read the list of figures; `FigureError` for an entry that says something unknown."""
    figures = [Figure(**entry) for entry in tomllib.loads(path.read_text(encoding="utf-8"))["figure"]]
    for figure in figures:
        if figure.pick not in PICKS or figure.rule not in RULES:
            raise FigureError(f'"{figure.row}": pick is one of {PICKS}, rule one of {RULES}')
    return figures


def text_of(page: str) -> str:
    """Return a page of the checkout."""
    return (ROOT / page).read_text(encoding="utf-8")


def row_of(figure: Figure, text: str) -> str:
    """Return the line of a figure in its page's text, which holds the quote; `FigureError` if it does not."""
    rows = [line for line in text.splitlines() if figure.row in line]
    if len(rows) != 1:
        raise FigureError(f'"{figure.row}" stands in {len(rows)} lines of {figure.page}, not in one')
    if not re.search(rf"(?<![\d.]){re.escape(figure.quote)}(?![\d])", rows[0]):
        raise FigureError(f'{figure.page}: the line of "{figure.row}" does not say "{figure.quote}"')
    return rows[0]


@cache
def output_of(command: str) -> str:
    """Run a command in the checkout and return what it prints."""
    print(f"... {command}", flush=True)
    path = f"{ROOT / '.venv/bin'}:/usr/local/bin:/usr/bin:/bin"
    done = subprocess.run(
        command, shell=True, cwd=ROOT, capture_output=True, text=True, env={"PATH": path, "HOME": "/"}, check=False
    )
    if done.returncode:
        raise FigureError(f"{command}: ends with {done.returncode}: {done.stderr.strip()[-300:]}")
    return done.stdout + done.stderr


def main(argv: list[str] | None = None) -> int:
    """Compare the figures whose command holds a text, or all; 1 if any is wrong."""
    parser = argparse.ArgumentParser(description="Compare the figures of the pages with what the commands print.")
    parser.add_argument("only", nargs="?", default="", help="only figures whose command holds this text")
    options = parser.parse_args(argv)
    wrong = 0
    for figure in read_list():
        if options.only not in figure.command:
            continue
        try:
            row_of(figure, text_of(figure.page))
            measured = figure.measured(output_of(figure.command))
            right = figure.is_right(measured)
            told = f"measured {measured:.6g}, {figure.page} says {figure.quote} ({figure.rule})"
        except FigureError as error:
            right, told = False, str(error)
        wrong += not right
        print(f"{'ok   ' if right else 'WRONG'} {figure.row}: {told}", flush=True)
    print(f"{wrong} figures of the pages are wrong" if wrong else "the pages say what the commands print")
    return min(wrong, 1)


if __name__ == "__main__":
    sys.exit(main())

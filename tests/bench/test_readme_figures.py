"""The list of the README's figures is whole, and its comparison can fail."""

from __future__ import annotations

import re

import pytest

from hil_sim.clib import ROOT
from tests.bench.readme_figures import Figure, FigureError, read_list, row_of, text_of

README = (ROOT / "README.md").read_text(encoding="utf-8")
FIGURE = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)? ?(?:cm|mm|degrees|deg|us|ms|nT|mG|%|m|poses)\b")


def figure(**changes: object) -> Figure:
    values = {"row": "the row", "quote": "0.67 cm", "command": "x", "pattern": r"error ([\d.]+) cm"} | changes
    return Figure(**values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("quote", "measured", "rule", "right"),
    [
        ("0.67 cm", 0.674, "rounds", True),
        ("0.67 cm", 0.676, "rounds", False),
        ("0.7 cm", 0.67, "rounds", True),
        ("12.0", 11.96, "rounds", True),
        ("11.996", 11.996, "rounds", True),
        ("0.4 us", 0.4, "at most", True),
        ("0.4 us", 0.41, "at most", False),
        ("100 of", 99.0, "at least", False),
        ("100 of", 100.0, "at least", True),
        ("10 nT", 11.9, "about", True),
        ("10 nT", 12.1, "about", False),
        ("10 nT", 8.4, "about", True),
        ("10 nT", 8.2, "about", False),
        ("1.7e-13 m", 3.3e-13, "machine", True),
        ("1.7e-13 m", 3.5e-13, "machine", False),
    ],
)
def test_a_quote_is_right_or_not(quote: str, measured: float, rule: str, right: bool) -> None:
    assert figure(quote=quote, rule=rule).is_right(measured) is right


def test_the_number_is_found_and_scaled() -> None:
    output = "error 0.0054 cm\nerror 0.0067 cm\n"
    assert figure(pick="most", scale=100.0).measured(output) == pytest.approx(0.67)
    assert figure(pick="first").measured(output) == 0.0054
    with pytest.raises(FigureError, match="prints 2 numbers"):
        figure().measured(output)
    with pytest.raises(FigureError, match="prints nothing like"):
        figure().measured("no error")


def test_a_quote_that_the_readme_lacks_is_told() -> None:
    assert row_of(figure(), "a\nthe row: 0.67 cm\n") == "the row: 0.67 cm"
    with pytest.raises(FigureError, match="does not say"):
        row_of(figure(), "the row: 10.67 cm\n")
    with pytest.raises(FigureError, match="in 2 lines"):
        row_of(figure(), "the row: 0.67 cm\nthe row")


@pytest.mark.parametrize("entry", read_list(), ids=lambda entry: f"{entry.page}: {entry.row}: {entry.quote}")
def test_every_entry_is_in_its_page(entry: Figure) -> None:
    """A line of the README's table has the command beside it."""
    row = row_of(entry, text_of(entry.page))
    if row.startswith("|") and entry.page == "README.md":
        assert f"`{entry.command}`" in row


OF_PAGES = [entry for entry in read_list() if entry.command.startswith("cat ")]


@pytest.mark.parametrize("entry", OF_PAGES, ids=lambda entry: f"{entry.page}: {entry.row}: {entry.quote}")
def test_a_page_says_what_the_page_says_that_it_quotes(entry: Figure) -> None:
    assert entry.is_right(entry.measured(text_of(entry.command.removeprefix("cat "))))


def test_every_figure_of_the_comparison_has_an_entry() -> None:
    """What stands in the column "figure" with a unit is compared."""
    page = "docs/comparison.md"
    entries = [entry for entry in read_list() if entry.page == page]
    rows = [row.split("|") for row in text_of(page).split("## goldfield, simulated")[1].splitlines() if row[:1] == "|"]
    assert len(rows) > 5
    for _, what, figures, *_ in rows[2:]:
        told = " ; ".join(entry.quote for entry in entries if entry.row in what)
        for quoted in FIGURE.findall(figures):
            assert quoted in told, f"{what}: nothing compares {quoted}"


def test_every_figure_of_the_table_has_an_entry() -> None:
    """What stands in the column "here" with a unit is compared with its command."""
    quotes: dict[str, list[str]] = {}
    for entry in (entry for entry in read_list() if entry.page == "README.md"):
        quotes.setdefault(row_of(entry, README), []).append(entry.quote)
    table = README.split("## Every system of the sources")[1].split("\n## ")[0]
    for row in table.splitlines():
        cells = [cell.strip() for cell in row.split("|")]
        if len(cells) < 6 or cells[1] in ("system", "---"):
            continue
        told = " ; ".join(quotes.get(row, []))
        for quoted in FIGURE.findall(cells[4]):
            assert quoted in told, f"{cells[1]}: nothing compares {quoted}"

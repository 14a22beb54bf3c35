"""The list of the README's figures is whole, and its comparison can fail."""

from __future__ import annotations

import re

import pytest

from hil_sim.clib import ROOT
from tests.bench.readme_figures import Figure, FigureError, read_list, row_of

README = (ROOT / "README.md").read_text(encoding="utf-8")
FIGURE = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)? ?(?:cm|mm|deg|us|nT|mG|%|m)\b")


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


@pytest.mark.parametrize("entry", read_list(), ids=lambda entry: f"{entry.row}: {entry.quote}")
def test_every_entry_is_in_the_readme_and_its_command_beside_it(entry: Figure) -> None:
    row = row_of(entry, README)
    if row.startswith("|"):
        assert f"`{entry.command}`" in row


def test_every_figure_of_the_table_has_an_entry() -> None:
    """What stands in the column "here" with a unit is compared with its command."""
    quotes: dict[str, list[str]] = {}
    for entry in read_list():
        quotes.setdefault(row_of(entry, README), []).append(entry.quote)
    table = README.split("## Every system of the sources")[1].split("\n## ")[0]
    for row in table.splitlines():
        cells = [cell.strip() for cell in row.split("|")]
        if len(cells) < 6 or cells[1] in ("system", "---"):
            continue
        told = " ; ".join(quotes.get(row, []))
        for quoted in FIGURE.findall(cells[4]):
            assert quoted in told, f"{cells[1]}: nothing compares {quoted}"

"""The reference circuit is one circuit: netlists, sheets and bill of materials name the same parts."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

from tests.bench import circuit_diagrams
from tests.bench.circuit_values import computed
from tests.docs.named_tests import check

HARDWARE = Path(__file__).resolve().parents[2] / "docs" / "hardware"
NETLIST_PART = re.compile(r"^(?:[rcd]\d+|m?[qs]q?\d+|x\d+)(?=[a-d]?\s)", re.M)


def bill() -> dict[str, dict[str, str]]:
    """Return the row of each designator of the bill of materials."""
    with (HARDWARE / "bill_of_materials.csv").open(encoding="utf-8", newline="") as file:
        return {name: row for row in csv.DictReader(file) for name in row["designators"].split()}


def netlist(name: str) -> set[str]:
    """Return the designators of a netlist: x is U, and a dual part counts once."""
    body = (HARDWARE / name).read_text(encoding="utf-8").split(".subckt", 1)[1]
    found = {re.sub(r"^[ms]q", "q", part) for part in NETLIST_PART.findall(body)}
    return {part.upper().replace("X", "U") for part in found}


def sheet(name: str) -> set[str]:
    """Return the designators of a sheet."""
    ids = re.findall(r'<g id="([^"]+)"', (HARDWARE / name).read_text(encoding="utf-8"))
    return {re.sub(r"(?<=\d)[A-D]$", "", part) for one in ids for part in one.split(", ") if part != "coil"}


def test_sheets_and_bill_name_the_same_parts():
    assert sheet("driver.svg") | sheet("sensor.svg") == set(bill())


def test_the_netlists_leave_out_only_what_does_not_act():
    """The netlist computes what U8, U9, U10 and U15 do, and leaves out what guards against heat."""
    assert sheet("driver.svg") - netlist("driver.cir") == {"U15", "R38", "R39"}
    assert netlist("driver.cir") <= sheet("driver.svg")
    assert {"R52", "C51", "D51", "D52"} == netlist("sensor.cir")


def test_values_of_the_sheet_are_those_of_the_netlist():
    words = (HARDWARE / "driver.svg").read_text(encoding="utf-8")
    shown = dict(re.findall(r'<g id="([RC]\d+)">.*?>\1</text>\n<text[^>]*>([^<]*)</text>', words, re.S))
    units = {"10 mOhm": "10m", "470 uF 200 V": "470u"}
    for part, value in re.findall(r"^([rc]\d+) \S+ \S+ (\S+)", (HARDWARE / "driver.cir").read_text(), re.M):
        told = shown[part.upper()]
        if told:
            plain = units.get(told, re.sub(r" ?(nF|pF)$", lambda found: found[1][0], told))
            assert (part, plain.replace("10M", "10meg").replace("2.0k", "2k")) == (part, value)


def test_the_drawn_sheets_are_those_of_the_script(tmp_path, monkeypatch):
    monkeypatch.setattr(circuit_diagrams, "FOLDER", tmp_path)
    circuit_diagrams.main()
    for name in ("driver.svg", "sensor.svg"):
        assert (tmp_path / name).read_text() == (HARDWARE / name).read_text()


def test_each_part_has_a_source():
    for name, row in bill().items():
        assert row["part"], name
        if re.fullmatch(r"[QDUB]\d+", name) and row["maker"] != "several":
            assert row["source"].startswith(("data sheet", "function")), name


def test_the_computed_figures_are_those_of_the_page():
    page = (HARDWARE / "figures.md").read_text(encoding="utf-8")
    for words, value in computed():
        assert f"| {words} | {value} |" in page


@pytest.mark.parametrize(
    ("number", "unit"), re.findall(r"\*\*([\d.]+) ([^*]+)\*\*", (HARDWARE.parent / "hardware.md").read_text())
)
def test_the_figures_that_hardware_quotes_are_those_of_the_page(number, unit):
    """Figures in bold on the page come from figures.md, rounded as there or coarser."""
    digits = len(number.partition(".")[2])
    page = (HARDWARE / "figures.md").read_text(encoding="utf-8")
    values = [float(value) for value in re.findall(rf"(-?[\d.]+) {re.escape(unit)}(?!\w)", page)]
    assert float(number) in [round(abs(value), digits) for value in values]


def test_what_silicon_does_is_shown_by_tests_that_are_there():
    """A test that is renamed or removed takes its row with it."""
    page = HARDWARE.with_suffix(".md").read_text(encoding="utf-8")
    [table] = re.findall(r"^\| what silicon does \| shown by \|\n\| --- \| --- \|\n((?:\|[^\n]*\n)+)", page, re.M)
    rows = [row.strip("| ").split(" | ") for row in table.splitlines()]
    assert len(rows) >= 19
    for fault, tests in rows:
        check(fault, tests)

"""The table of coverage counts rightly, on both sides of its limit."""

from __future__ import annotations

import json

import pytest

from hil_sim.clib import ROOT
from tests.coverage import report


def gcov(name: str, counts: dict[int, int]) -> dict[str, object]:
    lines = [{"line_number": number, "count": count} for number, count in counts.items()]
    return {"files": [{"file": name, "lines": lines}, {"file": "/usr/include/math.h", "lines": lines}]}


def test_a_line_of_c_ran_if_any_copy_of_it_did() -> None:
    found = report.of_gcov(
        [
            gcov("firmware/core/link/frame.c", {3: 0, 4: 7, 5: 0}),
            gcov("firmware/core/link/frame.c", {3: 1, 4: 0, 5: 0}),
            gcov("firmware/services/node.c", {1: 0}),
        ],
        "firmware/core/",
    )
    assert found == {"firmware/core/link/frame.c": {3: True, 4: True, 5: False}}


def test_lines_of_python_are_named_from_the_checkout_however_they_are_told() -> None:
    told = {"executed_lines": [1, 2], "missing_lines": [7]}
    files = {str(ROOT / "host/goldfield/a.py"): told, "host/goldfield/b.py": told, "tests/c.py": told}
    expected = {1: True, 2: True, 7: False}
    found = report.of_coverage({"files": files}, "host/")
    assert found == {"host/goldfield/a.py": expected, "host/goldfield/b.py": expected}


def test_missed_lines_are_told_in_spans() -> None:
    assert report.spans([9, 3, 4, 5, 11]) == ["3-5", "9", "11"]
    assert report.missed({"b.c": {1: False, 2: True, 3: False}, "a.c": {1: True}}) == ["b.c: 1, 3"]


def test_folders_and_all_of_them_are_counted() -> None:
    lines = {"x/a.c": {1: True, 2: False}, "x/b.c": {1: True, 2: True}, "y/c.c": {1: False}}
    rows = [row.split() for row in report.table("all", lines).splitlines()[1:]]
    assert rows == [["x", "4", "1", "75.0"], ["y", "1", "1", "0.0"], ["all", "5", "2", "60.0"]]


@pytest.mark.parametrize(("ran", "status"), [(95, 0), (94, 1)])
def test_below_the_limit_on_either_side_ends_with_1(tmp_path, monkeypatch, capsys, ran: int, status: int) -> None:
    told = {"executed_lines": list(range(ran)), "missing_lines": list(range(ran, 100))}
    full = gcov("firmware/core/link/frame.c", dict.fromkeys(range(20), 1))
    monkeypatch.setattr(report, "COVERED", tmp_path)
    monkeypatch.setattr(report, "ROOT", tmp_path.parent)
    monkeypatch.setattr(report, "gcov_documents", lambda _: [full])
    (tmp_path / "host.json").write_text(json.dumps({"files": {"host/goldfield/a.py": told}}))
    assert report.main() == status
    assert ("below 95 %" in capsys.readouterr().out) is bool(status)
    assert (tmp_path / "missed.txt").read_text().strip() == f"host/goldfield/a.py: {ran}-99"

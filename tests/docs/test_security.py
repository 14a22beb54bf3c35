"""The page on security: each of its claims names tests, and they are there."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
CLAIM = re.compile(r"^\| (?P<claim>[^|]+) \| (?P<tests>`tests/[^|]+) \|$", re.M)
NAME = re.compile(r"`(?P<file>tests/[\w/]+\.py)::(?P<test>\w+)`")
LEAST = 25
"""Claims that the page makes today: a table whose form is lost would have its claims pass unseen."""


@cache
def names_in(file: str) -> frozenset[str]:
    """Return the names of a file's tests."""
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    return frozenset(
        node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    )


def test_each_claim_names_tests_that_are_there() -> None:
    """A test that is renamed or removed takes its claim with it."""
    claims = list(CLAIM.finditer(PAGE))
    assert len(claims) >= LEAST
    for claim in claims:
        names = claim["tests"].split(", ")
        for name in names:
            found = NAME.fullmatch(name)
            assert found is not None, f"{claim['claim']}: {name} names no test"
            assert found["test"] in names_in(found["file"]), f"{claim['claim']}: {name} is not there"


def test_every_row_under_held_by_is_a_claim() -> None:
    """No row of those tables has another form, which the test above would pass over."""
    tables = re.findall(r"^\| claim \| held by \|\n\| --- \| --- \|\n((?:\|[^\n]*\n)+)", PAGE, re.M)
    rows = [row for table in tables for row in table.splitlines()]
    assert len(rows) == len(CLAIM.findall(PAGE))

"""Tests that a page names."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAME = re.compile(r"`(?P<file>tests/[\w/]+\.py)::(?P<test>\w+)`")


@cache
def names_in(file: str) -> frozenset[str]:
    """Return the names of a file's tests."""
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    return frozenset(
        node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    )


def check(claim: str, tests: str) -> None:
    """See that a cell of a table names tests, and that they are there."""
    for name in tests.split(", "):
        found = NAME.fullmatch(name)
        assert found is not None, f"{claim}: {name} names no test"
        assert found["test"] in names_in(found["file"]), f"{claim}: {name} is not there"

"""The page on security: each of its claims names tests, and they are there."""

from __future__ import annotations

import re

from tests.docs.named_tests import ROOT, check

PAGE = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
CLAIM = re.compile(r"^\| (?P<claim>[^|]+) \| (?P<tests>`tests/[^|]+) \|$", re.M)
LEAST = 25
"""Claims that the page makes today: a table whose form is lost would have its claims pass unseen."""


def test_each_claim_names_tests_that_are_there() -> None:
    """A test that is renamed or removed takes its claim with it."""
    claims = list(CLAIM.finditer(PAGE))
    assert len(claims) >= LEAST
    for claim in claims:
        check(claim["claim"], claim["tests"])


def test_every_row_under_held_by_is_a_claim() -> None:
    """No row of those tables has another form, which the test above would pass over."""
    tables = re.findall(r"^\| claim \| held by \|\n\| --- \| --- \|\n((?:\|[^\n]*\n)+)", PAGE, re.M)
    rows = [row for table in tables for row in table.splitlines()]
    assert len(rows) == len(CLAIM.findall(PAGE))

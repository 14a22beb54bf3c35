"""Comments and docstrings have a subject: none begins with "Of", which leaves out what it speaks of."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted(
    path
    for top in ("firmware", "hil_sim", "host", "protocol", "tests")
    for path in (ROOT / top).rglob("*")
    if path.suffix in (".py", ".c", ".h", ".mk", ".toml", ".dbc") and path != Path(__file__).resolve()
)
BEGIN = re.compile(
    r'"""Of '  # a docstring
    r"|(?<![\w])(?:/\*+|#|//) Of "  # a comment
    r"|^ *[\w, ]+ : [^\n]*\n +Of "  # the description of a parameter or attribute
    r'|^CM_ [^"\n]*"Of ',  # a comment of the DBC
    re.M,
)


def test_no_comment_begins_with_of():
    assert len(FILES) > 500
    found = [
        f"{path.relative_to(ROOT)}:{text[: match.start()].count(chr(10)) + 1}"
        for path in FILES
        for text in [path.read_text(encoding="utf-8")]
        for match in BEGIN.finditer(text)
    ]
    assert found == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('"""Of the beacons."""', True),
        ("x = 1  # Of 64 KB.", True),
        ("int x; /* Of the latest one. */", True),
        ("    fields : Fields\n        Of the same epoch.\n", True),
        ('CM_ SG_ 1 temperature "Of the processor";', True),
        ('"""The first of the beacons.\n\n    Offsets count."""', False),
        ("x = 1  # The sum is what is left\n# of 64 KB.", False),
    ],
)
def test_the_checker_judges_both_ways(text, found):
    assert bool(BEGIN.search(text)) == found

"""CHANGELOG.md tells each change once."""

from __future__ import annotations

import re
from collections import Counter

from hil_sim.clib import ROOT

SAME = 40
"""Entries that agree in so many characters tell the same thing twice, as when two versions of a line were merged."""


def told_twice(text: str) -> list[str]:
    """Return the beginnings of entries that stand more than once."""
    counts = Counter(entry[:SAME] for entry in re.findall(r"^- (.*)", text, re.M))
    return [begin for begin, count in counts.items() if count > 1]


def test_two_versions_of_an_entry_are_found():
    entry = "- `goldfield run --feed URL`: live poses for other programs"
    assert told_twice(f"{entry} by UDP.\n{entry} by UDP and MQTT.\n- Another.\n") == [entry[2 : 2 + SAME]]
    assert told_twice(f"{entry}.\n- `goldfield run --feed-all`: another.\n") == []


def test_each_change_is_told_once():
    assert told_twice((ROOT / "CHANGELOG.md").read_text(encoding="utf-8")) == []


def test_no_merge_has_left_its_marks():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^(?:<{7} |={7}$|>{7} ).*", text, re.M) == []

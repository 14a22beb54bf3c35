"""Numbers in messages: one thing is never told in the plural."""

from __future__ import annotations

import re

import pytest

from goldfield.errors import counted
from goldfield.link.traffic import KINDS
from goldfield_protocol.parameters import COUNTERS
from hil_sim.clib import ROOT

NUMBER_AND_NOUN = re.compile(
    r"\{(?:len\([^{}]*\)"
    r"|[\w.]*(?:count|lost|missed|dropped|bad|epochs|cycles|rest|pieces|heard|coils|runs)\w*(?: - \d)?)\}"
    r" (?:[a-z]+ )?[a-z]+[^sui\W]s\b"
)
NEVER_ONE = {
    "the site has {len(codes)} beacons": "more than a sensor reports",
    "of {len(view.epochs)} epochs": "all that were looked at",
    "of {count} cycles": "all that were looked at",
    "of the site's {len(site.codes)} codes": "the whole site's",
    "of the site's {len(site.beacons)} codes": "at least two are missing",
    "the {len(codes)} codes": "one code is always separable",
    "{heard} beacons are too few": "a pose was looked for",
    "{len(texts)} values": "more than a parameter takes",
    "{len(points_m)} points": "more than a wire may have",
    "{len(codes)} codes; a board superposes": "more than a board does",
    "{len(data)} bytes for": "sections of an image",
    "{len(parameter_page)} bytes; at most": "more than a page has",
    "{count} bytes at": "reads of memory by programs",
    "{len(times)} samples": "a window",
    "{len(time_s)} samples": "a window",
    "{len(frequency_Hz)} rotating beacons": "those of a paper",
    "{len(room.site.beacons)} beacons": "those of a paper",
    "{len(grid)} fingerprints": "a grid",
    "{len(periods)} tones": "all that fit",
    "of {len(turn)} cycles": "all that were recorded",
    "of {found.cycles} cycles": "all that were recorded",
    "of {len(sound)} epochs": "all that were walked",
    "{count} bodies": "one is told by another word",
    "{len(site.beacons)} beacons are too many": "more than are optimised",
    "{len(codes)} beacons are more than codes": "more than there are codes",
    "{len(drive.codes)} codes; a board drives 4": "more than four",
    "needs {count} finite numbers": "three at least",
    "stands {len(bodies)} times": "more than are allowed",
}
"""Counts that are never 1 where they are told, with the reason."""


@pytest.mark.parametrize(
    ("phrase", "one"),
    [
        ("foreign frames", "foreign frame"),
        ("messages of boards with another protocol", "message of boards with another protocol"),
        ("garbled lines or datagrams", "garbled line or datagram"),
        ("bus errors", "bus error"),
        ("lines could not be read and were left out", "line could not be read and was left out"),
        ("beacons need", "beacon needs"),
        ("SYNC of another master", "SYNC of another master"),
        ("clock fallback", "clock fallback"),
        ("axes", "axis"),
        ("entries", "entry"),
        ("bad entries or lines", "bad entry or line"),
    ],
)
def test_one_is_told_in_the_singular_and_any_other_number_as_it_stands(phrase, one):
    assert counted(1, phrase) == f"1 {one}"
    for count in (0, 2, 11, 21, 101):
        assert counted(count, phrase) == f"{count} {phrase}"


@pytest.mark.parametrize("name", [*KINDS, *(counter.name for counter in COUNTERS)])
def test_every_counter_has_a_singular(name):
    assert not re.search(r"\b(frames|messages|lines|overruns|errors|blocks|resets|edges|epochs)\b", counted(1, name))


def test_no_message_puts_a_noun_in_the_plural_behind_a_number_that_may_be_one():
    found = []
    for path in sorted(path for folder in ("host", "hil_sim") for path in (ROOT / folder).rglob("*.py")):
        for number, line in enumerate(path.read_text().splitlines(), start=1):
            if NUMBER_AND_NOUN.search(line) and not any(known in line for known in NEVER_ONE):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert found == [], "use goldfield.errors.counted"

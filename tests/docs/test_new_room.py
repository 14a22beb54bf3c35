"""docs/new_room.md: its commands run, what it quotes is what they print, and the poses become better."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.docs import walkthrough

PART, LAST_DIGITS = 0.2, 10.0
"""A quoted number may differ by this part, or by so many units of its last digit: a run starts at another moment."""
NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?")


@dataclass(frozen=True)
class Walkthrough:
    """What the page made: the folder of its files, and what each command printed."""

    folder: Path
    printed: dict[str, str]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Walkthrough:
    folder = tmp_path_factory.mktemp("room")
    return Walkthrough(folder, walkthrough.run_page(folder))


def words(line: str) -> list[str]:
    return NUMBER.sub(" # ", line).split()


def agrees(quoted: str, printed: str) -> bool:
    """Tell whether two lines have the same words, and numbers that are nearly the same, as far as ``...`` if it has."""
    if quoted.endswith(" ..."):
        quoted = quoted.removesuffix(" ...").rstrip(",;:")
        printed = " ".join(printed.split()[: len(quoted.split())]).rstrip(",;:")
    if words(quoted) != words(printed):
        return False
    for ours, theirs in zip(NUMBER.findall(quoted), NUMBER.findall(printed), strict=True):
        unit = 10.0 ** -len(ours.partition(".")[2])
        if abs(float(ours) - float(theirs)) > max(PART * abs(float(ours)), LAST_DIGITS * unit):
            return False
    return True


def quotations() -> list[tuple[str, str]]:
    """Return each line of output that the page quotes, after the last command above it."""
    found, command = [], ""
    text = walkthrough.PAGE.read_text(encoding="utf-8")
    for language, block in re.findall(r"```(\w+)\n(.*?)```", text, re.S):
        if language == "sh":
            command = block.splitlines()[-1]
        elif language == "text":
            found += [(command, line) for line in block.splitlines() if line != "..."]
    return found


@pytest.mark.parametrize(
    ("printed", "same"),
    [
        ("b1 is 1.52 m away", True),
        ("b1 is 1.70 m away", True),
        ("b1 is 1.90 m away", False),
        ("b1 is 1.52 m near", False),
        ("b1 is -1.52 m away", False),
        ("b1 is 1.52 m away, b2 is 3 m away", False),
    ],
)
def test_a_quotation_is_compared(printed: str, same: bool) -> None:
    assert agrees("b1 is 1.52 m away", printed) == same


@pytest.mark.parametrize(
    ("printed", "same"), [("b1 is 1.60 m away, b2 is 3 m away", True), ("b1 is 2 m away", False), ("b1 is", False)]
)
def test_a_quotation_is_compared_as_far_as_it_goes(printed: str, same: bool) -> None:
    assert agrees("b1 is 1.52 m away ...", printed) == same


def test_what_is_quoted_is_printed(done: Walkthrough) -> None:
    found = quotations()
    assert len(found) > 20
    wrong = [
        f"{command}\n    {line}"
        for command, line in found
        if not any(agrees(line, printed) for printed in done.printed[command].splitlines())
    ]
    assert wrong == []


def test_the_survey_brings_beacons_and_poses_nearer(done: Walkthrough) -> None:
    """The figures of the page's text are those of its files."""
    text = " ".join(walkthrough.PAGE.read_text(encoding="utf-8").split())
    quoted = re.search(r"`site.toml` are ([\d.]+) mm rms from the truth, those of `surveyed.toml` ([\d.]+) mm", text)
    assert quoted is not None
    measured_mm = [
        1e3 * walkthrough.beacon_rms_m(done.folder / name, done.folder / "true.toml")
        for name in ("site.toml", "surveyed.toml")
    ]
    np.testing.assert_allclose(measured_mm, [float(one) for one in quoted.groups()], rtol=PART)
    assert measured_mm[1] < 0.5 * measured_mm[0]
    rms_m = []
    for name in ("before.jsonl", "after.jsonl"):
        ours, true = walkthrough.located(done.folder / name, done.folder / "truth.jsonl")
        assert len(ours) > 500
        rms_m.append(np.sqrt(np.mean(np.sum((ours - true) ** 2, axis=1))))
    assert rms_m[1] < 0.7 * rms_m[0]


def test_metal_that_is_known_makes_more_poses_ok(done: Walkthrough) -> None:
    def ok(site: str) -> tuple[int, float, float]:
        command = f"goldfield run --log metal.log --site {site} --truth metal_truth.jsonl"
        found = re.search(r"rms error of (\d+) ok poses: position (\S+) cm, attitude (\S+) deg", done.printed[command])
        assert found is not None
        return int(found[1]), float(found[2]), float(found[3])

    count, position_cm, attitude_deg = ok("with_metal.toml")
    assert count > 1.2 * ok("without.toml")[0]
    assert position_cm < 0.7
    assert attitude_deg < 0.7
    known = {
        name: walkthrough.beacon_rms_m(done.folder / name, done.folder / "metal_true.toml")
        for name in ("without.toml", "with_metal.toml")
    }
    assert known["with_metal.toml"] < 0.7 * known["without.toml"], json.dumps(known)

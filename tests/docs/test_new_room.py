"""docs/new_room.md: its commands run, what it quotes is what they print, and the poses become better."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.docs import walkthrough
from tests.docs.new_room import PAGE, SENSOR, run_new_room
from tests.docs.quotation import PART, not_printed


@dataclass(frozen=True)
class Walkthrough:
    """What the page made: the folder of its files, and its steps."""

    folder: Path
    steps: list[walkthrough.Step]


@pytest.fixture(scope="module")
def surveyed(tmp_path_factory: pytest.TempPathFactory) -> Walkthrough:
    """What the page made up to its chapter on the sensor."""
    folder = tmp_path_factory.mktemp("room")
    return Walkthrough(folder, run_new_room(folder, until=SENSOR))


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Walkthrough:
    folder = tmp_path_factory.mktemp("room")
    return Walkthrough(folder, run_new_room(folder))


def test_what_is_quoted_is_printed_up_to_the_survey(surveyed: Walkthrough) -> None:
    commands = [command for command, _ in walkthrough.steps(PAGE)]
    assert len(surveyed.steps) == commands.index(SENSOR) > 8
    assert not_printed(surveyed.steps) == []


@pytest.mark.slow
def test_what_is_quoted_is_printed(done: Walkthrough) -> None:
    assert sum(len(step.quoted) for step in done.steps) > 20
    assert not_printed(done.steps) == []


def test_the_survey_brings_beacons_and_poses_nearer(surveyed: Walkthrough) -> None:
    """The figures of the page's text are those of its files."""
    text = " ".join(walkthrough.page(PAGE).split())
    quoted = re.search(r"`site.toml` are ([\d.]+) mm rms from the truth, those of `surveyed.toml` ([\d.]+) mm", text)
    assert quoted is not None
    measured_mm = [
        1e3 * walkthrough.beacon_rms_m(surveyed.folder / name, surveyed.folder / "true.toml")
        for name in ("site.toml", "surveyed.toml")
    ]
    np.testing.assert_allclose(measured_mm, [float(one) for one in quoted.groups()], rtol=PART)
    assert measured_mm[1] < 0.5 * measured_mm[0]
    rms_m = []
    for name in ("before.jsonl", "after.jsonl"):
        ours, true = walkthrough.located(surveyed.folder / name, surveyed.folder / "truth.jsonl")
        assert len(ours) > 500
        rms_m.append(np.sqrt(np.mean(np.sum((ours - true) ** 2, axis=1))))
    assert rms_m[1] < 0.7 * rms_m[0]


@pytest.mark.slow
def test_metal_that_is_known_makes_more_poses_ok(done: Walkthrough) -> None:
    def ok(site: str) -> tuple[int, float, float]:
        command = f"goldfield run --log metal.log --site {site} --truth metal_truth.jsonl"
        (printed,) = (step.printed for step in done.steps if step.command == command)
        found = re.search(r"rms error of (\d+) ok poses: position (\S+) cm, attitude (\S+) deg", printed)
        assert found is not None
        return int(found[1]), float(found[2]), float(found[3])

    count, position_cm, attitude_deg = ok("with_metal.toml")
    assert count > 1.2 * ok("without.toml")[0]
    assert position_cm < 0.5
    assert attitude_deg < 0.4
    known = {
        name: walkthrough.beacon_rms_m(done.folder / name, done.folder / "metal_true.toml")
        for name in ("without.toml", "with_metal.toml")
    }
    assert known["with_metal.toml"] < 0.5 * known["without.toml"], json.dumps(known)

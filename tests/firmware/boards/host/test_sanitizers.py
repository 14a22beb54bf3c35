"""Applications, core and host board under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import subprocess
from pathlib import Path

from hil_sim.clib import ROOT
from tests.objects import SANITIZED, objects


def test_two_beacons_a_sensor_and_an_anchor_without_a_finding(tmp_path: Path) -> None:
    program = tmp_path / "boards"
    folders = ("apps", "services", "core/*", "boards/host", "third_party/*")
    sources = [
        Path(__file__).with_name("host_boards_under_sanitizer.c"),
        *(path for folder in folders for path in sorted((ROOT / "firmware").glob(f"{folder}/*.c"))),
        ROOT / "build/protocol/goldfield.c",
    ]
    subprocess.run(["gcc", *SANITIZED, *objects(sources), "-lm", "-o", str(program)], check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    master, follower, sensor, anchor = [[int(n) for n in line.split()] for line in done.stdout.splitlines()]
    assert master[0] > 400
    assert follower[0] > 200
    assert sensor[0] > 200_000  # The stream of chips.
    assert sensor[1] > 500  # Fields on the bus.
    assert anchor[0] > 200_000
    assert anchor[1] > 500

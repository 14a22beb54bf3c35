"""How fast rigs of emulated boards are, in virtual seconds a second.

QEMU has no model of the converters, timers and drives that our boards need, so there is no peer for a whole rig.

A rig's figure is of one thread, by the time of its processor: with more, threads wait for each other by spinning, which
on a loaded machine takes more time than the boards. Each rig is in a process of its own
(``python -m tests.bench.peers.rig emulated 8 0.5``).
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hil_sim.clib import ROOT
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario
from tests.bench.building_figures import BOOTED_S, CEILING_M, building
from tests.bench.peers.bench import Bench
from tests.bench.peers.row import Goal, Row

SUBJECT = "rig"
BEACONS = ((8, 0.4, Goal("ours", at_least=1.5)), (26, 0.2, None))
"""Beacons beside the sensor, virtual seconds that are measured, and the goal."""


def rows(_: Bench) -> list[Row]:
    """Return the rows of the subject."""
    return [row_of(SUBJECT, "emulated", *one) for one in BEACONS]


def row_of(subject: str, kind: str, beacons: int, seconds: float, goal: Goal | None) -> Row:
    """Return the row of a rig, which runs in a process of its own."""
    words = [sys.executable, "-m", "tests.bench.peers.rig", kind, str(beacons), str(seconds)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    speed, memory_MB = json.loads(done.stdout)
    return Row(
        subject, f"{beacons + 1:,} {kind} boards, one thread", "virtual s/s", speed, memory_MB=memory_MB, goal=goal
    )


def measured(kind: str, beacons: int, seconds: float) -> tuple[float, float]:
    """Return virtual seconds a second of a rig that has booted, on one thread, and its largest memory, MB."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(building(beacons, 10.0, CEILING_M), encoding="utf-8")
        rig = Rig(load_scenario(str(path)), kind, threads=1)
    rig.advance(BOOTED_S)
    begun, begun_s = time.process_time(), rig.now_s
    rig.advance(seconds)
    spent, virtual_s = time.process_time() - begun, rig.now_s - begun_s
    rig.close()
    return virtual_s / spent, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


if __name__ == "__main__":
    print(json.dumps(measured(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))))

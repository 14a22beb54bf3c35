"""How fast the simulator is: one emulated board beside QEMU, and rigs of boards in virtual seconds a second.

Emulator and QEMU run one program for the same instructions; what either takes to start is taken out by a second, short
run. QEMU has no model of the converters, timers and drives that our boards need, so there is no peer for a whole rig.

A rig's figure is what two processors reach that do nothing else: twice the virtual time over the time that all its
threads have spent. Each rig is in a process of its own (``python -m tests.bench.peers.rig emulated 8 0.5``).
"""

from __future__ import annotations

import json
import resource
import statistics
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
from tests.hil_sim.emulator import oracle

SUBJECT = "rig"
PROGRAM = """
#include "runtime.h"
int main(void) {
    const uint32_t loops = *(volatile const uint32_t *)0xE0000u;
    static uint32_t table[256];
    uint32_t x = 1;
    for (uint32_t i = 0; i < loops; i++) {
        for (uint32_t j = 0; j < 1000u; j++) {
            x = x * 1664525u + 1013904223u;
            table[x >> 24] += x >> 3;
        }
    }
    note(x + table[7]);
    finish();
    return 0;
}
"""
LOOPS = (500, 20_500)
LIMIT_MS = 20_000
PROCESSORS = 2
RIGS = (
    ("emulated", 8, 0.4, Goal("ours", at_least=1.5)),
    ("emulated", 26, 0.2, None),
    ("host", 8, 0.4, None),
    ("host", 99, 0.2, None),
    ("host", 999, 0.04, Goal("ours", at_least=1.0)),
)
"""Boards, beacons beside the sensor, virtual seconds that are measured, and the goal."""


def rows(bench: Bench) -> list[Row]:
    """Return the rows of the subject."""
    found = [beside_qemu(bench)]
    for kind, beacons, seconds, goal in RIGS:
        words = [sys.executable, "-m", "tests.bench.peers.rig", kind, str(beacons), str(seconds)]
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
        speed, memory_MB = json.loads(done.stdout)
        what = f"{beacons + 1:,} {kind} boards"
        found.append(Row(SUBJECT, what, "virtual s/s", speed, memory_MB=memory_MB, goal=goal))
    return found


def beside_qemu(bench: Bench) -> Row:
    """Return the row of one board: instructions that either carries out in a second of its processor."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "loops.c").write_text(PROGRAM, encoding="utf-8")
        image = oracle.build(folder, folder / "loops.c")
        instructions, notes, ours, theirs = {}, set(), [], []
        for _ in range(min(bench.rounds, 3)):
            spent = {}
            for loops in LOOPS:
                begun = time.process_time()
                with oracle.load(image, argument=loops) as board:
                    told = oracle.run_on_emulator(board, LIMIT_MS)
                    instructions[loops] = board.statistics().instructions
                spent["ours", loops] = time.process_time() - begun
                begun = _of_children()
                assert oracle.run_on_qemu(image, loops) == told
                spent["theirs", loops] = _of_children() - begun
                notes.add((loops, *told))
            ours.append(spent["ours", LOOPS[1]] - spent["ours", LOOPS[0]])
            theirs.append(spent["theirs", LOOPS[1]] - spent["theirs", LOOPS[0]])
        assert len(notes) == len(LOOPS)
    millions = (instructions[LOOPS[1]] - instructions[LOOPS[0]]) / 1e6
    ratio = statistics.median(theirs_s / ours_s for ours_s, theirs_s in zip(ours, theirs, strict=True))
    version = subprocess.run(["qemu-system-arm", "--version"], capture_output=True, text=True, check=True).stdout
    peer = f"QEMU {version.split('version ')[1].split()[0]}, mps2-an386"
    rates = [millions / statistics.median(times) for times in (ours, theirs)]
    what = "one emulated Cortex-M4 that only computes"
    return Row(SUBJECT, what, "million instructions/s", rates[0], peer, rates[1], ratio)


def _of_children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def measured(kind: str, beacons: int, seconds: float) -> tuple[float, float]:
    """Return virtual seconds a second of a rig that has booted, on `PROCESSORS`, and its largest memory, MB."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(building(beacons, 10.0, CEILING_M), encoding="utf-8")
        rig = Rig(load_scenario(str(path)), kind)
    rig.advance(BOOTED_S)
    begun, begun_s = time.process_time(), rig.now_s
    rig.advance(seconds)
    spent, virtual_s = time.process_time() - begun, rig.now_s - begun_s
    rig.close()
    return PROCESSORS * virtual_s / spent, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


if __name__ == "__main__":
    print(json.dumps(measured(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))))

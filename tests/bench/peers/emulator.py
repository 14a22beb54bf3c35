"""One emulated board beside QEMU: a program that only computes, for the same instructions.

What either takes to start is taken out by a second, short run. QEMU translates instructions to those of this machine;
our boards' emulator, which stands on the same translation, also looks after peripherals, interrupts and faults.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

from tests.bench.peers.bench import Bench
from tests.bench.peers.row import Row
from tests.hil_sim.emulator import oracle

SUBJECT = "emulator"
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
LOOPS = (500, 8_500)
LIMIT_MS = 20_000


def rows(bench: Bench) -> list[Row]:
    """Return the row of the subject: instructions that either carries out in a second of its processor."""
    return [beside_qemu(bench)]


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

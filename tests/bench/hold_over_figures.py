"""How far chips are off when the sync wire is lost and crystals drift: ``make hold-over-figures``.

The firmware's chip clock, compiled for this machine, follows a wire for 8 s and then has none for 60 s: the worst error
of a chip's edge by time, and the error that the clock states of itself. Then emulated boards, a master, two beacons and
a sensor, lose theirs: the worst edge of a beacon by the second, as long as it drives its coil, and what they state.

    python -m tests.bench.hold_over_figures [--seeds 10] [--boards 1]     so many runs of a clock, and of boards
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield_protocol import decode
from hil_sim.bench import SimulatedBench
from hil_sim.clib import load
from tests.command import whole_number
from tests.firmware.core.timing.test_chip_clock import CYCLE_BLOCKS, MICROSECOND, Simulation
from tests.firmware.core.timing.test_clock_error import CYCLE_S, drifting, quality
from tests.hil.can_timing import beacon_phases
from tests.hil.reference_coil import COIL
from tests.hil.test_sync_lost import DRIFTS, SCENARIO

LEARNT, HELD = 80, 602
"""Cycles with edges, and then without."""
TIMES_S = (1, 2, 5, 10, 20, 30, 60)
RATES = {"0.1 ppm/s": 0.1, "2 ppm/K, 0.1 K/s": 0.2}
"""How fast the two clocks drift apart, ppm/s."""
COURSES = {
    "goes on": lambda ppm_per_s, lost: np.full(len(lost), ppm_per_s),
    "ends then": lambda ppm_per_s, lost: np.where(lost, 0.0, ppm_per_s),
    "begins then": lambda ppm_per_s, lost: np.where(lost, ppm_per_s, 0.0),
}
"""What the drift does when the wire is lost."""
BOARDS_S = 6
"""Time for which boards have no wire."""


def held(core: Any, seed: int, ppm_per_s: float, course: str, cycles: int = HELD) -> tuple[NDArray[np.float64], float]:
    """Return true and stated error, us, of cycles without an edge, shape (cycles, 2), and the time with a lock, s."""
    lost = np.arange(LEARNT + cycles + 3) >= LEARNT
    drift = COURSES[course](ppm_per_s * (-1) ** seed, lost)
    begins, _ = drifting(np.random.default_rng([12, seed]), len(lost), drift)
    simulation = Simulation(core)
    random = np.random.default_rng([13, seed])
    simulation.run(LEARNT * CYCLE_BLOCKS, [begin + random.uniform(0.0, 1.0) for begin in begins[:LEARNT]])
    assert simulation.clock.locked
    rows, locked = [], 0
    for _ in range(cycles):
        before = len(simulation.planned)
        simulation.run(CYCLE_BLOCKS, [])
        start = next(i for i in range(before, len(simulation.planned)) if simulation.planned[i][1] == 0)
        true = simulation.starts[start] - begins[np.argmin(np.abs(begins - simulation.starts[start]))]
        rows.append((abs(true) / MICROSECOND, quality(simulation).error_ns * 1e-3))
        locked += simulation.clock.locked
    return np.array(rows), locked * CYCLE_S


def print_clocks(seeds: int) -> None:
    """Print the errors of the chip clock by drift and course."""
    core = load("libgf_core.so", ("core/timing/chip_clock.h",))
    print(f"chip clock, {seeds} seeds: worst error of a chip's edge / least stated error, us, by time without the wire")
    print(f"{'':32s}" + "".join(f"{second:>14d} s" for second in TIMES_S) + "   locked for, s: least, most; error then")
    for rate, ppm_per_s in RATES.items():
        for course in COURSES:
            runs = [held(core, seed, ppm_per_s, course) for seed in range(seeds)]
            at = [round(second / CYCLE_S) - 1 for second in TIMES_S]
            cells = [f"{max(e[i, 0] for e, _ in runs):.2f} / {min(e[i, 1] for e, _ in runs):.2f}" for i in at]
            ends = [locked for _, locked in runs]
            last = max(errors[: round(locked / CYCLE_S), 0].max() for errors, locked in runs)
            print(
                f"{rate + ', ' + course:32s}"
                + "".join(f"{cell:>16s}" for cell in cells)
                + f"   {min(ends):.1f}, {max(ends):.1f}; {last:.2f}",
                flush=True,
            )


def lose(drift: str, seed: int, folder: Path) -> tuple[list[float], list[float], float]:
    """Cut the wire of emulated boards; return the worst edge and the largest stated error, us, by second, and the lock.

    The first second is that with the wire. Edges end with the drive (not a number); the lock is the sensor's, s.
    """
    random = np.random.default_rng([14, seed])
    path = folder / "lost.toml"
    path.write_text(SCENARIO.format(coil=COIL, **dict(zip(("sensor", "second", "third"), DRIFTS[drift], strict=True))))
    bench = SimulatedBench(str(path), "emulated", folder)
    edges, stated, told = [], [], []
    try:
        bench.advance(8.0 + float(random.uniform(0.0, 1.0)))
        for number in range(BOARDS_S + 1):
            bench.rig.watch_pins()
            bench.rig.can_read()
            reports = bench.advance(1.0)
            followers = np.concatenate([phases[1:-1] for phases in beacon_phases(bench)])
            edges.append(1e6 * float(np.abs(followers).max()) if len(followers) else float("nan"))
            clocks = [decode(frame.identifier, frame.data) for frame in bench.rig.can_read()]
            errors = [m.signals["error"] * 1e-3 for m in clocks if m is not None and m.name == "CLOCK" and m.node != 1]
            stated.append(float(max(errors)))
            if number == 0:
                for board in range(4):
                    bench.rig.fault(board, "sync_wire_cut")
            else:
                told += [bool(report.locked) for report in reports]
    finally:
        bench.close()
    return edges, stated, 0.1 * told.index(False)


def print_boards(runs: int) -> None:
    """Print the errors of emulated boards by drift."""
    print(f"emulated boards, runs: {runs}; worst edge of two beacons / largest error that a board states, us")
    for drift in DRIFTS:
        with tempfile.TemporaryDirectory() as folder:
            told = [lose(drift, seed, Path(folder)) for seed in range(runs)]
        for second in range(BOARDS_S + 1):
            worst = [edges[second] for edges, _, _ in told if not math.isnan(edges[second])]
            stated = max(errors[second] for _, errors, _ in told)
            if worst:
                print(f"{drift}, second {second} without the wire: {max(worst):.2f} / {stated:.2f}", flush=True)
        locks = [lock for _, _, lock in told]
        print(f"{drift}: sensor locked for {min(locks):.1f} to {max(locks):.1f} s", flush=True)


def main() -> None:
    """Print what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--seeds", type=whole_number(1), default=10, help="runs of the chip clock for each drift (default 10)"
    )
    parser.add_argument(
        "--boards", type=whole_number(), default=1, help="runs of emulated boards for each drift (default 1)"
    )
    arguments = parser.parse_args()
    print_clocks(arguments.seeds)
    if arguments.boards > 0:
        print_boards(arguments.boards)


if __name__ == "__main__":
    main()

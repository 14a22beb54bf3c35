"""Measure and print the figures of the whole chain: ``make figures``.

Each figure comes from a seeded run of the ARM images in the emulator; nothing is printed that was not measured in this
run. ``--boards host`` does the same with the firmware compiled for this machine (without the instruction counts).
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.access.epoch import EpochSeparator
from goldfield.locate import locate
from goldfield.types import Pose
from hil_sim import clib
from hil_sim.bench import SimulatedBench
from hil_sim.emulator import Emulator
from tests.command import whole_number

CYCLE_INSTRUCTIONS = 168e6 * 1023 * 16422 / 168e6
"""One instruction is one cycle in the emulator."""
BRIDGE_PINS = (38, 39)
"""PC6 and PC7, the bridge inputs of a beacon."""
CHIP_S = 16422 / 168e6

POSES = (
    ((0.9, 1.2, 0.8), (0.3, -0.2, 1.1)),
    ((0.5, 0.4, 0.5), (2.0, 1.0, -0.5)),
    ((1.6, 0.7, 1.3), (-1.0, 0.4, 2.2)),
    ((1.1, 1.7, 0.4), (0.1, 2.5, 0.3)),
    ((0.4, 1.0, 1.1), (-0.7, -1.2, 0.9)),
)
"""Positions in metres and rotation vectors inside the cube."""


def open_bench(scenario: str, boards: str, link: str = "serial") -> SimulatedBench:
    """Open a bench with a site file of its own."""
    return SimulatedBench(scenario, boards, Path(tempfile.mkdtemp(prefix="goldfield-figures-")), link)


def poses_of(bench: SimulatedBench, count: int) -> list[Pose]:
    """Locate the next cycles."""
    separator = EpochSeparator(bench.site)
    return [locate(bench.site, separator.fields(report)) for report in bench.reports(count)]


def pose_errors(bench: SimulatedBench, poses: list[Pose]) -> tuple[list[float], list[float]]:
    """Return distances in metres and angles in degrees from the truth."""
    truth = bench.truth()
    position, attitude = [], []
    for pose in poses:
        true = truth[pose.epoch]
        turn = Rotation.from_quat(pose.orientation_xyzw) * Rotation.from_quat(true.orientation_xyzw).inv()
        position.append(float(np.linalg.norm(pose.position_m - true.position_m)))
        attitude.append(float(np.degrees(turn.magnitude())))
    return position, attitude


def rms(values: list[float]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def print_accuracy(boards: str, epochs: int) -> None:
    """Errors at several poses inside the cube: 2 mG of noise, clocks 100 ppm apart."""
    position: list[float] = []
    attitude: list[float] = []
    statuses: set[str] = set()
    text = (clib.ROOT / "hil_sim/scenarios/prigge8.toml").read_text()
    for number, (place, turn) in enumerate(POSES):
        moved = text.replace("position_m = [0.9, 1.2, 0.8]", f"position_m = {list(place)}")
        moved = moved.replace("rotation_vector_rad = [0.3, -0.2, 1.1]", f"rotation_vector_rad = {list(turn)}")
        path = Path(tempfile.mkdtemp(prefix="goldfield-figures-")) / f"pose{number}.toml"
        path.write_text(moved.replace("seed = 1", f"seed = {number + 1}"))
        bench = open_bench(str(path), boards)
        poses = poses_of(bench, epochs)
        statuses |= {pose.status.value for pose in poses}
        here, turned = pose_errors(bench, poses)
        position += here
        attitude += turned
        bench.rig.close()
    print(
        f"prigge8, {len(POSES)} poses x {epochs} epochs: rms position error {100 * rms(position):.2f} cm, "
        f"attitude {rms(attitude):.2f} deg, status {', '.join(sorted(statuses))} (targets 2 cm, 2 deg)"
    )


def print_patent_example(boards: str) -> None:
    """Amplitudes 12, 6, 1 mG from three beacons."""
    bench = open_bench("patent3", boards)
    separator = EpochSeparator(bench.site)
    fields = np.mean([separator.fields(report).field_T for report in bench.reports(10)], axis=0)
    amplitudes = np.linalg.norm(fields, axis=1) / 1e-7
    print("patent3: " + ", ".join(f"{a:.4f}" for a in amplitudes) + " mG (truth 12, 6, 1; target 1 %)")
    bench.rig.close()


def print_edges(boards: str) -> None:
    """Chip edges of all beacons by a perfect clock, and by their own."""
    bench = open_bench("prigge8", boards)
    bench.rig.watch_pins()
    bench.advance(2.0)
    worst, jitter, count = 0.0, 0.0, 0
    fit = start = stop = None
    for board, beacon in enumerate(bench.scenario.beacons, start=1):
        changes = bench.rig.pin_changes(board)
        times = np.unique(changes["time_ps"][np.isin(changes["pin"], BRIDGE_PINS)]) * 1e-12
        if fit is None or start is None or stop is None:
            number = np.concatenate([[0.0], np.cumsum(np.round(np.diff(times) / CHIP_S))])
            fit, start, stop = np.polyfit(number, times, 1), times[0], times[-1]
        inside = times[(times >= start) & (times <= stop)]
        worst = max(worst, float(np.abs(inside - np.polyval(fit, np.round((inside - fit[1]) / fit[0]))).max()))
        ticks = (times - times[0]) * 168e6 * (1.0 + beacon.clock.crystal_ppm * 1e-6)
        jitter = max(jitter, float(np.abs(ticks - np.round(ticks)).max()) / 168e6)
        count += len(inside)
    print(
        f"chip edges of {len(bench.scenario.beacons)} beacons, {count} edges: at most {1e9 * worst:.0f} ns from the "
        f"sync master's (target 1000); against the own clock's ticks {1e12 * jitter:.1f} ps"
    )
    bench.rig.close()


def print_repeatability(boards: str) -> None:
    """Same seed, same bytes, in slices of 1 ms and 10 ms; and the same fields over CAN."""
    digests = []
    for slice_ms in (1, 1, 10):
        bench = open_bench("prigge8", boards)
        for _ in range(1000 // slice_ms):
            bench.advance(slice_ms * 1e-3)
        digests.append(hashlib.sha256(bytes(bench.stream)).hexdigest()[:16])
        bench.rig.close()
    print(f"sensor's serial bytes, sha256: slices of 1 ms {digests[0]}, again {digests[1]}, of 10 ms {digests[2]}")
    by_link = []
    for link in ("serial", "can"):
        bench = open_bench("prigge8", boards, link)
        by_link.append({pose.epoch: pose for pose in poses_of(bench, 10)})
        bench.rig.close()
    common = sorted(by_link[0].keys() & by_link[1].keys())
    difference = max(float(np.abs(by_link[0][c].position_m - by_link[1][c].position_m).max()) for c in common)
    print(f"poses by serial and by CAN, {len(common)} cycles: at most {difference:.1e} m apart")


def print_instructions() -> None:
    """Instructions of the despreading in the sensor's image."""
    with Emulator(clib.ROOT / "build/firmware/sensor.elf") as board:
        board.probe("despread_transform")
        board.run(int(1.5e12))
        probe = board.probes()["despread_transform"]
    share = probe.largest / CYCLE_INSTRUCTIONS
    print(
        f"despreading 1023 codes on three axes: {probe.largest} instructions ({probe.calls} calls), "
        f"{100 * share:.3f} % of a cycle (targets 90,000 and 0.6 %)"
    )


def print_speed(boards: str) -> None:
    """Virtual seconds per wall second of nine boards."""
    bench = open_bench("prigge8", boards)
    ratios = []
    for _ in range(3):
        start = time.perf_counter()
        bench.advance(1.0)
        ratios.append(1.0 / (time.perf_counter() - start))
    print(
        f"nine boards: {np.median(ratios):.2f} virtual seconds per wall second "
        f"(median of {', '.join(f'{r:.2f}' for r in sorted(ratios))}; target 1.0)"
    )
    bench.rig.close()


def main(argv: list[str] | None = None) -> int:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boards", choices=("emulated", "host"), default="emulated")
    parser.add_argument("--epochs", type=whole_number(1), default=40, help="epochs a pose")
    options = parser.parse_args(argv)
    if options.boards == "emulated":
        print_instructions()
    print_speed(options.boards)
    print_edges(options.boards)
    print_repeatability(options.boards)
    print_patent_example(options.boards)
    print_accuracy(options.boards, options.epochs)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Measure and print the figures of chip timing over CAN, without any sync wire: ``make can-sync-figures``.

Everything but the poses runs on a bus that foreign frames keep busy; see `LoadedBus`. Nothing is printed that was not
measured in this run. ``--boards host`` does the same with the firmware compiled for this machine, where instructions
take no time.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from goldfield_protocol import decode
from hil_sim import clib
from hil_sim.bench import SimulatedBench
from hil_sim.rig import SENSOR
from tests.bench.chain_figures import POSES, open_bench, pose_errors, poses_of, rms
from tests.command import real_number, whole_number
from tests.hil.can_timing import LoadedBus, beacon_phases, cold_starts, sensor_phases, starve

SCENARIO = "prigge8can"


def changed(scenario: str, *changes: tuple[str, str]) -> str:
    """Write a scenario with some text replaced; returns its path."""
    text = (clib.ROOT / f"hil_sim/scenarios/{scenario}.toml").read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    path = Path(tempfile.mkdtemp(prefix="goldfield-figures-")) / f"{scenario}.toml"
    path.write_text(text)
    return str(path)


def print_edges(boards: str, seconds: float) -> None:
    """Edges of the beacons by a perfect clock, of the sensor by the wire, and how single stamps scatter."""
    bench = open_bench(SCENARIO, boards)
    bench.rig.fault(SENSOR, "sync_wire_cut", False)
    bus = LoadedBus(bench.rig)
    bench.rig.can_read()
    beacons, sensor = [], []
    for _ in range(round(seconds)):
        bench.rig.watch_pins()
        sensor.append(sensor_phases(bench, bus, 1.0))
        beacons += beacon_phases(bench)
    edges = 1e9 * np.concatenate(beacons)
    own = 1e3 * np.concatenate(sensor)[:, 2]
    single = [
        message.signals["phase"]
        for message in (decode(frame.identifier, frame.data) for frame in bench.rig.can_read() if frame.extended)
        if message is not None and message.name == "DRIVE_STATUS" and message.node != 1
    ]
    print(
        f"bus {100 * bus.share():.0f} % busy, {seconds:.0f} s: {len(edges)} edges of 7 beacons against the sync "
        f"master's: at most {np.abs(edges).max():.0f} ns, rms {rms(list(edges)):.0f}, mean {edges.mean():.0f}; sensor, "
        f"{len(own)} cycles: at most {np.abs(own).max():.0f} ns, rms {rms(list(own)):.0f} (target 1000)\n"
        f"phase of the beacons' chip clocks at single stamps, {len(single)}: standard deviation "
        f"{np.std(single):.0f} ns, at most {np.abs(single).max():.0f}"
    )
    bench.rig.close()


def print_cold_starts(boards: str, count: int) -> None:
    """Random cold starts of a sensor among three beacons."""
    bench = open_bench(changed("patent3", ("name =", 'sync = "can"\nname =')), boards)
    bus = LoadedBus(bench.rig)
    starts = cold_starts(bench, bus, count)
    locked = starts[np.isfinite(starts[:, 0])]
    print(
        f"cold starts, bus {100 * bus.share():.0f} % busy: {len(locked)} of {count} locked; from power-on to the "
        f"report of the first whole cycle median {np.median(locked[:, 0]):.2f}, at most {locked[:, 0].max():.2f} s; "
        f"edge from then on at most {1e3 * locked[:, 1].max():.0f} ns"
    )
    bench.rig.close()


def print_hold_over(boards: str) -> None:
    """SYNC gets no bus for 10 s."""
    bench = open_bench(SCENARIO, boards)
    bench.rig.fault(SENSOR, "sync_wire_cut", False)
    LoadedBus(bench.rig).advance(1.0)
    starve(bench, 9.0)
    bench.rig.watch_pins()
    bench.rig.pin_changes(1)
    starve(bench, 0.8)
    edges = 1e9 * np.concatenate(beacon_phases(bench))
    starve(bench, 0.2)
    bench.rig.serial_read()
    quiet = LoadedBus(bench.rig, load=0.0)
    told = sensor_phases(bench, quiet, 3.0)
    print(
        f"10 s without SYNC: edges of 7 beacons in its last second at most {np.abs(edges).max():.0f} ns (crystals that "
        f"do not wander); sensor in the 3 s behind it at most {1e3 * np.abs(told[:, 2]).max():.0f} ns, "
        f"{int(told[:, 1].sum())} of {len(told)} cycles synchronous"
    )
    bench.rig.close()


def print_poses(boards: str, epochs: int) -> None:
    """Pose errors with the wire and over CAN, of the same seeds."""
    for scenario in ("prigge8", SCENARIO):
        position: list[float] = []
        attitude: list[float] = []
        for number, (place, turn) in enumerate(POSES):
            path = changed(
                scenario,
                ("position_m = [0.9, 1.2, 0.8]", f"position_m = {list(place)}"),
                ("rotation_vector_rad = [0.3, -0.2, 1.1]", f"rotation_vector_rad = {list(turn)}"),
                ("seed = 1", f"seed = {number + 1}"),
            )
            bench: SimulatedBench = open_bench(path, boards)
            here, turned = pose_errors(bench, poses_of(bench, epochs))
            position += here
            attitude += turned
            bench.rig.close()
        print(
            f"{scenario}, {len(POSES)} poses x {epochs} epochs: rms position error {100 * rms(position):.3f} cm, "
            f"attitude {rms(attitude):.3f} deg"
        )


def main(argv: list[str] | None = None) -> int:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boards", choices=("emulated", "host"), default="emulated")
    parser.add_argument("--seconds", type=real_number(1.0), default=10.0, help="of the edges' measurement")
    parser.add_argument("--starts", type=whole_number(1), default=100, help="cold starts")
    parser.add_argument("--epochs", type=whole_number(1), default=40, help="epochs a pose")
    options = parser.parse_args(argv)
    print(f"timing over CAN, {options.boards} boards")
    print_edges(options.boards, options.seconds)
    print_hold_over(options.boards)
    print_poses(options.boards, options.epochs)
    print_cold_starts(options.boards, options.starts)
    return 0


if __name__ == "__main__":
    sys.exit(main())

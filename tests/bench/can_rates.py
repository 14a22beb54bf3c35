"""Chip edges of followers by CAN alone, at each bit rate: ``python -m tests.bench.can_rates [--boards host]``."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from goldfield_protocol.rates import CAN_RATES
from hil_sim.bench import SimulatedBench
from hil_sim.scenario import SCENARIOS
from tests.command import whole_number
from tests.hil.can_timing import FloatArray, LoadedBus, beacon_phases, cold_starts

LOAD = 0.4
"""Part of the bus that foreign frames take."""
SPAN_S = 0.3
"""Time for which a straight line is fitted to the leader's edges."""


def bench_at(bit_s: int, boards: str, directory: Path) -> SimulatedBench:
    """Return three beacons and a sensor without a sync wire, on a CAN bus of that rate."""
    path = directory / "small.toml"
    links = f"\n[links]\ncan_bit_s = {bit_s}\n"
    path.write_text('sync = "can"\n' + (SCENARIOS / "patent3.toml").read_text() + links)
    return SimulatedBench(str(path), boards, directory)


def chip_errors(bench: SimulatedBench, bus: LoadedBus, spans: int) -> FloatArray:
    """Return how many seconds the followers' chip edges are late against the leader's, one an edge."""
    errors = []
    for _ in range(spans):
        bench.rig.watch_pins()
        bus.advance(SPAN_S)
        errors += beacon_phases(bench)
    return np.concatenate(errors)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each rate."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boards", choices=("emulated", "host"), default="emulated")
    parser.add_argument("--spans", type=whole_number(1), default=2)
    options = parser.parse_args(arguments)
    for bit_s in CAN_RATES:
        with tempfile.TemporaryDirectory() as directory:
            bench = bench_at(bit_s, options.boards, Path(directory))
            bus = LoadedBus(bench.rig, LOAD)
            ((start_s, start_us),) = cold_starts(bench, bus, 1)
            errors = 1e9 * chip_errors(bench, bus, options.spans)
            share = bus.share()
            bench.close()
        print(
            f"{bit_s} bit/s, bus {100 * share:.0f} % busy: chip edges {np.abs(errors).max():.0f} ns at most, "
            f"mean {errors.mean():.1f}, rms {errors.std():.1f} ({len(errors)} edges); "
            f"a cold start {start_s:.2f} s, then {1e3 * start_us:.0f} ns"
        )


if __name__ == "__main__":
    main()

"""An hour on emulated boards of a beacon and a sensor without a missed deadline: ``make long-run``.

The beacon drives its code and makes the sync wire; the sensor follows it and reports each cycle. Instructions take 2.5
cycles, crystals differ and drift, and both boards get warmer by up to 20 K.
Any violation of what the chip's manual allows, and any fault of the processor, ends the run with its report. In the end
it tells what the boards counted, among which a block that was planned too late, a converter's result that nobody
fetched and an edge that was rejected are the missed deadlines; how often each board started and the drive went on; and
the cycles that are missing or without a lock.

    python -m tests.bench.long_run [--hours 1] [--cycles-per-instruction 2.5] [--seed 12]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from goldfield_protocol import FrameDecoder, decode
from goldfield_protocol.table import counter_name
from hil_sim.options import cycles
from hil_sim.rig import Rig
from hil_sim.scenario import Scenario
from tests.command import ended, real_number, whole_number
from tests.firmware.host_rig import PIN_ENABLE
from tests.hil.reference_coil import COIL
from tests.hil.scenario_text import scenario_of

STEP_S = 0.1
"""Time between two looks at the boards, s: their links then hold all that came."""
CYCLES, CHIPS = 2**20, 1023
"""Cycles are numbered modulo the first; the second is the length of one."""

SCENARIO = """
name = "long run"
seed = {seed}
[ambient]
earth_T = [2e-5, 0.0, -4.5e-5]
[sensor]
node = 100
noise_T = 2e-7
range_T = 2e-4
{sensor}
[motion]
kind = "still"
position_m = [0.5, 0.6, 0.7]
{coil}[[beacon]]
id = "master"
node = 1
code = 2
position_m = [0.0, 0.0, 0.0]
sync_master = true
{master}
"""


def _clock(random: np.random.Generator, hours: float) -> str:
    """Return the keys of a board's clock: up to 50 ppm off, 5 ppm of drift and 20 K in the whole run."""
    seconds = 3600.0 * hours
    values = {
        "crystal_ppm": random.uniform(-50.0, 50.0),
        "crystal_ppm_per_s": random.uniform(-5.0, 5.0) / seconds,
        "crystal_ppm_per_K": random.uniform(-1.0, 1.0),
        "temperature_degC": random.uniform(10.0, 30.0),
        "temperature_K_per_s": random.uniform(0.0, 20.0) / seconds,
    }
    return "\n".join(f"{key} = {value:.9f}" for key, value in values.items())


def _scenario(seed: int, hours: float) -> Scenario:
    random = np.random.default_rng([12, seed])
    clocks = {name: _clock(random, hours) for name in ("sensor", "master")}
    return scenario_of(SCENARIO.format(coil=COIL, seed=seed, **clocks))


@dataclass
class Heard:
    """What came of a board so far."""

    name: str
    decoder: FrameDecoder = field(default_factory=FrameDecoder)
    counts: dict[str, int] = field(default_factory=dict)
    starts: int = 0
    causes: set[int] = field(default_factory=set)
    epochs: int = 0
    missing: int = 0
    unlocked: int = 0
    torn: int = 0
    cycle: int = 0
    last: int | None = None

    def take(self, stream: bytes) -> None:
        """Take bytes of the board's serial line."""
        for frame in self.decoder.feed(stream):
            message = decode(frame.identifier, frame.data)
            if message is None:
                continue
            signals = message.signals
            if message.name == "COUNTER":
                self.counts[counter_name(message.index)] = int(signals["value"])
            elif message.name == "RESET_REPORT":
                self.starts += message.index == 0
            elif message.name == "DRIVE_HEALTH":
                self.causes.add(int(signals["cause"]))
            elif message.name == "EPOCH":
                self.cycle = int(signals["cycle"])
            elif message.name == "EPOCH_STATUS":
                self._report(bool(signals["locked"]), int(signals["chips"]))

    def _report(self, locked: bool, chips: int) -> None:
        """Take the report of a cycle: they count from the first locked one on."""
        if self.last is None and not locked:
            return
        if self.last is not None:
            self.missing += (self.cycle - self.last - 1) % CYCLES
        self.last = self.cycle
        self.epochs += 1
        self.unlocked += not locked
        self.torn += chips != CHIPS

    def wrong(self) -> list[str]:
        """Return what is not as it must be."""
        found = [f"{self.name} counts {value} {name}" for name, value in self.counts.items() if value]
        found += [f"{self.name} started {self.starts} times"] if self.starts != 1 else []
        found += [f"{self.name} went off: causes {sorted(self.causes - {0})}"] if self.causes - {0} else []
        found += [f"{self.name} misses {self.missing} cycles"] if self.missing else []
        found += [f"{self.name} has {self.unlocked} cycles without a lock"] if self.unlocked else []
        found += [f"{self.name} has {self.torn} cycles with chips missing"] if self.torn else []
        damaged = self.decoder.bad_crc + self.decoder.malformed + self.decoder.overlong
        return found + ([f"{self.name}: {damaged} damaged frames"] if damaged else [])


def run(hours: float, cycles: float | str, seed: int) -> list[str]:
    """Run for so long, and print progress each minute of virtual time; returns what is wrong."""
    boards = [Heard("sensor"), Heard("beacon")]
    began, on, off = time.process_time(), 0, 0
    steps = round(hours * 3600.0 / STEP_S)
    with Rig(_scenario(seed, hours), "emulated", cycles_per_instruction=cycles, threads=1) as rig:
        rig.watch_pins()
        for step in range(1, steps + 1):
            rig.advance(STEP_S)
            rig.can_read()
            for number, board in enumerate(boards):
                board.take(rig.serial_read(number))
            changes = rig.pin_changes(1)
            enables = changes[changes["pin"] == PIN_ENABLE]["level"]
            on, off = on + int(np.count_nonzero(enables)), off + int(np.count_nonzero(~enables))
            if step % round(60.0 / STEP_S) == 0 or step == steps:
                said = "; ".join(word for board in boards for word in board.wrong()) or "nothing missed"
                print(
                    f"{rig.now_s / 60.0:6.1f} min in {time.process_time() - began:.0f} s of processor: "
                    f"{boards[0].epochs} cycles, drive on {on} times, off {off}; {said}",
                    flush=True,
                )
        violations = {board.name: rig.statistics(n)["violations"] for n, board in enumerate(boards)}
    found = [words for board in boards for words in board.wrong()]
    found += [f"{name}: {count} violations" for name, count in violations.items() if count]
    found += [f"the drive went on {on} times"] if on != 1 else []
    found += ["the sensor never locked"] if boards[0].last is None else []
    return found


def main(words: Sequence[str] | None = None) -> int:
    """Run, and say how it went."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--hours", type=real_number(least=0.001), default=1.0)
    parser.add_argument("--cycles-per-instruction", type=cycles, default=2.5, metavar="X", help="1 to 100, or m4")
    parser.add_argument("--seed", type=whole_number(), default=12)
    arguments = parser.parse_args(words)
    wrong = run(arguments.hours, arguments.cycles_per_instruction, arguments.seed)
    print(
        f"{arguments.hours:g} h at {arguments.cycles_per_instruction} cycles an instruction: "
        + ("; ".join(wrong) or "no deadline missed, no reset, no violation, nothing counted")
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(ended(main))

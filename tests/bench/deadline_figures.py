"""How long the interrupts of an image take, beside the times until which they must be done: ``make deadline-figures``.

Each image runs on the emulator under the load that costs its interrupts most: bursts of the shortest CAN frames, SYNC
and FOLLOW_UP, edges of the sync wire, bytes on the serial line. The first table has, by interrupt:

- the instructions and the core cycles (costs by class, ``m4``) of its dearest call, what interrupts it excluded;
- the response: the most that can pass from its request to its end, by response-time analysis with instructions of 1,
  1.5 and 2.5 cycles, and by class. All that may preempt it or has its priority does so as often as it can, and
  interrupts are off for as long as they ever are.
- the deadline, and at how many cycles an instruction the response would exceed it.

The second table has what the board counts and does when instructions take ever more cycles: it is observed.

    python -m tests.bench.deadline_figures [beacon sensor field anchor] [--seconds S]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

from goldfield_protocol import FrameDecoder, decode, encode
from goldfield_protocol.messages import database
from goldfield_protocol.table import counter_name
from hil_sim import CYCLES_BY_CLASS
from hil_sim.emulator import Probe
from tests.command import one_of, real_number
from tests.firmware.analog_pins import FOREVER, MID_SCALE_V
from tests.firmware.host_rig import (
    ANCHOR,
    BEACON,
    CHIPS,
    MS,
    PIN_CURRENT,
    PIN_ENABLE,
    PINS_BRIDGE,
    SECOND,
    SENSOR,
    Board,
    chip_at,
    chip_seconds,
    each_axis,
    gold_chips,
)

CHIP = 16000
"""Length of the shortest chip, ticks of 168 MHz, as are all times here; a tick is a core cycle."""
BLOCK = 31 * CHIP
FRAME = 67 * 168
"""Length of the shortest extended CAN frame: 64 bits without data, and 3 of intermission, at 1 Mbit/s."""
NEVER = math.inf
MASKED = 60
"""Instructions for which the board switches interrupts off at most (firmware/boards/stm32f405: 40), rounded up."""
ENTRY = 44
"""Cycles of an exception's entry and return, floating-point registers stacked: 12 + 10, and 17 more for each."""
FACTORS = (1.0, 1.5, 2.5)
SWEEP = (2.5, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0)


@dataclass(frozen=True)
class Interrupt:
    """An interrupt of a board.

    Attributes
    ----------
    handler : str
        The function.
    priority : int
        A lower number preempts; see ``stm32f405.h``.
    period : float
        Least time between two requests, ticks.
    deadline : dict
        Time from the request until which it must have ended, ticks, by role; a role without one has no deadline.
    why : str
        Where the deadline comes from.
    roles : tuple of int
        Boards that have it.
    look : str
        What the handler calls for this one of several that share it: they cost what it costs beside the rest.
    """

    handler: str
    priority: int
    period: float
    deadline: dict[int, float]
    why: str
    roles: tuple[int, ...] = (BEACON, SENSOR, ANCHOR)
    look: str = ""


def _all(ticks: float) -> dict[int, float]:
    return dict.fromkeys((BEACON, SENSOR, ANCHOR), ticks)


INTERRUPTS = {
    "sync edge": Interrupt("TIM8_CC_Handler", 1, 1023 * CHIP, _all(CHIP), "a chip: its count tells no more than that"),
    "CAN stamp out": Interrupt("CAN1_TX_Handler", 1, FRAME, _all(FRAME), "the next frame ends"),
    "CAN stamp in": Interrupt("CAN1_RX1_Handler", 1, FRAME, _all(FRAME), "the next frame ends"),
    "drive": Interrupt(
        *("ADC_Handler", 2, CHIP, {BEACON: 7568, SENSOR: BLOCK, ANCHOR: 7568}),
        "the currents amid the next chip come",
        look="drive_current",
    ),
    "edge": Interrupt(
        *("ADC_Handler", 2, CHIP, {BEACON: 15000}),
        *("the currents before the chip's end come", (BEACON,), "drive_edge"),
    ),
    "middle": Interrupt(
        *("ADC_Handler", 2, CHIP, {BEACON: 7952, ANCHOR: 7952}),
        *("the currents before the chip's end come", (BEACON, ANCHOR), "drive_middle"),
    ),
    "block": Interrupt("DMA2_Stream1_Handler", 3, BLOCK, _all(29 * CHIP), "the last chip but one of the block begins"),
    "sync work": Interrupt("PendSV_Handler", 3, 1023 * CHIP, _all(BLOCK), "a block: the clock is set one block later"),
    "CAN frame": Interrupt("CAN1_RX0_Handler", 2, FRAME, _all(3 * FRAME), "three more frames end: the FIFO has three"),
    "serial in": Interrupt("DMA1_Stream1_Handler", 3, 1024 * 840, _all(2048 * 840), "its ring is full once more"),
    "serial out": Interrupt("DMA1_Stream3_Handler", 3, 8 * 840, {}, "the line is idle until then"),
    "tick": Interrupt("SysTick_Handler", 4, 1_680_000, _all(1_680_000), "the next tick"),
}

DRIVE = {"waveform": 3, "periods": 5, "amplitude": 5.0, "sync_source": 2}
CODES = {"code_count": 8, "code_list": list(range(2, 10))}
IMAGES: dict[str, tuple[int, dict[str, Any]]] = {
    "beacon": (BEACON, DRIVE | {"degree": 11}),
    "sensor": (SENSOR, CODES | {"sync_source": 2}),
    "field": (SENSOR, CODES | {"sync_source": 1}),
    "anchor": (ANCHOR, DRIVE | CODES),
}
NODE, MASTER = 9, 1
CAUSES: dict[int, str] = database().get_message_by_name("DRIVE_HEALTH").get_signal_by_name("cause").choices
"""What switches a drive off, by number."""
BURST, PAUSE = 6, 2_170_000_000
"""Frames back to back, twice what the controller holds, and picoseconds until the next, which wander along the block.
The 128 frames that may wait for main are 51 ms then."""


class Loaded:
    """A board under load, its coils and its field in a few lines of Python."""

    def __init__(self, image: str, cycles: float | str) -> None:
        role, parameters = IMAGES[image]
        self.role = role
        self.degree_chips = 2047 if parameters.get("degree") == 11 else CHIPS
        self.field = [400.0 * float(chip) for chip in gold_chips(2)]
        self.board = Board(
            role,
            {"node": NODE, "open_coil": 0.0, **parameters},
            ppm=17.0,
            volts=each_axis(self._field) | {pin: partial(self._sense, at) for at, pin in enumerate(PIN_CURRENT)},
            emulated=True,
            cycles=cycles,
            strict=False,
        )
        self._requests = self._frame = self._cycle = 0
        self._free = 0

    def _sense(self, channel: int, _time: int) -> tuple[float, int]:
        board = self.board
        if not (board.level.get(PIN_ENABLE) and board.analog[channel]):
            return MID_SCALE_V, FOREVER
        positive, negative = (bool(board.level.get(p)) for p in PINS_BRIDGE[channel])
        amperes = (int(positive) - int(negative)) * board.analog[channel][-1][1] / 3.3 * 16.0
        return MID_SCALE_V + 0.103125 * amperes, FOREVER

    def _field(self, _axis: int, time: int) -> tuple[float, int]:
        """Volts of an axis, and until when they stay."""
        chip, until = chip_at(time, 0, 0.0)
        return MID_SCALE_V + self.field[chip % CHIPS] * 3.3 / 4096, until

    def _start(self, cycle: int) -> int:
        return 3 * MS + round(cycle * self.degree_chips * chip_seconds(0.0) * SECOND)

    def run(self, until: int) -> bool:
        """Run under load; returns false if the board stopped for good."""
        board = self.board
        while board.operations.now(board.handle) < until:
            now = board.operations.now(board.handle)
            for time, mailbox, _, _ in board.requests[self._requests :]:
                self._free = max(self._free, time) + 131_000_000
                board.can_sent(mailbox, True, self._free)
            self._requests = len(board.requests)
            self._fill(now + 2 * MS)
            if board.operations.run(board.handle, now + MS) != 0:
                return False
        return True

    def _fill(self, until: int) -> None:
        """Put frames on the bus up to a time, the master's among them, and an edge of the wire a cycle."""
        board = self.board
        while self._free < until:
            start = self._start(self._cycle)
            if self._free >= start + 2 * MS:
                signals = {"cycle": 1000 + self._cycle, "chips": self.degree_chips, "chip_period": 97750.0, "rank": 1}
                end = self._free + 131_000_000
                board.sync_pulse(self._start(self._cycle + 1))
                board.can_in(*encode("SYNC", signals, node=MASTER), end - 1_000_000)
                told = {"cycle": 1000 + self._cycle, "ticks": round((end - start) * 168e6 / SECOND)}
                board.can_in(*encode("FOLLOW_UP", told, node=MASTER), end + 130_000_000)
                board.receive(bytes(2000), end)
                self._free = end + 131_000_000
                self._cycle += 1
            for _ in range(BURST):
                self._free += 67_000_000
                board.can_in(0x1FFF0000 | self._frame % 65536, b"", self._free - 1_000_000)
                self._frame += 1
            self._free += PAUSE

    def said(self) -> tuple[dict[str, int], list[str]]:
        """Return the counters by name that are not 0, and what else became of the board."""
        frames = FrameDecoder().feed(bytes(byte for _, byte in self.board.serial))
        messages = [m for m in (decode(f.identifier, f.data) for f in frames) if m is not None]
        counts = {counter_name(m.index): int(m.signals["value"]) for m in messages if m.name == "COUNTER"}
        reset = [m for m in messages if m.name == "RESET_REPORT" and m.index == 0]
        health = [int(m.signals["cause"]) for m in messages if m.name == "DRIVE_HEALTH"]
        told = [m.signals["locked"] for m in messages if m.name == "EPOCH_STATUS"]
        rest = []
        if len(reset) > 1:
            rest.append(f"restarted {len(reset) - 1} times")
        if self.role != SENSOR:
            rest.append("drive " + ("on" if self.board.level.get(PIN_ENABLE) else "off"))
            if health and health[-1] != 0:
                rest.append(f"cause {CAUSES[health[-1]]}")
        if self.role != BEACON:
            rest.append(f"{len(told)} reports, {sum(1 for locked in told if locked)} locked")
        return {name: value for name, value in counts.items() if value and "foreign" not in name}, rest


def measure(image: str, cycles: float | str, seconds: float) -> dict[str, tuple[int, int]]:
    """Return the instructions and cycles of the dearest call of each interrupt.

    Looks at the currents share a handler: each costs what the dearest look of its kind does, and what the handler
    takes beside its looks.
    """
    role = IMAGES[image][0]
    own = {name: i for name, i in INTERRUPTS.items() if role in i.roles}
    looks = {name: i.look for name, i in own.items() if i.look and role != SENSOR}
    called = _probed(image, cycles, seconds, {i.handler for name, i in own.items() if name not in looks})
    found = {
        name: (p.largest, p.cycles) for name, i in own.items() if name not in looks and (p := called.get(i.handler))
    }
    if looks:
        seen = _probed(image, cycles, seconds, {"ADC_Handler", "current_sample", *looks.values()})
        sample, beside = seen.pop("current_sample"), _beside_looks(seen.pop("ADC_Handler"), seen)
        found |= {name: (seen[look].largest + beside[0], seen[look].cycles + beside[1]) for name, look in looks.items()}
        # Both currents may end their blocks at the same chip, which takes longer than this run to come about.
        end = sample.largest - sample.total // sample.calls
        found["drive"] = (found["drive"][0] + end, found["drive"][1] + end * sample.cycles // sample.largest)
    return found


def _beside_looks(handler: Probe, looks: dict[str, Probe]) -> tuple[int, int]:
    """Return the instructions and cycles that the handler of the looks takes beside each of them.

    A call that comes late holds a look behind an edge, too: the dearest call has, if what is left of it is more than
    what is taken beside one and a half in the mean, and then half of that is of each.
    """
    mean = (handler.total - sum(look.total for look in looks.values())) / sum(look.calls for look in looks.values())
    rest = handler.largest - looks["drive_current"].largest, handler.cycles - looks["drive_current"].cycles
    edge = looks.get("drive_edge")
    if edge is not None and rest[0] - edge.largest > 1.5 * mean:
        return (rest[0] - edge.largest + 1) // 2, (rest[1] - edge.cycles + 1) // 2
    return rest


def _probed(image: str, cycles: float | str, seconds: float, functions: Iterable[str]) -> dict[str, Probe]:
    """Return the counts of functions that were called."""
    loaded = Loaded(image, cycles)
    for function in sorted(functions):
        loaded.board.emulator.probe(function)
    assert loaded.run(round(seconds * SECOND)), "the board stopped"
    assert loaded.role == SENSOR or loaded.board.level.get(PIN_ENABLE), "the drive is still off: it needs more seconds"
    probes = loaded.board.emulator.probes()
    loaded.board.close()
    return {name: probe for name, probe in probes.items() if probe.calls}


def response(name: str, costs: dict[str, float], masked: float) -> float:
    """Return the longest time from a request to the end of its handler; infinite if there is none, ticks."""
    own = INTERRUPTS[name]
    others = [other for other in costs if other != name and INTERRUPTS[other].priority <= own.priority]
    longest = 0.0
    guess = masked + costs[name]
    while guess > longest:
        if guess > 1e8:
            return NEVER
        longest = guess
        guess = masked + costs[name]
        guess += sum(math.ceil(longest / INTERRUPTS[other].period) * costs[other] for other in others)
    return longest


def responses(counts: dict[str, int], factor: float) -> dict[str, float]:
    """Return the response of each interrupt with instructions of so many cycles."""
    costs = {name: count * factor + ENTRY for name, count in counts.items()}
    return {name: response(name, costs, MASKED * factor) for name in counts}


def limit(name: str, counts: dict[str, int], deadline: float) -> float:
    """Return the cycles of an instruction from which on the response exceeds the deadline."""
    low, high = 0.0, 1000.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (low, middle) if responses(counts, middle)[name] > deadline else (middle, high)
    return low


def budgets(image: str, seconds: float) -> None:
    """Print the first table."""
    role = IMAGES[image][0]
    measured = measure(image, CYCLES_BY_CLASS, seconds)
    counts = {name: instructions for name, (instructions, _) in measured.items()}
    by_class = {name: float(cycles + ENTRY) for name, (_, cycles) in measured.items()}
    bounds = [responses(counts, factor) for factor in FACTORS]
    print(f"\n{image}: times in us of 168 cycles; bound of the response at so many cycles an instruction")
    head = f"{'interrupt':14s} {'pri':>3s} {'instr.':>7s} {'m4 cyc.':>8s}"
    print(head + "".join(f"{f:>9g}" for f in FACTORS) + f"{'m4':>9s} {'deadline':>9s} {'missed at':>9s}  deadline is")
    for name, interrupt in INTERRUPTS.items():
        if name not in measured:
            continue
        last = response(name, by_class, 2.0 * MASKED)
        times = [*(bound[name] for bound in bounds), last]
        deadline = interrupt.deadline.get(role)
        cells = f"{'-':>9s} {'-':>9s}"
        if deadline is not None:
            cells = f"{deadline / 168:9.1f} {limit(name, counts, deadline):9.1f}"
        row = f"{name:14s} {interrupt.priority:3d} {counts[name]:7d} {measured[name][1]:8d}"
        print(row + "".join(f"{ticks / 168:9.1f}" for ticks in times) + f" {cells}  {interrupt.why}", flush=True)


def beyond(image: str, factors: Iterable[float], seconds: float) -> None:
    """Print the second table."""
    print(f"\n{image}, {seconds:g} s at ever more cycles an instruction: counters that are not 0, and the rest")
    for factor in factors:
        loaded = Loaded(image, factor)
        went_on = loaded.run(round(seconds * SECOND))
        counts, rest = loaded.said()
        words = ", ".join([f"{name} {value}" for name, value in counts.items()] or ["nothing counted"])
        if not went_on:
            rest.append("stopped for good")
        print(f"{factor:6g}  {words}; {'; '.join(rest)}", flush=True)
        loaded.board.close()


def main() -> None:
    """Print what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "images", nargs="*", type=one_of(IMAGES), metavar="IMAGE", help=f"of {', '.join(IMAGES)}; all if none is given"
    )
    parser.add_argument(
        "--seconds", type=real_number(1.0), default=2.5, help="virtual time of each run, with the drive on at its end"
    )
    arguments = parser.parse_args()
    for image in arguments.images or IMAGES:
        if image not in IMAGES:
            parser.error(f"there is no image '{image}'; there are {', '.join(IMAGES)}")
        budgets(image, arguments.seconds)
        beyond(image, SWEEP, arguments.seconds)


if __name__ == "__main__":
    main()

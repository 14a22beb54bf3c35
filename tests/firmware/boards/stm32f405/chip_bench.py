"""A board that runs chip_probe.c, whose every conversion tells its chip, and what came out of its pins.

Time zero is the moment the LED pin rises, which the driver does together with the start of the chip timer.
"""

import bisect
import itertools
import struct
from collections import Counter
from pathlib import Path

from hil_sim import clib
from hil_sim.emulator.emulator import LIBRARY, Configuration, Emulator

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[3]
BOARD = "firmware/boards/stm32f405"
SENSOR, MASK_INTERRUPTS, STALL, LOSE_SAMPLES, HANG_ONCE, ANCHOR, DISABLED, RETRY = (1 << n for n in range(8))
LONG_BLOCKS, STOP_CURRENT, STOP_EDGES, STOP_EDGES_8, STOP_SET_POINTS = range(1, 6)
STOP_CHIPS, HANG_CURRENT, EXCHANGE_SAMPLES, SOFTWARE_FAULT = range(6, 10)
PA0, PA1, PA6, PA7 = 0, 1, 6, 7
PB0, PB1, PB4, PB12, PB13, PB14, PB15 = 16, 17, 20, 28, 29, 30, 31
PC0, PC1, PC2, PC3, PC4, PC6 = 32, 33, 34, 35, 36, 38
BRIDGES = (PB13, PB14, PB0, PB1)
OUTPUTS = (*BRIDGES, PA7)
MONITOR = {PC1: 0, PC3: 200, PC0: 400, PC2: 600}  # Counts above the chip's own, by pin.
TICK_PS = 1e12 / 168e6
FIELDS = (
    *("hal", "mode", "planned", "plan_out_of_order", "samples_right", "samples_wrong", "blocks_lost"),
    *("samples_out_of_order", "sampled", "currents_right", "currents_wrong", "monitors_right", "monitors_wrong"),
    *(
        "enabled",
        "refused",
        "fault_driver",
        "fault_stale",
        "fault_clock",
        "fault_line",
        "temperature",
        "happened",
        "received",
    ),
)
COUNTERS = ("serial_overruns", "can_errors", "can_overruns", "late_blocks", "converter_overruns", "watchdog_resets")
CHIPS = 700


def period(chip, mode):
    return 16422 if mode & STALL else 16350 + chip * 37 % 131


def drive(chip, channel):
    mixed = chip * 2654435761 % 2**32
    return (mixed >> 8 & 0xFF) % 3 if channel else (mixed >> 16) % 3


def set_points(chip):
    return [min(chip * 29 % 4200, 4095), chip * 53 % 4096]


class Bench:
    """A board with the probe image; every conversion's volts tell chip, number in the chip, and axis."""

    def __init__(self, image, mode, happens=0, **configuration):
        self.mode = mode
        self.starts = [0, *itertools.accumulate(period(c, mode) for c in range(CHIPS + 200))]
        self.zero_ps = None
        self.edges = []  # (time, pin, level) since the start
        self.analog = ([], [])  # (time, counts) of each channel
        self._taken = Counter()
        self.conversions = []  # (pin, chip, number in the chip, ticks since the chip's start)
        self.middles = []  # (pin, chip, ticks since the chip's start) of the coil currents amid the chip
        self._ffi, _ = clib.load(LIBRARY, ["emulator/emulator.h"])
        edge = self._ffi.new("board_edge_t *")
        self._keep = [
            edge,
            self._ffi.callback("void(void *, unsigned, bool, int64_t)", self._pin_out),
            self._ffi.callback("double(void *, unsigned, int64_t)", self._analog_in),
            self._ffi.callback("void(void *, unsigned, double, int64_t)", self._analog_out),
        ]
        edge.pin_out, edge.analog_in, edge.analog_out = self._keep[1:]
        self.board = Emulator(
            image,
            Configuration(**configuration),
            edge=int(self._ffi.cast("uintptr_t", edge)),
            parameter_page=bytes([mode, happens]) + bytes(1022),
        )

    def _pin_out(self, _, pin, level, time_ps):
        if pin == PB4 and level:
            self.zero_ps = time_ps
        if self.zero_ps is not None:
            self.edges.append((time_ps, pin, bool(level)))

    def _analog_out(self, _, channel, volts, time_ps):
        self.analog[channel - 1].append((time_ps, round(volts / 3.3 * 4096)))

    def _analog_in(self, _, pin, time_ps):
        if self.zero_ps is None:
            return 1.65
        ticks = (time_ps - self.zero_ps) / TICK_PS
        chip = bisect.bisect_right(self.starts, ticks) - 1
        ticks -= self.starts[chip]
        if pin in (PA0, PC4) and 650 < ticks < 720:  # The first chip comes up to 20 later: the LED is told first.
            return (chip * 7 % 3000 + 300.25 + (30 if pin == PC4 else 0)) * 3.3 / 4096
        if 5800 < ticks < 7700:
            if pin in (PA0, PC4):
                self.middles.append((pin, chip, ticks))
                return (chip * 11 % 3000 + 200.25 + (40 if pin == PC4 else 0)) * 3.3 / 4096
            if pin in MONITOR:
                return (chip % 3000 + 107.25 + MONITOR[pin]) * 3.3 / 4096
        if ticks < 14000:  # Converted beside the temperature, for nobody.
            return 0.0
        number = self._taken[pin, chip]
        self._taken[pin, chip] += 1
        self.conversions.append((pin, chip, number, ticks))
        if pin in MONITOR:
            return (chip % 3000 + 100.25 + MONITOR[pin]) * 3.3 / 4096
        if pin == PC4:
            return ((chip * 8 * 5) % 4000 + 70.25) * 3.3 / 4096
        axis = max(pin - PA1, 0)
        return (((chip * 8 + number) * 5 + axis * 1000) % 4000 + 50.25) * 3.3 / 4096

    def run(self, chips):
        """Run to a little behind the start of a chip; the chip engine starts within 20 ms."""
        step = 0
        while self.zero_ps is None and step < 400:
            step += 1
            assert self.board.run(step * 50_000_000), self.board.report()
        assert self.zero_ps is not None
        end = self.zero_ps + int((self.starts[chips] + 1000) * TICK_PS)
        return self.board.run(end)

    def pulse(self, pin, chip, ticks, length_ps):
        """Bring a rising edge at a time of a chip, and a falling edge later."""
        time_ps = self.zero_ps + round((self.starts[chip] + ticks) * TICK_PS)
        assert self.board.run(time_ps - 1_000_000), self.board.report()
        self.board.pin_in(pin, True, time_ps)
        self.board.pin_in(pin, False, time_ps + length_ps)

    def fault(self, low, pins=(PB12, PA6)):
        """Pull the fault wire, now."""
        for pin in pins:
            self.board.pin_in(pin, not low, self.board.now_ps)

    def levels(self, pin):
        """Return [(chip, ticks, level)] of all edges of a pin."""
        edges = [((time - self.zero_ps) / TICK_PS, level) for time, number, level in self.edges if number == pin]
        chips = [bisect.bisect_right(self.starts, ticks) - 1 for ticks, _ in edges]
        return [(c, ticks - self.starts[c], level) for c, (ticks, level) in zip(chips, edges, strict=True)]

    def probe(self):
        address = self.board.symbols["probe"]
        words = struct.unpack("<174I", self.board.memory(address, 4 * 174))
        result = dict(zip(FIELDS, words[:22], strict=True))
        result["temperature"] -= (result["temperature"] >> 31) << 32
        result["ports"] = [words[22 + 4 * port : 26 + 4 * port] for port in range(3)]
        result["syncs"] = words[34]
        result["edges"] = list(zip(words[35:99], words[99:163], strict=True))[: result["syncs"]]
        looks = ("edges_right", "edges_wrong", "middles_right", "middles_wrong")
        result |= zip((*COUNTERS, "supply_dips", *looks), words[163:], strict=True)
        return result

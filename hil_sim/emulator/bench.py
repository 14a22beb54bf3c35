"""A chip without a processor, to test peripheral models: the caller's loads and stores take the core's place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import cffi

from hil_sim.clib import load

MICROSECOND = 1_000_000
MILLISECOND = 1_000_000_000


@cache
def library() -> tuple[cffi.FFI, Any]:
    """Open the emulator with the declarations of the bench."""
    return load("build/libgf_emulator.so", ["emulator/machine_bench.h", "emulator/peripherals/registers.h"])


@dataclass
class Edge:
    """What the chip did to the outside, in order of time, each with its time in picoseconds."""

    pins: list[tuple[int, bool, int]] = field(default_factory=list)
    released: list[tuple[int, str, int]] = field(default_factory=list)
    volts: list[tuple[int, float, int]] = field(default_factory=list)
    samples: list[tuple[int, int]] = field(default_factory=list)
    sent: list[tuple[int, int, int]] = field(default_factory=list)
    frames: list[tuple[int, int, bool, bytes, int]] = field(default_factory=list)
    aborts: list[tuple[int, int]] = field(default_factory=list)


class Bench:
    """A chip, its registers and its edge.

    Parameters
    ----------
    analog : callable, optional
        Volts of a pin at a time in picoseconds; 0 V without it.
    **config
        Fields of emulator_config_t.
    """

    def __init__(self, analog: Callable[[int, int], float] | None = None, **config: float) -> None:
        self.ffi, self.lib = library()
        ffi = self.ffi
        self.edge = Edge()
        settings: Any = ffi.new("emulator_config_t *")
        settings.temperature_degc = 25.0
        for key, value in config.items():
            setattr(settings, key, value)

        def analog_in(_: Any, pin: int, time_ps: int) -> float:
            self.edge.samples.append((pin, time_ps))
            return 0.0 if analog is None else analog(pin, time_ps)

        def frame_out(_: Any, box: int, frame: Any, time_ps: int) -> None:
            data = bytes(frame.data)[: frame.length]
            self.edge.frames.append((box, frame.id, bool(frame.extended), data, time_ps))

        edge = ffi.new("board_edge_t *")
        self._alive = [
            ffi.callback("void(void *, unsigned, bool, int64_t)", lambda _, p, v, t: self.edge.pins.append((p, v, t))),
            ffi.callback(
                "void(void *, unsigned, board_pull_t, int64_t)",
                lambda _, p, pull, t: self.edge.released.append((p, ("none", "up", "down")[pull], t)),
            ),
            ffi.callback(
                "void(void *, unsigned, double, int64_t)", lambda _, c, v, t: self.edge.volts.append((c, v, t))
            ),
            ffi.callback("double(void *, unsigned, int64_t)", analog_in),
            ffi.callback(
                "void(void *, unsigned, uint8_t, int64_t)", lambda _, u, b, t: self.edge.sent.append((u, b, t))
            ),
            ffi.callback("void(void *, unsigned, const board_frame_t *, int64_t)", frame_out),
            ffi.callback("void(void *, unsigned, int64_t)", lambda _, b, t: self.edge.aborts.append((b, t))),
        ]
        names = ("pin_out", "pin_release", "analog_out", "analog_in", "uart_out", "can_request", "can_abort")
        for name, callback in zip(names, self._alive, strict=True):
            setattr(edge, name, callback)
        self.operations = self.lib.machine_bench_operations
        self.machine = self.lib.machine_bench_create(settings, edge)
        self.board = ffi.cast("board_t *", self.machine)

    def close(self) -> None:
        """Free the chip."""
        self.operations.destroy(self.board)

    @property
    def now(self) -> int:
        """Present time, picoseconds."""
        return int(self.operations.now(self.board))

    def run(self, picoseconds: float) -> None:
        """Let time pass."""
        self.operations.run(self.board, self.now + round(picoseconds))

    def run_to(self, time_ps: float) -> None:
        """Let time pass up to (not including) a time."""
        self.operations.run(self.board, round(time_ps))

    def write(self, address: int, value: int, width: int = 4) -> None:
        """Store, as the core does it."""
        assert self.lib.machine_bench_write(self.machine, address, width, value), self.report

    def read(self, address: int, width: int = 4) -> int:
        """Load, as the core does it."""
        value = self.ffi.new("uint32_t *")
        assert self.lib.machine_bench_read(self.machine, address, width, value), self.report
        return int(value[0])

    def refused(self, address: int, value: int, width: int = 4) -> bool:
        """Store, and return whether the core would have a BusFault."""
        return not self.lib.machine_bench_write(self.machine, address, width, value)

    def change(self, address: int, set_bits: int, clear_bits: int = 0) -> None:
        """Read, modify, write."""
        self.write(address, (self.read(address) & ~clear_bits) | set_bits)

    def irq(self, position: int) -> bool:
        """Level of an interrupt line."""
        return bool(self.lib.machine_bench_irq(self.machine, position))

    def _text(self, pointer: Any) -> str:
        raw = self.ffi.string(pointer)
        return raw if isinstance(raw, str) else raw.decode()

    @property
    def report(self) -> str:
        """Violations so far, one a line."""
        return self._text(self.operations.report(self.board))

    @property
    def violations(self) -> int:
        """Return the number of violations so far."""
        return int(self.lib.machine_bench_violations(self.machine))

    def expect(self, text: str) -> None:
        """Check that violations were recorded and that one holds the text; forget them."""
        assert text in self.report, self.report or "no violation"
        self.lib.machine_bench_forget_violations(self.machine)

    def registers(self, name: str) -> dict[str, tuple[int, int, int, int]]:
        """Table of a model: offset, reset value, defined bits and access (enum) by register name."""
        count = self.ffi.new("unsigned *")
        table = self.lib.machine_register_table(self.machine, name.encode(), count)
        rows = [table[i] for i in range(count[0])]
        return {self._text(r.name): (r.offset, r.reset, r.bits, r.access) for r in rows}

    def base(self, name: str) -> int:
        """Return the base address of a peripheral."""
        return int(self.lib.machine_peripheral(self.machine, name.encode()).base)

    def clocks_on(self) -> None:
        """Enable every peripheral clock of the chip."""
        for offset, bits in ((0x30, 0x7E7411FF), (0x34, 0xF1), (0x40, 0x36FEC9FF), (0x44, 0x00075F33)):
            self.write(0x40023800 + offset, bits)
        self.run(MICROSECOND)

    def full_speed(self) -> None:
        """Crystal, PLL, 168 MHz; APB1 42 MHz, APB2 84 MHz; every clock on."""
        rcc, flash = 0x40023800, 0x40023C00
        self.write(flash, 0x705)
        self.write(rcc, 0x10083)
        self.run(2.5 * MILLISECOND)
        self.write(rcc + 4, 0x20000000 | 12 | 336 << 6 | 1 << 22 | 7 << 24)
        self.change(rcc, 1 << 24)
        self.run(0.2 * MILLISECOND)
        self.write(rcc + 8, 5 << 10 | 4 << 13 | 2)
        assert self.read(rcc + 8) & 0xC == 8, "the PLL is not the system clock"
        self.clocks_on()

    def alternate(self, port: str, pin: int, function: int) -> None:
        """Put a pin into alternate mode."""
        base = 0x40020000 + 0x400 * (ord(port) - ord("A"))
        high = base + 0x20 + 4 * (pin // 8)
        self.change(high, function << 4 * (pin % 8), 15 << 4 * (pin % 8))
        self.change(base, 2 << 2 * pin, 3 << 2 * pin)

    def analog_pin(self, port: str, pin: int) -> None:
        """Put a pin into analog mode."""
        self.change(0x40020000 + 0x400 * (ord(port) - ord("A")), 3 << 2 * pin)

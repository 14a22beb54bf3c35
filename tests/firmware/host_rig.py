"""Boards driven from Python: each board's edge is recorded, a test supplies volts, edges, bytes and frames.

A board is a host board, or, for comparison, the ARM image on the emulator: the edge is the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield_protocol import FrameDecoder, Message, decode, encode, encode_frame
from goldfield_protocol.parameters import PAGE_BYTES, build_page
from hil_sim.clib import ROOT, load
from hil_sim.emulator.emulator import Configuration, Emulator
from tests.firmware.analog_pins import FOREVER, MID_SCALE_V, AnalogPins, Pins, Source
from tests.firmware.gold_pairs import PAIRS

FFI, LIBRARY = load("libgf_hostboard.so", ["boards/host/host_board.h"])

BEACON, SENSOR, ANCHOR = 0, 1, 3
IMAGES = {BEACON: "beacon.elf", SENSOR: "sensor.elf", ANCHOR: "anchor.elf"}
PIN_CURRENT, PIN_FIELD, PIN_SYNC_IN = (0, 36), (1, 2, 3), 38
PINS_BRIDGE = ((29, 30), (16, 17))
"""Inputs 1 and 2 of each channel's bridge."""
PIN_SUPPLY, PIN_COIL_TEMPERATURE, PIN_DRIVER_TEMPERATURE = 32, (33, 35), 34
PIN_BRIDGE_1, PIN_BRIDGE_2, PIN_SYNC_OUT, PIN_ENABLE, PIN_LED = 29, 30, 7, 31, 20
PIN_FAULT, PIN_FAULT_TOO = 28, 6
"""The two ends of one wire."""
SERIAL_PORT = 3
PULL_UP = 1

US = 10**6
MS = 10**9
SECOND = 10**12
CHIPS = 1023
CHIP_TICKS = 16422
TICKS_PER_SECOND = 168_000_000
LISTENS = 234 * MS
"""A master looks for another leader first: its first cycle begins so late after its start, rounded up (election.h)."""


def chip_seconds(ppm: float) -> float:
    """Length of a nominal chip on a clock with this error."""
    return CHIP_TICKS / (TICKS_PER_SECOND * (1 + ppm * 1e-6))


@cache
def _register(stages: tuple[int, ...], degree: int) -> NDArray[np.int64]:
    """One period of a shift register whose stages feed back, from all ones."""
    state = [1] * degree
    out = []
    for _ in range(2**degree - 1):
        out.append(state[-1])
        state = [sum(state[s - 1] for s in stages) % 2, *state[:-1]]
    return np.array(out)


def gold_chips(code: int, degree: int = 10) -> NDArray[np.int64]:
    """One period of a code as +1 and -1, from the registers' definition (IS-GPS-200, figures 3-8 and 3-9)."""
    chips = 2**degree - 1
    u, v = (_register(stages, degree) for stages in PAIRS[degree])
    bits = u if code == chips else v if code == chips + 1 else u ^ np.roll(v, -code)
    return 1 - 2 * bits


@dataclass
class Board:
    """One board and everything that came out of it.

    Parameters
    ----------
    role : int
        `BEACON`, `SENSOR` or `ANCHOR`.
    parameters : mapping or bytes
        Contents of the parameter page, or the page itself.
    volts : mapping
        What the converter sees at each pin (`AnalogPins`).
    clock : int
        `hal_clock_t`: 0 crystal, 1 internal oscillator, 2 slow; host boards only.
    emulated : bool
        Run the ARM image of the role.
    cycles : float or str
        How many cycles an instruction takes there, or ``m4``.
    strict : bool
        A violation of what the chip's manual allows stops an emulated board.
    stop_at_fault : bool
        So does a fault of the processor; else its handler is entered.
    cells : bytes, optional
        The flash of an emulated board that had no power (`Emulator.cells`), in place of image and page.
    """

    role: int
    parameters: Mapping[str, Any] | bytes = field(default_factory=dict)
    ppm: float = 0.0
    volts: Pins = field(default_factory=dict)
    power_on: int = 0
    unique_id: bytes = bytes(range(12))
    temperature: float = 25.0
    can: bool = True
    clock: int = 0
    emulated: bool = False
    cycles: float | str = 1.0
    strict: bool = True
    stop_at_fault: bool = True
    cells: bytes | None = None

    pins: list[tuple[int, int, bool]] = field(default_factory=list)
    analog: tuple[list[tuple[int, float]], list[tuple[int, float]]] = field(default_factory=lambda: ([], []))
    serial: list[tuple[int, int]] = field(default_factory=list)
    requests: list[tuple[int, int, int, bytes]] = field(default_factory=list)
    level: dict[int, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        page = self.parameters if isinstance(self.parameters, bytes) else build_page(self.parameters)
        edge = self._edge()
        if self.emulated:
            settings = Configuration.with_cycles(
                self.cycles,
                crystal_ppm=self.ppm,
                unique_id=self.unique_id,
                temperature_degc=self.temperature,
                strict=self.strict,
                stop_at_fault=self.stop_at_fault,
            )
            image = ROOT / "build/firmware" / IMAGES[self.role]
            address = int(FFI.cast("uintptr_t", edge))
            self.emulator = Emulator(
                image, settings, edge=address, parameter_page=page, power_on_ps=self.power_on, cells=self.cells
            )
            self.handle = FFI.cast("board_t *", self.emulator.board)
            self.operations = FFI.cast("board_operations_t *", self.emulator.operations)
            return
        config = FFI.new("host_board_config_t *")
        config.role = self.role
        config.crystal_ppm = self.ppm
        config.clock = self.clock
        config.temperature_degc = self.temperature
        config.unique_id = self.unique_id
        config.parameter_page = page.ljust(PAGE_BYTES, b"\xff")
        self.handle = LIBRARY.host_board_create(config, edge, self.power_on)
        self.operations = LIBRARY.host_board_operations
        assert self.handle != FFI.NULL

    def _edge(self) -> Any:
        edge = FFI.new("board_edge_t *")
        self._keep = [
            FFI.callback("void(void *, unsigned, bool, int64_t)", self._pin_out),
            FFI.callback("void(void *, unsigned, board_pull_t, int64_t)", self._pin_release),
            FFI.callback("void(void *, unsigned, double, int64_t)", self._analog_out),
            FFI.callback("void(void *, unsigned, uint8_t, int64_t)", self._uart_out),
            FFI.callback("void(void *, unsigned, const board_frame_t *, int64_t)", self._can_request),
        ]
        edge.pin_out, edge.pin_release, edge.analog_out, edge.uart_out = self._keep[:4]
        if self.can:
            edge.can_request = self._keep[4]
        self._inputs = AnalogPins(self.volts)
        edge.context = FFI.cast("void *", self._inputs.context)
        edge.analog_in = FFI.cast("double(*)(void *, unsigned, int64_t)", self._inputs.sample)
        return edge

    def fail(self, what: str, active: bool = True) -> None:
        """Let something of a host board fail, or mend it: ``MAIN_HANGS`` or ``CURRENT_STOPS``."""
        LIBRARY.host_board_fail(self.handle, getattr(LIBRARY, f"HOST_FAILURE_{what}"), active)

    def clear(self, time: int, node: int = 1, board: int | None = None) -> None:
        """Ask the board on serial to clear what keeps its drive off."""
        halves = (int.from_bytes(self.unique_id[i : i + 6], "little") for i in (0, 6))
        own = next(halves) ^ next(halves)
        self.send_serial("COMMAND", {"board": own if board is None else board, "argument": 0}, node, 3, time)

    def close(self) -> None:
        if self.emulated:
            self.emulator.close()
        else:
            self.operations.destroy(self.handle)

    # What comes out.

    def _pin_out(self, _: Any, pin: int, level: bool, time: int) -> None:
        self.pins.append((time, pin, level))
        self.level[pin] = level
        self._inputs.forget()  # Sources of analog inputs depend on outputs.

    def _pin_release(self, _: Any, pin: int, pull: int, time: int) -> None:
        """Pins that float are low: enable and sync output by the pull-downs of the pinout, the rest by decree."""
        level = pull == PULL_UP and pin not in (PIN_ENABLE, PIN_SYNC_OUT)
        if self.level.get(pin, level) != level:
            self._pin_out(None, pin, level, time)

    def _analog_out(self, _: Any, channel: int, volts: float, time: int) -> None:
        self.analog[channel - 1].append((time, volts))
        self._inputs.forget()

    def _uart_out(self, _: Any, port: int, byte: int, time: int) -> None:
        assert port == SERIAL_PORT
        self.serial.append((time, byte))

    def _can_request(self, _: Any, mailbox: int, frame: Any, time: int) -> None:
        assert frame.extended
        assert not frame.remote
        self.requests.append((time, mailbox, frame.id, bytes(frame.data[0 : frame.length])))

    def edges(self, pin: int, level: bool = True) -> list[int]:
        """Times at which a pin went to a level; it is low until the board first drives it."""
        times, before = [], False
        for time, number, new in self.pins:
            if number == pin:
                if new == level != before:
                    times.append(time)
                before = new
        return times

    def messages(self, name: str | None = None) -> list[Message]:
        """Messages on the serial port so far, all or of one kind; any damaged frame is an error."""
        decoder = FrameDecoder()
        frames = list(decoder.feed(bytes(byte for _, byte in self.serial)))
        assert decoder.bad_crc == decoder.malformed == decoder.overlong == 0
        decoded = [decode(frame.identifier, frame.data) for frame in frames]
        assert None not in decoded
        return [m for m in decoded if m is not None and (name is None or m.name == name)]

    def can_messages(self, name: str | None = None) -> list[Message]:
        """Messages handed to CAN so far."""
        decoded = [decode(identifier, data) for _, _, identifier, data in self.requests]
        return [m for m in decoded if m is not None and (name is None or m.name == name)]

    # What goes in.

    def run(self, until: int) -> None:
        self._inputs.forget()  # And on what a test has changed since the last run.
        ok = self.operations.run(self.handle, until) == 0
        assert ok, FFI.string(self.operations.report(self.handle)).decode()

    def pin(self, pin: int, level: bool, time: int) -> None:
        for end in (PIN_FAULT, PIN_FAULT_TOO) if pin == PIN_FAULT else (pin,):
            self.operations.pin_in(self.handle, end, level, time)

    def sync_pulse(self, time: int) -> None:
        self.pin(PIN_SYNC_IN, True, time)
        self.pin(PIN_SYNC_IN, False, time + 97 * US)

    def receive(self, stream: bytes, time: int, baud: int = 2_000_000) -> None:
        """Bytes arrive back to back from a time on."""
        for i, byte in enumerate(stream):
            self.operations.uart_in(self.handle, SERIAL_PORT, byte, baud, time + (i + 1) * 10 * SECOND // baud)

    def send_serial(self, name: str, signals: Mapping[str, float], node: int, index: int, time: int) -> None:
        identifier, data = encode(name, signals, node=node, index=index)
        self.receive(encode_frame(identifier, data), time)

    def can_in(self, identifier: int, data: bytes, time: int) -> None:
        frame = FFI.new("board_frame_t *", {"id": identifier, "extended": True, "length": len(data)})
        frame.data[0 : len(data)] = list(data)
        self.operations.can_in(self.handle, frame, time)

    def can_sent(self, mailbox: int, ok: bool, time: int) -> None:
        self.operations.can_sent(self.handle, mailbox, ok, time)


class Rig:
    """Boards on one sync wire, one CAN bus, and one virtual time. The first board drives the wire and runs first.

    The bus takes 130 us a frame, first come, first served, and passes frames on at the end of a quantum: to
    receivers as of one bit (1 us) before the frame's end, to its sender as of its end.
    """

    def __init__(self, *boards: Board, quantum: int = MS) -> None:
        self.boards = boards
        self.quantum = quantum
        self.now = 0
        self._edges = 0
        self._requests = [0] * len(boards)
        self._bus_free = 0

    def run(self, until: int) -> None:
        while self.now < until:
            self.now = min(self.now + self.quantum, until)
            for board in self.boards:
                board.run(self.now)
                if board is self.boards[0]:
                    self._forward_sync()
            self._forward_can()

    def _forward_sync(self) -> None:
        pins = self.boards[0].pins
        for time, pin, level in pins[self._edges :]:
            if pin == PIN_SYNC_OUT:
                for board in self.boards[1:]:
                    board.pin(PIN_SYNC_IN, level, time)
        self._edges = len(pins)

    def _forward_can(self) -> None:
        for i, sender in enumerate(self.boards):
            for time, mailbox, identifier, data in sender.requests[self._requests[i] :]:
                self._bus_free = max(self._bus_free, time) + 130 * US
                sender.can_sent(mailbox, True, self._bus_free)
                for other in self.boards:
                    if other is not sender:
                        other.can_in(identifier, data, self._bus_free - US)
            self._requests[i] = len(sender.requests)

    def __iter__(self) -> Iterator[Board]:
        return iter(self.boards)


def chip_at(time: int, first_edge: int, ppm: float) -> tuple[int, int]:
    """Return which nominal chip of a clock it is, counted from an edge on, and a time just before the next one."""
    length_ps = chip_seconds(ppm) * 1e12
    chip = math.floor((time - first_edge) / length_ps)
    return chip, first_edge + int((chip + 1) * length_ps) - 10


def each_axis(volts: Callable[[int, int], float | tuple[float, int]]) -> dict[int, Source]:
    """Inputs of a sensor's axes of which ``volts(axis, time)`` tells."""
    return {pin: partial(volts, axis) for axis, pin in enumerate(PIN_FIELD)}


@dataclass
class Coil:
    """A coil that follows its bridge at once: the driver makes the reference's amperes with a gain, if enabled.

    ``extra_A``, ``stray_A`` and ``broken_from`` make it misbehave from a time on; the stray current flows whatever the
    bridge does. Who lets `amperes` depend on anything else says that it is not ``steady``.
    """

    gain: float = 1.0
    extra_A: float = 0.0
    extra_from: int = 1 << 62
    broken_from: int = 1 << 62
    stray_A: float = 0.0
    stray_from: int = 1 << 62
    channel: int = 0
    board: Board | None = None
    steady: bool = True

    def sensed(self, time: int) -> float | tuple[float, int]:
        """Volts of the current's sense, and until when they stay if the board leaves its outputs as they are."""
        volts = MID_SCALE_V + 0.103125 * self.amperes(time)
        if not self.steady:
            return volts
        return volts, min(at for at in (self.extra_from, self.broken_from, self.stray_from, FOREVER) if at > time)

    def amperes(self, time: int) -> float:
        board = self.board
        if time >= self.stray_from:
            return self.stray_A
        if board is None or not board.level.get(PIN_ENABLE) or time >= self.broken_from:
            return 0.0
        positive, negative = PINS_BRIDGE[self.channel]
        sign = bool(board.level.get(positive)) - bool(board.level.get(negative))
        reference = board.analog[self.channel][-1][1] / 3.3 * 16.0
        extra = self.extra_A if time >= self.extra_from else 0.0
        return sign * (self.gain * reference + extra)


def beacon(
    coil: Coil, second: Coil | None = None, pins: Mapping[int, Callable[[int], float]] | None = None, **options: Any
) -> Board:
    """A beacon board with its coil, or its two; other analog inputs give ``pins[pin](time)`` or lie at mid-scale."""
    coils = [coil] if second is None else [coil, second]
    senses = {pin: each.sensed for pin, each in zip(PIN_CURRENT, coils, strict=False)}
    board = Board(BEACON, volts={**senses, **(pins or {})}, **options)
    for channel, each in enumerate(coils):
        each.board, each.channel = board, channel
    return board

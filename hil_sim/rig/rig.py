"""The rig: a scenario's boards, coils, field and wires in one virtual time; the hot loop is ``lockstep.c``."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import SystemFailure, UserError, counted
from goldfield_protocol.parameters import Value, build_page, parse_page
from hil_sim import clib
from hil_sim.emulator import Emulator
from hil_sim.rig import config as rig_config
from hil_sim.rig.boards import Board, BoardFactory, BoardSpec, address, factory
from hil_sim.rig.paths import PathWindows, event_ps
from hil_sim.rig.truth import Truth, truth_at
from hil_sim.scenario import (
    COIL_FAULTS,
    SENSOR_FAULTS,
    Ambient,
    Clock,
    Electrical,
    ProcessorSupply,
    Scenario,
    SensorFault,
    Strike,
    Supply,
    Surroundings,
    parameter_page,
)

FloatArray = NDArray[np.float64]

LIBRARY = "libgf_rig.so"
SENSOR = 0
FAULTS = (
    *("driver", "coil_open", "sense_shorted", "sync_wire_cut", "coil_shorted", "driver_runaway"),
    *("driver_stuck", "sense_held", "coil_hot", "driver_hot", "pull_downs_lost", "can_cut"),
    *("bridge_swapped", "coil_reversed"),
)
"""The faults that a board can be given, in the order of ``rig_fault_t``."""
CHIP_PS = 16422 / 168e6 * 1e12
CAN_COUNTS = ("frames", "unacknowledged", "errors", "collisions", "busy_ps")
"""The members of ``can_statistics_t``."""


@dataclass(frozen=True)
class Frame:
    """A CAN frame on the bus.

    Attributes
    ----------
    time_s : float
        End of the frame.
    board : int
        Sender; one beyond the last beacon is the host's adapter.
    identifier : int
    data : bytes
    extended, remote, acknowledged : bool
    """

    time_s: float
    board: int
    identifier: int
    data: bytes
    extended: bool = True
    remote: bool = False
    acknowledged: bool = True


class Rig:
    """A bench of boards.

    Parameters
    ----------
    scenario : Scenario
    boards : str or BoardFactory
        ``emulated``, ``host``, or something that makes boards.
    seed : int, optional
        Seed of all random draws, in place of the scenario's.
    host_on_can : bool
        The host's adapter is on the CAN bus: it acknowledges, and `can_read` and `can_write` work.
    cycles_per_instruction : float or str
        How many cycles an instruction takes on emulated boards (1 to 100), or ``m4``: by class of instruction.
    threads : int, optional
        Default: two, or one if this machine has one processor.

    Raises
    ------
    UserError, SystemFailure
        If a board or a library is missing or refuses its configuration.

    Attributes
    ----------
    sensing : list of int
        Boards with a sensor: `SENSOR`, then the anchors.
    """

    def __init__(
        self,
        scenario: Scenario,
        boards: str | BoardFactory = "emulated",
        seed: int | None = None,
        *,
        host_on_can: bool = True,
        cycles_per_instruction: float | str = 1.0,
        threads: int | None = None,
    ) -> None:
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        self._ffi: Any
        self._library: Any
        try:
            make = factory(boards, cycles_per_instruction) if isinstance(boards, str) else boards
            self._ffi, self._library = clib.load_built(LIBRARY)
        except FileNotFoundError as error:
            raise UserError(str(error)) from error
        self._boards: list[Board] = []
        self._specs: list[BoardSpec] = []
        self.sensing = [n for n in range(1 + len(scenario.beacons)) if scenario.front_end(n) is not None]
        self._truth_edges = dict.fromkeys(self.sensing, 0)
        self._truth_cycles = dict.fromkeys(self.sensing, 0)
        self._rig = self._create(host_on_can, threads or min(2, os.cpu_count() or 1))
        try:
            self._make = make
            self._connect()
            self._paths = PathWindows(self._ffi, self._library, self._rig, scenario.installed)
            electrical = [event for event in scenario.events if isinstance(event, Electrical)]
            for event in electrical:
                if isinstance(event, ProcessorSupply):
                    self._emulator(self._board_of(event))
            self.can_errors(scenario.can.bit_error_probability)
            self.can_delay(scenario.can.delay_s)
            self._electrical = deque(sorted(electrical, key=lambda event: event.time_s))
            for board in range(len(self._boards)):
                if scenario.sync == "can" or (board == SENSOR and not scenario.sensor.sync_wire):
                    self.fault(board, "sync_wire_cut")
        except FileNotFoundError as error:
            self.close()
            raise UserError(str(error)) from error
        except BaseException:
            self.close()
            raise

    # ---- Building ----

    def _create(self, host_on_can: bool, threads: int) -> Any:
        config, _boards = rig_config.build(self._ffi, self.scenario.installed, self.seed)
        config.threads, config.host_on_can = threads, host_on_can
        rig = self._library.rig_create(config)
        if rig == self._ffi.NULL:
            raise SystemFailure("the rig could not be made: not enough memory or threads")
        return rig

    def _connect(self) -> None:
        scenario = self.scenario
        random = np.random.default_rng([self.seed, 1])
        delays_s = random.uniform(0.0, scenario.power_on_spread_s, len(scenario.beacons) + 1)
        clocks = [scenario.sensor.clock, *(beacon.clock for beacon in scenario.beacons)]
        for number, (delay_s, clock) in enumerate(zip(delays_s, clocks, strict=True)):
            spec = BoardSpec(
                role=self._role(number),
                clock=clock,
                unique_id=random.bytes(8) + number.to_bytes(4, "little"),
                parameter_page=parameter_page(scenario, number),
                power_on_ps=int(delay_s * 1e12),
                random_seed=self.seed % 2**64,
            )
            self._specs.append(spec)
            self._boards.append(self._slot(number, spec))

    def _role(self, board: int) -> str:
        if board == SENSOR:
            return "sensor"
        return "beacon" if self.scenario.front_end(board) is None else "anchor"

    def _slot(self, number: int, spec: BoardSpec) -> Board:
        """Make a board and connect it."""
        ffi, library = self._ffi, self._library
        board = self._make(spec, address(ffi, library.rig_edge(self._rig, number)))
        operations = ffi.cast("board_operations_t *", board.operations)
        library.rig_connect(self._rig, number, ffi.cast("board_t *", board.instance), operations, spec.power_on_ps)
        return board

    # ---- Running ----

    @property
    def now_s(self) -> float:
        """The sensor's present, seconds of virtual time."""
        return float(self._library.rig_now(self._rig)) * 1e-12

    def advance(self, seconds: float) -> None:
        """Run the bench; the result does not depend on how a time is cut in calls.

        Raises
        ------
        SystemFailure
            If a board stopped; the sentence says which and why.
        """
        self.run_until(int(self._library.rig_now(self._rig)) + round(seconds * 1e12))

    def run_until(self, until_ps: int) -> None:
        """Run up to a virtual time in picoseconds, rounded down to a whole quantum; see `advance`."""
        while True:
            now_ps = int(self._library.rig_now(self._rig))
            stop_ps = min(until_ps, self._paths.enter(now_ps))
            while self._electrical and event_ps(self._electrical[0]) <= now_ps:
                self._happen(self._electrical.popleft())
            status = self._library.rig_run(self._rig, stop_ps)
            if status != self._library.RIG_OK:
                raise SystemFailure(self._complaint(status))
            if stop_ps >= until_ps:
                return

    def _board_of(self, event: Supply | ProcessorSupply | Strike | SensorFault) -> int:
        if not event.beacon:
            return SENSOR
        return 1 + [beacon.id for beacon in self.scenario.beacons].index(event.beacon)

    def _happen(self, event: Electrical) -> None:
        if isinstance(event, Surroundings):
            self.surround(event.ambient)
            return
        board = self._board_of(event)
        if isinstance(event, SensorFault):
            self.sensor_fault(event.axis, event.fault, event.value, board)
        elif isinstance(event, Supply):
            self.set_supply_V(board, event.supply_V)
        elif isinstance(event, ProcessorSupply):
            self.supply(board, event.processor_supply_V)
        else:
            self.fault(board, event.fault, not event.mended, event.coil)

    def board_name(self, board: int) -> str:
        """Return the name of a board for messages: "the sensor" or "beacon b3"."""
        return self.scenario.board_name(board)

    def _complaint(self, status: int) -> str:
        board = int(self._library.rig_stopped_board(self._rig))
        name = self.board_name(board)
        if status == self._library.RIG_DRIVER_TOO_FAST:
            return f"{name} switched its coil driver more often than any driver can follow, at {self.now_s:.6f} s"
        return f"{name} stopped at {self.now_s:.6f} s: {self.report(board)}"

    def unique_id(self, board: int) -> bytes:
        """Return the unique id of a board's processor, 12 bytes."""
        return self._specs[board].unique_id

    def power_on_s(self, board: int) -> float:
        """Return the virtual time at which a board got its power last, or is to get it."""
        return self._specs[board].power_on_ps * 1e-12

    def report(self, board: int) -> str:
        """Return a board's own words: why it stopped, or its violations so far."""
        operations = self._ffi.cast("board_operations_t *", self._boards[board].operations)
        text = operations.report(self._ffi.cast("board_t *", self._boards[board].instance))
        return str(self._ffi.string(text).decode(errors="replace"))

    def statistics(self, board: int) -> Mapping[str, float]:
        """Return counts that a board keeps about itself (instructions, interrupts, sleep, violations), by name."""
        return self._boards[board].statistics()

    # ---- Links ----

    @property
    def host_node(self) -> int:
        """The number of the host's adapter among the senders of `Frame.board`: one beyond the last board's."""
        return len(self._boards)

    def serial_read(self, board: int = SENSOR) -> bytes:
        """Take all bytes that a board has sent since the last call."""
        taken = []
        buffer = self._ffi.new("uint8_t[]", 1 << 16)
        while count := self._library.rig_serial_read(self._rig, board, buffer, len(buffer)):
            taken.append(bytes(self._ffi.buffer(buffer, count)))
        return b"".join(taken)

    def serial_write(self, data: bytes, board: int = SENSOR) -> None:
        """Send bytes to a board from the present on, back to back at its baud rate."""
        self._library.rig_serial_write(self._rig, board, data, len(data))

    def can_read(self) -> list[Frame]:
        """Take all frames that were on the bus since the last call (those that end soon after the present included)."""
        frames = []
        transfer = self._ffi.new("can_transfer_t *")
        while self._library.rig_can_read(self._rig, transfer):
            frame = transfer.frame
            frames.append(
                Frame(
                    time_s=transfer.end_ps * 1e-12,
                    board=transfer.node,
                    identifier=frame.id,
                    data=bytes(frame.data[0 : frame.length]),
                    extended=frame.extended,
                    remote=frame.remote,
                    acknowledged=transfer.acknowledged,
                )
            )
        return frames

    def can_write(self, identifier: int, data: bytes, *, extended: bool = True, remote: bool = False) -> None:
        """Let the host's adapter send a frame as soon as the bus is free.

        Raises
        ------
        UserError
            If the rig was made without the host on the bus, or the frame is longer than 8 bytes.
        """
        if len(data) > 8:
            raise UserError(f"a CAN frame has at most 8 bytes, not {len(data)}")
        fields = {"id": identifier, "extended": extended, "remote": remote, "length": len(data), "data": list(data)}
        if not self._library.rig_can_write(self._rig, self._ffi.new("board_frame_t *", fields)):
            raise UserError("the host's adapter is not on the rig's CAN bus")

    def can_rate(self, bit_s: int) -> None:
        """Let the bus, and the host's adapter on it, have another bit rate from now on; the boards keep theirs.

        Raises
        ------
        UserError
            If it is above 1 Mbit/s or not above 0.
        """
        if bit_s <= 0 or not self._library.rig_can_rate(self._rig, bit_s):
            raise UserError(f"a CAN bus does more than 0 and at most 1000000 bit/s, not {bit_s}")

    def can_errors(self, probability: float) -> None:
        """Let each bit on the bus be wrong with a probability from now on; the rig's seed decides which.

        Raises
        ------
        UserError
            If it is no probability below 1.
        """
        if not 0.0 <= probability < 1.0:
            raise UserError(f"the probability of a wrong bit is 0 to below 1, not {probability:g}")
        self._library.rig_can_errors(self._rig, probability, self.seed)

    def can_corrupt(self, frames: int) -> None:
        """Destroy the next frames on the bus, so many, each by a wrong bit in its middle."""
        self._library.rig_can_corrupt(self._rig, frames)

    def can_delay(self, seconds: float) -> None:
        """Let receivers have each frame later by transceivers and cable: .1 to .25 us on a short bus, 0 by default.

        Raises
        ------
        UserError
            If it is negative or above 1 us, the shortest bit.
        """
        if not 0.0 <= seconds <= 1e-6:
            raise UserError(f"a CAN bus delays a frame by 0 to 1 us, not {seconds * 1e6:g} us")
        self._library.rig_can_delay(self._rig, round(seconds * 1e12))

    def can_statistics(self) -> dict[str, int]:
        """Return the bus's counts: frames, unacknowledged, errors, collisions, busy_ps."""
        statistics = self._ffi.new("can_statistics_t *")
        self._library.rig_can_statistics(self._rig, statistics)
        return {name: int(getattr(statistics, name)) for name in CAN_COUNTS}

    # ---- What an observer sees ----

    def sync_edges_s(self) -> FloatArray:
        """Return the times of all rising edges of the sync wire so far."""
        count = int(self._library.rig_sync_edges(self._rig, 0, self._ffi.NULL, 0))
        times = self._ffi.new("int64_t[]", max(count, 1))
        self._library.rig_sync_edges(self._rig, 0, times, count)
        return np.array(list(times)[:count], dtype=np.float64) * 1e-12

    def truth(self, board: int = SENSOR) -> list[Truth]:
        """Take a sensor's truth of the cycles that ended since the last call; the wire's first edge starts cycle 0.

        The wire marks each cycle of degree 10 or 11, each second one of degree 9, ... each 32nd of degree 5 (sync.h).
        While nobody drives it the cycles go on.
        """
        self._check_sensor(board)
        return [
            truth_at(self.scenario.installed.at(middle_s).motion_of(board), cycle, middle_s, duration_s)
            for cycle, middle_s, duration_s in self.cycles(board)
        ]

    def cycles(self, board: int = SENSOR) -> list[tuple[int, float, float]]:
        """Take number, middle and duration, s, of the cycles that `truth` would tell of, but not where a sensor was."""
        cycles = 1 << max(0, 10 - self.scenario.degree)
        cycle_ps = ((1 << self.scenario.degree) - 1) * CHIP_PS
        times = self._ffi.new("int64_t[]", 1024)
        result: list[tuple[int, float, float]] = []
        while True:
            first = self._truth_edges[board]
            count = int(self._library.rig_sync_edges(self._rig, first, times, len(times)))
            available = min(count - first, len(times))
            if available < 2:
                return result
            for start, end in pairwise(times[0:available]):
                parts = cycles * max(1, round((end - start) / (cycles * cycle_ps)))
                for part in range(parts):
                    middle_s = 1e-12 * (start + (end - start) * (part + 0.5) / parts)
                    result.append((self._truth_cycles[board], middle_s, 1e-12 * (end - start) / parts))
                    self._truth_cycles[board] += 1
            self._truth_edges[board] += available - 1

    def watch_pins(self, watch: bool = True) -> None:
        """Keep every change of the boards' bridge, enable and sync outputs from now on; see `pin_changes`."""
        self._library.rig_watch_pins(self._rig, watch)

    def pin_changes(self, board: int) -> NDArray[Any]:
        """Take a board's kept pin changes: a structured array of ``time_ps, board, pin, level``."""
        layout = np.dtype([("time_ps", "i8"), ("board", "u2"), ("pin", "u1"), ("level", "?")], align=True)
        taken = []
        buffer = self._ffi.new("rig_pin_change_t[]", 4096)
        while count := self._library.rig_pin_changes(self._rig, board, buffer, len(buffer)):
            taken.append(np.frombuffer(bytes(self._ffi.buffer(buffer)), dtype=layout, count=count))
        return np.concatenate(taken) if taken else np.empty(0, dtype=layout)

    def coil_current_A(self, board: int, coil: int = 0) -> float:
        """Return the current in a beacon's coil (1: the second of a dual-axis beacon) at the present."""
        self._check_coil(board, coil)
        return float(self._library.rig_coil_current(self._rig, board, coil))

    def coil_temperature_degC(self, board: int, coil: int = 0) -> float:
        """Return the temperature of the copper of a beacon's coil at the present."""
        self._check_coil(board, coil)
        return float(self._library.rig_coil_temperature(self._rig, board, coil))

    def set_supply_V(self, board: int, volts: float) -> None:
        """Change the voltage of the supply of a beacon's coils, without load, from the present on."""
        self._check_coil(board, 0)
        self._library.rig_supply(self._rig, board, volts)

    def sensor_field_T(self, board: int = SENSOR) -> FloatArray:
        """Return the field at a board's sensor at the present, shape (3,), its frame, before its front end."""
        self._check_sensor(board)
        field = self._ffi.new("double[3]")
        self._library.rig_sensor_field(self._rig, board, field)
        return np.array(list(field))

    def fault(self, board: int, kind: str, active: bool = True, coil: int = 0) -> None:
        """Begin or end a fault of `FAULTS` at a board, or at one of its coils, at the board's present.

        A beacon's is 20 us after `now_s`, the sync master's 40 us (lockstep.h).

        Raises
        ------
        UserError
            If there is no such fault, or no such coil to have it.
        """
        if kind not in FAULTS:
            raise UserError(f"there is no fault '{kind}'; there are {', '.join(FAULTS)}")
        if kind in COIL_FAULTS:
            self._check_coil(board, coil)
        self._library.rig_fault(self._rig, board, coil, FAULTS.index(kind), active)

    def glitch(self, width_s: float, after_s: float = 0.0) -> None:
        """Strike the sync wire: all boards that are on it see it high for so long, from 40 us and a time after `now_s`.

        Raises
        ------
        UserError
            If it lasts less than 1 ns or more than 10 ms, or begins before that, or more than a second later.
        """
        if not (1e-9 <= width_s <= 0.01 and 0.0 <= after_s <= 1.0):
            raise UserError(
                f"a glitch lasts 1 ns to 10 ms and begins within 1 s, not {width_s:g} s from {after_s:g} s on"
            )
        self._library.rig_glitch(self._rig, round(after_s * 1e12), round(width_s * 1e12))

    def sensor_fault(self, axis: int, kind: str, value: float = 0.0, board: int = SENSOR) -> None:
        """Let an axis of a board's sensor fail by a name of `SENSOR_FAULTS`, or be ``sound`` again, at the present.

        ``value`` is the factor of ``gain``, the axis of ``other_axis``, or the number of the bit.
        """
        self._check_sensor(board)
        if kind not in SENSOR_FAULTS or axis not in (0, 1, 2):
            raise UserError(f"axis {axis} of 0 to 2 has no fault '{kind}'; there are {', '.join(SENSOR_FAULTS)}")
        self._library.rig_sensor_fault(self._rig, board, axis, SENSOR_FAULTS.index(kind), value)

    def surround(self, ambient: Ambient) -> None:
        """Change the fields that are no beacon's, from the present on."""
        handed = self._ffi.new("ambient_t *")
        rig_config.fill_ambient(handed, ambient, self.seed, self.scenario.sensor.lag_s)
        self._library.rig_ambient(self._rig, handed)

    def crystal(self, board: int, alive: bool) -> None:
        """Let an emulated board's crystal stop, or oscillate again, at the present.

        Raises
        ------
        UserError
            If it is no emulated board.
        """
        self._emulator(board).crystal(alive)

    def drift(self, board: int, by_ppm: float) -> None:
        """Let a host board's crystal be faster by so much from the present on, also when it is switched on again.

        Raises
        ------
        UserError
            If it is no host board, or the error leaves +-100,000 ppm.
        """
        spec, crystal = self._specs[board], self._boards[board].crystal
        if crystal is None:
            raise UserError(f"{self.board_name(board)} is no host board: it drifts by crystal_ppm_per_s of its clock")
        ppm = spec.clock.crystal_ppm + by_ppm
        if not crystal(ppm):
            raise UserError(f"the crystal of {self.board_name(board)} cannot be off by {ppm:g} ppm")
        self._specs[board] = replace(spec, clock=replace(spec.clock, crystal_ppm=ppm))

    def supply(self, board: int, volts: float) -> None:
        """Set the supply of an emulated board's chip, 3.3 V before, at the present; see `crystal`."""
        self._emulator(board).supply(volts)

    def _emulator(self, board: int) -> Emulator:
        emulator = self._boards[board].keep
        if not isinstance(emulator, Emulator):
            raise UserError(f"{self.board_name(board)} is no emulated board: it has neither a crystal nor a supply")
        return emulator

    def _check_sensor(self, board: int) -> None:
        if board not in self.sensing:
            raise UserError(f"{self.board_name(board)} has no sensor: give it a table [beacon.sensor] in the scenario")

    def _check_coil(self, board: int, coil: int) -> None:
        coils = 0 if board == SENSOR else len(self.scenario.beacons[board - 1].coils)
        if not 0 <= coil < coils:
            raise UserError(
                f"{self.board_name(board)} has {counted(coils, 'coils')}: there is no coil {coil}, counted from 0"
            )

    def power_cycle_sensor(self, off_s: float, clock: Clock | None = None) -> None:
        """Take the sensor's power, and give it back after a time; it may come back with other oscillators."""
        self.power_cycle(SENSOR, off_s, clock)

    def power_cycle(self, board: int, off_s: float, clock: Clock | None = None, **parameters: Value) -> None:
        """Take a board's power, and give it back after a time.

        It may come back with other oscillators, or flashed anew with some parameters of other values.
        """
        spec = replace(self._specs[board], power_on_ps=int(self._library.rig_now(self._rig)) + round(off_s * 1e12))
        page = spec.parameter_page
        if parameters:
            page = build_page({**parse_page(page), **parameters})
        spec = replace(spec, parameter_page=page, cells=None if parameters else self._boards[board].cells())
        self._specs[board] = spec if clock is None else replace(spec, clock=clock)
        self._boards[board].destroy()
        self._boards[board] = self._slot(board, self._specs[board])

    # ---- End ----

    def close(self) -> None:
        """End the rig and its boards; a second call does nothing."""
        if self._rig != self._ffi.NULL:
            self._library.rig_destroy(self._rig)
            self._rig = self._ffi.NULL
            for board in self._boards:
                board.destroy()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

"""One emulated board, from Python. The manual is ``emulator.h``; the board's edge is ``board_edge.h``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hil_sim import CYCLES_BY_CLASS, MOST_CYCLES, clib
from hil_sim.emulator import kept_flash
from hil_sim.emulator.elf_image import behind, read_image
from hil_sim.emulator.kept_flash import CELLS, FLASH, BadImageError

LIBRARY = "libgf_emulator.so"
PARAMETER_PAGE = 0x080E0000
PICOSECONDS = 1_000_000_000_000


@dataclass(frozen=True)
class Configuration:
    """A board's individual traits.

    Attributes
    ----------
    crystal_ppm, internal_ppm : float
        Errors of the 12 MHz crystal and of the 16 MHz internal oscillator, parts per million.
    crystal_ppm_per_K, crystal_ppm_per_s : float
        What the crystal's error grows by with temperature and with time, from virtual time 0 on.
    crystal_dead : bool
        The crystal never starts.
    unique_id : bytes
        Twelve bytes.
    temperature_degc, temperature_K_per_s : float
        Temperature of die and crystal at virtual time 0, degrees Celsius, and how fast it rises.
    dac_load_Ohm : float
        Resistance from each analog output to ground; 0: outputs are ideal (``peripherals/dac.c``).
    memory_seed : int
        What the memories hold at power-on follows it; 0: zeros. So do random numbers, beside unique id and time.
    option_bytes : int
        The option bytes as FLASH_OPTCR shows them; BOR_LEV is in bits 2 and 3.
    revision : int
        REV_ID of the silicon: 0x1000 is revision A, 0x1001 Z, 0x1003 1, 0x1007 2.
    strict : bool
        A violation (``machine.h``) stops the board; else it is only recorded.
    stop_at_fault : bool
        A fault of the processor stops the board; else its program's handler is entered. A lock-up always stops it.
    cycles_per_instruction : float
        What each instruction takes, 1 to 100, in steps of 1/256.
    cycles_by_class : bool
        Instead, costs by class of instruction, with flash and buses (``cycles.h``).
    """

    crystal_ppm: float = 0.0
    internal_ppm: float = 0.0
    crystal_ppm_per_K: float = 0.0
    crystal_ppm_per_s: float = 0.0
    crystal_dead: bool = False
    unique_id: bytes = bytes(12)
    temperature_degc: float = 25.0
    temperature_K_per_s: float = 0.0
    dac_load_Ohm: float = 0.0
    memory_seed: int = 1
    option_bytes: int = 0x0FFFAAED
    revision: int = 0x1007
    strict: bool = True
    stop_at_fault: bool = True
    cycles_per_instruction: float = 1.0
    cycles_by_class: bool = False

    @classmethod
    def with_cycles(cls, cycles: float | str, **others: Any) -> Configuration:
        """Return a configuration whose instructions take a number of cycles, or `hil_sim.CYCLES_BY_CLASS`."""
        if cycles == CYCLES_BY_CLASS:
            return cls(cycles_by_class=True, **others)
        return cls(cycles_per_instruction=float(cycles), **others)


@dataclass(frozen=True)
class Statistics:
    """Counts since reset; see ``emulator_stats_t``."""

    instructions: int
    interrupts: int
    cycles: int
    sleep_cycles: int
    flash_wait_cycles: int
    violations: int
    faults: int
    stack_low: int

    def summary(self) -> dict[str, int | float]:
        """Return the counts and the share of cycles asleep (0 to 1)."""
        return {**asdict(self), "sleep_share": self.sleep_cycles / self.cycles if self.cycles else 0.0}


@dataclass(frozen=True)
class Probe:
    """How often a function was called, its summed and largest instruction counts, and its largest count of cycles.

    Interrupts taken inside do not count.
    """

    calls: int
    total: int
    largest: int
    cycles: int


def _settings(configuration: Configuration) -> dict[str, Any]:
    """Return what the engine takes; what no board can be is refused."""
    settings = asdict(configuration)
    if len(settings["unique_id"]) != 12:
        raise ValueError(f"a unique id has 12 bytes, not {len(settings['unique_id'])}")
    if not 1.0 <= settings["cycles_per_instruction"] <= MOST_CYCLES:
        raise ValueError(f"an instruction takes 1 to {MOST_CYCLES:g} cycles, not {settings['cycles_per_instruction']}")
    return settings


class Emulator:
    """One board.

    Parameters
    ----------
    image : path
        ELF file, as flashed.
    configuration : Configuration, optional
    boot : path, optional
        ELF file of a boot loader, which starts the image; without it the image starts alone, as if one had.
    key : bytes, optional
        The public key of the boot loader, 32 bytes.
    edge : int, optional
        Address of a ``board_edge_t`` that another C library fills in; it is copied. Excludes the callbacks.
    parameter_page : bytes, optional
        Placed at 0x080E0000.
    flash : path, optional
        A file that keeps the flash from one board to the next: written by `close`. If it is there already, the sectors
        of the image are written anew, as a probe does it, and all others, the parameter page's too, are as they were.
    cells : bytes, optional
        The flash of a board that had no power (`cells`): nothing is flashed, neither image nor parameter page.
    power_on_ps : int
        When the board gets power, picoseconds of virtual time.
    uart_out : callable, optional
        ``uart_out(uart, byte, time_ps)`` for each byte that left a serial port.
    pin_out : callable, optional
        ``pin_out(pin, level, time_ps)`` for each change of an output pin.

    Attributes
    ----------
    board, operations : int
        Addresses of the ``board_t`` and of its ``board_operations_t``, for another C library.
    symbols : dict
        Addresses of the image's symbols.

    Raises
    ------
    BadImageError
        See `read_image`; or the parameter page does not fit, or the flash's file is none.
    FileNotFoundError
        The emulator's library is not built.
    """

    def __init__(
        self,
        image: str | Path,
        configuration: Configuration | None = None,
        *,
        boot: str | Path | None = None,
        key: bytes | None = None,
        edge: int | None = None,
        parameter_page: bytes | None = None,
        flash: str | Path | None = None,
        cells: bytes | None = None,
        power_on_ps: int = 0,
        uart_out: Callable[[int, int, int], None] | None = None,
        pin_out: Callable[[int, bool, int], None] | None = None,
    ) -> None:
        segments, self.symbols = read_image(image)
        segments = behind(boot, key, segments)
        if parameter_page is not None and len(parameter_page) > FLASH.stop - PARAMETER_PAGE:
            raise BadImageError(f"the parameter page has {len(parameter_page)} bytes; at most 131072 fit")
        self._kept = None if flash is None else Path(flash)
        if cells is None and self._kept is not None and self._kept.exists():
            cells = kept_flash.flashed(kept_flash.read(self._kept), segments)
        elif cells is None and parameter_page is not None:
            segments.append((PARAMETER_PAGE, parameter_page))
        self._ffi: Any
        self._library: Any
        self._ffi, self._library = clib.load_built(LIBRARY)
        ffi = self._ffi
        self._callbacks: list[Any] = []
        edge_pointer = ffi.new("board_edge_t *") if edge is None else ffi.cast("board_edge_t *", edge)
        if uart_out is not None:
            edge_pointer.uart_out = self._keep(
                "void(void *, unsigned, uint8_t, int64_t)", lambda _, uart, byte, time: uart_out(uart, byte, time)
            )
        if pin_out is not None:
            edge_pointer.pin_out = self._keep(
                "void(void *, unsigned, bool, int64_t)", lambda _, pin, level, time: pin_out(pin, bool(level), time)
            )
        self.configuration = configuration or Configuration()
        settings = _settings(self.configuration)
        config = ffi.new("emulator_config_t *", {**settings, "unique_id": list(settings["unique_id"])})
        message = ffi.new("char[]", 256)
        self._board = self._library.emulator_create(config, edge_pointer, power_on_ps, message, 256)
        if self._board == ffi.NULL:
            raise RuntimeError(f"the emulator did not start: {ffi.string(message).decode()}")
        self._operations = ffi.addressof(self._library, "emulator_operations")
        self.board = int(ffi.cast("uintptr_t", self._board))
        self.operations = int(ffi.cast("uintptr_t", self._operations))
        self._probes: list[str] = []
        self._visits = range(0)
        if cells is not None:
            self._library.emulator_cells_restore(self._board, cells)
        else:
            for address, data in segments:
                self._library.emulator_load(self._board, address, data, len(data))

    def _keep(self, signature: str, function: Callable[..., None]) -> Any:
        callback = self._ffi.callback(signature, function)
        self._callbacks.append(callback)
        return callback

    def run(self, until_ps: int) -> bool:
        """Run up to (not including) a time in picoseconds. False: the board stopped for good, see `report`."""
        return int(self._operations.run(self._board, until_ps)) == 0

    @property
    def now_ps(self) -> int:
        """Present time of the board, picoseconds."""
        return int(self._operations.now(self._board))

    def pin_in(self, pin: int, level: bool, time_ps: int) -> None:
        """Drive an input pin (port * 16 + pin) from a time on."""
        self._operations.pin_in(self._board, pin, level, time_ps)

    def uart_in(self, uart: int, byte: int, baud: int, time_ps: int) -> None:
        """Let a byte arrive at a serial port; its stop bit ends at time_ps."""
        self._operations.uart_in(self._board, uart, byte, baud, time_ps)

    def crystal(self, alive: bool, time_ps: int = 0) -> None:
        """Let the crystal stop, or oscillate again, from a time on that may be past: at once."""
        self._library.emulator_crystal(self._board, alive, time_ps)

    def noise(self, alive: bool, time_ps: int = 0) -> None:
        """Let the noise source of the random number generator stick, or be alive again, from a time on.

        The generator repeats its number until it sees that, 65 periods of its clock later: a seed error.
        """
        self._library.emulator_noise(self._board, alive, time_ps)

    def supply(self, volts: float, time_ps: int = 0) -> None:
        """Set the chip's supply from a time on; it is 3.3 V from power-on."""
        self._library.emulator_supply(self._board, volts, time_ps)

    def cut_flash(self, step: int, fraction: float, *, cut_id: int = 0, off_ps: int = 0) -> None:
        """Cut the chip's supply in a step of its flash: while it programs or erases.

        Parameters
        ----------
        step : int
            Which step from now on, 1 being the next; 0: in none any more.
        fraction : float
            How much of the step's time is over then, 0 to 1.
        cut_id : int
            What the step leaves in the cells follows it, beside the configuration's seed and the unique id.
        off_ps : int
            After how many picoseconds the supply is back; 0: it stays away.
        """
        self._library.emulator_cut_flash(self._board, step, fraction, cut_id, off_ps)

    def flash_steps(self) -> int:
        """Return how many programs and erases the flash has begun."""
        return int(self._library.emulator_flash_steps(self._board))

    def cells(self) -> bytes:
        """Return the flash, as `kept_flash` has it; a program or an erase that is going on ends as without power."""
        cells = self._ffi.new("uint8_t[]", CELLS)
        self._library.emulator_cells_save(self._board, cells)
        return bytes(cells)

    def debug_halt(self, halted: bool, time_ps: int = 0) -> None:
        """Let a debugger stop the core from a time on, or let it go on."""
        self._library.emulator_debug_halt(self._board, halted, time_ps)

    def statistics(self) -> Statistics:
        """Return the counts since reset."""
        stats = self._ffi.new("emulator_stats_t *")
        self._library.emulator_stats(self._board, stats)
        return Statistics(**{name: int(getattr(stats, name)) for name in Statistics.__dataclass_fields__})

    def report(self) -> str:
        """Say where the processor stands, why it stopped, and what violations there were."""
        return str(self._ffi.string(self._operations.report(self._board)).decode(errors="replace"))

    def probe(self, function: str) -> None:
        """Count the instructions of a function of the image, at most twelve functions.

        Raises
        ------
        KeyError
            The image has no such symbol, or there are twelve probes already.
        """
        if function not in self.symbols:
            raise KeyError(f"the image has no function '{function}'")
        if not self._library.emulator_probe_add(self._board, self.symbols[function]):
            raise KeyError(f"no probe is left for '{function}': at most twelve functions can be counted")
        self._probes.append(function)

    def probes(self) -> dict[str, Probe]:
        """Return the counts of each probed function."""
        result = {}
        for index, name in enumerate(self._probes):
            probe = self._ffi.new("emulator_probe_t *")
            self._library.emulator_probe_read(self._board, index, probe)
            result[name] = Probe(int(probe.calls), int(probe.total), int(probe.largest), int(probe.cycles))
        return result

    def register(self, index: int) -> int:
        """Return a core register; the numbers are in ``emulator.h``."""
        return int(self._library.emulator_register(self._board, index))

    def memory(self, address: int, count: int) -> bytes:
        """Return bytes of flash or RAM.

        Raises
        ------
        ValueError
            There is no memory there.
        """
        buffer = self._ffi.new("uint8_t[]", count)
        if not self._library.emulator_memory_read(self._board, address, buffer, count):
            raise ValueError(f"no memory holds {count} bytes at 0x{address:08x}")
        return bytes(buffer)

    def skip(self, address: int, nth: int = 1) -> None:
        """Skip the instruction at an address of the flash once, in its nth execution from now on (``emulator.h``).

        Raises
        ------
        ValueError
            There is no such instruction, or one that is skipped is just running.
        """
        if not self._library.emulator_skip(self._board, address, nth):
            raise ValueError(f"no instruction at 0x{address:08x} can be skipped")

    def flip(self, address: int, register: int, mask: int, nth: int = 1) -> None:
        """Flip bits of a register, r0 to r15 or the flags (16), before the nth execution of an instruction.

        Raises
        ------
        ValueError
            There is no such instruction or register, or one that is skipped is just running.
        """
        if not self._library.emulator_flip(self._board, address, nth, register, mask):
            raise ValueError(f"no bits 0x{mask:08x} of register {register} can be flipped at 0x{address:08x}")

    def struck(self) -> bool:
        """Whether the skip or flip that was asked for last has come."""
        return bool(self._library.emulator_struck(self._board))

    def flip_memory(self, address: int, mask: int) -> None:
        """Flip bits of a byte of RAM, now.

        Raises
        ------
        ValueError
            There is no RAM.
        """
        if not self._library.emulator_flip_memory(self._board, address, mask):
            raise ValueError(f"no memory is at 0x{address:08x}")

    def begin_visits(self, start: int, stop: int) -> None:
        """Note from now on when each instruction of the flash from one address to another has begun first.

        Raises
        ------
        ValueError
            These are no even addresses in their order, or there is no memory.
        """
        if not self._library.emulator_visits_begin(self._board, start, stop):
            raise ValueError(f"no visits can be noted from 0x{start:08x} to 0x{stop:08x}")
        self._visits = range(start, stop, 2)

    def visits(self) -> dict[int, int]:
        """Return when the instructions that have run began first, ps, by address."""
        times = self._ffi.new("int64_t[]", len(self._visits))
        self._library.emulator_visits(self._board, times, len(self._visits))
        return {address: time for address, time in zip(self._visits, times, strict=True) if time >= 0}

    def close(self) -> None:
        """End the board, and keep its flash if it has a file; `board` is void then.

        Raises
        ------
        BadImageError
            The file cannot be written.
        """
        if self._board is not None:
            board, kept = self._board, None if self._kept is None else self.cells()
            self._board = None
            self._operations.destroy(board)
            if self._kept is not None and kept is not None:
                kept_flash.write(self._kept, kept)

    def __enter__(self) -> Emulator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

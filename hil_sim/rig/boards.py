"""Boards for the rig: emulated ones that run the ARM image, and host boards; both with the edge of ``board_edge.h``."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from goldfield.errors import SystemFailure, UserError
from hil_sim import KINDS, clib
from hil_sim.emulator import Configuration, Emulator
from hil_sim.emulator.emulator import LIBRARY as EMULATOR_LIBRARY
from hil_sim.scenario import Clock

HOST_LIBRARY = "libgf_hostboard.so"
ONLY_EMULATED = (
    *("crystal_dead", "crystal_stops_s", "crystal_ppm_per_K", "crystal_ppm_per_s", "temperature_K_per_s"),
    *("processor_supply_V", "flash", "public_key"),
)
"""Keys of `Clock` that only an emulated board can follow."""


@dataclass(frozen=True)
class BoardSpec:
    """What a board is made from.

    Attributes
    ----------
    role : str
        ``beacon``, ``sensor``, or ``anchor``: both.
    clock : Clock
    unique_id : bytes
        Twelve bytes.
    parameter_page : bytes
        The board's parameters as they lie in flash.
    power_on_ps : int
        Virtual time at which it gets power.
    random_seed : int
        Seed of a host board's random numbers, 64 bits.
    cells : bytes, optional
        Its flash as it was when its power went (`Board.cells`); a board without is flashed.
    """

    role: str
    clock: Clock
    unique_id: bytes
    parameter_page: bytes
    power_on_ps: int
    random_seed: int = 0
    cells: bytes | None = None


@dataclass
class Board:
    """A board that exists.

    Attributes
    ----------
    instance, operations : int
        Addresses of its ``board_t`` and ``board_operations_t``.
    destroy : callable
        Ends the board; the addresses are then void.
    statistics : callable
        Counts since reset, by name; empty if the board keeps none.
    cells : callable
        Its flash, for when it has power again; None if the board has no flash of its own.
    crystal : callable, optional
        Gives its crystal another error, ppm, from the board's present on; a board without drifts by its `Clock`.
    keep : object
        Whatever must live as long as the board.
    """

    instance: int
    operations: int
    destroy: Callable[[], None]
    statistics: Callable[[], Mapping[str, float]] = dict
    cells: Callable[[], bytes | None] = lambda: None
    crystal: Callable[[float], bool] | None = None
    keep: Any = field(default=None, repr=False)


class BoardFactory(Protocol):
    """Makes the boards of a rig."""

    def __call__(self, spec: BoardSpec, edge: int) -> Board:
        """Make one board on the edge at this address (``board_edge_t *``)."""
        ...


def address(ffi: Any, pointer: Any) -> int:
    """Return a cffi pointer as a number, to hand it to another library."""
    return int(ffi.cast("uintptr_t", pointer))


class HostBoards:
    """Boards of this machine: the firmware's own sources behind the same hardware layer (``host_board.h``)."""

    def __init__(self) -> None:
        self._ffi: Any
        self._library: Any
        self._ffi, self._library = clib.load_built(HOST_LIBRARY)

    def __call__(self, spec: BoardSpec, edge: int) -> Board:
        """See `BoardFactory`; raises UserError for a clock that such a board cannot have."""
        ffi, library = self._ffi, self._library
        for key in ONLY_EMULATED:
            if getattr(spec.clock, key) != getattr(Clock(), key):
                raise UserError(f"host boards cannot simulate {key}: use --boards emulated, or remove the key")
        config = ffi.new("host_board_config_t *")
        config.role = getattr(library, f"HAL_ROLE_{spec.role.upper()}")
        config.crystal_ppm = spec.clock.crystal_ppm
        config.temperature_degc = spec.clock.temperature_degC
        config.unique_id = list(spec.unique_id)
        config.random_seed = spec.random_seed
        config.parameter_page = list(spec.parameter_page)
        instance = library.host_board_create(config, ffi.cast("board_edge_t *", edge), spec.power_on_ps)
        if instance == ffi.NULL:
            raise SystemFailure(f"the host board of the {spec.role} could not be made")
        operations = ffi.addressof(library, "host_board_operations")
        return Board(
            instance=address(ffi, instance),
            operations=address(ffi, operations),
            destroy=lambda: operations.destroy(instance),
            crystal=lambda ppm: bool(library.host_board_crystal(instance, ppm)),
        )


FLASHED = 0x0FFFAAE1
"""Option bytes of a board that a probe has programmed: brown-out level 3, a reset from 2.83 V until 2.92 V are back."""


class EmulatedBoards:
    """STM32F405s that run the images to be flashed, on the emulator, with the option bytes that come with them.

    Parameters
    ----------
    images : path, optional
        Directory with ``beacon.elf``, ``sensor.elf`` and ``anchor.elf``; by default the images that were built.
    cycles_per_instruction : float or str
        How many cycles an instruction takes, or ``m4``; see `hil_sim.emulator.Configuration.with_cycles`.
    **traits
        Fields of `hil_sim.emulator.Configuration` that all boards share, as ``dac_load_Ohm`` and ``option_bytes``.

    Raises
    ------
    FileNotFoundError
        If the images or the emulator were not built.
    """

    def __init__(
        self, images: str | Path | None = None, cycles_per_instruction: float | str = 1.0, **traits: Any
    ) -> None:
        self._cycles, self._traits = cycles_per_instruction, traits
        self._images = clib.built("firmware/sensor.elf").parent if images is None else Path(images)
        clib.load_built(EMULATOR_LIBRARY)

    def __call__(self, spec: BoardSpec, edge: int) -> Board:
        """See `BoardFactory`; raises UserError if the image, or the file of a flash, cannot be read."""
        configuration = Configuration.with_cycles(
            self._cycles,
            crystal_ppm=spec.clock.crystal_ppm,
            internal_ppm=spec.clock.internal_ppm,
            crystal_ppm_per_K=spec.clock.crystal_ppm_per_K,
            crystal_ppm_per_s=spec.clock.crystal_ppm_per_s,
            crystal_dead=spec.clock.crystal_dead,
            unique_id=spec.unique_id,
            temperature_degc=spec.clock.temperature_degC,
            temperature_K_per_s=spec.clock.temperature_K_per_s,
            stop_at_fault=False,
            **{"option_bytes": FLASHED, **self._traits},
        )
        emulator = Emulator(
            self._images / f"{spec.role}.elf",
            configuration,
            edge=edge,
            parameter_page=spec.parameter_page,
            flash=spec.clock.flash or None,
            boot=clib.built("boot/boot.elf") if spec.clock.public_key else None,
            key=bytes.fromhex(spec.clock.public_key) or None,
            cells=spec.cells,
            power_on_ps=spec.power_on_ps,
        )
        if math.isfinite(spec.clock.crystal_stops_s):
            emulator.crystal(False, round(spec.clock.crystal_stops_s * 1e12))
        if spec.clock.processor_supply_V != Clock.processor_supply_V:
            emulator.supply(spec.clock.processor_supply_V, spec.power_on_ps)
        return Board(
            instance=emulator.board,
            operations=emulator.operations,
            destroy=emulator.close,
            statistics=lambda: emulator.statistics().summary(),
            cells=emulator.cells,
            keep=emulator,
        )


def factory(kind: str, cycles_per_instruction: float | str = 1.0) -> BoardFactory:
    """Return the factory of ``emulated`` or ``host`` boards.

    Raises
    ------
    UserError
        Unknown kind, its library is not built, or host boards are asked for cycles that they do not count.
    """
    if kind not in KINDS:
        raise UserError(f"there are no boards of kind '{kind}'; there are {', '.join(KINDS)}")
    try:
        if kind == "emulated":
            return EmulatedBoards(cycles_per_instruction=cycles_per_instruction)
        if cycles_per_instruction != 1.0:
            raise UserError("host boards count no cycles: leave out --cycles-per-instruction, or use --boards emulated")
        return HostBoards()
    except FileNotFoundError as error:
        raise UserError(str(error)) from error

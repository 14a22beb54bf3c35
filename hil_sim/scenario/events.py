"""What happens to a bench while it runs: a beacon is moved, metal or noise comes, a supply sags, something breaks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.files.toml_table import Table
from hil_sim.scenario.bodies import SHEET_KEYS, read_sheet
from hil_sim.scenario.parts import PROCESSOR_SUPPLY_V, Ambient
from hil_sim.scenario.surroundings import read_ambient
from hil_sim.scenario.values import between, number
from hil_sim.world.sheet import Sheet

EVENT_KEYS = (
    *("time_s", "moves", "by_m", "sensor_stays", "sheet", "beacon", "supply_V", "processor_supply_V", "fault"),
    *("coil", "mended", "sensor_fault", "axis", "value", "ambient"),
)
HIGHEST_PROCESSOR_SUPPLY_V = 4.0
"""Absolute maximum rating of the processor's supply (data sheet DS8626, table 11)."""
COIL_FAULTS = (
    *("coil_open", "sense_shorted", "coil_shorted", "driver_runaway", "driver_stuck", "sense_held", "coil_hot"),
    *("bridge_swapped", "coil_reversed"),
)
"""Faults of one coil with its driver and its current sense."""
SENSOR_FAULTS = ("sound", "held", "low", "high", "gain", "other_axis", "bit_high", "bit_low")
"""Faults of an axis of a sensor, in the order of ``front_end_fault_t``."""
VALUES = {"gain": (-100.0, 100.0), "other_axis": (0.0, 2.0), "bit_high": (0.0, 11.0), "bit_low": (0.0, 11.0)}
"""The faults of a sensor that have a value, and its range."""
BOARD_FAULTS = ("driver", "sync_wire_cut", "driver_hot", "pull_downs_lost")
"""Faults of a beacon's board as a whole."""


@dataclass(frozen=True, eq=False)
class Move:
    """A beacon is moved at a moment, without turning.

    Attributes
    ----------
    time_s : float
        Virtual time.
    beacon : str
        Its id.
    by_m : ndarray, shape (3,)
    sensor_stays : bool
        Whether only the coil of an anchor moves, and its sensor stays.
    """

    time_s: float
    beacon: str
    by_m: NDArray[np.float64]
    sensor_stays: bool = False


@dataclass(frozen=True, eq=False)
class Bring:
    """A sheet of metal is there from a virtual time on."""

    time_s: float
    sheet: Sheet


@dataclass(frozen=True)
class Supply:
    """The voltage of the supply of a beacon's coils changes."""

    time_s: float
    beacon: str
    supply_V: float


@dataclass(frozen=True)
class Strike:
    """Something of a beacon breaks, a name of `COIL_FAULTS` or `BOARD_FAULTS`, or is mended."""

    time_s: float
    beacon: str
    fault: str
    coil: int = 0
    mended: bool = False


@dataclass(frozen=True)
class ProcessorSupply:
    """The voltage of the supply of a beacon's processor changes (emulated boards)."""

    time_s: float
    beacon: str
    processor_supply_V: float


@dataclass(frozen=True)
class SensorFault:
    """An axis of a sensor fails, by a name of `SENSOR_FAULTS`, or is ``sound`` again.

    Attributes
    ----------
    time_s : float
        Virtual time.
    beacon : str
        Id of an anchor; empty: the sensor board.
    axis : int
        0 to 2.
    fault : str
    value : float
        The factor of ``gain``, the number of ``other_axis``, or that of the bit.
    """

    time_s: float
    beacon: str
    axis: int
    fault: str
    value: float = 0.0


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The fields that are no beacon's are others from a virtual time on."""

    time_s: float
    ambient: Ambient


Electrical = Supply | ProcessorSupply | Strike | SensorFault | Surroundings
Event = Move | Bring | Electrical


def processor_supply(table: Table) -> float:
    """Return the supply of a processor that a table gives, or the nominal one, V."""
    volts = number(table, "processor_supply_V", PROCESSOR_SUPPLY_V)
    if not 0.0 <= volts <= HIGHEST_PROCESSOR_SUPPLY_V:
        raise table.error("processor_supply_V", f"is {volts:g}; it must lie in 0 to {HIGHEST_PROCESSOR_SUPPLY_V:g}")
    return volts


def read_events(root: Table) -> tuple[Event, ...]:
    """Return what the tables [[event]] of a scenario file tell; there may be none.

    Raises
    ------
    UserError
        One sentence with file, line, table and key.
    """
    if "event" not in root:
        return ()
    beacons = [table.text("id") for table in root.tables("beacon")]
    return tuple(_event(table, beacons) for table in root.tables("event"))


def _event(table: Table, beacons: list[str]) -> Event:
    table.allow(*EVENT_KEYS)
    time_s = table.number("time_s")
    if time_s < 0.0:
        raise table.error("time_s", f"is {time_s:g}; it must not be negative")
    if "sheet" in table:
        if "moves" in table:
            raise table.error("sheet", "and moves are both given: give each an [[event]] of its own")
        table.allow("time_s", "sheet")
        inner = table.table("sheet")
        inner.allow(*SHEET_KEYS)
        return Bring(time_s, read_sheet(inner))
    if "ambient" in table:
        table.allow("time_s", "ambient")
        return Surroundings(time_s, read_ambient(table.table("ambient")))
    if "sensor_fault" in table:
        return _sensor_fault(table, time_s, beacons)
    if "beacon" in table:
        return _electrical(table, time_s, beacons)
    if "moves" not in table:
        raise table.error("moves", "is missing; give it, or sheet, beacon, sensor_fault or ambient")
    table.allow("time_s", "moves", "by_m", "sensor_stays")
    beacon = _known(table, "moves", beacons)
    return Move(time_s, beacon, table.vector("by_m"), "sensor_stays" in table and table.flag("sensor_stays"))


def _known(table: Table, key: str, beacons: list[str]) -> str:
    beacon = table.text(key)
    if beacon not in beacons:
        raise table.error(key, f'is "{beacon}"; the beacons are {", ".join(beacons)}')
    return beacon


def _electrical(table: Table, time_s: float, beacons: list[str]) -> Electrical:
    beacon = _known(table, "beacon", beacons)
    if "processor_supply_V" in table:
        table.allow("time_s", "beacon", "processor_supply_V")
        return ProcessorSupply(time_s, beacon, processor_supply(table))
    if "supply_V" in table:
        table.allow("time_s", "beacon", "supply_V")
        return Supply(time_s, beacon, table.positive("supply_V"))
    if "fault" not in table:
        raise table.error("fault", "is missing; give it, or supply_V, or processor_supply_V")
    fault = table.text("fault")
    if fault not in COIL_FAULTS + BOARD_FAULTS:
        raise table.error("fault", f'is "{fault}"; there are {", ".join(COIL_FAULTS + BOARD_FAULTS)}')
    of_coil = ("coil",) if fault in COIL_FAULTS else ()
    table.allow("time_s", "beacon", "fault", "mended", *of_coil)
    coil = between(table, "coil", 0, 1) if "coil" in table else 0
    return Strike(time_s, beacon, fault, coil, "mended" in table and table.flag("mended"))


def _sensor_fault(table: Table, time_s: float, beacons: list[str]) -> SensorFault:
    fault = table.text("sensor_fault")
    if fault not in SENSOR_FAULTS:
        raise table.error("sensor_fault", f'is "{fault}"; there are {", ".join(SENSOR_FAULTS)}')
    table.allow("time_s", "sensor_fault", "beacon", "axis", *(["value"] if fault in VALUES else []))
    value = table.number("value") if fault in VALUES else 0.0
    low, high = VALUES.get(fault, (0.0, 0.0))
    if not low <= value <= high or (fault != "gain" and value % 1.0):
        whole = "" if fault == "gain" else "a whole number of "
        raise table.error("value", f"is {value:g}; for {fault} it must be {whole}{low:g} to {high:g}")
    beacon = _known(table, "beacon", beacons) if "beacon" in table else ""
    return SensorFault(time_s, beacon, between(table, "axis", 0, 2), fault, value)

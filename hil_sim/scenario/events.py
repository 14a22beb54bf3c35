"""What happens to a bench while it runs, which no site file knows: a beacon is moved, metal is brought in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.files.toml_table import Table
from hil_sim.scenario.bodies import SHEET_KEYS, read_sheet
from hil_sim.world.sheet import Sheet

EVENT_KEYS = ("time_s", "moves", "by_m", "sensor_stays", "sheet")


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


Event = Move | Bring


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
    if "moves" not in table:
        raise table.error("moves", "is missing; give it, or sheet")
    beacon = table.text("moves")
    if beacon not in beacons:
        raise table.error("moves", f'is "{beacon}"; the beacons are {", ".join(beacons)}')
    return Move(time_s, beacon, table.vector("by_m"), "sensor_stays" in table and table.flag("sensor_stays"))

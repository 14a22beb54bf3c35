"""Reading the fields that are no beacon's: [ambient] and [[magnet]]."""

from __future__ import annotations

import math

from goldfield.files.toml_table import Table
from hil_sim.scenario.parts import Ambient, Impulses, Mains
from hil_sim.scenario.values import not_negative, number, vector
from hil_sim.world.magnet import Magnet

HARMONICS = 16
"""Most harmonics, ``AMBIENT_HARMONICS``."""
MAGNET_KEYS = ("moment_A_m2", "position_m", "velocity_m_per_s", "start_s", "stop_s")


def read_ambient(table: Table) -> Ambient:
    """Return the fields of a table [ambient]; what it leaves out is not there."""
    table.allow("earth_T", "mains", "impulses")
    mains, impulses = None, Impulses()
    if "mains" in table:
        inner = table.table("mains")
        inner.allow("frequency_Hz", "amplitude_T", "harmonics", "phase_rad")
        harmonics = tuple(inner.numbers("harmonics").tolist()) if "harmonics" in inner else (1.0,)
        if len(harmonics) > HARMONICS:
            raise inner.error("harmonics", f"lists {len(harmonics)}; at most {HARMONICS} are possible")
        mains = Mains(
            frequency_Hz=inner.positive("frequency_Hz"),
            amplitude_T=inner.vector("amplitude_T"),
            harmonics=harmonics,
            phase_rad=number(inner, "phase_rad", 0.0),
        )
    if "impulses" in table:
        inner = table.table("impulses")
        inner.allow("rate_Hz", "amplitude_T", "decay_s")
        impulses = Impulses(
            rate_Hz=not_negative(inner, "rate_Hz", 0.0),
            amplitude_T=inner.number("amplitude_T"),
            decay_s=inner.positive("decay_s") if "decay_s" in inner else Impulses.decay_s,
        )
    return Ambient(earth_T=vector(table, "earth_T"), mains=mains, impulses=impulses)


def read_magnets(root: Table) -> tuple[Magnet, ...]:
    """Return the magnets that the tables [[magnet]] of a scenario file tell; there may be none.

    Raises
    ------
    UserError
        One sentence with file, line, table and key.
    """
    return tuple(_magnet(table) for table in root.tables("magnet")) if "magnet" in root else ()


def _magnet(table: Table) -> Magnet:
    table.allow(*MAGNET_KEYS)
    start_s, stop_s = not_negative(table, "start_s", 0.0), number(table, "stop_s", math.inf)
    if stop_s <= start_s:
        raise table.error("stop_s", f"is {stop_s:g}; it must be later than start_s, {start_s:g}")
    return Magnet(
        moment_A_m2=table.vector("moment_A_m2"),
        position_m=table.vector("position_m"),
        velocity_m_per_s=vector(table, "velocity_m_per_s"),
        start_s=start_s,
        stop_s=stop_s,
    )

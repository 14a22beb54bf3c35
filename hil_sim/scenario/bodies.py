"""Reading what lies in the room, and how well it was installed: [[metal]] and [installation]."""

from __future__ import annotations

from goldfield.files.toml_table import Table
from hil_sim.scenario.installation import INSTALLATION_KEYS, Installation
from hil_sim.scenario.values import deviation, seed_of
from hil_sim.world.ball import MATERIALS, Ball
from hil_sim.world.metal import Body
from hil_sim.world.sheet import Sheet

SHEET_KEYS = ("centre_m", "normal", "side_m")
BALL_KEYS = ("centre_m", "radius_m", "material")
METAL_KEYS = {"sheet": SHEET_KEYS, "ball": BALL_KEYS}

LIMITS = {"position_sd_m": 1.0, "sensor_offset_sd_T": 1.0}
"""What a standard deviation must be below; 0.5 for the others, as in a site file."""


def read_sheet(table: Table) -> Sheet:
    """Return the sheet that a table describes."""
    return Sheet(table.vector("centre_m"), table.direction("normal"), table.positive("side_m"))


def read_metal(root: Table) -> tuple[Body, ...]:
    """Return the metal that the tables [[metal]] of a scenario file tell; there may be none.

    Raises
    ------
    UserError
        One sentence with file, line, table and key.
    """
    return tuple(_body(table) for table in root.tables("metal")) if "metal" in root else ()


def _body(table: Table) -> Body:
    shape = table.text("shape")
    if shape not in METAL_KEYS:
        raise table.error("shape", f'is "{shape}"; it must be one of {", ".join(METAL_KEYS)}')
    table.allow("shape", *METAL_KEYS[shape])
    if shape == "sheet":
        return read_sheet(table)
    material = table.text("material") if "material" in table else MATERIALS[0]
    if material not in MATERIALS:
        raise table.error("material", f'is "{material}"; it must be one of {", ".join(MATERIALS)}')
    return Ball(table.vector("centre_m"), table.positive("radius_m"), material)


def read_installation(root: Table, seed: int) -> Installation:
    """Return how exactly the bench was installed; without the table [installation] it was exactly.

    Parameters
    ----------
    root : Table
        The scenario.
    seed : int
        That of the errors if they have none of their own.
    """
    if "installation" not in root:
        return Installation(seed)
    table = root.table("installation")
    table.allow(*INSTALLATION_KEYS)
    deviations = {key: deviation(table, key, LIMITS.get(key, 0.5)) for key in INSTALLATION_KEYS if key != "seed"}
    return Installation(seed_of(table, seed), **deviations)

"""Reading and checking scenario files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import UserError
from goldfield.files.toml_table import Table, read_table
from goldfield.site.drive import DEGREES, Code, Plan, read_drive
from goldfield_protocol.image import KEY_BYTES
from goldfield_protocol.parameters import PARAMETERS, ParameterError
from goldfield_protocol.rates import CAN_RATES, SERIAL_RATES
from hil_sim.scenario.bodies import read_installation, read_metal
from hil_sim.scenario.events import processor_supply, read_events
from hil_sim.scenario.motions import read_motion
from hil_sim.scenario.pages import parameter_page
from hil_sim.scenario.parts import (
    CHIP_PERIOD_S,
    CLEAN_BUS,
    DEGREE,
    FASTEST,
    Ambient,
    Anchor,
    Beacon,
    CanBus,
    Circuit,
    Clock,
    HalfSpace,
    Impulses,
    Links,
    Sensor,
)
from hil_sim.scenario.scenario import Scenario
from hil_sim.scenario.surroundings import read_ambient, read_magnets
from hil_sim.scenario.values import ZERO, between, not_negative, number, seed_of, vector
from hil_sim.world.path import CoilGeometry

FloatArray = NDArray[np.float64]

LONGEST_NAME = 250
"""Letters: the system refuses to look for a file of a longer name."""
SCENARIOS = Path(__file__).parents[1] / "scenarios"
AMPLITUDE, NODE, SYNC_MASTER = (PARAMETERS[name] for name in ("amplitude", "node", "sync_master"))
CODES_MAX = PARAMETERS["codes"].rows
"""Superposed codes of a beacon, a limit of the boards."""
SQUARE_TOLERANCE = 1e-3
"""Cosine of the angle between crossed coils that still counts as none: coils that lean more would couple."""


def find(name: str) -> Path:
    """Return the file of a scenario given by its name in ``scenarios`` or by a path.

    Raises
    ------
    UserError
        If there is none.
    """
    if Path(name).suffix == ".toml" or (len(name) <= LONGEST_NAME and Path(name).is_file()):
        return Path(name)
    path = SCENARIOS / f"{name[:LONGEST_NAME]}.toml"
    if len(name) > LONGEST_NAME or not path.is_file():
        known = ", ".join(sorted(file.stem for file in SCENARIOS.glob("*.toml")))
        raise UserError(f"there is no scenario '{name}'; there are {known}; or give the path of a .toml file")
    return path


def load_scenario(name: str, seed: int | None = None) -> Scenario:
    """Read the scenario of a name or a path; see `find` and `load`."""
    return load(find(name), seed)


def load(path: str | Path, seed: int | None = None) -> Scenario:
    """Read and check a scenario file.

    Parameters
    ----------
    path : str or Path
    seed : int, optional
        In place of the file's, which is also that of walk and installation where they have none of their own.

    Raises
    ------
    UserError
        One sentence with file, line, table and key, if anything is missing, unknown, of the wrong type or out of range.
    """
    path = Path(path)
    root = read_table(path, "scenario")
    root.allow(
        *("name", "seed", "degree", "power_on_spread_s", "slots", "sync", "half_space", "ambient", "sensor", "motion"),
        *("coil", "beacon", "event", "metal", "magnet", "installation", "known_point", "can", "links", "shared_codes"),
    )
    sync = root.text("sync") if "sync" in root else "wire"
    if sync not in ("wire", "can", "automatic"):
        raise root.error("sync", f'is "{sync}"; it must be "wire", "can" or "automatic"')
    coil = root.table("coil") if "coil" in root else Table({}, path=path, lines=())
    coil.allow(*COIL_KEYS)
    own_seed = seed_of(root)
    seed = own_seed if seed is None else seed
    degree = root.integer("degree") if "degree" in root else DEGREE
    if degree not in DEGREES:
        raise root.error("degree", f"is {degree}; codes exist for {', '.join(map(str, DEGREES))}")
    plan = Plan("cdma", degree, CHIP_PERIOD_S)
    sensor = _sensor(root.table("sensor"))
    defaults = Defaults(coil, root.table("sensor"), plan)
    installation = read_installation(root, seed)
    motion, visits = read_motion(root, seed, plan.chips * CHIP_PERIOD_S)
    scenario = Scenario(
        name=root.text("name"),
        seed=seed,
        power_on_spread_s=not_negative(root, "power_on_spread_s", 0.02),
        half_space=_half_space(root.table("half_space")) if "half_space" in root else None,
        ambient=read_ambient(root.table("ambient")) if "ambient" in root else Ambient(ZERO, None, Impulses()),
        sensor=sensor,
        motion=motion,
        beacons=tuple(_beacon(table, defaults) for table in root.tables("beacon")),
        slots=between(root, "slots", 1, plan.chips) if "slots" in root else 0,
        degree=degree,
        sync=sync,
        shared_codes=root.flag("shared_codes") if "shared_codes" in root else False,
        events=read_events(root),
        metal=read_metal(root),
        magnets=read_magnets(root),
        installation=installation,
        visits=visits,
        can=_can(root.table("can")) if "can" in root else CLEAN_BUS,
        links=_links(root.table("links")) if "links" in root else FASTEST,
    )
    _check_boards(root, scenario)
    return scenario


# ---- Tables ----

CLOCK_KEYS = tuple(field.name for field in fields(Clock))
CAN_KEYS = tuple(field.name for field in fields(CanBus))
LINKS_RATES = {"can_bit_s": CAN_RATES, "serial_baud": SERIAL_RATES}
LONGEST_DELAY_S = 1e-6
CIRCUIT_KEYS = tuple(field.name for field in fields(Circuit))
COIL_KEYS = (*CIRCUIT_KEYS, "turns", "radius_m", "axis")
CIRCUIT_NOT_NEGATIVE = (
    *("source_Ohm", "dead_time_s", "driver_delay_s", "driver_limit_A"),
    *("thermal_resistance_K_per_W", "heat_capacity_J_per_K"),
    *("shorted_fraction", "shorted_coupling"),
)
CIRCUIT_REQUIRED = ("current_A", "inductance_H", "resistance_Ohm", "supply_V")
FRONT_END_KEYS = (
    *("noise_T", "converter_noise_LSB", "range_T", "gain_error", "misalignment_rad", "offset_T", "calibration"),
)
SENSOR_KEYS = ("node", "bandwidth_Hz", "stream", "pose", "sync_wire", *FRONT_END_KEYS, *CLOCK_KEYS)
ANCHOR_KEYS = ("position_m", "rotation_vector_rad", *FRONT_END_KEYS)
BEACON_KEYS = (
    *("id", "node", "code", "codes", "slot", "periods", "rotating_periods", "second_axis"),
    *("sync_master", "sync_rank", "position_m", "points_m", "sensor", *COIL_KEYS, *CLOCK_KEYS),
)


@dataclass(frozen=True)
class Defaults:
    """Where a beacon's values come from if it does not give them."""

    coil: Table
    sensor: Table
    plan: Plan


def _source(table: Table, defaults: Table) -> Callable[[str], Table]:
    """Return what tells the table of a key: the defaults' only if the table has none and they have."""

    def source(key: str) -> Table:
        return defaults if key not in table and key in defaults else table

    return source


def _clock(table: Table) -> Clock:
    internal = number(table, "internal_ppm", 0.0)
    crystal = number(table, "crystal_ppm", 0.0)
    rates = {key: number(table, key, 0.0) for key in ("crystal_ppm_per_K", "crystal_ppm_per_s", "temperature_K_per_s")}
    limits = {"crystal_ppm_per_K": 100.0, "crystal_ppm_per_s": 100.0, "temperature_K_per_s": 10.0}
    checked = {"crystal_ppm": (crystal, 5e3), "internal_ppm": (internal, 5e4)}
    checked |= {key: (value, limits[key]) for key, value in rates.items()}
    for key, (value, limit) in checked.items():
        if abs(value) > limit:
            raise table.error(key, f"is {value:g}; it must lie within +-{limit:g}")
    stops = number(table, "crystal_stops_s", math.inf)
    if stops < 0.0:
        raise table.error("crystal_stops_s", f"is {stops:g}; it must not be negative")
    return Clock(
        crystal_ppm=crystal,
        internal_ppm=internal,
        crystal_dead="crystal_dead" in table and table.flag("crystal_dead"),
        crystal_stops_s=stops,
        temperature_degC=number(table, "temperature_degC", 25.0),
        processor_supply_V=processor_supply(table),
        flash=table.text("flash") if "flash" in table else "",
        public_key=_public_key(table) if "public_key" in table else "",
        **rates,
    )


def _public_key(table: Table) -> str:
    text = table.text("public_key")
    if re.fullmatch(f"[0-9a-fA-F]{{{2 * KEY_BYTES}}}", text) is None:
        raise table.error(
            "public_key", f"is {text!r}; it must have {2 * KEY_BYTES} hexadecimal digits, as goldfield keys show prints"
        )
    return text


def _can(table: Table) -> CanBus:
    table.allow(*CAN_KEYS)
    probability = not_negative(table, "bit_error_probability", 0.0)
    if probability >= 1.0:
        raise table.error("bit_error_probability", f"is {probability:g}; it must be below 1")
    delay_s = not_negative(table, "delay_s", 0.0)
    if delay_s > LONGEST_DELAY_S:
        raise table.error("delay_s", f"is {delay_s:g}; it must not be above {LONGEST_DELAY_S:g}, a bit")
    return CanBus(probability, delay_s)


def _links(table: Table) -> Links:
    table.allow(*LINKS_RATES)
    given = {key: _rate(table, key, rates) for key, rates in LINKS_RATES.items() if key in table}
    return replace(FASTEST, **given)


def _rate(table: Table, key: str, rates: tuple[int, ...]) -> int:
    rate = table.integer(key)
    if rate not in rates:
        raise table.error(key, f"is {rate}; the boards do {', '.join(map(str, rates))}")
    return rate


def _half_space(table: Table) -> HalfSpace:
    table.allow("point", "normal")
    return HalfSpace(point=table.vector("point"), normal=table.direction("normal"))


def _front_end(table: Table, defaults: Table) -> dict[str, Any]:
    """Return the fields of a `FrontEnd`; the bandwidth is the sensor board's for all, as the coils' lag is one."""
    source = _source(table, defaults)
    calibration = source("calibration").text("calibration") if "calibration" in source("calibration") else "exact"
    if calibration not in ("exact", "nominal"):
        raise source("calibration").error("calibration", f'is "{calibration}"; it must be "exact" or "nominal"')
    return {
        "noise_T": not_negative(source("noise_T"), "noise_T", 0.0),
        "converter_noise_LSB": not_negative(source("converter_noise_LSB"), "converter_noise_LSB", 0.5),
        "bandwidth_Hz": not_negative(defaults, "bandwidth_Hz", 0.0),
        "range_T": source("range_T").positive("range_T"),
        "gain_error": vector(source("gain_error"), "gain_error"),
        "misalignment_rad": vector(source("misalignment_rad"), "misalignment_rad"),
        "offset_T": vector(source("offset_T"), "offset_T"),
        "calibration": calibration,
    }


def _sensor(table: Table) -> Sensor:
    table.allow(*SENSOR_KEYS)
    return Sensor(
        **_front_end(table, table),
        node=between(table, "node", int(NODE.low), int(NODE.high)),
        clock=_clock(table),
        stream=between(table, "stream", 0, 1) if "stream" in table else 0,
        sync_wire=table.flag("sync_wire") if "sync_wire" in table else True,
        pose=between(table, "pose", 0, 1) if "pose" in table else 1,
    )


def _anchor(table: Table, defaults: Table) -> Anchor:
    table.allow(*ANCHOR_KEYS)
    return Anchor(
        **_front_end(table, defaults),
        position_m=table.vector("position_m"),
        rotation_vector_rad=vector(table, "rotation_vector_rad"),
    )


def _beacon(table: Table, defaults: Defaults) -> Beacon:
    table.allow(*BEACON_KEYS)
    plan, source = defaults.plan, _source(table, defaults.coil)
    values = {key: source(key).number(key) for key in CIRCUIT_KEYS if key in source(key) or key in CIRCUIT_REQUIRED}
    for key in ("inductance_H", "resistance_Ohm", "supply_V"):
        if values[key] <= 0.0:
            raise source(key).error(key, f"is {values[key]:g}; it must be greater than zero")
    for key in CIRCUIT_NOT_NEGATIVE:
        if values.get(key, 0.0) < 0.0:
            raise source(key).error(key, f"is {values[key]:g}; it must not be negative")
    if values.get("shorted_fraction", 0.0) >= 1.0:
        raise source("shorted_fraction").error("shorted_fraction", "is 1 or more; some turns must be left")
    if not 0.0 < values.get("shorted_coupling", 0.5) < 1.0:
        raise source("shorted_coupling").error(
            "shorted_coupling", f"is {values['shorted_coupling']:g}; it must be between 0 and 1"
        )
    if values.get("thermal_resistance_K_per_W", 0.0) > 0.0 and values.get("heat_capacity_J_per_K", 0.0) == 0.0:
        raise source("thermal_resistance_K_per_W").error(
            "thermal_resistance_K_per_W", "needs a heat_capacity_J_per_K above 0: without one the coil has no time"
        )
    if not AMPLITUDE.low <= values["current_A"] <= AMPLITUDE.high:
        limits = f"the boards drive {AMPLITUDE.low:g} to {AMPLITUDE.high:g} A"
        raise source("current_A").error("current_A", f"is {values['current_A']:g}; {limits}")
    given = [key for key in ("codes", "slot", "periods", "rotating_periods") if key in table]
    if not given and "code" not in table:
        raise table.error("code", "is missing; give one, or codes, slot, periods or rotating_periods")
    if len(given) > 1:
        raise table.error(given[0], f"and {given[1]} are both given: a beacon drives one of them")
    geometry = _geometry(table, source)
    highest = (plan.chips - 1) // 2
    master = "sync_master" in table and table.flag("sync_master")
    if master and "sync_rank" in table:
        raise table.error("sync_rank", "and sync_master are both given: the sync master has rank 1")
    rank = between(table, "sync_rank", 2, int(SYNC_MASTER.high)) if "sync_rank" in table else int(master)
    return Beacon(
        id=table.label("id"),
        node=between(table, "node", int(NODE.low), int(NODE.high)),
        code=between(table, "code", 0, 1 << plan.degree) if "code" in table else None,
        sync_master=master,
        sync_rank=rank,
        clock=_clock(table),
        circuit=Circuit(**values),
        geometry=geometry,
        slot=between(table, "slot", 0, plan.chips - 1) if "slot" in table else None,
        periods=between(table, "periods", 1, highest) if "periods" in table else None,
        rotating_periods=between(table, "rotating_periods", 1, highest) if "rotating_periods" in table else None,
        second_coil=_second_coil(table, geometry),
        codes=_codes(table, plan) if "codes" in table else (),
        sensor=_anchor(table.table("sensor"), defaults.sensor) if "sensor" in table else None,
    )


def _codes(table: Table, plan: Plan) -> tuple[Code, ...]:
    codes = read_drive(table, plan)[1].codes
    if len(codes) > CODES_MAX:
        raise table.error("codes", f"lists {len(codes)} codes; a board superposes at most {CODES_MAX}")
    for code in codes:
        lasts = code.hold * ((1 << code.degree) - 1)
        if plan.chips % lasts:
            raise table.error("codes", f"has a code that lasts {lasts} chips: a cycle of {plan.chips} is no multiple")
    return codes


def _second_coil(table: Table, first: CoilGeometry) -> CoilGeometry | None:
    """Return the sine coil of a dual-axis beacon: the same as the first around another axis."""
    if ("second_axis" in table) != ("rotating_periods" in table):
        raise table.error("second_axis", "and rotating_periods belong together: give both or none")
    if "second_axis" not in table:
        return None
    axis = table.direction("second_axis")
    if first.points_m is not None:
        raise table.error("points_m", "gives one coil, and second_axis needs two circular ones: give radius_m")
    if abs(float(axis @ first.axis)) > SQUARE_TOLERANCE:
        raise table.error("second_axis", "is not at right angles to axis: the two coils would couple")
    return replace(first, axis=axis)


def _geometry(table: Table, source: Callable[[str], Table]) -> CoilGeometry:
    if "points_m" in table:
        if "radius_m" in table:
            raise table.error("points_m", "and radius_m are both given: give one of them")
        points = table.vectors("points_m")
        area = 0.5 * np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
        if len(points) < 3 or not np.any(area):
            raise table.error("points_m", "encloses no area: give at least three points that are not on a line")
        return CoilGeometry(
            turns=table.positive("turns") if "turns" in table else 1.0,
            radius_m=None,
            position_m=table.vector("position_m") if "position_m" in table else points.mean(axis=0),
            axis=area / np.linalg.norm(area),
            points_m=points,
        )
    return CoilGeometry(
        turns=source("turns").positive("turns"),
        radius_m=source("radius_m").positive("radius_m"),
        position_m=table.vector("position_m"),
        axis=source("axis").direction("axis"),
    )


def _check_boards(root: Table, scenario: Scenario) -> None:
    tables = root.tables("beacon")
    masters = [beacon.id for beacon in scenario.beacons if beacon.sync_master]
    if len(masters) != 1:
        found = f"{', '.join(masters)} have" if masters else "none has"
        raise root.error("beacon", f"tables: exactly one must have sync_master = true; {found}")
    taken: dict[tuple[str, Any], str] = {
        (key, value): "the sensor"
        for key, value in (("node", scenario.sensor.node), ("flash", scenario.sensor.clock.flash))
    }
    for table, beacon in zip(tables, scenario.beacons, strict=True):
        if beacon.slot is not None and beacon.slot >= scenario.slots:
            raise table.error("slot", f"is {beacon.slot}; it must be below the scenario's slots ({scenario.slots})")
        if beacon.access != scenario.beacons[0].access:
            raise table.error(
                "id", "is driven otherwise than the first beacon: all need codes, or slots, or periods, or turn"
            )
        flash = beacon.clock.flash or None
        for key, value in {"id": beacon.id, "node": beacon.node, "code": beacon.code, "flash": flash}.items():
            if value is None or (key == "code" and scenario.shared_codes):
                continue
            if (key, value) in taken:
                but = ", or set shared_codes = true" if key == "code" else ""
                raise table.error(key, f"is {value!r}, which {taken[key, value]} already has: take another{but}")
            taken[key, value] = f"beacon {beacon.id}"
    if scenario.sensor.pose and any(beacon.plain_code is None for beacon in scenario.beacons):
        raise root.table("sensor").error("pose", "is 1, but the board can tell apart plain codes alone: set pose = 0")
    if scenario.sensor.pose and scenario.shared_codes:
        raise root.table("sensor").error("pose", "is 1, but the board needs a code for each beacon: set pose = 0")
    try:
        for board in range(len(scenario.beacons) + 1):
            parameter_page(scenario, board)
    except ParameterError as error:
        raise root.error(
            "sensor" if board == 0 else "beacon", f"does not fit the boards' parameters: {error}"
        ) from error

"""The site file: a site as TOML; see `load` for the keys.

Every value is checked once, when the file is read, so that nothing behind this module needs to.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from goldfield.errors import counted
from goldfield.files.toml_table import Table, read_table
from goldfield.site.board_keys import BOARD_KEYS, check_boards, read_beacon_board
from goldfield.site.coil_shapes import SHAPE_KEYS, placed, wire_of
from goldfield.site.drive import NO_CODE, SITE_KEYS, Plan, read_drive, read_plan
from goldfield.site.metal import Metal
from goldfield.site.metal_keys import BEACON_KEY, check_bodies, read_beacon_metal, read_metal
from goldfield.site.model import (
    ALERT_LIMIT_M,
    AMBIENT_GRADIENT_T_M,
    USUAL_HUM_HZ,
    Beacon,
    HalfSpace,
    SensorSite,
    Site,
    Survey,
    area_vector,
)
from goldfield.site.plausible import check_extent, check_place, checked
from goldfield.types import FloatArray


def load(path: str | Path) -> Site:
    """Read and check a site file.

    The table ``[site]`` says what all beacons have in common:

    - ``name``: text;
    - ``chip_period_s``: duration of a chip, above 0;
    - ``degree``: degree of the Gold codes, 5, 6, 7, 9, 10 or 11: a cycle has 2^degree - 1 chips;
    - ``access``: how beacons are told apart: ``"cdma"``, codes (the default), ``"tdma"``, slots, or ``"fdma"``, tones;
    - ``slots``: only for tdma, and needed there: the number of time slots in a cycle, 1 to the number of its chips;
    - ``tone``: only for fdma: ``"sine"`` (the default) or ``"square"``;
    - ``phase``: only for fdma: ``"known"`` (the default) or ``"unknown"`` (`goldfield.access.tones`); ``samples``, how
      many make a window, may then stand in place of ``degree``;
    - ``half_space``: optional, ``{point = [x, y, z], normal = [x, y, z]}``: the sensor is on the normal's side;
    - ``shared_codes``, for cdma, ``alert_limit_m`` and ``ambient_gradient_T_m``, above 0: optional, see `Site`.

    The table ``[sensor]`` describes the sensor:

    - ``noise_T``: standard deviation of one chip's sample on one axis, above 0, or a list of one for each axis;
    - ``hum_T``, ``hum_Hz``, ``axes``, ``lever_m``, ``gain_sd``, ``axis_sd_rad``: optional, see `SensorSite`.

    The optional table ``[survey]`` says how well position, axis and current of all beacons are known (`Survey`):
    ``position_sd_m``, ``axis_sd_rad``, ``current_sd``; the same keys in a ``[[beacon]]`` count for that one instead.
    What neither says is assumed (`ASSUMED_SURVEY`, `ASSUMED_GAIN_SD`, `ASSUMED_AXIS_SD_RAD`); 0 says that it is exact.

    ``[metal]`` and ``metal_T_A`` of a beacon, optional, say what metal adds to the fields (`site.metal_keys`).

    Each table ``[[beacon]]`` describes one coil, in metres and in the site's frame:

    - ``id``: text or whole number, different for each beacon;
    - ``current_A``: amplitude, not 0; a negative current turns the moment round;
    - ``radius_m`` for a circular coil, which needs ``position_m`` (its centre), ``axis`` (its normal, of any length)
      and ``turns``; or
    - ``points_m`` for a coil given by its wire, at least three points in the direction of a positive current;
      ``position_m``, ``axis`` and ``turns`` (default 1) may then be left out; or
    - ``shape`` for a coil as people make them, one of `goldfield.site.coil_shapes.SHAPES`, with ``position_m``,
      ``axis``, optionally ``angle_rad`` about it, and its sizes;
    - ``code`` for cdma: index of a Gold code, 0 to 2^degree, different for each beacon unless ``shared_codes``; or
      ``codes``, several at once: a list of ``{code, degree, offset, hold}``, the last three optional (`Code`);
    - ``slot`` for tdma: 0 to slots - 1;
    - ``frequency_Hz`` for fdma, a whole number of periods in a cycle, and optionally ``wave``, ``"cosine"`` (the
      default) or ``"sine"``: two beacons may share a frequency, not a frequency and a wave; with unknown phases any
      frequency, and optionally ``phase_rad``;
    - ``tau_s``: optional, time constant of the coil's current, 0 to ten chips; and those of `BeaconBoard`.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Site

    Raises
    ------
    UserError
        If the file cannot be read or is no TOML, or if any value is missing, unknown, of the wrong type or out of
        range; the sentence names file, line and key.
    """
    return site_of(read_table(Path(path), "site file"))


def site_of(root: Table) -> Site:
    """Read and check a site file that is parsed already; see `load`."""
    root.allow("site", "sensor", "survey", "metal", "beacon")
    site, sensor = root.table("site"), root.table("sensor")
    survey = root.table("survey") if "survey" in root else None
    site.allow("name", "chip_period_s", "degree", "half_space", "access", "shared_codes", *LIMITS, *SITE_KEYS)
    if survey is not None:
        survey.allow(*SURVEY_LIMITS)
    doubts: list[str] = []
    plan = read_plan(site)
    checked(site, "chip_period_s", plan.chip_period_s, doubts)
    tables = root.tables("beacon")
    metal = read_metal(root.table("metal")) if "metal" in root else None
    beacons = tuple(_beacon(table, plan, survey, metal, doubts) for table in tables)
    shared_codes = site.flag("shared_codes") if "shared_codes" in site else False
    if shared_codes and plan.access != "cdma":
        raise site.error("shared_codes", f'is for access = "cdma", but the site\'s access is "{plan.access}"')
    _check_unique(tables, beacons, shared_codes=shared_codes)
    check_boards(tables, [(beacon.id, beacon.board) for beacon in beacons])
    check_extent(tables, beacons, doubts)
    if metal is not None:
        check_bodies(root.table("metal"), metal, beacons)
    return Site(
        name=site.text("name"),
        chip_period_s=plan.chip_period_s,
        degree=plan.degree,
        half_space=_half_space(site.table("half_space")) if "half_space" in site else None,
        sensor=_sensor(sensor, doubts),
        beacons=beacons,
        access=plan.access,
        slots=plan.slots,
        samples=plan.samples,
        **{key: _positive(site, key, default, doubts) for key, default in LIMITS.items()},
        assumed=_assumed(tables, sensor, survey),
        doubts=tuple(doubts),
        metal=metal,
        shared_codes=shared_codes,
    )


LIMITS = {"alert_limit_m": ALERT_LIMIT_M, "ambient_gradient_T_m": AMBIENT_GRADIENT_T_M}
"""Optional numbers above 0 of the table ``[site]``, and their defaults."""


def _positive(table: Table, key: str, default: float, doubts: list[str]) -> float:
    """Return an optional number above 0 that is in its range."""
    return checked(table, key, table.positive(key) if key in table else default, doubts)


ASSUMED_SURVEY = Survey(position_sd_m=0.003, axis_sd_rad=0.005, current_sd=0.003)
"""What is assumed of a beacon where the file is silent: a tape measure, a spirit level and a shunt of today do it."""

ASSUMED_GAIN_SD = 0.003
ASSUMED_AXIS_SD_RAD = 0.005
"""What is assumed of the sensor's axes where the file is silent."""

SURVEY_LIMITS = {"position_sd_m": (1.0, " m"), "axis_sd_rad": (0.5, " rad"), "current_sd": (0.5, "")}
SENSOR_LIMITS = {"gain_sd": (0.5, ""), "axis_sd_rad": (0.5, " rad")}
"""Least values that are refused, with their units: with errors this large the model holds nowhere."""

LEAST_DEVIATION = 1e-12
"""Least standard deviation but 0: the squares of much smaller ones leave the range of numbers."""

SENSOR_KEYS = ("noise_T", "hum_T", "hum_Hz", "axes", "lever_m", *SENSOR_LIMITS)

MOST_HUM_T = 1e-4
"""A hum as large as this is no site's: it is 141 uT at its peak, three times the earth's field."""

LONGEST_LEVER_M = 0.3
"""The search takes all axes to be at one point and finds no pose where their levers are not small against the room."""

LARGEST_CONDITION = 100.0
"""Largest ratio of what the sensor's axes read of a field along its best and its worst direction: more is a mistake."""


def _deviation(table: Table, key: str, limits: dict[str, tuple[float, str]]) -> float:
    value, (limit, unit) = table.number(key), limits[key]
    if not 0.0 <= value < limit:
        raise table.error(key, f"is {value:g}; it is a standard deviation, from 0 to below {limit:g}{unit}")
    if 0.0 < value < LEAST_DEVIATION:
        raise table.error(key, f"is {value:g}; nothing is known so well: write 0 for what is exact")
    return value


def _sensor(table: Table, doubts: list[str]) -> SensorSite:
    if "model_error" in table:
        raise table.error(
            "model_error",
            "is no longer a key: say how well the beacons are known in [survey] (position_sd_m, axis_sd_rad, "
            "current_sd) and the sensor here (gain_sd, axis_sd_rad)",
        )
    table.allow(*SENSOR_KEYS)
    axes = _axes(table) if "axes" in table else None
    noise_T, noise_ratio = _noise(table, 3 if axes is None else len(axes), doubts)
    return SensorSite(
        noise_T=noise_T,
        gain_sd=_deviation(table, "gain_sd", SENSOR_LIMITS) if "gain_sd" in table else ASSUMED_GAIN_SD,
        axis_sd_rad=_deviation(table, "axis_sd_rad", SENSOR_LIMITS) if "axis_sd_rad" in table else ASSUMED_AXIS_SD_RAD,
        axes=axes,
        noise_ratio=noise_ratio,
        lever_m=_levers(table, 3 if axes is None else len(axes)) if "lever_m" in table else None,
        hum_T=_hum(table),
        hum_Hz=_positive(table, "hum_Hz", USUAL_HUM_HZ, doubts),
    )


def _hum(table: Table) -> float:
    hum_T = table.number("hum_T") if "hum_T" in table else 0.0
    if not 0.0 <= hum_T < MOST_HUM_T:
        raise table.error("hum_T", f"is {hum_T:g}; it is a root mean square, from 0 to below {MOST_HUM_T:g} T")
    return hum_T


def _levers(table: Table, axes: int) -> FloatArray | None:
    """Return where the axes read; None if it is the reference point."""
    lever = table.vectors("lever_m")
    if len(lever) != axes:
        raise table.error(
            "lever_m",
            f"has {counted(len(lever), 'rows')}; the sensor has {counted(axes, 'axes')}: give the place of each",
        )
    longest = float(np.linalg.norm(lever, axis=1).max())
    if longest >= LONGEST_LEVER_M:
        raise table.error("lever_m", f"has one of {longest:g} m; levers are below {LONGEST_LEVER_M:g} m")
    return lever if longest > 0.0 else None


def _noise(table: Table, axes: int, doubts: list[str]) -> tuple[float, FloatArray | None]:
    """Return the noise of an axis, and that of each over it if they differ."""
    if not table.is_list("noise_T"):
        return checked(table, "noise_T", table.positive("noise_T"), doubts), None
    each = table.numbers("noise_T")
    if len(each) != axes:
        raise table.error(
            "noise_T", f"has {counted(len(each), 'numbers')}; give one for all axes of the sensor, or {axes}"
        )
    for value in each.tolist():
        if value <= 0.0:
            raise table.error("noise_T", f"has {value:g}; noise is greater than zero")
        checked(table, "noise_T", value, doubts)
    noise_T = float(np.sqrt(np.mean(each**2)))
    return noise_T, each / noise_T


def _axes(table: Table) -> FloatArray:
    axes = table.vectors("axes")
    count = len(axes)
    if count > 3:
        raise table.error("axes", f"has {counted(count, 'rows')}; give one for each axis of the sensor, at most three")
    if count < 3 and np.triu(axes, 1).any():
        raise table.error(
            "axes",
            "are those of a sensor with fewer than three axes, whose first one is x and whose second one is in the "
            "plane of x and y: give [[a, 0, 0]] or [[a, 0, 0], [b, c, 0]]",
        )
    largest, *_, least = np.linalg.svd(axes, compute_uv=False) if count > 1 else np.abs(axes[0, :1]).repeat(2)
    if not least * LARGEST_CONDITION >= largest > 0.0:
        raise table.error("axes", "are nearly in one plane, or one of them reads almost nothing: no field can be told")
    return axes


def _survey(beacon: Table, survey: Table | None) -> Survey:
    """Return what the beacon's own table says, else ``[survey]``, else what is assumed."""
    values = {}
    for key in SURVEY_LIMITS:
        table = beacon if key in beacon else survey
        given = table is not None and key in table
        values[key] = _deviation(table, key, SURVEY_LIMITS) if table and given else getattr(ASSUMED_SURVEY, key)
    return Survey(**values)


def _assumed(beacons: list[Table], sensor: Table, survey: Table | None) -> tuple[str, ...]:
    silent = [
        f"[survey] {key} = {getattr(ASSUMED_SURVEY, key):g}"
        for key in SURVEY_LIMITS
        if (survey is None or key not in survey) and any(key not in beacon for beacon in beacons)
    ]
    given = {"gain_sd": ASSUMED_GAIN_SD, "axis_sd_rad": ASSUMED_AXIS_SD_RAD}
    return (*silent, *(f"[sensor] {key} = {value:g}" for key, value in given.items() if key not in sensor))


def _half_space(table: Table) -> HalfSpace:
    table.allow("point", "normal")
    return HalfSpace(point_m=table.vector("point"), normal=table.direction("normal"))


BEACON_KEYS = ("id", "position_m", "axis", "turns", "radius_m", "points_m", "current_A")
DRIVE_KEYS = ("code", "codes", "slot", "frequency_Hz", "wave", "phase_rad", "tau_s")


def _beacon(table: Table, plan: Plan, survey: Table | None, metal: Metal | None, doubts: list[str]) -> Beacon:
    table.allow(*BEACON_KEYS, *SHAPE_KEYS, *SURVEY_LIMITS, *DRIVE_KEYS, BEACON_KEY, *BOARD_KEYS)
    code, drive = read_drive(table, plan)
    current = table.number("current_A")
    if current == 0.0:
        raise table.error("current_A", "is zero: a beacon without a field cannot be located from; leave the beacon out")
    checked(table, "current_A", current, doubts)
    drawn = wire_of(table, doubts) if "shape" in table else None
    if drawn is None and ("radius_m" in table) == ("points_m" in table):
        raise table.error("radius_m", "or points_m must be given, exactly one of them; or shape")
    given: dict[str, Any] = {"id": table.label("id"), "current_A": current, "code": code, "drive": drive}
    given["survey"] = _survey(table, survey)
    given["metal"] = read_beacon_metal(table, metal)
    given["board"] = read_beacon_board(table)
    if "position_m" in table:
        check_place(table, "position_m", table.vector("position_m"))
    if drawn is not None:
        position, axis = table.vector("position_m"), table.direction("axis")
        return Beacon(
            **given,
            position_m=position,
            axis=axis,
            turns=_turns(table, doubts) if table.text("shape") == "rectangle" else 1.0,
            radius_m=None,
            points_m=placed(drawn, position, axis, table.number("angle_rad") if "angle_rad" in table else 0.0),
        )
    for key in SHAPE_KEYS:
        if key in table:
            raise table.error(key, "is only for a coil with a shape: leave it out")
    if "radius_m" in table:
        return Beacon(
            **given,
            position_m=table.vector("position_m"),
            axis=table.direction("axis"),
            turns=_turns(table, doubts),
            radius_m=checked(table, "radius_m", table.positive("radius_m"), doubts),
            points_m=None,
        )
    points = table.vectors("points_m")
    check_place(table, "points_m", points)
    area = area_vector(points)
    length = float(np.linalg.norm(area))
    extent = float(np.max(np.ptp(points, axis=0)))
    if len(points) < 3 or length <= 1e-9 * extent**2:
        raise table.error("points_m", "encloses no area: give at least three points of the wire that are not on a line")
    axis = table.direction("axis") if "axis" in table else area / length
    if axis @ area <= 0.0:
        raise table.error(
            "points_m", "run against axis: give the points in the direction of a positive current (right-hand rule)"
        )
    return Beacon(
        **given,
        position_m=table.vector("position_m") if "position_m" in table else points.mean(axis=0),
        axis=axis,
        turns=_turns(table, doubts) if "turns" in table else 1.0,
        radius_m=None,
        points_m=points,
    )


def _turns(table: Table, doubts: list[str]) -> float:
    return checked(table, "turns", table.positive("turns"), doubts)


def _check_unique(tables: list[Table], beacons: tuple[Beacon, ...], *, shared_codes: bool) -> None:
    ids: dict[str, int] = {}
    codes: dict[int, Beacon] = {}
    waves: dict[tuple[int, str], str] = {}
    for table, beacon in zip(tables, beacons, strict=True):
        if beacon.id in ids:
            raise table.error("id", f'is "{beacon.id}", which beacon {ids[beacon.id]} already has: take another')
        if beacon.code != NO_CODE and beacon.code in codes:
            _check_shared(table, beacon, codes[beacon.code], shared_codes=shared_codes)
        periods, wave = beacon.drive.periods, beacon.drive.wave
        if periods is not None:
            if (periods, wave) in waves:
                raise table.error(
                    "frequency_Hz",
                    f'is that of beacon "{waves[periods, wave]}" and so is the wave, "{wave}": change one of them',
                )
            waves[periods, wave] = beacon.id
        ids[beacon.id] = len(ids) + 1
        codes.setdefault(beacon.code, beacon)


def _check_shared(table: Table, beacon: Beacon, first: Beacon, *, shared_codes: bool) -> None:
    """Refuse a code that another beacon has, but where codes are shared; then its coil must follow as fast."""
    if not shared_codes:
        raise table.error(
            "code",
            f'is {beacon.code}, which beacon "{first.id}" already has: codes must differ, unless [site] has '
            "shared_codes = true",
        )
    if beacon.drive.tau_s != first.drive.tau_s:
        raise table.error(
            "code",
            f'is {beacon.code}, which beacon "{first.id}" already has, whose tau_s is another: coils that share a code '
            "must follow alike",
        )

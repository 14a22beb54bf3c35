"""A lattice of equal beacons as a site: for a plan before there is one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from goldfield.files.toml_table import Table, read_table
from goldfield.site import Beacon, HalfSpace, SensorSite, Site
from goldfield.site.model import Survey
from goldfield.site.plausible import EXTENT, check_place, checked
from goldfield.site.reading import ASSUMED_AXIS_SD_RAD, ASSUMED_GAIN_SD, ASSUMED_SURVEY, LEAST_DEVIATION
from goldfield.types import FloatArray

LATTICE_KEYS = ("count", "spacing_m", "height_m", "origin_m", "side", "axis", "turns", "radius_m", "current_A")
SENSOR_KEYS = ("noise_T", "degree", "gain_sd", "axis_sd_rad")
SURVEY_KEYS = ("position_sd_m", "axis_sd_rad", "current_sd")
SIDES = {"below": -1.0, "above": 1.0, "both": 0.0}

MOST_BEACONS = 20_000
"""Largest lattice."""

DEGREE, CHIP_PERIOD_S = 10, 16422 / 168e6
"""Degree of the codes unless the file says otherwise, and the chip period of the reference board."""


def load(path: str | Path) -> Site:
    """Read a lattice file.

    The table ``[lattice]`` has

    - ``count``: ``[nx, ny]``, numbers of beacons along x and y;
    - ``spacing_m``: ``[dx, dy]``, their distances;
    - ``height_m``: z of all of them;
    - ``origin_m``: optional, ``[x, y]`` of the first, default the site's origin;
    - ``side``: optional, where the sensor is: ``"below"`` (the default) or ``"above"`` the lattice, or ``"both"``;
    - ``axis``: optional, default ``[0, 0, 1]``; ``turns``, ``radius_m`` and ``current_A`` of every coil.

    The table ``[sensor]`` has ``noise_T``, the standard deviation of a sample on one axis, and, all optional,
    ``degree`` of the codes (10), ``gain_sd`` and ``axis_sd_rad``. The table ``[survey]``, optional, is that of a site
    file.

    Raises
    ------
    UserError
        As for `goldfield.site.load`.
    """
    root = read_table(Path(path), "lattice file")
    root.allow("lattice", "sensor", "survey")
    lattice, sensor = root.table("lattice"), root.table("sensor")
    survey = _survey(root.table("survey")) if "survey" in root else ASSUMED_SURVEY
    sensor.allow(*SENSOR_KEYS)
    doubts: list[str] = []
    beacons, half_space = _beacons(lattice, survey, doubts)
    return Site(
        name=Path(path).stem,
        chip_period_s=CHIP_PERIOD_S,
        degree=_degree(sensor),
        half_space=half_space,
        sensor=SensorSite(
            checked(sensor, "noise_T", sensor.positive("noise_T"), doubts),
            _deviation(sensor, "gain_sd", ASSUMED_GAIN_SD),
            _deviation(sensor, "axis_sd_rad", ASSUMED_AXIS_SD_RAD),
        ),
        beacons=beacons,
        doubts=tuple(doubts),
    )


def _degree(sensor: Table) -> int:
    degree = sensor.integer("degree") if "degree" in sensor else DEGREE
    if degree not in (5, 6, 7, 9, 10, 11):
        raise sensor.error("degree", f"is {degree}; Gold codes have degree 5, 6, 7, 9, 10 or 11")
    return degree


def _survey(table: Table) -> Survey:
    table.allow(*SURVEY_KEYS)
    return Survey(*(_deviation(table, key, getattr(ASSUMED_SURVEY, key)) for key in SURVEY_KEYS))


def _deviation(table: Table, key: str, assumed: float) -> float:
    value = table.number(key) if key in table else assumed
    if not 0.0 <= value < 1.0:
        raise table.error(key, f"is {value:g}; it is a standard deviation, from 0 to below 1")
    if 0.0 < value < LEAST_DEVIATION:
        raise table.error(key, f"is {value:g}; nothing is known so well: write 0 for what is exact")
    return value


def _beacons(table: Table, survey: Survey, doubts: list[str]) -> tuple[tuple[Beacon, ...], HalfSpace | None]:
    table.allow(*LATTICE_KEYS)
    count = table.numbers("count")
    if count.shape != (2,) or (count < 1).any() or (count % 1 != 0).any() or count.prod() > MOST_BEACONS:
        raise table.error("count", f"must be two whole numbers [nx, ny] of at most {MOST_BEACONS} beacons in all")
    spacing = _pair(table, "spacing_m")
    if (spacing <= 0.0).any():
        raise table.error("spacing_m", "must be above zero")
    widest = float(spacing[count > 1].max(initial=0.0))
    if widest > EXTENT.most:
        raise table.error("spacing_m", f"has {widest:g} m, farther than any field reaches{EXTENT.hint(widest)}")
    origin = _pair(table, "origin_m") if "origin_m" in table else np.zeros(2)
    height, side = table.number("height_m"), table.text("side") if "side" in table else "below"
    if side not in SIDES:
        raise table.error("side", f'is "{side}"; the sensor is {", ".join(SIDES)} of the lattice')
    axis = table.direction("axis") if "axis" in table else np.array([0.0, 0.0, 1.0])
    turns, radius, current = (
        checked(table, key, table.positive(key), doubts) for key in ("turns", "radius_m", "current_A")
    )
    check_place(table, "height_m", np.array([height]))
    check_place(table, "origin_m", origin)
    beacons = tuple(
        Beacon(
            id=f"b{i}-{j}",
            position_m=np.array([origin[0] + i * spacing[0], origin[1] + j * spacing[1], height]),
            axis=axis,
            turns=turns,
            radius_m=radius,
            points_m=None,
            current_A=current,
            code=0,
            survey=survey,
        )
        for i in range(int(count[0]))
        for j in range(int(count[1]))
    )
    normal = np.array([0.0, 0.0, SIDES[side]])
    return beacons, HalfSpace(np.array([0.0, 0.0, height]), normal) if side != "both" else None


def _pair(table: Table, key: str) -> FloatArray:
    """Return two numbers: the first counts for x, the second for y."""
    pair = table.numbers(key)
    if pair.shape != (2,):
        raise table.error(key, "must be two numbers, [x, y]")
    return pair

"""The files that tell what is known beside the fields: a table of points, and distances and the like in TOML."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from goldfield.errors import UserError
from goldfield.files.csv_table import Row, read_table
from goldfield.files.inputs import name_of
from goldfield.files.toml_table import Table
from goldfield.files.toml_table import read_table as read_toml
from goldfield.site import Site
from goldfield.survey.data import Current, Direction, Distance, Known, KnownPoint, Place, SensorPlace
from goldfield.types import Fields

COORDINATES = ("x_m", "y_m", "z_m")
POINT_SIGMA_M = 0.002
"""Deviation of a known coordinate where the table does not tell it: a tape measure and a mark on the floor."""
LARGEST_M = 1e4
"""Beyond any coordinate of an indoor site."""
DEVIATIONS = {"sd_m": (1e-6, 10.0, " m"), "sd_rad": (1e-6, 1.0, " rad"), "sd": (1e-6, 1.0, "")}
"""Least and largest standard deviation that a measurement has, with its unit, by its key."""
LARGEST_LEVER_M = 1.0
"""Beyond the distance of any anchor's sensor from the centre of its own coil."""
LARGEST_RATIO = 10.0
"""By how much a measured current may differ from that of the site file: more is another unit."""


def read_points(path: str | Path, epochs: Sequence[Fields]) -> tuple[KnownPoint, ...]:
    """Read where the sensor really was: a CSV table ``epoch,x_m,y_m,z_m[,sigma_m]``.

    An empty cell is a coordinate that is not known: three points on the floor have but ``z_m``. Where several epochs
    have the same coordinates the sensor stood still, and they share one error: each counts for its part.

    Parameters
    ----------
    path : path
    epochs : sequence of Fields
        What was measured.

    Raises
    ------
    UserError
        With file, line and column of whatever is wrong.
    """
    count = Counter(fields.epoch for fields in epochs)
    rows = list(read_table(path, ("epoch", *COORDINATES), ("sigma_m",)))
    if not rows:
        raise UserError(f"{name_of(path)}: has a header but no rows")
    points: dict[int, KnownPoint] = {}
    for row in rows:
        epoch = row.whole("epoch")
        if count[epoch] != 1:
            times = "is not among the epochs with fields" if not count[epoch] else "comes more than once among them"
            raise row.error("epoch", f"{epoch} {times}: give the number of one epoch of the fields")
        if epoch in points:
            raise row.error("epoch", f"{epoch} comes twice: an epoch has one point")
        position = np.array([_coordinate(row, column) for column in COORDINATES])
        if not np.isfinite(position).any():
            raise row.error("x_m", "is empty, as are y_m and z_m: give at least one coordinate")
        points[epoch] = KnownPoint(epoch, position, _sigma(row))
    alike = Counter(_key(point) for point in points.values())
    return tuple(
        replace(point, sigma_m=point.sigma_m * float(np.sqrt(alike[_key(point)]))) for point in points.values()
    )


def _key(point: KnownPoint) -> tuple[float | None, ...]:
    return tuple(None if np.isnan(value) else float(value) for value in point.position_m)


def _coordinate(row: Row, column: str) -> float:
    if not row.cells[column].strip():
        return float("nan")
    value = row.number(column)
    if abs(value) > LARGEST_M:
        raise row.error(column, f"is {value:g}, far outside of any room: give metres")
    return value


def _sigma(row: Row) -> float:
    if not row.cells.get("sigma_m", "").strip():
        return POINT_SIGMA_M
    value = row.number("sigma_m")
    least, most, unit = DEVIATIONS["sd_m"]
    if not least <= value <= most:
        raise row.error("sigma_m", f"is {value:g}; a standard deviation is {least:f} to {most:g}{unit}")
    return value


def read_known(path: str | Path, site: Site) -> tuple[Known | SensorPlace, ...]:
    """Read what was measured of the beacons with other means: a TOML file with one table, ``[known]``.

    Each of its keys is a list of inline tables, and may be left out:

    - ``distance``: ``{between = ["b1", "b2"], m, sd_m}``, between the centres of two coils;
    - ``height``: ``{beacon, m, sd_m}``, the z of a coil's centre;
    - ``position``: ``{beacon, m = [x, y, z], sd_m}``, its whole place;
    - ``direction``: ``{beacon, axis = [x, y, z], sd_rad}``, where its axis points;
    - ``current``: ``{beacon, A, sd}``, with a relative deviation;
    - ``sensor``: ``{beacon, m = [x, y, z], sd_m}``, where an anchor's sensor is, from the centre of its coil and in the
      frame of the sensor.

    Raises
    ------
    UserError
        With file, line and key of whatever is wrong.
    """
    root = read_toml(Path(path), "file of known values")
    root.allow("known")
    table = root.table("known")
    readers: dict[str, Callable[[Table, Site], Known | SensorPlace]] = {
        "distance": _distance,
        "height": _height,
        "position": _position,
        "direction": _direction,
        "current": _current,
        "sensor": _sensor,
    }
    table.allow(*readers)
    known = [read(item, site) for key, read in readers.items() if key in table for item in table.tables(key)]
    if not known:
        raise UserError(f"{name_of(path)}: [known] is empty: its keys are {', '.join(readers)}")
    return tuple(known)


def _distance(table: Table, site: Site) -> Distance:
    table.allow("between", "m", "sd_m")
    names = table.labels("between")
    if len(names) != 2 or names[0] == names[1]:
        raise table.error("between", "must name two different beacons")
    for name in names:
        _check(table, "between", name, site)
    return Distance((names[0], names[1]), _length(table, table.positive("m")), _deviation(table, "sd_m"))


def _height(table: Table, site: Site) -> Place:
    table.allow("beacon", "m", "sd_m")
    return Place(
        _beacon(table, site), np.array([np.nan, np.nan, _length(table, table.number("m"))]), _deviation(table, "sd_m")
    )


def _position(table: Table, site: Site) -> Place:
    table.allow("beacon", "m", "sd_m")
    place = np.array([_length(table, value) for value in table.vector("m").tolist()])
    return Place(_beacon(table, site), place, _deviation(table, "sd_m"))


def _direction(table: Table, site: Site) -> Direction:
    table.allow("beacon", "axis", "sd_rad")
    return Direction(_beacon(table, site), table.direction("axis"), _deviation(table, "sd_rad"))


def _current(table: Table, site: Site) -> Current:
    table.allow("beacon", "A", "sd")
    name, value = _beacon(table, site), table.number("A")
    ratio = value / site.beacon(name).current_A
    if ratio <= 0.0:
        raise table.error("A", f"is {value:g} and has not the sign of {name}'s current in the site file")
    if not 1.0 / LARGEST_RATIO <= ratio <= LARGEST_RATIO:
        before = site.beacon(name).current_A
        raise table.error("A", f"is {value:g}, and the site file says {before:g} A of {name}: give amperes")
    return Current(name, value, _deviation(table, "sd"))


def _sensor(table: Table, site: Site) -> SensorPlace:
    table.allow("beacon", "m", "sd_m")
    lever = table.vector("m")
    if np.abs(lever).max() > LARGEST_LEVER_M:
        raise table.error("m", f"is {np.linalg.norm(lever):g} m from the centre of the coil: give metres, at most one")
    return SensorPlace(_beacon(table, site), lever, _deviation(table, "sd_m"))


def _length(table: Table, value: float) -> float:
    if abs(value) > LARGEST_M:
        raise table.error("m", f"is {value:g}, far outside of any room: give metres")
    return value


def _deviation(table: Table, key: str) -> float:
    value, (least, most, unit) = table.number(key), DEVIATIONS[key]
    if not least <= value <= most:
        raise table.error(key, f"is {value:g}; a standard deviation is {least:f} to {most:g}{unit}")
    return value


def _beacon(table: Table, site: Site) -> str:
    return _check(table, "beacon", table.label("beacon"), site)


def _check(table: Table, key: str, name: str, site: Site) -> str:
    ids = [beacon.id for beacon in site.beacons]
    if name not in ids:
        more = "" if len(ids) <= 10 else f" and {len(ids) - 10} more"
        raise table.error(key, f'names "{name}", which the site does not have: it has {", ".join(ids[:10])}{more}')
    return name

"""A site file with new values: they are written where the old ones stood, and all else stays as its author wrote it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from tomlkit.items import Array, Float, Integer, Item, Table, Trivia

from goldfield.errors import UserError
from goldfield.files.inputs import name_of
from goldfield.files.toml_table import parse_table, read_text
from goldfield.site.coil_shapes import angle_of, frame, smallest_rotation
from goldfield.site.metal import COLUMNS, ROWS, Metal
from goldfield.site.model import Beacon, Survey
from goldfield.site.reading import site_of
from goldfield.types import FloatArray

WIRE_DIGITS = 12
"""Decimals of the metres to which the points of a moved wire are written: a picometre is below everything."""

SAME_ANGLE_RAD = 1e-12
"""A turn of a coil about its axis by less is none."""

PLAIN = (1e-5, 1e9)
"""Sizes of numbers that are written without an exponent, unless the number that they replace has one."""


@dataclass(frozen=True)
class BeaconRevision:
    """What is new of a beacon; None stays as it is.

    Attributes
    ----------
    position_m : ndarray, shape (3,), or None
        Centre of the coil.
    axis : ndarray, shape (3,), or None
        Unit vector.
    current_A : float or None
    survey : Survey or None
        All three standard deviations.
    tau_s : float or None
        Time constant with which the current follows a step.
    metal_T_A : ndarray, shape (C,), or None
        Coefficients of what metal adds.
    """

    position_m: FloatArray | None = None
    axis: FloatArray | None = None
    current_A: float | None = None
    survey: Survey | None = None
    tau_s: float | None = None
    metal_T_A: FloatArray | None = None


@dataclass(frozen=True)
class SensorRevision:
    """What is new of the sensor; None stays as it is.

    Attributes
    ----------
    axes : ndarray, shape (k, 3), or None
    gain_sd, axis_sd_rad : float or None
    lever_m : ndarray, shape (k, 3), or None
    """

    axes: FloatArray | None = None
    gain_sd: float | None = None
    axis_sd_rad: float | None = None
    lever_m: FloatArray | None = None


def revised(
    path: Path,
    beacons: Mapping[str, BeaconRevision],
    sensor: SensorRevision | None = None,
    metal: Metal | None = None,
) -> str:
    """Return the text of a site file with new values.

    Comments, blank lines, the order of keys and the style of numbers stay; a key that the file does not have comes to
    the end of its table. Tables ``[[beacon]]`` between which other tables stand are brought together. A coil that is
    given by its wire or its shape moves and turns as a rigid body, by the smallest rotation from its old axis to the
    new one.

    Parameters
    ----------
    path : Path
        The file to revise; it is not written.
    beacons : mapping of str to BeaconRevision
        By the beacon's id.
    sensor : SensorRevision, optional
    metal : Metal, optional
        Takes the place of a table ``[metal]``; each revision of a beacon then has ``metal_T_A``.

    Returns
    -------
    str
        A file from which `load` reads the new values: bit for bit, but for an axis, which is scaled to length 1 once
        more, and for the place and axis that a wire tells (`WIRE_DIGITS`).

    Raises
    ------
    UserError
        If the file is no site file, has no beacon of such an id, or the new values are none that a site can have.
    """
    text, name = read_text(path, "site file"), name_of(path)
    old = {beacon.id: beacon for beacon in site_of(parse_table(text, name, "site file")).beacons}
    for unknown in beacons.keys() - old.keys():
        raise UserError(f'{name}: no beacon has the id "{unknown}"; there are {", ".join(old)}')
    document: Any = tomlkit.parse(text)
    for table in document["beacon"]:
        beacon_id = str(table["id"])
        if beacon_id in beacons:
            _revise_beacon(table, old[beacon_id], beacons[beacon_id])
    for key, value in _given(sensor).items():
        put(document["sensor"], key, value)
    if metal is not None:
        _put_metal(document, metal)
    result = written(document, text)
    site_of(parse_table(result, f"{name}, revised", "site file"))
    return result


def written(document: Any, text: str) -> str:
    """Return a revised document's text, with lines that end as all lines of the text that it was read from do."""
    result = tomlkit.dumps(document)
    dos = 0 < text.count("\r\n") == text.count("\n")
    return re.sub("\r?\n", "\r\n", result) if dos else result


def _put_metal(document: Any, metal: Metal) -> None:
    """Write the table ``[metal]``: in place of an old one, else before the first beacon. Nothing takes it away."""
    table = tomlkit.table()
    if metal.degree == 0:
        for beacon in document["beacon"]:
            beacon.pop("metal_T_A", None)
    if metal.is_nothing:
        document.pop("metal", None)
        return
    if metal.degree:
        table["degree"] = metal.degree
        put(table, "centre_m", metal.centre_m)
        put(table, "radius_m", metal.radius_m)
    put(table, "sd_T_A", metal.sd_T_A)
    if len(metal.walked_m):
        put(table, "walked_m", metal.walked_m)
    bodies = tomlkit.aot()
    for place, matrix in zip(metal.body_m, metal.polarisability_A_m2_T, strict=True):
        body = tomlkit.table()
        put(body, "position_m", place)
        put(body, "polarisability_A_m2_T", matrix[ROWS, COLUMNS])
        bodies.append(body)
    if len(bodies):
        table["body"] = bodies
    if "metal" in document:
        document["metal"] = table
        return
    # tomlkit appends; the beacons are taken out and put back behind the new table.
    beacons = document.pop("beacon")
    document["metal"] = table
    document["beacon"] = beacons


def _given(revision: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that are not None; nothing of None."""
    if revision is None:
        return {}
    values = {field.name: getattr(revision, field.name) for field in fields(revision)}
    return {key: value for key, value in values.items() if value is not None}


def _revise_beacon(table: MutableMapping[str, Any], old: Beacon, revision: BeaconRevision) -> None:
    values = _given(revision)
    survey = values.pop("survey", None)
    if "points_m" in table and ("position_m" in values or "axis" in values):
        position, axis = values.get("position_m", old.position_m), values.get("axis", old.axis)
        assert old.points_m is not None
        moved = position + (old.points_m - old.position_m) @ smallest_rotation(old.axis, axis).T
        put(table, "points_m", moved.round(WIRE_DIGITS))
        # A wire tells its place and axis; only where the file tells them too there is something to revise.
        values = {
            key: value for key, value in values.items() if key in table or key in ("current_A", "tau_s", "metal_T_A")
        }
    if "shape" in table and "axis" in values:
        given = float(table.get("angle_rad", 0.0))
        rotation = smallest_rotation(old.axis, values["axis"]) @ frame(old.axis, given)
        angle = angle_of(rotation)
        if abs(math.remainder(angle - given, math.tau)) > SAME_ANGLE_RAD:
            values["angle_rad"] = angle
    for key, value in {**values, **_given(survey)}.items():
        put(table, key, value)


def put(table: MutableMapping[str, Any], key: str, value: float | FloatArray) -> None:
    """Set a key of a table; a new one stands behind the last key, before the comments that lead to the next table."""
    if key in table:
        table[key] = _renewed(table[key], value)
        return
    body = table.value.body if isinstance(table, Table) else []
    tail = []
    while body and body[-1][0] is None:
        tail.append(body.pop())
    table[key] = _renewed(None, value)
    body.extend(reversed(tail))


def _renewed(old: Any, value: float | FloatArray) -> Any:
    """Return a number, or a list of numbers at any depth, in the style of the one that it replaces."""
    if isinstance(value, int):  # true and false, too
        return tomlkit.item(value)
    if np.ndim(value) == 0:
        return _number(old, float(value))
    values = np.asarray(value, dtype=np.float64)
    if isinstance(old, Array) and len(old) == len(values):
        for index, part in enumerate(values):
            old[index] = _renewed(old[index], part)
        return old
    new = tomlkit.array()
    new.extend([_renewed(None, part) for part in values])
    return new.multiline(values.ndim > 1)


def _number(old: Any, value: float) -> Item:
    """Return a number; the old one itself, digits and all, where it has the value already."""
    if isinstance(old, Integer | Float) and float(old) == value:
        return old
    written = old.as_string() if isinstance(old, Integer | Float) else ""
    if isinstance(old, Integer) and value.is_integer() and abs(value) < PLAIN[1]:
        return Integer(int(value), Trivia(), str(int(value)))
    exponent = "e" in written.lower() or not (value == 0.0 or PLAIN[0] <= abs(value) < PLAIN[1])
    style = np.format_float_scientific if exponent else np.format_float_positional
    raw = re.sub(r"e\+?(-?)0*(?=\d)", r"e\1", style(value, unique=True, trim="0"))
    return Float(value, Trivia(), raw)

"""The site file: a site as TOML; see `load` for the keys.

Every value is checked once, when the file is read, so that nothing behind this module needs to.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from goldfield.files.toml_table import Table, read_table
from goldfield.site.drive import NO_CODE, SITE_KEYS, Plan, read_drive, read_plan
from goldfield.site.model import ALERT_LIMIT_M, Beacon, HalfSpace, SensorSite, Site, area_vector


def load(path: str | Path) -> Site:
    """Read and check a site file.

    The table ``[site]`` says what all beacons have in common:

    - ``name``: text;
    - ``chip_period_s``: duration of a chip, above 0;
    - ``degree``: degree of the Gold codes, 5, 6, 7, 9, 10 or 11: a cycle has 2^degree - 1 chips;
    - ``access``: how beacons are told apart, ``"cdma"`` (codes, the default), ``"tdma"`` (time slots) or ``"fdma"``
      (frequencies);
    - ``slots``: only for tdma, and needed there: the number of time slots in a cycle, 1 to the number of its chips;
    - ``tone``: only for fdma: ``"sine"`` (the default) or ``"square"``;
    - ``half_space``: optional, ``{point = [x, y, z], normal = [x, y, z]}``: the sensor is on the side of the plane
      to which the normal points, which decides between a pose and its mirror image;
    - ``alert_limit_m``: optional, above 0: a pose whose error could be larger through a fault of one beacon is not
      ``ok`` but ``unverified`` (`ALERT_LIMIT_M`).

    The table ``[sensor]`` describes the sensor:

    - ``noise_T``: standard deviation of one chip's sample on one axis, above 0;
    - ``model_error``: optional, 0 to below 1: by what part of its size a field may differ from the model.

    Each table ``[[beacon]]`` describes one coil, in metres and in the site's frame:

    - ``id``: text, different for each beacon;
    - ``current_A``: amplitude, not 0; a negative current turns the moment round;
    - ``radius_m`` for a circular coil, which needs ``position_m`` (its centre), ``axis`` (its normal, of any length)
      and ``turns``; or
    - ``points_m`` for a coil given by its wire, at least three points in the direction of a positive current;
      ``position_m``, ``axis`` and ``turns`` (default 1) may then be left out: the wire tells them;
    - ``code`` for cdma: index of a Gold code, 0 to 2^degree, different for each beacon; or ``codes``, several at
      once: a list of ``{code, degree, offset, hold}``, each with the last three optional (`Code`);
    - ``slot`` for tdma: 0 to slots - 1;
    - ``frequency_Hz`` for fdma, a whole number of periods in a cycle, and optionally ``wave``, ``"cosine"`` (the
      default) or ``"sine"``: two beacons may share a frequency, not a frequency and a wave;
    - ``tau_s``: optional, time constant with which the coil's current follows a step, 0 to ten chips.

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
    return _site(read_table(Path(path), "site file"))


def _site(root: Table) -> Site:
    root.allow("site", "sensor", "beacon")
    site, sensor = root.table("site"), root.table("sensor")
    site.allow("name", "chip_period_s", "degree", "half_space", "access", "alert_limit_m", *SITE_KEYS)
    sensor.allow("noise_T", "model_error")
    plan = read_plan(site)
    beacons = tuple(_beacon(table, plan) for table in root.tables("beacon"))
    _check_unique(root, beacons)
    return Site(
        name=site.text("name"),
        chip_period_s=plan.chip_period_s,
        degree=plan.degree,
        half_space=_half_space(site.table("half_space")) if "half_space" in site else None,
        sensor=SensorSite(noise_T=sensor.positive("noise_T"), model_error=_model_error(sensor)),
        beacons=beacons,
        access=plan.access,
        slots=plan.slots,
        alert_limit_m=site.positive("alert_limit_m") if "alert_limit_m" in site else ALERT_LIMIT_M,
    )


def _model_error(sensor: Table) -> float:
    if "model_error" not in sensor:
        return 0.0
    error = sensor.number("model_error")
    if not 0.0 <= error < 1.0:
        raise sensor.error("model_error", f"is {error:g}; it must be a part of the field, from 0 to below 1")
    return error


def _half_space(table: Table) -> HalfSpace:
    table.allow("point", "normal")
    return HalfSpace(point_m=table.vector("point"), normal=table.direction("normal"))


BEACON_KEYS = ("id", "position_m", "axis", "turns", "radius_m", "points_m", "current_A")
DRIVE_KEYS = ("code", "codes", "slot", "frequency_Hz", "wave", "tau_s")


def _beacon(table: Table, plan: Plan) -> Beacon:
    table.allow(*BEACON_KEYS, *DRIVE_KEYS)
    code, drive = read_drive(table, plan)
    current = table.number("current_A")
    if current == 0.0:
        raise table.error("current_A", "is zero: a beacon without a field cannot be located from; leave the beacon out")
    if ("radius_m" in table) == ("points_m" in table):
        raise table.error("radius_m", "or points_m must be given, exactly one of them")
    given: dict[str, Any] = {"id": table.text("id"), "current_A": current, "code": code, "drive": drive}
    if "radius_m" in table:
        return Beacon(
            **given,
            position_m=table.vector("position_m"),
            axis=table.direction("axis"),
            turns=table.positive("turns"),
            radius_m=table.positive("radius_m"),
            points_m=None,
        )
    points = table.vectors("points_m")
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
        turns=table.positive("turns") if "turns" in table else 1.0,
        radius_m=None,
        points_m=points,
    )


def _check_unique(root: Table, beacons: tuple[Beacon, ...]) -> None:
    tables = root.tables("beacon")
    ids: dict[str, int] = {}
    codes: dict[int, str] = {}
    waves: dict[tuple[int, str], str] = {}
    for table, beacon in zip(tables, beacons, strict=True):
        if beacon.id in ids:
            raise table.error("id", f'is "{beacon.id}", which beacon {ids[beacon.id]} already has: take another')
        if beacon.code != NO_CODE and beacon.code in codes:
            raise table.error(
                "code", f'is {beacon.code}, which beacon "{codes[beacon.code]}" already has: codes must differ'
            )
        periods, wave = beacon.drive.periods, beacon.drive.wave
        if periods is not None:
            if (periods, wave) in waves:
                raise table.error(
                    "frequency_Hz",
                    f'is that of beacon "{waves[periods, wave]}" and so is the wave, "{wave}": change one of them',
                )
            waves[periods, wave] = beacon.id
        ids[beacon.id] = len(ids) + 1
        codes[beacon.code] = beacon.id

"""The site file: which beacons stand where, with which coil and code, and how noisy the sensor is.

TOML; see `load` for the keys. Every number is checked here once, so that nothing behind this module needs to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from goldfield.drive import NO_CODE, NOTHING_ELSE, SITE_KEYS, Drive, Plan, read_drive, read_plan
from goldfield.errors import UserError
from goldfield.poses import FloatArray
from goldfield.toml_table import Table, read_table


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The side of a plane where the sensor is: ``(p - point_m) . normal >= 0``.

    Attributes
    ----------
    point_m : ndarray, shape (3,)
    normal : ndarray, shape (3,)
        Unit vector.
    """

    point_m: FloatArray
    normal: FloatArray

    def contains(self, position_m: FloatArray) -> bool:
        """Tell whether a position, shape (3,), lies on the sensor's side."""
        return bool((position_m - self.point_m) @ self.normal >= 0.0)


@dataclass(frozen=True)
class SensorSite:
    """What the site file says of the sensor.

    Attributes
    ----------
    noise_T : float
        Standard deviation of one chip's sample on one axis.
    model_error : float
        What a measured field may differ from the model by (survey, currents, metal near by), relative to its size. It
        adds to the noise of each beacon's field, so that strong beacons are not trusted beyond it.
    """

    noise_T: float
    model_error: float = 0.0


@dataclass(frozen=True, eq=False)
class Beacon:
    """A coil at a known place.

    Attributes
    ----------
    id : str
    position_m : ndarray, shape (3,)
        Centre of the coil; of a coil given by its wire the mean of its points unless the file says otherwise.
    axis : ndarray, shape (3,)
        Unit vector; a positive current turns around it by the right-hand rule.
    turns : float
        Of a coil given by its wire: how often the whole wire is repeated.
    radius_m : float or None
        Of a circular coil.
    points_m : ndarray, shape (n, 3), or None
        The wire as a polyline in the site's frame, in the direction of a positive current; exactly one of
        ``radius_m`` and ``points_m`` is given.
    current_A : float
        Amplitude of the chips; negative turns the moment round.
    code : int
        Index of the Gold code; `goldfield.drive.NO_CODE` unless the beacon has just one.
    drive : Drive
        Whatever else tells the beacon from others, and how fast its coil follows.
    """

    id: str
    position_m: FloatArray
    axis: FloatArray
    turns: float
    radius_m: float | None
    points_m: FloatArray | None
    current_A: float
    code: int
    drive: Drive = NOTHING_ELSE

    @property
    def moment_A_m2(self) -> FloatArray:
        """Magnetic moment, shape (3,), A m^2: turns, current and area vector multiplied."""
        if self.points_m is not None:
            return self.turns * self.current_A * area_vector(self.points_m)
        assert self.radius_m is not None
        return self.turns * self.current_A * math.pi * self.radius_m**2 * self.axis


@dataclass(frozen=True, eq=False)
class Site:
    """Everything that the host knows before the first sample.

    Attributes
    ----------
    name : str
    chip_period_s : float
    degree : int
        Of the Gold codes: a cycle has ``2**degree - 1`` chips.
    half_space : HalfSpace or None
    sensor : SensorSite
    beacons : tuple of Beacon
        Ids are unique, plain codes too, and frequencies with their waves.
    access : str
        How beacons are told apart: "cdma", "tdma" or "fdma".
    slots : int
        Of a cycle, for "tdma"; else 0.
    """

    name: str
    chip_period_s: float
    degree: int
    half_space: HalfSpace | None
    sensor: SensorSite
    beacons: tuple[Beacon, ...]
    access: str = "cdma"
    slots: int = 0

    @property
    def chips(self) -> int:
        """Chips in a cycle, N."""
        return (1 << self.degree) - 1

    @property
    def cycle_s(self) -> float:
        """Duration of a cycle."""
        return self.chips * self.chip_period_s

    @property
    def codes(self) -> tuple[int, ...]:
        """Code index of each beacon.

        Raises
        ------
        UserError
            If a beacon has not just one plain code: a sensor's correlations then do not hold its field.
        """
        for beacon in self.beacons:
            if beacon.code == NO_CODE:
                raise UserError(
                    f'beacon "{beacon.id}" of the site "{self.name}" has no plain code: a sensor board correlates with '
                    'one Gold code a beacon; give each beacon a code, or use "goldfield separate" on raw samples'
                )
        return tuple(beacon.code for beacon in self.beacons)

    def beacon(self, beacon_id: str) -> Beacon:
        """Return the beacon of this id; KeyError if there is none."""
        for beacon in self.beacons:
            if beacon.id == beacon_id:
                return beacon
        raise KeyError(beacon_id)


def area_vector(points_m: FloatArray) -> FloatArray:
    """Return half the sum of r x dr along a polyline, shape (n, 3), closed by its chord: area times normal, m^2."""
    relative = points_m - points_m.mean(axis=0)
    return np.asarray(0.5 * np.cross(relative, np.roll(relative, -1, axis=0)).sum(axis=0), dtype=np.float64)


def load(path: str | Path) -> Site:
    """Read and check a site file.

    Keys: ``[site] name, chip_period_s, degree``, optionally ``half_space = {point = [x, y, z], normal = [x, y, z]}``
    and ``access`` with its own (`goldfield.drive`); ``[sensor] noise_T`` and optionally ``model_error``; for each
    beacon ``[[beacon]] id, position_m, axis, turns, current_A, code`` and one of ``radius_m`` and ``points_m``,
    optionally ``tau_s``. With ``points_m`` the position, axis and turns may be left out: the wire tells them.

    Raises
    ------
    UserError
        With file, line and key, if the file cannot be read, is no TOML, or any value is missing, unknown, of the wrong
        type or out of range.
    """
    path = Path(path)
    root = read_table(path, "site file")
    root.allow("site", "sensor", "beacon")
    site, sensor = root.table("site"), root.table("sensor")
    site.allow("name", "chip_period_s", "degree", "half_space", "access", *SITE_KEYS)
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

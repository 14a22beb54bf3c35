"""The experiments of Zheng et al. 2022, figs 6 to 11, in a simulated room that is not our model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.site.rotating import RotatingSite
from goldfield.types import FloatArray
from hil_sim.papers.zheng.methods.attitude import attitude_from_normals, printed_angles, yaw_only_attitude
from hil_sim.papers.zheng.methods.ellipse import locate_by_ellipse, position_from_axes
from hil_sim.papers.zheng.methods.field_ellipse import direction_from_normal, normal_vector, rms_strength
from hil_sim.papers.zheng.methods.fingerprint import LineLocator, nearest_neighbours
from hil_sim.papers.zheng.room import Room, Setting
from hil_sim.papers.zheng.trend import DAY_S, Trend, slope_per_day, trend

MIDDLE_M = 1.0
"""Half the side of the square of targets whose beacons are all about equally far (fig 11)."""

SETTLE_S, UPDATE_S = 4.0 * 3600.0, 60.0
"""Time after which the drive is warm, and time between estimates: one a minute, as in the paper."""

IMPROVED, OURS = "3 improved fingerprints", "ours, all components"


@dataclass(frozen=True, eq=False)
class Compared:
    """One algorithm in the room.

    Attributes
    ----------
    name : str
    error_m : ndarray, shape (e,)
        Error of the position.
    printed_deg : ndarray, shape (e,) or None
        Mean of the three angles' errors (eqn 31) with the attitude as printed, for a sensor that is not turned; None
        where the algorithm has an attitude of its own.
    turned_deg : ndarray, shape (e,)
        Angle between the true attitude and that of Wahba's problem on the normals (of the full fit, if the algorithm
        has one), for sensors turned at random.
    printed_turned_deg : ndarray, shape (e,) or None
        The same as ``printed_deg``, for the sensors turned at random.
    """

    name: str
    error_m: FloatArray
    printed_deg: FloatArray | None
    turned_deg: FloatArray
    printed_turned_deg: FloatArray | None


def compare(room: Room, runs: int, tilt_deg: float) -> list[Compared]:
    """Run each algorithm at the same random places: position, attitude unturned and turned (figs 7 and 8)."""
    fingerprints = room.survey()
    lines = LineLocator(room.site.position_m, fingerprints, room.site.up)
    truth = room.targets(runs)
    attitude = room.tilted(runs, tilt_deg)
    level, turned = room.measure(truth), room.measure(truth, attitude)
    algorithms: dict[str, Callable[[FloatArray], FloatArray]] = {
        "1 attenuation lines, global": lines.by_global_lines,
        "1 attenuation lines, regions": lines.by_region_lines,
        "2 nearest fingerprints": lambda strength: nearest_neighbours(fingerprints, strength),
        "2 nearest fingerprints, ln B": lambda strength: nearest_neighbours(fingerprints, strength, logarithmic=True),
        IMPROVED: lines.by_local_lines,
        "3 improved fingerprints, ln B": lambda strength: lines.by_local_lines(strength, logarithmic=True),
    }
    results = []
    for name, locate in algorithms.items():
        position, position_turned = locate(rms_strength(level)), locate(rms_strength(turned))
        results.append(
            Compared(
                name,
                distance(position, truth),
                printed_error_deg(room.site, position, level, np.tile(np.eye(3), (runs, 1, 1))),
                angle_deg(attitude_from_normals(room.site, position_turned, turned), attitude),
                printed_error_deg(room.site, position_turned, turned, attitude),
            )
        )
    position = position_from_axes(room.site, turned, room.sigma_T)
    wahba = attitude_from_normals(room.site, position, turned)
    results.append(Compared("ours, semi-axes alone", distance(position, truth), None, angle_deg(wahba, attitude), None))
    fit = locate_by_ellipse(room.site, turned, room.sigma_T)
    results.append(Compared(OURS, distance(fit.position_m, truth), None, angle_deg(fit.rotation, attitude), None))
    return results


def direction_errors(room: Room, range_m: FloatArray, polar_deg: float, runs: int) -> FloatArray:
    """Return the rms error, in degrees, of the direction from the normal at each range from beacon 1 (fig 6).

    The points are at one angle from the beacon's z (not stated in the paper) and random azimuths: at the horizon the
    normal tells no azimuth, whatever the range. The shape is that of ``range_m``, (d,).
    """
    beacon = room.site.beacons[0]
    polar = np.radians(polar_deg)
    errors = np.empty(len(range_m))
    for place, distance_m in enumerate(range_m):
        azimuth = room.rng.uniform(0.0, 2.0 * np.pi, runs)
        unit = np.stack(
            [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.full(runs, np.cos(polar))], axis=1
        )
        field = room.measure(beacon.position_m + distance_m * unit @ beacon.frame.T)[:, 0]
        estimate = direction_from_normal(normal_vector(field @ beacon.frame))
        cosine = np.clip((estimate * unit).sum(axis=1), -1.0, 1.0)
        errors[place] = np.degrees(np.sqrt(np.mean(np.arccos(cosine) ** 2)))
    return errors


@dataclass(frozen=True, eq=False)
class BeaconCount:
    """Errors with some number of beacons.

    Attributes
    ----------
    beacons : int
    improved_m, ours_m : ndarray, shape (e,)
        Errors of algorithm 3 and of the fit of all components.
    """

    beacons: int
    improved_m: FloatArray
    ours_m: FloatArray


def more_beacons(site: RotatingSite, setting: Setting, runs: int) -> list[BeaconCount]:
    """Return errors with the first 3, 4, ... of the site's beacons, at the same places around their middle (fig 11)."""
    middle = site.position_m[:, :2].mean(axis=0)
    results = []
    for count in range(3, len(site.beacons) + 1):
        some = site.first(count)
        room = Room(some, setting)
        spread = np.random.default_rng(setting.seed).uniform(-MIDDLE_M, MIDDLE_M, (runs, 2))
        height = np.linspace(setting.low_m[2], setting.high_m[2], runs)
        truth = np.column_stack([middle + spread, height])
        field = room.measure(truth)
        fingerprint = LineLocator(some.position_m, room.survey(), some.up).by_local_lines(rms_strength(field))
        fit = locate_by_ellipse(some, field, room.sigma_T)
        results.append(BeaconCount(count, distance(fingerprint, truth), distance(fit.position_m, truth)))
    return results


@dataclass(frozen=True, eq=False)
class Stability:
    """Errors over the hours of repeated runs, with a drifting drive.

    Attributes
    ----------
    hours : ndarray, shape (t,)
    error_m, error_deg : dict of str to ndarray, shape (t,)
        Errors of the first run, by algorithm.
    trend_m, trend_deg : dict of str to Trend
        Slopes after the warm-up over all runs, by algorithm.
    drive_range : float
        Greatest minus least drift factor on any beacon's current, in the first run.
    """

    hours: FloatArray
    error_m: dict[str, FloatArray]
    error_deg: dict[str, FloatArray]
    trend_m: dict[str, Trend]
    trend_deg: dict[str, Trend]
    drive_range: float


def stability(room: Room, hours: float, position_m: FloatArray, runs: int, ageing_per_day: float = 0.0) -> Stability:
    """Return the errors of a sensor at rest while the drive warms, follows the day and wanders (figs 9 and 10).

    Parameters
    ----------
    room : Room
    hours : float
        Duration of one run.
    position_m : ndarray, shape (3,)
    runs : int
        Number of runs, at least two, each with a drift of its own.
    ageing_per_day : float
        Steady relative loss of every beacon's current, which shows what a trend looks like.
    """
    lines = LineLocator(room.site.position_m, room.survey(), room.site.up)
    time_s: FloatArray = np.arange(round(hours * 3600.0 / UPDATE_S), dtype=np.float64) * UPDATE_S
    warm = time_s >= SETTLE_S
    truth = np.tile(position_m, (len(time_s), 1))
    upright = np.tile(np.eye(3), (len(time_s), 1, 1))
    series: list[tuple[dict[str, FloatArray], dict[str, FloatArray]]] = []
    drive_ranges = []
    for _ in range(runs):
        drive = room.world.thermal_drive(time_s, room.rng) - (ageing_per_day / DAY_S) * time_s[:, None]
        field = room.measure(truth, None, drive)
        fingerprint = lines.by_local_lines(rms_strength(field))
        fit = locate_by_ellipse(room.site, field, room.sigma_T)
        by_normals = attitude_from_normals(room.site, fingerprint, field)
        series.append(
            (
                {IMPROVED: distance(fingerprint, truth), OURS: distance(fit.position_m, truth)},
                {IMPROVED: angle_deg(by_normals, upright), OURS: angle_deg(fit.rotation, upright)},
            )
        )
        drive_ranges.append(float(np.ptp(drive, axis=0).max()))

    def trends(part: int) -> dict[str, Trend]:
        return {
            name: trend(np.array([slope_per_day(time_s[warm], run[part][name][warm]) for run in series]))
            for name in (IMPROVED, OURS)
        }

    error_m, error_deg = series[0]
    hour: FloatArray = np.asarray(time_s / 3600.0)
    return Stability(hour, error_m, error_deg, trends(0), trends(1), drive_ranges[0])


def distance(position_m: FloatArray, truth_m: FloatArray) -> FloatArray:
    """Return distances, shape (e,), between positions of shape (e, 3)."""
    return np.asarray(np.linalg.norm(position_m - truth_m, axis=1))


def angle_deg(rotation: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the angles of the turns between attitudes of shape (e, 3, 3), degrees, shape (e,)."""
    return np.asarray(np.degrees((Rotation.from_matrix(rotation) * Rotation.from_matrix(truth).inv()).magnitude()))


def printed_error_deg(site: RotatingSite, position_m: FloatArray, field_T: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the mean error of the angles of the attitude as printed (eqn 31), degrees, shape (e,)."""
    angles = printed_angles(yaw_only_attitude(site.position_m, position_m, field_T))
    error = angles - printed_angles(truth.swapaxes(1, 2))
    return np.asarray(np.degrees(np.abs((error + np.pi) % (2.0 * np.pi) - np.pi).mean(axis=1)))

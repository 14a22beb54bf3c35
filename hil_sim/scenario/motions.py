"""Reading where the sensor is: [motion], and the known points at which a walk stands still."""

from __future__ import annotations

import math

import numpy as np

from goldfield.errors import counted
from goldfield.files.toml_table import Table
from hil_sim.scenario.values import FloatArray, deviation, not_negative, positive, seed_of, vector
from hil_sim.world.motion import Line, Motion, Still, Waypoints
from hil_sim.world.roaming import Roaming, Shake
from hil_sim.world.walk import Limits, Mark, Room, Visit, Walk, turning

LEAVES_S = 3.0
"""When walks and turns begin by default: the boards have started, are in step and have their currents by then."""
LONGEST_S = 3600.0
"""Longest walk: its stops are drawn before the bench runs."""
FARTHEST_M, FASTEST_M_PER_S, FASTEST_RAD_PER_S, LARGEST_SWAY_M = 1e4, 1e3, 1e3, 1.0
"""What is farther, faster or sways more is a slip in the file: the boards would see nothing that they could use."""

MOTION_KEYS = {
    "still": ("position_m", "rotation_vector_rad"),
    "line": ("position_m", "rotation_vector_rad", "velocity_m_per_s", "rate_rad_per_s"),
    "waypoints": ("times_s", "positions_m", "rotation_vectors_rad"),
    "walk": (
        *("low_m", "high_m", "seconds", "start_s", "speed_m_per_s", "rate_rad_per_s", "tilt_rad", "pause_s", "seed"),
    ),
    "roaming": (*("low_m", "high_m", "speed_m_per_s", "rate_rad_per_s", "shake_Hz", "shake_m", "shake_rad", "seed"),),
    "turning": ("position_m", "seconds", "start_s", "rate_rad_per_s", "sway_m", "seed"),
}
KNOWN_POINT_KEYS = ("position_m", "sigma_m", "cycles")


def read_motion(root: Table, seed: int, cycle_s: float) -> tuple[Motion, tuple[Visit, ...]]:
    """Return the sensor's motion and its visits to known points.

    Parameters
    ----------
    root : Table
        The scenario.
    seed : int
        That of motions that have none of their own.
    cycle_s : float

    Raises
    ------
    UserError
        One sentence with file, line, table and key.
    """
    table = root.table("motion")
    kind = table.text("kind")
    if kind not in MOTION_KEYS:
        raise table.error("kind", f'is "{kind}"; it must be one of {", ".join(MOTION_KEYS)}')
    table.allow("kind", *MOTION_KEYS[kind])
    if kind == "walk":
        walk = _walk(table, _marks(root, seed), seed, cycle_s)
        return walk, walk.visits
    if "known_point" in root:
        raise root.error("known_point", f'tables are stops of a walk, and the motion is "{kind}": make it "walk"')
    if kind == "waypoints":
        return _waypoints(table), ()
    if kind == "roaming":
        return _roaming(table, seed), ()
    position = _near(table, "position_m", table.vector("position_m"))
    if kind == "turning":
        start_s, seconds = _times(table)
        limits = Limits(math.inf, positive(table, "rate_rad_per_s", 1.0, FASTEST_RAD_PER_S))
        sway_m = not_negative(table, "sway_m", 0.0, LARGEST_SWAY_M)
        return turning(seed_of(table, seed), start_s, seconds, position, sway_m, limits), ()
    rotation = vector(table, "rotation_vector_rad")
    if kind == "still":
        return Still(position, rotation), ()
    velocity, rate = vector(table, "velocity_m_per_s"), vector(table, "rate_rad_per_s")
    for key, value, most in (
        ("velocity_m_per_s", velocity, FASTEST_M_PER_S),
        ("rate_rad_per_s", rate, FASTEST_RAD_PER_S),
    ):
        if np.abs(value).max() > most:
            raise table.error(key, f"has {np.abs(value).max():g}; at most {most:g} are possible")
    return Line(position, rotation, velocity, rate), ()


def _near(table: Table, key: str, places_m: FloatArray) -> FloatArray:
    """Return places, shape (..., 3); refuse those that no site has."""
    farthest = float(np.abs(places_m).max(initial=0.0))
    if farthest > FARTHEST_M:
        raise table.error(
            key, f"has {farthest:g}; a sensor is at most {FARTHEST_M:g} m from the origin: it is in metres"
        )
    return places_m


def _waypoints(table: Table) -> Waypoints:
    times, rotations = table.numbers("times_s"), table.vectors("rotation_vectors_rad")
    positions = _near(table, "positions_m", table.vectors("positions_m"))
    if len(times) < 2 or np.any(np.diff(times) <= 0.0):
        raise table.error("times_s", "must be at least two times that increase")
    for key, value in (("positions_m", positions), ("rotation_vectors_rad", rotations)):
        if len(value) != len(times):
            raise table.error(key, f"has {counted(len(value), 'entries')}; times_s has {len(times)}: give one each")
    return Waypoints(times, positions, rotations)


def _times(table: Table) -> tuple[float, float]:
    seconds = table.positive("seconds")
    if seconds > LONGEST_S:
        raise table.error("seconds", f"is {seconds:g}; at most {LONGEST_S:g} are possible")
    return not_negative(table, "start_s", LEAVES_S), seconds


def _box(table: Table) -> tuple[FloatArray, FloatArray]:
    low, high = (_near(table, key, table.vector(key)) for key in ("low_m", "high_m"))
    if np.any(high < low):
        raise table.error("high_m", "is below low_m: give the corner of the box with the largest x, y and z")
    return low, high


def _roaming(table: Table, seed: int) -> Roaming:
    low, high = _box(table)
    shake = Shake(*(not_negative(table, key, 0.0) for key in ("shake_Hz", "shake_m", "shake_rad")))
    if shake.frequency_Hz == 0.0 and (shake.size_m or shake.angle_rad):
        raise table.error("shake_Hz", "is missing or 0, and there is something to shake: say how often")
    return Roaming(
        seed_of(table, seed),
        low,
        high,
        not_negative(table, "speed_m_per_s", 0.5, FASTEST_M_PER_S),
        not_negative(table, "rate_rad_per_s", 0.5, FASTEST_RAD_PER_S),
        shake,
    )


def _walk(table: Table, marks: tuple[Mark, ...], seed: int, cycle_s: float) -> Walk:
    low, high = _box(table)
    tilt_rad = not_negative(table, "tilt_rad", 0.5)
    if tilt_rad > math.pi:
        raise table.error("tilt_rad", f"is {tilt_rad:g}; it is an angle in radians, at most pi")
    start_s, seconds = _times(table)
    return Walk(
        seed_of(table, seed),
        start_s,
        seconds,
        Room(low, high, tilt_rad, not_negative(table, "pause_s", 0.5)),
        Limits(
            positive(table, "speed_m_per_s", 0.5, FASTEST_M_PER_S),
            positive(table, "rate_rad_per_s", 1.0, FASTEST_RAD_PER_S),
        ),
        marks,
        cycle_s,
    )


def _marks(root: Table, seed: int) -> tuple[Mark, ...]:
    """Return the known points; where the sensor really stands differs by what the measurement is off."""
    if "known_point" not in root:
        return ()
    random = np.random.default_rng([seed, 5])
    return tuple(_mark(table, random.normal(size=3)) for table in root.tables("known_point"))


def _mark(table: Table, off: FloatArray) -> Mark:
    table.allow(*KNOWN_POINT_KEYS)
    position, sigma_m = _near(table, "position_m", table.vector("position_m")), deviation(table, "sigma_m", 1.0)
    cycles = table.integer("cycles") if "cycles" in table else 20
    if not 1 <= cycles <= 10_000:
        raise table.error("cycles", f"is {cycles}; it must lie in 1 to 10000")
    return Mark(position, sigma_m, position + sigma_m * off, cycles)

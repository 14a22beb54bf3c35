"""Motions that a person makes: walks through a room with stops, and turning a sensor in the hand.

Both go from stop to stop. On the way the fraction done is 10 u^3 - 15 u^4 + 6 u^5 of the fraction u of the time, so
that speed and acceleration begin and end at zero; the largest speed is 15/8 of the mean, and each leg lasts as long as
the limits of speed and of turning ask for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]

PEAK = 15.0 / 8.0
"""Largest speed of a leg over its mean speed."""
SHORTEST_LEG_S = 0.2


@dataclass(frozen=True)
class Limits:
    """How fast a person moves: the largest speed and the largest angular velocity, each reached in each leg or not."""

    speed_m_per_s: float
    rate_rad_per_s: float


@dataclass(frozen=True, eq=False)
class Stop:
    """A place and attitude at which the sensor stays; ``rotation`` turns from its frame to the site's."""

    position_m: FloatArray
    rotation: Rotation
    stay_s: float


@dataclass(frozen=True, eq=False)
class Mark:
    """A place that someone else has measured, where a walk stands still.

    Attributes
    ----------
    position_m : ndarray, shape (3,)
        What was measured.
    sigma_m : float
        Standard deviation of each coordinate.
    true_m : ndarray, shape (3,)
        Where the sensor really stands.
    cycles : int
        How many whole cycles it stands there.
    """

    position_m: FloatArray
    sigma_m: float
    true_m: FloatArray
    cycles: int


@dataclass(frozen=True, eq=False)
class Visit:
    """A walk's stay at a mark, from ``arrival_s`` to ``departure_s``."""

    mark: Mark
    arrival_s: float
    departure_s: float


class StopAndGo:
    """A motion from stop to stop; before and after it the sensor rests at the first and the last of them.

    Parameters
    ----------
    start_s : float
        When it leaves the first stop, which it may do later if that one's ``stay_s`` says so.
    stops : sequence of Stop
        At least two.
    limits : Limits

    Attributes
    ----------
    arrivals_s, departures_s : ndarray, shape (n,)
        The interval in which the sensor is at each stop; the first begins at ``start_s``.
    """

    still = False

    def __init__(self, start_s: float, stops: Sequence[Stop], limits: Limits) -> None:
        self._positions = np.array([stop.position_m for stop in stops])
        self._rotations = Rotation.concatenate([stop.rotation for stop in stops])
        self._turns = (self._rotations[:-1].inv() * self._rotations[1:]).as_rotvec()
        lengths = np.linalg.norm(np.diff(self._positions, axis=0), axis=1)
        angles = np.linalg.norm(self._turns, axis=1)
        least = np.maximum(lengths / limits.speed_m_per_s, angles / limits.rate_rad_per_s)
        legs_s = np.maximum(PEAK * least, SHORTEST_LEG_S)
        stays_s = np.array([stop.stay_s for stop in stops])
        self.departures_s = start_s + np.cumsum(stays_s) + np.concatenate([[0.0], np.cumsum(legs_s)])
        self.arrivals_s = self.departures_s - stays_s

    def poses(self, times_s: FloatArray) -> tuple[FloatArray, Rotation]:
        """See `hil_sim.world.motion.Motion.poses`."""
        leg = np.clip(np.searchsorted(self.departures_s, times_s, side="right") - 1, 0, len(self._turns) - 1)
        length_s = self.arrivals_s[leg + 1] - self.departures_s[leg]
        u = np.clip((times_s - self.departures_s[leg]) / length_s, 0.0, 1.0)
        done = (u**3 * (10.0 - 15.0 * u + 6.0 * u**2))[:, None]
        positions = self._positions[leg] + done * (self._positions[leg + 1] - self._positions[leg])
        return positions, self._rotations[leg] * Rotation.from_rotvec(done * self._turns[leg])


@dataclass(frozen=True, eq=False)
class Room:
    """Where a person walks, and how the sensor is carried.

    Attributes
    ----------
    low_m, high_m : ndarray, shape (3,)
        Opposite corners of a box: the stops are spread evenly in it.
    tilt_rad : float
        The sensor's third axis leans at most so much from the site's third axis, in any direction; its heading is any.
    pause_s : float
        How long the walk rests at a stop.
    """

    low_m: FloatArray
    high_m: FloatArray
    tilt_rad: float
    pause_s: float


class Walk(StopAndGo):
    """A walk through a room to random stops, and to each of some marks on the way, in their order.

    Parameters
    ----------
    seed : int
        The same seed makes the same walk.
    start_s, seconds : float
        When it begins, and for how long new stops are taken; marks that are left by then are still visited.
    room : Room
    limits : Limits
    marks : sequence of Mark
    cycle_s : float
        Duration of a cycle: at a mark the sensor stays for one more than it has to, as it comes within a cycle.

    Attributes
    ----------
    visits : tuple of Visit
        One for each mark.
    """

    def __init__(
        self,
        seed: int,
        start_s: float,
        seconds: float,
        room: Room,
        limits: Limits,
        marks: Sequence[Mark],
        cycle_s: float,
    ) -> None:
        random = np.random.default_rng([seed, 3])
        stops = [_somewhere(random, room)]
        at_mark: dict[int, Mark] = {}
        left = list(marks)
        while True:
            done_s = StopAndGo(start_s, [*stops, stops[-1]], limits).departures_s[-2] - start_s if stops else 0.0
            if not left and done_s >= seconds:
                break
            stop = _somewhere(random, room)
            if left and done_s >= seconds * (len(marks) - len(left) + 0.5) / len(marks):
                mark = left.pop(0)
                at_mark[len(stops)] = mark
                stop = Stop(mark.true_m, stop.rotation, (mark.cycles + 1) * cycle_s)
            stops.append(stop)
        super().__init__(start_s, stops if len(stops) > 1 else stops * 2, limits)
        self.visits = tuple(
            Visit(mark, float(self.arrivals_s[row]), float(self.departures_s[row])) for row, mark in at_mark.items()
        )


def turning(
    seed: int, start_s: float, seconds: float, position_m: FloatArray, sway_m: float, limits: Limits
) -> StopAndGo:
    """Return the motion of a sensor that a hand turns in place, through random attitudes, all equally likely.

    Parameters
    ----------
    seed : int
    start_s, seconds : float
        When it begins, and for how long new attitudes are taken.
    position_m : ndarray, shape (3,)
        Where the hand is.
    sway_m : float
        Standard deviation of each coordinate of the hand's place at an attitude.
    limits : Limits
    """
    random = np.random.default_rng([seed, 4])
    stops: list[Stop] = []
    while len(stops) < 2 or StopAndGo(start_s, stops, limits).arrivals_s[-1] - start_s < seconds:
        place = position_m + sway_m * random.normal(size=3)
        quaternion = random.normal(size=4)
        stops.append(Stop(place, Rotation.from_quat(quaternion), 0.0))
    return StopAndGo(start_s, stops, limits)


def _somewhere(random: np.random.Generator, room: Room) -> Stop:
    place = random.uniform(room.low_m, room.high_m)
    heading, direction = random.uniform(0.0, 2.0 * np.pi, 2)
    lean = room.tilt_rad * np.sqrt(random.uniform())
    tilt = Rotation.from_rotvec(lean * np.array([np.cos(direction), np.sin(direction), 0.0]))
    return Stop(place, tilt * Rotation.from_rotvec([0.0, 0.0, heading]), room.pause_s)

"""Recovery of a track: all beacons are lost for a while, the sensor moves and turns on, and they return.

Samples are those of `motion_trials`: a moving sensor's, chip by chip, coils by magpylib, the earth's field in them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.access import Separator
from goldfield.site import Site
from goldfield.track import Tracker
from goldfield.types import Fields, Pose
from tests.bench.locate_trials import CHIPS
from tests.bench.motion_trials import EARTH_T, Flight, Room, circling

BEFORE = 8
"""Cycles with beacons before they are lost."""
AFTER = 6
"""Cycles with beacons after their return."""
SOON = 2
"""Cycles within which the pose must be `ok` again."""
ERROR_M = 0.10
"""A pose that is `ok` at the return with a larger error is wrong."""


@dataclass(frozen=True)
class Return:
    """What a tracker said when the beacons returned.

    Attributes
    ----------
    cycles : int
        Cycles until it was `ok`, 1 if it was in the first; `AFTER` + 1 if it never was.
    error_m : float
        Largest error of the poses that were `ok` after the return; 0 if none was.
    said_ok : int
        Poses that were `ok` later than a second into the loss, though nothing was heard.
    """

    cycles: int
    error_m: float
    said_ok: int


class Outage:
    """Runs trackers through losses of all beacons on one site.

    Parameters
    ----------
    site : Site
    noise_T : float
        Noise of a sample.
    silent : bool
        Whether no epoch comes while the beacons are lost; else epochs of nothing but noise and the earth's field come.
    """

    def __init__(self, site: Site, noise_T: float, silent: bool) -> None:
        self._site, self._noise_T, self._silent = site, noise_T, silent
        self._room = Room(site)
        self._separator = Separator(10, site.codes, noise_T)
        self._names = tuple(beacon.id for beacon in site.beacons)

    def run(self, seconds: float, speed: float, rate: float, rng: np.random.Generator) -> Return:
        """Lose the beacons for a time while the sensor circles at a speed (m/s) and turn rate (rad/s)."""
        flight = circling(rng, speed, rate)
        tracker = Tracker(self._site)
        lost = max(round(seconds / self._site.cycle_s), 1)
        heard = [*range(BEFORE), *range(BEFORE + lost, BEFORE + lost + AFTER)]
        cycles = heard if self._silent else range(BEFORE + lost + AFTER)
        said_ok, first, error = 0, AFTER + 1, 0.0
        for cycle in cycles:
            pose = tracker.update(self._fields(flight, cycle, cycle in heard, rng))
            since = cycle - BEFORE - lost
            if since >= 0 and pose.status == "ok":
                first = min(first, since + 1)
                error = max(error, self._error_m(flight, pose))
            elif BEFORE + 10 < cycle < BEFORE + lost:
                said_ok += pose.status == "ok"
        return Return(first, error, said_ok)

    def _fields(self, flight: Flight, cycle: int, heard: bool, rng: np.random.Generator) -> Fields:
        middle = cycle * self._site.cycle_s
        if heard:
            samples = self._room.samples(flight, middle, self._noise_T, rng)
        else:
            times = middle + (np.arange(CHIPS) + 1 - CHIPS / 2) * self._site.chip_period_s
            rotation = flight.poses(times)[1]
            samples = rotation.inv().apply(EARTH_T) + self._noise_T * rng.normal(size=(CHIPS, 3))
        separation = self._separator.from_samples(samples)
        return Fields(cycle, middle, self._names, separation.field_T, separation.sigma_T)

    def _error_m(self, flight: Flight, pose: Pose) -> float:
        position = flight.poses(np.array([pose.time_s]))[0][0]
        return float(np.linalg.norm(pose.position_m - position))

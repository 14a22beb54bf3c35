"""A whole scenario."""

from __future__ import annotations

from dataclasses import dataclass, replace

from hil_sim.scenario.events import Bring, Event, Move
from hil_sim.scenario.parts import DEGREE, Ambient, Beacon, FrontEnd, HalfSpace, Sensor
from hil_sim.world.motion import Motion
from hil_sim.world.sheet import Sheet


@dataclass(frozen=True, eq=False)
class Scenario:
    """A whole scenario; board 0 is the sensor, board i the i-th beacon.

    ``sync`` is where the boards have their time from, ``wire`` or ``can``; with ``can`` there is no sync wire.
    ``beacons`` are as they are before the first of the ``events``.
    """

    name: str
    seed: int
    power_on_spread_s: float
    half_space: HalfSpace | None
    ambient: Ambient
    sensor: Sensor
    motion: Motion
    beacons: tuple[Beacon, ...]
    slots: int = 0
    degree: int = DEGREE
    sync: str = "wire"
    events: tuple[Event, ...] = ()

    def at(self, time_s: float) -> Scenario:
        """Return the scenario with its beacons where they are at a virtual time."""
        moves = [event for event in self.events if isinstance(event, Move) and event.time_s <= time_s]
        if not moves:
            return self
        beacons = {beacon.id: beacon for beacon in self.beacons}
        for move in moves:
            beacons[move.beacon] = beacons[move.beacon].moved(move.by_m, move.sensor_stays)
        return replace(self, beacons=tuple(beacons.values()))

    def sheets(self, time_s: float) -> tuple[Sheet, ...]:
        """Return the sheets of metal that are there at a virtual time."""
        return tuple(event.sheet for event in self.events if isinstance(event, Bring) and event.time_s <= time_s)

    @property
    def chips(self) -> int:
        """Chips in a cycle."""
        return (1 << self.degree) - 1

    @property
    def sync_master(self) -> int:
        """Board number of the sync master."""
        return 1 + [beacon.sync_master for beacon in self.beacons].index(True)

    def board_name(self, board: int) -> str:
        """Return the name of a board for messages: "the sensor" or "beacon b3"."""
        return "the sensor" if board == 0 else f"beacon {self.beacons[board - 1].id}"

    def front_end(self, board: int) -> FrontEnd | None:
        """Return a board's sensor; None: it has none."""
        return self.sensor if board == 0 else self.beacons[board - 1].sensor

    def motion_of(self, board: int) -> Motion:
        """Return the motion of a board's sensor; ValueError if it has none."""
        if board == 0:
            return self.motion
        anchor = self.beacons[board - 1].sensor
        if anchor is None:
            raise ValueError(f"beacon {self.beacons[board - 1].id} has no sensor")
        return anchor.motion

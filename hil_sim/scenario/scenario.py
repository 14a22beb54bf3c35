"""A whole scenario."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from hil_sim.scenario.events import Bring, Event, Move
from hil_sim.scenario.installation import EXACT, Installation, draw
from hil_sim.scenario.parts import (
    CLEAN_BUS,
    DEGREE,
    FASTEST,
    Ambient,
    Beacon,
    CanBus,
    FrontEnd,
    HalfSpace,
    Links,
    Sensor,
)
from hil_sim.world.magnet import Magnet
from hil_sim.world.metal import Body
from hil_sim.world.motion import Motion
from hil_sim.world.walk import Visit


@dataclass(frozen=True, eq=False)
class Scenario:
    """A whole scenario; board 0 is the sensor, board i the i-th beacon.

    ``sync`` is where the boards have their time from, ``wire``, ``can`` or ``automatic``; with ``can`` there is no sync
    wire.
    ``beacons`` and ``sensor`` are as the site file and the boards' parameters have them, `installed` as they are, both
    before the first of the ``events``. ``metal`` is there from the start, ``magnets`` when they say; ``visits`` are the
    walk's to known points.
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
    shared_codes: bool = False
    events: tuple[Event, ...] = ()
    metal: tuple[Body, ...] = ()
    magnets: tuple[Magnet, ...] = ()
    installation: Installation = EXACT
    visits: tuple[Visit, ...] = ()
    can: CanBus = CLEAN_BUS
    links: Links = FASTEST

    @cached_property
    def installed(self) -> Scenario:
        """The bench that is really there, whose own installation is exact."""
        beacons, sensor = draw(self.installation, self.beacons, self.sensor)
        return replace(self, beacons=beacons, sensor=sensor, installation=EXACT)

    def at(self, time_s: float) -> Scenario:
        """Return the scenario with its beacons where they are at a virtual time."""
        moves = [event for event in self.events if isinstance(event, Move) and event.time_s <= time_s]
        if not moves:
            return self
        beacons = {beacon.id: beacon for beacon in self.beacons}
        for move in moves:
            beacons[move.beacon] = beacons[move.beacon].moved(move.by_m, move.sensor_stays)
        return replace(self, beacons=tuple(beacons.values()))

    def metal_at(self, time_s: float) -> tuple[Body, ...]:
        """Return the metal that is there at a virtual time."""
        brought = [event.sheet for event in self.events if isinstance(event, Bring) and event.time_s <= time_s]
        return (*self.metal, *brought)

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

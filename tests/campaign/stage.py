"""What a kind of fault is, and the bench on which one is played, by a trial or in the course of a day."""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from goldfield.nodes.conversation import CLEAR
from goldfield_protocol import encode
from hil_sim.rig import Rig
from hil_sim.scenario import Scenario
from tests.campaign.links import CanLink, SerialLink

CYCLE_S = 1023 * 16422 / 168e6
FAULT_S = 4.0
"""How long a fault lasts unless its kind says otherwise."""
CLEAR_S = 0.5
"""So long after the mending a host clears what is latched: while a current still decays a board would refuse."""
LOW_M, HIGH_M = np.array([0.4, 0.4, 0.4]), np.array([1.7, 1.7, 1.4])
"""Opposite corners of the room through which the sensor roams."""
SPEED_M_S, RATE_RAD_S = 0.3, 0.3


@dataclass(frozen=True)
class Kind:
    """A kind of fault.

    Attributes
    ----------
    group, name : str
    begin : callable
        Takes the `Stage` at the moment of the fault.
    end : callable
        Takes it when the fault is mended.
    plan : callable, optional
        Takes scenario, begin and end (s) and a generator, and returns the scenario in which it happens by itself.
    serial : bool
        The host reads the sensor's serial port, not CAN.
    lasts_s : float
        How long it lasts.
    by_arrival : bool
        No number tells which cycle it was, as two masters drove the wire: the moment of its last message does, on CAN.
    emulated : bool
        Only an emulated board can have it.
    """

    group: str
    name: str
    begin: Callable[[Stage], None] = lambda trial: None
    end: Callable[[Stage], None] = lambda trial: None
    plan: Callable[[Scenario, float, float, np.random.Generator], Scenario] | None = None
    serial: bool = False
    lasts_s: float = FAULT_S
    by_arrival: bool = False
    emulated: bool = False


class Killed(Exception):
    """The host is killed: what it was told is gone, and a new one starts."""


@dataclass(order=True)
class _Due:
    time_s: float
    happen: Callable[[Any], None] = field(compare=False)


class Stage:
    """A bench on which kinds of faults are played.

    Parameters
    ----------
    scenario : Scenario
    seed : int
    boards : str
        Which boards the rig has: "host" or "emulated".
    random : numpy.random.Generator
        Draws what of the kind is not fixed: which beacon, which axis.

    Attributes
    ----------
    scenario, seed, boards, random
        The parameters.
    kind : Kind
        What is played.
    rig : Rig
    link : CanLink or SerialLink
        What the host reads; `tick` is to be called at each of its looks.
    notes : dict
        What `begin` leaves for `end`.
    takes_s : float
        How long, in virtual time, a pose is taken for before the next one is asked for.
    """

    kind: Kind
    link: CanLink | SerialLink

    def __init__(self, scenario: Scenario, seed: int, boards: str, random: np.random.Generator) -> None:
        self.scenario, self.seed, self.boards, self.random = scenario, seed, boards, random
        self.notes: dict[str, Any] = {}
        self.takes_s = 0.0
        self._due: list[_Due] = []
        self.rig = Rig(scenario, boards, threads=1)  # Trials run side by side, a process each.

    @property
    def beacons(self) -> int:
        """How many beacons there are; board 1 is the first."""
        return len(self.scenario.beacons)

    def follower(self) -> int:
        """Draw a beacon that is not the sync master."""
        others = [board for board in range(1, 1 + self.beacons) if board != self.scenario.sync_master]
        return int(self.random.choice(others))

    def clear(self, board: int) -> None:
        """Let a host clear, a moment from now, why a beacon's drive is off, as ``goldfield nodes clear`` does."""
        unique = self.rig.unique_id(board)
        own = int.from_bytes(unique[:6], "little") ^ int.from_bytes(unique[6:], "little")
        node = self.scenario.beacons[board - 1].node
        request = encode("COMMAND", {"board": own, "argument": 0}, node=node, index=CLEAR)
        self.at(self.rig.now_s + CLEAR_S, lambda stage: stage.rig.can_write(*request))

    def at(self, time_s: float, happen: Callable[[Any], None]) -> None:
        """Let something happen, to this stage, at the first look behind a virtual time."""
        insort(self._due, _Due(time_s, happen))

    def tick(self) -> None:
        """Let happen what is due."""
        while self._due and self.rig.now_s >= self._due[0].time_s:
            self._due.pop(0).happen(self)

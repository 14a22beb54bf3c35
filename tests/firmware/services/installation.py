"""Beacons and sensors of one installation whose leader may change: the sync wire, CAN, cuts, and deaths.

Boards run one after the other through a quantum, the one that drives the wire first: what it does reaches the others
when it happens. A wire or a bus may be split into parts that do not hear each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield_protocol import Message, decode
from tests.firmware.host_rig import (
    BEACON,
    CHIPS,
    MS,
    PIN_BRIDGE_1,
    PIN_BRIDGE_2,
    PIN_SYNC_IN,
    PIN_SYNC_OUT,
    SENSOR,
    US,
    Board,
    Coil,
    beacon,
    chip_seconds,
)

FRAME, BIT = 130 * US, US
SYNC_TYPE = 1
LEADS_ALONE = 150 * MS
"""Without an edge of the board that runs first for so long, one that sends SYNC runs first from then on."""


@dataclass
class Place:
    """A place of the installation: how its board is made, and the board while it has power."""

    node: int
    rank: int
    source: int
    ppm: float
    wire: int | None = 0
    can: int | None = 0
    board: Board | None = None
    requests: int = 0
    pins: int = 0
    past: list[Board] = field(default_factory=list)


class Installation:
    """Boards on one wire and one bus.

    Parameters
    ----------
    places : mapping of int to tuple
        By node: rank, sync_source, crystal's error in ppm. Nodes from 100 on are sensors.
    extra : mapping, optional
        Parameters that all boards have.
    """

    def __init__(self, places: Mapping[int, tuple[int, int, float]], extra: Mapping[str, Any] | None = None) -> None:
        self.places = {node: Place(node, *values) for node, values in places.items()}
        self.extra = dict(extra or {})
        self.now = 0
        self.frames: list[tuple[int, int, Message]] = []
        """Time, sender, message of all that was on the bus."""
        self.edges: list[tuple[int, int]] = []
        """Time and node of all rising edges of sync outputs."""
        self._first = next(iter(self.places))
        self._bus_free = 0

    def start(self, *nodes: int, at: int | None = None) -> None:
        """Give boards power, all or some."""
        for node in nodes or self.places:
            place = self.places[node]
            on = self.now if at is None else at
            options = {"ppm": place.ppm, "power_on": on, "unique_id": node.to_bytes(12, "little")}
            common = {"node": node, "sync_source": place.source, **self.extra}
            if node >= 100:
                parameters = {**common, "code_count": 0}
                place.board = Board(SENSOR, parameters, **options)
            else:
                parameters = {"code": node + 1, "amplitude": 5.0, **common, "sync_master": place.rank}
                place.board = beacon(Coil(), parameters=parameters, **options)
            assert place.board.role in (BEACON, SENSOR)
            place.requests = place.pins = 0

    def kill(self, node: int) -> None:
        """Take a board's power."""
        place = self.places[node]
        assert place.board is not None
        place.past.append(place.board)
        place.board = None
        self._level(place, False, self.now)

    def board(self, node: int) -> Board:
        board = self.places[node].board
        assert board is not None
        return board

    def run(self, time: int, quantum: int = MS) -> None:
        """Run on for a time."""
        until = self.now + time
        while self.now < until:
            self.now = min(self.now + quantum, until)
            alive = [place for place in self.places.values() if place.board is not None]
            for place in sorted(alive, key=lambda place: place.node != self._first):
                assert place.board is not None
                place.board.run(self.now)
                self._forward_wire(place)
            for place in alive:
                self._forward_can(place)

    def _level(self, source: Place, level: bool, time: int) -> None:
        for other in self.places.values():
            if other is not source and other.board is not None and other.wire is not None and other.wire == source.wire:
                other.board.pin(PIN_SYNC_IN, level, time)

    def _forward_wire(self, place: Place) -> None:
        assert place.board is not None
        pins = place.board.pins
        for time, pin, level in pins[place.pins :]:
            if pin == PIN_SYNC_OUT:
                self._level(place, level, time)
                if level:
                    self.edges.append((time, place.node))
        place.pins = len(pins)

    def _forward_can(self, place: Place) -> None:
        board = place.board
        assert board is not None
        for time, mailbox, identifier, data in board.requests[place.requests :]:
            self._bus_free = max(self._bus_free, self.now, time) + FRAME
            message = decode(identifier, data)
            assert message is not None
            if identifier >> 24 == SYNC_TYPE and place.node != self._first:
                last = max((at for at, node in self.edges if node == self._first), default=-LEADS_ALONE)
                self._first = place.node if self.now - last >= LEADS_ALONE else self._first
            if place.can is None:
                continue  # Nobody acknowledges.
            board.can_sent(mailbox, True, self._bus_free)
            self.frames.append((self._bus_free, place.node, message))
            for other in self.places.values():
                if other is not place and other.board is not None and other.can == place.can:
                    other.board.can_in(identifier, data, self._bus_free - BIT)
        place.requests = len(board.requests)

    def inject(self, identifier: int, data: bytes, at: int, to: int) -> None:
        """Let a frame of a stranger reach a board."""
        self.board(to).can_in(identifier, data, at)

    # What is seen.

    def messages(self, node: int, name: str) -> list[Message]:
        return self.board(node).messages(name)

    def counter(self, node: int, index: int) -> int:
        """Latest value of a counter that a board told; boards tell it once a second."""
        told = [m.signals["value"] for m in self.messages(node, "COUNTER") if m.index == index]
        return int(told[-1]) if told else 0

    def leaders(self, since: int) -> set[int]:
        """Nodes that sent SYNC since a time."""
        return {node for time, node, message in self.frames if message.name == "SYNC" and time > since}

    def drivers(self, since: int) -> set[int]:
        """Nodes that drove the wire since a time."""
        return {node for time, node in self.edges if time > since}

    def locked(self, node: int, last: int) -> list[int]:
        """What the latest cycles of a board told of its lock."""
        name = "EPOCH_STATUS" if node >= 100 else "DRIVE_STATUS"
        return [int(m.signals["locked"]) for m in self.messages(node, name)[-last:]]

    def chip_edges(self, node: int, since: int, until: int) -> NDArray[np.float64]:
        """Times at which the coil changed its sign in a span, s."""
        place = self.places[node]
        boards = [*place.past, *([place.board] if place.board else [])]
        times = [time for board in boards for pin in (PIN_BRIDGE_1, PIN_BRIDGE_2) for time in board.edges(pin)]
        return np.array(sorted({time for time in times if since < time <= until})) * 1e-12


def late_us(times_s: NDArray[np.float64], origin_s: float, ppm: float) -> NDArray[np.float64]:
    """Microseconds by which chip edges are later than the nearest chip of a time line with this crystal's error."""
    chip = chip_seconds(ppm)
    return np.asarray(1e6 * (times_s - origin_s - chip * np.round((times_s - origin_s) / chip)))


CYCLE = round(CHIPS * chip_seconds(0.0) * 1e12)

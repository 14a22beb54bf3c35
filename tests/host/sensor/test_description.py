"""A board tells its own table: on host boards and on the images that are flashed, over serial and over CAN."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace

import can
import numpy as np
import pytest

from goldfield.errors import SystemFailure
from goldfield.sensor import description
from goldfield.sensor.description import Description, describe
from goldfield_protocol import FrameDecoder, encode_frame
from goldfield_protocol.parameters import PARAMETERS
from tests.firmware.host_rig import ANCHOR, BEACON, MS, SECOND, SENSOR, Board

ROLES = {"beacon": BEACON, "sensor": SENSOR, "anchor": ANCHOR}
NODE = 9
Harm = Callable[[can.Message], bool]


class BoardLink:
    """A link to one board, whose time goes on only while an answer is awaited.

    Parameters
    ----------
    over_can : bool
        Requests and answers go over CAN, else over serial.
    lost : callable
        Says of each message of the board whether it is lost.
    """

    name = "a board"

    def __init__(self, board: Board, over_can: bool = False, lost: Harm = lambda message: False) -> None:
        self.board = board
        self.asked = 0
        self._over_can = over_can
        self._lost = lost
        self._decoder = FrameDecoder()
        self._serial_read = self._can_read = 0
        self._now = 0
        self._waiting: deque[can.Message] = deque()
        while self._now < 100 * MS:  # An image takes some of them to start, and its first messages must get away.
            self._now += MS
            board.run(self._now)
            self._collect()

    def send(self, identifier: int, data: bytes) -> None:
        self.asked += 1
        if self._over_can:
            self.board.can_in(identifier, data, self._now + MS)
        else:
            self.board.receive(encode_frame(identifier, data), self._now + MS)

    def monotonic(self) -> float:
        """Time of the board in seconds, in place of the wall clock."""
        return self._now / SECOND

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next message; None if none came in this time of the board."""
        end = self._now + max(MS, round(timeout_s * SECOND))
        while not self._waiting and self._now < end:
            self._now += MS
            self.board.run(self._now)
            self._collect()
        return self._waiting.popleft() if self._waiting else None

    def _collect(self) -> None:
        frames = [(f.identifier, f.data) for f in self._decoder.feed(bytes(b for _, b in self._new_serial()))]
        for _, mailbox, identifier, data in (requests := self.board.requests[self._can_read :]):
            self.board.can_sent(mailbox, True, self._now)
            frames += [(identifier, data)] if self._over_can else []
        self._can_read += len(requests)
        messages = [can.Message(arbitration_id=identifier, data=data) for identifier, data in frames]
        self._waiting += [message for message in messages if not self._lost(message)]

    def _new_serial(self) -> list[tuple[int, int]]:
        new = [] if self._over_can else self.board.serial[self._serial_read :]
        self._serial_read = len(self.board.serial)
        return new


def single(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def table_of(role: str) -> tuple[Description, ...]:
    """What parameters.toml says of a role."""
    return tuple(
        Description(
            id=p.first,
            name=p.name,
            kind=p.kind.name.lower(),
            unit=p.unit,
            low=single(p.low) if p.kind.name == "FLOAT" else p.low,
            high=single(p.high) if p.kind.name == "FLOAT" else p.high,
            default=single(p.default[0]) if p.kind.name == "FLOAT" else p.default[0],
            excluded=p.excluded,
            elements=p.group,
            rows=p.rows,
            stride=p.stride,
            at_start=p.at_start,
        )
        for p in PARAMETERS.values()
        if role in p.roles
    )


def board_of(role: str, emulated: bool) -> Board:
    return Board(ROLES[role], {"node": NODE}, emulated=emulated)


def told_by(link: BoardLink, node: int = NODE) -> tuple[Description, ...]:
    """What the board tells, in its own time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(description, "time", SimpleNamespace(monotonic=link.monotonic))
        return describe(link, node)


@pytest.mark.parametrize("over_can", [False, True], ids=["serial", "can"])
@pytest.mark.parametrize("emulated", [False, True], ids=["host", "emulated"])
@pytest.mark.parametrize("role", ROLES)
def test_the_table_told_is_that_of_the_file(role: str, emulated: bool, over_can: bool) -> None:
    board = board_of(role, emulated)
    link = BoardLink(board, over_can)
    told = told_by(link)
    board.close()
    assert told == table_of(role)
    assert link.asked == len(told) + 1


def test_a_message_that_is_lost_is_asked_for_again() -> None:
    """One in eleven of the messages that leave the board is lost, of whatever kind."""
    rng = np.random.default_rng(3)

    def lost(_: can.Message) -> bool:
        return bool(rng.random() < 1.0 / 11.0)

    board = board_of("sensor", False)
    link = BoardLink(board, lost=lost)
    told = told_by(link)
    board.close()
    assert told == table_of("sensor")
    assert link.asked > len(told) + 1


def test_a_board_that_is_not_there_is_told() -> None:
    board = board_of("beacon", False)
    with pytest.raises(SystemFailure, match="a board: node 77 did not describe its parameters from id 0 on in 5 tries"):
        told_by(BoardLink(board), 77)
    board.close()

"""Host boards with image slots on one CAN bus, or one of them on a serial line, as a link of the host in virtual time.

A board that restarts goes through its boot loader (`Node.boot`), and its next life runs what that chose.
"""

from __future__ import annotations

import contextlib
import io
from collections import deque
from collections.abc import Callable, Sequence
from typing import TextIO

import can

from goldfield.cli import main
from goldfield.link.buses import BusSource
from goldfield.link.line import FASTEST, Line, Link
from goldfield.nodes import conversation as conversations
from goldfield.nodes import opening
from goldfield_protocol import FrameDecoder, decode, encode_frame
from tests.firmware.core.boot.slots import Choice, Node, PowerLost
from tests.firmware.host_rig import MS, SECOND, SENSOR, Board
from tests.firmware.services.updated_board import UpdatedBoard

FRAME_BITS = 160
"""Bits of the longest frame of CAN, with the pause behind it, and of serial."""
STEP = 5 * MS
Filter = Callable[[str, int, int], bool]
"""It tells, by a message's name, its index and a board's place, whether the board hears it."""


class Seat:
    """A board through all its lives.

    Parameters
    ----------
    node : Node
        Its slots.
    number, place : int
        Its number, and which board it is.
    make : callable, optional
        It makes a board of a number and a unique id; by default a sensor.
    """

    def __init__(self, node: Node, number: int, place: int, make: Callable[[int, bytes], Board] | None = None) -> None:
        self.node, self.number, self.place = node, number, place
        self._make = make or (lambda number, unique: Board(SENSOR, {"node": number}, unique_id=unique))
        self.choices: list[Choice] = []
        self.hangs_in: int | None = None
        """The slot whose image does nothing, so that its watchdog strikes."""
        self.start(0)

    def start(self, now: int) -> None:
        """Let the boot loader choose, and run what it chose."""
        while True:
            try:
                choice = self.node.boot()
                break
            except PowerLost:
                pass
        assert choice is not None, "bricked"
        self.choices.append(choice)
        board = self.new_board()
        self.life = UpdatedBoard(self.node, choice.slot, board)
        if self.hangs_in == choice.slot:
            board.fail("MAIN_HANGS")
        self.began, self.taken, self.starts = now, 0, 0
        self.decoder = FrameDecoder()

    def new_board(self) -> Board:
        """Return the board without anything in its memory."""
        return self._make(self.number, bytes([self.place, *range(1, 12)]))

    def run(self, now: int) -> None:
        self.life.board.run(now - self.began)

    def local(self, time: int) -> int:
        """Return a time of the link as the board's own, which must not lie behind it."""
        return time - self.began

    def close(self) -> None:
        self.life.close()


class VirtualLink(BusSource):
    """A link in virtual time, which takes the place of a `BusSource` and, by its `monotonic`, of the module `time`.

    A subclass runs its boards in `_advance`, and puts what they send into ``_received``.
    """

    traffic = {}  # noqa: RUF012 - nothing is counted
    line = FASTEST[Link.CAN]
    step = STEP

    def __init__(self) -> None:
        self.now = 0
        self._received: deque[can.Message] = deque()

    def monotonic(self) -> float:
        return self.now / SECOND

    def receive(self, timeout_s: float) -> can.Message | None:
        until = self.now + max(1, round(timeout_s * SECOND))
        while not self._received and self.now < until:
            self._advance(min(self.now + self.step, until))
        return self._received.popleft() if self._received else None

    def close(self) -> None:
        """Let go of nothing."""

    def _advance(self, until: int) -> None:
        raise NotImplementedError

    def _hear(self, identifier: int, data: bytes, time: int) -> None:
        self._received.append(can.Message(timestamp=time / SECOND, arbitration_id=identifier, data=data))


class BoardsLink(VirtualLink):
    """Host boards through their restarts.

    Parameters
    ----------
    seats : sequence of Seat
    serial : bool
        The first board's serial line in place of the bus.
    hears : callable, optional
        Which messages reach which board.
    bit_rate : int, optional
        The link's, if it is not the fastest.

    Attributes
    ----------
    latest : int
        How long what the host sends has waited for the link at most.
    foreign : bool
        Whether heartbeats tell another protocol.
    gone : set of int
        Places of the boards whose cable is pulled.
    interrupt_at : int or None
        The block with which the user ends the command.
    """

    def __init__(
        self,
        seats: Sequence[Seat],
        *,
        serial: bool = False,
        hears: Filter = lambda *_: True,
        bit_rate: int | None = None,
    ) -> None:
        super().__init__()
        fastest = FASTEST[Link.SERIAL if serial else Link.CAN]
        self.name, self.shared, self.line = "bench", not serial, Line(fastest.link, bit_rate or fastest.bit_rate)
        self.frame = FRAME_BITS * SECOND // self.line.bit_rate
        self.latest = 0
        self.seats, self.serial, self.hears = list(seats), serial, hears
        self.bus = 0
        self.sent: list[str] = []
        self.interrupt_at: int | None = None
        self.foreign = False
        self.gone: set[int] = set()
        self._advance(50 * MS)
        self._received.clear()

    def send(self, identifier: int, data: bytes) -> None:
        message = decode(identifier, data)
        assert message is not None
        self.sent.append(message.name)
        if self.interrupt_at is not None and self.sent.count("UPDATE_DATA") >= self.interrupt_at:
            self.interrupt_at = None
            raise KeyboardInterrupt
        self.bus = max(self.bus, self.now) + self.frame
        self.latest = max(self.latest, self.bus - self.now)
        for seat in self.seats:
            if seat.place not in self.gone and self.hears(message.name, message.index, seat.place):
                time = seat.local(self.bus)
                if self.serial:
                    seat.life.board.receive(encode_frame(identifier, data), time)
                else:
                    seat.life.board.can_in(identifier, data, time)

    def advance(self, seconds: float) -> None:
        """Let time pass in which nobody listens."""
        until = self.now + round(seconds * SECOND)
        while self.now < until:
            self._advance(min(self.now + STEP, until))
        self._received.clear()

    def _advance(self, until: int) -> None:
        for seat in self.seats:
            seat.run(until)
            for identifier, data in self._told(seat, until):
                message = decode(identifier, data)
                seat.starts += message is not None and message.name == "HEARTBEAT" and message.signals["state"] == 0
                if seat.starts > 1:
                    break
                if seat.place in self.gone:
                    continue
                if self.foreign and message is not None and message.name == "HEARTBEAT":
                    data = bytes([data[0] ^ 1, *data[1:]])
                self._hear(identifier, data, until)
            hangs = seat.choices[-1].slot == seat.hangs_in and until - seat.began > SECOND // 2
            if seat.starts > 1 or seat.life.lost or hangs:
                seat.close()
                seat.start(until)
        self.now = until

    def _told(self, seat: Seat, now: int) -> list[tuple[int, bytes]]:
        if self.serial:
            new = seat.life.board.serial[seat.taken :]
            seat.taken += len(new)
            return [(f.identifier, f.data) for f in seat.decoder.feed(bytes(byte for _, byte in new))]
        new_requests = seat.life.board.requests[seat.taken :]
        seat.taken += len(new_requests)
        for _, mailbox, _, _ in new_requests:
            seat.life.board.can_sent(mailbox, True, seat.local(now))
        return [(identifier, data) for _, _, identifier, data in new_requests]


def run(monkeypatch, link: BusSource, *words: str, into: TextIO | None = None) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr of a command on a link; stdout is empty if it goes ``into`` a file."""
    monkeypatch.setattr(opening, "open_link", lambda *_: link)
    monkeypatch.setattr(conversations, "time", link)
    out, told = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(into or out), contextlib.redirect_stderr(told):
        code = main([*words, *(("--port", "/dev/x") if link.line.link is Link.SERIAL else ("--can", "socketcan:can0"))])
    return code, out.getvalue(), told.getvalue()

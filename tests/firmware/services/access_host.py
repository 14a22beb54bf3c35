"""A host on one link of a board that may have a key; the answers are computed by Python's own HMAC."""

from __future__ import annotations

import hmac
from dataclasses import dataclass, field

from goldfield_protocol.messages import Message, encode
from goldfield_protocol.parameters import PARAMETERS
from tests.firmware.host_rig import MS, SECOND, Board

KEY = bytes(range(0x30, 0x40))
OTHER_KEY = bytes(16 * [0xFF])
UNIQUE = bytes(range(12))
NAMED = int.from_bytes(UNIQUE[:6], "little") ^ int.from_bytes(UNIQUE[6:], "little")
RESET, CLEAR, SAVE, START, STOP, SIGNATURE, NUMBER, CHALLENGE, LOCK = 2, 3, 5, 6, 7, 8, 9, 16, 17
OK, REFUSED, OK_RESTARTS, LOCKED, WAIT, NO_RANDOM = 0, 2, 5, 16, 17, 18
PARAMETER_LOCKED = 5
SLOW = 2
WRONG_ANSWERS = 22
KEY_IDS = [PARAMETERS["access_key"].identifier(i) for i in range(4)]
ANSWER, IDLE, LONGEST = 5 * SECOND, 60 * SECOND, 600 * SECOND
TURN = 20 * MS
"""A board that does nothing else looks at its links at least each 10 ms; serial takes 0.1 ms more."""


def words(key: bytes) -> list[int]:
    return [int.from_bytes(key[i : i + 4], "little") for i in range(0, 16, 4)]


def tag(number: int, key: bytes = KEY, unique: bytes = UNIQUE) -> int:
    """The answer, from the sentence in framing.md."""
    message = b"goldfield access 1" + unique + number.to_bytes(8, "little")
    return int.from_bytes(hmac.digest(key, message, "sha512")[:8], "little")


@dataclass
class Clock:
    """The present of a board, and how many of its frames were acknowledged."""

    now: int = SECOND
    acknowledged: int = 0


@dataclass
class Host:
    """Somebody on one link of a board."""

    board: Board
    can: bool = False
    node: int = 9
    clock: Clock = field(default_factory=Clock)

    @property
    def now(self) -> int:
        return self.clock.now

    def on_can(self) -> Host:
        """Somebody on the other link of this board."""
        return Host(self.board, True, self.node, self.clock)

    def send(self, name: str, index: int, signals: dict[str, float], node: int | None = None) -> list[Message]:
        """Send a message, and return what the board says on this link within a turn."""
        self._run(self.now)
        before = len(self._heard())
        to = self.node if node is None else node
        if self.can:
            self.board.can_in(*encode(name, signals, node=to, index=index), self.now)
        else:
            self.board.send_serial(name, signals, to, index, self.now)
        self._run(self.now + TURN)
        said = ("PARAM_VALUE", "COMMAND_ANSWER", "ACCESS", "IDENTITY", "PARAM_DESCRIPTION")
        return [m for m in self._heard()[before:] if m.name in said]

    def _heard(self) -> list[Message]:
        return self.board.can_messages() if self.can else self.board.messages()

    def _run(self, until: int) -> None:
        """Run the board; somebody on the bus acknowledges its frames."""
        while True:
            at = min(self.now + 2 * MS, until) if self.can else until
            self.board.run(at)
            for _, mailbox, _, _ in self.board.requests[self.clock.acknowledged :]:
                self.board.can_sent(mailbox, True, at)
            self.clock.acknowledged = len(self.board.requests)
            self.clock.now = max(at, self.now)
            if at >= until:
                break

    def command(self, index: int, argument: int = 0, named: int = NAMED, node: int | None = None) -> int | None:
        """The status of the answer, None if there is none."""
        said = self.send("COMMAND", index, {"board": named, "argument": argument}, node)
        return next((int(m.signals["status"]) for m in said if m.name == "COMMAND_ANSWER"), None)

    def put(self, identifier: int, value: int, node: int | None = None) -> tuple[int, int]:
        """Status and value of the answer."""
        (answer,) = self.send("PARAM_SET", identifier, {"kind": 0, "value_unsigned": value}, node)
        return int(answer.signals["status"]), int(answer.signals["value_unsigned"])

    def get(self, identifier: int) -> int:
        (answer,) = self.send("PARAM_GET", identifier, {"reserved": 0})
        return int(answer.signals["value_unsigned"])

    def changes(self) -> bool:
        """Whether a parameter that does no harm may be set."""
        status, _ = self.put(PARAMETERS["group"].first, 7)
        assert status in (0, PARAMETER_LOCKED)
        return status == 0

    def challenge(self) -> int:
        (said,) = self.send("COMMAND", CHALLENGE, {"board": NAMED, "argument": 0})
        assert (said.name, said.index) == ("ACCESS", 0)
        return self.number_of(said)

    def number_of(self, said: Message) -> int:
        return int(said.signals["high"]) << 32 | int(said.signals["low"])

    def answer(self, value: int) -> int | None:
        said = self.send("ACCESS", 1, {"low": value & 0xFFFFFFFF, "high": value >> 32})
        assert all(m.index == CHALLENGE for m in said)
        return int(said[0].signals["status"]) if said else None

    def unlock(self, key: bytes = KEY) -> int | None:
        return self.answer(tag(self.challenge(), key))

    def wait(self, until: int) -> None:
        self._run(until)

    def counted(self) -> int:
        self.wait(self.now + 1100 * MS)
        told = [m.signals["value"] for m in self.board.messages("COUNTER") if m.index == WRONG_ANSWERS]
        return int(told[-1]) if told else 0

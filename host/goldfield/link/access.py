"""Unlocking a board that has a key: the challenge and response of ``framing.md``.

Boards of a site share a key of 128 bits. It is on the link only when it is set; what unlocks a board is the keyed hash
of a number that the board has just made up.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Protocol

from goldfield.errors import SystemFailure, option
from goldfield.link.access_key import AccessKey
from goldfield.link.requests import ANSWER_S, LOCKED
from goldfield_protocol.messages import Identifier, Message, encode, type_of
from goldfield_protocol.parameters import PARAMETERS

KEY = PARAMETERS["access_key"]
IDENTITY, CHALLENGE, LOCK = 0, 16, 17
"""Numbers of the commands, the index of ``COMMAND``."""
FROM_BOARD, TO_BOARD = 0, 1
"""Indices of ``ACCESS``."""
OK, REFUSED, COMMAND_LOCKED, WAIT, NO_RANDOM = 0, 2, 16, 17, 18
"""Statuses of ``COMMAND_ANSWER``."""
TRIES = 3
LATE_S = 4.0
"""An answer that was later than this may have been refused for that: a board takes it for 5 s."""
PATIENCE_S = 10.0
"""How long a board is waited for that was given wrong answers: it takes none for up to 8 s."""
LOOK_AGAIN_S = 0.25


class Locked(SystemFailure):
    """A board is locked, and there is no key, or not the right one."""


def board_of(unique_id: str) -> int:
    """Return what names a board in a ``COMMAND``: the exclusive or of the halves of its unique id.

    Examples
    --------
    >>> hex(board_of("0102030405060000000000ff"))
    '0xf90504030201'
    """
    whole = bytes.fromhex(unique_id)
    return int.from_bytes(whole[:6], "little") ^ int.from_bytes(whole[6:], "little")


def is_locked(answer: Message) -> bool:
    """Return whether a board refuses a request because it is locked."""
    return int(answer.signals.get("status", OK)) == {"PARAM_VALUE": LOCKED, "COMMAND_ANSWER": COMMAND_LOCKED}.get(
        answer.name
    )


def holds_key(identifier: int) -> bool:
    """Return whether a message sets a part of a key, which is to be recorded by nobody.

    Examples
    --------
    >>> holds_key(0x0C036007), holds_key(0x0C035007), holds_key(0x0D036007)
    (True, False, False)
    """
    fields = Identifier.unpack(identifier)
    return fields.type == type_of("PARAM_SET") and KEY.first <= fields.index < KEY.first + KEY.count


class Asker(Protocol):
    """Somebody on a link who can ask its boards."""

    @property
    def name(self) -> str:
        """The link's name, for messages."""
        ...

    def send(self, identifier: int, data: bytes) -> None:
        """Send a message."""
        ...

    def wait(self, take: Callable[[Message], bool], seconds: float) -> bool:
        """Hand what comes to a function until it returns True, or the time is over; return whether it did."""
        ...


def unlock(asker: Asker, node: int, unique_id: str | None, key: AccessKey | None) -> str:
    """Unlock a board for changes on this link.

    Parameters
    ----------
    asker : Asker
    node : int
        Its number.
    unique_id : str or None
        Its unique id, 24 hexadecimal digits; None: it is asked for it.
    key : AccessKey or None

    Returns
    -------
    str
        The unique id.

    Raises
    ------
    Locked
        If there is no key, or the board has another one.
    SystemFailure
        If the board does not answer.
    """
    who = f"{asker.name}: node {node}"
    if key is None:
        raise Locked(
            f"{who} is locked, so that it is read but not changed: give its site's key, {option('key', 'FILE')}"
        )
    own = _unique_id(asker, node) if unique_id is None else unique_id
    begin_s = time.monotonic()
    tries = 0
    while tries < TRIES:
        asked_s = time.monotonic()
        said = _answered(asker, node, encode("COMMAND", _named(own), node=node, index=CHALLENGE))
        if said is not None and said.name == "ACCESS":
            number = int(said.signals["high"]) << 32 | int(said.signals["low"])
            answer = key.answer(number, bytes.fromhex(own))
            signals = {"low": answer & 0xFFFFFFFF, "high": answer >> 32}
            said = _answered(asker, node, encode("ACCESS", signals, node=node, index=TO_BOARD), challenge=False)
        status = None if said is None else int(said.signals["status"])
        if status == OK:
            return own
        if status == NO_RANDOM:
            raise Locked(f"{who} cannot be unlocked, as its processor has no random numbers: power it off and on")
        if status == WAIT and time.monotonic() < begin_s + PATIENCE_S:
            asker.wait(lambda _: False, LOOK_AGAIN_S)
            continue
        if status == WAIT:
            raise Locked(f"{who} was given wrong answers, and takes none for up to 8 s: see who else is on its link")
        if status == REFUSED and time.monotonic() - asked_s < LATE_S:
            raise Locked(f"{who} has another key than that of {key.file}: give the one that it was set to")
        tries += 1
    raise SystemFailure(f"{who} did not answer when it was to be unlocked, in {TRIES} tries")


def lock_request(unique_id: str) -> tuple[int, bytes]:
    """Return identifier and data of the message that locks a board on the link it comes by, whatever its number is."""
    return encode("COMMAND", _named(unique_id), node=0, index=LOCK)


def _named(unique_id: str) -> Mapping[str, float]:
    return {"board": board_of(unique_id), "argument": 0}


def _answered(asker: Asker, node: int, request: tuple[int, bytes], *, challenge: bool = True) -> Message | None:
    """Send a request, and return the challenge, or what became of it; None if neither comes in time."""
    found: list[Message] = []

    def take(message: Message) -> bool:
        told = (message.name, message.index)
        if message.node == node and (
            told == ("COMMAND_ANSWER", CHALLENGE) or (challenge and told == ("ACCESS", FROM_BOARD))
        ):
            found.append(message)
        return bool(found)

    asker.send(*request)
    asker.wait(take, ANSWER_S)
    return found[0] if found else None


def _unique_id(asker: Asker, node: int) -> str:
    halves: dict[int, dict[int, int]] = {}

    def whole() -> Iterator[dict[int, int]]:
        return (pair for pair in halves.values() if len(pair) == 2)

    def take(message: Message) -> bool:
        if message.name == "IDENTITY" and message.node == node:
            halves.setdefault(int(message.signals["tag"]), {})[message.index] = int(message.signals["half"])
        return any(whole())

    for _ in range(TRIES):
        asker.send(*encode("COMMAND", {"board": 0, "argument": 0}, node=node, index=IDENTITY))
        if asker.wait(take, ANSWER_S):
            pair = next(whole())
            return (pair[0].to_bytes(6, "little") + pair[1].to_bytes(6, "little")).hex()
    raise SystemFailure(f"{asker.name}: node {node} does not tell its unique id, in {TRIES} tries")

"""What a workload is: a board in a warm state, what is done to it from there, and how its fate is judged."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from cantools.database.errors import Error as DatabaseError

from goldfield_protocol import FrameDecoder, Message, RawFrame, decode
from goldfield_protocol.messages import database
from hil_sim.clib import ROOT
from hil_sim.emulator.emulator import Emulator
from tests.firmware.host_rig import Board

BEACON_IMAGE = ROOT / "build/firmware/beacon.elf"
NOTHING, SAID, WRONG, DANGEROUS = "no effect", "said", "silently wrong", "dangerous"
VERDICTS = (NOTHING, SAID, WRONG, DANGEROUS)
Seen = dict[str, Any]
"""What was seen of a board: numbers, words and lists of them."""


@dataclass(frozen=True)
class Verdict:
    """What became of a board, and why that is thought."""

    verdict: str
    why: str = ""


class Workload(Protocol):
    """One board's work. It is started once, and each trial goes on with a copy of the process.

    Attributes
    ----------
    name : str
    image : Path
        The ELF file in whose code upsets strike.
    modules : tuple of str
        Those of its modules that matter here.
    begin : int
        When the first upset may strike, ps.
    """

    name: str
    image: Path
    modules: tuple[str, ...]
    begin: int

    def start(self) -> Any:
        """Return the bench of the workload, at its beginning."""

    def chip(self, bench: Any) -> Emulator:
        """Return the chip that an upset strikes."""

    def observe(self, bench: Any) -> Seen:
        """Let the work come to its end, and return what was seen."""

    def judge(self, seen: Seen, sound: Seen) -> Verdict:
        """Judge what was seen, beside what is seen of a board that nothing has struck."""


@dataclass
class Told:
    """What a board has said on its serial port, whatever state it is in."""

    causes: list[str]
    headroom_lost: bool
    resets: int
    crashed: bool
    values: list[tuple[int, int, int]]
    answers: list[tuple[int, int]]
    state: str
    messages: int

    def as_seen(self) -> Seen:
        """Return it as plain values."""
        return asdict(self)


def used_message(frame: RawFrame) -> Message | None:
    """Return the message of a frame; None: it is none, whatever its check says."""
    try:
        return decode(frame.identifier, frame.data)
    except (DatabaseError, ValueError):
        return None


def messages_of(board: Board, since: int = 0) -> list[Message]:
    """Return the messages of a board's serial port, whatever else came out of it."""
    decoder = FrameDecoder()
    stream = bytes(byte for time, byte in board.serial if time >= since)
    return [message for frame in decoder.feed(stream) if (message := used_message(frame))]


def _word(message: Message, signal: str) -> str:
    choices = database().get_message_by_name(message.name).get_signal_by_name(signal).choices or {}
    return str(choices.get(int(message.signals[signal]), "unknown"))


def told(board: Board, since: int = 0) -> Told:
    """Return what a board has said since a time."""
    messages = messages_of(board, since)
    stream = bytes(byte for time, byte in board.serial if time >= since)
    health = [_word(m, "cause") for m in messages if m.name == "DRIVE_HEALTH"]
    states = [_word(m, "state") for m in messages if m.name == "HEARTBEAT"]
    return Told(
        causes=[cause for cause in dict.fromkeys(health) if cause != "none"],
        headroom_lost=any(m.signals["headroom_lost"] for m in messages if m.name == "DRIVE_HEALTH"),
        resets=sum(m.name == "RESET_REPORT" and m.index == 0 for m in messages),
        crashed=b"crash pc=" in stream,
        values=[
            (m.index, int(m.signals["status"]), next(round(v * 1024) for k, v in m.signals.items() if "value" in k))
            for m in messages
            if m.name == "PARAM_VALUE"
        ],
        answers=[(m.index, int(m.signals["status"])) for m in messages if m.name == "COMMAND_ANSWER"],
        state=states[-1] if states else "",
        messages=len(messages),
    )

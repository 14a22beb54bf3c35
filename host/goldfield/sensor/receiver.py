"""The messages of a source, decoded: those that a session uses, from nodes that speak this host's protocol."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

import can
from cantools.database.errors import Error as DatabaseError

from goldfield.errors import UserError, tell
from goldfield.link.access import holds_key
from goldfield.link.buses import BusSource, Source
from goldfield.link.heartbeat import ROLES
from goldfield.link.marks import mark
from goldfield.link.reports import ON_SENSOR_POSE
from goldfield.link.traffic import (
    BY_MISMATCH,
    MEANINGLESS,
    OTHER_CHANNEL,
    OTHER_PROTOCOL,
    added,
    damaged,
    no_traffic,
)
from goldfield_protocol.messages import Identifier, Message, decode, mismatch, protocol_hash, type_of

USED = (
    "EPOCH",
    "EPOCH_STATUS",
    "EPOCH_OFFSET",
    "FIELD",
    "BLOCK",
    "BLOCK_SUM",
    "CHIP",
    "HEARTBEAT",
    "COUNTER",
    "PARAM_VALUE",
    "PARAM_SET",
    "SYNC",
    "DRIVE_STATUS",
    *ON_SENSOR_POSE,
)
USED_TYPES = {type_of(name) for name in USED}
TO_NODES = ("PARAM_SET",)
"""Messages whose node is the receiver's, not the sender's."""

STALE_S = 10.0
"""A stamp that is older is of another clock than the wall's: some interfaces count from their own start."""


class Recorder(Protocol):
    """Keeps every message that a source delivers, as it came."""

    def write(self, message: can.Message, /) -> None:
        """Take the next message; it must not raise for a medium that fails."""
        ...

    def close(self) -> None:
        """End the recording."""
        ...


class Receiver:
    """Receives from one source.

    Parameters
    ----------
    source : Source
    name : str
        The link's name, for error messages.
    recorder : Recorder, optional
        Gets every message received, whether it can be decoded or not, and the marks between them; but for those that
        set a board's key.
    listener : callable, optional
        Is told of every message of the `USED` ones, before it is returned.

    Attributes
    ----------
    node : int or None
        The node that is read: it must speak this host's protocol.
    channel : str or None
        Messages of other channels are left out; None: all are taken.
    arrived_s : float
        Time of the wall clock at which the latest message arrived, in a recording that which it tells.
    taken_cpu_s : float
        Processor time of this process when the latest message was taken; NaN in a recording.
    """

    def __init__(
        self,
        source: Source,
        name: str,
        recorder: Recorder | None = None,
        listener: Callable[[Message], None] | None = None,
    ) -> None:
        self.name = name
        self.node: int | None = None
        self.channel: str | None = None
        self.arrived_s = self.taken_cpu_s = math.nan
        self._traffic = no_traffic()
        self._source = source
        self._live = isinstance(source, BusSource)
        self._recorder = recorder
        self._listener = listener
        self._ahead: deque[can.Message] = deque()
        self._strangers: set[int] = set()
        self._told: set[str] = set()
        self._marks: list[int | None] = []

    @property
    def traffic(self) -> Mapping[str, int]:
        """What came and is no message of boards with this host's protocol, by kind (`goldfield.link.traffic`)."""
        return added(self._source.traffic, self._traffic)

    @property
    def bad_frames(self) -> int:
        """Frames so far that were damaged: corrupt, unreadable, of a wrong length or without a meaning."""
        return damaged(self.traffic)

    def tell_once(self, text: str) -> None:
        """Tell the user something of the link, on stderr; the same text a second time is not told."""
        if text not in self._told:
            self._told.add(text)
            tell(f"{self.name}: {text}")

    def forget(self, text: str) -> None:
        """Tell a text again the next time that `tell_once` gets it."""
        self._told.discard(text)

    def receive_raw(self, timeout_s: float) -> can.Message | None:
        """Return the next message as it came, None when none came in time or, for a log, at its end."""
        again = bool(self._ahead)
        raw = self._ahead.popleft() if again else self._source.receive(timeout_s)
        if raw is not None:
            self.arrived_s = _arrival_s(raw.timestamp) if self._live else raw.timestamp
            self.taken_cpu_s = time.process_time() if self._live else math.nan
        if raw is not None and not again and self._recorder is not None:
            for node in self._marks:
                self._recorder.write(mark(node, raw.timestamp))
            self._marks.clear()
            if not holds_key(raw.arbitration_id):
                self._recorder.write(raw)
        return raw

    def mark(self, node: int | None) -> None:
        """Note in the recording that the reports of a node are read from the next message on; None: nobody's."""
        if self._marks[-1:] != [node]:  # one that is waited for is started again and again
            self._marks.append(node)

    def put_back(self, messages: Iterable[can.Message]) -> None:
        """Let messages that were received be received again, in their order, before all others."""
        self._ahead.extendleft(reversed(list(messages)))

    def receive(self, timeout_s: float) -> Message | None:
        """Return the next message; None too for one that is not used."""
        raw = self.receive_raw(timeout_s)
        return None if raw is None else self.decoded(raw)

    def decoded(self, raw: can.Message) -> Message | None:
        """Decode a message of the `USED` ones; None for any other, which is counted if it is none of ours.

        Raises
        ------
        UserError
            If it is the heartbeat of the node that is read, which speaks another protocol.
        """
        fault = mismatch(raw.arbitration_id, len(raw.data))
        if fault is not None:
            self._traffic[BY_MISMATCH[fault]] += 1
            return None
        if self.channel is not None and channel_of(raw) != self.channel:
            self._traffic[OTHER_CHANNEL] += 1
            return None
        message = used_message(raw)
        if message is None:
            self._traffic[MEANINGLESS] += Identifier.unpack(raw.arbitration_id).type in USED_TYPES
            return None
        if message.name == "HEARTBEAT":
            self._check_protocol(message)
        if message.node in self._strangers and message.name not in TO_NODES:
            self._traffic[OTHER_PROTOCOL] += 1
            return None
        if self._listener is not None:
            self._listener(message)
        return message

    def _check_protocol(self, heartbeat: Message) -> None:
        fault = other_protocol(heartbeat, live=self._live)
        if fault is None:
            self._strangers.discard(heartbeat.node)
            return
        if heartbeat.node == self.node:
            raise UserError(f"{self.name}: {fault}")
        self._strangers.add(heartbeat.node)
        self.tell_once(f"{fault}; until then it is ignored" if self._live else f"{fault}; here it is ignored")


def _arrival_s(stamp_s: float) -> float:
    """Return when a message arrived: its own stamp, if that is one of the wall clock's and of late, else now."""
    now_s = time.time()
    return stamp_s if now_s - STALE_S < stamp_s <= now_s else now_s


def channel_of(raw: can.Message) -> str | None:
    """Return the channel that a message came on, None if its source tells none."""
    return None if raw.channel is None else str(raw.channel)


def used_message(raw: can.Message) -> Message | None:
    """Decode a message of the `USED` ones; None for any other frame."""
    if Identifier.unpack(raw.arbitration_id).type not in USED_TYPES:
        return None
    try:
        return decode(raw.arbitration_id, bytes(raw.data))
    except (DatabaseError, ValueError):
        return None


def other_protocol(heartbeat: Message, *, live: bool) -> str | None:
    """Return what to do with a node, or a recording of it, of another protocol than this host's; None if it is this."""
    theirs, ours = int(heartbeat.signals["protocol_hash"]), protocol_hash()
    if theirs == ours:
        return None
    role = ROLES[int(heartbeat.signals["role"])]
    version = ".".join(str(int(heartbeat.signals[f"version_{part}"])) for part in ("major", "minor", "patch"))
    what = (
        f"node {heartbeat.node} ({role}, firmware {version}) speaks protocol {theirs:#010x} and this host {ours:#010x}"
    )
    if not live:
        return f"{what}: read the recording with the version of goldfield that made it"
    return f"{what}: flash it with the {role} firmware of this host's version (make flash ROLE={role})"

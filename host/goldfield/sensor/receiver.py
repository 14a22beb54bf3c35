"""The messages of a source, decoded: those that a session uses, from nodes that speak this host's protocol."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import can
from cantools.database.errors import Error as DatabaseError

from goldfield.errors import UserError
from goldfield.link.buses import Source
from goldfield.link.reports import ON_SENSOR_POSE
from goldfield_protocol.messages import Identifier, Message, database, decode, protocol_hash

ROLES = {0: "beacon", 1: "sensor", 2: "host", 3: "anchor"}
"""What a node is, by the number in its heartbeat."""

USED = (
    "EPOCH",
    "EPOCH_STATUS",
    "EPOCH_OFFSET",
    "FIELD",
    "PART",
    "HEARTBEAT",
    "COUNTER",
    "PARAM_VALUE",
    "SYNC",
    "DRIVE_STATUS",
    *ON_SENSOR_POSE,
)
USED_TYPES = {Identifier.unpack(database().get_message_by_name(name).frame_id).type for name in USED}


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
        Gets every message received, whether it can be decoded or not.
    listener : callable, optional
        Is told of every message of the `USED` ones, before it is returned.

    Attributes
    ----------
    undecodable : int
        Messages that the protocol's database does not explain.
    """

    def __init__(
        self,
        source: Source,
        name: str,
        recorder: Recorder | None = None,
        listener: Callable[[Message], None] | None = None,
    ) -> None:
        self.name = name
        self.undecodable = 0
        self._source = source
        self._recorder = recorder
        self._listener = listener

    @property
    def bad_frames(self) -> int:
        """Frames that the link dropped as corrupt, and messages that say nothing by the protocol's database."""
        return self._source.bad_frames + self.undecodable

    def receive_raw(self, timeout_s: float) -> can.Message | None:
        """Return the next message as it came, None when none came in time or, for a log, at its end."""
        raw = self._source.receive(timeout_s)
        if raw is not None and self._recorder is not None:
            self._recorder.write(raw)
        return raw

    def receive(self, timeout_s: float) -> Message | None:
        """Return the next message; None too for one that is not used."""
        raw = self.receive_raw(timeout_s)
        return None if raw is None else self.decoded(raw)

    def decoded(self, raw: can.Message) -> Message | None:
        """Decode a message of the `USED` ones; None for any other.

        Raises
        ------
        UserError
            If it is the heartbeat of a node that speaks another protocol.
        """
        if Identifier.unpack(raw.arbitration_id).type not in USED_TYPES:
            return None
        try:
            message = decode(raw.arbitration_id, bytes(raw.data))
        except (DatabaseError, ValueError):
            message = None
        if message is None:
            self.undecodable += 1
            return None
        if message.name == "HEARTBEAT":
            self._check_protocol(message)
        if self._listener is not None:
            self._listener(message)
        return message

    def _check_protocol(self, heartbeat: Message) -> None:
        theirs, ours = int(heartbeat.signals["protocol_hash"]), protocol_hash()
        if theirs == ours:
            return
        role = ROLES.get(int(heartbeat.signals["role"]), "unknown")
        version = ".".join(str(int(heartbeat.signals[f"version_{part}"])) for part in ("major", "minor", "patch"))
        raise UserError(
            f"{self.name}: node {heartbeat.node} ({role}, firmware {version}) speaks protocol {theirs:#010x} and this "
            f"host {ours:#010x}: flash it with the {role} firmware of this host's version (make flash ROLE={role})"
        )

"""What a board tells of its own parameters: names, kinds, units, ranges and defaults, without this host's table.

A host and a board of different versions can so understand each other's parameters, and a tool can list what a board
takes. ``protocol/framing.md``, "Descriptions", has the dialogue.
"""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass
from typing import Protocol

import can

from goldfield.errors import SystemFailure
from goldfield.link.requests import ANSWER_S
from goldfield.sensor.dialogue import TRIES
from goldfield_protocol.messages import Message, decode, encode

NO_FURTHER = 3
"""Value of ``PARAM_DESCRIPTION.kind`` behind the last parameter."""
_KINDS = {0: ("unsigned", "<I"), 1: ("signed", "<i"), 2: ("float", "<f")}
_ANSWERS = ("PARAM_DESCRIPTION", "PARAM_RANGE", "PARAM_TEXT")


class Link(Protocol):
    """A link to boards, such as `goldfield.link.buses.BusSource`."""

    @property
    def name(self) -> str:
        """Name for messages."""
        ...

    def send(self, identifier: int, data: bytes) -> None:
        """Send a message."""
        ...

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next message, None if none came in time."""
        ...


@dataclass(frozen=True)
class Description:
    """One parameter as a board describes it.

    Parameters
    ----------
    id : int
        Id of the first element.
    name : str
    kind : str
        ``"unsigned"``, ``"signed"`` or ``"float"``.
    unit : str
        Unit, empty for a plain number; of an array with mixed units, those of a row with commas between them.
    low, high : int or float
        Allowed range of each element, both included.
    default : int or float
        Default of the first element.
    excluded : int or None
        A value of the range that the board refuses all the same.
    elements, rows, stride : int
        Elements of a row, number of rows, and ids from one row to the next.
    at_start : bool
        True if a change acts after the next reset only.
    """

    id: int
    name: str
    kind: str
    unit: str
    low: int | float
    high: int | float
    default: int | float
    excluded: int | None
    elements: int
    rows: int
    stride: int
    at_start: bool


def describe(link: Link, node: int) -> tuple[Description, ...]:
    """Ask a board for the table of the parameters that it uses.

    Parameters
    ----------
    link : Link
        Messages of other kinds that come in the meantime are lost.
    node : int
        Number of the board: a beacon, a sensor or an anchor.

    Returns
    -------
    tuple of Description
        One for each parameter, in the order of their ids.

    Raises
    ------
    SystemFailure
        If the board does not answer a request in `TRIES` tries.
    """
    table: list[Description] = []
    description = _ask(link, node, 0)
    while description is not None:
        table.append(description)
        description = _ask(link, node, description.id + 1)
    return tuple(table)


def _ask(link: Link, node: int, identifier: int) -> Description | None:
    """Return the description of the first parameter from an id on, None if there is none."""
    for _ in range(TRIES):
        link.send(*encode("PARAM_DESCRIBE", {"reserved": 0}, node=node, index=identifier))
        answer = _Answer(identifier)
        deadline = time.monotonic() + ANSWER_S
        while not answer.complete and (remaining := deadline - time.monotonic()) > 0.0:
            raw = link.receive(remaining)
            message = None if raw is None else decode(raw.arbitration_id, bytes(raw.data))
            if message is not None and message.node == node and message.name in _ANSWERS:
                answer.take(message)
        if answer.complete:
            return answer.description()
    raise SystemFailure(
        f"{link.name}: node {node} did not describe its parameters from id {identifier} on in {TRIES} tries: "
        "check that it is there, and that its firmware is of this host's version"
    )


class _Answer:
    """The messages that describe one parameter, in whatever order and however often they come."""

    def __init__(self, asked: int) -> None:
        self._asked = asked
        self._numbers: dict[str, Message] = {}
        self._parts: dict[int, bytes] = {}
        self._length: int | None = None

    def take(self, message: Message) -> None:
        """Take a message; one that belongs to another request is left out."""
        first = self._numbers.get("PARAM_DESCRIPTION")
        if message.name == "PARAM_DESCRIPTION":
            if message.index >= self._asked:
                self._numbers, self._parts, self._length = {message.name: message}, {}, None
        elif first is not None and message.index == first.index:
            if message.name == "PARAM_RANGE":
                self._numbers[message.name] = message
                return
            part = int(message.signals["part"])
            low, high = (int(message.signals[f"characters_{which}"]) for which in ("0_to_3", "4_to_6"))
            self._parts[part] = low.to_bytes(4, "little") + high.to_bytes(3, "little")
            if message.signals["last"]:
                self._length = part + 1

    @property
    def complete(self) -> bool:
        """True if nothing is missing."""
        first = self._numbers.get("PARAM_DESCRIPTION")
        if first is None:
            return False
        if first.signals["kind"] == NO_FURTHER:
            return True
        return "PARAM_RANGE" in self._numbers and self._length is not None and len(self._parts) >= self._length

    def description(self) -> Description | None:
        """Return what the messages say, None if there is no further parameter."""
        first = self._numbers["PARAM_DESCRIPTION"]
        if first.signals["kind"] == NO_FURTHER:
            return None
        kind, layout = _KINDS[int(first.signals["kind"])]
        limits = self._numbers["PARAM_RANGE"].signals
        text = b"".join(self._parts[i] for i in sorted(self._parts)).rstrip(b"\0").decode("ascii", "replace")
        name, _, unit = text.partition(" ")

        def number(bits: float) -> int | float:
            value: int | float = struct.unpack(layout, struct.pack("<I", int(bits)))[0]
            return value

        return Description(
            id=first.index,
            name=name,
            kind=kind,
            unit=unit,
            low=number(limits["minimum"]),
            high=number(limits["maximum"]),
            default=number(first.signals["value_default"]),
            excluded=int(first.signals["excluded"]) or None,
            elements=int(first.signals["elements"]),
            rows=int(first.signals["rows"]),
            stride=int(first.signals["stride"]),
            at_start=bool(first.signals["at_start"]),
        )

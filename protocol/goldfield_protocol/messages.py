"""Messages of ``goldfield.dbc``: identifiers, packing, unpacking and the protocol hash."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache
from importlib import resources
from typing import NamedTuple

import cantools
from cantools.database import Database
from cantools.database.can import Signal

DBC = resources.files("goldfield_protocol") / "goldfield.dbc"
"""The file of all messages, which is shipped with the package."""

TYPE_SHIFT = 24
INDEX_SHIFT = 12
INDEX_MASK = 0xFFF
NODE_MASK = 0xFFF
TYPE_MASK = 0x1F << TYPE_SHIFT

BROADCAST_NODE = 0
"""Node 0 is the host; a PARAM_SET or PARAM_GET to node 0 addresses every node."""


@dataclass(frozen=True)
class Identifier:
    """The three fields of a 29-bit identifier.

    Parameters
    ----------
    type : int
        Message type, 0..31; the lower wins the bus.
    index : int
        Code index, chip, parameter or counter, 0..4095.
    node : int
        Sender (of PARAM_SET and PARAM_GET: receiver), 0..4095.
    """

    type: int
    index: int
    node: int

    @classmethod
    def unpack(cls, value: int) -> Identifier:
        """Split a 29-bit identifier."""
        return cls(value >> TYPE_SHIFT & 0x1F, value >> INDEX_SHIFT & INDEX_MASK, value & NODE_MASK)

    def pack(self) -> int:
        """Join the fields to a 29-bit identifier."""
        if not (0 <= self.type < 32 and 0 <= self.index <= INDEX_MASK and 0 <= self.node <= NODE_MASK):
            raise ValueError(f"{self} does not fit a 29-bit identifier (type < 32, index and node < 4096)")
        return self.type << TYPE_SHIFT | self.index << INDEX_SHIFT | self.node


@dataclass(frozen=True)
class Message:
    """A decoded message: its name in the DBC, who sent it, its index and its signals in physical units."""

    name: str
    node: int
    index: int
    signals: Mapping[str, float]


@cache
def database() -> Database:
    """Return the parsed ``goldfield.dbc`` (identifiers masked to the type)."""
    loaded = cantools.database.load_string(DBC.read_text(encoding="ascii"), "dbc", frame_id_mask=TYPE_MASK)
    assert isinstance(loaded, Database)
    return loaded


@cache
def protocol_hash() -> int:
    """Return the 32-bit version of the protocol: a hash of everything in the DBC that affects bytes.

    Comments and value names do not count; identifiers, names, positions, scales and multiplexing do.
    """
    layout = [
        [
            message.frame_id,
            message.name,
            message.length,
            [
                [
                    signal.name,
                    signal.start,
                    signal.length,
                    signal.byte_order,
                    signal.is_signed,
                    signal.is_float,
                    float(signal.scale),
                    float(signal.offset),
                    signal.multiplexer_ids,
                ]
                for signal in sorted(message.signals, key=lambda s: s.name)
            ],
        ]
        for message in sorted(database().messages, key=lambda m: m.frame_id)
    ]
    digest = hashlib.sha256(json.dumps(layout, separators=(",", ":")).encode()).digest()
    return int.from_bytes(digest[:4], "little")


class Mismatch(Enum):
    """Why a frame is none of the database's messages, whatever its bytes are."""

    FOREIGN = "foreign"
    """No message has this type, or the message of this type has no such index: somebody else's frame."""
    LENGTH = "length"
    """The message of this type and index has another number of bytes."""


@dataclass(frozen=True)
class Shape:
    """What every frame of one message has: how many bytes, and an index that is at most so large.

    Parameters
    ----------
    length : int
        Bytes of data.
    largest_index : int
        The attribute ``LargestIndex`` of the message.
    """

    length: int
    largest_index: int


@cache
def shapes() -> Mapping[int, Shape]:
    """Return the shape of each message by its type, 0..31; the firmware's table is generated from the same."""
    found = {}
    for message in database().messages:
        assert message.dbc is not None
        attribute = message.dbc.attributes.get("LargestIndex")
        largest = int(attribute.value) if attribute is not None else 0
        found[Identifier.unpack(message.frame_id).type] = Shape(message.length, largest)
    return found


def mismatch(identifier: int, length: int) -> Mismatch | None:
    """Return why a data frame with a 29-bit identifier is no message; None if type, index and length are one's.

    Examples
    --------
    >>> mismatch(0x0C000003, 5), mismatch(0x0C000003, 8), mismatch(0x08FE6E0B, 8)
    (None, <Mismatch.LENGTH: 'length'>, <Mismatch.FOREIGN: 'foreign'>)
    """
    shape = shapes().get(identifier >> TYPE_SHIFT & 0x1F)
    if shape is None or (identifier >> INDEX_SHIFT & INDEX_MASK) > shape.largest_index:
        return Mismatch.FOREIGN
    return None if length == shape.length else Mismatch.LENGTH


@cache
def type_of(name: str) -> int:
    """Return the type of a message, 0..31, by its name."""
    return Identifier.unpack(database().get_message_by_name(name).frame_id).type


def encode(name: str, signals: Mapping[str, float], *, node: int, index: int = 0) -> tuple[int, bytes]:
    """Pack a message.

    Parameters
    ----------
    name : str
        Message name in the DBC.
    signals : mapping
        Every signal of the message in physical units (of a multiplexed message: those of the chosen kind).
    node, index : int
        Fields of the identifier.

    Returns
    -------
    tuple of (int, bytes)
        29-bit identifier and data.

    Examples
    --------
    >>> identifier, data = encode("PARAM_GET", {"reserved": 0}, node=7, index=2)
    >>> hex(identifier), data.hex()
    ('0xd002007', '00')
    """
    message = database().get_message_by_name(name)
    data = bytes(message.encode(dict(signals), scaling=True))
    return Identifier(message.frame_id >> TYPE_SHIFT, index, node).pack(), data


class _Reading(NamedTuple):
    """How the frames of one message are read.

    Parameters
    ----------
    name : str
    length, largest_index : int
        As `Shape` has them.
    signals : callable or None
        Makes the signals of the message of its bits; None where they depend on what they hold: cantools reads those.
    """

    name: str
    length: int
    largest_index: int
    signals: Callable[[int], dict[str, float]] | None


@cache
def _readings() -> tuple[_Reading | None, ...]:
    """Return how each type of message is read, by the type, 0..31; None for types that no message has."""
    found: list[_Reading | None] = [None] * 32
    for message in database().messages:
        type_ = Identifier.unpack(message.frame_id).type
        shape = shapes()[type_]
        plain = all(one.byte_order == "little_endian" and not one.is_float for one in message.signals)
        signals = _signals_of(message.signals) if plain and not message.is_multiplexed() else None
        found[type_] = _Reading(message.name, shape.length, shape.largest_index, signals)
    return tuple(found)


def _signals_of(signals: Iterable[Signal]) -> Callable[[int], dict[str, float]]:
    """Return a function of a message's bits that has its signals' places and scales written into it.

    A sensor sends thousands of messages a second, and a loop over places takes most of the time of reading them.
    """
    parts = []
    for one in signals:
        raw = f"(bits >> {one.start} & {(1 << one.length) - 1})"
        if one.is_signed:
            raw = f"(({raw[1:-1]} ^ {1 << (one.length - 1)}) - {1 << (one.length - 1)})"
        parts.append(f"{one.name!r}: {raw} * {float(one.scale)!r} + {float(one.offset)!r}")
    read: Callable[[int], dict[str, float]] = eval(f"lambda bits: {{{', '.join(parts)}}}", {"__builtins__": {}})
    return read


def decode(identifier: int, data: bytes) -> Message | None:
    """Unpack a message; None for a frame that is none, as `mismatch` tells.

    All but the multiplexed ones are unpacked here, to what cantools makes of them.
    """
    reading = _readings()[identifier >> TYPE_SHIFT & 0x1F]
    index = identifier >> INDEX_SHIFT & INDEX_MASK
    if reading is None or index > reading.largest_index or len(data) != reading.length:
        return None
    if reading.signals is None:
        return _decode_by_cantools(identifier, data)
    return Message(reading.name, identifier & NODE_MASK, index, reading.signals(int.from_bytes(data, "little")))


def _decode_by_cantools(identifier: int, data: bytes) -> Message:
    fields = Identifier.unpack(identifier)
    message = database().get_message_by_frame_id(fields.type << TYPE_SHIFT)
    signals = message.decode(bytes(data), decode_choices=False, scaling=True)
    assert isinstance(signals, dict)
    return Message(message.name, fields.node, fields.index, {k: float(v) for k, v in signals.items()})  # type: ignore[arg-type]

"""Frames of CAN as ROS 2 has them, ``can_msgs/msg/Frame``, in CDR: what Foxglove and ROS tools decode."""

from __future__ import annotations

import math
import struct

import can

NANOSECONDS = 1_000_000_000

SCHEMA_NAME = "can_msgs/msg/Frame"
SCHEMA = b"""std_msgs/Header header
uint32 id
bool is_rtr
bool is_extended
bool is_error
uint8 dlc
uint8[8] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

_HEAD = struct.Struct("<4siII")
"""Encapsulation (CDR, little-endian), seconds, nanoseconds, length of the channel's name with its final zero."""
_BODY = struct.Struct("<I???B8s")
_ENCAPSULATION = b"\x00\x01\x00\x00"
LONGEST_NAME = 1000


def nanoseconds(unix_s: float) -> int:
    """Return a time of the wall clock in whole nanoseconds since 1970, never below 0.

    Examples
    --------
    >>> nanoseconds(1700000000.25), nanoseconds(-1.0)
    (1700000000250000000, 0)
    """
    whole = math.floor(unix_s)
    return max(0, whole * NANOSECONDS + round((unix_s - whole) * NANOSECONDS))


def packed(message: can.Message) -> bytes:
    r"""Return a message in CDR; its channel is the ``frame_id`` of the header.

    Examples
    --------
    >>> message = can.Message(timestamp=1.5, arbitration_id=0x64, data=b"\x07", channel="can0")
    >>> again = unpacked(packed(message))
    >>> again.timestamp, again.arbitration_id, bytes(again.data), again.channel
    (1.5, 100, b'\x07', 'can0')
    """
    seconds, rest = divmod(nanoseconds(message.timestamp), NANOSECONDS)
    name = ("" if message.channel is None else str(message.channel)).encode() + b"\0"
    padding = b"\0" * (-len(name) % 4)
    body = _BODY.pack(
        message.arbitration_id,
        message.is_remote_frame,
        message.is_extended_id,
        message.is_error_frame,
        message.dlc,
        bytes(message.data),
    )
    return _HEAD.pack(_ENCAPSULATION, seconds & 0x7FFFFFFF, rest, len(name)) + name + padding + body


def unpacked(data: bytes) -> can.Message:
    """Return the message of its CDR; `ValueError` if the bytes are none."""
    try:
        encapsulation, seconds, rest, length = _HEAD.unpack_from(data)
        begin = _HEAD.size + length + (-length % 4)
        if encapsulation != _ENCAPSULATION or not 0 < length <= LONGEST_NAME:
            raise ValueError("no frame of CAN in CDR, little-endian")
        identifier, remote, extended, error, dlc, content = _BODY.unpack_from(data, begin)
        name = data[_HEAD.size : _HEAD.size + length - 1].decode()
    except struct.error as torn:
        raise ValueError(f"no frame of CAN in CDR: {torn}") from torn
    return can.Message(
        timestamp=seconds + rest / NANOSECONDS,
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=remote,
        is_error_frame=error,
        dlc=dlc,
        data=None if remote else content[:dlc],
        channel=name or None,
        check=True,
    )

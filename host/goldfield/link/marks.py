"""Marks in a recording, which tell a replay the stretches that the live run read: it reads the same ones.

While a live sensor is looked for and set, what it reports belongs to no pose. A mark is a remote frame, which no board
sends and every program that reads such logs knows. It has the identifier of ``EPOCH``: of the sensor that is read
from there on, or of node 0, which is no node, where none is read until the next mark.
"""

from __future__ import annotations

import can

from goldfield_protocol.messages import Identifier, database

_TYPE = Identifier.unpack(database().get_message_by_name("EPOCH").frame_id).type


def mark(node: int | None, time_s: float) -> can.Message:
    """Return the mark from which on a node's reports are read; None: nobody's.

    Examples
    --------
    >>> begin = mark(100, 1.5)
    >>> f"{begin.arbitration_id:08X}", is_mark(begin), reads(begin), reads(mark(None, 1.0))
    ('02000064', True, True, False)
    """
    identifier = Identifier(_TYPE, 0, node or 0).pack()
    return can.Message(timestamp=time_s, arbitration_id=identifier, is_extended_id=True, is_remote_frame=True)


def is_mark(message: can.Message) -> bool:
    """Return whether a message of a recording is a mark."""
    if not (message.is_remote_frame and message.is_extended_id):
        return False
    identifier = Identifier.unpack(message.arbitration_id)
    return (identifier.type, identifier.index) == (_TYPE, 0)


def reads(message: can.Message) -> bool:
    """Return whether reports are read behind a mark."""
    return Identifier.unpack(message.arbitration_id).node != 0

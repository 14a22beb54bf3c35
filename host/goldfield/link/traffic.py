"""What comes over a link and is no message of ours, by kind: it is counted and gone on, whatever it is.

A bus may be shared with other protocols, a line may be noisy, a port of the network is open to anybody. Only a link
that is dead ends a run.
"""

from __future__ import annotations

from collections.abc import Mapping

import can

from goldfield_protocol.messages import Mismatch

CORRUPT = "corrupt frames"
"""Frames of the serial line, or lines of a log, that do not pass their checks."""
GARBLED = "garbled lines or datagrams"
"""What an interface of python-can received and could not read as a frame, as from slcan or udp_multicast."""
ELEVEN_BIT = "frames with 11-bit identifiers"
REMOTE = "remote frames"
ERROR = "error frames"
FD = "CAN FD frames"
FOREIGN = "foreign frames"
"""Frames whose type or index no message has."""
WRONG_LENGTH = "messages of a wrong length"
MEANINGLESS = "messages without a meaning"
"""Messages whose bytes are no value of their signals."""
OTHER_PROTOCOL = "messages of boards with another protocol"
OTHER_CHANNEL = "messages of other channels"

KINDS = (
    CORRUPT,
    GARBLED,
    ELEVEN_BIT,
    REMOTE,
    ERROR,
    FD,
    FOREIGN,
    WRONG_LENGTH,
    MEANINGLESS,
    OTHER_PROTOCOL,
    OTHER_CHANNEL,
)
DAMAGED = (CORRUPT, GARBLED, WRONG_LENGTH, MEANINGLESS)
"""Kinds that a sound link to one sensor, which nobody else uses, never has."""

BY_MISMATCH = {Mismatch.FOREIGN: FOREIGN, Mismatch.LENGTH: WRONG_LENGTH}


def no_traffic() -> dict[str, int]:
    """Return a count of each kind, all zero; a thread may count while another one reads."""
    return dict.fromkeys(KINDS, 0)


def kind_of(message: can.Message) -> str | None:
    """Return the kind of a frame that is no data frame with a 29-bit identifier; None for one that is.

    Examples
    --------
    >>> kind_of(can.Message(arbitration_id=0x123, is_extended_id=False))
    'frames with 11-bit identifiers'
    """
    if message.is_error_frame:
        return ERROR
    if message.is_fd:
        return FD
    if not message.is_extended_id:
        return ELEVEN_BIT
    return REMOTE if message.is_remote_frame else None


def added(*counts: Mapping[str, int]) -> dict[str, int]:
    """Return the sum of several counts, kind by kind."""
    return {kind: sum(count.get(kind, 0) for count in counts) for kind in KINDS}


def damaged(counts: Mapping[str, int]) -> int:
    """Return how many frames were damaged."""
    return sum(counts.get(kind, 0) for kind in DAMAGED)

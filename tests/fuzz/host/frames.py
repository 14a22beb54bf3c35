"""Serial frames: bytes that come at once, one by one or in pieces give the same frames; each encodes to its bytes.

A frame that is a message decodes to numbers that encode to the very same bytes, or says in a `ValueError` why not.
"""

from __future__ import annotations

import math

from goldfield_protocol import FrameDecoder, decode, encode, encode_frame
from goldfield_protocol.framing import RawFrame
from goldfield_protocol.messages import mismatch

MOST_BYTES = 400


def one_input(data: bytes) -> None:
    """Try one input; its first byte says how long the pieces are."""
    piece, received = (data[0] % 40 + 1 if data else 1), data[1:MOST_BYTES]
    at_once, by_one, by_piece = FrameDecoder(), FrameDecoder(), FrameDecoder()
    frames = list(at_once.feed(received))
    assert frames == fed(by_one, received, 1)
    assert frames == fed(by_piece, received, piece)
    assert at_once == by_one == by_piece
    parts = received.split(b"\0")[:-1]
    encoded = [encode_frame(frame.identifier, frame.data) for frame in frames]
    assert all(one[:-1] in parts for one in encoded)
    dropped = at_once.bad_crc + at_once.malformed + at_once.overlong
    assert len(frames) + dropped == sum(bool(part) for part in parts)
    for frame in frames:
        check_message(frame)


def fed(decoder: FrameDecoder, received: bytes, piece: int) -> list[RawFrame]:
    """Return the frames of bytes that come in pieces."""
    return [f for begin in range(0, len(received), piece) for f in decoder.feed(received[begin : begin + piece])]


def check_message(frame: RawFrame) -> None:
    """Decode a frame that is a message, and encode what came of it."""
    if mismatch(frame.identifier, len(frame.data)) is not None:
        return
    try:
        message = decode(frame.identifier, frame.data)
    except ValueError:
        return
    assert all(isinstance(value, int | float) for value in message.signals.values())
    if all(math.isfinite(value) for value in message.signals.values()):
        again = encode(message.name, message.signals, node=message.node, index=message.index)
        assert decode(*again) == message

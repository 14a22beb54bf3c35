"""Serial framing: COBS( id u32 LE | data | CRC-16 u16 LE ), delimiter 00. See ``framing.md``."""

from __future__ import annotations

import binascii
from collections.abc import Iterator
from dataclasses import dataclass, field

MAX_DATA = 8
MAX_ENCODED = 4 + MAX_DATA + 2 + 1
"""Longest frame between two delimiters: 14 bytes and one byte of COBS overhead."""


def crc16(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, no reflection.

    Examples
    --------
    >>> hex(crc16(b"123456789"))
    '0x29b1'
    """
    return binascii.crc_hqx(data, 0xFFFF)


def cobs_encode(payload: bytes) -> bytes:
    """Encode so that no byte is zero (Cheshire & Baker 1999). At most 254 bytes of payload.

    Examples
    --------
    >>> cobs_encode(bytes([0x11, 0x22, 0x00, 0x33])).hex()
    '0311220233'
    """
    if len(payload) > 254:
        raise ValueError(f"a frame of {len(payload)} bytes is longer than COBS's single block of 254")
    return b"".join(bytes([len(block) + 1]) + block for block in payload.split(b"\0"))


def cobs_decode(encoded: bytes) -> bytes | None:
    """Invert `cobs_encode`; None if the bytes are no COBS block."""
    blocks = []
    position = 0
    while position < len(encoded):
        code = encoded[position]
        block = encoded[position + 1 : position + code]
        if code == 0 or len(block) != code - 1 or 0 in block:
            return None
        blocks.append(block)
        position += code
    return b"\0".join(blocks) if blocks else None


@dataclass(frozen=True)
class RawFrame:
    """A frame that passed its checks: 29-bit identifier and 0 to 8 bytes of data."""

    identifier: int
    data: bytes


def encode_frame(identifier: int, data: bytes) -> bytes:
    """Build the bytes of one frame, delimiter included.

    Raises
    ------
    ValueError
        If the identifier needs more than 29 bits or there are more than 8 bytes of data.
    """
    if not 0 <= identifier < 1 << 29:
        raise ValueError(f"identifier {identifier:#x} needs more than 29 bits")
    if len(data) > MAX_DATA:
        raise ValueError(f"{len(data)} bytes of data are more than a frame's {MAX_DATA}")
    body = identifier.to_bytes(4, "little") + bytes(data)
    return cobs_encode(body + crc16(body).to_bytes(2, "little")) + b"\0"


@dataclass
class FrameDecoder:
    """Turns received bytes into frames. A bad frame costs that frame only and is counted.

    Attributes
    ----------
    bad_crc, malformed, overlong : int
        Frames dropped: checksum wrong; no COBS, too short or more than 29 bits of identifier; longer than any frame.
    """

    bad_crc: int = 0
    malformed: int = 0
    overlong: int = 0
    _pending: bytearray = field(default_factory=bytearray)
    _skipping: bool = False

    def feed(self, received: bytes) -> Iterator[RawFrame]:
        """Yield the frames that end in the received bytes."""
        frames = []
        *ended, rest = received.split(b"\0")
        for part in ended:
            self._take(part)
            if self._skipping:
                self.overlong += 1
            elif self._pending:
                frame = self._check(bytes(self._pending))
                if frame is not None:
                    frames.append(frame)
            self._pending.clear()
            self._skipping = False
        self._take(rest)
        return iter(frames)

    def _take(self, part: bytes) -> None:
        """Take bytes without a delimiter; what is longer than any frame is not kept."""
        self._skipping |= len(self._pending) + len(part) > MAX_ENCODED
        self._pending += part[: MAX_ENCODED - len(self._pending)]

    def _check(self, encoded: bytes) -> RawFrame | None:
        payload = cobs_decode(encoded)
        if payload is None or not 6 <= len(payload) <= 4 + MAX_DATA + 2:
            self.malformed += 1
            return None
        body, crc = payload[:-2], int.from_bytes(payload[-2:], "little")
        if crc16(body) != crc:
            self.bad_crc += 1
            return None
        identifier = int.from_bytes(body[:4], "little")
        if identifier >= 1 << 29:
            self.malformed += 1
            return None
        return RawFrame(identifier, body[4:])

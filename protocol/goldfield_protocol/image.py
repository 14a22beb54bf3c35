"""What lies in front of a firmware image in its slot of the flash: header, CRC, signature, and state words.

The layout is that of ``firmware/core/boot/image.h``, which says what each word means. A slot's first `CODE_OFFSET`
bytes are made here; the code follows, and begins with the vector table.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

MAGIC = 0x4D494647
MARK, ERASED = 0x5AC3A53C, 0xFFFFFFFF
STATE_BYTES = 64
SIGNATURE_OFFSET, SIGNATURE_BYTES = 64, 64
CRC_OFFSET = 128
HEADER_OFFSET = 448
CODE_OFFSET = 512
SLOTS = (0x08020000, 0x08080000)
"""Addresses of both slots."""
SLOT_BYTES = 384 * 1024
STM32F405 = 1
"""The kind of board, as the header tells it."""
KEY_PLACE, KEY_MARK, KEY_BYTES = 0x08003FC0, 0x594B4647, 32
"""Where a boot loader finds the public key."""
_HEADER = "<7I36x"


@dataclass(frozen=True)
class Header:
    """What an image says of itself.

    Attributes
    ----------
    length : int
        Bytes of code, a multiple of 4.
    address : int
        Address of the slot that it is linked for.
    board, role : int
        Kind of hardware, and the role as ``HEARTBEAT`` tells it.
    version : int
        ``major << 16 | minor << 8 | patch``.
    protocol : int
        Hash of the protocol that it speaks.
    """

    length: int
    address: int
    board: int
    role: int
    version: int
    protocol: int

    def pack(self) -> bytes:
        """Return the 64 bytes that are signed together with the code."""
        words = (self.length, self.address, self.board, self.role, self.version, self.protocol)
        return struct.pack(_HEADER, MAGIC, *words)


class NoImageError(ValueError):
    """Bytes that hold no image; the message is a part of a sentence."""


def head(header: Header, code: bytes, *, signature: bytes | None = None, confirmed: bool = False) -> bytes:
    """Return what lies in front of the code: `CODE_OFFSET` bytes.

    Parameters
    ----------
    header : Header
        It tells the code's length.
    code : bytes
    signature : bytes, optional
        64 bytes over `message`; without it that place is erased.
    confirmed : bool
        Whether the state words say that the image is the first on its node and good, as a probe writes it; otherwise
        they are erased, as a node wants it over a link.
    """
    words = (1, ERASED - 1, ERASED, MARK, MARK, MARK, MARK) if confirmed else ()
    result = bytearray(b"\xff" * HEADER_OFFSET)
    result[: 4 * len(words)] = struct.pack(f"<{len(words)}I", *words)
    if signature is not None:
        result[SIGNATURE_OFFSET : SIGNATURE_OFFSET + SIGNATURE_BYTES] = signature
    packed = header.pack()
    result[CRC_OFFSET : CRC_OFFSET + 4] = struct.pack("<I", zlib.crc32(packed + code))
    return bytes(result) + packed


def key_place(key: bytes) -> bytes:
    """Return what lies at `KEY_PLACE` for a public key: a mark, the key, its CRC-32.

    Raises
    ------
    ValueError
        The key has another length.
    """
    if len(key) != KEY_BYTES:
        raise ValueError(f"a public key has {KEY_BYTES} bytes, not {len(key)}")
    return struct.pack("<I32sI", KEY_MARK, key, zlib.crc32(key))


def parse(slot: bytes) -> tuple[Header, bytes]:
    """Return the header and the code of what lies in a slot; the CRC is compared, the signature is not.

    Raises
    ------
    NoImageError
        There is none, or bits of it have changed.
    """
    if len(slot) < CODE_OFFSET:
        raise NoImageError("it is shorter than an image's header")
    magic, *words = struct.unpack_from(_HEADER, slot, HEADER_OFFSET)
    header = Header(*words)
    code = slot[CODE_OFFSET : CODE_OFFSET + header.length]
    if magic != MAGIC:
        raise NoImageError("it has no image's header")
    if len(code) != header.length or header.length % 4:
        raise NoImageError(f"its header tells {header.length} bytes of code, and there are {len(code)}")
    if slot[CRC_OFFSET : CRC_OFFSET + 4] != struct.pack("<I", zlib.crc32(header.pack() + code)):
        raise NoImageError("its CRC is wrong: bits of it have changed")
    return header, code

"""The flash of a board that has no power: as bytes, and as a file."""

from __future__ import annotations

import itertools
from pathlib import Path

from goldfield.errors import UserError

FLASH = range(0x08000000, 0x08100000)
CELLS = 2 * len(FLASH)
"""Bytes that keep a flash: what each byte reads as, then which of its bits are weak (``emulator.h``)."""
SECTOR_STARTS = (*range(0, 0x10000, 0x4000), 0x10000, *range(0x20000, 0x100001, 0x20000))
"""Where the sectors begin, and where the last ends (RM0090 table 5)."""


class BadImageError(UserError):
    """An image, a parameter page or a flash that this board cannot hold; the message is one sentence for the user."""


def read(path: Path) -> bytes:
    """Read the file of a flash.

    Raises
    ------
    BadImageError
        The file cannot be read, or has another length.
    """
    try:
        cells = path.read_bytes()
    except OSError as error:
        raise BadImageError(f"the flash cannot be read from {path} ({error.strerror}): name another file") from error
    if len(cells) != CELLS:
        raise BadImageError(f"{path} is {len(cells)} B long, and a flash {CELLS} B: name the file of a board")
    return cells


def write(path: Path, cells: bytes) -> None:
    """Write the file of a flash; what was there before is there until the new one is complete.

    Raises
    ------
    BadImageError
        The file cannot be written.
    """
    temporary = path.with_name(path.name + ".new")
    try:
        temporary.write_bytes(cells)
        temporary.replace(path)
    except OSError as error:
        raise BadImageError(f"the flash cannot be kept in {path} ({error.strerror}): name another file") from error


def flashed(cells: bytes, segments: list[tuple[int, bytes]]) -> bytes:
    """Return the flash after a probe has written an image: it erases the sectors that hold a part of it, no other."""
    result = bytearray(cells)
    for begin, end in itertools.pairwise(SECTOR_STARTS):
        if any(at - FLASH.start < end and at - FLASH.start + len(data) > begin for at, data in segments):
            result[begin:end] = b"\xff" * (end - begin)
            result[len(FLASH) + begin : len(FLASH) + end] = bytes(end - begin)
    for at, data in segments:
        result[at - FLASH.start : at - FLASH.start + len(data)] = data
    return bytes(result)

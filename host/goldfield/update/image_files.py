"""Files of images: the ELF files that make builds, and update files, which hold signed images for boards to take.

An update file is a row of images, each as it lies in its slot (`goldfield_protocol.image`) and filled up to a whole
number of blocks. It may hold images of several roles; of each it needs the one of slot A and the one of slot B, as a
board takes that of the slot which does not run.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from goldfield.errors import UserError
from goldfield.files.inputs import name_of, read_bounded
from goldfield.link.heartbeat import ROLES
from goldfield_protocol.image import (
    CODE_OFFSET,
    SIGNATURE_BYTES,
    SIGNATURE_OFFSET,
    SLOT_BYTES,
    SLOTS,
    Header,
    NoImageError,
    head,
    parse,
)

BLOCK_BYTES = 8
MOST_BYTES = 8 * SLOT_BYTES
"""Both images of four roles, whatever fills their slots: 3 MiB. An ELF file with what a debugger needs has half."""
UNSIGNED = b"\xff" * SIGNATURE_BYTES
NAMES = "AB"
ELF_MAGIC = b"\x7fELF\x01\x01"
"""An ELF file of 32 bits, little-endian, begins so."""
LOADED = 1


@dataclass(frozen=True)
class Image:
    """One image with its header, as it goes into a slot.

    Attributes
    ----------
    header : Header
    data : bytes
        All that lies in the slot, its state words erased, in whole blocks.
    """

    header: Header
    data: bytes

    @property
    def slot(self) -> int:
        """The slot that it is linked for: 0 A, 1 B."""
        return SLOTS.index(self.header.address)

    @property
    def role(self) -> str:
        """Its role in words."""
        return ROLES.get(self.header.role, f"role {self.header.role}")

    @property
    def version(self) -> str:
        """Its version, as heartbeats tell it."""
        return version_text(self.header.version)

    @property
    def signature(self) -> bytes:
        """Its signature; `UNSIGNED` if it has none."""
        return self.data[SIGNATURE_OFFSET : SIGNATURE_OFFSET + SIGNATURE_BYTES]

    @property
    def message(self) -> bytes:
        """What is signed: header and code."""
        return self.header.pack() + self.data[CODE_OFFSET : CODE_OFFSET + self.header.length]

    @property
    def blocks(self) -> int:
        """How many blocks it has."""
        return len(self.data) // BLOCK_BYTES

    @property
    def text(self) -> str:
        """Role, version and slot in words."""
        return f"{self.role} {self.version} for slot {NAMES[self.slot]}"


def version_text(version: int) -> str:
    """Return a version in words.

    Examples
    --------
    >>> version_text(0x010203)
    '1.2.3'
    """
    return f"{version >> 16}.{version >> 8 & 255}.{version & 255}"


def version_number(text: str) -> int:
    """Return the number of a version that a heartbeat has told."""
    major, minor, patch = (int(part) for part in text.split("."))
    return major << 16 | minor << 8 | patch


def read(path: str) -> list[Image]:
    """Return the images of a file, an update file or the ELF file of one image.

    Raises
    ------
    UserError
        The file cannot be read, holds no image, or bits of it have changed.
    """
    data = read_bounded(path, "file of images", MOST_BYTES)
    if not data:
        raise UserError(f"{name_of(path)}: is empty: give an image that make firmware or goldfield image sign has made")
    try:
        return [_image(_slot_of(data))] if data.startswith(b"\x7fELF") else list(_row(data))
    except NoImageError as error:
        raise UserError(
            f"{name_of(path)}: holds no image for a board: {error}: give one that make firmware or goldfield image "
            "sign has made"
        ) from error


def signed(images: Iterable[Image], sign: Callable[[bytes], bytes]) -> list[Image]:
    """Return images with a signature; ``sign`` makes one of a message."""
    result = []
    for image in images:
        code = image.data[CODE_OFFSET : CODE_OFFSET + image.header.length]
        front = head(image.header, code, signature=sign(image.message))
        result.append(Image(image.header, _filled(front + code)))
    return result


def packed(images: Sequence[Image]) -> bytes:
    """Return the update file of images; `UserError` if two are for the same slot of the same role."""
    seen: set[tuple[int, int, int]] = set()
    for image in images:
        place = image.header.board, image.header.role, image.header.address
        if place in seen:
            raise UserError(f"two images are given of the {image.role} for slot {NAMES[image.slot]}: give one of them")
        seen.add(place)
    return b"".join(image.data for image in images)


def without_partner(images: Sequence[Image]) -> list[Image]:
    """Return the images for whose role there is none of the other slot."""
    return [i for i in images if not any(o.header.role == i.header.role and o.slot != i.slot for o in images)]


def _filled(data: bytes) -> bytes:
    return data + b"\xff" * (-len(data) % BLOCK_BYTES)


def _image(slot: bytes) -> Image:
    header, _ = parse(slot)
    if header.address not in SLOTS:
        raise NoImageError(f"it is linked for {header.address:#010x}, where no slot is")
    if header.length > SLOT_BYTES - CODE_OFFSET:
        raise NoImageError("it is longer than a slot")
    return Image(header, _filled(slot[: CODE_OFFSET + header.length]))


def _row(data: bytes) -> Iterable[Image]:
    """Yield the images that lie one behind the other."""
    begin = 0
    while begin < len(data):
        image = _image(data[begin:])
        yield image
        begin += len(image.data)


def _slot_of(elf: bytes) -> bytes:
    """Return what an ELF file has for a slot, from the slot's beginning on."""
    if not elf.startswith(ELF_MAGIC):
        raise NoImageError("it is an ELF file of another kind of machine")
    try:
        begin, size, count = (*struct.unpack_from("<I", elf, 28), *struct.unpack_from("<HH", elf, 42))
        segments = []
        for i in range(count):
            kind, offset, _, address, length = struct.unpack_from("<5I", elf, begin + i * size)
            if kind == LOADED and length:
                segments.append((address, elf[offset : offset + length]))
    except struct.error:
        raise NoImageError("it is cut off") from None
    for slot in SLOTS:
        inside = [(a - slot, data) for a, data in segments if slot <= a < slot + SLOT_BYTES]
        if inside:
            result = bytearray(b"\xff" * min(SLOT_BYTES, max(at + len(data) for at, data in inside)))
            for at, data in inside:
                result[at : at + len(data)] = data
            return bytes(result) + b"\xff" * (-len(result) % 4)
    raise NoImageError("none of it lies in a slot")

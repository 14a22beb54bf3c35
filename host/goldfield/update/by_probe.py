"""An image of an update file onto a board by a debug probe, as ``make flash`` does it with what it has built."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from goldfield.errors import SystemFailure, UserError
from goldfield.update.find_probe import NoProbe, choose, connected
from goldfield.update.image_files import Image
from goldfield.update.program_board import NotProgrammed, Target, boot_files, check_chip, program
from goldfield_protocol.image import CODE_OFFSET, SLOTS, head

TARGET = "stm32f405rgtx"
BOOT = "build/boot/boot.bin"
"""Where make puts the boot loader, as seen from a checkout."""


def pyocd() -> str:
    """Return the program that talks to probes: the one of this Python, else of the search path."""
    beside = Path(sys.executable).with_name("pyocd")
    found = str(beside) if beside.exists() else shutil.which("pyocd")
    if found is None:
        raise UserError("pyOCD programs boards with a probe, and is not installed: pip install pyocd")
    return found


def as_confirmed(image: Image) -> bytes:
    """Return what a probe writes of an image: its state words say that it is the first one, and good."""
    code = image.data[CODE_OFFSET : CODE_OFFSET + image.header.length]
    return head(image.header, code, signature=image.signature, confirmed=True) + code


def image_of(images: Sequence[Image], role: str | None) -> Image:
    """Return the image of a role for slot A; `UserError` if it is not clear which."""
    found = [image for image in images if image.slot == 0 and role in (None, image.role)]
    if not found:
        raise UserError(f"the file has no {role or 'image'} for slot A, which a probe writes: sign that one, too")
    if len(found) > 1:
        roles = ", ".join(image.role for image in found)
        raise UserError(f"the file has images of several roles, {roles}: say which with --role")
    return found[0]


def flash(image: Image, probe: str, boot: str, public: bytes | None) -> None:
    """Program boot loader, key and image, and print what is done.

    Parameters
    ----------
    image : Image
    probe : str
        Part of the probe's unique id; empty: there is one only.
    boot : str
        File of the boot loader's bytes.
    public : bytes or None
        The key by which the board judges images over its links.

    Raises
    ------
    UserError
        There is no such file, no pyOCD or no probe.
    SystemFailure
        The board was not programmed.
    """
    if not Path(boot).is_file():
        raise UserError(f"{boot}: there is no such boot loader: run make firmware, or give its file with --boot")
    program_name = pyocd()
    try:
        print(choose(connected(program_name), probe), flush=True)
    except NoProbe as sentence:
        raise UserError(str(sentence).replace("PROBE=", "--probe ")) from sentence
    target = Target(program_name, TARGET, probe or None)
    try:
        print(check_chip(target), flush=True)
        with tempfile.TemporaryDirectory() as directory:
            place = Path(directory) / "image.bin"
            place.write_bytes(as_confirmed(image))
            files = boot_files(boot, None if public is None else public.hex(), Path(directory))
            program(target, None, [(place, SLOTS[0]), *files])
    except NotProgrammed as sentence:
        raise SystemFailure(str(sentence)) from sentence
    print(f"programmed: {image.text}")

"""Program a board: check that the chip is the one meant, load, compare what was loaded, and set the brown-out level.

``python -m goldfield.update.program_board PYOCD [--uid ID] --target TARGET --boot BOOT [--key KEY] ELF [PAGE]``: pyOCD,
the debug probe, pyOCD's name of the target, the boot loader (its bytes), the public key by which it judges new images
(64 hexadecimal digits), the image, and a parameter page. The image takes the place of whatever the board has got over
its link: the other slot is emptied. What a board has saved itself overrules its page: a page that is written takes the
place of it, and an image alone leaves it. Exit code 0: all is done; 1: a sentence on stderr tells what is not.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from goldfield_protocol.image import CODE_OFFSET, KEY_BYTES, KEY_PLACE, SLOTS, key_place

BOOT_ADDRESS = 0x08000000
PAGE_ADDRESS = 0x080E0000
SAVED_ADDRESS, SAVED_BYTES = 0x08004000, 2 * 16384
"""Where a board saves its parameters (flash.c)."""
FLASH_KB = 1024

# RM0090, 38.6.1 and 39.2; ARMv7-M Architecture Reference Manual, B3.2.3.
IDCODE, FLASH_SIZE, CPUID = 0xE0042000, 0x1FFF7A20, 0xE000ED00
DEVICE, DEVICE_OF_REVISION_A, REVISION_A, CORTEX_M4 = 0x413, 0x411, 0x1000, 0xC24
"""Revision A tells the device id of the STM32F2, whose core is another (ES0182)."""

# RM0090, 3.9: registers and keys of the option bytes.
OPTKEYR, STATUS, OPTCR = 0x40023C08, 0x40023C0C, 0x40023C14
KEYS = 0x08192A3B, 0x4C5D6E7F
LOCK, START, BROWN_OUT, BUSY = 1 << 0, 1 << 1, 3 << 2, 1 << 16
"""Both bits of the brown-out level are 0 at level 3, 2.7 V and above."""

CHECK = "check the board's power and the wires SWDIO, SWCLK, NRST and GND"


class NotProgrammed(Exception):
    """The sentence that tells what is wrong, and what to do."""


class Target:
    """The chip behind a debug probe, by pyOCD's commands.

    Parameters
    ----------
    pyocd, name : str
        The program, and its name of the target.
    uid : str or None
        Part of the probe's unique id.
    """

    def __init__(self, pyocd: str, name: str, uid: str | None) -> None:
        self._pyocd = pyocd
        self._options = [*(["--uid", uid] if uid else []), "--target", name]

    def command(self, *commands: str) -> str:
        """Give commands to the halted chip, and return what they print."""
        words = [self._pyocd, "commander", *self._options, "-M", "halt", *(w for c in commands for w in ("-c", c))]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = (done.stderr or done.stdout).strip().splitlines()
            raise NotProgrammed(f"pyOCD cannot reach the chip ({lines[-1] if lines else 'it says nothing'}): {CHECK}")
        return done.stdout

    def read(self, *addresses: int) -> list[int]:
        """Return words of the chip."""
        told = self.command(*(f"read32 {address:#010x}" for address in addresses))
        found = {int(a, 16): int(v, 16) for a, v in re.findall(r"^([0-9a-f]{8}): +([0-9a-f]{8})\b", told, re.M)}
        missing = [address for address in addresses if address not in found]
        if missing:
            raise NotProgrammed(f"pyOCD does not tell what is at {missing[0]:#010x} of the chip: {CHECK}")
        return [found[address] for address in addresses]

    def load(self, *files: str) -> None:
        """Write files to the flash, and start them."""
        if subprocess.run([self._pyocd, "load", *self._options, *files], check=False).returncode:
            raise NotProgrammed(f"pyOCD could not write the flash: {CHECK}")

    def memory(self, address: int, count: int) -> bytes:
        """Return bytes of the chip."""
        with tempfile.TemporaryDirectory() as directory:
            path = Path(directory) / "memory.bin"
            self.command(f"savemem {address:#010x} {count} {path}")
            return path.read_bytes() if path.exists() else b""


def check_chip(target: Target) -> str:
    """Return the words that name the chip.

    Raises
    ------
    NotProgrammed
        If it is another than the image is for.
    """
    idcode, size, cpuid = target.read(IDCODE, FLASH_SIZE, CPUID)
    device, revision, kilobytes = idcode & 0xFFF, idcode >> 16, size >> 16
    core = cpuid >> 4 & 0xFFF
    if core != CORTEX_M4 or device not in (DEVICE, DEVICE_OF_REVISION_A):
        raise NotProgrammed(
            f"the chip's device id is {device:#05x} and its core {core:#05x}; those of an STM32F405 are {DEVICE:#05x} "
            f"and {CORTEX_M4:#05x}: connect the probe to the board's own processor"
        )
    if kilobytes < FLASH_KB:
        raise NotProgrammed(
            f"the chip has {kilobytes} kB of flash, and the parameter page needs {FLASH_KB} kB: take an STM32F405RG"
        )
    old = ", which reads its flash without prefetch" if revision == REVISION_A else ""
    return f"chip: STM32F405, device id {device:#05x}, revision {revision:#06x}{old}, {kilobytes} kB of flash"


def boot_files(boot: str, key: str | None, beside: Path) -> list[tuple[Path, int]]:
    """Return the files of the boot loader with its key, and of an empty slot B, with their addresses.

    They are written in a directory, since both share a sector with nothing else that is written.

    Raises
    ------
    NotProgrammed
        The key is none.
    """
    loader = Path(boot).read_bytes()
    if key:
        try:
            place = key_place(bytes.fromhex(key))
        except ValueError as error:
            raise NotProgrammed(
                f"KEY={key} is no public key: give the {2 * KEY_BYTES} hexadecimal digits of one"
            ) from error
        loader = loader.ljust(KEY_PLACE - BOOT_ADDRESS, b"\xff") + place
    first, empty = beside / "boot_and_key.bin", beside / "empty_slot.bin"
    first.write_bytes(loader)
    empty.write_bytes(b"\xff" * CODE_OFFSET)
    return [(first, BOOT_ADDRESS), (empty, SLOTS[1])]


def page_files(page: str) -> list[tuple[Path, int]]:
    """Return the files of a parameter page, with their addresses: itself, and erased flash in place of what is saved.

    The second is written beside the page.
    """
    saved = Path(page).with_name("saved.bin")
    saved.write_bytes(b"\xff" * SAVED_BYTES)
    return [(Path(page), PAGE_ADDRESS), (saved, SAVED_ADDRESS)]


def contents(elf: str | None, pages: list[tuple[Path, int]]) -> Iterator[tuple[str, int, bytes]]:
    """Yield what the flash must hold: whose it is, address, bytes."""
    if elf is not None:
        yield from _segments(elf)
    for path, address in pages:
        yield str(path), address, path.read_bytes()


def _segments(elf: str) -> Iterator[tuple[str, int, bytes]]:
    from elftools.elf.elffile import ELFFile

    with Path(elf).open("rb") as file:
        for segment in ELFFile(file).iter_segments():
            if segment["p_type"] == "PT_LOAD" and segment["p_filesz"]:
                yield elf, segment["p_paddr"], segment.data()


def verify(target: Target, elf: str | None, pages: list[tuple[Path, int]]) -> str:
    """Compare the flash with the files, and return the words that say so.

    Raises
    ------
    NotProgrammed
        At the first byte that differs.
    """
    total = 0
    for name, address, wanted in contents(elf, pages):
        found = target.memory(address, len(wanted))
        if found != wanted:
            at = next((i for i, (a, b) in enumerate(zip(wanted, found, strict=False)) if a != b), len(found))
            raise NotProgrammed(f"the flash differs from {name} at {address + at:#010x}: program it again")
        total += len(wanted)
    return f"verified: {total} bytes of flash are those of the files"


def set_brown_out(target: Target) -> str:
    """Set the brown-out level in the option bytes, and return the words that say so.

    Raises
    ------
    NotProgrammed
        If the chip does not keep it.
    """
    (options,) = target.read(OPTCR)
    if options & BROWN_OUT == 0:
        return "option bytes: brown-out reset at level 3 (2.7 V) already"
    wanted = options & ~(BROWN_OUT | LOCK | START)
    writes = [(OPTKEYR, KEYS[0]), (OPTKEYR, KEYS[1]), (OPTCR, wanted), (OPTCR, wanted | START)]
    target.command("halt", *(f"write32 {address:#010x} {value:#010x}" for address, value in writes), "sleep 200")
    status, options = target.read(STATUS, OPTCR)
    if status & BUSY or options & BROWN_OUT:
        raise NotProgrammed(
            f"the chip did not take the brown-out level (FLASH_OPTCR {options:#010x}): power it off and on"
        )
    target.command(f"write32 {OPTCR:#010x} {wanted | LOCK:#010x}", "reset")
    return "option bytes: brown-out reset set to level 3 (2.7 V); it acts from the next power-on"


def program(target: Target, elf: str | None, files: list[tuple[Path, int]]) -> None:
    """Load an image and files at their addresses, compare them, and set the brown-out level; print what is done.

    Raises
    ------
    NotProgrammed
        If any of it fails.
    """
    target.load(*([] if elf is None else [elf]), *(f"{path}@0x{address:08X}" for path, address in files))
    print(verify(target, elf, files), flush=True)
    print(set_brown_out(target), flush=True)


def main(arguments: list[str]) -> int:
    """Program a board, and return the exit code."""
    parser = argparse.ArgumentParser(description="Program a board through pyOCD.")
    parser.add_argument("pyocd")
    parser.add_argument("--uid")
    parser.add_argument("--target", required=True)
    parser.add_argument("--boot", required=True)
    parser.add_argument("--key")
    parser.add_argument("elf")
    parser.add_argument("page", nargs="?")
    asked = parser.parse_args(arguments)
    target = Target(asked.pyocd, asked.target, asked.uid)
    try:
        print(check_chip(target), flush=True)
        if not asked.key:
            print("no KEY is given: this board will take no image over its links", flush=True)
        with tempfile.TemporaryDirectory() as directory:
            files = boot_files(asked.boot, asked.key, Path(directory))
            files += page_files(asked.page) if asked.page else []
            program(target, asked.elf, files)
    except NotProgrammed as sentence:
        print(sentence, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

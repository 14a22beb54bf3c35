"""The flash of an emulated chip with the boot loader, its key, and the images that were built, signed here."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from goldfield_protocol.image import (
    CODE_OFFSET,
    ERASED,
    KEY_PLACE,
    MARK,
    SLOT_BYTES,
    SLOTS,
    Header,
    head,
    key_place,
    parse,
)
from hil_sim.clib import ROOT
from hil_sim.emulator.elf_image import read_image
from hil_sim.emulator.emulator import Configuration, Emulator
from hil_sim.emulator.kept_flash import CELLS, FLASH
from tests.firmware.core.boot.slots import KEY, public

BOOT = ROOT / "build/boot/boot.elf"
IMAGES = ROOT / "build/firmware"
MS, STEP_MS = 1_000_000_000, 20
MOST_BY_CLASS = 2.5
"""Cycles that an instruction takes at most on the mean where each has its own costs."""
STATE_WORDS = 7
Part = tuple[int, bytes]


def boot_loader(key: Ed25519PrivateKey | None = KEY) -> list[Part]:
    """Return the boot loader, with the public key of a private one."""
    segments, _ = read_image(BOOT)
    return [*segments, *([(KEY_PLACE, key_place(public(key)))] if key else [])]


def slot_bytes(elf: Path, slot: int) -> bytes:
    """Return what an ELF file has for a slot."""
    result = bytearray()
    for address, data in read_image(elf)[0]:
        if address >= SLOTS[slot]:
            result[len(result) :] = b"\xff" * (address - SLOTS[slot] + len(data) - len(result))
            result[address - SLOTS[slot] : address - SLOTS[slot] + len(data)] = data
    return bytes(result) + b"\xff" * (-len(result) % 4)


def probed(role: str = "sensor") -> Part:
    """Return slot A as a probe writes it."""
    return SLOTS[0], slot_bytes(IMAGES / f"{role}.elf", 0)


def image(
    role: str = "sensor",
    *,
    state: tuple[int, ...] = (2, ERASED - 2, ERASED, MARK),
    key: Ed25519PrivateKey = KEY,
    older: bool = False,
    patch: Callable[[Header, bytearray], None] | None = None,
) -> Part:
    """Return slot B with an image that came over a link; ``patch`` changes its code before it is signed."""
    header, code = parse(slot_bytes(IMAGES / "slot_b" / f"{role}.elf", 1))
    changed = bytearray(code)
    if patch is not None:
        patch(header, changed)
    if older:
        header = replace(header, version=header.version - 1)
    code = bytes(changed)
    front = bytearray(head(header, code, signature=key.sign(header.pack() + code)))
    front[: 4 * len(state)] = struct.pack(f"<{len(state)}I", *state)
    return SLOTS[1], bytes(front) + code


def flash(*parts: Part) -> bytes:
    """Return the cells that hold these parts and are erased elsewhere."""
    cells = bytearray(b"\xff" * len(FLASH) + bytes(CELLS - len(FLASH)))
    for address, data in parts:
        cells[address - FLASH.start : address - FLASH.start + len(data)] = data
    return bytes(cells)


def state_of(cells: bytes, slot: int) -> tuple[int, ...]:
    """Return the state words of a slot."""
    return struct.unpack_from(f"<{STATE_WORDS}I", cells, SLOTS[slot] - FLASH.start)


class Run:
    """One life of the chip: what it runs at its end, and what it did to its flash.

    Parameters
    ----------
    cells : bytes
    ms : int
        How long it lives at most, ms, if an instruction takes a cycle; longer if it takes more.
    cut : (int, float, int), optional
        Step of the flash in which the power goes, how much of the step is over then, and an id.
    seed : int
        What the memories hold, and what a step that is cut leaves, follows it.
    to_the_end : bool
        Otherwise its life ends as soon as an image runs.
    """

    def __init__(
        self,
        cells: bytes,
        ms: int,
        *,
        cut: tuple[int, float, int] | None = None,
        seed: int = 1,
        to_the_end: bool = False,
    ) -> None:
        configuration = Configuration(memory_seed=seed)
        self.levels: list[tuple[int, bool, int]] = []
        chip = Emulator(BOOT, configuration, cells=cells, pin_out=lambda *change: self.levels.append(change))
        try:
            if cut is not None:
                step, fraction, cut_id = cut
                chip.cut_flash(step, fraction, cut_id=cut_id)
            chip.probe("image_check")
            chip.probe("image_intact")
            self.slot = None
            cycles = chip.configuration
            self.slow = MOST_BY_CLASS if cycles.cycles_by_class else cycles.cycles_per_instruction
            for until in range(1, 1 + round(ms * self.slow / STEP_MS)):
                chip.run(until * STEP_MS * MS)
                place = chip.register(15)
                self.slot = next((slot for slot in (1, 0) if CODE_OFFSET <= place - SLOTS[slot] < SLOT_BYTES), None)
                if self.slot is not None and not to_the_end:
                    break
            self.probes = chip.probes()
            self.report = chip.report()
            self.steps = chip.flash_steps()
            self.violations = chip.statistics().violations
            self.in_boot = place < SLOTS[0]
            self.cells = chip.cells()
        finally:
            chip.close()

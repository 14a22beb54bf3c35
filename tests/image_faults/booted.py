"""The boot loader between two images: which one runs, and that no forged one does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from goldfield_protocol.image import CODE_OFFSET, SLOT_BYTES, SLOTS
from hil_sim.emulator.emulator import Configuration, Emulator
from tests.firmware.boards.stm32f405.boot_flash import BOOT, MS, Part, boot_loader, flash, image, probed, state_of
from tests.firmware.core.boot.slots import OTHER_KEY
from tests.image_faults.workload import DANGEROUS, NOTHING, SAID, Seen, Verdict

A, B = 0, 1
STEP_MS, LONGEST_MS = 20, 3600


def forged() -> Part:
    """Return an image whose CRC is right and which another key has signed."""
    return image(key=OTHER_KEY)


def older() -> Part:
    """Return an image of a version before, which nobody has forced."""
    return image(older=True)


@dataclass
class Booted:
    """A boot loader that finds a confirmed image in slot A and a new one in slot B."""

    name: str
    part: Callable[[], Part]
    begin: int = 0
    image: Path = BOOT
    modules: tuple[str, ...] = ("boot", "storage", "signature")

    def start(self) -> Emulator:
        """Return the chip as it gets its power."""
        configuration = Configuration(strict=False, stop_at_fault=False)
        return Emulator(BOOT, configuration, cells=flash(*boot_loader(), probed(), self.part()))

    def chip(self, bench: Emulator) -> Emulator:
        """Return the chip."""
        return bench

    def observe(self, bench: Emulator) -> Seen:
        """Run until an image runs."""
        slot, running, now = None, True, bench.now_ps
        while slot is None and running and now < LONGEST_MS * MS:
            now += STEP_MS * MS
            running = bench.run(now)
            place = bench.register(15)
            slot = next((slot for slot in (B, A) if CODE_OFFSET <= place - SLOTS[slot] < SLOT_BYTES), None)
        return {"slot": slot, "running": running, "state": list(state_of(bench.cells(), B)), "end_ps": now}

    def judge(self, seen: Seen, sound: Seen) -> Verdict:
        """Judge by the image that runs."""
        if seen["slot"] == B and sound["slot"] != B:
            return Verdict(DANGEROUS, "an image runs that must not")
        if seen["slot"] is None:
            return Verdict(SAID, "no image runs until the next reset")
        if seen["slot"] != sound["slot"]:
            return Verdict(SAID, "the image before runs, and tells its version")
        return Verdict(NOTHING if seen["state"] == sound["state"] else SAID, f"state words {seen['state']}")


def booted() -> list[Booted]:
    """Return the workloads of the boot loader."""
    without = ("boot", "storage")
    return [Booted("signed", image, modules=without), Booted("forged", forged), Booted("older", older, modules=without)]

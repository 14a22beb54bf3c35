"""A node with two image slots whose power can be made to go, and images that are built here by another hand."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from tests.firmware.core.storage.flash_cells import ONES, Cells, Torn

WORDS = 140
"""Words of a slot: the header's and signature's 128, and some of code."""
ADDRESSES = (0x08020000, 0x08080000)
BOARD, SENSOR, BEACON = 1, 1, 0
MARK = 0x5AC3A53C
SEQUENCE, COMPLEMENT, FORCED, PENDING, TRIED, CONFIRMED, SETTLED = range(7)
STATE_WORDS, SIGNATURE, CRC, HEADER, CODE = 16, 16, 32, 112, 128
OK, NONE, DAMAGED, WRONG_BOARD, WRONG_ROLE, WRONG_PLACE, OLDER, NO_KEY, UNSIGNED = range(9)
NOTHING, IS_PENDING, IS_TRIED, IS_CONFIRMED, IS_REJECTED = range(5)
KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
OTHER_KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(1, 33)))


def public(key: Ed25519PrivateKey) -> bytes:
    return key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)


@dataclass(frozen=True)
class Image:
    """What an image says of itself, and its code."""

    code: tuple[int, ...] = (0x20002000, 0x08020201, 7, 8, 9)
    magic: int = 0x4D494647
    slot: int = 0
    board: int = BOARD
    role: int = SENSOR
    version: int = 0x00010000
    length: int | None = None

    def words(self, key: Ed25519PrivateKey = KEY) -> list[int]:
        """Return a slot's words, signed; the state words are erased."""
        length = 4 * len(self.code) if self.length is None else self.length
        header = (self.magic, length, ADDRESSES[self.slot], self.board, self.role, self.version, 0x1234, *(9 * [0]))
        message = struct.pack(f"<{16 + len(self.code)}I", *header, *self.code)
        words = WORDS * [ONES]
        words[SIGNATURE : SIGNATURE + 16] = struct.unpack("<16I", key.sign(message))
        words[CRC] = zlib.crc32(message)
        words[HEADER : HEADER + len(message) // 4] = struct.unpack(f"<{len(message) // 4}I", message)
        return words

    def at(self, slot: int) -> Image:
        return replace(self, slot=slot)


OLD = Image()
NEW = Image(code=(0x20002000, 0x08020201, 0x11111111, ONES, 0, 5), version=0x00010001)


class PowerLost(Exception):
    """The step at which the power goes has come."""


@dataclass(frozen=True)
class Choice:
    """What the boot loader starts."""

    slot: int
    trial: bool


class Node:
    """Two slots of flash with the boot loader's and the application's part of an update.

    ``cut`` is the step at which the power goes, counted over both of them.
    """

    def __init__(self, core: Any, seed: int = 1, key: bytes | None = None) -> None:
        self._ffi, self._lib = core
        self._memory = [self._ffi.new("uint32_t[]", WORDS) for _ in range(2)]
        self.cells = Cells(self._memory, WORDS, seed)
        self._key = self._ffi.new("uint8_t[]", public(KEY) if key is None else key)
        self.flash = self._ffi.new("image_flash_t *")
        self.flash.slot, self.flash.address, self.flash.words = self._memory, ADDRESSES, WORDS
        self.flash.board, self.flash.key = BOARD, self._key
        self.steps, self.cut, self.torn = 0, None, Torn.NOT
        self.log: list[tuple[int, int | None, int]] = []

    def forget_key(self) -> None:
        self.flash.key = self._ffi.NULL

    def put(self, image: Image, slot: int, key: Ed25519PrivateKey = KEY, **state: int) -> None:
        """Write an image with its state words, as a probe does it."""
        words = image.at(slot).words(key)
        if "sequence" in state:
            sequence = state.pop("sequence")
            words[SEQUENCE], words[COMPLEMENT] = sequence, ~sequence & ONES
        for name, value in state.items():
            words[globals()[name.upper()]] = value
        self.cells.erase(slot)
        self.cells.read[slot][0:WORDS] = words

    def confirmed(self, image: Image, slot: int, sequence: int) -> None:
        self.put(image, slot, sequence=sequence, pending=MARK, tried=MARK, confirmed=MARK, settled=MARK)

    def words(self, slot: int) -> list[int]:
        return list(self._memory[slot])

    def state(self, slot: int) -> int:
        return int(self._lib.select_state(self.flash, slot))

    def check(self, slot: int, role: int = ONES, least: int = 0) -> int:
        demand = self._ffi.new("image_demand_t *", {"role": role, "least_version": least})
        return int(self._lib.image_check(self.flash, slot, demand))

    def intact(self, slot: int) -> bool:
        return bool(self._lib.image_intact(self.flash, slot))

    def holds(self, slot: int, image: Image) -> bool:
        """Whether a slot holds an image, by what is read of it now."""
        words, wanted = self.words(slot), image.at(slot).words()
        return (
            words[STATE_WORDS:CRC] == wanted[STATE_WORDS:CRC]
            and words[CRC] == wanted[CRC]
            and (words[HEADER : CODE + len(image.code)] == wanted[HEADER : CODE + len(image.code)])
        )

    def places(self) -> list[int]:
        """Addresses of the slots, for another library."""
        return [int(self._ffi.cast("uintptr_t", memory)) for memory in self._memory]

    def key_place(self) -> int:
        """Address of the key; 0: there is none."""
        return int(self._ffi.cast("uintptr_t", self.flash.key))

    def carry_out(self, slot: int, index: int | None, value: int) -> None:
        """Do a step, in which the power may go."""
        if self.steps == self.cut:
            self.cut = None
            self.cells.tear(self.torn, slot, index, value)
            raise PowerLost
        self.steps += 1
        self.log.append((slot, index, value))
        if index is None:
            self.cells.erase(slot)
        else:
            self.cells.program(slot, index, value)

    def boot(self, upset: Callable[[Any], None] = lambda select: None) -> Choice | None:
        """Switch on, and return what is started; None: nothing. ``upset`` spoils what the loader has in its memory."""
        self.cells.start()
        select = self._ffi.new("select_t *")
        self._lib.select_open(select, self.flash)
        upset(select)
        for _ in range(20):
            step = self._lib.select_next(select)
            if not step.wanted:
                choice = self._lib.select_choice(select)
                return Choice(choice.slot, choice.trial) if choice.found else None
            self.carry_out(step.slot, step.index, step.value)
        raise AssertionError("the boot loader goes round")

    # ---- The application ----

    def open(self, running: int) -> None:
        self._install = self._ffi.new("install_t *")
        self._lib.install_open(self._install, self.flash, running)

    @property
    def phase(self) -> int:
        return int(self._lib.install_phase(self._install))

    def work(self) -> None:
        """Carry out what the application's part asks for."""
        while (step := self._lib.install_next(self._install)).kind != 0:
            self.carry_out(step.slot, None if step.kind == 2 else step.index, step.value)

    def confirm(self) -> bool:
        wanted = bool(self._lib.install_confirm(self._install))
        self.work()
        return wanted

    def begin(self, length: int, forced: bool = False) -> int:
        return int(self._lib.install_begin(self._install, length, forced))

    def takes(self, index: int) -> bool:
        return bool(self._lib.install_takes(self._install, index))

    def receive(self, slot: int, words: list[int]) -> None:
        for index in range(WORDS):
            if self.takes(index) and words[index] != ONES:
                self.carry_out(slot, index, words[index])

    def end(self) -> int:
        status = int(self._lib.install_end(self._install))
        self.work()
        return status

    def update(self, image: Image, running: int, *, forced: bool = False, key: Ed25519PrivateKey = KEY) -> int:
        """Bring an image into the slot that does not run, and return what was found wrong."""
        self.open(running)
        words = image.at(1 - running).words(key)
        assert self.begin(4 * len(image.code), forced) == 0
        self.work()
        self.receive(1 - running, words)
        return self.end()

    def live(self) -> tuple[Choice, Image | None]:
        """Switch on, let what starts confirm itself, and return what that is."""
        choice = self.boot()
        assert choice is not None, "bricked"
        image = next((image for image in (NEW, OLD) if self.holds(choice.slot, image)), None)
        if choice.trial:
            self.open(choice.slot)
            self.confirm()
        return choice, image


def running_old(core, seed=1, other=True):
    """Return a node that runs the old image in slot 0; in slot 1 lies one from before, or nothing."""
    node = Node(core, seed)
    node.confirmed(OLD, 0, 7)
    if other:
        node.confirmed(replace(OLD, code=(1, 2, 3)), 1, 6)
    return node

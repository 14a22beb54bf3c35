"""The image that is built takes its successor over the serial port, on the emulated chip and behind the boot loader."""

from __future__ import annotations

import struct

import pytest

from goldfield_protocol import FrameDecoder, Message, decode
from goldfield_protocol.image import ERASED, MARK, SLOTS
from goldfield_protocol.parameters import build_page
from hil_sim.emulator.emulator import PARAMETER_PAGE
from hil_sim.emulator.kept_flash import FLASH
from tests.firmware.boards.stm32f405.boot_flash import boot_loader, flash, image, probed, state_of
from tests.firmware.host_rig import MS, SECOND, SENSOR, Board
from tests.firmware.services.saved_flash import NAMED
from tests.firmware.services.updated_board import BEGIN, END, FIRST_BLOCK, MISSING, OK, OK_RESTARTS, PAGE, TELL

PAGE_BLOCKS = 1024
BLOCK_TIME = MS // 5
"""A frame takes 16 bytes, 0.08 ms; everything stands still for its two words, 0.03 ms as a rule and at most 0.2 ms."""
ERASURE = 6 * SECOND
A, B = 0, 1


class Life:
    """One life of the chip, with its host on the serial port."""

    def __init__(self, cells: bytes) -> None:
        self.board = Board(SENSOR, {"node": 9}, emulated=True, cells=cells)
        self._decoder, self._taken, self._told = FrameDecoder(), 0, list[Message]()
        self.now = 300 * MS
        self.board.run(self.now)

    def run(self, until: int) -> None:
        self.now = until
        self.board.run(until)

    def command(self, index: int, argument: int = 0, wait: int = 20 * MS) -> tuple[int, int]:
        """Give a command and return its answer."""
        told = self._answers(index)
        self.board.send_serial("COMMAND", {"board": NAMED, "argument": argument}, 9, index, self.now)
        end = self.now + wait
        while self.now < end:
            self.run(self.now + 10 * MS)
            if len(answers := self._answers(index)) > len(told):
                return answers[-1]
        raise AssertionError(f"command {index} has no answer")

    def _messages(self) -> list[Message]:
        """Return what has come so far. A restart may cut a frame off."""
        new = self.board.serial[self._taken :]
        self._taken += len(new)
        decoded = (decode(f.identifier, f.data) for f in self._decoder.feed(bytes(byte for _, byte in new)))
        self._told += [m for m in decoded if m is not None and m.name in ("COMMAND_ANSWER", "RESET_REPORT")]
        return self._told

    def _answers(self, index: int) -> list[tuple[int, int]]:
        found = [m for m in self._messages() if m.name == "COMMAND_ANSWER" and m.index == index]
        return [(int(m.signals["status"]), int(m.signals["value"])) for m in found]

    def data(self, data: bytes, pages: int | None = None) -> int:
        """Send an image, page by page, each until nothing of it is missing; return how many blocks it took."""
        words = struct.unpack(f"<{len(data) // 4}I", data)
        sent = 0
        for page in range(-(-len(words) // 2 // PAGE_BLOCKS))[:pages]:
            assert self.command(PAGE, page) == (OK, page)
            first, count = 0 if page else FIRST_BLOCK, PAGE_BLOCKS
            while count:
                blocks = range(page * PAGE_BLOCKS + first, min(page * PAGE_BLOCKS + PAGE_BLOCKS, len(words) // 2))
                for block in blocks[:count]:
                    values = {"first": words[2 * block], "second": words[2 * block + 1]}
                    self.board.send_serial("UPDATE_DATA", values, 9, block % PAGE_BLOCKS, self.now)
                    self.now += BLOCK_TIME
                    sent += 1
                self.run(self.now + 10 * MS)
                status, value = self.command(MISSING)
                first, count = value & 0xFFFF, value >> 16
                assert status == OK
        return sent

    def causes(self) -> list[int]:
        return [int(m.signals["cause"]) for m in self._messages() if m.name == "RESET_REPORT" and m.index == 0]

    def end(self) -> bytes:
        """Switch off, and return the flash."""
        cells = self.board.emulator.cells()
        self.board.close()
        return cells


def before() -> bytes:
    """Return the flash of a board that a probe has programmed."""
    return flash(*boot_loader(), probed(), (PARAMETER_PAGE, build_page({"node": 9})))


@pytest.fixture(scope="module")
def new() -> bytes:
    """The successor as it comes over a link, in whole blocks."""
    data = image(state=())[1]
    return data + b"\xff" * (-len(data) % 8)


@pytest.mark.slow  # tests/host/update/test_flash_on_the_emulated_chip.py does the same by the command line
def test_an_image_takes_its_successor_which_confirms_itself(new: bytes) -> None:
    life = Life(before())
    status, value = life.command(TELL)
    assert (status, value & 15, value >> 12 & 1) == (OK, A, 1)
    assert life.command(BEGIN, len(new) // 8, ERASURE) == (OK, SLOTS[B])
    sent = life.data(new)
    print(f"{len(new)} bytes, {sent} blocks of {len(new) // 8 - FIRST_BLOCK}, {life.now / SECOND:.1f} s from power-on")
    assert sent < 1.1 * len(new) / 8
    assert life.command(END, wait=500 * MS) == (OK_RESTARTS, 0)
    life.run(life.now + 3000 * MS)  # The boot loader checks the signature twice, and starts it.
    status, value = life.command(TELL)
    assert (status, value & 15) == (OK, B)
    life.run(life.now + 3500 * MS)
    assert life.causes() == [0, 3]  # Power-on and software: the watchdog has not struck.
    cells = life.end()
    assert state_of(cells, B) == (2, ERASED - 2, 0, MARK, MARK, MARK, MARK)
    begin = SLOTS[B] - FLASH.start
    assert cells[begin + 64 : begin + len(new)] == new[64:]
    assert state_of(cells, A) == state_of(flash(probed()), A)
    life = Life(cells)
    assert life.command(TELL)[1] & 15 == B
    life.end()


def test_an_update_that_is_broken_off_leaves_the_image_that_runs(new: bytes) -> None:
    life = Life(before())
    assert life.command(BEGIN, len(new) // 8, ERASURE)[0] == OK
    life.data(new, pages=1)
    life = Life(life.end())
    assert life.command(TELL)[1] & 15 == A
    life.end()

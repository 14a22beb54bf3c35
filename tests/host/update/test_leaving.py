"""A board leaves the bus amid an update of four, or the output cannot be written: all others are updated."""

import contextlib
import os
from dataclasses import replace

import numpy as np
import pytest

from goldfield_protocol import decode
from tests.firmware.core.boot import slots
from tests.firmware.core.boot.slots import IS_CONFIRMED, NEW, Choice
from tests.firmware.host_rig import SECOND
from tests.host.update.boards_on_a_link import BoardsLink, run

END, TELL = 14, 15
VICTIM = 1
OTHERS = (0, 2, 3)
CAME_BACK, STAYED_AWAY = Choice(1, True), Choice(0, False)


class LeavingLink(BoardsLink):
    """A bus that one board leaves before a message, and to which it may come back."""

    def __init__(self, seats, leaves, back_s):
        self.leaves, self.back_s, self.back_at = leaves, back_s, None
        super().__init__(seats)

    def send(self, identifier, data):
        message = decode(identifier, data)
        command = message.index if message.name == "COMMAND" else None
        if self.leaves is not None and self.leaves(command, self.sent.count("UPDATE_DATA")):
            self.leaves = None
            self.gone.add(VICTIM)
            self.back_at = None if self.back_s is None else self.now + round(self.back_s * SECOND)
        super().send(identifier, data)

    def _advance(self, until):
        if self.back_at is not None and until >= self.back_at:
            self.gone.clear()
        super()._advance(until)


def at_block(count):
    return lambda _, blocks: blocks >= count


def large():
    """An image of three pages."""
    random = np.random.default_rng(5)
    return replace(NEW, code=(0x20002000, 0x08020201, *(int(one) for one in random.integers(0, 1 << 32, 4300))))


@pytest.mark.parametrize(
    ("block", "back_s", "stays"),
    [(1, 1.0, True), (1, 5.0, False), (700, None, False), (700, 1.0, True), (700, 4.0, False), (2150, 4.0, False)],
)
def test_a_board_that_leaves_amid_the_blocks(bench, update_file, monkeypatch, block, back_s, stays):
    """Back soon it has the image as all; else it is told, and has what it had, whatever blocks it heard meanwhile."""
    monkeypatch.setattr(slots, "WORDS", 4500)
    link = bench(4, link=LeavingLink, leaves=at_block(block), back_s=back_s)
    code, out, told = run(monkeypatch, link, "flash", update_file(large()), "--all")
    victim = link.seats[VICTIM]
    assert all(link.seats[place].choices[-1] == CAME_BACK for place in OTHERS)
    assert (code, out.count("confirmed")) == ((0, 4) if stays else (3, 3))
    assert ("node 10 does not answer any more, and keeps the image that it had" in told) != stays
    assert told.endswith("not updated: 1 node, 10: see above\n") != stays
    link.gone.clear()
    link.advance(11.0)
    assert victim.choices[-1] == (CAME_BACK if stays else STAYED_AWAY)
    code, out, told = run(monkeypatch, link, "flash", update_file(large()), "10")
    assert (code, victim.node.state(victim.choices[-1].slot)) == (0, IS_CONFIRMED), told


@pytest.mark.parametrize(
    ("command", "back_s", "words"),
    [
        (END, None, "was not heard since it was to restart: check its power and its cable"),
        (END, 12.0, "runs the image that it had, and has not tried the new one: try again"),
        (TELL, None, "was not heard since it was to restart: check its power and its cable"),
        (TELL, 10.0, None),
    ],
)
def test_a_board_that_leaves_when_all_has_come(bench, update_file, monkeypatch, command, back_s, words):
    asked = []

    def leaves(now, blocks):
        asked.append(now)
        return blocks > 0 and now == command and (command != END or asked.count(END) == VICTIM + 1)

    link = bench(4, link=LeavingLink, leaves=leaves, back_s=back_s)
    code, out, told = run(monkeypatch, link, "flash", update_file(), "--all")
    assert (code, out.count("confirmed")) == ((0, 4) if words is None else (3, 3))
    assert words is None or f"node 10 {words}" in told
    link.gone.clear()
    link.advance(1.0)
    code, _, told = run(monkeypatch, link, "flash", update_file(), "10")
    assert code == 0, told
    assert all(seat.node.state(seat.choices[-1].slot) == IS_CONFIRMED for seat in link.seats)


def full_disk():
    return os.fdopen(os.open("/dev/full", os.O_WRONLY), "w", buffering=1)


def reader_gone():
    """A pipe that nobody reads."""
    reader, writer = os.pipe()
    os.close(reader)
    return os.fdopen(writer, "w", buffering=1)


@pytest.mark.parametrize(
    ("make", "code", "words"),
    [
        (full_disk, 3, "the output cannot be written: No space left on device"),
        (reader_gone, 0, "100 % sent"),
    ],
    ids=["full disk", "no reader"],
)
def test_an_output_that_cannot_be_written_ends_no_update(bench, update_file, monkeypatch, make, code, words):
    """Boards that run the other slot come after the first lines: they are brought their image all the same."""
    link = bench(4, running=[0, 0, 1, 1])
    into = make()
    got, _, told = run(monkeypatch, link, "flash", update_file(), "--all", into=into)
    with contextlib.suppress(OSError):
        into.close()
    assert (got, words in told) == (code, True)
    assert [seat.choices[-1] for seat in link.seats] == [*2 * [Choice(1, True)], *2 * [Choice(0, True)]]
    assert all(seat.node.state(seat.choices[-1].slot) == IS_CONFIRMED for seat in link.seats)

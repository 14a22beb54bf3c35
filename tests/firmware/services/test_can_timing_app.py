"""Timing over CAN on one board at a time: the test is the bus and the other side, with a perfect clock.

The sensor's sync input gets the master's edges for comparison only: with sync_source 2 it tells its phase against them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from goldfield_protocol import Message, encode
from tests.firmware.host_rig import BEACON, CHIP_TICKS, CHIPS, MS, PIN_SYNC_OUT, SECOND, SENSOR, US, Board, chip_seconds

MASTER, STRANGER = 1, 7
MASTER_PPM = -50.0
FIRST_EDGE = 3 * MS + 123_457
BIT = US
TICK_PS = SECOND / (168e6 * (1 + MASTER_PPM * 1e-6))
LATE = {False: 0.0, True: 0.4}
"""Stamps of emulated boards are late by the way into the interrupt, microseconds; on two boards this cancels."""


def cycle_start(cycle: int) -> int:
    """Picosecond at which the master begins a cycle."""
    return FIRST_EDGE + round(cycle * CHIPS * chip_seconds(MASTER_PPM) * 1e12)


class Bus:
    """The master's frames to a follower."""

    def __init__(self, board: Board) -> None:
        self.board = board

    def sync(self, cycle: int, end: int, node: int = MASTER, chips: int = CHIPS) -> None:
        """SYNC whose last bit ends at a time."""
        signals = {"cycle": cycle, "chips": chips, "chip_period": 97750.0, "rank": 1}
        self.board.can_in(*encode("SYNC", signals, node=node), end - BIT)

    def follow_up(self, cycle: int, end: int, at: int, node: int = MASTER, start: int | None = None) -> None:
        """FOLLOW_UP at a time, for a SYNC that ended at another."""
        ticks = round((end - (cycle_start(cycle - 1000) if start is None else start)) / TICK_PS)
        self.board.can_in(*encode("FOLLOW_UP", {"cycle": cycle, "ticks": ticks}, node=node), at)


@pytest.fixture
def follower() -> Iterator[Callable[..., Bus]]:
    boards: list[Board] = []

    def make(emulated: bool = False) -> Bus:
        parameters = {"node": 100, "sync_source": 2, "code_count": 0}
        boards.append(Board(SENSOR, parameters, ppm=17.0, emulated=emulated))
        for cycle in range(25):
            boards[-1].sync_pulse(cycle_start(cycle))
        return Bus(boards[-1])

    yield make
    for board in boards:
        board.close()


def statuses(board: Board) -> list[Message]:
    return board.messages("EPOCH_STATUS")


def phase_us(board: Board, last: int) -> float:
    """Largest phase against the wire of the last cycles, all of which must be locked."""
    told = statuses(board)[-last:]
    assert len(told) == last
    assert all(m.signals["locked"] == 1 for m in told)
    return max(abs(m.signals["phase"]) for m in told) * 1e-3


def counters(board: Board) -> dict[int, float]:
    return {m.index: m.signals["value"] for m in board.messages("COUNTER")}


@pytest.mark.parametrize("emulated", [False, True])
def test_follows_sync_and_follow_up_whenever_they_come(follower: Callable[..., Bus], emulated: bool) -> None:
    bus = follower(emulated)
    random = np.random.default_rng(5)
    for cycle in range(14):
        end = cycle_start(cycle) + int(random.uniform(0.2, 12.0) * MS)
        bus.sync(1000 + cycle, end)
        bus.follow_up(1000 + cycle, end, end + int(random.uniform(0.2, 60.0) * MS))
    bus.board.run(cycle_start(14))
    assert phase_us(bus.board, 5) < 0.05 + LATE[emulated]
    assert [int(m.signals["cycle"]) for m in bus.board.messages("EPOCH")][-3:] == [1010, 1011, 1012]
    assert 10 not in counters(bus.board)


def test_sync_may_come_before_its_cycle(follower: Callable[..., Bus]) -> None:
    bus = follower()
    for cycle in range(14):
        end = cycle_start(cycle) - 2 * MS
        bus.sync(1000 + cycle, end)
        bus.follow_up(1000 + cycle, end, end + 5 * MS)
    bus.board.run(cycle_start(14))
    assert phase_us(bus.board, 5) < 0.05


def test_lost_messages_and_a_sync_that_is_sent_twice(follower: Callable[..., Bus]) -> None:
    bus = follower()
    for cycle in range(16):
        end = cycle_start(cycle) + 700 * US
        if cycle % 5 != 2:  # else lost
            bus.sync(1000 + cycle, end)
        if cycle % 5 == 4:  # valid for this receiver, but the master saw an error in the last bit and repeats it
            end += 160 * US
            bus.sync(1000 + cycle, end)
        if cycle % 7 != 3:  # else lost
            bus.follow_up(1000 + cycle, end, end + 3 * MS)
        if cycle == 9:  # and one that is repeated
            bus.follow_up(1000 + cycle, end, end + 4 * MS)
    bus.board.run(cycle_start(16))
    assert phase_us(bus.board, 5) < 0.05
    assert 10 not in counters(bus.board)


def test_of_two_masters_the_first_is_followed_though_the_other_comes_in_between(follower: Callable[..., Bus]) -> None:
    bus = follower()
    for cycle in range(14):
        end = cycle_start(cycle) + 700 * US
        other = cycle_start(cycle) + 33 * MS + 456 * US
        bus.sync(1000 + cycle, end)
        bus.sync(1000 + cycle, end + 200 * US, node=STRANGER)
        bus.follow_up(1000 + cycle, end + 200 * US, end + 2 * MS, node=STRANGER, start=other)
        bus.follow_up(1000 + cycle, end, end + 3 * MS)
    bus.board.run(cycle_start(14))
    assert all(
        m.signals["locked"] == 1 for m in statuses(bus.board)[-5:]
    )  # to the stranger, whose FOLLOW_UP came first
    assert all(abs(m.signals["phase"]) > 10_000 for m in statuses(bus.board)[-5:])
    assert counters(bus.board)[10] > 5  # the master


def test_a_master_of_another_degree_is_ignored_and_counted(follower: Callable[..., Bus]) -> None:
    bus = follower()
    for cycle in range(14):
        end = cycle_start(cycle) + 700 * US
        bus.sync(1000 + cycle, end, chips=511)
        bus.follow_up(1000 + cycle, end, end + 3 * MS)
    bus.board.run(cycle_start(14))
    assert all(m.signals["locked"] == 0 for m in statuses(bus.board))
    assert counters(bus.board)[14] > 5


@pytest.mark.parametrize(("emulated", "middle"), [(False, False), (True, False), (True, True)])
def test_the_master_tells_when_sync_was_through(emulated: bool, middle: bool) -> None:
    """Also where SYNC ends around the middle of a chip, behind which the board must wait to know the chip."""
    board = Board(
        BEACON,
        {"node": MASTER, "sync_master": 1},
        ppm=MASTER_PPM,
        emulated=emulated,
    )
    random = np.random.default_rng(6)
    done, ends = 0, {}
    while board.operations.now(board.handle) < SECOND:
        board.run(board.operations.now(board.handle) + 50 * US)
        for _, mailbox, identifier, data in board.requests[done:]:
            done += 1
            end = board.operations.now(board.handle) + int(random.uniform(0.07, 5.0) * MS)
            if middle and identifier >> 24 == 1:
                chip, [first, *_] = chip_seconds(MASTER_PPM) * 1e12, board.edges(PIN_SYNC_OUT)
                end = first + round((np.ceil((end - first) / chip) + 8000 / CHIP_TICKS) * chip)
                end += int(random.uniform(-0.9, 0.5) * US)
            if identifier >> 24 == 1 and random.integers(3) == 0 and not emulated:
                board.can_sent(mailbox, False, end - 150 * US)  # an error: the host board asks for the bus again
            else:
                board.can_sent(mailbox, True, end)
                if identifier >> 24 == 1:
                    ends[int.from_bytes(data[:4], "little") & 0xFFFFF] = end
            break
    starts = board.edges(PIN_SYNC_OUT)
    told = board.can_messages("FOLLOW_UP")
    board.close()
    assert len(told) >= 8
    late = [
        (m.signals["ticks"] - (ends[int(m.signals["cycle"])] - starts[int(m.signals["cycle"])]) / TICK_PS) / 168
        for m in told
    ]
    assert max(late) - min(late) < 0.1
    assert abs(np.mean(late) - LATE[emulated] / 2) <= 0.01 + LATE[emulated] / 2

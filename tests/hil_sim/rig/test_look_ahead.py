"""Boards run ahead as far as nothing can reach them: what they do is what they do when nobody looks ahead."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

import pytest

from hil_sim import clib
from hil_sim.clib import ROOT
from hil_sim.rig import Rig
from hil_sim.rig.boards import HOST_LIBRARY, Board, BoardSpec, HostBoards, address
from hil_sim.scenario import load_scenario

SLICES_S = (0.02, 0.0071, 0.1, 0.00005)
SECONDS = 1.2


class Silent:
    """Host boards that do not tell what they do next, so that the rig asks each of them in every quantum."""

    def __init__(self) -> None:
        self._make = HostBoards()
        ffi: Any
        library: Any
        ffi, library = clib.load_built(HOST_LIBRARY)
        self._operations = ffi.new("board_operations_t *", library.host_board_operations)
        self._operations.ahead = ffi.NULL
        self._address = address(ffi, self._operations)

    def __call__(self, spec: BoardSpec, edge: int) -> Board:
        """See `BoardFactory`."""
        board = self._make(spec, edge)
        board.operations = self._address
        return board


def slices(rig: Rig) -> Iterator[int]:
    """Run a rig in uneven slices; yield the number of each."""
    number = 0
    while SECONDS - rig.now_s > 2e-5:
        rig.advance(min(SLICES_S[number % len(SLICES_S)], SECONDS - rig.now_s))
        yield number
        number += 1


def told(rig: Rig, cut: bool) -> tuple[str, dict[str, int]]:
    """Return a hash of all that an observer sees while things happen to the boards, and the counts of the bus."""
    seen = hashlib.sha256()
    boards = range(1 + len(rig.scenario.beacons))
    rig.watch_pins()
    for board in boards[3 if cut else len(boards) :]:
        rig.fault(board, "can_cut")
    for number in slices(rig):
        for board in boards:
            seen.update(rig.serial_read(board))
            seen.update(repr(rig.pin_changes(board).tolist()).encode())
        seen.update(repr(rig.can_read()).encode())
        seen.update(repr([rig.coil_current_A(board) for board in boards[1:]]).encode())
        seen.update(rig.sensor_field_T().tobytes())
        if number % 5 == 1:
            rig.serial_write(bytes(range(40)), number % len(boards))
        if number % 7 == 2:
            rig.can_write(number % 2047, b"", extended=False)
            rig.can_corrupt(1)
        if number == 11:
            rig.fault(boards[-1], "coil_open")
        if number == 14:
            rig.power_cycle(boards[-2], 0.03)
    return seen.hexdigest(), rig.can_statistics()


@pytest.mark.long
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("scenario", ["prigge8", "anchors4", "turning8"])
def test_who_looks_ahead_sees_the_same(scenario: str, cut: bool, threads: int) -> None:
    loaded = load_scenario(str(ROOT / f"hil_sim/scenarios/{scenario}.toml"))
    with Rig(loaded, "host", threads=threads) as ahead, Rig(loaded, Silent()) as asked:
        assert told(ahead, cut) == told(asked, cut)


def senders(rig: Rig) -> set[int]:
    """Return the nodes that sent something on the bus in .3 s."""
    rig.can_read()
    rig.advance(0.3)
    return {frame.identifier & 0xFFF for frame in rig.can_read()}


def test_a_board_off_the_bus_neither_sends_nor_hears() -> None:
    with Rig(load_scenario(str(ROOT / "hil_sim/scenarios/prigge8.toml")), "host") as rig:
        rig.advance(0.8)
        assert {3, 4} <= senders(rig)
        rig.fault(3, "can_cut")
        rig.advance(0.01)
        assert 3 not in senders(rig)
        assert 4 in senders(rig)
        rig.fault(3, "can_cut", active=False)
        rig.advance(0.2)
        assert 3 in senders(rig)

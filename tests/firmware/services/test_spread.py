"""When boards tell of themselves: DRIVE_STATUS in the block of the cycle that is the board's, heartbeats apart, and at
once what a host must not learn late. Times are those at which CAN is given the message.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from goldfield_protocol import decode
from tests.firmware.host_rig import (
    CHIPS,
    LISTENS,
    MS,
    PIN_FAULT,
    PIN_SYNC_OUT,
    SECOND,
    US,
    Board,
    Coil,
    Rig,
    beacon,
    chip_seconds,
)

BLOCK_CHIPS, BLOCKS = 31, 33
CHIP_PS = chip_seconds(0.0) * 1e12


def driving(boards: list[Board], node: int, power_on: int = 0, **parameters: float) -> Board:
    own = {"node": node, "code": 2, "amplitude": 8.0, "sync_master": 1, **parameters}
    boards.append(beacon(Coil(), parameters=own, power_on=power_on))
    return boards[-1]


def times_of(board: Board, name: str, index: int = 0) -> list[int]:
    """When CAN was given the messages of a name."""
    found = []
    for time, _, identifier, data in board.requests:
        message = decode(identifier, data)
        if message is not None and message.name == name and message.index == index:
            found.append(time)
    return found


@pytest.mark.parametrize("node", [1, 2, 16, 17, 33, 1000])
def test_a_beacon_tells_its_status_once_a_cycle_in_its_own_block(boards: list[Board], node: int) -> None:
    """The block is planned while the one before it runs, and begins with any chip of its place."""
    board = driving(boards, node, power_on=node * 137 * US)
    Rig(board, quantum=100 * US).run(LISTENS + SECOND)
    edges = np.array(board.edges(PIN_SYNC_OUT))
    period = CHIPS * CHIP_PS
    # What is told at once, when the drive goes on with the first cycle, is no status of a place.
    sent = [time for time in times_of(board, "DRIVE_STATUS") if time > edges[1]]
    assert np.abs(np.diff(sent) - period).max() < 0.2 * MS
    assert len(sent) >= 8
    place = 2 * node % BLOCKS
    for time in sent:
        chip = (time - edges[1]) / CHIP_PS % CHIPS
        behind = (chip - BLOCK_CHIPS * (place - 1) + 2.0) % CHIPS
        assert behind < BLOCK_CHIPS + 4.0, (chip, place)


@pytest.mark.parametrize(("degree", "cycles"), [(5, 32), (7, 8), (9, 2), (11, 1)])
def test_periods_of_other_degrees_have_one_status_each(boards: list[Board], degree: int, cycles: int) -> None:
    board = driving(boards, 12, degree=degree, code=3)
    Rig(board, quantum=100 * US).run(LISTENS + 2 * SECOND)
    period = (2**degree - 1) * cycles * CHIP_PS
    sent = [time for time in times_of(board, "DRIVE_STATUS") if time > board.edges(PIN_SYNC_OUT)[1]]
    gaps = np.diff(sent)
    assert len(sent) >= 8
    # A block of the last place of degree 11 may begin a chip later from one period to the next.
    assert np.abs(gaps - period).max() < (BLOCK_CHIPS + 1) * CHIP_PS


def test_no_two_of_nine_beacons_tell_their_status_at_once(boards: list[Board]) -> None:
    made = [driving(boards, node, power_on=node * 731 * US, sync_master=int(node == 1)) for node in range(1, 10)]
    Rig(*made, quantum=MS).run(1100 * MS)
    sent = sorted((time, board) for board in range(9) for time in times_of(made[board], "DRIVE_STATUS"))
    settled = [(time, board) for time, board in sent if time > 800 * MS]
    assert {board for _, board in settled} == set(range(9))
    gaps = [after - before for (before, _), (after, _) in pairwise(settled)]
    assert min(gaps) > 2 * MS


def test_boards_that_are_switched_on_together_tell_their_heartbeats_apart(boards: list[Board]) -> None:
    made = [driving(boards, node, sync_master=0) for node in range(1, 9)]
    sent = []
    for board in made:
        Rig(board, quantum=MS).run(1100 * MS)
        beats = times_of(board, "HEARTBEAT")
        assert beats[1] - beats[0] < 1002 * MS
        sent += beats[1:]
    assert np.diff(sorted(sent)).min() > 18 * MS


@pytest.mark.parametrize("ms", range(410, 510, 7))
def test_a_drive_that_goes_off_is_told_at_once_wherever_in_the_cycle(boards: list[Board], ms: int) -> None:
    """Else a host would learn of it up to a cycle late, and take the field of a cycle that it ended in for whole."""
    board = driving(boards, 1)
    rig = Rig(board, quantum=100 * US)
    rig.run(ms * MS)
    assert board.messages("DRIVE_STATUS")[-1].signals["enabled"] == 1
    board.pin(PIN_FAULT, False, ms * MS)
    rig.run((ms + 1) * MS)
    told = board.messages("DRIVE_STATUS")[-1].signals
    assert (told["enabled"], told["driver_fault"]) == (0, 1)
    assert board.messages("DRIVE_HEALTH")[-1].signals["cause"] != 0

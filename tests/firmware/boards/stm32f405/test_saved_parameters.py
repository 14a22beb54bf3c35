"""The images save their parameters in the flash of the emulated chip, also when its power goes meanwhile.

The model of the flash and its driver are by different hands, from RM0090 and the data sheet.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.firmware.host_rig import ANCHOR, BEACON, MS, PIN_ENABLE, SECOND, SENSOR, Board, Coil, beacon
from tests.firmware.services.saved_flash import (
    COIL_ON,
    DONE,
    DONE_RESTARTS,
    UNIQUE,
    answers,
    ask_to_save,
    counted,
    in_force,
    put,
    save,
)

STEPS = 1022
"""Words of a save that is appended: 1,016 of the set, with the record's around them and the head's mark."""
SOFTWARE, POWER_ON = 3, 0
OLD, NEW = (17, 3.5, 0.25), (23, 4.5, 0.75)
NAMES = ("code", "over_current", "survey__191")


def emulated(role: int = BEACON, cells: bytes | None = None) -> Board:
    return Board(role, {"node": 9}, emulated=True, cells=cells)


def values(of: tuple[float, ...]) -> dict[str, float]:
    return dict(zip(NAMES, of, strict=True))


def causes(board: Board) -> list[int]:
    """Why the board has started, each time."""
    return [int(m.signals["cause"]) for m in board.messages("RESET_REPORT") if m.index == 0]


@pytest.mark.parametrize("role", [BEACON, SENSOR, ANCHOR])
def test_what_is_saved_is_in_force_after_the_restart_and_after_the_loss_of_power(role: int) -> None:
    """The erasure takes its 0.25 s and more, and the watchdog does not strike."""
    board = emulated(role)
    board.run(50 * MS)
    ask_to_save(board, put(board, 50 * MS, **values(OLD)) + MS)
    board.run(1500 * MS)
    assert answers(board) == [DONE_RESTARTS]
    assert causes(board) == [POWER_ON, SOFTWARE]
    assert in_force(board, NAMES, 1500 * MS) == OLD
    assert save(board, 2 * SECOND, **values(NEW)) == DONE  # Appended: no restart.
    assert causes(board) == [POWER_ON, SOFTWARE]
    board.run(3500 * MS)
    assert counted(board) == {}
    cells = board.emulator.cells()
    board.close()
    board = emulated(role, cells)
    assert in_force(board, NAMES, 150 * MS) == NEW  # At 2.5 cycles an instruction a beacon starts within 0.1 s.
    board.close()


def test_a_beacon_pauses_for_its_save_and_drives_again() -> None:
    board = beacon(Coil(), parameters={"node": 9, "sync_master": 1, "amplitude": 5.0}, unique_id=UNIQUE, emulated=True)
    board.run(SECOND)
    ask_to_save(board, SECOND)
    ask_to_save(board, 1200 * MS, pause=True)
    board.run(1150 * MS)
    assert answers(board) == [COIL_ON]
    assert board.level[PIN_ENABLE] is True
    assert board.emulator.flash_steps() == 0
    board.run(4 * SECOND)
    assert answers(board) == [COIL_ON, DONE_RESTARTS]
    assert causes(board) == [POWER_ON, SOFTWARE]
    [off] = board.edges(PIN_ENABLE, False)
    assert 1200 * MS < off < 1210 * MS
    assert board.level[PIN_ENABLE] is True
    board.close()


@pytest.fixture(scope="module")
def kept() -> Iterator[bytes]:
    """The flash of a board that has saved the old set."""
    board = emulated()
    assert save(board, 50 * MS, **values(OLD)) in (DONE, DONE_RESTARTS)
    yield board.emulator.cells()
    board.close()


def lose_power(cells: bytes | None, step: int, fraction: float) -> None:
    """Lose the power in a step of a save, for 20 ms; check that the old set or the new one is in force from then on."""
    board = emulated(cells=cells)
    old = OLD if cells is not None else (0, 12.0, 0.003)
    before = in_force(board, NAMES, 50 * MS)
    assert before == pytest.approx(old)
    board.emulator.cut_flash(step, fraction, cut_id=step, off_ps=20 * MS)
    ask_to_save(board, put(board, 100 * MS, **values(NEW)) + MS)
    board.run(900 * MS)
    again = f"step {step}, fraction {fraction}"
    assert causes(board) == [POWER_ON, POWER_ON], again
    found = in_force(board, NAMES, SECOND)
    assert found in (before, NEW), again
    cells = board.emulator.cells()
    board.close()
    board = emulated(cells=cells)
    assert in_force(board, NAMES, 50 * MS) == found, again
    assert save(board, 100 * MS, **values(OLD)) in (DONE, DONE_RESTARTS), again
    board.close()


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.99])
@pytest.mark.parametrize("step", [1, 2, 500, STEPS - 2, STEPS - 1, STEPS])
def test_the_power_goes_within_a_word(kept: bytes, step: int, fraction: float) -> None:
    """The head's mark, the first and a middle word, the CRC, commit and settled word."""
    lose_power(kept, step, fraction)


@pytest.mark.parametrize("fraction", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_the_power_goes_within_an_erasure(fraction: float) -> None:
    lose_power(None, 1, fraction)


@pytest.mark.slow
def test_the_power_goes_within_each_word(kept: bytes) -> None:
    for step in range(1, STEPS + 1):
        lose_power(kept, step, (step * 0.618) % 1.0)

"""A debugger halts the core: the watchdogs go on, or stand still where DBGMCU says so (RM0090, 38.16.2 to 38.16.5)."""

import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil_sim.emulator import Configuration, Emulator
from tests.hil_sim.emulator import oracle

MS = 1_000_000_000
NOTES = 0x2001F800
WWDG_STOP, IWDG_STOP, TIM2_STOP, TIM7_STOP = 1 << 11, 1 << 12, 1 << 0, 1 << 5
IWDGRSTF, WWDGRSTF, PINRSTF, PORRSTF = 1 << 29, 1 << 30, 1 << 26, 1 << 27
HALTED_MS = 1000
"""More than either watchdog waits: 512 and 131 ms."""


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return oracle.build(tmp_path_factory.mktemp("debugged"), oracle.PROGRAMS / "debugged.c")


def notes(board: Emulator) -> tuple[int, int, int]:
    flags, turns, freeze = oracle.words(board.memory(NOTES, 12))
    return flags, turns, freeze


@pytest.fixture
def halted(image: Path, request: pytest.FixtureRequest) -> Iterator[Emulator]:
    """A board that was halted for a while and goes on, with what the parameter gives DBGMCU_APB1_FZ."""
    page = struct.pack("<I", request.param)
    with Emulator(image, Configuration(), parameter_page=page) as board:
        assert board.run(20 * MS), board.report()
        board.debug_halt(True, 20 * MS)
        assert board.run(21 * MS), board.report()
        before = notes(board)
        assert before[1] > 5
        assert board.run(22 * MS), board.report()
        assert notes(board) == before  # It stands still.
        board.debug_halt(False, (20 + HALTED_MS) * MS)
        assert board.run((50 + HALTED_MS) * MS), board.report()
        yield board


@pytest.mark.parametrize("halted", [WWDG_STOP | IWDG_STOP], indirect=True)
def test_frozen_watchdogs_wait_for_the_debugger(halted: Emulator) -> None:
    flags, turns, _ = notes(halted)
    assert flags & PORRSTF
    assert turns > 15


@pytest.mark.parametrize(
    ("halted", "flag", "kept"),
    [(WWDG_STOP, IWDGRSTF, WWDG_STOP), (IWDG_STOP, WWDGRSTF, IWDG_STOP), (0, WWDGRSTF, 0)],
    indirect=["halted"],
)
def test_a_watchdog_that_is_not_frozen_strikes(halted: Emulator, flag: int, kept: int) -> None:
    """And finds the registers of DBGMCU as they were: only a power-on resets them."""
    flags, turns, freeze = notes(halted)
    assert flags == flag | PINRSTF
    assert turns > 5
    assert freeze == kept


def test_a_frozen_watchdog_has_as_long_to_go_as_before(image: Path) -> None:
    """Halted again and again for longer than either waits, the core finds the counters where they were."""
    page = struct.pack("<I", WWDG_STOP | IWDG_STOP)
    with Emulator(image, Configuration(), parameter_page=page) as board:
        for number in range(6):
            begin = (20 + 200 * number) * MS
            board.debug_halt(True, begin)
            board.debug_halt(False, begin + 190 * MS)
            assert board.run(begin + 200 * MS), board.report()
        assert notes(board)[0] & PORRSTF


@pytest.mark.parametrize("freeze", [TIM2_STOP, TIM7_STOP])
def test_freezing_what_the_model_cannot_is_a_violation(image: Path, freeze: int) -> None:
    with Emulator(image, Configuration(), parameter_page=struct.pack("<I", freeze | WWDG_STOP | IWDG_STOP)) as board:
        assert board.run(20 * MS), board.report()
        board.debug_halt(True, 20 * MS)
        assert not board.run(30 * MS)
        assert f"does not freeze what bit {freeze.bit_length() - 1} stands for" in board.report()


def test_a_power_on_resets_what_a_debugger_has_set(image: Path) -> None:
    with Emulator(image, Configuration(), parameter_page=struct.pack("<I", IWDG_STOP)) as board:
        board.supply(0.0, 20 * MS)
        board.supply(3.3, 30 * MS)
        assert board.run(60 * MS), board.report()
        assert notes(board)[2] == 0

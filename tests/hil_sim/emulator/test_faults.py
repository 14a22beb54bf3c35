"""Faults enter their handlers as the ARMv7-M manual (B1.5.14, B3.2.15, B3.5) says; only a lock-up ends a board."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from hil_sim.emulator import Configuration, Emulator
from tests.hil_sim.emulator import oracle

MEMORY, BUS, USAGE, HARD = 4, 5, 6, 3
FORCED = 1 << 30


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return oracle.build(tmp_path_factory.mktemp("faults"), oracle.PROGRAMS / "faults.c")


def told(image: Path) -> tuple[Iterator[int], Emulator]:
    with Emulator(image, Configuration(stop_at_fault=False)) as board:
        return iter(oracle.run_on_emulator(board)), board


def test_each_fault_tells_what_it_was(image: Path) -> None:
    notes, board = told(image)
    at = board.symbols

    def fault(
        name: str, exception: int, cfsr: int, address: int, hfsr: int = 0, behind: int = 0, r0: int = 0x77
    ) -> None:
        expected = [exception, cfsr, hfsr, address, (at[f"at_{name}"] & ~1) + behind, r0]
        assert [next(notes) for _ in expected] == expected, name

    fault("load", BUS, 0x8200, 0x60000000)
    fault("store", BUS, 0x0400, 0, behind=2)  # Buffered: imprecise, behind it, without address.
    fault("store_peripheral", BUS, 0x0400, 0, behind=2)
    fault("store_unbuffered", BUS, 0x8200, 0x60000020)
    fault("undefined", USAGE, 0x10000, 0)
    fault("load_disabled", HARD, 0x8200, 0x60000030, hfsr=FORCED)
    assert next(notes) == 1  # The word below the region.
    fault("read_inside", MEMORY, 0x82, 0x08000400)
    assert next(notes) == 1  # The word above it.
    array = at["guarded"]
    fault("write_read_only", MEMORY, 0x82, array + 256)
    fault("write_inside", MEMORY, 0x82, array + 508)
    assert [next(notes) for _ in range(4)] == [0x77, 0x77, 0, 0]  # Both sides were written, the inside was not.
    fault("read_register", MEMORY, 0x82, 0x40023800)
    assert next(notes) == 1  # The next peripheral.


def test_what_ccr_forbids_is_a_usage_fault(image: Path) -> None:
    """ARMv7-M manual, B3.2.8. Without DIV_0_TRP a quotient is 0, without UNALIGN_TRP a word may lie anywhere."""
    told_notes, board = told(image)
    notes, at = list(told_notes), board.symbols
    begin = [0, 0x55443322, 0x3322]
    rest = iter(notes[next(i for i in range(len(notes)) if notes[i : i + 3] == begin) :])

    def fault(name: str, cfsr: int) -> None:
        expected = [USAGE, cfsr, 0, 0, at[f"at_{name}"] & ~1, 0x77]
        assert [next(rest) for _ in expected] == expected, name

    assert [next(rest) for _ in begin] == begin
    fault("divide", 1 << 25)
    fault("divide_signed", 1 << 25)
    assert [next(rest) for _ in range(2)] == [0x77 // 7, 0x55443322]
    assert next(rest) == 0
    for name in ("unaligned_word", "unaligned_half", "unaligned_store"):
        fault(name, 1 << 24)
    assert [next(rest) for _ in range(3)] == [0x22, 0x4433, 0x77665544]  # The store has no effect.


def test_code_may_be_forbidden(image: Path) -> None:
    told_notes, board = told(image)
    notes, code = list(told_notes), board.symbols["code"]
    start = notes.index(0x55)
    assert notes[start + 1 : start + 7] == [MEMORY, 0x01, 0, 0, code, 0x77]
    assert notes[start + 7 : start + 9] == [0x77, 0x55]  # Not run; run again without the unit.


def test_a_frame_in_the_stack_guard(image: Path) -> None:
    """The frame of SVC meets the read-only region: MemManage is entered in its place, and nothing was stacked."""
    notes, _ = told(image)
    assert list(notes)[-6:-2] == [MEMORY, 0x10, 0, 0]


def test_faults_are_counted_and_told(image: Path) -> None:
    with Emulator(image, Configuration(stop_at_fault=False)) as board:
        oracle.run_on_emulator(board)
        assert (board.statistics().violations, board.statistics().faults) == (0, 17)
        assert "fault at 0.00" in board.report()
        assert "which the memory protection unit forbids" in board.report()


def test_a_board_that_is_to_stop_does(image: Path) -> None:
    with Emulator(image) as board:
        assert not board.run(10 * oracle.MILLISECOND)
        assert board.statistics().faults == 1
        assert "read of unmapped address 0x60000000" in board.report()

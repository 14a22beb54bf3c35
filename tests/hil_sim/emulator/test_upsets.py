"""Instructions that are skipped once and registers that flip, against the sums that a program must come to then."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hil_sim.emulator import Emulator
from tests.hil_sim.emulator import oracle
from tests.hil_sim.emulator.oracle import MILLISECOND

FLAG_Z = 1 << 30


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return oracle.build(tmp_path_factory.mktemp("upsets"), oracle.PROGRAMS / "upsets.c")


def expected(skipped: str = "", nth: int = 0, flip: Callable[[int], int] = lambda total: total) -> list[int]:
    """Return the notes of the program, as its text has it: the last sum, then that of each turn."""
    total, turns = 0, [0] * 5
    for turn in range(5):
        skips = skipped if turn + 1 == nth else ""
        total = flip(total) if turn + 1 == nth else total
        total += 0 if skips == "narrow" else 0x1
        total += 0 if skips == "wide" else 0x10
        total += 0 if skips == "call" else 0x100
        total += 0x1000 if (turn < 2 and skips != "then") or skips == "it" else 0
        total += 0x10000 if (turn >= 2 and skips != "else") or skips == "it" else 0
        turns[turn] = 0 if skips == "store" else total
        if skips == "branch":
            break
    return [total, *turns]


def run(image: Path, ask: Callable[[Emulator], None], argument: int = 0) -> tuple[list[int], int]:
    """Return the notes, and how many instructions the program took."""
    with oracle.load(image, argument=argument) as board:
        before = board.memory(0x08000000, 0x1000)
        ask(board)
        notes = oracle.run_on_emulator(board)
        assert board.memory(0x08000000, 0x1000) == before
        return notes, board.statistics().instructions


def skip(name: str, nth: int) -> Callable[[Emulator], None]:
    def ask(board: Emulator) -> None:
        board.skip(board.symbols[f"at_{name}"], nth)

    return ask


def nothing(_: Emulator) -> None:
    pass


@pytest.mark.parametrize("argument", [0, 1], ids=["alone", "interrupted"])
@pytest.mark.parametrize("nth", range(1, 6))
@pytest.mark.parametrize("name", ["narrow", "wide", "call", "it", "then", "else", "store", "branch"])
def test_an_instruction_is_skipped_once(image: Path, name: str, nth: int, argument: int) -> None:
    notes, _ = run(image, skip(name, nth), argument)
    assert notes == expected(name, nth)


def test_nothing_changes_where_nothing_strikes(image: Path) -> None:
    """The instruction runs five times, so a sixth does not come: all is as it was without, to the instruction."""
    plain = run(image, nothing)
    assert plain[0] == expected()
    assert run(image, skip("narrow", 6)) == plain
    assert run(image, lambda board: board.begin_visits(0, 0x1000)) == plain


def test_a_skipped_instruction_takes_the_time_of_one(image: Path) -> None:
    assert run(image, skip("wide", 3))[1] == run(image, nothing)[1]


@pytest.mark.parametrize("nth", [1, 4])
@pytest.mark.parametrize("bit", [0, 7, 31])
def test_bits_of_a_register_flip(image: Path, bit: int, nth: int) -> None:
    def ask(board: Emulator) -> None:
        board.flip(board.symbols["at_narrow"], 0, 1 << bit, nth)

    want = [value & 0xFFFFFFFF for value in expected("", nth, lambda total: total ^ 1 << bit)]
    assert run(image, ask)[0] == want


def test_flags_and_the_program_counter_flip(image: Path) -> None:
    def flags(board: Emulator) -> None:
        board.flip(board.symbols["at_branch"], 16, FLAG_Z, 2)

    def counter(board: Emulator) -> None:
        """From the narrow instruction, at a multiple of 8, over it to the wide one."""
        board.flip(board.symbols["at_narrow"], 15, 2, 3)

    assert run(image, flags)[0] == expected("branch", 2)
    assert run(image, counter)[0] == expected("narrow", 3)


def test_whether_it_has_struck_is_told(image: Path) -> None:
    with oracle.load(image) as board:
        assert not board.struck()
        board.skip(board.symbols["at_store"], 5)
        assert not board.struck()
        oracle.run_on_emulator(board)
        assert board.struck()


def test_memory_flips_at_once(image: Path) -> None:
    with oracle.load(image) as board:
        before = board.memory(0x20000100, 1)[0]
        board.flip_memory(0x20000100, 0x41)
        assert board.memory(0x20000100, 1)[0] == before ^ 0x41


def test_visits_are_the_first_ones_in_their_order(image: Path) -> None:
    """A turn takes 12 cycles; the first `else` is in the third, and a condition that fails costs none."""
    with oracle.load(image) as board:
        board.begin_visits(0, 0x1000)
        oracle.run_on_emulator(board)
        seen = board.visits()
        at = {name: board.symbols[f"at_{name}"] for name in ("narrow", "wide", "call", "then", "else", "store")}
    first = seen[at["narrow"]]
    cycles = {name: round((seen[place] - first) / 62_500) for name, place in at.items()}
    assert cycles == {"narrow": 0, "wide": 1, "call": 2, "then": 7, "else": 31, "store": 8}
    assert 0 < first < 5 * MILLISECOND
    assert board.symbols["main"] not in seen  # It is odd.


@pytest.mark.parametrize(
    "ask",
    [
        lambda board: board.skip(0x20000000),
        lambda board: board.skip(board.symbols["at_wide"], 0),
        lambda board: board.flip(board.symbols["at_wide"], 15, 1),
        lambda board: board.flip(board.symbols["at_wide"], 16, 1),
        lambda board: board.flip(board.symbols["at_wide"], 17, 1),
        lambda board: board.flip(board.symbols["at_wide"], 1, 0),
        lambda board: board.flip_memory(0x08000000, 1),
        lambda board: board.flip_memory(0x40000000, 1),
        lambda board: board.begin_visits(8, 8),
        lambda board: board.begin_visits(1, 8),
    ],
)
def test_what_cannot_be_is_refused(image: Path, ask: Callable[[Emulator], None]) -> None:
    with oracle.load(image) as board, pytest.raises(ValueError, match=r"can be|is at"):
        ask(board)

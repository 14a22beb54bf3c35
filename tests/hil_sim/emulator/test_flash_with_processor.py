"""A program beside its flash that is programmed or erased: what waits, what goes on, what a loss of power leaves."""

import struct
from pathlib import Path

import pytest

from hil_sim.emulator import BadImageError, Configuration, Emulator, kept_flash
from hil_sim.emulator.bench import MILLISECOND
from tests.hil_sim.emulator import oracle

TARGET = 0x08040000
SECOND_TICKS, TOLERANCE = 16_000_000, 60
"""A sector of 128 KB is erased in 1 s, 16 MHz; what the instructions around it take, in cycles."""
IWDGRSTF = 1 << 29
WORDS, ERASE, TICKS, FLASH_HANDLER, RAM_HANDLER, LOAD, WATCHDOG, STALE, RESET, MANY, CALL, CODE = range(1, 13)


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return oracle.build(tmp_path_factory.mktemp("flashing"), oracle.PROGRAMS / "flashing.c")


def board(image: Path, argument: int, *, flash: Path | None = None, **traits: object) -> Emulator:
    """Make a board with typical times, which a violation stops."""
    configuration = Configuration(**{"memory_seed": 0, **traits})  # type: ignore[arg-type]
    return Emulator(image, configuration, parameter_page=struct.pack("<I", argument), flash=flash)


def notes(image: Path, argument: int, **traits: object) -> list[int]:
    with board(image, argument, **traits) as emulator:
        return oracle.run_on_emulator(emulator)


def within(value: int, cycles: int) -> bool:
    return cycles <= value <= cycles + TOLERANCE


def test_code_in_the_flash_waits_for_each_word(image: Path) -> None:
    """16 us are 256 cycles, which the cycle counter counts as TIM2 does; the status is read afterwards only."""
    before, status, cycles, timer, after, beside = notes(image, WORDS)
    assert before == 0xFFFFFFFF
    assert status == 0
    assert within(cycles, 256)
    assert within(timer, 256)
    assert after == 0x12340000
    assert beside == 0xFFFFFFFF


@pytest.mark.parametrize("cycles", [1.0, 2.5, None])
def test_code_in_the_flash_waits_for_an_erase(image: Path, cycles: float | None) -> None:
    """The timer goes on; of a second of ticks one is left, pending."""
    traits = {"cycles_by_class": True} if cycles is None else {"cycles_per_instruction": cycles}
    status, timer, ticks, content = notes(image, ERASE, **traits)
    assert status == 0
    assert SECOND_TICKS <= timer <= SECOND_TICKS + 250
    assert ticks == 1
    assert content == 0xFFFFFFFF


def test_waiting_is_no_sleep(image: Path) -> None:
    with board(image, ERASE) as emulator:
        oracle.run_on_emulator(emulator)
        statistics = emulator.statistics()
    assert 0 <= SECOND_TICKS + 256 - statistics.flash_wait_cycles <= 2  # Each of the two stores takes its cycle.
    assert statistics.sleep_cycles < 0.006 * SECOND_TICKS  # What is left of the last 5 ms.


@pytest.mark.parametrize("argument", [TICKS, FLASH_HANDLER])
def test_an_exception_that_needs_the_flash_waits(image: Path, argument: int) -> None:
    """The vectors are in the flash, or the handler alone: code in RAM goes on for a millisecond, up to the first."""
    timer, turns, ticks, ram_ticks = notes(image, argument)
    assert within(timer, SECOND_TICKS)
    assert 3900 < turns < 4100  # Four instructions a turn, 16,000 cycles.
    assert (ticks, ram_ticks) == (1, 0)


def test_vectors_and_handler_in_ram_go_on(image: Path) -> None:
    timer, turns, ticks, ram_ticks = notes(image, RAM_HANDLER)
    assert within(timer, SECOND_TICKS)
    assert turns > 3_900_000
    assert (ticks, ram_ticks) == (0, 1000)


def test_a_load_from_the_flash_waits(image: Path) -> None:
    busy_then_value, timer = notes(image, LOAD)
    assert busy_then_value == 0x15AA5
    assert within(timer, SECOND_TICKS)


def test_a_call_into_the_flash_waits(image: Path) -> None:
    _, timer = notes(image, CALL)
    assert within(timer, SECOND_TICKS)


def test_code_in_ram_programs_a_hundred_words(image: Path) -> None:
    assert notes(image, MANY) == [1, 99, 0xFFFFFFFF, 0xFFFFFFFF]


def test_the_watchdog_does_not_wait(image: Path) -> None:
    """512 ms in an erase of 1 s: it resets the chip, and leaves a mix."""
    flags, content = notes(image, WATCHDOG, strict=False)
    assert flags & IWDGRSTF
    assert 0 < content.bit_count() < 32


def test_slices_leave_no_trace(image: Path) -> None:
    results = []
    for step in (2000 * MILLISECOND, 7 * MILLISECOND, 123_456_789):
        with board(image, LOAD) as emulator:
            until = 0
            while until < 1100 * MILLISECOND:
                until = min(until + step, 1100 * MILLISECOND)
                assert emulator.run(until), emulator.report()
            registers = [emulator.register(i) for i in range(24)]
            results.append((emulator.statistics(), registers, emulator.memory(0x20000000, 0x18000)))
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize(("argument", "wrong"), [(STALE, True), (RESET, False)])
def test_caches_that_are_not_reset_are_told(image: Path, argument: int, wrong: bool) -> None:
    """The word that was programmed since may be loaded, the one beside it not."""
    with board(image, argument, strict=False) as emulator:
        oracle.run_on_emulator(emulator)
        assert emulator.statistics().violations == int(wrong)
        assert ("4-byte load at 0x40004, which was erased while the data cache was on" in emulator.report()) == wrong


@pytest.mark.parametrize("by_class", [False, True])
def test_new_code_runs(image: Path, by_class: bool) -> None:
    assert notes(image, CODE, cycles_by_class=by_class) == [41, 42]


# ---- Power ----


def cut_board(image: Path, fraction: float, cut_id: int) -> int:
    """Return the word of which the second program was cut off, when the board is there again."""
    with board(image, WORDS, strict=False) as emulator:
        emulator.cut_flash(2, fraction, cut_id=cut_id, off_ps=50 * MILLISECOND)
        assert emulator.run(40 * MILLISECOND)
        instructions = emulator.statistics().instructions
        assert emulator.run(45 * MILLISECOND)
        assert emulator.statistics().instructions == instructions  # It is off.
        assert emulator.flash_steps() == 2
        word = oracle.words(emulator.memory(TARGET, 4))[0]
        assert emulator.run(60 * MILLISECOND)
        assert emulator.statistics().instructions > instructions
        assert emulator.flash_steps() == 4
    return word


def test_the_supply_is_cut_in_a_step(image: Path) -> None:
    """The first program made 0x12345678 of it, the second would have made 0x12340000."""
    words = [cut_board(image, 0.5, cut_id) for cut_id in range(8)]
    assert all(word & 0xFFFF0000 == 0x12340000 and word & 0xFFFF & ~0x5678 == 0 for word in words)
    assert len(set(words)) > 5
    assert words == [cut_board(image, 0.5, cut_id) for cut_id in range(8)]


def test_the_flash_survives_resets_and_a_supply_that_goes(image: Path) -> None:
    with board(image, WORDS) as emulator:
        oracle.run_on_emulator(emulator)
        emulator.supply(0.0)
        assert emulator.run(emulator.now_ps + MILLISECOND)
        assert oracle.words(emulator.memory(TARGET, 4)) == [0x12340000]


def test_a_file_keeps_the_flash(image: Path, tmp_path: Path) -> None:
    """The image's sector is written anew; the page and what the program wrote stay, whatever the page would be now."""
    path = tmp_path / "board.flash"
    with board(image, WORDS, flash=path) as emulator:
        assert not path.exists()
        assert oracle.run_on_emulator(emulator)[0] == 0xFFFFFFFF
    cells = bytearray(path.read_bytes())
    cells[:0x100] = bytes(0x100)  # The vectors are gone.
    cells[0x3000] = 0  # A byte of the image's sector that no image has written.
    path.write_bytes(cells)
    with board(image, ERASE, flash=path) as emulator:
        assert oracle.run_on_emulator(emulator)[0] == 0x12340000
        assert emulator.memory(0x08003000, 1) == b"\xff"


def test_a_step_at_the_end_is_cut_off(image: Path, tmp_path: Path) -> None:
    path = tmp_path / "board.flash"
    with board(image, ERASE, flash=path) as emulator:
        assert emulator.run(500 * MILLISECOND)
    cells = path.read_bytes()
    sector = cells[0x40000:0x60000]
    assert 0.3 < sum(byte.bit_count() for byte in sector) / (8 * len(sector)) < 0.6
    weak = cells[len(cells) // 2 :]
    assert any(weak[0x40000:0x60000])
    assert not any(weak[:0x40000])


def test_weak_cells_are_kept(image: Path, tmp_path: Path) -> None:
    path = tmp_path / "board.flash"
    with board(image, ERASE, flash=path) as emulator:
        assert emulator.run(500 * MILLISECOND)
    kept = path.read_bytes()
    with board(image, MANY, flash=path) as emulator:
        assert emulator.run(MILLISECOND)
        now = emulator.memory(TARGET, 0x20000)
    weak = kept[kept_flash.CELLS // 2 + 0x40000 :][:0x20000]
    assert now != kept[0x40000:0x60000]
    assert all(a & ~w == b & ~w for a, b, w in zip(now, kept[0x40000:0x60000], weak, strict=True))


def test_files_that_are_none(image: Path, tmp_path: Path) -> None:
    path = tmp_path / "short"
    path.write_bytes(bytes(1000))
    with pytest.raises(BadImageError, match="short is 1000 B long, and a flash 2097152 B"):
        board(image, WORDS, flash=path)
    with pytest.raises(BadImageError, match=r"the flash cannot be read from .*: name another file"):
        board(image, WORDS, flash=tmp_path)
    emulator = board(image, WORDS, flash=tmp_path / "nowhere" / "board")
    with pytest.raises(BadImageError, match=r"the flash cannot be kept in .*: name another file"):
        emulator.close()

"""Time, sleep, counters, probes and loud failures of the processor."""

from collections.abc import Callable
from pathlib import Path

import pytest

from hil_sim.emulator import Configuration, Emulator, Probe
from tests.hil_sim.emulator import oracle
from tests.hil_sim.emulator.oracle import MILLISECOND


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return oracle.build(tmp_path_factory.mktemp("core"), oracle.PROGRAMS / "core.c")


def test_sleep_skips_time(image: Path) -> None:
    with oracle.load(image, argument=1) as board:
        assert oracle.run_on_emulator(board) == [100]
        statistics = board.statistics()
    assert statistics.sleep_cycles > 0.95 * statistics.cycles
    assert statistics.cycles > 1_600_000  # 100 ms at 16 MHz.


def test_time_is_that_of_the_oscillator(image: Path) -> None:
    """1 % fast: the 100th tick comes 1 % earlier."""
    ends = []
    for ppm in (0.0, 10_000.0):
        with Emulator(image, Configuration(internal_ppm=ppm), parameter_page=bytes((1, 0, 0, 0))) as board:
            board.run(3 * MILLISECOND)  # Before, RAM holds anything.
            while oracle.word(board, "ticks") < 100:
                board.run(board.now_ps + MILLISECOND // 100)
            ends.append(board.now_ps)
    assert ends[0] / ends[1] == pytest.approx(1.01, rel=2e-4)


def test_masked_interrupt_wakes(image: Path) -> None:
    with oracle.load(image, argument=2) as board:
        assert oracle.run_on_emulator(board) == [0, 1, 1]


def test_core_coupled_memory_holds_data(image: Path) -> None:
    with oracle.load(image, strict=True, argument=14) as board:
        assert oracle.run_on_emulator(board) == [0x11223344, 0xA5000000, 8]
        assert board.memory(0x10000000, 4) == bytes((0x44, 0x33, 0x22, 0x11))


def test_counters_count_instructions(image: Path) -> None:
    """Six instructions from read to read; 3002 of the loop, its argument, the call and the second read."""
    with oracle.load(image, argument=3) as board:
        assert oracle.run_on_emulator(board)[:2] == [6, 6]
        assert 3002 + 3 <= oracle.run_on_emulator(board)[2] <= 3002 + 6


def trace(image: Path, step: Callable[[int], int]) -> tuple[object, ...]:
    with oracle.load(image, argument=4) as board:
        until, index = 0, 0
        while until < 20 * MILLISECOND:
            until = min(until + step(index), 20 * MILLISECOND)
            index += 1
            assert board.run(until)
        registers = [board.register(i) for i in range(24)]
        return board.statistics(), registers, board.memory(0x20000000, 0x18000)


def test_slices_leave_no_trace(image: Path) -> None:
    """run(20 ms) equals many short runs, of one core cycle (62.5 ns) and odd lengths as well."""
    whole = trace(image, lambda _: 20 * MILLISECOND)
    assert trace(image, lambda _: MILLISECOND) == whole
    assert trace(image, lambda _: 62_500) == whole
    assert trace(image, lambda index: (index * 7919) % 1_000_003) == whole


def test_run_ends_on_time(image: Path) -> None:
    """Never early; late by at most an IT block."""
    with oracle.load(image, argument=4) as board:
        for until in range(1_000_000, 10 * MILLISECOND, 12_345_678):
            assert board.run(until)
            assert until <= board.now_ps <= until + 4 * 62_500


def test_probe_counts_a_known_loop(image: Path) -> None:
    with oracle.load(image, argument=5) as board:
        board.probe("known_loop")
        oracle.run_on_emulator(board)
        assert board.probes() == {"known_loop": Probe(calls=3, total=32 + 3002 + 5, largest=3002, cycles=3002)}


@pytest.mark.parametrize("cycles", [1.5, 2.5])
def test_a_probe_counts_cycles(image: Path, cycles: float) -> None:
    with oracle.load(image, argument=5, cycles_per_instruction=cycles) as board:
        board.probe("known_loop")
        oracle.run_on_emulator(board)
        assert board.probes()["known_loop"].cycles == int(3002 * cycles)


def test_probe_limits(image: Path) -> None:
    with oracle.load(image) as board:
        with pytest.raises(KeyError, match="no function 'nobody'"):
            board.probe("nobody")
        for _ in range(12):
            board.probe("main")
        with pytest.raises(KeyError, match="at most twelve"):
            board.probe("main")


@pytest.mark.parametrize(
    ("argument", "sentence"),
    [
        (6, "4-byte write of 0x1 to unmapped address 0x40018000"),
        (7, "write to unmapped address 0x60000000"),
        (8, "instruction fetch from 0x20020000"),
        (9, "undefined instruction"),
        (10, "unaligned"),
        (15, "write to unmapped address 0x10010000"),
        (16, "instruction fetch from 0x10000000"),
    ],
)
def test_strict_board_stops_and_says_why(image: Path, argument: int, sentence: str) -> None:
    with oracle.load(image, strict=True, argument=argument) as board:
        while board.run(board.now_ps + MILLISECOND):
            assert board.now_ps < 100 * MILLISECOND
        report = board.report()
        assert sentence in report
        assert report.startswith("stopped at")
        assert (board.statistics().violations, board.statistics().faults) == (0, 1)
        assert not board.run(board.now_ps + MILLISECOND)  # For good.


def test_reset_by_software_starts_again(image: Path) -> None:
    with oracle.load(image, strict=True, argument=11) as board:
        assert board.run(20 * MILLISECOND)
        first = board.statistics().instructions
        assert first > 100_000
        assert oracle.word(board, "finished") == 0


def test_lockup_stops_a_tolerant_board_too(image: Path) -> None:
    with oracle.load(image, argument=13) as board:
        while board.run(board.now_ps + MILLISECOND):
            assert board.now_ps < 100 * MILLISECOND
        assert "frame of exception 3 at 0x07ffffe0, where there is no RAM" in board.report()
        assert "lockup: a fault inside the HardFault or NMI handler" in board.report()


def test_wait_for_event_sleeps(image: Path) -> None:
    with oracle.load(image, strict=True, argument=12) as board:
        assert board.run(10 * MILLISECOND)
        assert board.statistics().sleep_cycles > 100_000


def test_factory_bytes(image: Path) -> None:
    with Emulator(image, Configuration(unique_id=bytes(range(12)))) as board:
        assert board.memory(0x1FFF7A10, 12) == bytes(range(12))
        assert board.memory(0x1FFF7A22, 2) == (1024).to_bytes(2, "little")
        assert board.memory(0x080FFFFF, 1) == b"\xff"
        with pytest.raises(ValueError, match="no memory"):
            board.memory(0x60000000, 4)

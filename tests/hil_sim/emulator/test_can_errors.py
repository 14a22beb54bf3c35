"""bxCAN's error management (RM0090 32.7.6, ISO 11898-1 12.1.4): counters, warning, error passive, bus-off, recovery."""

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench
from tests.hil_sim.emulator.test_serial_and_can import CAN, load, start_can

MCR, MSR, TSR, IER, ESR = 0x00, 0x04, 0x08, 0x14, 0x18
EWGF, EPVF, BOFF = 1, 2, 4
NART, ABOM = 0x10, 0x40
LISTENS = 3
SCE_IRQ = 22
RECOVERY = 128 * 11 * MICROSECOND


@pytest.fixture
def chip(fast_chip: Bench) -> Bench:
    return fast_chip


def error(chip: Bench, mailbox: int = LISTENS, count: int = 1) -> None:
    for _ in range(count):
        chip.operations.can_error(chip.board, mailbox, chip.now)
        chip.run(30 * MICROSECOND)


def counters(chip: Bench) -> tuple[int, int]:
    status = chip.read(CAN + ESR)
    return status >> 16 & 0xFF, status >> 24


def flags(chip: Bench) -> int:
    return chip.read(CAN + ESR) & 7


def test_a_destroyed_frame_counts_eight_and_is_sent_again(chip: Bench) -> None:
    start_can(chip)
    load(chip, 0, 0x123, b"abc")
    error(chip, 0)
    assert counters(chip) == (8, 0)
    assert chip.read(CAN + ESR) >> 4 & 7 == 4  # A recessive bit that was dominant.
    assert [identifier for _, identifier, *_ in chip.edge.frames] == [0x123, 0x123]
    assert not chip.read(CAN + TSR) & 1
    chip.operations.can_sent(chip.board, 0, True, chip.now)
    chip.run(MICROSECOND)
    assert counters(chip) == (7, 0)
    assert chip.read(CAN + TSR) & 3 == 3


def test_without_retransmission_it_fails(chip: Bench) -> None:
    start_can(chip, control=NART)
    load(chip, 0, 0x123, b"abc")
    error(chip, 0)
    assert len(chip.edge.frames) == 1
    assert chip.read(CAN + TSR) & 0xF == 9


def test_receiver_warns_turns_passive_and_goes_no_further(chip: Bench) -> None:
    start_can(chip)
    error(chip, count=95)
    assert (counters(chip), flags(chip)) == ((0, 95), 0)
    error(chip)
    assert (counters(chip), flags(chip)) == ((0, 96), EWGF)
    error(chip, count=31)
    assert flags(chip) == EWGF
    error(chip)
    assert (counters(chip), flags(chip)) == ((0, 128), EWGF | EPVF)
    error(chip, count=10)
    assert flags(chip) == EWGF | EPVF
    frame = chip.ffi.new("board_frame_t *", {"id": 5, "extended": True})
    chip.operations.can_in(chip.board, frame, chip.now + 100)
    chip.run(MICROSECOND)
    assert (counters(chip), flags(chip)) == ((0, 120), EWGF)  # A frame without error.


def test_error_passive_sender_lets_others_go_first(chip: Bench) -> None:
    """Suspended transmission: eight bits more."""
    start_can(chip)
    load(chip, 0, 0x123, b"")
    error(chip, 0, count=15)
    assert flags(chip) == EWGF
    error(chip, 0)
    assert flags(chip) == EWGF | EPVF
    count = len(chip.edge.frames)
    now = chip.now
    chip.operations.can_error(chip.board, 0, now)
    chip.run(8 * MICROSECOND)
    assert len(chip.edge.frames) == count
    chip.run(1000)
    assert chip.edge.frames[-1][-1] == now + 8 * MICROSECOND


def bus_off(chip: Bench, control: int) -> None:
    start_can(chip, control=control)
    chip.write(CAN + IER, 0x8400)
    load(chip, 0, 0x123, b"")
    error(chip, 0, count=31)
    assert flags(chip) == EWGF | EPVF
    assert not chip.irq(SCE_IRQ)
    chip.operations.can_error(chip.board, 0, chip.now)
    chip.run(1000)
    assert flags(chip) == EWGF | EPVF | BOFF
    assert chip.irq(SCE_IRQ)


def test_bus_off_sends_and_hears_nothing(chip: Bench) -> None:
    bus_off(chip, 0)
    count = len(chip.edge.frames)
    load(chip, 1, 0x124, b"")
    frame = chip.ffi.new("board_frame_t *", {"id": 5, "extended": True})
    chip.operations.can_in(chip.board, frame, chip.now)
    chip.run(100 * RECOVERY)
    assert len(chip.edge.frames) == count
    assert chip.read(CAN + 0x0C) & 3 == 0
    assert flags(chip) & BOFF


def test_automatic_recovery(chip: Bench) -> None:
    bus_off(chip, ABOM)
    count = len(chip.edge.frames)
    chip.run(RECOVERY - 10 * MICROSECOND)
    assert flags(chip) & BOFF
    assert len(chip.edge.frames) == count
    chip.run(20 * MICROSECOND)
    assert (counters(chip), flags(chip)) == ((0, 0), 0)
    assert chip.edge.frames[-1][1] == 0x123  # What waited is sent.
    assert len(chip.edge.frames) == count + 1


def test_recovery_by_the_program(chip: Bench) -> None:
    """It enters initialisation mode and leaves it; the controller then waits for the recovery sequence."""
    bus_off(chip, 0)
    chip.write(CAN + MCR, 0x10001)
    chip.run(MICROSECOND)
    assert chip.read(CAN + MSR) & 1
    chip.write(CAN + MCR, 0x10000)
    chip.run(RECOVERY - 10 * MICROSECOND)
    assert chip.read(CAN + MSR) & 1
    assert flags(chip) & BOFF
    chip.run(20 * MICROSECOND)
    assert not chip.read(CAN + MSR) & 1
    assert (counters(chip), flags(chip)) == ((0, 0), 0)


def test_a_missing_acknowledge_never_ends_in_bus_off(chip: Bench) -> None:
    start_can(chip)
    load(chip, 0, 0x123, b"")
    for _ in range(60):
        chip.operations.can_sent(chip.board, 0, False, chip.now)
        chip.run(40 * MICROSECOND)
    assert (counters(chip), flags(chip)) == ((128, 0), EWGF | EPVF)

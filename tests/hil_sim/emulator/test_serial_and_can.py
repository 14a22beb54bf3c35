"""USART and bxCAN: directed tests on the bare chip."""

import pytest

from hil_sim.emulator.bench import MICROSECOND, MILLISECOND, Bench

USART1, USART2, DMA2 = 0x40011000, 0x40004400, 0x40026400
SR, DR, BRR, U1, U2, U3 = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14
FE, ORE, IDLE, RXNE, TC, TXE = 2, 8, 0x10, 0x20, 0x40, 0x80
UE, TE, RE, OVER8 = 0x2000, 8, 4, 0x8000
CAN, CAN2 = 0x40006400, 0x40006800
MCR, MSR, TSR, RF0R, RF1R, IER, ESR, BTR = range(0, 0x20, 4)
FMR, FM1R, FS1R, FFA1R, FA1R, BANKS = 0x200, 0x204, 0x20C, 0x214, 0x21C, 0x240
SRAM = 0x20001000


def serial(chip: Bench, brr: int = 42, control: int = UE | TE | RE) -> None:
    chip.alternate("B", 6, 7)
    chip.alternate("B", 7, 7)
    chip.write(USART1 + BRR, brr)
    chip.write(USART1 + U1, control)


def arrive(chip: Bench, data: bytes, start: int, baud: int = 2_000_000) -> None:
    for i, byte in enumerate(data):
        chip.operations.uart_in(chip.board, 1, byte, baud, start + round((i + 1) * 1e13 / baud))


@pytest.mark.parametrize(
    ("brr", "over8", "baud"),
    [(42, False, 2e6), (729, False, 84e6 / 729), (5 << 4 | 2, True, 2e6), (0x30D, False, 84e6 / 0x30D)],
)
def test_byte_times(fast_chip: Bench, brr: int, over8: bool, baud: float) -> None:
    chip = fast_chip
    serial(chip, brr, UE | TE | (OVER8 if over8 else 0))
    assert chip.read(USART1 + SR) == TXE | TC
    begin = chip.now
    chip.write(USART1 + DR, 0x41)
    assert chip.read(USART1 + SR) == TXE
    chip.write(USART1 + DR, 0x42)
    assert chip.read(USART1 + SR) == 0
    chip.run(10.5e12 / baud)
    assert chip.read(USART1 + SR) == TXE
    chip.run(10e12 / baud)
    assert chip.read(USART1 + SR) == TXE | TC
    assert [(u, b) for u, b, _ in chip.edge.sent] == [(1, 0x41), (1, 0x42)]
    for i, (_, _, time) in enumerate(chip.edge.sent):
        assert abs(time - begin - (i + 1) * 10e12 / baud) <= 2


def test_lost_byte_is_loud(fast_chip: Bench) -> None:
    serial(fast_chip)
    for byte in b"abc":
        fast_chip.write(USART1 + DR, byte)
    fast_chip.expect("written while TXE is 0")


def test_transmit_without_pin_is_loud(fast_chip: Bench) -> None:
    fast_chip.write(USART2 + BRR, 42)
    fast_chip.write(USART2 + U1, UE | TE)
    fast_chip.write(USART2 + DR, 1)
    fast_chip.run(MILLISECOND)
    fast_chip.expect("no pin is in its alternate function 7")


def test_transmit_by_dma_is_gapless(fast_chip: Bench) -> None:
    chip = fast_chip
    serial(chip)
    message = bytes(range(1, 41))
    for i, byte in enumerate(message):
        chip.write(SRAM + i, byte, 1)
    base = DMA2 + 0x10 + 7 * 0x18
    chip.write(base + 4, len(message))
    chip.write(base + 8, USART1 + DR)
    chip.write(base + 0xC, SRAM)
    chip.write(base, 4 << 25 | 1 << 10 | 1 << 6 | 1 << 4 | 1)
    begin = chip.now
    chip.write(USART1 + U3, 0x80)
    chip.run(250 * MICROSECOND)
    assert bytes(b for _, b, _ in chip.edge.sent) == message
    assert all(abs(t - begin - (i + 1) * 5 * MICROSECOND) <= 2 for i, (_, _, t) in enumerate(chip.edge.sent))
    assert chip.irq(70)


def test_receive_by_dma_and_idle(fast_chip: Bench) -> None:
    chip = fast_chip
    serial(chip)
    base = DMA2 + 0x10 + 2 * 0x18
    chip.write(base + 4, 16)
    chip.write(base + 8, USART1 + DR)
    chip.write(base + 0xC, SRAM)
    chip.write(base, 4 << 25 | 1 << 10 | 1 << 8 | 1)
    chip.write(USART1 + U3, 0x40)
    chip.change(USART1 + U1, 0x10)
    arrive(chip, b"hello", chip.now)
    chip.run(26 * MICROSECOND)
    assert not chip.irq(37)
    chip.run(10 * MICROSECOND)
    assert chip.irq(37)
    assert chip.read(USART1 + SR) & IDLE
    chip.read(USART1 + DR)
    assert not chip.irq(37)
    assert bytes(chip.read(SRAM + i, 1) for i in range(5)) == b"hello"
    assert chip.read(base + 4) == 11


def test_overrun(fast_chip: Bench) -> None:
    chip = fast_chip
    serial(chip, control=UE | RE | 0x20)
    arrive(chip, b"xy", chip.now)
    chip.run(11 * MICROSECOND)
    chip.expect("byte 0x79 was lost (ORE)")
    assert chip.irq(37)
    assert chip.read(USART1 + SR) & (ORE | RXNE) == ORE | RXNE
    assert chip.read(USART1 + DR) == ord("x")
    assert chip.read(USART1 + SR) & (ORE | RXNE) == 0


@pytest.mark.parametrize(
    ("baud", "error"), [(2_000_000, False), (2_050_000, False), (2_100_000, True), (1_900_000, True)]
)
def test_framing_error(fast_chip: Bench, baud: int, error: bool) -> None:
    serial(fast_chip)
    arrive(fast_chip, b"z", fast_chip.now, baud)
    fast_chip.run(20 * MICROSECOND)
    assert bool(fast_chip.read(USART1 + SR) & FE) == error


def test_serial_rules(fast_chip: Bench) -> None:
    serial(fast_chip)
    fast_chip.write(USART1 + DR, 1)
    fast_chip.write(USART1 + BRR, 84)
    fast_chip.expect("BRR: changed while a frame")
    fast_chip.run(MILLISECOND)
    fast_chip.change(USART1 + U1, OVER8)
    fast_chip.expect("OVER8 may change only while UE is 0")
    fast_chip.change(USART1 + U1, 0x400, OVER8)
    fast_chip.expect("does not do 9-bit frames, parity")


# ---- CAN ----

ONE_MEGABIT = 0 << 24 | 2 << 20 | 9 << 16 | 2  # 42 MHz / 3 / (1 + 10 + 3)


def start_can(chip: Bench, btr: int = ONE_MEGABIT, control: int = 0) -> None:
    chip.alternate("B", 8, 9)
    chip.alternate("B", 9, 9)
    chip.write(CAN + MCR, 0x10001 | control)
    chip.run(MICROSECOND)
    assert chip.read(CAN + MSR) & 3 == 1
    chip.write(CAN + BTR, btr)
    chip.write(CAN + FS1R, 1)
    chip.write(CAN + FA1R, 1)
    chip.change(CAN + FMR, 0, 1)
    chip.write(CAN + MCR, 0x10000 | control)
    chip.run(10 * MICROSECOND)
    assert chip.read(CAN + MSR) & 1 == 1, "11 recessive bits are not over"
    chip.run(2 * MICROSECOND)
    assert chip.read(CAN + MSR) & 3 == 0


@pytest.fixture
def can_chip(fast_chip: Bench) -> Bench:
    start_can(fast_chip)
    return fast_chip


def load(chip: Bench, box: int, identifier: int, data: bytes) -> None:
    base = CAN + 0x180 + 16 * box
    chip.write(base + 4, len(data))
    padded = data.ljust(8, b"\0")
    chip.write(base + 8, int.from_bytes(padded[:4], "little"))
    chip.write(base + 12, int.from_bytes(padded[4:], "little"))
    chip.write(base, identifier << 3 | 4 | 1)


def frame_in(chip: Bench, identifier: int, data: bytes = b"", extended: bool = True) -> None:
    frame = chip.ffi.new("board_frame_t *")
    frame.id, frame.extended, frame.length = identifier, extended, len(data)
    frame.data = data.ljust(8, b"\0")
    chip.operations.can_in(chip.board, frame, chip.now)
    chip.run(MICROSECOND)


def test_frames_out_and_acknowledged(can_chip: Bench) -> None:
    chip = can_chip
    chip.write(CAN + IER, 1)
    assert chip.read(CAN + TSR) & 0x1F000000 == 0x1C000000
    load(chip, 0, 0x1ABCDEF, b"\1\2\3\4\5")
    load(chip, 1, 0x1FFFFFFF, b"")
    assert [f[:4] for f in chip.edge.frames] == [(0, 0x1ABCDEF, True, b"\1\2\3\4\5"), (1, 0x1FFFFFFF, True, b"")]
    assert chip.read(CAN + TSR) == 1 << 28 | 2 << 24 | 1 << 30, "TME2, CODE 2, LOW1"
    chip.operations.can_sent(chip.board, 0, True, chip.now + 100)
    chip.run(1000)
    assert chip.irq(19)
    assert chip.read(CAN + TSR) & 0x0400000F == 0x04000003
    chip.write(CAN + TSR, 1)
    assert not chip.irq(19)
    chip.write(CAN + 0x190, 0)
    chip.expect("mailbox 1 written while it is not empty")


def test_order_of_request(fast_chip: Bench) -> None:
    chip = fast_chip
    start_can(chip, control=4)
    for box, identifier in ((1, 0x300), (0, 0x100), (2, 0x200)):
        load(chip, box, identifier, b"")
    for box in (1, 0, 2):
        assert chip.edge.frames[-1][0] == box
        chip.operations.can_sent(chip.board, box, True, chip.now)
        chip.run(1000)
    assert len(chip.edge.frames) == 3


def test_abort_of_what_the_network_has(can_chip: Bench) -> None:
    """It may be on the bus, and then its outcome counts (RM0090 32.7.1): nobody knows here, so it is said."""
    chip = can_chip
    load(chip, 2, 5, b"")
    chip.write(CAN + TSR, 1 << 23)
    chip.expect("mailbox 2 may be on the bus")
    assert chip.edge.aborts == [(2, chip.now)]
    assert chip.read(CAN + TSR) & 0x100F0000 == 0x10010000, "RQCP2 without TXOK2; TME2"
    chip.operations.can_sent(chip.board, 2, True, chip.now)
    chip.run(1000)
    assert chip.read(CAN + TSR) & 0x20000 == 0, "what comes behind the abort is of no request"


def test_lone_node_turns_error_passive_and_tries_on(can_chip: Bench) -> None:
    chip = can_chip
    chip.write(CAN + IER, 0x8300)
    load(chip, 0, 7, b"")
    for i in range(1, 20):
        chip.operations.can_sent(chip.board, 0, False, chip.now)
        chip.run(30 * MICROSECOND)
        assert len(chip.edge.frames) == i + 1
        status = chip.read(CAN + ESR)
        assert status >> 16 & 0xFF == min(8 * i, 128)
        assert status & 7 == (i >= 12) | (i >= 16) << 1
        assert status >> 4 & 7 == 3
    assert chip.irq(22)


def test_no_retransmission(fast_chip: Bench) -> None:
    chip = fast_chip
    start_can(chip, control=0x10)
    load(chip, 0, 7, b"")
    chip.operations.can_sent(chip.board, 0, False, chip.now)
    chip.run(MILLISECOND)
    assert len(chip.edge.frames) == 1
    assert chip.read(CAN + TSR) & 0xF == 0x9


def test_receive_release_and_overrun(can_chip: Bench) -> None:
    chip = can_chip
    chip.write(CAN + IER, 2 | 8)
    for i in range(3):
        frame_in(chip, 0x1000 + i, bytes([i]))
    assert chip.irq(20)
    assert chip.read(CAN + RF0R) == 0xB
    frame_in(chip, 0x1003, b"\3")
    chip.expect("FIFO 0 overrun")
    assert chip.read(CAN + RF0R) == 0x1B
    seen = []
    while chip.read(CAN + RF0R) & 3:
        seen.append((chip.read(CAN + 0x1B0) >> 3, chip.read(CAN + 0x1B8) & 0xFF, chip.read(CAN + 0x1B4) & 15))
        chip.write(CAN + RF0R, 0x20)
    assert seen == [(0x1000, 0, 1), (0x1001, 1, 1), (0x1003, 3, 1)], "without RFLM the newest replaces the last"
    chip.write(CAN + RF0R, 0x18)
    assert not chip.irq(20)


@pytest.mark.parametrize("ppm", [0.0, 80.0])
def test_reception_waits_for_the_receivers_time_quantum(ppm: float) -> None:
    """RM0090 32.7.7: a time quantum is (BRP + 1) clocks of the receiver, here 3 / 42 MHz = 71.4 ns."""
    chip = Bench(crystal_ppm=ppm)
    chip.full_speed()
    start_can(chip)
    chip.write(CAN + IER, 2)
    quantum_ps = 3 / (42e6 * (1 + ppm * 1e-6)) * 1e12
    frame = chip.ffi.new("board_frame_t *", {"id": 5, "extended": True})
    times: list[int] = []
    for i in range(40):
        valid_ps = chip.now + 100 * MICROSECOND + 7_001 * i
        chip.operations.can_in(chip.board, frame, valid_ps)
        chip.run_to(valid_ps)
        while not chip.irq(20):
            chip.run(100)
        times.append(chip.now)
        assert 0 <= times[-1] - valid_ps <= quantum_ps + 100
        chip.write(CAN + RF0R, 0x20)
    steps = [(time - times[0]) / quantum_ps for time in times]
    assert all(abs(step - round(step)) < 0.005 for step in steps)
    assert not chip.report
    chip.close()


@pytest.mark.parametrize(
    ("mode", "scale", "bank", "passing", "stopped"),
    [
        (0, 1, (0x123 << 3 | 4, 0x1FFFFFFF << 3 | 4), [(0x123, True)], [(0x122, True), (0x123, False)]),
        (0, 1, (0x10000 << 3 | 4, 0x1FFF0000 << 3 | 4), [(0x10000, True), (0x1FFFF, True)], [(0x20000, True)]),
        (1, 1, (5 << 21, 9 << 3 | 4), [(5, False), (9, True)], [(5, True), (9, False)]),
        (0, 0, (0xFFF8 << 16 | 5 << 5, 0xFFFF << 16 | 0xFFFF), [(5, False)], [(6, False), (5 << 18, True)]),
        (1, 0, (1 << 5 | 2 << 21, 3 << 5 | (4 << 5 | 8 | 5) << 16), [(1, False), (2, False), (3, False),
          (4 << 18 | 5 << 15, True)], [(4, False)]),
    ],
)  # fmt: skip
def test_filters(
    can_chip: Bench,
    mode: int,
    scale: int,
    bank: tuple[int, int],
    passing: list[tuple[int, bool]],
    stopped: list[tuple[int, bool]],
) -> None:
    chip = can_chip
    chip.change(CAN + FMR, 1)
    chip.write(CAN + FA1R, 0)
    for offset, value in (
        (FM1R, mode << 3),
        (FS1R, 1 | scale << 3),
        (FFA1R, 1 << 3),
        (BANKS + 24, bank[0]),
        (BANKS + 28, bank[1]),
    ):
        chip.write(CAN + offset, value)
    chip.write(CAN + FA1R, 1 << 3)
    chip.change(CAN + FMR, 0, 1)
    for identifier, extended in stopped:
        frame_in(chip, identifier, extended=extended)
        assert chip.read(CAN + RF1R) == 0
    for i, (identifier, extended) in enumerate(passing):
        frame_in(chip, identifier, extended=extended)
        assert chip.read(CAN + RF1R) & 3 == 1
        matched = chip.read(CAN + 0x1C4) >> 8
        assert matched == (i if mode else 0)
        chip.write(CAN + RF1R, 0x38)


def test_loop_back(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.alternate("B", 8, 9)
    start_can(chip, btr=ONE_MEGABIT | 3 << 30)
    load(chip, 0, 0x42, b"loop")
    chip.run(98 * MICROSECOND)
    assert chip.read(CAN + RF0R) & 3 == 0
    chip.run(2 * MICROSECOND)
    assert chip.read(CAN + RF0R) & 3 == 1
    assert chip.read(CAN + 0x1B0) >> 3 == 0x42
    assert chip.edge.frames == []


def test_wrong_bit_rate() -> None:
    """A crystal 1 % off, or a network of another rate: nothing is understood. Above 1 Mbit/s: loud at once."""
    chip = Bench(crystal_ppm=10000.0)
    chip.full_speed()
    start_can(chip)
    frame_in(chip, 1)
    load(chip, 0, 1, b"")
    chip.run(MILLISECOND)
    assert chip.read(CAN + RF0R) == 0
    assert chip.edge.frames == []
    assert chip.read(CAN + ESR) >> 16 & 0xFF == 128
    assert not chip.report
    chip.write(CAN + MCR, 0x10001)
    chip.run(MILLISECOND)
    chip.write(CAN + BTR, 0x01230000)
    chip.write(CAN + MCR, 0x10000)
    chip.expect("makes 5250000 bit/s, above 1 Mbit/s")
    chip.close()


def test_the_rate_of_the_network(can_chip: Bench) -> None:
    """A controller of 1 Mbit/s hears nothing at 500 kbit/s; with twice the divider it does."""
    chip = can_chip
    chip.operations.can_rate(chip.board, 500_000)
    frame_in(chip, 1)
    chip.run(MILLISECOND)
    assert chip.read(CAN + RF0R) & 3 == 0
    assert chip.read(CAN + ESR) >> 24 > 0
    chip.write(CAN + MCR, 0x10001)
    chip.run(MILLISECOND)
    chip.write(CAN + BTR, (ONE_MEGABIT & ~0x3FF) | (2 * ((ONE_MEGABIT & 0x3FF) + 1) - 1))
    chip.write(CAN + MCR, 0x10000)
    chip.run(MILLISECOND)
    frame_in(chip, 2)
    chip.run(MILLISECOND)
    assert chip.read(CAN + RF0R) & 3 == 1


def test_can_rules(can_chip: Bench) -> None:
    chip = can_chip
    chip.write(CAN + BTR, ONE_MEGABIT)
    chip.expect("written outside initialisation mode")
    chip.write(CAN + FM1R, 1)
    chip.expect("outside filter initialisation")
    chip.write(CAN + BANKS, 1)
    chip.expect("while its bank is active")
    chip.write(CAN + MCR, 0, 2)
    chip.expect("16 bits is not supported")
    chip.write(CAN2 + FMR, 0)
    chip.expect("where no register is")


def test_receiver_without_pin(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(CAN + MCR, 0x10001)
    chip.run(MICROSECOND)
    chip.write(CAN + BTR, ONE_MEGABIT)
    chip.write(CAN + MCR, 0x10000)
    chip.expect("it never synchronises")
    chip.run(MILLISECOND)
    assert chip.read(CAN + MSR) & 1


@pytest.mark.parametrize(
    ("modes", "scales", "index"),
    [(0b000, 0b111, 0), (0b100, 0b111, 2), (0b000, 0b110, 2), (0b001, 0b110, 4)],
)
def test_filter_priority(can_chip: Bench, modes: int, scales: int, index: int) -> None:
    """32 bits before 16, list before mask, then the lower number; filters are numbered over all banks of the FIFO."""
    chip = can_chip
    chip.change(CAN + FMR, 1)
    chip.write(CAN + FA1R, 0)
    chip.write(CAN + FM1R, modes)
    chip.write(CAN + FS1R, scales)
    for bank in range(3):
        wide, listed = scales >> bank & 1, modes >> bank & 1
        value = 5 << 21 if wide else (5 << 5) * (0x10001 if listed else 1)
        chip.write(CAN + BANKS + 8 * bank, value)
        chip.write(CAN + BANKS + 8 * bank + 4, value if listed else 0)
    chip.write(CAN + FA1R, 7)
    chip.change(CAN + FMR, 0, 1)
    frame_in(chip, 5, extended=False)
    assert chip.read(CAN + RF0R) & 3 == 1
    assert chip.read(CAN + 0x1B4) >> 8 == index

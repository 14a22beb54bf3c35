"""DMA controllers: directed tests on the bare chip, after RM0090 10 and AN4031."""

import pytest

from hil_sim.emulator.bench import MICROSECOND, MILLISECOND, Bench
from tests.hil_sim.emulator.timer_bench import (
    ARR,
    CCM,
    CCR1,
    CIRC,
    CNT,
    CT,
    DBM,
    DCR,
    DIER,
    DMA1,
    DMA2,
    DMAR,
    EGR,
    GPIOC,
    HALVES,
    HTIE,
    MEMORY_TO_MEMORY,
    MINC,
    PINC,
    RCR,
    SRAM,
    TCIE,
    TIM1,
    TIM3,
    TIM6,
    TO_MEMORY,
    TO_PERIPHERAL,
    WORDS,
    flags,
    pulse,
    stream,
)

MAP = [  # A sample of RM0090 tables 42 and 43: controller, stream, channel, line
    (1, 0, 2, "TIM4_CH1"), (1, 1, 3, "TIM2_UP"), (1, 1, 3, "TIM2_CH3"), (1, 1, 7, "TIM6_UP"),
    (1, 2, 1, "TIM7_UP"), (1, 2, 5, "TIM3_UP"), (1, 2, 4, "UART4_RX"), (1, 1, 4, "USART3_RX"), (1, 3, 4, "USART3_TX"),
    (1, 4, 7, "USART3_TX"), (1, 5, 4, "USART2_RX"), (1, 5, 7, "DAC1"), (1, 6, 7, "DAC2"),
    (1, 6, 4, "USART2_TX"), (1, 6, 6, "TIM5_UP"), (1, 7, 3, "TIM2_CH4"), (1, 7, 4, "UART5_TX"),
    (1, 0, 4, "UART5_RX"), (1, 4, 4, "UART4_TX"), (2, 0, 0, "ADC1"), (2, 4, 0, "ADC1"), (2, 2, 1, "ADC2"),
    (2, 3, 1, "ADC2"), (2, 0, 2, "ADC3"), (2, 1, 2, "ADC3"), (2, 2, 4, "USART1_RX"), (2, 5, 4, "USART1_RX"),
    (2, 7, 4, "USART1_TX"), (2, 1, 5, "USART6_RX"), (2, 7, 5, "USART6_TX"), (2, 5, 6, "TIM1_UP"),
    (2, 1, 6, "TIM1_CH1"), (2, 2, 6, "TIM1_CH2"), (2, 6, 6, "TIM1_CH3"), (2, 4, 6, "TIM1_CH4"),
    (2, 6, 0, "TIM1_CH2"), (2, 1, 7, "TIM8_UP"), (2, 7, 7, "TIM8_CH4"),
]  # fmt: skip


@pytest.mark.parametrize(("controller", "n", "channel", "line"), MAP)
def test_request_map(fast_chip: Bench, controller: int, n: int, channel: int, line: str) -> None:
    """The stream serves this line, and of all lines no other one that the map does not give it."""
    chip = fast_chip
    base = DMA1 if controller == 1 else DMA2
    chip.write(SRAM, 0x55)
    stream(chip, base, n, channel << 25 | WORDS | TO_PERIPHERAL | CIRC, 9, TIM3 + CCR1, SRAM)
    allowed = {x[3] for x in MAP if x[:3] == (controller, n, channel)}
    for other in sorted({x[3] for x in MAP} - allowed):
        if not (line.startswith("TIM") and other.startswith(line[:4])):
            assert chip.lib.machine_bench_dma_pulse(chip.machine, other.encode())
    count = base + 0x14 + 0x18 * n
    assert chip.read(count) == 9
    pulse(chip, line)
    assert chip.read(count) == 8
    assert chip.read(TIM3 + CCR1) == 0x55


def test_half_and_full_transfer(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(TIM3 + CNT, 0xBEEF)
    stream(chip, DMA1, 1, 7 << 25 | HALVES | MINC | TCIE | HTIE, 4, TIM3 + CNT, SRAM)
    seen = []
    for _ in range(4):
        pulse(chip, "TIM6_UP")
        seen.append((flags(chip, DMA1, 1), chip.irq(12), chip.read(DMA1 + 0x2C)))
    assert seen == [(0, False, 3), (0x10, True, 2), (0x10, True, 1), (0x30, True, 0)]
    assert chip.read(SRAM + 4) == 0xBEEFBEEF
    assert chip.read(DMA1 + 0x28) & 1 == 0
    chip.write(DMA1 + 8, 0x3D << 6)
    assert not chip.irq(12)


def test_double_buffer_and_its_free_address(fast_chip: Bench) -> None:
    chip = fast_chip
    stream(chip, DMA1, 1, 7 << 25 | HALVES | MINC | DBM | CIRC, 2, TIM3 + CNT, SRAM, second=SRAM + 0x100)
    for value in range(1, 7):
        chip.write(TIM3 + CNT, value)
        pulse(chip, "TIM6_UP")
        assert bool(chip.read(DMA1 + 0x28) & CT) == (value in (2, 3, 6))
        if value == 3:
            chip.write(DMA1 + 0x34, SRAM + 0x200)  # M0AR, while buffer 1 is in use
    assert [chip.read(a) for a in (SRAM, SRAM + 0x100, SRAM + 0x200)] == [0x20001, 0x40003, 0x60005]
    chip.write(DMA1 + 0x38, 0)  # M1AR is now in use
    chip.expect("M1AR written while EN is set")


def test_memory_side_is_prefetched(fast_chip: Bench) -> None:
    """Direct mode fetches the next item as soon as EN is set or the last one left: a later change of it is not seen."""
    chip = fast_chip
    chip.write(SRAM, 0x00020001)
    stream(chip, DMA1, 1, 7 << 25 | HALVES | MINC | TO_PERIPHERAL, 2, TIM3 + CCR1, SRAM)
    chip.write(SRAM, 0x00990098)
    pulse(chip, "TIM6_UP")
    assert chip.read(TIM3 + CCR1) == 1
    pulse(chip, "TIM6_UP")
    assert chip.read(TIM3 + CCR1) == 0x99


def test_fifo_packs_and_flushes(fast_chip: Bench) -> None:
    chip = fast_chip
    control = 7 << 25 | 1 << 11 | 2 << 13 | MINC  # Half-words in, words out
    stream(chip, DMA1, 1, control, 6, TIM3 + CNT, SRAM, fifo=0x20 | 4 | 1)  # Threshold a half: 8 bytes
    for value in range(1, 7):
        chip.write(TIM3 + CNT, value)
        pulse(chip, "TIM6_UP")
        if value == 3:
            assert chip.read(SRAM) == 0
            assert chip.read(DMA1 + 0x3C) >> 3 & 7 == 1
        if value == 4:
            assert chip.read(SRAM + 4) == 0x40003
    assert [chip.read(SRAM + 4 * i) for i in range(3)] == [0x20001, 0x40003, 0x60005]


def test_memory_to_memory(fast_chip: Bench) -> None:
    chip = fast_chip
    for i in range(5):
        chip.write(SRAM + 4 * i, 0x1000 + i)
    stream(chip, DMA2, 0, WORDS | MINC | PINC | MEMORY_TO_MEMORY, 5, SRAM, SRAM + 0x100, fifo=0x27)
    chip.run(MICROSECOND)
    assert [chip.read(SRAM + 0x100 + 4 * i) for i in range(5)] == [0x1000 + i for i in range(5)]
    assert flags(chip, DMA2, 0) & 0x20


@pytest.mark.parametrize(
    ("controller", "control", "count", "peripheral", "memory", "fifo", "sentence"),
    [
        (DMA1, 7 << 25 | HALVES, 1, GPIOC + 0x14, SRAM, 0, "all that DMA1 reaches"),
        (DMA1, 7 << 25 | HALVES | TO_PERIPHERAL, 1, TIM3 + CCR1, CCM, 0, "CCM, which no DMA reaches"),
        (DMA1, 7 << 25 | HALVES, 0, TIM3 + CNT, SRAM, 0, "NDTR 0"),
        (DMA1, 7 << 25 | WORDS, 1, TIM3 + CNT + 2, SRAM, 0, "not aligned"),
        (DMA1, 7 << 25 | 1 << 11 | 2 << 13, 3, TIM3 + CNT, SRAM, 4, "NDTR is not a multiple"),
        (DMA1, 7 << 25 | WORDS | 1 << 23, 4, TIM3 + CNT, SRAM, 5, "does not fit the FIFO threshold"),
        (DMA1, WORDS | MEMORY_TO_MEMORY, 4, SRAM, SRAM, 4, "memory-to-memory needs DMA2"),
        (DMA1, 7 << 25 | 3 << 11, 4, TIM3 + CNT, SRAM, 0, "reserved value 3"),
    ],
)  # fmt: skip
def test_illegal_streams(
    fast_chip: Bench, controller: int, control: int, count: int, peripheral: int, memory: int, fifo: int, sentence: str
) -> None:
    chip = fast_chip
    stream(chip, controller, 1, control, count, peripheral, memory, fifo=fifo)
    chip.expect(sentence)
    assert chip.read(controller + 0x28) & 1 == 0


@pytest.mark.parametrize(
    ("control", "peripheral", "memory", "fifo"),
    [
        (TO_PERIPHERAL, TIM1 + CCR1, CCM, 0x21),
        (TO_MEMORY, TIM1 + CNT, CCM + 0xFFF0, 0x21),
        (TO_PERIPHERAL, CCM + 0x100, SRAM, 0x21),
        (MEMORY_TO_MEMORY | PINC, SRAM, CCM, 0x27),
        (MEMORY_TO_MEMORY | PINC, CCM, SRAM, 0x27),
    ],
)
def test_core_coupled_memory_is_out_of_reach(
    fast_chip: Bench, control: int, peripheral: int, memory: int, fifo: int
) -> None:
    """RM0090 2.3.1: only the core's data bus reaches it. A transfer error: TEIF with its interrupt, EN falls."""
    chip = fast_chip
    stream(chip, DMA2, 5, 6 << 25 | WORDS | MINC | 1 << 2 | control, 4, peripheral, memory, fifo=fifo)
    if control in (TO_PERIPHERAL, TO_MEMORY):
        pulse(chip, "TIM1_UP")
    chip.run(MICROSECOND)
    assert flags(chip, DMA2, 5) & 8
    assert chip.irq(68)
    assert chip.read(DMA2 + 0x88) & 1 == 0
    chip.expect("bus error")


def test_protected_registers_and_stale_flags(fast_chip: Bench) -> None:
    chip = fast_chip
    stream(chip, DMA1, 1, 7 << 25 | HALVES, 4, TIM3 + CNT, SRAM)
    chip.write(DMA1 + 0x2C, 9)
    chip.expect("NDTR written while EN is set")
    chip.change(DMA1 + 0x28, MINC)
    chip.expect("protected bits")
    chip.change(DMA1 + 0x28, 0, 1)
    assert flags(chip, DMA1, 1) == 0x20, "a stream that software stops sets TCIF"
    chip.change(DMA1 + 0x28, 1)
    chip.expect("event flags are still set")
    chip.write(DMA1 + 8, 0xFFFFFFFF & 0x0F7D0F7D)


def test_two_streams_on_one_line(fast_chip: Bench) -> None:
    stream(fast_chip, DMA2, 0, HALVES, 4, TIM3 + CNT, SRAM)
    stream(fast_chip, DMA2, 4, HALVES, 4, TIM3 + CNT, SRAM)
    fast_chip.expect("already served by DMA2 stream 0")


def test_timer_request_without_reader_waits(fast_chip: Bench) -> None:
    """A request stays until it is served, or until its enable bit falls."""
    chip = fast_chip
    chip.write(TIM6 + DIER, 1 << 8)
    chip.write(TIM6 + EGR, 1)
    stream(chip, DMA1, 1, 7 << 25 | HALVES, 4, TIM3 + CNT, SRAM)
    assert chip.read(DMA1 + 0x2C) == 3
    chip.change(DMA1 + 0x28, 0, 1)
    chip.write(DMA1 + 8, 0x3D << 6)
    chip.write(TIM6 + EGR, 1)
    chip.write(TIM6 + DIER, 0)
    stream(chip, DMA1, 1, 7 << 25 | HALVES, 4, TIM3 + CNT, SRAM)
    assert chip.read(DMA1 + 0x2C) == 4
    chip.run(MILLISECOND)


# ---- Arbitration, bus time, the erratum ----

LINES = {1: "TIM1_CH1", 2: "TIM1_CH2", 5: "TIM1_UP", 6: "TIM1_CH3"}  # Channel 6 of DMA2


def ticks_of_edges(chip: Bench, begin: int) -> list[tuple[int, int]]:
    """Pins of port C and the AHB cycles after which they rose."""
    return [(pin - 32, round((time - begin) * 168e6 / 1e12)) for pin, high, time in chip.edge.pins if high]


@pytest.mark.parametrize("priorities", [{1: 0, 2: 0, 5: 0, 6: 0}, {1: 0, 2: 1, 5: 3, 6: 2}, {1: 1, 2: 3, 5: 0, 6: 1}])
@pytest.mark.parametrize("first", [1, 6])
def test_simultaneous_requests_are_served_one_after_another(
    fast_chip: Bench, priorities: dict[int, int], first: int
) -> None:
    """The first meets an idle controller; of those that wait the highest PL is next, of equals the lowest stream."""
    chip = fast_chip
    chip.write(GPIOC, 0x1555)
    for n, priority in priorities.items():
        chip.write(SRAM + 4 * n, 1 << n)
        control = 6 << 25 | priority << 16 | WORDS | TO_PERIPHERAL
        stream(chip, DMA2, n, control, 1, GPIOC + 0x18, SRAM + 4 * n)
    begin = chip.now
    for n in [first, *(n for n in priorities if n != first)]:
        assert chip.lib.machine_bench_dma_pulse(chip.machine, LINES[n].encode())
    chip.run(MICROSECOND)
    waiting = sorted((n for n in priorities if n != first), key=lambda n: (-priorities[n], n))
    assert ticks_of_edges(chip, begin) == [(n, 8 * i) for i, n in enumerate([first, *waiting])]


@pytest.mark.parametrize(
    ("controller", "peripheral", "fifo", "cycles"),
    [
        (DMA2, TIM1 + CCR1, 0x21, 11),  # AN4031, 3.2.1: 7 and 4 at half the clock, past the bus matrix
        (DMA2, TIM1 + CCR1, 0x25, 7),  # with the FIFO
        (DMA1, TIM3 + CCR1, 0x21, 15),  # tables 4 and 5: 3, two clocks of APB1 at a quarter, 4
        (DMA2, TIM3 + CCR1, 0x21, 16),  # through the bus matrix
        (DMA2, GPIOC + 0x14, 0x21, 8),  # AHB: 4 and 4
        (DMA2, GPIOC + 0x14, 0x25, 4),
    ],
)
def test_time_of_an_item(fast_chip: Bench, controller: int, peripheral: int, fifo: int, cycles: int) -> None:
    """Two items asked for at once, of two streams: the second is there when the first one's time is over."""
    chip = fast_chip
    streams = {DMA2: ((1, 6, "TIM1_CH1"), (2, 6, "TIM1_CH2")), DMA1: ((1, 7, "TIM6_UP"), (4, 1, "TIM7_UP"))}[controller]
    for n, channel, _ in streams:
        stream(chip, controller, n, channel << 25 | HALVES | TO_PERIPHERAL, 8, peripheral, SRAM, fifo=fifo)
    begin = chip.now
    for _, _, line in streams:
        assert chip.lib.machine_bench_dma_pulse(chip.machine, line.encode())
    count = controller + 0x14 + 0x18 * streams[1][0]
    chip.run_to(begin + cycles * 1e12 / 168e6 - 1000)
    assert chip.read(count) == 8
    chip.run_to(begin + cycles * 1e12 / 168e6 + 1000)
    assert chip.read(count) == 7


def test_the_two_controllers_do_not_wait_for_each_other(fast_chip: Bench) -> None:
    chip = fast_chip
    stream(chip, DMA1, 1, 7 << 25 | HALVES | TO_PERIPHERAL, 8, TIM3 + CCR1, SRAM)
    stream(chip, DMA2, 5, 6 << 25 | HALVES | TO_PERIPHERAL, 8, TIM1 + CCR1, SRAM)
    for line in (b"TIM6_UP", b"TIM1_UP"):
        assert chip.lib.machine_bench_dma_pulse(chip.machine, line)
    assert [chip.read(DMA1 + 0x2C), chip.read(DMA2 + 0x8C)] == [7, 7]


def test_a_burst_is_not_disturbed_by_another_request_of_its_timer(fast_chip: Bench) -> None:
    chip = fast_chip
    for i, value in enumerate((500, 0, 200, 300)):
        chip.write(SRAM + 2 * i, value, 2)
    chip.write(SRAM + 0x40, 77)
    stream(chip, DMA2, 5, 6 << 25 | HALVES | MINC | TO_PERIPHERAL, 4, TIM1 + DMAR, SRAM)
    stream(chip, DMA2, 6, 6 << 25 | 3 << 16 | HALVES | TO_PERIPHERAL, 1, TIM1 + CCR1 + 12, SRAM + 0x40)
    chip.write(TIM1 + DCR, 3 << 8 | ARR // 4)
    chip.write(TIM1 + DIER, 1 << 8 | 1 << 11)
    chip.write(TIM1 + EGR, 1 | 8)
    chip.run(MICROSECOND)
    assert [chip.read(TIM1 + r) for r in (ARR, RCR, CCR1, CCR1 + 4, CCR1 + 12)] == [500, 0, 200, 300, 77]


ON_AHB, ON_APB = GPIOC + 0x18, TIM1 + CCR1


@pytest.mark.parametrize(
    ("first", "second", "corrupts"),
    [(ON_AHB, ON_APB, True), (ON_APB, ON_AHB, True), (ON_APB, ON_APB, False), (ON_AHB, ON_AHB, False)],
)
def test_dma2_on_both_buses_is_loud(fast_chip: Bench, first: int, second: int, corrupts: bool) -> None:
    """ES0182, DMA2 data corruption when managing AHB and APB peripherals in a concurrent way."""
    chip = fast_chip
    stream(chip, DMA2, 5, 6 << 25 | WORDS | TO_PERIPHERAL, 2, first, SRAM)
    stream(chip, DMA2, 1, 6 << 25 | WORDS | TO_PERIPHERAL, 2, second, SRAM)
    if corrupts:
        chip.expect("concurrent transfers to both buses can corrupt data (errata ES0182)")


def test_dma2_on_both_buses_in_turn(fast_chip: Bench) -> None:
    chip = fast_chip
    stream(chip, DMA2, 5, 6 << 25 | WORDS | TO_PERIPHERAL, 1, ON_AHB, SRAM)
    pulse(chip, "TIM1_UP")
    stream(chip, DMA2, 1, 6 << 25 | WORDS | TO_PERIPHERAL, 2, ON_APB, SRAM)

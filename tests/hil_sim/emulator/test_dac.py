"""DAC: alignments, triggers, DMA and its underrun, on the bare chip (RM0090 chapter 14)."""

from collections.abc import Iterator
from itertools import pairwise

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench

DAC, EXTI, DMA1, DMA2 = 0x40007400, 0x40013C00, 0x40026000, 0x40026400
TIM1, TIM2, TIM4, TIM5, TIM6, TIM7, TIM8 = (
    0x40010000, 0x40000000, 0x40000800, 0x40000C00, 0x40001000, 0x40001400, 0x40010400,
)  # fmt: skip
CR, SWTRIGR, DHR12R1, DHR12RD, DOR1, DOR2, SR = 0x00, 0x04, 0x08, 0x20, 0x2C, 0x30, 0x34
EN, TEN, DMAEN, DMAUDRIE = 1, 4, 0x1000, 0x2000
TIMER_CR1, TIMER_CR2, TIMER_SMCR, TIMER_DIER, TIMER_ARR, TIMER_CCR1 = 0x00, 0x04, 0x08, 0x0C, 0x2C, 0x34
MEMORY_TO_PERIPHERAL, CIRCULAR, MINC, WORDS = 1 << 6, 1 << 8, 1 << 10, 2 << 11 | 2 << 13
SRAM = 0x20001000
APB1_PS = 1e12 / 42e6


@pytest.fixture
def chip() -> Iterator[Bench]:
    bench = Bench()
    bench.full_speed()
    bench.analog_pin("A", 4)
    bench.analog_pin("A", 5)
    yield bench
    report = bench.report
    bench.close()
    assert not report


def outputs(chip: Bench, channel: int) -> list[tuple[int, int]]:
    """Codes and times of one channel, without the 0 V at its start."""
    seen = [(round(v / 3.3 * 4096), t) for c, v, t in chip.edge.volts if c == channel]
    assert seen[0][0] == 0
    return seen[1:]


def stream(chip: Bench, controller: int, number: int, channel: int, words: list[int], control: int = CIRCULAR) -> None:
    """A stream that brings words to both channels."""
    base = controller + 0x10 + 0x18 * number
    for i, word in enumerate(words):
        chip.write(SRAM + 4 * i, word)
    chip.write(base + 4, len(words))
    chip.write(base + 8, DAC + DHR12RD)
    chip.write(base + 0xC, SRAM)
    chip.write(base, channel << 25 | WORDS | MINC | MEMORY_TO_PERIPHERAL | control | 1)


@pytest.mark.parametrize(
    ("offset", "value", "codes"),
    [
        (0x08, 0xABC, (0xABC, 0)),
        (0x0C, 0xABC0, (0xABC, 0)),
        (0x10, 0xAB, (0xAB0, 0)),
        (0x14, 0xABC, (0, 0xABC)),
        (0x18, 0xABC0, (0, 0xABC)),
        (0x1C, 0xAB, (0, 0xAB0)),
        (0x20, 0x0DEF0ABC, (0xABC, 0xDEF)),
        (0x24, 0xDEF0ABC0, (0xABC, 0xDEF)),
        (0x28, 0xDEAB, (0xAB0, 0xDE0)),
    ],
)
def test_alignments(chip: Bench, offset: int, value: int, codes: tuple[int, int]) -> None:
    """Without a trigger the value is out one APB1 cycle after its write, on both channels at once (14.3.5)."""
    chip.write(DAC + CR, EN | EN << 16)
    chip.run(MICROSECOND)
    written = chip.now
    chip.write(DAC + offset, value)
    chip.run(MICROSECOND)
    assert (chip.read(DAC + DOR1), chip.read(DAC + DOR2)) == codes
    for channel in (1, 2):
        got = outputs(chip, channel)
        assert [code for code, _ in got] == [codes[channel - 1]][: bool(codes[channel - 1])]
        assert all(0 < time - written <= APB1_PS + 1 for _, time in got)


@pytest.mark.parametrize(
    ("selection", "timer"), [(0, TIM6), (1, TIM8), (2, TIM7), (3, TIM5), (4, TIM2), (5, TIM4)]
)  # fmt: skip
def test_timer_triggers(chip: Bench, selection: int, timer: int) -> None:
    """Table 74; the value is out three APB1 cycles after the trigger."""
    clock_hz = 168e6 if timer == TIM8 else 84e6
    chip.write(DAC + CR, EN | TEN | selection << 3)
    chip.write(timer + TIMER_ARR, 839)
    chip.write(timer + TIMER_CR2, 2 << 4)
    chip.write(DAC + DHR12R1, 1000)
    start = chip.now
    chip.write(timer + TIMER_CR1, 1)
    chip.run(839 / clock_hz * 1e12)
    assert chip.read(DAC + DOR1) == 0
    chip.run(MICROSECOND)
    ((code, time),) = outputs(chip, 1)
    update = start + 841 / clock_hz * 1e12  # The counter starts one tick after CEN, at its clock's next edge
    assert code == 1000
    assert 2 * APB1_PS - 2 < time - update <= 3 * APB1_PS + 1
    chip.write(timer + TIMER_CR1, 0)


def test_pin_trigger(chip: Bench) -> None:
    """EXTI line 9, TSEL 6."""
    chip.write(EXTI + 0, 1 << 9)
    chip.write(EXTI + 8, 1 << 9)
    chip.write(DAC + CR, EN | TEN | 6 << 3)
    chip.write(DAC + DHR12R1, 77)
    chip.run(MICROSECOND)
    edge = chip.now + MICROSECOND
    chip.operations.pin_in(chip.board, 9, True, edge)
    chip.run(2 * MICROSECOND)
    ((code, time),) = outputs(chip, 1)
    assert code == 77
    assert 2 * APB1_PS - 1 < time - edge <= 3 * APB1_PS + 1


def test_software_trigger_takes_one_cycle_and_asks_for_nothing(chip: Bench) -> None:
    chip.write(DAC + CR, EN | TEN | 7 << 3 | DMAEN)
    stream(chip, DMA1, 5, 7, [5 | 6 << 16, 7])
    chip.run(MICROSECOND)
    chip.write(DAC + DHR12R1, 1024)
    chip.run(MICROSECOND)
    assert chip.read(DAC + DOR1) == 0
    written = chip.now
    chip.write(DAC + SWTRIGR, 1)
    chip.run(MICROSECOND)
    ((code, time),) = outputs(chip, 1)
    assert code == 1024
    assert 0 < time - written <= APB1_PS + 1
    assert chip.read(DMA1 + 0x8C) == 2, "no transfer of stream 5"


@pytest.mark.parametrize(("asks", "number"), [(1, 5), (2, 6)])
def test_dma_brings_the_value_of_the_next_trigger(chip: Bench, asks: int, number: int) -> None:
    """One stream serves both channels: DMAEN of one of them, both on one trigger, words to DHR12RD (14.4)."""
    words = [(100 + i) | (200 + i) << 16 for i in range(5)]
    stream(chip, DMA1, number, 7, words)
    both = EN | TEN | 0 << 3
    chip.write(DAC + CR, both | both << 16 | DMAEN << 16 * (asks - 1))
    chip.write(DAC + DHR12RD, 50 | 60 << 16)
    chip.write(TIM6 + TIMER_ARR, 839)
    chip.write(TIM6 + TIMER_CR2, 2 << 4)
    chip.write(TIM6 + TIMER_CR1, 1)
    chip.run(75 * MICROSECOND)
    for channel, first in ((1, 100), (2, 200)):
        got = outputs(chip, channel)
        assert [code for code, _ in got] == [{100: 50, 200: 60}[first]] + [first + i for i in (0, 1, 2, 3, 4, 0)]
        assert all(abs(b - a - 10 * MICROSECOND) <= 1 for (_, a), (_, b) in pairwise(got))
    assert [t for _, t in outputs(chip, 1)] == [t for _, t in outputs(chip, 2)]
    assert chip.read(DAC + SR) == 0


def test_underrun(chip: Bench) -> None:
    """A trigger that finds the request waiting: DMAUDR, interrupt 54, no more requests until it is cleared (14.3.6)."""
    chip.write(DAC + CR, EN | TEN | 0 << 3 | DMAEN | DMAUDRIE)
    chip.write(TIM6 + TIMER_ARR, 839)
    chip.write(TIM6 + TIMER_CR2, 2 << 4)
    chip.write(TIM6 + TIMER_CR1, 1)
    chip.run(15 * MICROSECOND)
    assert not chip.irq(54)
    chip.run(10 * MICROSECOND)
    chip.expect("channel 1 triggered before its DMA request was served")
    assert chip.read(DAC + SR) == 0x2000
    assert chip.irq(54)
    stream(chip, DMA1, 5, 7, [5 | 6 << 16, 7, 8])
    chip.run(30 * MICROSECOND)
    assert chip.read(DMA1 + 0x8C) == 3
    assert not chip.report
    chip.write(DAC + SR, 0x2000)
    assert not chip.irq(54)
    chip.run(10 * MICROSECOND)
    assert chip.read(DMA1 + 0x8C) == 2


@pytest.mark.parametrize("at_update", [False, True])
def test_the_timer_of_the_chips_moves_set_points_by_dma2(chip: Bench, at_update: bool) -> None:
    """A compare of TIM1 at 0, or at any count with CCDS, asks DMA2 at the update; its port reaches the DAC on APB1."""
    words = [0x0010_0020, 0x0FFF_0001, 0x0123_0456]
    stream(chip, DMA2, 4, 6, words)
    chip.write(DAC + CR, EN | EN << 16)
    chip.write(TIM1 + TIMER_ARR, 16421)
    chip.write(TIM1 + TIMER_CCR1 + 12, 500 if at_update else 0)
    chip.write(TIM1 + TIMER_CR2, 8 if at_update else 0)
    chip.write(TIM1 + 0x14, 1)
    chip.write(TIM1 + TIMER_DIER, 1 << 12)
    chip.edge.volts.clear()
    chip.write(TIM1 + TIMER_CR1, 1)
    start = chip.now
    chip.run(6.9 * 97.75 * MICROSECOND)
    got = [(round(v / 3.3 * 4096), t) for c, v, t in chip.edge.volts if c == 1 and t > start + 90 * MICROSECOND]
    skipped = 0 if at_update else 1  # The compare matches at the very start too
    expected = [words[(i + skipped) % 3] & 0xFFF for i in range(6)]
    assert [code for code, _ in got] == expected
    for i, (_, time) in enumerate(got):
        update = start + (i + 1) * 16422 / 168e6 * 1e12
        assert 0 < time - update <= APB1_PS + 2e12 / 168e6


def test_a_slave_passes_the_chips_update_on_to_the_trigger(chip: Bench) -> None:
    """TIM1's TRGO is no trigger of the DAC; TIM8, reset by it, is (its TRGO of MMS 0 or 2 is that reset)."""
    for master_mode in (0, 2):
        chip.edge.volts.clear()
        chip.write(TIM8 + TIMER_CR2, master_mode << 4)
        chip.write(TIM8 + TIMER_SMCR, 4)  # ITR0: TIM1
        chip.write(DAC + CR, EN | TEN | 1 << 3)
        chip.write(DAC + DHR12R1, 300 + master_mode)
        chip.write(TIM1 + TIMER_ARR, 16421)
        chip.write(TIM1 + TIMER_CR2, 2 << 4)
        chip.write(TIM1 + 0x24, 0)
        chip.write(TIM1 + TIMER_CR1, 1)
        start = chip.now
        chip.run(100 * MICROSECOND)
        code, time = [(round(v / 3.3 * 4096), t) for _, v, t in chip.edge.volts][-1]
        assert code == 300 + master_mode
        assert 0 < time - start - 97.75 * MICROSECOND <= 4 * APB1_PS
        chip.write(TIM1 + TIMER_CR1, 0)
        chip.write(DAC + CR, 0)


def test_bridge_and_set_points_change_together(chip: Bench) -> None:
    """Both by DMA from one update: chip k's word is on the pins at update k, its set-point three APB1 cycles later."""
    chips = 7
    gpio_c, patterns = 0x40020800, SRAM + 0x100
    chip.write(gpio_c, 1 << 12 | 1 << 14)
    for k in range(chips):
        chip.write(patterns + 4 * k, 1 << 6 | 1 << 23 if k % 2 else 1 << 7 | 1 << 22)
    chip.write(DAC + CR, (EN | 1 << 3) * 0x10001)
    set_points = [100 * k + 10 | (4000 - 100 * k) << 16 for k in range(chips)]
    chip.write(DAC + DHR12RD, set_points[0])
    chip.run(MICROSECOND)
    stream(chip, DMA1, 5, 7, set_points[2:] + set_points[:2])
    chip.write(DAC + CR, (EN | TEN | 1 << 3) * 0x10001 | DMAEN)
    chip.write(DAC + DHR12RD, set_points[1])
    base = DMA2 + 0x10 + 0x18 * 5
    for offset, value in ((4, chips), (8, gpio_c + 0x18), (0xC, patterns + 4)):
        chip.write(base + offset, value)
    chip.write(patterns + 4 * chips, chip.read(patterns))
    chip.write(base, 6 << 25 | WORDS | MINC | MEMORY_TO_PERIPHERAL | CIRCULAR | 1)
    chip.write(TIM1 + TIMER_ARR, 16421)
    chip.write(TIM1 + TIMER_CR2, 2 << 4)
    chip.write(TIM1 + TIMER_DIER, 1 << 8)
    chip.write(TIM8 + TIMER_CR2, 2 << 4)
    chip.write(TIM8 + TIMER_SMCR, 4)
    chip.write(TIM8, 1)
    chip.edge.volts.clear()
    chip.edge.pins.clear()
    chip.write(TIM1, 1)
    chip.run(20.5 * 97.75 * MICROSECOND)
    edges = [t for pin, _, t in chip.edge.pins if pin == 38]
    for channel in (1, 2):
        got = [(round(v / 3.3 * 4096), t) for c, v, t in chip.edge.volts if c == channel]
        expected = [set_points[k % chips] >> 16 * (channel - 1) & 0xFFF for k in range(1, 21)]
        assert [code for code, _ in got] == expected
        assert all(2 * APB1_PS - 1 < t - edge <= 3 * APB1_PS + 1 for (_, t), edge in zip(got, edges[:6], strict=False))
    levels = [level for pin, level, _ in chip.edge.pins if pin == 38]
    assert levels[:6] == [True, False] * 3


def test_rules() -> None:
    chip = Bench()
    chip.full_speed()
    chip.analog_pin("A", 4)
    chip.write(DAC + CR, EN | 1 << 3)
    chip.run(MICROSECOND)
    chip.write(DAC + CR, EN | 2 << 3)
    chip.expect("TSEL1 changed while EN1 is 1")
    chip.write(DAC + SWTRIGR, 1)
    chip.expect("not set to the software trigger")
    chip.write(DAC + CR, EN | 2 << 3 | 1 << 6)
    chip.expect("noise and triangle waves")
    chip.write(DAC + CR, EN << 16)
    chip.run(MICROSECOND)
    chip.expect("PA5, which is not in analog mode")
    chip.close()


def test_switching_off_releases_the_pin(chip: Bench) -> None:
    chip.write(DAC + CR, EN)
    chip.run(MICROSECOND)
    chip.write(DAC + DHR12R1, 2048)
    chip.run(MICROSECOND)
    chip.write(DAC + CR, 0)
    assert [(c, v) for c, v, _ in chip.edge.volts] == [(1, 0.0), (1, 1.65), (1, 0.0)]


# ---- What stands behind the pin (data sheet DS8626, 5.3.24) ----

BOFF = 2


def settled(load_Ohm: float, control: int, code: int) -> tuple[list[tuple[float, int]], str]:
    """Return what the outside was told of a value, each with its time after the update, and the report."""
    chip = Bench(dac_load_Ohm=load_Ohm)
    chip.full_speed()
    chip.analog_pin("A", 4)
    chip.write(DAC + CR, control | EN)
    chip.run(10 * MICROSECOND)
    chip.edge.volts.clear()
    begin = chip.now
    chip.write(DAC + DHR12R1, code)
    chip.run(10 * MICROSECOND)
    told = [(volts, time - begin) for channel, volts, time in chip.edge.volts if channel == 1]
    report = chip.report
    chip.close()
    return told, report


@pytest.mark.parametrize(
    ("load_Ohm", "control", "code", "volts"),
    [
        (10e3, BOFF, 2048, 1.65 * 10 / 25),  # 15 kOhm and 10 kOhm: 40 %.
        (15e6, BOFF, 2048, 1.65 * 15e6 / 15.015e6),
        (10e3, 0, 2048, 1.65),
        (10e3, 0, 249, 249 * 3.3 / 4096),  # Just above .2 V,
        (10e3, 0, 100, 0.2),  # and below.
        (10e3, 0, 3847, 3847 * 3.3 / 4096),  # Just below 3.1 V,
        (10e3, 0, 4095, 3.1),  # and above.
    ],
)
def test_source_and_range(load_Ohm: float, control: int, code: int, volts: float) -> None:
    told, report = settled(load_Ohm, control, code)
    assert told[-1][0] == pytest.approx(volts, rel=1e-9)
    assert not report


def test_settling() -> None:
    """Three steps of 1 us; after the second a hundredth of the change is left, after the third nothing."""
    told, _ = settled(10e3, 0, 2048)
    assert [round(time / MICROSECOND, 1) for _, time in told] == [1.0, 2.0, 3.0]
    rest = [(1.65 - volts) / (1.65 - 0.2) for volts, _ in told]
    assert rest == pytest.approx([0.0992, 0.0992**2, 0.0], abs=1e-6)


def test_too_heavy_a_load_for_the_buffer() -> None:
    assert not settled(5e3, 0, 2048)[1]
    assert "channel 1 drives 4999 Ohm with its buffer, which needs 5 kOhm or more" in settled(4999.0, 0, 2048)[1]


def test_without_a_stated_load_outputs_are_ideal() -> None:
    told, _ = settled(0.0, 0, 100)
    assert [volts for volts, _ in told] == [100 * 3.3 / 4096]

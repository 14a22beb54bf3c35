"""Timers: directed tests on the bare chip, after RM0090 17.3 and 18.3."""

import math

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench
from tests.hil_sim.emulator.timer_bench import (
    ARR,
    CCER,
    CCMR2,
    CCR1,
    CIRC,
    CNT,
    CR1,
    CR2,
    DCR,
    DIER,
    DMA1,
    DMA2,
    DMAR,
    EGR,
    GPIOC,
    HALVES,
    MINC,
    PSC,
    RCR,
    SMCR,
    SR,
    SRAM,
    TIM1,
    TIM2,
    TIM3,
    TIM6,
    TO_MEMORY,
    TO_PERIPHERAL,
    WORDS,
    stream,
)


@pytest.mark.parametrize("ppm", [0.0, 50.0, -37.5])
def test_update_period_with_crystal_error(ppm: float) -> None:
    """The chip clock: 16,422 ticks at 168 MHz; a thousand periods without drift."""
    chip = Bench(crystal_ppm=ppm)
    chip.full_speed()
    chip.write(GPIOC, 1 << 12)
    for word in range(2):
        chip.write(SRAM + 4 * word, (1 << 6, 1 << 22)[word])
    stream(chip, DMA2, 5, 6 << 25 | WORDS | MINC | CIRC | TO_PERIPHERAL, 2, GPIOC + 0x18, SRAM)
    chip.write(TIM1 + ARR, 16421)
    chip.write(TIM1 + DIER, 1 << 8)
    chip.write(TIM1 + CR1, 0x81)
    chip.edge.pins.clear()
    chip.run(1001 * 97.75 * MICROSECOND)
    times = [t for _, _, t in chip.edge.pins]
    period = 16422 / (168e6 * (1 + ppm * 1e-6)) * 1e12
    assert len(times) >= 1000
    assert [v for _, v, _ in chip.edge.pins[:4]] == [True, False, True, False]
    assert all(abs(t - times[0] - i * period) <= 1 for i, t in enumerate(times))
    assert not chip.report
    chip.close()


def test_prescaler_and_reload_are_preloaded(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(TIM2 + ARR, 83)
    chip.write(TIM2 + CR1, 0x81)
    chip.write(TIM2 + PSC, 1)
    chip.write(TIM2 + ARR, 9)
    start = chip.now
    chip.run(0.5 * MICROSECOND)
    assert chip.read(TIM2 + CNT) == 41  # Old values up to the update; one tick late, as CEN says
    chip.run_to(start + 85 / 84e6 * 1e12 + 10)
    assert chip.read(TIM2 + SR) & 1
    assert chip.read(TIM2 + CNT) == 0
    chip.run(19 / 84e6 * 1e12)
    assert chip.read(TIM2 + CNT) == 9
    chip.run(1 / 84e6 * 1e12)
    assert chip.read(TIM2 + CNT) == 0


def test_update_without_preload_is_immediate(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(TIM3 + ARR, 999)
    chip.write(TIM3 + CR1, 1)
    chip.run(MICROSECOND)
    chip.write(TIM3 + ARR, 99)
    chip.run(MICROSECOND)
    assert chip.read(TIM3 + CNT) == 67  # 167 ticks in, one wrap of 100


@pytest.mark.parametrize(("control", "flag"), [(0, 1), (4, 0), (2, 0)])
def test_software_update(fast_chip: Bench, control: int, flag: int) -> None:
    """UG sets UIF, unless URS or UDIS; the counter restarts in each case."""
    chip = fast_chip
    chip.write(TIM3 + CR1, control)
    chip.write(TIM3 + CNT, 77)
    chip.write(TIM3 + EGR, 1)
    assert chip.read(TIM3 + CNT) == 0
    assert chip.read(TIM3 + SR) & 1 == flag


def test_one_pulse_and_write_zero_to_clear(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(TIM6 + ARR, 839)
    chip.write(TIM6 + DIER, 1)
    chip.write(TIM6 + CR1, 9)
    chip.run(9.9 * MICROSECOND)
    assert not chip.irq(54)
    chip.run(0.2 * MICROSECOND)
    assert chip.irq(54)
    assert chip.read(TIM6 + CR1) == 8
    chip.write(TIM6 + SR, 1)
    assert chip.irq(54)
    chip.write(TIM6 + SR, 0xFFFFFFFE)
    assert not chip.irq(54)


def test_repetition_counter(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(TIM1 + ARR, 167)
    chip.write(TIM1 + RCR, 2)
    chip.write(TIM1 + EGR, 1)
    chip.write(TIM1 + SR, 0)
    chip.write(TIM1 + CR1, 1)
    chip.run(2.9 * MICROSECOND)
    assert chip.read(TIM1 + SR) & 1 == 0
    chip.run(0.2 * MICROSECOND)
    assert chip.read(TIM1 + SR) & 1 == 1


def test_compare_flags_and_interrupts_in_time(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(TIM1 + ARR, 1679)
    chip.write(TIM1 + CCR1 + 4, 840)
    chip.write(TIM1 + DIER, 4)
    chip.write(TIM1 + CR1, 1)
    chip.run(4.99 * MICROSECOND)
    assert not chip.irq(27)
    chip.run(0.03 * MICROSECOND)
    assert chip.irq(27)
    assert not chip.irq(25)


def test_long_idle_is_caught_up(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(TIM2 + ARR, 999)
    chip.write(TIM2 + CR1, 1)
    begin = chip.now
    chip.run(1e12)
    ticks = math.floor((chip.now - begin) * 84e6 / 1e12) - 1
    assert abs(chip.read(TIM2 + CNT) - ticks % 1000) <= 1
    assert chip.read(TIM2 + SR) & 1


@pytest.mark.parametrize(
    ("filter_bits", "polarity", "delay"),
    [(0, 0, 0), (0, 2, 0), (0, 10, 0), (3, 0, 8), (7, 0, 32), (15, 0, 256)],
)
def test_input_capture(fast_chip: Bench, filter_bits: int, polarity: int, delay: int) -> None:
    """The sync wire: PA10 is TIM1_CH3; a filter of N samples delays by N sample periods."""
    chip = fast_chip
    chip.alternate("A", 10, 1)
    chip.write(TIM1 + CCMR2, 1 | filter_bits << 4)
    chip.write(TIM1 + CCER, (1 | polarity) << 8)
    chip.write(TIM1 + DIER, 8)
    chip.write(TIM1 + CR1, 1)
    begin = chip.now
    rise, fall = begin + 10 * MICROSECOND, begin + 20 * MICROSECOND
    chip.operations.pin_in(chip.board, 10, True, rise)
    chip.operations.pin_in(chip.board, 10, False, fall)
    chip.run(40 * MICROSECOND)
    assert chip.irq(27)
    edge = rise if polarity == 0 else fall
    expected = (edge - begin) * 168e6 / 1e12 - 1 + delay
    status = chip.read(TIM1 + SR)
    assert abs(chip.read(TIM1 + CCR1 + 8) - expected) <= 1
    assert bool(status & 1 << 11) == (polarity == 10)  # Both edges: overcapture
    assert chip.read(TIM1 + SR) & 8 == 0, "reading CCR3 clears CC3IF"


def test_filter_swallows_glitches(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.alternate("A", 10, 1)
    chip.write(TIM1 + CCMR2, 1 | 15 << 4)
    chip.write(TIM1 + CCER, 1 << 8)
    chip.write(TIM1 + CR1, 1)
    chip.operations.pin_in(chip.board, 10, True, chip.now + MICROSECOND)
    chip.operations.pin_in(chip.board, 10, False, chip.now + 2 * MICROSECOND)
    chip.run(10 * MICROSECOND)
    assert chip.read(TIM1 + SR) & 8 == 0


def test_capture_needs_the_alternate_function(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(TIM1 + CCMR2, 1)
    chip.write(TIM1 + CCER, 1 << 8)
    chip.write(TIM1 + CR1, 1)
    chip.operations.pin_in(chip.board, 10, True, chip.now + MICROSECOND)
    chip.run(10 * MICROSECOND)
    assert chip.read(TIM1 + SR) & 8 == 0


def test_trigger_mode_starts_on_a_master(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(TIM3 + ARR, 0xFFFF)
    chip.write(TIM3 + SMCR, 6 | 1 << 4)  # ITR1 of TIM3 is TIM2
    chip.write(TIM2 + ARR, 839)
    chip.write(TIM2 + CR2, 2 << 4)
    chip.write(TIM2 + CR1, 1)
    chip.run(9 * MICROSECOND)
    assert chip.read(TIM3 + CNT) == 0
    chip.run(6 * MICROSECOND)
    assert 410 <= chip.read(TIM3 + CNT) <= 420


def test_a_slave_may_be_connected_while_its_master_runs(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(TIM2 + ARR, 839)
    chip.write(TIM2 + CR2, 2 << 4)
    chip.write(TIM2 + CR1, 1)
    chip.run(25 * MICROSECOND)
    chip.write(TIM3 + ARR, 0xFFFF)
    chip.write(TIM3 + SMCR, 4 | 1 << 4)
    chip.write(TIM3 + CR1, 1)
    chip.run(8 * MICROSECOND)
    assert 240 <= chip.read(TIM3 + CNT) <= 260, "reset at 30 us"


@pytest.mark.parametrize(
    ("slave", "trigger_input", "irq", "controller", "n", "channel"),
    [(0x40010400, 1, 45, DMA2, 7, 7), (TIM3, 1, 29, DMA1, 4, 5)],
)
def test_trigger_interrupt_and_request(
    fast_chip: Bench, slave: int, trigger_input: int, irq: int, controller: int, n: int, channel: int
) -> None:
    """A trigger from TIM2 (ITR1 of TIM8 and TIM3): TIF, with TIE an interrupt (TIM8's own line), with TDE a request."""
    chip = fast_chip
    chip.write(slave + SMCR, 6 | trigger_input << 4)
    chip.write(slave + DIER, 1 << 6 | 1 << 14)
    stream(chip, controller, n, channel << 25 | HALVES | TO_MEMORY, 3, slave + ARR, SRAM)
    chip.write(TIM2 + CR2, 2 << 4)
    chip.write(TIM2 + EGR, 1)
    assert chip.read(slave + SR) & 1 << 6
    assert chip.irq(irq)
    assert chip.read(controller + 0x14 + 0x18 * n) == 2
    chip.write(slave + SR, 0)
    assert not chip.irq(irq)


def test_what_is_missing_is_loud(fast_chip: Bench) -> None:
    fast_chip.write(TIM3 + CR1, 0x10)
    fast_chip.expect("does not do counting down")
    fast_chip.write(TIM3 + SMCR, 3)
    fast_chip.expect("does not do slave modes")


def test_dma_burst_through_dmar(fast_chip: Bench) -> None:
    chip = fast_chip
    for i, value in enumerate((500, 100, 200, 300)):  # ARR, RCR, CCR1, CCR2
        chip.write(SRAM + 2 * i, value if i != 1 else 0, 2)
    stream(chip, DMA2, 5, 6 << 25 | HALVES | MINC | TO_PERIPHERAL, 4, TIM1 + DMAR, SRAM)
    chip.write(TIM1 + DCR, 3 << 8 | ARR // 4)
    chip.write(TIM1 + DIER, 1 << 8)
    chip.write(TIM1 + EGR, 1)
    chip.run(MICROSECOND)
    assert [chip.read(TIM1 + r) for r in (ARR, RCR, CCR1, CCR1 + 4)] == [500, 0, 200, 300]

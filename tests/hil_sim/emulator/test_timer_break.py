"""Timers' break inputs: directed tests on the bare chip, after RM0090 17.3.12."""

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench
from tests.hil_sim.emulator.timer_bench import (
    AOE,
    BDTR,
    BIF,
    BKE,
    BKP,
    CCER,
    CCMR1,
    CR2,
    DIER,
    DMA2,
    EGR,
    FORCED_HIGH,
    MOE,
    OSSI,
    PA6,
    PA8,
    PB0,
    PB12,
    PB13,
    PB15,
    SR,
    SRAM,
    TICK,
    TIM1,
    TIM8,
    bridge,
    edges,
    level,
    set_pin,
)


def test_a_break_acts_at_once(fast_chip: Bench) -> None:
    chip = fast_chip
    bridge(chip)
    chip.write(TIM1 + DIER, BIF)
    assert [level(chip, PB13), level(chip, PB15)] == [1, 1]
    when = chip.now + 12345
    chip.edge.pins.clear()
    chip.operations.pin_in(chip.board, PB12, False, when)
    chip.run(MICROSECOND)
    assert edges(chip, PB13) == [(False, when)]
    assert edges(chip, PB15) == [(False, when)]
    assert chip.irq(24), "TIM1_BRK"
    assert chip.read(TIM1 + BDTR) & MOE == 0


def test_neither_moe_nor_the_flag_while_the_break_lasts(fast_chip: Bench) -> None:
    chip = fast_chip
    bridge(chip)
    set_pin(chip, PB12, False)
    chip.write(TIM1 + BDTR, BKE | OSSI | MOE)
    assert chip.read(TIM1 + BDTR) == BKE | OSSI
    chip.write(TIM1 + SR, 0)
    assert chip.read(TIM1 + SR) & BIF
    set_pin(chip, PB12, True)
    assert level(chip, PB15) == 0, "off until software says otherwise"
    chip.write(TIM1 + SR, 0)
    assert chip.read(TIM1 + SR) & BIF == 0
    chip.write(TIM1 + BDTR, BKE | OSSI | MOE)
    assert chip.read(TIM1 + BDTR) & MOE
    assert level(chip, PB15) == 1


@pytest.mark.parametrize("breaking", [False, True])
def test_automatic_output_enable(fast_chip: Bench, breaking: bool) -> None:
    """AOE sets MOE at the next update, unless the break is active."""
    chip = fast_chip
    bridge(chip, BKE | OSSI | AOE | MOE)
    set_pin(chip, PB12, False)
    if not breaking:
        set_pin(chip, PB12, True)
    assert level(chip, PB15) == 0
    chip.run(1000 * TICK)
    assert level(chip, PB15) == (0 if breaking else 1)


@pytest.mark.parametrize("polarity", [0, 1])
@pytest.mark.parametrize("enabled", [False, True])
def test_break_polarity_and_enable(fast_chip: Bench, polarity: int, enabled: bool) -> None:
    chip = fast_chip
    set_pin(chip, PB12, not polarity)
    bridge(chip, (BKE if enabled else 0) | polarity * BKP | OSSI | MOE)
    assert level(chip, PB15) == 1
    set_pin(chip, PB12, bool(polarity))
    assert level(chip, PB15) == (0 if enabled else 1)
    assert bool(chip.read(TIM1 + SR) & BIF) == enabled


def test_break_active_from_the_start(fast_chip: Bench) -> None:
    """The input's level counts, not its edge: a driver that is in fault at power-on is never switched on."""
    chip = fast_chip
    set_pin(chip, PB12, False)
    bridge(chip)
    assert edges(chip, PB15)[-1:] == [] or not edges(chip, PB15)[-1][0]
    assert chip.read(TIM1 + BDTR) & MOE == 0


def test_break_without_a_pin_is_loud(fast_chip: Bench) -> None:
    fast_chip.write(TIM8 + BDTR, BKE)
    fast_chip.expect("no pin has the alternate function BKIN")


def test_both_break_pins(fast_chip: Bench) -> None:
    """The same wire on PB12 (TIM1_BKIN) and PA6 (TIM8_BKIN) stops both timers; TIM8's line is 43."""
    chip = fast_chip
    bridge(chip)
    chip.alternate("A", 6, 3)
    set_pin(chip, PA6, True)
    chip.alternate("B", 0, 3)
    chip.write(TIM8 + CCMR1, FORCED_HIGH << 8)
    chip.write(TIM8 + CCER, 4 << 4)
    chip.write(TIM8 + DIER, BIF)
    chip.write(TIM8 + BDTR, BKE | OSSI | MOE)
    assert level(chip, PB0) == 1
    set_pin(chip, PA6, False)
    assert level(chip, PB0) == 0
    assert chip.irq(43)
    assert level(chip, PB15) == 1
    set_pin(chip, PB12, False)
    assert level(chip, PB15) == 0


def test_break_by_software(fast_chip: Bench) -> None:
    chip = fast_chip
    bridge(chip)
    chip.write(TIM1 + EGR, BIF)
    assert chip.read(TIM1 + SR) & BIF
    assert level(chip, PB15) == 0
    chip.write(TIM1 + SR, 0)
    assert chip.read(TIM1 + SR) & BIF == 0


@pytest.mark.parametrize("lock", [0, 3])
def test_a_break_that_dma_brings(fast_chip: Bench, lock: int) -> None:
    """TIM8_CH4 has DMA2 stream 7 write EGR: 0 is no event, BG a break, whatever BDTR's LOCK protects."""
    chip = fast_chip
    bridge(chip, BKE | OSSI | MOE | lock << 8)
    for i, value in enumerate((0, 0, BIF, 0)):
        chip.write(SRAM + 2 * i, value, 2)
    base = DMA2 + 0x10 + 0x18 * 7
    for offset, value in ((4, 4), (8, TIM1 + EGR), (0xC, SRAM)):
        chip.write(base + offset, value)
    chip.write(base, 7 << 25 | 1 << 13 | 1 << 11 | 1 << 10 | 1 << 6 | 1)
    chip.write(TIM8 + DIER, 1 << 12)
    for broken in (False, False, True, True):
        chip.write(TIM8 + EGR, 1 << 4)
        chip.run(MICROSECOND)
        assert chip.read(TIM1 + BDTR) & MOE == (0 if broken else MOE)
        assert level(chip, PB15) == (0 if broken else 1)
        assert chip.read(TIM1 + SR) & BIF == (BIF if broken else 0)


@pytest.mark.parametrize("by_break", [False, True])
def test_idle_levels_come_after_the_dead_time(fast_chip: Bench, by_break: bool) -> None:
    chip = fast_chip
    chip.write(TIM1 + CR2, 1 << 9)  # OIS1N
    bridge(chip, BKE | OSSI | MOE | 100)
    chip.edge.pins.clear()
    begin = chip.now
    if by_break:
        chip.write(TIM1 + EGR, BIF)
    else:
        chip.write(TIM1 + BDTR, BKE | OSSI | 100)
    chip.run(MICROSECOND)
    (off, off_time), (on, on_time) = edges(chip, PB13)
    assert [off, on] == [False, True]
    assert off_time == begin
    assert (on_time - begin) / TICK == pytest.approx(100, abs=1)


def test_idle_levels_that_would_both_be_active(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.alternate("A", 8, 1)
    chip.write(TIM1 + CR2, 3 << 8)
    bridge(chip)
    chip.change(TIM1 + CCER, 1)
    chip.write(TIM1 + BDTR, BKE | OSSI)
    chip.expect("OIS1 and OIS1N would both be active")
    assert [level(chip, PA8), level(chip, PB13)] == [0, 0]


def test_a_break_silences_the_trigger_of_a_converter(fast_chip: Bench) -> None:
    """A channel's trigger is its output: without MOE no edge comes. Left off by software it is a mistake, and loud."""
    chip = fast_chip
    bridge(chip)
    chip.write(TIM1 + CCER, 5 | 4 << 8)
    chip.analog_pin("A", 0)
    chip.write(0x40012304, 1 << 16)
    chip.write(0x40012008, 1)
    chip.run(4 * MICROSECOND)
    chip.write(0x40012008, 1 << 28 | 1)  # ADC1 on TIM1_CC1, rising
    chip.run(1000 * TICK)
    before = len(chip.edge.samples)
    assert before > 0
    set_pin(chip, PB12, False)
    chip.run(10 * 1000 * TICK)
    assert len(chip.edge.samples) == before
    assert not chip.report
    set_pin(chip, PB12, True)
    chip.write(TIM1 + BDTR, MOE | OSSI | BKE)
    chip.write(TIM1 + BDTR, OSSI | BKE)
    chip.run(1000 * TICK)
    chip.expect("CC1E and MOE")

"""A second reading of the DAC (see ``second_reading_bench``).

Sections are those of RM0090, chapter 14. Its text was read in RM0364 Rev 4, which describes the same converter, and the
trigger sources in ST's stm32f4xx_hal_dac.h.
"""

from collections.abc import Iterator
from itertools import pairwise

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench
from tests.hil_sim.emulator.second_reading_bench import (
    APB1,
    DMA1,
    MEMORY_WORD,
    MINC,
    SRAM,
    TO_PERIPHERAL,
    VOLTS,
    WORD,
    fast_bench,
    start_stream,
)
from tests.hil_sim.emulator.timer_bench import ARR, CR1, CR2, EGR, TIM2, TIM4, TIM5, TIM6, TIM8

DAC = 0x40007400
CR, SWTRIGR, DHR12R1, DHR12L1, DHR8R1 = DAC, DAC + 4, DAC + 8, DAC + 0x0C, DAC + 0x10
DHR12R2, DHR12L2, DHR8R2 = DAC + 0x14, DAC + 0x18, DAC + 0x1C
DHR12RD, DHR12LD, DHR8RD = DAC + 0x20, DAC + 0x24, DAC + 0x28
DOR1, DOR2, SR = DAC + 0x2C, DAC + 0x30, DAC + 0x34
EN1, BOFF1, TEN1, DMAEN1 = 1, 2, 4, 1 << 12
BY_SOFTWARE, BY_TIM6 = 7 << 3, 0
DMAUDR1 = 1 << 13
TIM7 = 0x40001400
UG = 1


@pytest.fixture
def chip() -> Iterator[Bench]:
    """168 MHz, so that a cycle of APB1 takes 23.8 ns; the pins PA4 and PA5 are analog."""
    with fast_bench() as bench:
        bench.analog_pin("A", 4)
        bench.analog_pin("A", 5)
        yield bench


def pulse(chip: Bench, timer: int = TIM6) -> None:
    """One pulse of a timer's TRGO: MMS is 000, so UG makes it."""
    chip.write(timer + EGR, UG)


def later(chip: Bench, cycles: float) -> int:
    """DOR1 some cycles of APB1 from now on."""
    chip.run(cycles * APB1)
    return chip.read(DOR1)


# ---- When the output register follows ----


def test_without_trigger_the_output_follows_one_cycle_later(chip: Bench) -> None:
    """14.3.4: data are transferred to DOR after one APB1 cycle if TEN is reset."""
    chip.write(CR, EN1)
    chip.run(20 * MICROSECOND)
    chip.write(DHR12R1, 0x123)
    assert chip.read(DOR1) == 0
    assert later(chip, 2.1) == 0x123


def test_a_hardware_trigger_takes_three_cycles(chip: Bench) -> None:
    """14.3.4: with a hardware trigger the transfer is three APB1 cycles after it, not before."""
    chip.write(CR, EN1 | TEN1 | BY_TIM6)
    chip.run(20 * MICROSECOND)
    chip.write(DHR12R1, 0x123)
    assert later(chip, 50) == 0, "no transfer without a trigger"
    pulse(chip)
    assert later(chip, 1.9) == 0
    assert later(chip, 2.6) == 0x123


def test_a_software_trigger_takes_one_cycle_and_clears_itself(chip: Bench) -> None:
    """14.3.6: only one cycle for the software trigger; SWTRIG is reset by hardware once DOR is loaded."""
    chip.write(CR, EN1 | TEN1 | BY_SOFTWARE)
    chip.run(20 * MICROSECOND)
    chip.write(DHR12R1, 0x456)
    chip.write(SWTRIGR, 1)
    assert later(chip, 2.1) == 0x456
    assert chip.read(SWTRIGR) == 0
    chip.write(DHR12R1, 0x789)
    assert later(chip, 50) == 0x456


@pytest.mark.parametrize("code", range(6))
def test_trigger_sources(chip: Bench, code: int) -> None:
    """Table 75: TSEL 0 to 5 are TIM6, TIM8, TIM7, TIM5, TIM2 and TIM4, and no other timer."""
    timers = (TIM6, TIM8, TIM7, TIM5, TIM2, TIM4)
    chip.write(CR, code << 3)
    chip.write(CR, EN1 | TEN1 | code << 3)
    chip.run(20 * MICROSECOND)
    started = []
    for n, timer in enumerate(timers):
        chip.write(DHR12R1, 100 + n)
        pulse(chip, timer)
        if later(chip, 10) == 100 + n:
            started.append(timer)
    assert started == [timers[code]]


def test_exti_line_9_triggers_at_its_rising_edge(chip: Bench) -> None:
    """Table 75, TSEL 6; 14.3.6: each time a rising edge is detected on the selected external interrupt line 9."""
    chip.change(0x40020400, 0, 3 << 18)
    chip.change(0x40013810, 1 << 4, 15 << 4)
    chip.operations.pin_in(chip.board, 25, False, chip.now)
    chip.run(MICROSECOND)
    chip.write(0x40013C00, 1 << 9)
    chip.write(0x40013C08, 1 << 9)
    chip.write(CR, 6 << 3)
    chip.write(CR, EN1 | TEN1 | 6 << 3)
    chip.run(20 * MICROSECOND)
    chip.write(DHR12R1, 0x321)
    assert later(chip, 10) == 0
    chip.operations.pin_in(chip.board, 25, True, chip.now)
    assert later(chip, 20) == 0x321
    chip.write(DHR12R1, 0x322)
    chip.operations.pin_in(chip.board, 25, False, chip.now)
    assert later(chip, 20) == 0x321


def test_the_digital_side_works_with_the_channel_off(chip: Bench) -> None:
    """14.3.1: ENx enables the analog macrocell only; the digital interface is enabled even if ENx is reset."""
    chip.write(CR, 0)
    chip.write(DHR12R1, 0x222)
    assert later(chip, 10) == 0x222


# ---- Holding registers ----


@pytest.mark.parametrize(
    ("register", "written", "first", "second"),
    [
        (DHR12R1, 0x0ABC, 0xABC, 0),
        (DHR12L1, 0xABC0, 0xABC, 0),
        (DHR8R1, 0xAB, 0xAB0, 0),
        (DHR12R2, 0x0ABC, 0, 0xABC),
        (DHR12L2, 0xABC0, 0, 0xABC),
        (DHR8R2, 0xAB, 0, 0xAB0),
        (DHR12RD, 0x01230ABC, 0xABC, 0x123),
        (DHR12LD, 0x1230ABC0, 0xABC, 0x123),
        (DHR8RD, 0x12AB, 0xAB0, 0x120),
    ],
)
def test_formats(chip: Bench, register: int, written: int, first: int, second: int) -> None:
    """14.3.3, 14.4.1: right, left and 8 bits; in dual registers channel 1 is the lower part; 8 bits are DHR[11:4]."""
    chip.write(CR, EN1 | EN1 << 16)
    chip.run(20 * MICROSECOND)
    chip.write(register, written)
    chip.run(5 * APB1)
    assert (chip.read(DOR1), chip.read(DOR2)) == (first, second)


def test_one_trigger_moves_both_channels_together(chip: Bench) -> None:
    """14.4.8, simultaneous trigger: both channels with the same TSEL are loaded by the same trigger."""
    chip.write(CR, (EN1 | TEN1) * 0x10001)
    chip.run(20 * MICROSECOND)
    chip.write(DHR12RD, 0x02220111)
    pulse(chip)
    chip.run(6 * APB1)
    assert (chip.read(DOR1), chip.read(DOR2)) == (0x111, 0x222)


def test_volts_are_a_fraction_of_the_reference(chip: Bench) -> None:
    """14.3.5: VREF+ x DOR / 4096, here without the buffer, which would not reach the rails.

    ST's texts say 4095 or 4096; the 2 mV leave that open.
    """
    chip.write(CR, EN1 | BOFF1)
    chip.run(20 * MICROSECOND)
    for code in (1000, 3000):
        chip.write(DHR12R1, code)
        chip.run(30 * MICROSECOND)
        channel, volts, _ = chip.edge.volts[-1]
        assert channel in (0, 1)
        assert volts == pytest.approx(VOLTS * code / 4096, abs=0.002)


# ---- DMA ----


def fed(chip: Bench, items: int, values: tuple[int, ...]) -> None:
    """DMA1 stream 5, channel 7 (table 43) feeds DHR12R1 at each trigger of TIM6."""
    for n, value in enumerate(values):
        chip.write(SRAM + 4 * n, value)
    start_stream(chip, DMA1, 5, 7 << 25 | WORD | MEMORY_WORD | MINC | TO_PERIPHERAL, items, DHR12R1)
    chip.write(CR, EN1 | TEN1 | DMAEN1)
    chip.run(20 * MICROSECOND)


def test_dma_brings_the_next_value_after_the_trigger(chip: Bench) -> None:
    """14.3.7: a request at an external trigger; what it brings into DHR is converted at the following trigger."""
    fed(chip, 3, (0x111, 0x222, 0x333))
    chip.write(DHR12R1, 0x099)
    seen = []
    for _ in range(4):
        pulse(chip)
        seen.append(later(chip, 100))
    assert seen[:3] == [0x099, 0x111, 0x222]


def test_a_trigger_before_the_acknowledgement_is_an_underrun(chip: Bench) -> None:
    """14.3.7: a second trigger before the first request is served sets DMAUDR, which is cleared by writing 1."""
    chip.write(CR, EN1 | TEN1 | DMAEN1)
    chip.run(20 * MICROSECOND)
    pulse(chip)
    chip.run(MICROSECOND)
    assert not chip.read(SR) & DMAUDR1
    pulse(chip)
    chip.run(MICROSECOND)
    assert chip.read(SR) & DMAUDR1
    chip.expect("underrun")
    chip.write(SR, 0)
    assert chip.read(SR) & DMAUDR1
    chip.write(SR, DMAUDR1)
    assert not chip.read(SR) & DMAUDR1


def test_a_software_trigger_requests_no_dma(chip: Bench) -> None:
    """14.3.7: a request is generated by an external trigger, but not by a software trigger."""
    start_stream(chip, DMA1, 5, 7 << 25 | WORD | MEMORY_WORD | MINC | TO_PERIPHERAL, 3, DHR12R1)
    chip.write(CR, BY_SOFTWARE)
    chip.write(CR, EN1 | TEN1 | BY_SOFTWARE | DMAEN1)
    chip.run(20 * MICROSECOND)
    for _ in range(3):
        chip.write(SWTRIGR, 1)
        chip.run(MICROSECOND)
    assert chip.read(DMA1 + 0x10 + 0x18 * 5 + 4) == 3
    assert not chip.read(SR) & DMAUDR1


def test_a_timer_paces_the_samples(chip: Bench) -> None:
    """14.3.6: the output changes three cycles after each update of TIM6, so with its period."""
    fed(chip, 4, (1000, 2000, 3000, 4000))
    chip.write(CR, EN1 | BOFF1 | TEN1 | DMAEN1)
    chip.write(DHR12R1, 100)
    chip.write(TIM6 + ARR, 839)
    chip.write(TIM6 + CR2, 2 << 4)
    chip.edge.volts.clear()
    chip.write(TIM6 + CR1, 1)
    chip.run(45 * MICROSECOND)
    times = [time for _, _, time in chip.edge.volts]
    assert [b - a for a, b in pairwise(times)] == pytest.approx([10 * MICROSECOND] * (len(times) - 1), abs=1)
    assert len(times) == 4

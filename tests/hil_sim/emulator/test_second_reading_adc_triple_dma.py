"""A second reading of the converters, alone and together, and what they ask of DMA (see ``second_reading_bench``).

Sections are those of RM0090 Rev 21: 13 ADC.
"""

from collections.abc import Iterator
from itertools import pairwise

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench
from tests.hil_sim.emulator.second_reading_bench import (
    ADC1,
    ADC2,
    ADC_CCR,
    ADC_CDR,
    ADC_CR1,
    ADC_CR2,
    ADC_CSR,
    ADC_DR,
    ADC_SMPR1,
    ADC_SMPR2,
    ADC_SR,
    APB2,
    COMMON_DDS,
    CONT,
    CONVERTERS,
    DDS,
    DMA2,
    DMA_MODE_1,
    DMA_MODE_2,
    DMA_ON,
    DUAL_SIMULTANEOUS,
    EOC,
    EOCS,
    HALF_WORD,
    MEMORY_HALF,
    MEMORY_WORD,
    MINC,
    OVR,
    PRESCALE_4,
    PRESCALE_6,
    PRESCALE_8,
    SAMPLING,
    SCAN,
    SRAM,
    STREAM0,
    STRT,
    SWSTART,
    TCIF,
    TRIPLE_SIMULTANEOUS,
    WORD,
    all_near,
    clear_stream_flags,
    code_of_pin,
    convert,
    converters,
    halves,
    near,
    power,
    sequence,
    start_stream,
    stream_flags,
    triple,
    words,
)
from tests.hil_sim.emulator.timer_bench import (
    ARR,
    CCER,
    CCMR1,
    CCR1,
    CNT,
    CR1,
    PRELOAD,
    PWM1,
    TIM2,
)

CCR2 = CCR1 + 4
TIM2_CC2, EXTEN_RISING, EXTEN_FALLING = 3 << 24, 1 << 28, 2 << 28
RES_10, RES_8, RES_6 = 1 << 24, 2 << 24, 3 << 24


@pytest.fixture
def chip() -> Iterator[Bench]:
    """168 MHz, converters at 21 MHz; each pin has a voltage of its own."""
    with converters() as bench:
        yield bench


# ---- Order of results ----


def test_mode_1_of_triple_simultaneous_brings_adc1_then_adc2_then_adc3(chip: Bench) -> None:
    """13.9, DMA mode 1: three requests a trigger, one item each, first ADC1, then ADC2, then ADC3, and again."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC, 6, ADC_CDR)
    triple(chip, TRIPLE_SIMULTANEOUS | DMA_MODE_1 | COMMON_DDS)
    convert(chip)
    convert(chip)
    assert all_near(halves(chip, 6), (10, 11, 12, 10, 11, 12))


def test_mode_1_of_a_scanning_triple_takes_rank_by_rank(chip: Bench) -> None:
    """13.9.2, triple: at each end of conversion three transfers; the process is repeated for each new three."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC, 6, ADC_CDR)
    chip.write(ADC_CCR, PRESCALE_4 | TRIPLE_SIMULTANEOUS | DMA_MODE_1 | COMMON_DDS)
    for adc, channels in zip(CONVERTERS, ((10, 1), (11, 2), (12, 3)), strict=True):
        sequence(chip, adc, *channels)
        chip.write(adc + ADC_CR1, SCAN)
    power(chip, *CONVERTERS)
    convert(chip, 5)
    assert all_near(halves(chip, 6), (10, 11, 12, 1, 2, 3))


def test_mode_2_of_dual_simultaneous_has_adc2_in_the_upper_half(chip: Bench) -> None:
    """13.9, DMA mode 2 in dual mode: one word a trigger, ADC2 in its upper half, ADC1 in its lower."""
    start_stream(chip, DMA2, 0, WORD | MEMORY_WORD | MINC, 2, ADC_CDR)
    triple(chip, DUAL_SIMULTANEOUS | DMA_MODE_2 | COMMON_DDS)
    convert(chip)
    convert(chip)
    assert all_near([half for word in words(chip, 2) for half in (word & 0xFFFF, word >> 16)], (10, 11, 10, 11))


def test_common_register_of_dual_mode_holds_both_results(chip: Bench) -> None:
    """13.13.17: DATA2 is the regular data of ADC2, DATA1 that of ADC1."""
    triple(chip, DUAL_SIMULTANEOUS)
    convert(chip)
    value = chip.read(ADC_CDR)
    assert all_near([value & 0xFFFF, value >> 16], (10, 11))


def test_simultaneous_converters_sample_at_the_same_instant(chip: Bench) -> None:
    """13.9.2: a simultaneous trigger is provided to ADC2 and ADC3; the slaves' own triggers stay off."""
    triple(chip, TRIPLE_SIMULTANEOUS)
    chip.edge.samples.clear()
    convert(chip)
    assert sorted(pin for pin, _ in chip.edge.samples) == [32, 33, 34]
    assert len({time for _, time in chip.edge.samples}) == 1


# ---- Time of a conversion ----


@pytest.mark.parametrize(("prescaler", "divider"), [(PRESCALE_4, 4), (PRESCALE_6, 6), (PRESCALE_8, 8)])
def test_a_conversion_takes_15_cycles_of_the_divided_apb2_clock(chip: Bench, prescaler: int, divider: int) -> None:
    """13.5: sampling time + 12 cycles; 13.13.16: ADCPRE divides PCLK2 by 4, 6 and 8 (2 would be beyond DS8626)."""
    chip.write(ADC_CCR, prescaler)
    sequence(chip, ADC1, 10)
    power(chip, ADC1, control=CONT)
    chip.edge.samples.clear()
    convert(chip, 20)
    times = [time for _, time in chip.edge.samples]
    assert (times[10] - times[1]) / 9 == pytest.approx(15 * divider * APB2, rel=1e-4)


@pytest.mark.parametrize("code", range(8))
def test_sampling_time_by_its_code(chip: Bench, code: int) -> None:
    """13.13.4: 3, 15, 28, 56, 84, 112, 144 and 480 cycles; channel 10 is in SMPR1[2:0], channel 9 ends SMPR2."""
    chip.write(ADC1 + ADC_SMPR1, code)
    chip.write(ADC1 + ADC_SMPR2, 0)
    sequence(chip, ADC1, 10)
    power(chip, ADC1, control=CONT)
    chip.edge.samples.clear()
    convert(chip, 80)
    times = [time for _, time in chip.edge.samples]
    assert times[2] - times[1] == pytest.approx((SAMPLING[code] + 12) * 4 * APB2, rel=1e-4)


@pytest.mark.parametrize(("resolution", "bits"), [(0, 12), (RES_10, 10), (RES_8, 8), (RES_6, 6)])
def test_fewer_bits_take_fewer_cycles_and_drop_the_lowest(chip: Bench, resolution: int, bits: int) -> None:
    """13.7: 3 + bits cycles at the shortest sampling time."""
    sequence(chip, ADC1, 10)
    chip.write(ADC1 + ADC_CR1, resolution)
    power(chip, ADC1, control=CONT)
    chip.edge.samples.clear()
    convert(chip, 5)
    times = [time for _, time in chip.edge.samples]
    assert (times[4] - times[1]) / 3 == pytest.approx((3 + bits) * 4 * APB2, rel=1e-4)
    assert abs(chip.read(ADC1 + ADC_DR) - (code_of_pin(32) >> 12 - bits)) <= 1


# ---- EOC and OVR ----


@pytest.mark.parametrize(("control", "first"), [(0, 0), (EOCS, EOC)])
def test_eocs_tells_whether_each_conversion_or_the_sequence_ends_by_eoc(chip: Bench, control: int, first: int) -> None:
    """13.3.8: EOC at the end of the sequence if EOCS = 0, at the end of each regular conversion if it is 1."""
    sequence(chip, ADC1, 10, 11)
    chip.write(ADC1 + ADC_CR1, SCAN)
    power(chip, ADC1, control=control)
    chip.change(ADC1 + ADC_CR2, SWSTART)
    chip.run(22 * 4 * APB2)
    assert chip.read(ADC1 + ADC_SR) & EOC == first
    chip.read(ADC1 + ADC_DR)
    chip.run(22 * 4 * APB2)
    assert chip.read(ADC1 + ADC_SR) & EOC


def test_eoc_goes_by_reading_the_data_or_by_writing_zero(chip: Bench) -> None:
    """13.13.1: EOC is cleared by software (rc_w0) or by reading ADC_DR; STRT stays until software clears it."""
    sequence(chip, ADC1, 10)
    power(chip, ADC1)
    convert(chip)
    assert chip.read(ADC1 + ADC_SR) & (EOC | STRT) == EOC | STRT
    chip.read(ADC1 + ADC_DR)
    assert chip.read(ADC1 + ADC_SR) & (EOC | STRT) == STRT
    convert(chip)
    chip.write(ADC1 + ADC_SR, EOC | STRT)
    assert chip.read(ADC1 + ADC_SR) & (EOC | STRT) == EOC | STRT
    chip.write(ADC1 + ADC_SR, 0)
    assert not chip.read(ADC1 + ADC_SR)


def test_no_overrun_without_dma_and_eocs(chip: Bench) -> None:
    """13.8.3: overrun detection is off with DMA = 0 and EOCS = 0; the last result is in ADC_DR."""
    sequence(chip, ADC1, 10)
    power(chip, ADC1)
    for _ in range(3):
        convert(chip)
    assert not chip.read(ADC1 + ADC_SR) & OVR
    assert near(chip.read(ADC1 + ADC_DR), code_of_pin(32))


def test_dds_clear_stops_requests_after_the_last_transfer_without_overrun(chip: Bench) -> None:
    """13.8.1: no new request after the last transfer if DDS = 0 (this avoids an overrun); DMA must be written 0, 1."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC, 2, ADC1 + ADC_DR)
    sequence(chip, ADC1, 10)
    power(chip, ADC1, control=DMA_ON)
    for _ in range(5):
        convert(chip)
    assert stream_flags(chip, DMA2, 0) & TCIF
    assert not chip.read(ADC1 + ADC_SR) & OVR
    clear_stream_flags(chip, DMA2, 0)
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC, 2, ADC1 + ADC_DR, SRAM + 64)
    convert(chip)
    assert chip.read(STREAM0 + 4) == 2, "a request although DMA was not toggled"
    chip.read(ADC1 + ADC_DR)
    chip.change(ADC1 + ADC_CR2, 0, DMA_ON)
    chip.change(ADC1 + ADC_CR2, DMA_ON)
    convert(chip)
    assert chip.read(STREAM0 + 4) == 1


def test_dds_set_keeps_requesting_and_runs_over_when_nobody_serves(chip: Bench) -> None:
    """13.8.1: with DDS = 1 requests go on; a result that nobody took in time is an overrun, shown in CSR too."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC, 2, ADC1 + ADC_DR)
    sequence(chip, ADC1, 10)
    power(chip, ADC1, control=DMA_ON | DDS)
    convert(chip)
    convert(chip)
    assert not chip.read(ADC1 + ADC_SR) & OVR
    convert(chip)
    convert(chip)
    assert chip.read(ADC1 + ADC_SR) & OVR
    assert chip.read(ADC_CSR) & OVR
    chip.expect("overrun")


def test_after_an_overrun_further_triggers_are_ignored(chip: Bench) -> None:
    """13.8.1: after OVR DMA requests are no longer accepted and further regular triggers are ignored until cleared."""
    sequence(chip, ADC1, 10)
    power(chip, ADC1, control=DMA_ON | DDS)
    for _ in range(3):
        convert(chip)
    assert chip.read(ADC1 + ADC_SR) & OVR
    chip.expect("overrun")
    chip.edge.samples.clear()
    convert(chip)
    assert not chip.edge.samples
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC, 8, ADC1 + ADC_DR)
    chip.write(ADC1 + ADC_SR, 0)
    convert(chip)
    assert chip.edge.samples


def test_common_status_mirrors_and_cannot_be_written(chip: Bench) -> None:
    """13.13.15: CSR has the flags of the three converters in its bits 5..0, 13..8 and 21..16, read-only."""
    for adc in CONVERTERS:
        sequence(chip, adc, 10)
    power(chip, *CONVERTERS)
    for adc, shift in zip(CONVERTERS, (0, 8, 16), strict=True):
        assert not chip.read(ADC_CSR) >> shift & 0x3F
        chip.change(adc + ADC_CR2, SWSTART)
        chip.run(3 * MICROSECOND)
        assert chip.read(ADC_CSR) >> shift & 0x3F == EOC | STRT
    chip.write(ADC2 + ADC_SR, 0)
    assert chip.read(ADC_CSR) == (EOC | STRT) | (EOC | STRT) << 16


# ---- Triggers ----


def pulse_of_tim2(chip: Bench, trigger: int, period: float, cycles: int = 0) -> list[float]:
    """TIM2 CC2, a PWM high for the first quarter of its period, as the trigger of ADC1: when it sampled.

    Times in microseconds after the counter's start.
    """
    ticks = round(period * 84)
    chip.write(TIM2 + ARR, ticks - 1)
    chip.write(TIM2 + CCR2, ticks // 4)
    chip.write(TIM2 + CNT, ticks - 1)
    chip.write(TIM2 + CCMR1, (PWM1 | PRELOAD) << 8)
    chip.write(TIM2 + 0x14, 1)
    chip.write(TIM2 + CNT, ticks // 2)
    chip.write(TIM2 + CCER, 1 << 4)
    chip.write(ADC1 + ADC_SMPR1, cycles)
    sequence(chip, ADC1, 10)
    power(chip, ADC1, control=trigger | TIM2_CC2)
    chip.edge.samples.clear()
    start = chip.now
    chip.write(TIM2 + CR1, 1)
    chip.run(100 * MICROSECOND)
    return [(time - start) / MICROSECOND for _, time in chip.edge.samples]


@pytest.mark.parametrize(
    ("edges", "expected"),
    [(EXTEN_RISING, [10, 30, 50, 70, 90]), (EXTEN_FALLING, [15, 35, 55, 75, 95])],
)
def test_polarity_of_the_external_trigger(chip: Bench, edges: int, expected: list[int]) -> None:
    """13.6, table 68: rising or falling edge; 69: EXTSEL 3 is TIM2_CH2. Its level is high from 0 to CCR2 in PWM 1."""
    times = pulse_of_tim2(chip, edges, period=20)
    assert times == pytest.approx([t + 0.15 for t in expected], abs=0.25)


def test_both_edges_trigger_too(chip: Bench) -> None:
    """13.6, table 68: EXTEN = 11 detects both edges."""
    times = pulse_of_tim2(chip, EXTEN_RISING | EXTEN_FALLING, period=20)
    assert times == pytest.approx([t + 0.15 for t in (10, 15, 30, 35, 50, 55, 70, 75, 90, 95)], abs=0.25)


def test_a_trigger_during_a_conversion_is_ignored(chip: Bench) -> None:
    """Figure 62 of 13.9.6 and the later families' manuals (RM0351 16.4.18): a trigger while converting is ignored.

    480 + 12 cycles take 23.4 us at 21 MHz, so of rising edges every 10 us each third one converts.
    """
    times = pulse_of_tim2(chip, EXTEN_RISING, period=10, cycles=7)
    assert {round(b - a) for a, b in pairwise(times)} == {30}
    chip.expect("a trigger came while")

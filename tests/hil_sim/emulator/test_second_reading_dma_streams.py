"""A second reading of the DMA streams, which a converter drives here (see ``second_reading_bench``).

Sections are those of RM0090 Rev 21: 10 DMA, 13 ADC.
"""

from collections.abc import Iterator

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench
from tests.hil_sim.emulator.second_reading_bench import (
    ADC1,
    ADC2,
    ADC3,
    ADC_CDR,
    ADC_CR2,
    ADC_CSR,
    ADC_DR,
    CIRC,
    COMMON_DDS,
    CT,
    DBM,
    DDS,
    DMA2,
    DMA_MODE_1,
    DMA_ON,
    EN,
    FEIF,
    HALF_WORD,
    HTIE,
    HTIF,
    MEMORY_HALF,
    MEMORY_WORD,
    MINC,
    OVR,
    SRAM,
    STREAM0,
    SWSTART,
    TCIE,
    TCIF,
    TEIF,
    TO_PERIPHERAL,
    TRIPLE_SIMULTANEOUS,
    WORD,
    all_near,
    clear_stream_flags,
    code_of_pin,
    convert,
    converters,
    converting,
    halves,
    many,
    near,
    power,
    sequence,
    start_stream,
    stream_flags,
    triple,
    words,
)
from tests.hil_sim.emulator.timer_bench import CCR1, CNT, CR1, DIER, EGR, TIM1


@pytest.fixture
def chip() -> Iterator[Bench]:
    """168 MHz, converters at 21 MHz; each pin has a voltage of its own."""
    with converters() as bench:
        yield bench


def test_half_and_complete_flags_and_the_count_of_items(chip: Bench) -> None:
    """10.3.17: HTIF once half the data are moved, TCIF at the end; 10.5.6: NDTR counts down what remains."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC, 4, ADC1 + ADC_DR)
    converting(chip)
    seen = []
    for _ in range(4):
        many(chip, 1)
        seen.append((chip.read(STREAM0 + 4), stream_flags(chip, DMA2, 0)))
    assert seen == [(3, 0), (2, HTIF), (1, HTIF), (0, HTIF | TCIF)]
    assert not chip.read(STREAM0) & EN, "EN is cleared by hardware at the end (10.3.13)"


def test_circular_stream_reloads_its_count_and_address(chip: Bench) -> None:
    """10.3.8: NDTR is reloaded with what was programmed, requests go on; memory begins anew."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC | CIRC, 4, ADC1 + ADC_DR)
    converting(chip)
    many(chip, 4)
    assert chip.read(STREAM0 + 4) == 4
    assert stream_flags(chip, DMA2, 0) == HTIF | TCIF
    for n in range(4):
        chip.write(SRAM + 2 * n, 0, 2)
    many(chip, 1)
    assert chip.read(STREAM0 + 4) == 3
    assert near(halves(chip, 1)[0], code_of_pin(32))
    assert halves(chip, 4)[1:] == [0, 0, 0]
    assert chip.read(STREAM0) & EN


def test_double_buffer_swaps_targets_at_each_end(chip: Bench) -> None:
    """10.3.9: DBM makes the stream circular and swaps the memory pointers at each end; CT shows the present target."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC | DBM, 2, ADC1 + ADC_DR, SRAM, SRAM + 64)
    converting(chip)
    assert not chip.read(STREAM0) & CT
    many(chip, 2)
    assert chip.read(STREAM0) & CT
    assert halves(chip, 2, SRAM + 64) == [0, 0]
    many(chip, 2)
    assert not chip.read(STREAM0) & CT
    assert all(near(half, code_of_pin(32)) for half in halves(chip, 2, SRAM + 64))


def test_direct_mode_takes_the_width_of_the_peripheral_side(chip: Bench) -> None:
    """10.3.12: in direct mode both widths are PSIZE; 10.5.5: MSIZE is forced to PSIZE as soon as EN = 1."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_WORD | MINC, 3, ADC1 + ADC_DR)
    assert chip.read(STREAM0) >> 13 & 3 == 1
    converting(chip)
    many(chip, 3)
    assert all(near(half, code_of_pin(32)) for half in halves(chip, 3))


def test_double_buffer_shows_circular_mode(chip: Bench) -> None:
    """10.5.5: CIRC is forced to 1 by hardware if DBM is set, as soon as the stream is enabled."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC | DBM, 2, ADC1 + ADC_DR, SRAM, SRAM + 64)
    assert chip.read(STREAM0) & CIRC


def test_a_stream_enabled_again_counts_from_what_was_programmed(chip: Bench) -> None:
    """10.5.6: NDTR is reloaded with the previously programmed value when the stream is enabled again."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC, 2, ADC1 + ADC_DR)
    converting(chip)
    many(chip, 2)
    assert chip.read(STREAM0 + 4) == 0
    clear_stream_flags(chip, DMA2, 0)
    chip.change(STREAM0, EN)
    assert chip.read(STREAM0 + 4) == 2
    for n in range(2):
        chip.write(SRAM + 2 * n, 0, 2)
    many(chip, 1)
    assert chip.read(STREAM0 + 4) == 1
    assert near(halves(chip, 1)[0], code_of_pin(32))
    assert halves(chip, 2)[1] == 0


def test_fifo_packs_little_endian_and_stores_at_its_threshold(chip: Bench) -> None:
    """10.3.6, 10.3.10: half-words fill the FIFO up to its threshold (here half: two words), then words are stored.

    NDTR counts items of the peripheral's width.
    """
    base = STREAM0
    chip.write(base + 0x04, 8)
    chip.write(base + 0x08, ADC1 + ADC_DR)
    chip.write(base + 0x0C, SRAM)
    chip.write(base + 0x14, 4 | 1)
    chip.write(base, HALF_WORD | MEMORY_WORD | MINC)
    chip.write(base, HALF_WORD | MEMORY_WORD | MINC | EN)
    converting(chip)
    many(chip, 3)
    assert chip.read(base + 4) == 5
    assert words(chip, 2) == [0, 0]
    many(chip, 1)
    assert all(near(half, code_of_pin(32)) for half in halves(chip, 4))
    assert chip.read(base + 4) == 4


def test_stopping_a_stream_sets_tcif_and_keeps_the_count(chip: Bench) -> None:
    """10.3.14: clearing EN early sets TCIF; NDTR holds the number of remaining items."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC, 9, ADC1 + ADC_DR)
    converting(chip)
    many(chip, 2)
    chip.change(STREAM0, 0, EN)
    chip.run(MICROSECOND)
    assert not chip.read(STREAM0) & EN
    assert stream_flags(chip, DMA2, 0) & TCIF
    assert chip.read(STREAM0 + 4) == 7


def test_adc3_has_its_own_stream_and_channel(chip: Bench) -> None:
    """10.3.3, table 44: ADC3 is channel 2 of DMA2's streams 0 and 1, ADC2 channel 1 of streams 2 and 3."""
    start_stream(chip, DMA2, 1, 2 << 25 | HALF_WORD | MEMORY_HALF | MINC, 4, ADC3 + ADC_DR)
    start_stream(chip, DMA2, 3, 1 << 25 | HALF_WORD | MEMORY_HALF | MINC, 4, ADC2 + ADC_DR, SRAM + 64)
    for adc, channel in ((ADC2, 11), (ADC3, 12)):
        sequence(chip, adc, channel)
        power(chip, adc, control=DMA_ON | DDS)
        chip.change(adc + ADC_CR2, SWSTART)
        chip.run(3 * MICROSECOND)
    assert all_near([halves(chip, 1)[0], halves(chip, 1, SRAM + 64)[0]], (12, 11))


def test_writing_the_present_target_of_a_double_buffer_is_an_error(chip: Bench) -> None:
    """10.3.9: M1AR can be written while CT = 0; writing M0AR then sets TEIF and disables the stream."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC | DBM, 4, ADC1 + ADC_DR, SRAM, SRAM + 64)
    chip.write(STREAM0 + 0x10, SRAM + 128)
    assert chip.read(STREAM0) & EN
    assert chip.read(STREAM0 + 0x10) == SRAM + 128
    chip.write(STREAM0 + 0x0C, SRAM + 256)
    chip.run(MICROSECOND)
    chip.expect("M0AR")
    assert stream_flags(chip, DMA2, 0) & TEIF
    assert not chip.read(STREAM0) & EN


@pytest.mark.parametrize(("enable", "conversions"), [(HTIE, 2), (TCIE, 4)])
def test_interrupt_line_of_a_stream(chip: Bench, enable: int, conversions: int) -> None:
    """10.4: HTIF and TCIF interrupt if enabled; DMA2 stream 0 is position 56; LIFCR clears."""
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC | CIRC | enable, 4, ADC1 + ADC_DR)
    converting(chip)
    many(chip, conversions - 1)
    assert not chip.irq(56)
    many(chip, 1)
    assert chip.irq(56)
    clear_stream_flags(chip, DMA2, 0)
    assert not chip.irq(56)


def test_dma_moves_nothing_after_an_overrun(chip: Bench) -> None:
    """13.8.1, 13.9: once OVR is set requests are blocked, so all that reached memory is valid and in order.

    A triple simultaneous mode whose stream ends after two of its three results.
    """
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC, 2, ADC_CDR)
    triple(chip, TRIPLE_SIMULTANEOUS | DMA_MODE_1 | COMMON_DDS)
    convert(chip)
    convert(chip)
    assert chip.read(ADC_CSR) & (OVR | OVR << 8 | OVR << 16)
    chip.expect("overrun")
    clear_stream_flags(chip, DMA2, 0)
    start_stream(chip, DMA2, 0, HALF_WORD | MEMORY_HALF | MINC, 6, ADC_CDR, SRAM + 64)
    convert(chip)
    assert chip.read(STREAM0 + 4) == 6


@pytest.mark.parametrize(("urgent", "first"), [(None, 2), (6, 6), (2, 2)])
def test_the_arbiter_takes_the_priority_level_and_then_the_lower_stream(
    chip: Bench, urgent: int | None, first: int
) -> None:
    """10.3.4: PL first; of equal levels the stream of the lower number.

    Compares 2 and 3 of TIM1 ask streams 2 and 6 (table 44, channel 6) while the item of compare 1 is still being moved;
    each stores the counter, which runs on.
    """
    for n in (3, 2, 6):
        level = 3 << 16 if n == urgent else 0
        start_stream(chip, DMA2, n, 6 << 25 | HALF_WORD | MEMORY_HALF | MINC | level, 1, TIM1 + CNT, SRAM + 2 * n)
    for channel, compare in enumerate((497, 500, 500)):
        chip.write(TIM1 + CCR1 + 4 * channel, compare)
    chip.write(TIM1 + DIER, 7 << 9)
    chip.write(TIM1 + CR1, 1)
    chip.run(10 * MICROSECOND)
    stored = {n: chip.read(SRAM + 2 * n, 2) for n in (2, 6)}
    assert min(stored.values()) >= 500
    assert min(stored, key=lambda n: stored[n]) == first


def test_direct_mode_fetches_the_first_item_before_it_is_asked_for(chip: Bench) -> None:
    """10.3.6, memory to peripheral: in direct mode the first data is preloaded as soon as the stream is enabled."""
    for n, value in enumerate((11, 22)):
        chip.write(SRAM + 2 * n, value, 2)
    control = 6 << 25 | HALF_WORD | MEMORY_HALF | MINC | TO_PERIPHERAL
    start_stream(chip, DMA2, 5, control, 2, TIM1 + CCR1)
    chip.run(MICROSECOND)
    for n, value in enumerate((33, 44)):
        chip.write(SRAM + 2 * n, value, 2)
    chip.write(TIM1 + DIER, 1 << 8)
    seen = []
    for _ in range(2):
        chip.write(TIM1 + EGR, 1)
        chip.run(MICROSECOND)
        seen.append(chip.read(TIM1 + CCR1))
    assert seen == [11, 44]


def test_a_burst_that_does_not_fit_the_threshold_is_a_fifo_error(chip: Bench) -> None:
    """10.3.12, table 49: words, a quarter full, bursts of four are forbidden: FEIF, and the stream is disabled."""
    chip.write(STREAM0 + 0x04, 16)
    chip.write(STREAM0 + 0x08, ADC1 + ADC_DR)
    chip.write(STREAM0 + 0x0C, SRAM)
    chip.write(STREAM0 + 0x14, 4)
    chip.write(STREAM0, WORD | MEMORY_WORD | MINC | 1 << 23 | EN)
    chip.expect("does not fit the FIFO threshold")
    assert stream_flags(chip, DMA2, 0) & FEIF
    assert not chip.read(STREAM0) & EN


def test_an_early_stop_stores_what_is_in_the_fifo(chip: Bench) -> None:
    """10.3.12, FIFO flush: what remains in the FIFO is stored when the stream is disabled, then TCIF is set."""
    chip.write(STREAM0 + 0x04, 8)
    chip.write(STREAM0 + 0x08, ADC1 + ADC_DR)
    chip.write(STREAM0 + 0x0C, SRAM)
    chip.write(STREAM0 + 0x14, 4 | 3)
    chip.write(STREAM0, HALF_WORD | MEMORY_HALF | MINC | EN)
    converting(chip)
    many(chip, 3)
    assert halves(chip, 3) == [0, 0, 0]
    chip.change(STREAM0, 0, EN)
    chip.run(MICROSECOND)
    assert all(near(half, code_of_pin(32)) for half in halves(chip, 3))
    assert stream_flags(chip, DMA2, 0) & TCIF
    assert chip.read(STREAM0 + 4) == 5

"""A second reading of the converters' injected groups, watchdog and alignment (see ``second_reading_bench``).

Sections are those of RM0090 Rev 21: 13 ADC.
"""

from collections.abc import Iterator

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench
from tests.hil_sim.emulator.second_reading_bench import (
    ADC1,
    ADC_CR1,
    ADC_CR2,
    ADC_DR,
    ADC_JDR1,
    ADC_JOFR1,
    ADC_JSQR,
    ADC_SMPR1,
    ADC_SR,
    APB2,
    JEOC,
    JSWSTART,
    LEFT,
    SCAN,
    SWSTART,
    all_near,
    code_of_pin,
    convert,
    converters,
    near,
    power,
    sequence,
)

RES_6 = 3 << 24


@pytest.fixture
def chip() -> Iterator[Bench]:
    """168 MHz, converters at 21 MHz; each pin has a voltage of its own."""
    with converters() as bench:
        yield bench


def test_a_short_injected_sequence_begins_late_in_jsqr(chip: Bench) -> None:
    """13.13.12: with JL = 1 the converter takes JSQ3, then JSQ4, not JSQ1; the results are in JDR1 and JDR2."""
    chip.write(ADC1 + ADC_JSQR, 1 << 20 | 13 << 15 | 12 << 10 | 1 << 5 | 2)
    chip.write(ADC1 + ADC_CR1, SCAN)
    power(chip, ADC1)
    chip.change(ADC1 + ADC_CR2, JSWSTART)
    chip.run(5 * MICROSECOND)
    assert chip.read(ADC1 + ADC_SR) & JEOC
    assert all_near([chip.read(ADC1 + ADC_JDR1), chip.read(ADC1 + ADC_JDR1 + 4)], (12, 13))


def test_injected_offset_makes_a_signed_result(chip: Bench) -> None:
    """13.4: JOFRx is subtracted from the result of an injected channel, sign extended."""
    chip.write(ADC1 + ADC_JSQR, 10 << 15)
    chip.write(ADC1 + ADC_JOFR1, code_of_pin(32) + 100)
    power(chip, ADC1)
    chip.change(ADC1 + ADC_CR2, JSWSTART)
    chip.run(5 * MICROSECOND)
    value = chip.read(ADC1 + ADC_JDR1) & 0xFFFF
    assert near(value - 0x10000, -100)


@pytest.mark.parametrize(("resolution", "shift"), [(0, 4), (RES_6, 2)])
def test_left_alignment_shifts_by_four_but_six_bits_within_their_byte(chip: Bench, resolution: int, shift: int) -> None:
    """13.4, figures 49 and 50: left-aligned on a half-word, with 6 bits on a byte."""
    sequence(chip, ADC1, 10)
    chip.write(ADC1 + ADC_CR1, resolution)
    power(chip, ADC1, control=LEFT)
    convert(chip)
    bits = 6 if resolution else 12
    value = chip.read(ADC1 + ADC_DR)
    assert abs((value >> shift) - (code_of_pin(32) >> 12 - bits)) <= 3
    assert not value & (1 << shift) - 1
    assert value < 1 << bits + shift


def test_injection_breaks_in_and_the_regular_conversion_begins_again(chip: Bench) -> None:
    """13.3.9, triggered injection: the regular conversion is reset, the injected one made, then it is resumed."""
    chip.write(ADC1 + ADC_SMPR1, 6)
    sequence(chip, ADC1, 10)
    chip.write(ADC1 + ADC_JSQR, 1 << 15)
    power(chip, ADC1)
    chip.edge.samples.clear()
    start = chip.now
    chip.change(ADC1 + ADC_CR2, SWSTART)
    chip.run(100 * 4 * APB2)
    chip.change(ADC1 + ADC_CR2, JSWSTART)
    chip.run(30 * MICROSECOND)
    assert near(chip.read(ADC1 + ADC_JDR1), code_of_pin(1))
    assert near(chip.read(ADC1 + ADC_DR), code_of_pin(32))
    injected, regular = (next(t for p, t in reversed(chip.edge.samples) if p == pin) for pin in (1, 32))
    assert (injected - start) / (4 * APB2) == pytest.approx(100 + 3 + 3, abs=5)
    assert (regular - injected) / (4 * APB2) == pytest.approx(12 + 144, abs=5)


def test_auto_injection_follows_the_regular_group(chip: Bench) -> None:
    """13.3.9, JAUTO: the injected group is converted after the regular group, without a trigger of its own."""
    sequence(chip, ADC1, 10, 11)
    chip.write(ADC1 + ADC_JSQR, 12 << 15)
    chip.write(ADC1 + ADC_CR1, SCAN | 1 << 10)
    power(chip, ADC1)
    chip.edge.samples.clear()
    convert(chip, 5)
    assert [pin for pin, _ in chip.edge.samples] == [32, 33, 34]
    assert chip.read(ADC1 + ADC_SR) & JEOC


def test_discontinuous_mode_takes_a_subgroup_a_trigger(chip: Bench) -> None:
    """13.3.10: n = 2 of three channels: the first trigger converts two, the second one, the third begins anew."""
    sequence(chip, ADC1, 10, 11, 12)
    chip.write(ADC1 + ADC_CR1, SCAN | 1 << 11 | 1 << 13)
    power(chip, ADC1)
    seen = []
    for _ in range(3):
        chip.edge.samples.clear()
        convert(chip, 5)
        seen.append([pin for pin, _ in chip.edge.samples])
    assert seen == [[32, 33], [34], [32, 33]]


@pytest.mark.parametrize(
    ("low", "high", "guarded", "alarm"),
    [
        (0, 0xFFF, 10, False),
        (-50, 50, 10, False),
        (50, 0xFFF, 10, True),
        (-0xFFF, -50, 10, True),
        (50, 0xFFF, 11, False),
    ],
)
def test_the_watchdog_guards_one_channel(chip: Bench, low: int, high: int, guarded: int, alarm: bool) -> None:
    """13.3.7: AWD is set below LTR or above HTR; with AWDSGL it guards the channel AWDCH alone."""
    code = code_of_pin(32)
    sequence(chip, ADC1, 10)
    chip.write(ADC1 + 0x24, min(max(code + high, 0), 0xFFF))
    chip.write(ADC1 + 0x28, min(max(code + low, 0), 0xFFF) if low else 0)
    chip.write(ADC1 + ADC_CR1, 1 << 23 | 1 << 9 | guarded)
    power(chip, ADC1)
    convert(chip)
    assert bool(chip.read(ADC1 + ADC_SR) & 1) == alarm

"""ADC: directed tests on the bare chip."""

from collections.abc import Callable
from itertools import pairwise

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench

TIM1, TIM2, DMA2, GPIOA = 0x40010000, 0x40000000, 0x40026400, 0x40020000
ADC1, ADC2, ADC3, COMMON = 0x40012000, 0x40012100, 0x40012200, 0x40012300
SR, AC1, AC2, SMPR2, SQR1, SQR3, JSQR, JDR1, DR = 0x00, 0x04, 0x08, 0x10, 0x2C, 0x34, 0x38, 0x3C, 0x4C
EOC, STRT, OVR = 2, 16, 32
SRAM = 0x20001000
ADC_CLOCK_PS = 1e12 / 21e6  # PCLK2 84 MHz / 4


def make(analog: Callable[[int, int], float]) -> Bench:
    chip = Bench(analog=analog)
    chip.full_speed()
    chip.write(COMMON + 4, 1 << 16)
    for pin in range(8):
        chip.analog_pin("A", pin)
    return chip


def on(chip: Bench, adc: int, control: int = 0) -> None:
    chip.write(adc + AC2, control | 1)
    chip.run(4 * MICROSECOND)


def finish(chip: Bench) -> None:
    report = chip.report
    chip.close()
    assert not report


@pytest.mark.parametrize(
    ("volts", "code"),
    [(0, 0), (-1, 0), (1.65, 2048), (3.3, 4095), (9, 4095), (3.3 / 4096 * 100.4, 100), (3.3 / 4096 * 100.6, 101)],
)
def test_code(volts: float, code: int) -> None:
    chip = make(lambda pin, time: volts)
    on(chip, ADC1)
    chip.change(ADC1 + AC2, 1 << 30)
    chip.run(2 * MICROSECOND)
    assert chip.read(ADC1 + SR) == EOC | STRT
    assert chip.read(ADC1 + DR) == code
    assert chip.read(ADC1 + SR) == STRT
    finish(chip)


@pytest.mark.parametrize(("setting", "sampling"), list(enumerate((3, 15, 28, 56, 84, 112, 144, 480))))
@pytest.mark.parametrize(("resolution", "bits"), [(0, 12), (3, 6)])
def test_conversion_time(setting: int, sampling: int, resolution: int, bits: int) -> None:
    """The switch opens after the sampling time, the result comes one clock a bit later.

    Before that, two clocks of latency and up to one to the clock's edge.
    """
    chip = make(lambda pin, time: 1.0)
    chip.write(ADC1 + SMPR2, setting)
    chip.write(ADC1 + AC1, resolution << 24 | 1 << 5)
    on(chip, ADC1)
    chip.change(ADC1 + AC2, 1 << 30)
    begin = chip.now
    ((pin, opened),) = chip.edge.samples
    assert pin == 0
    assert 2 * ADC_CLOCK_PS <= opened - begin - sampling * ADC_CLOCK_PS < 3.01 * ADC_CLOCK_PS
    done = opened + bits * ADC_CLOCK_PS
    chip.run_to(done - 10)
    assert not chip.irq(18)
    chip.run_to(done + 10)
    assert chip.irq(18)
    chip.read(ADC1 + DR)
    assert not chip.irq(18)
    finish(chip)


def test_scan_sequence_with_dma_and_continuous_restart() -> None:
    chip = make(lambda pin, time: pin * 3.3 / 16)
    base = DMA2 + 0x10
    chip.write(base + 4, 6)
    chip.write(base + 8, ADC1 + DR)
    chip.write(base + 0xC, SRAM)
    chip.write(base, 1 << 11 | 1 << 13 | 1 << 10 | 1)
    chip.write(ADC1 + AC1, 1 << 8)
    chip.write(ADC1 + SQR1, 2 << 20)
    chip.write(ADC1 + SQR3, 3 | 1 << 5 | 2 << 10)
    on(chip, ADC1, 1 << 8 | 1 << 9)
    for _ in range(2):
        chip.change(ADC1 + AC2, 1 << 30)
        chip.run(5 * MICROSECOND)
    words = [chip.read(SRAM + 2 * i, 2) // 256 for i in range(6)]
    assert words == [3, 1, 2, 3, 1, 2]
    assert chip.read(base) & 1 == 0
    finish(chip)


def test_overrun_stops_and_is_loud() -> None:
    chip = make(lambda pin, time: 1.0)
    on(chip, ADC1, 1 << 10 | 2)
    chip.change(ADC1 + AC2, 1 << 30)
    chip.run(5 * MICROSECOND)
    assert chip.read(ADC1 + SR) & OVR
    chip.expect("overrun, a result was lost")
    count = len(chip.edge.samples)
    chip.run(5 * MICROSECOND)
    assert len(chip.edge.samples) == count
    finish(chip)


def test_dma_without_dds_ends_after_one_buffer() -> None:
    """RM0090 13.8.1: with DDS 0 no request follows the last transfer, circular stream or not."""
    chip = make(lambda pin, time: 1.0)
    base = DMA2 + 0x10
    chip.write(base + 4, 4)
    chip.write(base + 8, ADC1 + DR)
    chip.write(base + 0xC, SRAM)
    chip.write(base, 1 << 11 | 1 << 13 | 1 << 10 | 1 << 8 | 1)
    on(chip, ADC1, 1 << 8)
    for _ in range(6):
        chip.change(ADC1 + AC2, 1 << 30)
        chip.run(5 * MICROSECOND)
    assert chip.read(base + 4) == 4
    assert chip.read(DMA2) & 0x20
    finish(chip)


@pytest.mark.parametrize(
    ("external", "timer", "compare"),
    [(0, TIM1, 0), (1, TIM1, 1), (2, TIM1, 2), (3, TIM2, 1), (4, TIM2, 2), (5, TIM2, 3)],
)
def test_compare_triggers(external: int, timer: int, compare: int) -> None:
    """PWM mode 2: the output rises at the match, once a period."""
    chip = make(lambda pin, time: 1.0)
    clock = 168e6 if timer == TIM1 else 84e6
    on(chip, ADC1, external << 24 | 1 << 28)
    chip.change(timer + (0x18 if compare < 2 else 0x1C), 7 << (4 + 8 * (compare % 2)))
    chip.write(timer + 0x34 + 4 * compare, 1000)
    chip.write(timer + 0x2C, 1679)
    chip.write(timer + 0x20, 1 << 4 * compare)
    if timer == TIM1:
        chip.write(TIM1 + 0x44, 0x8000)
    chip.write(timer, 1)
    begin = chip.now
    for i in range(3):
        chip.run(1680 / clock * 1e12)
        chip.read(ADC1 + DR)
        assert len(chip.edge.samples) == i + 1
    match = [
        t - 3 * ADC_CLOCK_PS - (1000 + 1680 * i) / clock * 1e12 - begin for i, (_, t) in enumerate(chip.edge.samples)
    ]
    assert all(2 * ADC_CLOCK_PS - 1 <= m <= 3 * ADC_CLOCK_PS + 2e12 / clock for m in match)
    finish(chip)


def test_silent_compare_is_explained() -> None:
    chip = make(lambda pin, time: 1.0)
    on(chip, ADC1, 1 << 28)
    chip.write(TIM1 + 0x34, 100)
    chip.write(TIM1 + 0x2C, 1679)
    chip.write(TIM1 + 0x20, 1)
    chip.write(TIM1 + 0x0C, 2)
    chip.write(TIM1, 1)
    chip.run(20 * MICROSECOND)
    chip.expect("OC1 never changes")
    finish(chip)


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_triple_simultaneous(mode: int) -> None:
    """One trigger, eight conversions of three converters at the same moments; DMA order ADC1, ADC2, ADC3."""
    chip = make(lambda pin, time: (pin * 512 + time // 1000 % 97 + 1) * 3.3 / 4096)
    base = DMA2 + 0x10
    size, items = {1: (1, 24), 2: (2, 12), 3: (1, 12)}[mode]
    chip.write(base + 4, items)
    chip.write(base + 8, COMMON + 8)
    chip.write(base + 0xC, SRAM)
    chip.write(base, size << 11 | size << 13 | 1 << 10 | 1 << 4 | 1)
    chip.write(COMMON + 4, 1 << 16 | mode << 14 | 1 << 13 | 0x16)
    for adc, channel in ((ADC1, 1), (ADC2, 2), (ADC3, 3)):
        chip.write(adc + AC1, 1 << 8 | (2 << 24 if mode == 3 else 0))
        chip.write(adc + SMPR2, 0o2222)
        chip.write(adc + SQR1, 7 << 20 | channel << 5 | channel)
        chip.write(adc + 0x30, sum(channel << 5 * i for i in range(6)))
        chip.write(adc + SQR3, sum(channel << 5 * i for i in range(6)))
        on(chip, adc, (6 << 24 | 1 << 28) if adc == ADC1 else 0)
    chip.write(TIM2 + 0x2C, 8400)
    chip.write(TIM2 + 4, 2 << 4)
    chip.write(TIM2, 1)
    begin = chip.now
    chip.run(140 * MICROSECOND)
    samples = chip.edge.samples
    assert [pin for pin, _ in samples] == [1, 2, 3] * 8
    times = [t for _, t in samples[::3]]
    assert [t for _, t in samples] == [t for t in times for _ in range(3)]
    bits = 8 if mode == 3 else 12
    for a, b in pairwise(times):
        assert abs(b - a - (28 + bits) * ADC_CLOCK_PS) <= 1
    update = begin + 8402 / 84e6 * 1e12
    assert 0 < times[0] - update - 29 * ADC_CLOCK_PS < 2.1 * ADC_CLOCK_PS
    codes = [pin * 512 + time // 1000 % 97 + 1 for pin, time in samples]
    if mode == 3:
        assert [chip.read(SRAM + i, 1) for i in range(24)] == [c >> 4 for c in codes]
    else:
        assert [chip.read(SRAM + 2 * i, 2) for i in range(24)] == codes
    assert chip.irq(56)
    assert chip.read(COMMON) & OVR == 0
    finish(chip)


def test_injected_group_interrupts_the_regular_one() -> None:
    chip = make(lambda pin, time: pin * 3.3 / 16)
    chip.write(ADC1 + SMPR2, 0o77777777)
    chip.write(ADC1 + SQR3, 1)
    chip.write(ADC1 + AC1, 1 << 8 | 1 << 7)
    chip.write(ADC1 + JSQR, 1 << 20 | 4 << 10 | 5 << 15)
    chip.write(ADC1 + 0x14, 24)
    on(chip, ADC1)
    chip.change(ADC1 + AC2, 1 << 30)
    chip.run(10 * MICROSECOND)
    chip.change(ADC1 + AC2, 1 << 22)
    chip.run(100 * MICROSECOND)
    assert chip.irq(18)
    assert [pin for pin, _ in chip.edge.samples] == [1, 4, 5, 1]
    assert [chip.read(ADC1 + JDR1 + 4 * i) for i in range(2)] == [1024 - 24, 1280]
    assert chip.read(ADC1 + DR) == 256
    finish(chip)


@pytest.mark.parametrize("celsius", [-20.0, 25.0, 85.0])
def test_temperature_against_the_factory_calibration(celsius: float) -> None:
    chip = Bench(temperature_degc=celsius)
    chip.full_speed()
    chip.write(COMMON + 4, 1 << 23 | 1 << 16)
    chip.write(ADC1 + 0x0C, 7 << 18 | 7 << 21)
    codes = {}
    on(chip, ADC1)
    for channel in (16, 17):
        chip.write(ADC1 + SQR3, channel)
        chip.change(ADC1 + AC2, 1 << 30)
        chip.run(40 * MICROSECOND)
        codes[channel] = chip.read(ADC1 + DR)
    cold, hot, reference = (chip.read(0x1FFF7A00 + o, 2) for o in (0x2C, 0x2E, 0x2A))
    assert 30 + (codes[16] - cold) * 80 / (hot - cold) == pytest.approx(celsius, abs=1.0)
    assert codes[17] == pytest.approx(reference, abs=1)
    finish(chip)


def test_strictness() -> None:
    chip = make(lambda pin, time: 1.0)
    chip.write(ADC1 + AC2, 1)
    chip.change(ADC1 + AC2, 1 << 30)
    chip.expect("less than 3 us after ADON")
    chip.run(5 * MICROSECOND)
    chip.write(COMMON + 4, 0)
    chip.change(ADC1 + AC2, 1 << 30)
    chip.expect("above 36 MHz")
    chip.write(COMMON + 4, 1 << 16)
    chip.write(ADC1 + SQR3, 10)
    chip.change(ADC1 + AC2, 1 << 30)
    chip.expect("its pin PC0 is not in analog mode")
    chip.change(ADC1 + AC2, 1 << 30)
    chip.expect("and was lost")
    chip.run(5 * MICROSECOND)
    chip.write(COMMON + 4, 0x17)
    chip.expect("does not do this value of MULTI")
    finish(chip)

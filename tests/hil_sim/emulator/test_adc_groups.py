"""ADC: injected groups, their triggers, and converters that go together, on the bare chip (RM0090 13.3.9, 13.9)."""

from collections.abc import Iterator

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench

TIM1, TIM2, TIM3, TIM4, TIM5, TIM8 = 0x40010000, 0x40000000, 0x40000400, 0x40000800, 0x40000C00, 0x40010400
TIMER_CR2, TIMER_SMCR, TIMER_EGR, TIMER_ARR, TIMER_CCR1, TIMER_BDTR = 0x04, 0x08, 0x14, 0x2C, 0x34, 0x44
DMA2, EXTI, SRAM = 0x40026400, 0x40013C00, 0x20001000
ADC = ADC1, ADC2, ADC3 = 0x40012000, 0x40012100, 0x40012200
COMMON = 0x40012300
SR, AC1, AC2, SMPR1, SMPR2, SQR1, SQR2, SQR3, JSQR, JDR1, DR = (
    0x00, 0x04, 0x08, 0x0C, 0x10, 0x2C, 0x30, 0x34, 0x38, 0x3C, 0x4C,
)  # fmt: skip
EOC, JEOC, JSTRT, STRT = 2, 4, 8, 16
SCAN, JEOCIE = 1 << 8, 1 << 7
CONT, SWSTART, JSWSTART = 2, 1 << 30, 1 << 22
RISING, FALLING = 1 << 20, 2 << 20  # JEXTEN
CLOCK_PS = 1e12 / 21e6  # PCLK2 84 MHz / 4
ADC_IRQ = 18


@pytest.fixture
def chip() -> Iterator[Bench]:
    """Pin p carries p / 16 of the reference; the converters' clock is 21 MHz."""
    bench = Bench(analog=lambda pin, time: pin * 3.3 / 16)
    bench.full_speed()
    bench.write(COMMON + 4, 1 << 16)
    for pin in range(8):
        bench.analog_pin("A", pin)
    yield bench
    report = bench.report
    bench.close()
    assert not report


def on(chip: Bench, *converters: int) -> None:
    for adc in converters:
        chip.change(adc + AC2, 1)
    chip.run(4 * MICROSECOND)


def together(chip: Bench, mode: int, dma: int = 0) -> None:
    chip.write(COMMON + 4, 1 << 16 | mode | dma)


def injected(chip: Bench, adc: int, *channels: int) -> None:
    chip.write(
        adc + JSQR, len(channels) - 1 << 20 | sum(c << 5 * (4 - len(channels) + i) for i, c in enumerate(channels))
    )
    chip.change(adc + AC1, SCAN)


def regular(chip: Bench, adc: int, *channels: int) -> None:
    chip.write(adc + SQR1, len(channels) - 1 << 20 | sum(c << 5 * i for i, c in enumerate(channels[12:])))
    chip.write(adc + SQR2, sum(c << 5 * i for i, c in enumerate(channels[6:12])))
    chip.write(adc + SQR3, sum(c << 5 * i for i, c in enumerate(channels[:6])))
    chip.change(adc + AC1, SCAN)


def codes(chip: Bench, adc: int, count: int) -> list[int]:
    return [chip.read(adc + JDR1 + 4 * i) // 256 for i in range(count)]


TIMER_TRIGGERS = [
    (0, TIM1, 3), (1, TIM1, None), (2, TIM2, 0), (3, TIM2, None), (4, TIM3, 1), (5, TIM3, 3), (6, TIM4, 0),
    (7, TIM4, 1), (8, TIM4, 2), (9, TIM4, None), (10, TIM5, 3), (11, TIM5, None), (12, TIM8, 1), (13, TIM8, 2),
    (14, TIM8, 3),
]  # fmt: skip


@pytest.mark.parametrize(("selection", "timer", "compare"), TIMER_TRIGGERS)
@pytest.mark.parametrize(("adc", "enable"), [(ADC1, 1), (ADC2, 1), (ADC3, 3)])
def test_injected_triggers(chip: Bench, selection: int, timer: int, compare: int | None, adc: int, enable: int) -> None:
    """Table 70: JEXTSEL; the switch opens 3 clocks of latency and 3 of sampling after the trigger's next clock edge."""
    clock_hz = 168e6 if timer in (TIM1, TIM8) else 84e6
    injected(chip, adc, 2)
    chip.change(adc + AC2, selection << 16 | enable << 20)
    on(chip, adc)
    chip.write(timer + TIMER_ARR, 16799)
    if compare is None:
        chip.write(timer + TIMER_CR2, 2 << 4)
    else:
        chip.change(timer + (0x18 if compare < 2 else 0x1C), 7 << (4 + 8 * (compare % 2)))
        chip.write(timer + TIMER_CCR1 + 4 * compare, 8000)
        chip.write(timer + 0x20, 1 << 4 * compare)
        if timer in (TIM1, TIM8):
            chip.write(timer + TIMER_BDTR, 0x8000)
    chip.write(timer, 1)
    start = chip.now + 1e12 / clock_hz
    chip.run(1.9 * 16800 / clock_hz * 1e12)
    period = 16800 / clock_hz * 1e12
    if compare is None:
        # A pulse has both edges at once: with both selected, the second finds the group running
        expected = [period]
        if enable == 3:
            chip.expect("an injected trigger came while the injected group was still being converted")
    else:
        rise = 8000 / clock_hz * 1e12
        expected = [rise, rise + period] if enable == 1 else [rise, period, rise + period]
    opened = [t - start - 6 * CLOCK_PS for _, t in chip.edge.samples]
    assert len(opened) == len(expected)
    assert all(-1 <= o - e <= CLOCK_PS + 2e12 / clock_hz for o, e in zip(opened, expected, strict=True))
    assert codes(chip, adc, 1) == [2]
    assert chip.read(adc + SR) == JEOC | JSTRT


def test_injected_pin_trigger(chip: Bench) -> None:
    chip.write(EXTI + 0, 1 << 15)
    chip.write(EXTI + 8, 1 << 15)
    injected(chip, ADC3, 1)
    chip.change(ADC3 + AC2, 15 << 16 | RISING)
    on(chip, ADC3)
    chip.operations.pin_in(chip.board, 15, False, chip.now)  # PA15 has a pull-up after reset
    chip.operations.pin_in(chip.board, 15, True, chip.now + MICROSECOND)
    chip.run(4 * MICROSECOND)
    assert codes(chip, ADC3, 1) == [1]


@pytest.mark.parametrize("enabled", [ADC1, ADC2, ADC3])
def test_interrupt_of_the_injected_group(chip: Bench, enabled: int) -> None:
    """JEOCIE of each converter raises the one line of all; writing 0 to JEOC lowers it."""
    for adc in ADC:
        injected(chip, adc, 1)
    chip.change(enabled + AC1, JEOCIE)
    on(chip, *ADC)
    for adc in ADC:
        if adc != enabled:
            chip.change(adc + AC2, JSWSTART)
    chip.run(2 * MICROSECOND)
    assert not chip.irq(ADC_IRQ)
    chip.change(enabled + AC2, JSWSTART)
    chip.run(2 * MICROSECOND)
    assert chip.irq(ADC_IRQ)
    chip.write(enabled + SR, 0x3F & ~JEOC)
    assert not chip.irq(ADC_IRQ)
    assert chip.read(enabled + SR) == JSTRT


def test_the_second_converter_alone(chip: Bench) -> None:
    """Outside the multi modes ADC2 has its own trigger, DMA line and interrupt; ADC1 converts on beside it."""
    regular(chip, ADC1, 1)
    chip.change(ADC1 + AC2, CONT)
    base = DMA2 + 0x10 + 0x18 * 2
    chip.write(base + 4, 4)
    chip.write(base + 8, ADC2 + DR)
    chip.write(base + 0xC, SRAM)
    chip.write(base, 1 << 25 | 1 << 11 | 1 << 13 | 1 << 10 | 1 << 4 | 1)
    regular(chip, ADC2, 6, 2)
    chip.change(ADC2 + AC2, 9 << 24 | 1 << 28 | 3 << 8)  # TIM4 CC4; DMA, DDS
    on(chip, ADC1, ADC2)
    chip.change(ADC1 + AC2, SWSTART)
    chip.write(TIM4 + 0x1C, 7 << 12)
    chip.write(TIM4 + TIMER_CCR1 + 12, 500)
    chip.write(TIM4 + TIMER_ARR, 839)
    chip.write(TIM4 + 0x20, 1 << 12)
    chip.write(TIM4, 1)
    chip.run(19 * MICROSECOND)
    assert [chip.read(SRAM + 2 * i, 2) // 256 for i in range(4)] == [6, 2, 6, 2]
    assert chip.irq(58)
    assert sum(pin == 1 for pin, _ in chip.edge.samples) > 20


@pytest.mark.parametrize("mode", [1, 6])
def test_dual_mode_leaves_the_third_converter_alone(chip: Bench, mode: int) -> None:
    """CDR holds ADC2's and ADC1's results; ADC3 has its own sequence, injected group and DMA line."""
    together(chip, mode, dma=2 << 14 | 1 << 13)
    for n, (adc, line, source, memory) in enumerate(((ADC1, 0, COMMON + 8, SRAM), (ADC3, 2, ADC3 + DR, SRAM + 0x100))):
        base = DMA2 + 0x10 + 0x18 * n
        size = 2 if adc == ADC1 else 1
        chip.write(base + 4, 2)
        chip.write(base + 8, source)
        chip.write(base + 0xC, memory)
        chip.write(base, line << 25 | size << 11 | size << 13 | 1 << 10 | 1)
    regular(chip, ADC1, 1, 4)
    regular(chip, ADC2, 2, 5)
    regular(chip, ADC3, 3, 0)
    injected(chip, ADC3, 1)
    chip.change(ADC3 + AC2, 1 << 8)
    on(chip, *ADC)
    chip.change(ADC3 + AC2, SWSTART)
    chip.change(ADC1 + AC2, SWSTART)
    chip.change(ADC3 + AC2, JSWSTART)
    chip.run(5 * MICROSECOND)
    assert [chip.read(SRAM + 4 * i) for i in range(2)] == [0x02000100, 0x05000400]
    assert [chip.read(SRAM + 0x100 + 2 * i, 2) for i in range(2)] == [0x300, 0]
    assert codes(chip, ADC3, 1) == [1]


@pytest.mark.parametrize("interrupted", range(4))
def test_injected_interrupts_the_triple_burst(chip: Bench, interrupted: int) -> None:
    """MULTI 0x11, 13.9.5: the conversion that runs is given up by all three and done again by all three at once."""
    together(chip, 0x11, dma=1 << 14 | 1 << 13)
    base = DMA2 + 0x10
    chip.write(base + 4, 12)
    chip.write(base + 8, COMMON + 8)
    chip.write(base + 0xC, SRAM)
    chip.write(base, 1 << 11 | 1 << 13 | 1 << 10 | 1)
    for adc, field, current in ((ADC1, 1, 0), (ADC2, 2, 6), (ADC3, 3, 3)):
        chip.write(adc + SMPR2, 0o11111111)
        regular(chip, adc, *[field] * 4)
        injected(chip, adc, current, 7 if adc == ADC1 else 5 if adc == ADC2 else 2)
    chip.change(ADC1 + AC1, JEOCIE)
    on(chip, *ADC)
    chip.change(ADC1 + AC2, SWSTART)
    chip.run((2 + 27 * interrupted + 13) * CLOCK_PS)
    chip.change(ADC1 + AC2, JSWSTART)
    assert [chip.read(adc + SR) & JSTRT for adc in ADC] == [JSTRT] * 3
    chip.run(20 * MICROSECOND)
    assert chip.irq(ADC_IRQ)
    assert [chip.read(adc + SR) & JEOC for adc in ADC] == [JEOC] * 3
    assert [codes(chip, adc, 2) for adc in ADC] == [[0, 7], [6, 5], [3, 2]]
    assert [chip.read(SRAM + 2 * i, 2) // 256 for i in range(12)] == [1, 2, 3] * 4
    steps = [tuple(pin for pin, _ in chip.edge.samples[i : i + 3]) for i in range(0, len(chip.edge.samples), 3)]
    assert steps == [(1, 2, 3)] * (interrupted + 1) + [(0, 6, 3), (7, 5, 2)] + [(1, 2, 3)] * (4 - interrupted)
    times = [t for _, t in chip.edge.samples]
    assert all(times[i] == times[i + 1] == times[i + 2] for i in range(0, len(times), 3))


def test_injected_simultaneous_with_independent_regular_groups(chip: Bench) -> None:
    """MULTI 0x15, 13.9.1: regular conversions are independent, are interrupted, and go on after the injected group."""
    together(chip, 0x15)
    for adc, channels in ((ADC1, (1, 1)), (ADC2, (2, 2, 2)), (ADC3, (3,))):
        regular(chip, adc, *channels)
        chip.change(adc + AC2, 1 << 10 | 1 << 8 | 1 << 9 if adc == ADC2 else 0)
        injected(chip, adc, {ADC1: 4, ADC2: 5, ADC3: 0}[adc])
    chip.write(ADC2 + SMPR2, 0o222)
    base = DMA2 + 0x10 + 0x18 * 2
    chip.write(base + 4, 3)
    chip.write(base + 8, ADC2 + DR)
    chip.write(base + 0xC, SRAM)
    chip.write(base, 1 << 25 | 1 << 11 | 1 << 13 | 1 << 10 | 1)
    on(chip, *ADC)
    chip.change(ADC2 + AC2, SWSTART)
    chip.run(50 * CLOCK_PS)  # In its second conversion
    chip.change(ADC1 + AC2, JSWSTART)
    chip.change(ADC3 + AC2, SWSTART)  # Waits for the injected group
    chip.run(20 * MICROSECOND)
    pins = [pin for pin, _ in chip.edge.samples]
    assert pins == [2, 2, 4, 5, 0, 2, 3, 2]
    assert [codes(chip, adc, 1) for adc in ADC] == [[4], [5], [0]]
    assert [chip.read(SRAM + 2 * i, 2) // 256 for i in range(3)] == [2, 2, 2]
    assert chip.read(ADC3 + DR) // 256 == 3
    assert chip.read(ADC1 + SR) & STRT == 0


def test_a_single_conversion_may_be_longer_on_one_converter(chip: Bench) -> None:
    """The temperature (480 clocks) with currents (15) beside it: each opens at its own time, JEOC when all are done."""
    together(chip, 0x11 | 1 << 23)
    injected(chip, ADC1, 16)
    chip.write(ADC1 + SMPR1, 7 << 18)
    injected(chip, ADC2, 6)
    injected(chip, ADC3, 3)
    for adc in (ADC2, ADC3):
        chip.write(adc + SMPR2, 0o11111111)
    chip.change(ADC2 + AC1, JEOCIE)
    on(chip, *ADC)
    begin = chip.now
    chip.change(ADC1 + AC2, JSWSTART)
    assert [pin for pin, _ in chip.edge.samples] == [6, 3]
    assert all(0 <= t - begin - 18 * CLOCK_PS <= CLOCK_PS for _, t in chip.edge.samples)
    done = begin + (3 + 480 + 12) * CLOCK_PS
    chip.run_to(done - 10)
    assert not chip.irq(ADC_IRQ)
    chip.run_to(done + CLOCK_PS + 10)
    assert chip.irq(ADC_IRQ)
    assert codes(chip, ADC2, 1) == [6]
    assert codes(chip, ADC3, 1) == [3]
    assert chip.read(ADC1 + JDR1) == round(0.76 / 3.3 * 4096)


def test_a_compare_of_the_slave_timer_samples_once_a_chip(chip: Bench) -> None:
    """TIM8, reset by each update of TIM1, triggers the injected group at a count after the chip's edge (JEXTSEL 12)."""
    together(chip, 0x11)
    for adc, channel in ((ADC1, 0), (ADC2, 6), (ADC3, 3)):
        injected(chip, adc, channel)
        chip.write(adc + SMPR2, 0o11111111)
    chip.change(ADC1 + AC2, 12 << 16 | RISING)
    on(chip, *ADC)
    chip.write(TIM1 + TIMER_ARR, 16421)
    chip.write(TIM1 + TIMER_CR2, 2 << 4)
    chip.write(TIM8 + TIMER_SMCR, 4)
    chip.write(TIM8 + 0x18, 7 << 12)
    chip.write(TIM8 + TIMER_CCR1 + 4, 14240)
    chip.write(TIM8 + 0x20, 1 << 4)
    chip.write(TIM8 + TIMER_BDTR, 0x8000)
    chip.write(TIM8, 1)
    chip.write(TIM1, 1)
    start = chip.now + 1e12 / 168e6
    chip.run(5.95 * 97.75 * MICROSECOND)
    times = [t for pin, t in chip.edge.samples if pin == 6]
    assert [pin for pin, _ in chip.edge.samples] == [0, 6, 3] * 6
    for i, time in enumerate(times):
        match = start + (16422 * i + 14240) / 168e6 * 1e12
        assert -CLOCK_PS <= time - match - 18 * CLOCK_PS <= 2 * CLOCK_PS


def test_rules_of_going_together(chip: Bench) -> None:
    together(chip, 0x11)
    for adc, channel in zip(ADC, (1, 2, 3), strict=True):
        regular(chip, adc, channel, channel)
        injected(chip, adc, channel)
    on(chip, *ADC)
    chip.write(ADC3 + JSQR, 2 << 15)
    chip.change(ADC1 + AC2, JSWSTART)
    chip.expect("ADC3: converts the same pin as ADC2")
    chip.write(ADC2 + JSQR, 4 << 15)
    chip.expect("changed during a conversion")
    chip.change(ADC1 + AC2, JSWSTART)
    chip.expect("was lost")
    chip.run(3 * MICROSECOND)
    injected(chip, ADC3, 3, 0)
    chip.change(ADC1 + AC2, JSWSTART)
    chip.expect("ADC3: sequence length differs")
    chip.run(3 * MICROSECOND)
    chip.write(ADC2 + SMPR2, 0o11111111)
    chip.change(ADC1 + AC2, SWSTART)
    chip.expect("differ between converters that go together")
    chip.run(5 * MICROSECOND)
    chip.expect("differ between")


def overrun_in_triple_mode(chip: Bench) -> None:
    """Let three converters convert two sequences that nobody fetches."""
    together(chip, 0x16, dma=1 << 14 | 1 << 13)
    for adc, channel in zip(ADC, (1, 2, 3), strict=True):
        regular(chip, adc, channel)
    on(chip, *ADC)
    for _ in range(3):
        chip.change(ADC1 + AC2, SWSTART)
        chip.run(5 * MICROSECOND)
    chip.expect("overrun, a result was lost")
    for adc in ADC:
        chip.write(adc + SR, 0)


def fetched(chip: Bench) -> list[int]:
    """Return the pins whose results a DMA stream fetches of two triggers."""
    base = DMA2 + 0x10
    chip.write(base, 0)
    chip.write(DMA2 + 8, 0x3D)
    chip.write(base + 4, 6)
    chip.write(base + 8, COMMON + 8)
    chip.write(base + 0xC, SRAM)
    chip.write(base, 1 << 11 | 1 << 13 | 1 << 10 | 1)
    for _ in range(2):
        chip.change(ADC1 + AC2, SWSTART)
        chip.run(5 * MICROSECOND)
    return [chip.read(SRAM + 2 * i, 2) // 256 for i in range(6)]


@pytest.mark.parametrize("way", ["ADON", "CCR"])
def test_order_after_an_overrun_when_started_over(chip: Bench, way: str) -> None:
    overrun_in_triple_mode(chip)
    if way == "ADON":
        for adc in ADC:
            chip.change(adc + AC2, 0, 1)
        on(chip, *ADC)
    else:
        together(chip, 0x16)
        together(chip, 0x16, dma=1 << 14 | 1 << 13)
    assert fetched(chip) == [1, 2, 3, 1, 2, 3]


def test_order_after_an_overrun_when_only_its_flag_is_cleared() -> None:
    """RM0090 13.9: a converter may keep a result that was not fetched. Seeds give every shift, and each is loud."""
    orders = set()
    for seed in range(1, 12):
        chip = Bench(analog=lambda pin, time: pin * 3.3 / 16, memory_seed=seed)
        chip.full_speed()
        chip.write(COMMON + 4, 1 << 16)
        for pin in range(8):
            chip.analog_pin("A", pin)
        overrun_in_triple_mode(chip)
        orders.add(tuple(fetched(chip)))
        chip.expect("the order of the results may be shifted")
        chip.close()
    assert orders == {(1, 2, 3, 1, 2, 3), (3, 1, 2, 3, 1, 2), (3, 2, 1, 2, 3, 1)}


def test_software_start_beside_an_armed_trigger_is_doubtful(chip: Bench) -> None:
    """The next trigger may convert another channel; without the external trigger nothing is wrong."""
    injected(chip, ADC1, 1)
    on(chip, ADC1)
    chip.change(ADC1 + AC2, JSWSTART)
    chip.run(5 * MICROSECOND)
    chip.change(ADC1 + AC2, RISING)
    chip.change(ADC1 + AC2, JSWSTART)
    chip.expect("ADC1: JSWSTART while an external trigger of the injected group is armed (JEXTEN)")

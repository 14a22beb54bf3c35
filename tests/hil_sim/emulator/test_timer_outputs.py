"""Timer outputs on pins, dead time, commutation, locked bits: directed tests on the bare chip (RM0090 17.3, 17.4)."""

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench
from tests.hil_sim.emulator.timer_bench import (
    AOE,
    ARR,
    BDTR,
    BKE,
    BKP,
    CCER,
    CCMR1,
    CCMR2,
    CCR1,
    COMIF,
    CR1,
    CR2,
    DCR,
    DIER,
    DMA2,
    DMAR,
    EGR,
    FORCED_HIGH,
    FORCED_LOW,
    MOE,
    OSSI,
    OSSR,
    PA7,
    PA8,
    PB13,
    PB15,
    PRELOAD,
    PWM1,
    PWM2,
    SMCR,
    SR,
    SRAM,
    TICK,
    TIM1,
    TIM2,
    TIM3,
    TIM4,
    TIM5,
    TIM8,
    bridge,
    drives,
    edges,
    level,
)

# ---- Outputs on pins ----

PINS = [  # DS8626 table 9: port, pin, alternate function, timer, bit of CCER
    ("A", 8, 1, TIM1, 0), ("B", 13, 1, TIM1, 2), ("B", 14, 1, TIM1, 6), ("B", 15, 1, TIM1, 10),
    ("A", 7, 1, TIM1, 2), ("B", 0, 1, TIM1, 6), ("B", 1, 1, TIM1, 10), ("E", 8, 1, TIM1, 2),
    ("E", 10, 1, TIM1, 6), ("E", 12, 1, TIM1, 10),
    ("C", 6, 3, TIM8, 0), ("A", 5, 3, TIM8, 2), ("A", 7, 3, TIM8, 2), ("B", 0, 3, TIM8, 6), ("B", 1, 3, TIM8, 10),
    ("B", 14, 3, TIM8, 6), ("B", 15, 3, TIM8, 10), ("A", 7, 2, TIM3, 4), ("A", 6, 2, TIM3, 0), ("B", 4, 2, TIM3, 0),
]  # fmt: skip


@pytest.mark.parametrize(("port", "pin", "function", "timer", "bit"), PINS)
def test_outputs_reach_their_pins(fast_chip: Bench, port: str, pin: int, function: int, timer: int, bit: int) -> None:
    chip = fast_chip
    number = (ord(port) - ord("A")) * 16 + pin
    chip.alternate(port, pin, function)
    chip.write(timer + CCMR1, FORCED_HIGH | FORCED_HIGH << 8)
    chip.write(timer + CCMR2, FORCED_HIGH | FORCED_HIGH << 8)
    if timer != TIM3:
        chip.write(timer + BDTR, MOE)
    assert drives(chip, number) == "off"
    chip.write(timer + CCER, 1 << bit)
    assert drives(chip, number) == "high"
    chip.write(timer + CCER, 3 << bit)
    assert drives(chip, number) == "low", "the bit beside it is the polarity"
    chip.write(timer + CCER, 3 << bit ^ 0x333)
    chip.change(0x40020000 + 0x400 * (number // 16), 1 << 2 * pin, 3 << 2 * pin)
    assert drives(chip, number) == "low", "a port's output again"


CONTROL = [  # RM0090, output control bits: MOE, OSSI, OSSR, CC1E, CC1NE, then OC1 and OC1N with OC1REF 1, no dead time
    (1, 0, 0, 0, 0, "off", "off"), (1, 0, 0, 0, 1, "off", "high"), (1, 0, 0, 1, 0, "high", "off"),
    (1, 0, 0, 1, 1, "high", "low"), (1, 0, 1, 0, 0, "off", "off"), (1, 0, 1, 0, 1, "low", "high"),
    (1, 0, 1, 1, 0, "high", "low"), (1, 1, 1, 1, 1, "high", "low"), (0, 0, 0, 0, 0, "off", "off"),
    (0, 0, 1, 0, 1, "off", "off"), (0, 0, 0, 1, 0, "off", "off"), (0, 0, 0, 1, 1, "off", "off"),
    (0, 1, 0, 0, 0, "off", "off"), (0, 1, 0, 0, 1, "low", "low"), (0, 1, 0, 1, 0, "low", "low"),
    (0, 1, 1, 1, 1, "low", "low"),
]  # fmt: skip


@pytest.mark.parametrize(("moe", "ossi", "ossr", "main", "complement", "oc1", "oc1n"), CONTROL)
@pytest.mark.parametrize("inverted", [False, True])
def test_output_control_bits(
    fast_chip: Bench, moe: int, ossi: int, ossr: int, main: int, complement: int, oc1: str, oc1n: str, inverted: bool
) -> None:
    """With both polarities inverted, and the idle levels with them, each driven level is the other one."""
    chip = fast_chip
    chip.alternate("A", 8, 1)
    chip.alternate("B", 13, 1)
    chip.write(TIM1 + CCMR1, FORCED_HIGH)
    chip.write(TIM1 + CR2, 3 << 8 if inverted else 0)
    chip.write(TIM1 + CCER, main | complement << 2 | (0xA if inverted else 0))
    chip.write(TIM1 + BDTR, moe * MOE | ossi * OSSI | ossr * OSSR)
    other = {"low": "high", "high": "low", "off": "off"} if inverted else {x: x for x in ("low", "high", "off")}
    assert [drives(chip, PA8), drives(chip, PB13)] == [other[oc1], other[oc1n]]
    if moe and inverted and not main and not complement:
        chip.expect("has neither CCxE nor CCxNE")


def test_preloaded_compares_act_at_the_update(fast_chip: Bench) -> None:
    """PWM on an N output that is alone follows OC1REF itself. CCR1 and ARR that are written act a period later."""
    chip = fast_chip
    chip.alternate("B", 13, 1)
    chip.write(TIM1 + ARR, 999)
    chip.write(TIM1 + CCR1, 300)
    chip.write(TIM1 + CCMR1, PWM1 | PRELOAD)
    chip.write(TIM1 + CCER, 4)
    chip.write(TIM1 + BDTR, MOE)
    chip.write(TIM1 + EGR, 1)
    chip.write(TIM1 + CR1, 0x81)
    start = chip.now + TICK
    chip.write(TIM1 + CCR1, 1500)
    chip.write(TIM1 + ARR, 1999)
    chip.edge.pins.clear()
    chip.run(6000 * TICK)
    got = [(high, round((time - start) / TICK)) for high, time in edges(chip, PB13)]
    assert got == [(False, 300), (True, 1000), (False, 2500), (True, 3000), (False, 4500), (True, 5000)]


@pytest.mark.parametrize("offset", [0, 777])
def test_slave_on_another_bus_follows_its_master(fast_chip: Bench, offset: int) -> None:
    """TIM3 in reset mode on TIM1's update (ITR0): its channel 2 marks a time in TIM1's period, on PA7."""
    chip = fast_chip
    chip.alternate("A", 7, 2)
    chip.write(TIM3 + CCR1 + 4, 1000 + offset)
    chip.write(TIM3 + CCMR1, PWM2 << 8)
    chip.write(TIM3 + CCER, 1 << 4)
    chip.write(TIM3 + SMCR, 4)
    chip.write(TIM1 + ARR, 16421)
    chip.write(TIM1 + CR2, 2 << 4)
    chip.write(TIM3 + CR1, 1)
    chip.write(TIM1 + CR1, 0x81)
    start = chip.now + TICK
    chip.edge.pins.clear()
    chip.run(3.5 * 16422 * TICK)
    rises = [time for high, time in edges(chip, PA7) if high]
    wanted = [start + (16422 * i + 2 * (1000 + offset)) * TICK for i in range(4)]
    assert rises[1:] == pytest.approx(wanted[1:4], abs=3 * TICK)


@pytest.mark.parametrize(
    ("timer", "controller", "n", "channel", "request_bit", "first"),
    [(TIM1, DMA2, 5, 6, 8, ARR), (TIM1, DMA2, 4, 6, 12, ARR), (TIM8, DMA2, 1, 7, 8, CCR1 + 4)],
)
def test_bursts_of_the_advanced_timers(
    fast_chip: Bench, timer: int, controller: int, n: int, channel: int, request_bit: int, first: int
) -> None:
    """TIM1_UP, TIM1_CH4 and TIM8_UP: one request moves the burst that DCR names, then waits for the next event."""
    chip = fast_chip
    count = 4 if first == ARR else 2
    values = [700, 0, 150, 250, 800, 0, 350, 450] if first == ARR else [11, 22, 33, 44]
    for i, value in enumerate(values):
        chip.write(SRAM + 2 * i, value, 2)
    base = controller + 0x10 + 0x18 * n
    chip.write(base + 4, len(values))
    chip.write(base + 8, timer + DMAR)
    chip.write(base + 0xC, SRAM)
    chip.write(base, channel << 25 | 1 << 11 | 1 << 13 | 1 << 10 | 1 << 6 | 1)
    chip.write(timer + CR1, 0x80)
    chip.write(timer + DCR, (count - 1) << 8 | first // 4)
    chip.write(timer + DIER, 1 << request_bit)
    for step in range(2):
        chip.write(timer + EGR, 1 if request_bit == 8 else 0x10)
        chip.run(MICROSECOND)
        assert [chip.read(timer + first + 4 * i) for i in range(count)] == values[step * count : (step + 1) * count]
        assert chip.read(base + 4) == len(values) - (step + 1) * count


# ---- Dead time ----


@pytest.mark.parametrize(
    ("dtg", "ticks"),
    [(1, 1), (0x7F, 127), (0x80, 128), (0xBF, 254), (0xC0, 256), (0xDF, 504), (0xE0, 512), (0xFF, 1008)],
)
@pytest.mark.parametrize("division", [0, 1, 2])
def test_dead_time(fast_chip: Bench, dtg: int, ticks: int, division: int) -> None:
    """Each edge that switches on comes late by DTG, in clocks divided by CKD; the ones that switch off do not."""
    chip = fast_chip
    chip.alternate("A", 8, 1)
    chip.alternate("B", 13, 1)
    chip.write(TIM1 + ARR, 19999)
    chip.write(TIM1 + CCR1, 10000)
    chip.write(TIM1 + CCMR1, PWM1)
    chip.write(TIM1 + CCER, 5)
    chip.write(TIM1 + BDTR, MOE | dtg)
    chip.write(TIM1 + CR1, 0x81 | division << 8)
    start, late = chip.now + TICK, ticks << division
    chip.edge.pins.clear()
    chip.run(41000 * TICK)
    main = [(high, round((time - start) / TICK)) for high, time in edges(chip, PA8)]
    complement = [(high, round((time - start) / TICK)) for high, time in edges(chip, PB13)]
    main = [(high, tick) for high, tick in main if tick >= 10000]
    assert main[:3] == [(False, 10000), (True, 20000 + late), (False, 30000)]
    assert complement[:3] == [(True, 10000 + late), (False, 20000), (True, 30000 + late)]


def test_a_pulse_shorter_than_the_dead_time_is_lost(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.alternate("A", 8, 1)
    chip.alternate("B", 13, 1)
    chip.write(TIM1 + ARR, 999)
    chip.write(TIM1 + CCR1, 50)
    chip.write(TIM1 + CCMR1, PWM1)
    chip.write(TIM1 + CCER, 5)
    chip.write(TIM1 + BDTR, MOE | 60)
    chip.write(TIM1 + CR1, 0x81)
    chip.run(1000 * TICK)
    chip.edge.pins.clear()
    chip.run(5000 * TICK)
    assert not edges(chip, PA8)
    assert len(edges(chip, PB13)) == 10


# ---- What starts converters, and unused outputs ----

REGULAR = [  # RM0090 table 68: EXTSEL, timer, channel
    (0, TIM1, 1), (1, TIM1, 2), (2, TIM1, 3), (3, TIM2, 2), (4, TIM2, 3), (5, TIM2, 4), (7, TIM3, 1), (9, TIM4, 4),
    (10, TIM5, 1), (11, TIM5, 2), (12, TIM5, 3), (13, TIM8, 1),
]  # fmt: skip
INJECTED = [  # RM0090 table 69: JEXTSEL, timer, channel
    (0, TIM1, 4), (2, TIM2, 1), (4, TIM3, 2), (5, TIM3, 4), (6, TIM4, 1), (7, TIM4, 2), (8, TIM4, 3), (10, TIM5, 4),
    (12, TIM8, 2), (13, TIM8, 3), (14, TIM8, 4),
]  # fmt: skip


@pytest.mark.parametrize(
    ("injected", "selection", "timer", "channel"),
    [(False, *row) for row in REGULAR] + [(True, *row) for row in INJECTED],
)
def test_converters_by_compare(fast_chip: Bench, injected: bool, selection: int, timer: int, channel: int) -> None:
    """A rising output starts a conversion; the other channels of the timer start none."""
    chip = fast_chip
    chip.write(0x40012304, 1 << 16)
    chip.write(0x40012008, 1)
    chip.analog_pin("A", 0)
    chip.run(4 * MICROSECOND)
    chip.write(0x40012008, (selection << 16 | 1 << 20 if injected else selection << 24 | 1 << 28) | 1)
    if timer in (TIM1, TIM8):
        chip.write(timer + BDTR, MOE)
    chip.write(timer + CCER, 0x1111)
    for number in range(1, 5):
        register, shift = (CCMR1, CCMR2)[(number - 1) // 2], 8 * ((number - 1) % 2)
        chip.change(timer + register, FORCED_HIGH << shift)
        chip.run(2 * MICROSECOND)
        assert len(chip.edge.samples) == (number >= channel), number
    chip.write(0x40012000, 0)


@pytest.mark.parametrize(
    ("register", "value", "loud"), [(CCER, 2, True), (CCER, 8, True), (CR2, 1 << 14, True), (CCER, 0xB, False)]
)
def test_what_unused_outputs_must_keep_clear(fast_chip: Bench, register: int, value: int, loud: bool) -> None:
    chip = fast_chip
    chip.write(TIM1 + register, value)
    chip.write(TIM1 + BDTR, MOE)
    if loud:
        chip.expect("has neither CCxE nor CCxNE, but a polarity or idle level")


# ---- Commutation ----


def test_modes_and_enables_wait_for_the_commutation(fast_chip: Bench) -> None:
    """CCPC: OCxM, CCxE and CCxNE of channels 1 to 3 act from COMG on; channel 4 at once."""
    chip = fast_chip
    bridge(chip, BKE | OSSI | MOE)
    chip.alternate("A", 11, 1)
    chip.write(TIM1 + DIER, COMIF)
    chip.write(TIM1 + CR2, 1)
    chip.write(TIM1 + CCMR2, FORCED_LOW | FORCED_HIGH << 8)
    chip.write(TIM1 + CCER, 4 << 8 | 1 << 12)
    assert [level(chip, PB13), level(chip, PB15), level(chip, 11)] == [1, 1, 1]
    assert not chip.irq(26)
    chip.write(TIM1 + EGR, COMIF)
    assert [level(chip, PB13), level(chip, PB15)] == [0, 0]
    assert drives(chip, PB13) == "off"
    assert chip.irq(26)
    chip.write(TIM1 + SR, 0)
    assert not chip.irq(26)


@pytest.mark.parametrize("ccus", [False, True])
def test_commutation_by_trigger(fast_chip: Bench, ccus: bool) -> None:
    chip = fast_chip
    bridge(chip)
    chip.write(TIM1 + CR2, 1 | (4 if ccus else 0))
    chip.write(TIM1 + SMCR, 6 | 1 << 4)  # ITR1 is TIM2
    chip.write(TIM1 + CCMR2, FORCED_LOW)
    chip.write(TIM2 + CR2, 2 << 4)
    chip.write(TIM2 + EGR, 1)
    assert level(chip, PB15) == (0 if ccus else 1)


# ---- Locked bits ----

LOCKED = [  # RM0090 17.4.18: register, value before, change, the first LOCK level that protects it (4: none)
    (BDTR, 0, 0x01, 1), (BDTR, 0, 0x80, 1), (BDTR, 0, AOE, 1), (BDTR, 0, BKP, 1), (BDTR, 0, OSSI, 2),
    (BDTR, 0, OSSR, 2), (BDTR, 0, MOE, 4), (CR2, 0, 1 << 8, 1), (CR2, 0, 1 << 14, 1), (CR2, 0, 2 << 4, 4),
    (CCER, 0, 2, 2), (CCER, 0, 8, 2), (CCER, 0, 1 << 13, 2), (CCER, 0, 0x5, 4), (CCER, 0, 2 << 4, 4),
    (CCMR1, 1 << 8, FORCED_HIGH, 3), (CCMR1, 1 << 8, PRELOAD, 3), (CCMR1, 1 << 8, 4, 4),
    (CCMR1, 1 << 8, 3 << 12, 4), (CCMR2, 0, PWM1 << 8, 3), (CCR1, 0, 77, 4), (ARR, 0, 0xFF, 4),
]  # fmt: skip


@pytest.mark.parametrize(("register", "before", "change", "protected_from"), LOCKED)
@pytest.mark.parametrize("lock", [0, 1, 2, 3])
def test_locked_bits(fast_chip: Bench, register: int, before: int, change: int, protected_from: int, lock: int) -> None:
    """Channel 2 captures: its polarity and filter stay free."""
    chip = fast_chip
    chip.write(TIM1 + CCMR1, 1 << 8)
    if register != BDTR:
        chip.write(TIM1 + register, before)
        chip.write(TIM1 + BDTR, lock << 8)
        chip.write(TIM1 + register, before ^ change)
    else:
        before = lock << 8
        chip.write(TIM1 + BDTR, before)
        chip.write(TIM1 + BDTR, before ^ change)
    if lock >= protected_from:
        chip.expect(f"which LOCK {lock} protects until reset")
        assert chip.read(TIM1 + register) == before
    else:
        assert chip.read(TIM1 + register) == before ^ change


def test_lock_is_written_once(fast_chip: Bench) -> None:
    """Even a first write of 0 freezes it."""
    chip = fast_chip
    chip.write(TIM1 + BDTR, OSSI)
    chip.write(TIM1 + BDTR, OSSI | 1 << 8)
    chip.expect("the first write of the register froze it")
    assert chip.read(TIM1 + BDTR) == OSSI
    chip.write(0x40023844 - 0x20, 1)  # RCC_APB2RSTR: TIM1
    chip.write(0x40023844 - 0x20, 0)
    chip.write(TIM1 + BDTR, OSSI | 1 << 8)
    assert chip.read(TIM1 + BDTR) == OSSI | 1 << 8

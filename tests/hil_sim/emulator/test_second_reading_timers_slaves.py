"""A second reading of the timers: counters, triggers, captures (see ``second_reading_bench``).

Sections are those of RM0090: 17 advanced-control timers, 18 TIM2 to TIM5, 20 TIM6 and TIM7; AN4013 says the same in
fewer words.
"""

import pytest

from hil_sim.emulator.bench import Bench
from tests.hil_sim.emulator.second_reading_timers import (
    CC1IF,
    CC1OF,
    CEN,
    MMS_ENABLE,
    MMS_OC1,
    MMS_PULSE,
    MMS_UPDATE,
    NAMES,
    RESET_MODE,
    TG,
    TICK2,
    TIF,
    TRIGGER,
    UDIS,
    UG,
    UIF,
    URS,
    count,
    flags,
    pulse,
    slave,
)
from tests.hil_sim.emulator.timer_bench import (
    ARR,
    CCER,
    CCMR1,
    CCR1,
    CNT,
    CR1,
    CR2,
    EGR,
    PA6,
    PA7,
    PSC,
    PWM2,
    RCR,
    SMCR,
    SR,
    TICK,
    TIM1,
    TIM2,
    TIM3,
    TIM4,
    TIM5,
    TIM8,
    set_pin,
)

# ---- Which timer is which internal trigger ----


@pytest.mark.parametrize(
    ("timer", "masters"),
    [
        (TIM1, (TIM5, TIM2, TIM3, TIM4)),
        (TIM8, (TIM1, TIM2, TIM4, TIM5)),
        (TIM2, (TIM1, TIM8, TIM3, TIM4)),
        (TIM3, (TIM1, TIM2, TIM5, TIM4)),
        (TIM4, (TIM1, TIM2, TIM3, TIM8)),
        (TIM5, (TIM2, TIM3, TIM4, TIM8)),
    ],
    ids=("TIM1", "TIM8", "TIM2", "TIM3", "TIM4", "TIM5"),
)
def test_internal_triggers(fast_chip: Bench, timer: int, masters: tuple[int, ...]) -> None:
    """Tables 93 and 97, ITR0 to ITR3 by slave (TIM2's ITR1 as after reset, ITR1_RMP = 00); MMS = 000 sends UG."""
    for itr, expected in enumerate(masters):
        slave(fast_chip, timer, TRIGGER, itr)
        started = []
        for master in NAMES:
            if master == timer:
                continue
            fast_chip.write(timer + CR1, 0)
            flags(fast_chip, timer)
            pulse(fast_chip, master)
            if fast_chip.read(timer + CR1) & CEN:
                assert flags(fast_chip, timer) & TIF
                started.append(NAMES[master])
        assert started == [NAMES[expected]], itr
        fast_chip.write(timer + SMCR, 0)


# ---- Counting ----


def test_status_is_cleared_by_zeros_only(fast_chip: Bench) -> None:
    """18.4.5: SR is rc_w0; writing ones changes nothing, so SR = ~UIF clears UIF alone."""
    fast_chip.write(TIM3 + CCR1, 5)
    fast_chip.write(TIM3 + ARR, 20)
    fast_chip.write(TIM3 + CR1, CEN)
    fast_chip.run(100 * TICK2)
    fast_chip.write(TIM3 + CR1, 0)
    assert fast_chip.read(TIM3 + SR) & (UIF | CC1IF) == UIF | CC1IF
    fast_chip.write(TIM3 + SR, 0xFFFF & ~UIF)
    assert fast_chip.read(TIM3 + SR) & (UIF | CC1IF) == CC1IF


def test_a_compare_beyond_the_reload_value_flags_the_overflow(fast_chip: Bench) -> None:
    """18.4.5 CC1IF: when CCR1 > ARR it goes high on the counter overflow in upcounting mode."""
    fast_chip.write(TIM3 + ARR, 99)
    fast_chip.write(TIM3 + CCR1, 150)
    fast_chip.write(TIM3 + EGR, UG)
    flags(fast_chip, TIM3)
    fast_chip.write(TIM3 + CR1, CEN)
    fast_chip.run(95 * TICK2)
    assert not flags(fast_chip, TIM3) & CC1IF
    fast_chip.run(10 * TICK2)
    assert flags(fast_chip, TIM3) & CC1IF


def test_the_counter_starts_one_clock_after_cen(fast_chip: Bench) -> None:
    """18.3.1: the actual counter enable signal CNT_EN is set 1 clock cycle after CEN."""
    fast_chip.write(TIM3 + CR1, CEN)
    assert count(fast_chip, TIM3, 10.5) in (8, 9)


def test_a_reload_value_of_zero_blocks_the_counter(fast_chip: Bench) -> None:
    """18.4.12: the counter is blocked while the auto-reload value is null."""
    fast_chip.write(TIM3 + ARR, 0)
    fast_chip.write(TIM3 + EGR, UG)
    flags(fast_chip, TIM3)
    fast_chip.write(TIM3 + CR1, CEN)
    assert count(fast_chip, TIM3, 1000) == 0
    assert not flags(fast_chip, TIM3) & UIF


def test_tim2_and_tim5_count_32_bits(fast_chip: Bench) -> None:
    """18.4.10, 18.4.12: CNT and ARR of TIM2 and TIM5 have 32 bits, those of TIM3 and TIM4 16."""
    assert fast_chip.read(TIM5 + ARR) == 0xFFFFFFFF
    assert fast_chip.read(TIM4 + ARR) == 0xFFFF
    for timer, expected in ((TIM5, 0x10010), (TIM4, 0x10)):
        fast_chip.write(timer + CNT, 0xFFF0)
        fast_chip.write(timer + CR1, CEN)
        assert abs(count(fast_chip, timer, 32.5) - expected) <= 1


# ---- Slaves ----


def test_reset_mode_restarts_and_updates(fast_chip: Bench) -> None:
    """18.3.14, reset mode: the counter and prescaler restart, preloaded registers are updated, UIF if URS = 0; TIF."""
    slave(fast_chip, TIM3, RESET_MODE, 1)
    fast_chip.write(TIM3 + CR1, CEN)
    fast_chip.run(500 * TICK2)
    flags(fast_chip, TIM3)
    fast_chip.write(TIM3 + PSC, 9)
    pulse(fast_chip, TIM2)
    assert flags(fast_chip, TIM3) & (UIF | TIF) == UIF | TIF
    assert 90 <= count(fast_chip, TIM3, 1000) <= 110, "counts from 0 by ten now"
    fast_chip.write(TIM3 + CR1, CEN | URS)
    pulse(fast_chip, TIM2)
    assert flags(fast_chip, TIM3) & (UIF | TIF) == TIF
    assert fast_chip.read(TIM3 + CNT) < 5


def test_trigger_mode_sets_cen_and_does_not_reset(fast_chip: Bench) -> None:
    """18.3.14, trigger mode: the counter starts at the rising edge, from where it stands; only that is controlled."""
    fast_chip.write(TIM2 + CR2, MMS_ENABLE)
    slave(fast_chip, TIM3, TRIGGER, 1)
    fast_chip.write(TIM3 + CNT, 1234)
    assert count(fast_chip, TIM3, 100) == 1234
    fast_chip.write(TIM2 + CR1, CEN)
    assert 1330 <= count(fast_chip, TIM3, 100) <= 1334
    assert fast_chip.read(TIM3 + CR1) & CEN
    assert flags(fast_chip, TIM3) & (TIF | UIF) == TIF
    fast_chip.write(TIM2 + CR1, 0)
    before = fast_chip.read(TIM3 + CNT)
    assert count(fast_chip, TIM3, 100) - before == 100


def triggers(chip: Bench, timer: int, period: float, periods: int) -> list[bool]:
    """Whether TIF came in each of a number of periods of the master, which begin now."""
    seen = []
    for _ in range(periods):
        chip.run(period)
        seen.append(bool(flags(chip, timer) & TIF))
    return seen


def test_update_trigger_follows_the_repetition_counter(fast_chip: Bench) -> None:
    """17.4.2 MMS = 010: the trigger is the update event, which comes every RCR + 1 overflows."""
    fast_chip.write(TIM1 + ARR, 99)
    fast_chip.write(TIM1 + RCR, 2)
    fast_chip.write(TIM1 + EGR, UG)
    fast_chip.write(TIM1 + CR2, MMS_UPDATE)
    slave(fast_chip, TIM3, TRIGGER, 0)
    fast_chip.write(TIM1 + CR1, CEN)
    fast_chip.run(50 * TICK)
    flags(fast_chip, TIM3)
    assert triggers(fast_chip, TIM3, 100 * TICK, 6) == [False, False, True, False, False, True]


def test_update_trigger_is_silent_under_udis(fast_chip: Bench) -> None:
    """18.3.2: with UDIS no update event occurs, so none is sent as a trigger."""
    fast_chip.write(TIM2 + ARR, 99)
    fast_chip.write(TIM2 + CR2, MMS_UPDATE)
    fast_chip.write(TIM2 + EGR, UG)
    slave(fast_chip, TIM3, TRIGGER, 1)
    fast_chip.write(TIM2 + CR1, CEN | UDIS)
    assert triggers(fast_chip, TIM3, 100 * TICK2, 3) == [False, False, False]


def test_compare_pulse_comes_although_the_flag_is_still_set(fast_chip: Bench) -> None:
    """18.4.2 MMS = 011: a positive pulse when CC1IF is to be set, even if it was already high."""
    fast_chip.write(TIM2 + ARR, 99)
    fast_chip.write(TIM2 + CCR1, 30)
    fast_chip.write(TIM2 + CR2, MMS_PULSE)
    slave(fast_chip, TIM3, TRIGGER, 1)
    fast_chip.write(TIM2 + CR1, CEN)
    assert triggers(fast_chip, TIM3, 100 * TICK2, 3) == [True, True, True]
    assert fast_chip.read(TIM2 + SR) & CC1IF


def test_oc1ref_as_trigger_rises_at_the_compare_of_pwm_2(fast_chip: Bench) -> None:
    """18.4.2 MMS = 100: OC1REF is the trigger; PWM mode 2 is inactive while CNT < CCR1 (18.4.7), so it rises there."""
    fast_chip.write(TIM2 + ARR, 999)
    fast_chip.write(TIM2 + CCR1, 400)
    fast_chip.write(TIM2 + CCMR1, PWM2)
    fast_chip.write(TIM2 + EGR, UG)
    fast_chip.write(TIM2 + CR2, MMS_OC1)
    slave(fast_chip, TIM3, TRIGGER, 1)
    fast_chip.write(TIM2 + CR1, CEN)
    fast_chip.run(900 * TICK2)
    assert fast_chip.read(TIM2 + CNT) - fast_chip.read(TIM3 + CNT) == pytest.approx(402, abs=3)


def test_reset_mode_holds_two_counters_in_step(fast_chip: Bench) -> None:
    """18.3.14, 18.3.15: a slave of the same clock that each update of its master resets stays a constant behind it."""
    fast_chip.write(TIM2 + ARR, 499)
    fast_chip.write(TIM2 + CR2, MMS_UPDATE)
    slave(fast_chip, TIM3, RESET_MODE, 1)
    fast_chip.write(TIM3 + CR1, CEN)
    fast_chip.write(TIM2 + CR1, CEN)
    fast_chip.run(777 * TICK2)
    behind = fast_chip.read(TIM2 + CNT) - fast_chip.read(TIM3 + CNT)
    assert 0 <= behind <= 3
    for _ in range(5):
        fast_chip.run(700 * TICK2)
        assert fast_chip.read(TIM2 + CNT) - fast_chip.read(TIM3 + CNT) in (behind, behind - 500)


def test_a_trigger_by_software_sets_tif(fast_chip: Bench) -> None:
    """18.4.6 TG: TIF is set in SR."""
    fast_chip.write(TIM3 + EGR, TG)
    assert flags(fast_chip, TIM3) & TIF


# ---- Capture ----


def test_a_second_capture_without_reading_is_an_overcapture(fast_chip: Bench) -> None:
    """18.3.5: CC1IF at a capture, cleared by reading CCR1; another capture while it is set sets CC1OF."""
    fast_chip.alternate("A", PA6, 2)
    set_pin(fast_chip, PA6, False)
    fast_chip.write(TIM3 + CCMR1, 1)
    fast_chip.write(TIM3 + CCER, 1)
    fast_chip.write(TIM3 + CR1, CEN)
    fast_chip.run(100 * TICK2)
    set_pin(fast_chip, PA6, True)
    fast_chip.run(20 * TICK2)
    assert fast_chip.read(TIM3 + SR) & (CC1IF | CC1OF) == CC1IF
    assert 99 <= fast_chip.read(TIM3 + CCR1) <= 106
    assert not fast_chip.read(TIM3 + SR) & CC1IF
    for _ in range(2):
        set_pin(fast_chip, PA6, False)
        fast_chip.run(20 * TICK2)
        set_pin(fast_chip, PA6, True)
        fast_chip.run(20 * TICK2)
    assert fast_chip.read(TIM3 + SR) & (CC1IF | CC1OF) == CC1IF | CC1OF


def test_a_capture_by_its_own_edge_divider_and_the_other_pin(fast_chip: Bench) -> None:
    """18.4.7, 18.4.9: CC1S = 10 maps IC1 on TI2; CC1P takes falling edges; IC1PSC = 01 captures each second one."""
    fast_chip.alternate("A", PA7, 2)
    set_pin(fast_chip, PA7, False)
    fast_chip.write(TIM3 + CCMR1, 1 << 2 | 2)
    fast_chip.write(TIM3 + CCER, 2 | 1)
    fast_chip.write(TIM3 + CR1, CEN)
    seen = []
    for _ in range(4):
        set_pin(fast_chip, PA7, True)
        fast_chip.run(20 * TICK2)
        assert not flags(fast_chip, TIM3) & CC1IF
        set_pin(fast_chip, PA7, False)
        fast_chip.run(20 * TICK2)
        seen.append(bool(flags(fast_chip, TIM3) & CC1IF))
    assert seen in ([False, True, False, True], [True, False, True, False])


@pytest.mark.parametrize(("source", "edges_per_pulse"), [(4, 2), (5, 1)])
def test_the_pin_as_trigger_by_one_or_both_edges(fast_chip: Bench, source: int, edges_per_pulse: int) -> None:
    """18.4.3 TS: 100 is TI1F_ED, a pulse for each transition of TI1; 101 is TI1FP1, here its rising edge."""
    fast_chip.alternate("A", PA6, 2)
    set_pin(fast_chip, PA6, False)
    fast_chip.write(TIM3 + CCMR1, 1)
    slave(fast_chip, TIM3, RESET_MODE, source)
    fast_chip.write(TIM3 + CR1, CEN)
    fast_chip.run(50 * TICK2)
    flags(fast_chip, TIM3)
    total = 0
    for level in (True, False):
        set_pin(fast_chip, PA6, level)
        fast_chip.run(50 * TICK2)
        total += bool(flags(fast_chip, TIM3) & TIF)
    assert total == edges_per_pulse


@pytest.mark.parametrize("capture", [0, 1])
def test_a_compare_or_capture_by_software(fast_chip: Bench, capture: int) -> None:
    """18.4.6 CC1G: CC1IF is set; as an input the counter is captured in CCR1."""
    fast_chip.write(TIM3 + CCMR1, capture)
    fast_chip.write(TIM3 + CNT, 777)
    fast_chip.write(TIM3 + EGR, 2)
    fast_chip.run(5 * TICK2)
    assert fast_chip.read(TIM3 + SR) & CC1IF
    assert fast_chip.read(TIM3 + CCR1) == (777 if capture else 0)

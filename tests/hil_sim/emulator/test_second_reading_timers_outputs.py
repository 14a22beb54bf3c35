"""A second reading of the timers: outputs, dead time, break, lock (see ``second_reading_bench``).

Sections are those of RM0090: 17 advanced-control timers, 18 TIM2 to TIM5.
"""

from itertools import pairwise

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench
from tests.hil_sim.emulator.second_reading_bench import (
    DMA2,
    EN,
    HALF_WORD,
    MEMORY_HALF,
    MINC,
    SRAM,
    TO_PERIPHERAL,
    start_stream,
)
from tests.hil_sim.emulator.second_reading_timers import (
    ARPE,
    BG,
    CCR2,
    CEN,
    COMG,
    OPM,
    UG,
    UIF,
    bridge,
    flags,
)
from tests.hil_sim.emulator.timer_bench import (
    AOE,
    ARR,
    BDTR,
    BIF,
    BKE,
    CCER,
    CCMR1,
    CCR1,
    CR1,
    CR2,
    DCR,
    DIER,
    DMAR,
    EGR,
    MOE,
    OSSI,
    OSSR,
    PA8,
    PB12,
    PB13,
    PSC,
    RCR,
    SR,
    TICK,
    TIM1,
    TIM6,
    drives,
    edges,
    level,
    set_pin,
)

# ---- Preload and update events ----


def test_one_pulse_mode_with_repetition_makes_rcr_plus_one_pulses(fast_chip: Bench) -> None:
    """17.3.3 with 17.4.1 OPM: the counter stops at the update event, which is the last of RCR + 1 overflows."""
    bridge(fast_chip, MOE, duty=500)
    fast_chip.write(TIM1 + CR1, 0)
    fast_chip.write(TIM1 + RCR, 3)
    fast_chip.write(TIM1 + EGR, UG)
    before = len(edges(fast_chip, PA8))
    fast_chip.write(TIM1 + CR1, CEN | OPM)
    fast_chip.run(9000 * TICK)
    assert not fast_chip.read(TIM1 + CR1) & CEN
    assert sum(not high for high, _ in edges(fast_chip, PA8)[before:]) == 4


@pytest.mark.parametrize(
    ("code", "ticks"),
    [(0x50, 0x50), (0x80 | 10, (64 + 10) * 2), (0xC0 | 5, (32 + 5) * 8), (0xE0 | 3, (32 + 3) * 16)],
)
def test_dead_time_by_its_code(fast_chip: Bench, code: int, ticks: int) -> None:
    """17.4.18 DTG: DTG x t; (64 + DTG[5:0]) x 2 t; (32 + DTG[4:0]) x 8 t; (32 + DTG[4:0]) x 16 t. Both edges wait."""
    bridge(fast_chip, MOE | code, duty=1200)
    fast_chip.write(TIM1 + ARR, 2399)
    fast_chip.run(3 * 2400 * TICK)
    main, other = edges(fast_chip, PA8), edges(fast_chip, PB13)
    falls = [time for high, time in main if not high]
    rises = [time for high, time in other if high]
    gaps = [min(rise - fall for rise in rises if rise > fall) for fall in falls if fall < max(rises)]
    assert gaps[-1] == pytest.approx(ticks * TICK, abs=2.5 * TICK)
    falls = [time for high, time in other if not high]
    rises = [time for high, time in main if high]
    gaps = [min(rise - fall for rise in rises if rise > fall) for fall in falls if fall < max(rises)]
    assert gaps[-1] == pytest.approx(ticks * TICK, abs=2.5 * TICK)


def test_pwm_at_its_limits(fast_chip: Bench) -> None:
    """18.3.9: CCR > ARR holds OCREF at 1, CCR = 0 at 0; between it is active CCR ticks of ARR + 1."""
    bridge(fast_chip, MOE, duty=250)
    fast_chip.run(3500 * TICK)
    shown = edges(fast_chip, PA8)
    rise = [time for high, time in shown if high]
    fall = [time for high, time in shown if not high]
    assert rise[-1] - rise[-2] == pytest.approx(1000 * TICK, rel=1e-6)
    assert (fall[-1] - rise[-1]) % (1000 * TICK) == pytest.approx(250 * TICK, rel=1e-4)
    for duty, expected in ((1000, 1), (0, 0)):
        fast_chip.write(TIM1 + CCR1, duty)
        fast_chip.run(1100 * TICK)
        before = len(edges(fast_chip, PA8))
        fast_chip.run(3000 * TICK)
        assert len(edges(fast_chip, PA8)) == before
        assert fast_chip.read(0x40020010) >> PA8 & 1 == expected


def test_break_clears_moe_and_aoe_sets_it_at_the_next_update(fast_chip: Bench) -> None:
    """17.3.12: a break clears MOE and sets BIF; with AOE MOE is set again at the next update event, else it stays."""
    for aoe in (0, AOE):
        bridge(fast_chip, MOE | BKE | OSSI | aoe)
        fast_chip.run(1500 * TICK)
        set_pin(fast_chip, PB12, False)
        fast_chip.run(10 * TICK)
        assert not fast_chip.read(TIM1 + BDTR) & MOE
        assert fast_chip.read(TIM1 + SR) & BIF
        set_pin(fast_chip, PB12, True)
        fast_chip.run(10 * TICK)
        fast_chip.write(TIM1 + SR, 0)
        assert not fast_chip.read(TIM1 + BDTR) & MOE
        fast_chip.run(1100 * TICK)
        assert bool(fast_chip.read(TIM1 + BDTR) & MOE) == bool(aoe)


def test_an_active_break_holds_moe_and_its_flag(fast_chip: Bench) -> None:
    """17.3.12: while the break input is active MOE cannot be set and BIF cannot be cleared."""
    bridge(fast_chip, MOE | BKE | OSSI)
    set_pin(fast_chip, PB12, False)
    fast_chip.run(10 * TICK)
    fast_chip.write(TIM1 + SR, 0)
    fast_chip.run(10 * TICK)
    assert fast_chip.read(TIM1 + SR) & BIF
    fast_chip.change(TIM1 + BDTR, MOE)
    fast_chip.run(10 * TICK)
    assert not fast_chip.read(TIM1 + BDTR) & MOE


def test_idle_states_hold_while_moe_is_off(fast_chip: Bench) -> None:
    """17.3.12, OSSI: after a break each output goes to its idle level, OIS1 and OIS1N, and is still driven."""
    bridge(fast_chip, MOE | BKE | OSSI)
    fast_chip.write(TIM1 + CR2, 1 << 9)
    fast_chip.run(1200 * TICK)
    set_pin(fast_chip, PB12, False)
    fast_chip.run(10 * TICK)
    before = len(edges(fast_chip, PA8)) + len(edges(fast_chip, PB13))
    fast_chip.run(3000 * TICK)
    assert len(edges(fast_chip, PA8)) + len(edges(fast_chip, PB13)) == before
    assert fast_chip.read(0x40020010) >> PA8 & 1 == 0
    assert fast_chip.read(0x40020410) >> 13 & 1 == 1


def shares(chip: Bench, pin: int, periods: int = 4) -> float:
    """Part of a period of 1000 ticks that a pin is high, from the edges of some periods."""
    start, before = chip.now, level(chip, pin)
    known = len(edges(chip, pin))
    chip.run(periods * 1000 * TICK)
    high, at = 0.0, float(start)
    for now_high, time in edges(chip, pin)[known:]:
        high += (time - at) * before
        before, at = int(now_high), time
    return (high + (chip.now - at) * before) / (periods * 1000 * TICK)


@pytest.mark.parametrize(
    ("enables", "main", "other"),
    [(1 | 4, 0.3, 0.7), (1, 0.3, None), (4, None, 0.3), (4 | 8, None, 0.7), (1 | 2 | 4 | 8, 0.7, 0.3)],
)
def test_a_complement_that_is_alone_is_not_inverted(
    fast_chip: Bench, enables: int, main: float | None, other: float | None
) -> None:
    """17.3.11, 17.4.9, table 96: OC1N alone is OC1REF XOR CC1NP, beside OC1 it is its complement.

    An output whose enable is off is not driven by the timer with OSSR = 0.
    """
    bridge(fast_chip, MOE, duty=300)
    fast_chip.write(TIM1 + CCER, 0)
    fast_chip.write(TIM1 + CCER, enables)
    fast_chip.run(2000 * TICK)
    for pin, share in ((PA8, main), (PB13, other)):
        if share is not None:
            assert shares(fast_chip, pin) == pytest.approx(share, abs=0.01)
        else:
            assert drives(fast_chip, pin) == "off"


@pytest.mark.parametrize(("ossr", "seen"), [(0, "off"), (OSSR, "low")])
def test_ossr_keeps_the_partner_of_an_enabled_output_inactive(fast_chip: Bench, ossr: int, seen: str) -> None:
    """17.4.18 OSSR: with it an output of a pair whose other half is enabled is driven with its inactive level."""
    bridge(fast_chip, MOE | ossr, duty=300)
    fast_chip.write(TIM1 + CCER, 4)
    fast_chip.run(2000 * TICK)
    assert drives(fast_chip, PA8) == seen


@pytest.mark.parametrize(("ossi", "seen"), [(0, "off"), (OSSI, "low")])
def test_ossi_drives_the_outputs_while_moe_is_off(fast_chip: Bench, ossi: int, seen: str) -> None:
    """17.4.18 OSSI: without MOE outputs whose enable is set are driven with their idle level, or not at all."""
    bridge(fast_chip, ossi, duty=300)
    fast_chip.run(2000 * TICK)
    assert drives(fast_chip, PA8) == seen
    assert drives(fast_chip, PB13) == seen


def test_toggle_mode_changes_at_each_match(fast_chip: Bench) -> None:
    """17.4.7 OC1M = 011: OC1REF toggles when CNT = CCR1, so the output has half the counter's frequency."""
    bridge(fast_chip, MOE)
    fast_chip.write(TIM1 + CCMR1, 3 << 4)
    fast_chip.run(2500 * TICK)
    before = len(edges(fast_chip, PA8))
    fast_chip.run(10_000 * TICK)
    shown = edges(fast_chip, PA8)[before:]
    assert len(shown) == 10
    assert all(b - a == pytest.approx(1000 * TICK, rel=1e-5) for (_, a), (_, b) in pairwise(shown))


def test_break_by_software(fast_chip: Bench) -> None:
    """17.4.6 BG: a break event is generated, MOE is cleared, BIF is set."""
    bridge(fast_chip, MOE | BKE | OSSI)
    fast_chip.run(100 * TICK)
    assert fast_chip.read(TIM1 + BDTR) & MOE
    fast_chip.write(TIM1 + EGR, BG)
    fast_chip.run(10 * TICK)
    assert not fast_chip.read(TIM1 + BDTR) & MOE
    assert fast_chip.read(TIM1 + SR) & BIF


def test_lock_level_1_protects_break_and_dead_time(fast_chip: Bench) -> None:
    """17.4.18 LOCK: level 1 protects DTG, BKE, BKP and AOE; LOCK itself can be written once after the reset."""
    bridge(fast_chip, BKE | 1 << 8 | 0x20)
    fast_chip.write(TIM1 + BDTR, MOE | 0x55)
    fast_chip.run(10 * TICK)
    value = fast_chip.read(TIM1 + BDTR)
    assert value & 0xFF == 0x20
    assert value & BKE
    assert value & 3 << 8 == 1 << 8
    assert value & MOE
    fast_chip.expect("LOCK")


def test_commutation_takes_over_preloaded_modes(fast_chip: Bench) -> None:
    """17.3.13, CCPC: with it OCxM, CCxE and CCxNE are preloaded, and take effect together at COM."""
    bridge(fast_chip, MOE, duty=500)
    fast_chip.write(TIM1 + CR2, 1)
    fast_chip.run(1500 * TICK)
    fast_chip.write(TIM1 + CCMR1, 4 << 4)
    before = len(edges(fast_chip, PA8))
    fast_chip.run(2000 * TICK)
    assert len(edges(fast_chip, PA8)) - before >= 3, "the PWM goes on until COM"
    fast_chip.write(TIM1 + EGR, COMG)
    fast_chip.run(10 * TICK)
    before = len(edges(fast_chip, PA8))
    fast_chip.run(2000 * TICK)
    assert len(edges(fast_chip, PA8)) == before


def test_dma_burst_writes_consecutive_registers_at_the_update(fast_chip: Bench) -> None:
    """17.4.19, 17.4.20: a write to DMAR goes to DBA + index; an update request then comes DBL + 1 times."""
    for n, value in enumerate((499, 0, 100, 200)):
        fast_chip.write(SRAM + 2 * n, value, 2)
    control = 6 << 25 | HALF_WORD | MEMORY_HALF | MINC | TO_PERIPHERAL
    start_stream(fast_chip, DMA2, 5, control, 4, TIM1 + DMAR)
    fast_chip.write(TIM1 + DCR, 3 << 8 | ARR // 4)
    fast_chip.write(TIM1 + ARR, 99)
    fast_chip.write(TIM1 + DIER, 1 << 8)
    fast_chip.write(TIM1 + CR1, CEN | ARPE)
    fast_chip.run(150 * TICK)
    assert [fast_chip.read(TIM1 + offset) for offset in (ARR, RCR, CCR1, CCR2)] == [499, 0, 100, 200]
    assert not fast_chip.read(DMA2 + 0x10 + 0x18 * 5) & EN


def test_basic_timer_sends_its_update_as_trigger_without_slave_registers(fast_chip: Bench) -> None:
    """20.4: TIM6 has CR1, CR2, DIER, SR, EGR, CNT, PSC and ARR only; its period is (PSC + 1) (ARR + 1) APB1 ticks."""
    fast_chip.write(TIM6 + PSC, 83)
    fast_chip.write(TIM6 + ARR, 9)
    fast_chip.write(TIM6 + EGR, UG)
    flags(fast_chip, TIM6)
    fast_chip.write(TIM6 + CR1, CEN)
    fast_chip.run(9.9 * MICROSECOND)
    assert not flags(fast_chip, TIM6) & UIF
    fast_chip.run(0.3 * MICROSECOND)
    assert flags(fast_chip, TIM6) & UIF

"""A second reading of the timers: update events (see ``second_reading_bench``).

Sections are those of RM0090: 17 advanced-control timers, 18 TIM2 to TIM5, 20 TIM6 and TIM7; AN4013 says the same in
fewer words.
"""

import pytest

from hil_sim.emulator.bench import MICROSECOND, Bench
from tests.hil_sim.emulator.second_reading_bench import (
    DMA2,
    EN,
    HALF_WORD,
    MEMORY_HALF,
    MINC,
    TO_PERIPHERAL,
    clear_stream_flags,
    start_stream,
)
from tests.hil_sim.emulator.second_reading_timers import (
    ARPE,
    CC1IF,
    CCR2,
    CEN,
    OPM,
    TICK2,
    UDIS,
    UG,
    UIF,
    URS,
    count,
    flags,
)
from tests.hil_sim.emulator.timer_bench import (
    ARR,
    CCMR1,
    CCR1,
    CNT,
    CR1,
    CR2,
    DIER,
    EGR,
    PRELOAD,
    PSC,
    RCR,
    TICK,
    TIM1,
    TIM3,
)

# ---- Preload and update events ----


def test_prescaler_is_buffered_until_the_next_update(fast_chip: Bench) -> None:
    """18.3.1: a new prescaler ratio is taken into account at the next update event."""
    fast_chip.write(TIM3 + ARR, 99)
    fast_chip.write(TIM3 + CR1, CEN)
    fast_chip.run(10.5 * TICK2)
    fast_chip.write(TIM3 + PSC, 3)
    start = fast_chip.read(TIM3 + CNT)
    assert count(fast_chip, TIM3, 20) - start == 20
    fast_chip.run((100 - 20 - start) * TICK2)
    first = fast_chip.read(TIM3 + CNT)
    assert count(fast_chip, TIM3, 40) - first == 10


def test_auto_reload_is_immediate_without_arpe_and_buffered_with_it(fast_chip: Bench) -> None:
    """18.3.1, 18.4.1 ARPE: the preload of ARR goes to the shadow register permanently, or at each update event."""
    for arpe, wraps_at_once in ((0, True), (ARPE, False)):
        fast_chip.write(TIM3 + CR1, 0)
        fast_chip.write(TIM3 + ARR, 999)
        fast_chip.write(TIM3 + EGR, UG)
        flags(fast_chip, TIM3)
        fast_chip.write(TIM3 + CR1, CEN | arpe)
        fast_chip.run(100 * TICK2)
        fast_chip.write(TIM3 + ARR, 199)
        fast_chip.run(200 * TICK2)
        assert bool(flags(fast_chip, TIM3) & UIF) == wraps_at_once
        fast_chip.run(800 * TICK2)
        flags(fast_chip, TIM3)
        fast_chip.run(250 * TICK2)
        assert flags(fast_chip, TIM3) & UIF, "the new value holds after an update"


def test_compare_is_buffered_with_its_preload(fast_chip: Bench) -> None:
    """18.3.8, OCxPE: the preload register is transferred at the next update event, else at once."""
    for preload, at_once in ((0, True), (PRELOAD, False)):
        fast_chip.write(TIM3 + CR1, 0)
        fast_chip.write(TIM3 + ARR, 499)
        fast_chip.write(TIM3 + CCMR1, preload)
        fast_chip.write(TIM3 + CCR1, 400)
        fast_chip.write(TIM3 + EGR, UG)
        fast_chip.write(TIM3 + CR1, CEN)
        fast_chip.run(50 * TICK2)
        fast_chip.write(TIM3 + CCR1, 100)
        flags(fast_chip, TIM3)
        fast_chip.run(100 * TICK2)
        assert bool(flags(fast_chip, TIM3) & CC1IF) == at_once
        fast_chip.run(370 * TICK2)
        flags(fast_chip, TIM3)
        fast_chip.run(100 * TICK2)
        assert flags(fast_chip, TIM3) & CC1IF


def test_urs_hides_ug_but_not_the_overflow(fast_chip: Bench) -> None:
    """18.3.2, 18.4.1 URS: with it UG makes an update event without UIF; an overflow still sets UIF."""
    fast_chip.write(TIM3 + ARR, 99)
    fast_chip.write(TIM3 + EGR, UG)
    assert flags(fast_chip, TIM3) & UIF
    fast_chip.write(TIM3 + CR1, URS)
    fast_chip.write(TIM3 + PSC, 1)
    fast_chip.write(TIM3 + EGR, UG)
    assert not flags(fast_chip, TIM3) & UIF
    fast_chip.write(TIM3 + CR1, URS | CEN)
    assert count(fast_chip, TIM3, 50.5) in (24, 25), "the event itself took place: the prescaler was loaded"
    fast_chip.run(160 * TICK2)
    assert flags(fast_chip, TIM3) & UIF


def test_udis_stops_events_not_the_counter(fast_chip: Bench) -> None:
    """18.3.2: with UDIS no update event occurs, shadow registers keep their value, yet the counter restarts from 0."""
    fast_chip.write(TIM3 + ARR, 99)
    fast_chip.write(TIM3 + EGR, UG)
    flags(fast_chip, TIM3)
    fast_chip.write(TIM3 + CR1, CEN | UDIS)
    fast_chip.write(TIM3 + PSC, 7)
    assert count(fast_chip, TIM3, 250.5) in (49, 50)
    assert not flags(fast_chip, TIM3) & UIF


def test_ug_under_udis_restarts_the_counter_alone(fast_chip: Bench) -> None:
    """18.4.1 UDIS: the counter and the prescaler are reinitialized if UG is set, the buffers keep their value."""
    fast_chip.write(TIM3 + CR1, CEN | UDIS)
    fast_chip.write(TIM3 + PSC, 7)
    fast_chip.run(50 * TICK2)
    fast_chip.write(TIM3 + EGR, UG)
    assert count(fast_chip, TIM3, 20) in (19, 20)
    assert not flags(fast_chip, TIM3) & UIF


def test_one_pulse_mode_stops_at_the_update(fast_chip: Bench) -> None:
    """18.3.10, OPM: the counter stops at the next update event, CEN is cleared; the counter is then at 0."""
    fast_chip.write(TIM3 + ARR, 99)
    fast_chip.write(TIM3 + CR1, CEN | OPM)
    fast_chip.run(300 * TICK2)
    assert not fast_chip.read(TIM3 + CR1) & CEN
    assert fast_chip.read(TIM3 + CNT) == 0
    assert flags(fast_chip, TIM3) & UIF


def test_repetition_counter_counts_overflows_and_is_reloaded_by_ug(fast_chip: Bench) -> None:
    """17.3.3: an update after RCR + 1 overflows; UG updates at once and reloads the repetition counter."""
    fast_chip.write(TIM1 + ARR, 99)
    fast_chip.write(TIM1 + RCR, 2)
    fast_chip.write(TIM1 + EGR, UG)
    flags(fast_chip, TIM1)
    fast_chip.write(TIM1 + CR1, CEN)
    fast_chip.run(250 * TICK)
    assert not flags(fast_chip, TIM1) & UIF
    fast_chip.write(TIM1 + EGR, UG)
    assert flags(fast_chip, TIM1) & UIF
    fast_chip.run(250 * TICK)
    assert not flags(fast_chip, TIM1) & UIF
    fast_chip.run(60 * TICK)
    assert flags(fast_chip, TIM1) & UIF


def test_a_new_repetition_rate_waits_for_the_next_update(fast_chip: Bench) -> None:
    """17.4.13 RCR: a write is taken into account at the next repetition update event."""
    fast_chip.write(TIM1 + ARR, 99)
    fast_chip.write(TIM1 + RCR, 3)
    fast_chip.write(TIM1 + EGR, UG)
    flags(fast_chip, TIM1)
    fast_chip.write(TIM1 + CR1, CEN)
    fast_chip.run(50 * TICK)
    fast_chip.write(TIM1 + RCR, 0)
    fast_chip.run(320 * TICK)
    assert not flags(fast_chip, TIM1) & UIF
    fast_chip.run(40 * TICK)
    assert flags(fast_chip, TIM1) & UIF
    fast_chip.run(100 * TICK)
    assert flags(fast_chip, TIM1) & UIF


def test_urs_also_keeps_the_dma_request_of_ug_back(fast_chip: Bench) -> None:
    """18.4.1 URS: with it only an overflow makes an update interrupt or DMA request; without it UG makes one too."""
    for urs, left in ((URS, 4), (0, 3)):
        start_stream(fast_chip, DMA2, 5, 6 << 25 | HALF_WORD | MEMORY_HALF | MINC | TO_PERIPHERAL, 4, TIM1 + CCR1)
        fast_chip.write(TIM1 + CR1, urs)
        fast_chip.write(TIM1 + DIER, 1 << 8)
        fast_chip.write(TIM1 + EGR, UG)
        fast_chip.run(MICROSECOND)
        assert fast_chip.read(DMA2 + 0x10 + 0x18 * 5 + 4) == left
        fast_chip.write(TIM1 + DIER, 0)
        fast_chip.change(DMA2 + 0x10 + 0x18 * 5, 0, EN)
        fast_chip.run(MICROSECOND)
        clear_stream_flags(fast_chip, DMA2, 5)


@pytest.mark.parametrize(("ccds", "left"), [(0, 2), (8, 3)])
def test_ccds_moves_the_compare_request_to_the_update(fast_chip: Bench, ccds: int, left: int) -> None:
    """17.4.2 CCDS: the CCx DMA request is sent at the CCx event (0) or at the update event (1)."""
    start_stream(fast_chip, DMA2, 1, 6 << 25 | HALF_WORD | MEMORY_HALF | MINC | TO_PERIPHERAL, 4, TIM1 + CCR2)
    fast_chip.write(TIM1 + ARR, 999)
    fast_chip.write(TIM1 + CCR1, 300)
    fast_chip.write(TIM1 + CR2, ccds)
    fast_chip.write(TIM1 + DIER, 1 << 9)
    fast_chip.write(TIM1 + CR1, CEN)
    fast_chip.run(1600 * TICK)
    assert fast_chip.read(DMA2 + 0x10 + 0x18 + 4) == left

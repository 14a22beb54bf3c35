"""What the tests of the second reading of the timers share."""

from hil_sim.emulator.bench import Bench
from tests.hil_sim.emulator.timer_bench import (
    ARR,
    BDTR,
    CCER,
    CCMR1,
    CCR1,
    CNT,
    CR1,
    EGR,
    PA8,
    PB12,
    PRELOAD,
    PWM1,
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

CEN, UDIS, URS, OPM, ARPE = 1, 2, 4, 8, 0x80
UG, COMG, TG, BG = 1, 0x20, 0x40, 0x80
UIF, CC1IF, TIF, CC1OF = 1, 2, 0x40, 0x200
CCR2 = CCR1 + 4
MMS_ENABLE, MMS_UPDATE, MMS_PULSE, MMS_OC1 = (n << 4 for n in range(1, 5))
RESET_MODE, TRIGGER = 4, 6
NAMES = {TIM1: "TIM1", TIM2: "TIM2", TIM3: "TIM3", TIM4: "TIM4", TIM5: "TIM5", TIM8: "TIM8"}
TICK2 = 2 * TICK


def slave(chip: Bench, timer: int, mode: int, itr: int) -> None:
    """Slave mode on one of ITR0 to ITR3; the source is chosen while the mode is off."""
    chip.write(timer + SMCR, itr << 4)
    chip.write(timer + SMCR, itr << 4 | mode)


def pulse(chip: Bench, master: int) -> None:
    """Set UG of a master whose MMS is 000: one pulse of its TRGO."""
    chip.write(master + EGR, UG)
    chip.run(20 * TICK)


def flags(chip: Bench, timer: int) -> int:
    """Read and clear the status flags of a timer."""
    value = chip.read(timer + SR)
    chip.write(timer + SR, 0)
    return value


def count(chip: Bench, timer: int, ticks: float) -> int:
    """Let some ticks of APB1's timers pass and read the counter."""
    chip.run(ticks * TICK2)
    return chip.read(timer + CNT)


def bridge(chip: Bench, bdtr: int, duty: int = 500) -> None:
    """TIM1 CH1 on PA8 and CH1N on PB13, a PWM of 1000 ticks, its break input PB12 high."""
    chip.alternate("A", PA8, 1)
    chip.alternate("B", 13, 1)
    chip.alternate("B", 12, 1)
    set_pin(chip, PB12, True)
    chip.write(TIM1 + ARR, 999)
    chip.write(TIM1 + CCR1, duty)
    chip.write(TIM1 + CCMR1, PWM1 | PRELOAD)
    chip.write(TIM1 + EGR, UG)
    chip.write(TIM1 + CCER, 1 | 4)
    chip.write(TIM1 + BDTR, bdtr)
    chip.write(TIM1 + CR1, CEN | ARPE)

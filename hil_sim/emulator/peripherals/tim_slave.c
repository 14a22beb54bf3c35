/* tim_slave.c: TRGO: timers that trigger converters and one another. A trigger acts at once: on silicon a slave's
 * counter follows a tick or two later. */
#include "emulator/peripherals/tim.h"

void tim_trgo(tim_t *t, bool rising, bool pulse, int64_t time_ps) {
    chip_t *const chip = t->model.chip;
    if (t->what->trgo == TRIGGER_NONE) {
        return;
    }
    if (chip->trigger_heard[t->what->trgo]) {
        chip->signals.convert(chip, t->what->trgo, rising, time_ps);
        if (pulse) {
            chip->signals.convert(chip, t->what->trgo, !rising, time_ps);
        }
    }
    if (rising) {
        chip->signals.output(chip, t->what->trgo, time_ps);
        for (unsigned i = 0; t->slaves >> i != 0; i++) {
            if ((t->slaves >> i & 1u) != 0) {
                tim_slave_trigger(chip->tim[i], time_ps);
            }
        }
    }
}

bool tim_trgo_heard(const tim_t *t) {
    const chip_t *const chip = t->model.chip;
    return t->what->trgo != TRIGGER_NONE &&
           (t->slaves != 0 || chip->trigger_heard[t->what->trgo] || chip->trigger_wanted[t->what->trgo]);
}

/* Timer number that t's trigger input is connected to; 0: none. */
static unsigned master_of(const tim_t *t) {
    const uint32_t smcr = t->model.value[TIM_SMCR / 4];
    return (smcr & 7u) != 0 && field(smcr, 4, 3) < 4 ? t->what->master[field(smcr, 4, 3)] : 0;
}

void tim_connect_slaves(chip_t *chip) {
    for (unsigned i = 0; i < TIM_COUNT; i++) {
        chip->tim[i]->slaves = 0;
    }
    for (unsigned i = 0; i < TIM_COUNT; i++) {
        const unsigned master = master_of(chip->tim[i]);
        if (master != 0) {
            chip->tim[master - 1]->slaves |= (uint16_t)(1u << i);
        }
    }
}

void tim_slave_trigger(tim_t *t, int64_t time_ps) {
    const int64_t tick = clock_tick(t->clock, time_ps);
    tim_advance(t, tick);
    t->model.value[TIM_SR / 4] |= TIF;
    switch (field(t->model.value[TIM_SMCR / 4], 0, 3)) {
    case 4:
        tim_restart_counter(t, tick);
        break;
    case 6:
        if (!t->running) {
            t->model.value[TIM_CR1 / 4] |= CEN;
            tim_start(t, tick);
        }
        break;
    default:
        break;
    }
    if (t->what->advanced && (t->model.value[TIM_CR2 / 4] & CCUS) != 0) {
        tim_commutate(t);
    }
    tim_interrupt(t);
    tim_pulse_dma(t, 14, t->what->dma_trigger);
    tim_plan(t);
}

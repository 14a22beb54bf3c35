/* tim_break.c: main output enable, break, and the bits that LOCK protects (RM0090 17.3.12, 17.4.18).
 *
 * A break takes MOE down at once, without a clock. It comes from the level of the BKIN pin, from the clock security
 * system, both only with BKE, or from EGR's BG. While the input is active MOE stays off whatever is written, and BIF
 * cannot be cleared; software that sets MOE has to read it back.
 */
#include "emulator/peripherals/tim.h"

#define LOCK        0x0300u
#define IDLE_LEVELS 0x7F00u /* TIM_CR2 */

static unsigned lock_level(const tim_t *t) {
    return field(t->model.value[TIM_BDTR / 4], 8, 2);
}

/* ---- Break ---- */

/* Whether a pin is a break input of the timer; active: whether one is at the level that BKP selects. */
static bool break_pins(const tim_t *t, bool *active) {
    const bool selected = (t->model.value[TIM_BDTR / 4] & BKP) != 0;
    bool any = false;
    *active = false;
    for (unsigned i = 0; i < tim_pin_count; i++) {
        const tim_pin_t *const p = &tim_pins[i];
        if (p->role == TIM_PIN_BREAK && p->timer == tim_number(t) &&
            chip_pin_is_alternate(t->model.chip, p->pin, p->alternate)) {
            any = true;
            *active = *active || chip_pin_level(t->model.chip, p->pin) == selected;
        }
    }
    return any;
}

void tim_break(tim_t *t, int64_t time_ps) {
    tim_advance(t, clock_tick(t->clock, time_ps)); /* What came before happened with the outputs on. */
    t->model.value[TIM_SR / 4] |= BIF;
    if (tim_outputs_on(t)) {
        t->model.value[TIM_BDTR / 4] &= ~MOE;
        t->broken = true;
        tim_outputs_idle(t, time_ps);
    }
    tim_interrupt(t);
    tim_plan(t);
}

void tim_break_input(tim_t *t, int64_t time_ps) {
    bool active = false;
    break_pins(t, &active);
    t->breaking = active && (t->model.value[TIM_BDTR / 4] & BKE) != 0;
    if (t->breaking) {
        tim_break(t, time_ps);
    }
}

void tim_clock_failed(tim_t *t) {
    if (t->model.clocked && !t->model.in_reset && (t->model.value[TIM_BDTR / 4] & BKE) != 0) {
        tim_break(t, machine_now(t->model.machine));
    }
}

/* ---- Main output enable ---- */

static void refresh(tim_t *t, int64_t time_ps) {
    t->broken = t->broken && !tim_outputs_on(t);
    for (unsigned i = 0; i < t->what->channels; i++) {
        tim_refresh_output(t, i, time_ps);
    }
}

void tim_update_enables(tim_t *t, int64_t time_ps) {
    if (t->what->advanced && (t->model.value[TIM_BDTR / 4] & (AOE | MOE)) == AOE && !t->breaking) {
        t->model.value[TIM_BDTR / 4] |= MOE;
        refresh(t, time_ps);
    }
}

/* RM0090, note to the table of output control bits: what belongs to outputs that are not used must be clear. */
static void check_unused(const tim_t *t) {
    for (unsigned i = 0; i < t->what->channels; i++) {
        const unsigned enable = tim_enable_bits(t, i),
                       idle = field(t->model.value[TIM_CR2 / 4], 8 + 2 * i, i < 3 ? 2 : 1);
        if (!tim_is_capture(t, i) && (enable & 5u) == 0 && ((enable & 0xAu) != 0 || idle != 0)) {
            machine_violation(t->model.machine,
                              "%s_BDTR: MOE set while channel %u has neither CCxE nor CCxNE, but a polarity or idle "
                              "level",
                              model_name(&t->model), i + 1);
        }
    }
}

void tim_write_bdtr(tim_t *t, uint32_t value, int64_t time_ps) {
    const uint32_t old = t->model.value[TIM_BDTR / 4];
    value = tim_unlocked(t, TIM_BDTR, value);
    t->bdtr_written = true;
    t->model.value[TIM_BDTR / 4] = (value & ~MOE) | (old & MOE);
    bool active = false;
    if (!break_pins(t, &active) && (value & ~old & BKE) != 0) {
        machine_violation(t->model.machine,
                          "%s_BDTR: BKE is set, but no pin has the alternate function BKIN, so the input's level is "
                          "undefined",
                          model_name(&t->model));
    }
    tim_break_input(t, time_ps);
    value &= t->breaking ? ~MOE : ~0u;
    const bool falls = tim_outputs_on(t) && (value & MOE) == 0;
    t->model.value[TIM_BDTR / 4] = value;
    if ((value & ~old & MOE) != 0) {
        check_unused(t);
    }
    if (falls) {
        tim_outputs_idle(t, time_ps);
    } else {
        refresh(t, time_ps);
    }
}

/* ---- Locked bits ---- */

/* The bits of a register that the present LOCK level protects. */
static uint32_t locked_bits(const tim_t *t, uint32_t offset) {
    const unsigned level = lock_level(t);
    uint32_t bits = 0;
    if (offset == TIM_BDTR) {
        bits = (level >= 1 ? 0xFFu | BKE | BKP | AOE : 0) | (level >= 2 ? OSSI | OSSR : 0);
    } else if (offset == TIM_CR2 && level >= 1) {
        bits = IDLE_LEVELS;
    }
    for (unsigned i = 0; i < 4; i++) {
        if (tim_is_capture(t, i)) {
            continue;
        }
        if (offset == TIM_CCER && level >= 2) {
            bits |= 0xAu << 4 * i; /* CCxP, CCxNP */
        } else if ((offset == TIM_CCMR1 || offset == TIM_CCMR2) && level == 3 && i / 2 == (offset - TIM_CCMR1) / 4) {
            bits |= 0x78u << 8 * (i % 2); /* OCxM, OCxPE */
        }
    }
    return bits;
}

uint32_t tim_unlocked(tim_t *t, uint32_t offset, uint32_t value) {
    static const struct {
        uint32_t offset;
        const char *name;
    } names[] = {{TIM_CR2, "CR2"}, {TIM_CCMR1, "CCMR1"}, {TIM_CCMR2, "CCMR2"}, {TIM_CCER, "CCER"}, {TIM_BDTR, "BDTR"}};
    const uint32_t old = t->model.value[offset / 4];
    uint32_t locked = t->what->advanced ? locked_bits(t, offset) : 0;
    if (offset == TIM_BDTR && t->bdtr_written && ((old ^ value) & LOCK) != 0) {
        machine_violation(t->model.machine,
                          "%s_BDTR: LOCK changed, but the first write of the register froze it until reset",
                          model_name(&t->model));
        value = (value & ~LOCK) | (old & LOCK);
    }
    for (unsigned i = 0; i < sizeof names / sizeof names[0] && ((old ^ value) & locked) != 0; i++) {
        if (names[i].offset == offset) {
            machine_violation(t->model.machine, "%s_%s: bits 0x%04X changed, which LOCK %u protects until reset",
                              model_name(&t->model), names[i].name, (unsigned)((old ^ value) & locked), lock_level(t));
        }
    }
    return (value & ~locked) | (old & locked);
}

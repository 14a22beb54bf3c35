/* tim_outputs.c: what the channels drive pins and converters' triggers with (RM0090 17.3.11, 17.3.12, table of the
 * output control bits for complementary channels with break feature).
 *
 * Both outputs of a channel follow OCxREF, each with its polarity, if only one of them is on; with both on OCxN is the
 * inverse, and the one that becomes active waits for the dead time. With MOE off and OSSI on they are inactive at once
 * and go to their idle levels OISx, OISxN after the dead time; with OSSI off they let go of the pins.
 */
#include "emulator/peripherals/tim.h"

/* Bits of CCxE, CCxNE and of the polarities in a channel's field of CCER. */
#define MAIN_ON       1u
#define COMPLEMENT_ON 4u
#define BOTH_ON       (MAIN_ON | COMPLEMENT_ON)

static int64_t dead_ticks(const tim_t *t) {
    const uint32_t dtg = t->model.value[TIM_BDTR / 4] & 0xFFu;
    const uint32_t steps = dtg < 0x80   ? dtg
                           : dtg < 0xC0 ? (64 + (dtg & 0x3Fu)) * 2
                           : dtg < 0xE0 ? (32 + (dtg & 0x1Fu)) * 8
                                        : (32 + (dtg & 0x1Fu)) * 16;
    return (int64_t)steps << field(t->model.value[TIM_CR1 / 4], 8, 2); /* CKD: steps of 1, 2 or 4 clocks. */
}

static bool idle_level(const tim_t *t, unsigned channel, unsigned side) {
    return (t->model.value[TIM_CR2 / 4] >> (8 + 2 * channel + side) & 1u) != 0;
}

/* Whether both idle levels are active: then the outputs stay inactive. */
static bool idle_clash(const tim_t *t, unsigned channel) {
    const unsigned enable = tim_enable_bits(t, channel);
    return channel < 3 && idle_level(t, channel, TIM_PIN_CHANNEL) != ((enable & 2u) != 0) &&
           idle_level(t, channel, TIM_PIN_COMPLEMENT) != ((enable & 8u) != 0);
}

static pin_output_t side_output(const tim_t *t, unsigned channel, unsigned side, int64_t time_ps) {
    const unsigned enable = tim_enable_bits(t, channel), mine = side == TIM_PIN_CHANNEL ? MAIN_ON : COMPLEMENT_ON;
    const bool inverted = (enable & (mine << 1)) != 0, on = (enable & mine) != 0;
    const uint32_t bdtr = t->model.value[TIM_BDTR / 4];
    const bool waits = time_ps < t->dead[channel].until_ps;
    bool level = inverted; /* Inactive. */
    if (tim_is_capture(t, channel) || (side == TIM_PIN_COMPLEMENT && (!t->what->advanced || channel == 3))) {
        return OUTPUT_OFF;
    }
    if (!t->what->advanced) {
        return !on ? OUTPUT_OFF : t->reference[channel] != inverted ? OUTPUT_HIGH : OUTPUT_LOW;
    }
    if ((enable & BOTH_ON) == 0 || (!tim_outputs_on(t) && (bdtr & OSSI) == 0)) {
        return OUTPUT_OFF;
    }
    if (!tim_outputs_on(t)) {
        level = waits || idle_clash(t, channel) ? inverted : idle_level(t, channel, side);
    } else if ((enable & BOTH_ON) == BOTH_ON) {
        level = (!waits && t->reference[channel] == (side == TIM_PIN_CHANNEL)) != inverted;
    } else if (on) {
        level = t->reference[channel] != inverted;
    } else if ((bdtr & OSSR) == 0) {
        return OUTPUT_OFF;
    }
    return level ? OUTPUT_HIGH : OUTPUT_LOW;
}

static void tell_pins(const tim_t *t, unsigned channel, unsigned side, int64_t time_ps) {
    for (unsigned i = 0; i < tim_pin_count; i++) {
        const tim_pin_t *const p = &tim_pins[i];
        if (p->timer == tim_number(t) && p->channel == channel && p->role == side &&
            chip_pin_is_alternate(t->model.chip, p->pin, p->alternate)) {
            chip_pin_driven(t->model.chip, p->pin, time_ps);
        }
    }
}

void tim_refresh_output(tim_t *t, unsigned channel, int64_t time_ps) {
    chip_t *const chip = t->model.chip;
    const bool was = t->output[channel][TIM_PIN_CHANNEL] == OUTPUT_HIGH;
    bool changed[2];
    for (unsigned side = 0; side < 2; side++) {
        const pin_output_t output = side_output(t, channel, side, time_ps);
        changed[side] = t->output[channel][side] != output;
        t->output[channel][side] = output;
    }
    const bool is = t->output[channel][TIM_PIN_CHANNEL] == OUTPUT_HIGH;
    if (was != is && t->what->first_channel_trigger != TRIGGER_NONE) {
        chip->signals.convert(chip, (trigger_t)(t->what->first_channel_trigger + channel), is, time_ps);
    }
    for (unsigned side = 0; side < 2; side++) {
        if (changed[side] && (t->wired[side] >> channel & 1u) != 0) {
            tell_pins(t, channel, side, time_ps);
        }
    }
}

/* Both outputs of the channel are inactive from now on, until the dead time is over. */
static void begin_dead_time(tim_t *t, unsigned channel, int64_t time_ps) {
    machine_t *const machine = t->model.machine;
    const int64_t ticks = dead_ticks(t),
                  until_ps = ticks == 0 ? time_ps : clock_time(t->clock, clock_tick(t->clock, time_ps) + ticks);
    t->dead[channel].until_ps = until_ps;
    tim_refresh_output(t, channel, time_ps);
    if (until_ps > machine_now(machine)) {
        machine_schedule(machine, &t->dead[channel].end, until_ps);
    } else {
        tim_refresh_output(t, channel, until_ps);
    }
}

static void dead_time_over(void *context, int64_t time_ps) {
    tim_t *const t = *(tim_t **)context; /* First member of the channel's dead time. */
    for (unsigned i = 0; i < 4; i++) {
        if ((void *)&t->dead[i] == context) {
            tim_refresh_output(t, i, time_ps);
        }
    }
}

void tim_reference_changed(tim_t *t, unsigned channel, int64_t time_ps) {
    if (t->what->advanced && tim_outputs_on(t) && (tim_enable_bits(t, channel) & BOTH_ON) == BOTH_ON) {
        begin_dead_time(t, channel, time_ps);
    } else {
        tim_refresh_output(t, channel, time_ps);
    }
}

void tim_outputs_idle(tim_t *t, int64_t time_ps) {
    for (unsigned i = 0; i < t->what->channels; i++) {
        if ((tim_enable_bits(t, i) & BOTH_ON) != 0 && idle_clash(t, i)) {
            machine_violation(t->model.machine,
                              "%s_CR2: OIS%u and OIS%uN would both be active without MOE; the outputs stay inactive",
                              model_name(&t->model), i + 1, i + 1);
        }
        begin_dead_time(t, i, time_ps);
    }
}

/* ---- Pins ---- */

pin_output_t tim_pin_output(const chip_t *chip, unsigned pin, unsigned af) {
    for (unsigned i = 0; i < tim_pin_count; i++) {
        const tim_pin_t *const p = &tim_pins[i];
        if (p->pin == pin && p->alternate == af) {
            return p->role == TIM_PIN_BREAK ? OUTPUT_OFF : chip->tim[p->timer - 1]->output[p->channel][p->role];
        }
    }
    return OUTPUT_UNSEEN;
}

void tim_pin_routing(chip_t *chip, bool done) {
    if (!done) {
        tim_before_change(chip);
        return;
    }
    const int64_t now = machine_now(chip->machine);
    for (unsigned i = 0; i < TIM_COUNT; i++) {
        chip->tim[i]->wired[TIM_PIN_CHANNEL] = chip->tim[i]->wired[TIM_PIN_COMPLEMENT] = 0;
    }
    for (unsigned i = 0; i < tim_pin_count; i++) {
        const tim_pin_t *const p = &tim_pins[i];
        if (p->role != TIM_PIN_BREAK && chip_pin_is_alternate(chip, p->pin, p->alternate)) {
            chip->tim[p->timer - 1]->wired[p->role] |= (uint8_t)(1u << p->channel);
        }
    }
    tim_break_input(chip->tim[0], now);
    tim_break_input(chip->tim[7], now);
    tim_after_change(chip);
}

void tim_outputs_init(tim_t *t) {
    for (unsigned i = 0; i < 4; i++) {
        t->dead[i].timer = t;
        t->dead[i].channel = i;
        machine_event_init(&t->dead[i].end, dead_time_over, &t->dead[i]);
    }
}

void tim_outputs_restart(tim_t *t) {
    t->breaking = t->broken = t->bdtr_written = false;
    for (unsigned i = 0; i < 4; i++) {
        t->dead[i].until_ps = 0;
        machine_cancel(t->model.machine, &t->dead[i].end);
        tim_refresh_output(t, i, machine_now(t->model.machine));
    }
}

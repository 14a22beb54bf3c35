/* tim_channels.c: compare (output references, what a match sets off) and capture (inputs, filters).
 *
 * A capture without filter has no synchroniser delay (two to
 * three ticks on silicon).
 */
#include "emulator/peripherals/tim.h"

/* ---- Compare ---- */

/* OCxREF, and what follows from it. */
static void set_reference(tim_t *t, unsigned channel, bool level, int64_t time_ps) {
    if (t->reference[channel] != level) {
        t->reference[channel] = level;
        tim_reference_changed(t, channel, time_ps);
        if (tim_master_mode(t) == 4 + channel) {
            tim_trgo(t, level, false, time_ps);
        }
    }
}

void tim_evaluate_reference(tim_t *t, unsigned channel, bool match, int64_t count, int64_t time_ps) {
    bool level = t->reference[channel];
    switch (tim_compare_mode(t, channel)) {
    case 1:
        level = match ? true : level;
        break;
    case 2:
        level = match ? false : level;
        break;
    case 3:
        level = match ? !level : level;
        break;
    case 4:
        level = false;
        break;
    case 5:
        level = true;
        break;
    case 6:
        level = count < t->compare[channel];
        break;
    case 7:
        level = count >= t->compare[channel];
        break;
    default:
        break;
    }
    set_reference(t, channel, level, time_ps);
}

bool tim_channel_heard(const tim_t *t, unsigned channel) {
    return t->what->first_channel_trigger != TRIGGER_NONE &&
           t->model.chip->trigger_heard[(unsigned)t->what->first_channel_trigger + channel];
}

void tim_compare_match(tim_t *t, unsigned channel, int64_t tick) {
    const int64_t time_ps = clock_time(t->clock, tick);
    t->model.value[TIM_SR / 4] |= 2u << channel;
    tim_evaluate_reference(t, channel, true, t->compare[channel], time_ps);
    if (channel == 0 && tim_master_mode(t) == 3) {
        tim_trgo(t, true, true, time_ps);
    }
    if (tim_channel_heard(t, channel) && !t->silent_trigger && !t->broken &&
        ((tim_enable_bits(t, channel) & 1u) == 0 || !tim_outputs_on(t) || tim_compare_mode(t, channel) == 0)) {
        t->silent_trigger = true;
        machine_violation(
            t->model.machine,
            "%s: a converter waits for CC%u, but OC%u never changes: it needs an OC%uM other than frozen, CC%uE%s",
            model_name(&t->model), channel + 1, channel + 1, channel + 1, channel + 1,
            t->what->advanced ? " and MOE" : "");
    }
    tim_interrupt(t);
    tim_channel_dma(t, channel);
}

/* ---- Capture ---- */

void tim_capture(tim_t *t, unsigned channel, int64_t time_ps) {
    static const uint8_t every[4] = {1, 2, 4, 8};
    if (++t->edges[channel] < every[field(tim_mode_bits(t, channel), 2, 2)]) {
        return;
    }
    t->edges[channel] = 0;
    const int64_t tick = clock_tick(t->clock, time_ps);
    tim_advance(t, tick);
    uint32_t *const sr = &t->model.value[TIM_SR / 4];
    t->model.value[TIM_CCR1 / 4 + channel] = (uint32_t)tim_position(t, tick);
    *sr |= (*sr & 2u << channel) ? 0x200u << channel : 0;
    *sr |= 2u << channel;
    tim_interrupt(t);
    tim_channel_dma(t, channel);
    tim_plan(t);
}

static bool edge_wanted(const tim_t *t, unsigned channel, bool level) {
    switch (tim_enable_bits(t, channel) & 0xAu) {
    case 0x0:
        return level;
    case 0x2:
        return !level;
    case 0xA:
        return true;
    default:
        machine_violation(t->model.machine, "%s_CCER: CC%uNP set with CC%uP clear is reserved for inputs",
                          model_name(&t->model), channel + 1, channel + 1);
        return false;
    }
}

/* The level of TIx after the filter changed. */
static void filtered_edge(tim_t *t, unsigned input, bool level, int64_t time_ps) {
    for (unsigned channel = 0; channel < t->what->channels; channel++) {
        const unsigned selection = tim_mode_bits(t, channel) & 3u;
        const bool mine = (selection == 1 && channel == input) || (selection == 2 && (channel ^ 1u) == input);
        if (mine && (tim_enable_bits(t, channel) & 1u) != 0 && edge_wanted(t, channel, level)) {
            tim_capture(t, channel, time_ps);
        }
    }
    const uint32_t smcr = t->model.value[TIM_SMCR / 4];
    const unsigned source = field(smcr, 4, 3);
    if ((smcr & 7u) != 0 && ((source == 4 && input == 0) || (source == 5 + input && edge_wanted(t, input, level)))) {
        tim_slave_trigger(t, time_ps);
    }
}

static int64_t filter_ticks(const tim_t *t, unsigned input) {
    static const uint16_t ticks[16] = {0,  2,  4,  8,  12,  16,  24,  32,
                                       48, 64, 80, 96, 128, 160, 192, 256}; /* Samples times divider. */
    /* The filter is that of the first channel that listens to this input. */
    unsigned setting = 0;
    for (unsigned channel = 0; channel < t->what->channels && setting == 0; channel++) {
        const unsigned selection = tim_mode_bits(t, channel) & 3u;
        if ((selection == 1 && channel == input) || (selection == 2 && (channel ^ 1u) == input)) {
            setting = field(tim_mode_bits(t, channel), 4, 4);
        }
    }
    const unsigned division = setting < 4 ? 0 : field(t->model.value[TIM_CR1 / 4], 8, 2);
    return (int64_t)ticks[setting] << division;
}

static void filter_done(void *context, int64_t time_ps) {
    tim_t *const t = *(tim_t **)context; /* First member of the input. */
    for (unsigned i = 0; i < 4; i++) {
        if ((void *)&t->input[i] == context && t->input[i].raw != t->input[i].level) {
            t->input[i].level = t->input[i].raw;
            filtered_edge(t, i, t->input[i].level, time_ps);
        }
    }
}

void tim_pin_edge(chip_t *chip, unsigned pin, bool level, int64_t time_ps) {
    for (unsigned i = 0; i < tim_pin_count; i++) {
        if (tim_pins[i].pin != pin) {
            continue;
        }
        tim_t *const t = chip->tim[tim_pins[i].timer - 1];
        if (!t->model.clocked || t->model.in_reset || !chip_pin_is_alternate(chip, pin, tim_pins[i].alternate)) {
            continue;
        }
        if (tim_pins[i].role != TIM_PIN_CHANNEL) {
            if (tim_pins[i].role == TIM_PIN_BREAK) {
                tim_break_input(t, time_ps);
            }
            continue;
        }
        const unsigned input = tim_pins[i].channel;
        t->input[input].raw = level;
        const int64_t ticks = filter_ticks(t, input);
        if (ticks == 0) {
            t->input[input].level = level;
            filtered_edge(t, input, level, time_ps);
        } else if (level == t->input[input].level) {
            machine_cancel(chip->machine, &t->input[input].filter); /* A glitch: back before the filter was full. */
        } else {
            machine_schedule(chip->machine, &t->input[input].filter,
                             clock_time(t->clock, clock_tick(t->clock, time_ps) + ticks));
        }
    }
}

/* ---- Registers ---- */

/* Bits of a channel that CCPC preloads: OCxM, and CCxE with CCxNE. */
static uint32_t preloaded(const tim_t *t, unsigned channel, uint32_t bits) {
    return (t->model.value[TIM_CR2 / 4] & CCPC) != 0 && channel < 3 && !tim_is_capture(t, channel) ? bits : 0;
}

void tim_take_modes(tim_t *t, bool commutation) {
    for (unsigned i = 0; i < t->what->channels; i++) {
        const unsigned shift = 8 * (i % 2), was = tim_compare_mode(t, i);
        const uint32_t modes = (0xFFu & ~(commutation ? 0 : preloaded(t, i, 0x70))) << shift;
        const uint32_t enables = (0xFu & ~(commutation ? 0 : preloaded(t, i, 5))) << 4 * i;
        uint32_t *const acting = &t->modes[i / 2];
        *acting = (*acting & ~modes) | (t->model.value[TIM_CCMR1 / 4 + i / 2] & modes);
        t->enables = (t->enables & ~enables) | (t->model.value[TIM_CCER / 4] & enables);
        const int64_t now = machine_now(t->model.machine);
        if (tim_is_capture(t, i)) {
            tim_refresh_output(t, i, now);
            continue;
        }
        if ((tim_mode_bits(t, i) & 8u) == 0) { /* OCxPE off: active at once. */
            t->compare[i] = t->model.value[TIM_CCR1 / 4 + i];
        }
        if (tim_compare_mode(t, i) < 6 || was == 0 || was >= 6) { /* Else PWM waits for the next comparison. */
            tim_evaluate_reference(t, i, false, tim_position(t, tim_now_tick(t)), now);
        }
        tim_refresh_output(t, i, now);
    }
}

void tim_write_channel_mode(tim_t *t, uint32_t offset, uint32_t value) {
    value = tim_unlocked(t, offset, value);
    const uint32_t old = t->model.value[offset / 4];
    for (unsigned i = 0; i < 2; i++) {
        const unsigned channel = (offset == TIM_CCMR1 ? 0 : 2) + i;
        if (((old ^ value) >> (8 * i) & 3u) != 0 && (tim_enable_bits(t, channel) & 1u) != 0) {
            machine_violation(t->model.machine, "%s: CC%uS is writable only while CC%uE is 0", model_name(&t->model),
                              channel + 1, channel + 1);
            return;
        }
    }
    t->model.value[offset / 4] = value;
    tim_take_modes(t, false);
}

void tim_channels_init(tim_t *t) {
    for (unsigned i = 0; i < 4; i++) {
        t->input[i].timer = t;
        t->input[i].input = i;
        machine_event_init(&t->input[i].filter, filter_done, &t->input[i]);
    }
}

void tim_channels_restart(tim_t *t) {
    t->modes[0] = t->modes[1] = t->enables = 0;
    for (unsigned i = 0; i < 4; i++) {
        machine_cancel(t->model.machine, &t->input[i].filter);
        t->input[i].level = t->input[i].raw = false;
        t->reference[i] = false;
        t->edges[i] = 0;
    }
}

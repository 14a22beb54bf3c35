/* adc_group.c: regular and injected groups: what is converted when, and where results go (RM0090 13.3.9, 13.8, 13.9).
 *
 * A trigger takes effect two converter clocks (regular) or three (injected) after the next edge of the converters'
 * clock. An injected group interrupts a regular conversion, which is done again after it; a regular trigger during an
 * injected group waits. Converters that go together begin each conversion at once and go on when the slowest is done;
 * their JEOC comes when all are done (13.9.1). Only where the group is a single conversion may they differ in its
 * length.
 */
#include "emulator/peripherals/adc.h"

#define REGULAR_LATENCY  2
#define INJECTED_LATENCY 3

static unsigned place(const unit_t *leader, activity_t group) {
    return group == REGULAR ? leader->index : leader->injected_index;
}

/* ---- Conversions ---- */

static void check_pins(unit_t *leader, activity_t group, unsigned count) {
    unsigned pins[3];
    for (unsigned i = 0; i < count; i++) {
        const unit_t *const u = adc_member(leader, count, i);
        pins[i] = adc_pin(u, adc_channel(u, group, place(leader, group)));
        for (unsigned k = 0; k < i && pins[i] != ADC_NO_PIN; k++) {
            if (pins[k] == pins[i]) {
                machine_violation(leader->model.machine, "%s: converts the same pin as %s at the same time",
                                  model_name(&u->model), model_name(&adc_of(u)->unit[k].model));
            }
        }
    }
}

static void begin(unit_t *leader, activity_t group, int64_t tick) {
    chip_t *const chip = leader->model.chip;
    const int64_t divider = adc_divider(leader);
    const unsigned count = adc_members(leader, group), index = place(leader, group);
    unsigned longest = 0;
    bool differ = false;
    for (unsigned i = 0; i < count; i++) {
        unit_t *const u = adc_member(leader, count, i);
        const unsigned channel = adc_channel(u, group, index), sampling = adc_sampling(u, channel),
                       clocks = sampling + adc_resolution(u);
        u->activity = group;
        u->result = adc_sample(u, channel, clock_time(&chip->pclk2, tick + sampling * divider));
        differ = differ || (i > 0 && clocks != longest);
        longest = clocks > longest ? clocks : longest;
    }
    if (differ && adc_length(leader, group) > 1) {
        model_missing(&leader->model,
                      "sequences whose sampling times or resolutions differ between converters that go together");
    }
    if (count > 1) {
        check_pins(leader, group, count);
    }
    machine_schedule(chip->machine, &leader->done, clock_time(&chip->pclk2, tick + longest * divider));
}

/* May all members start? */
static bool members_ready(unit_t *leader, activity_t group, unsigned count) {
    for (unsigned i = 0; i < count; i++) {
        unit_t *const u = adc_member(leader, count, i);
        if (!adc_ready(u, group == REGULAR ? "regular conversion started" : "injected conversion started")) {
            return false;
        }
        if (adc_length(u, group) != adc_length(leader, group)) {
            machine_violation(u->model.machine, "%s: sequence length differs from ADC1's in simultaneous mode",
                              model_name(&u->model));
        }
    }
    return true;
}

static void mark_started(unit_t *leader, unsigned count, uint32_t flag) {
    for (unsigned i = 0; i < count; i++) {
        adc_member(leader, count, i)->model.value[ADC_SR / 4] |= flag;
    }
}

void adc_start_regular(unit_t *u, int64_t time_ps) {
    const unsigned count = adc_members(u, REGULAR);
    if (!members_ready(u, REGULAR, count) || (reg(&u->model, ADC_SR) & OVR) != 0) {
        return; /* No conversion until OVR is cleared. */
    }
    if (u->activity == REGULAR || u->regular_waits) {
        machine_violation(u->model.machine,
                          "%s: a trigger came while the sequence was still being converted, and was lost",
                          model_name(&u->model));
        return;
    }
    if (adc_by_common(u)) {
        adc_common_check_order(adc_of(u));
    }
    if ((reg(&u->model, ADC_CR1) & DISCEN) == 0) {
        u->index = 0;
    }
    mark_started(u, count, STRT);
    if (u->activity == INJECTED) {
        u->regular_waits = true;
    } else {
        begin(u, REGULAR, adc_start_tick(u, time_ps, REGULAR_LATENCY));
    }
}

void adc_start_injected(unit_t *u, int64_t time_ps) {
    const unsigned count = adc_members(u, INJECTED);
    if (!members_ready(u, INJECTED, count)) {
        return;
    }
    for (unsigned i = 0; i < count; i++) {
        const unit_t *const member = adc_member(u, count, i);
        if (member->activity == INJECTED) {
            machine_violation(
                u->model.machine,
                "%s: an injected trigger came while the injected group was still being converted, and was lost",
                model_name(&member->model));
            return;
        }
    }
    for (unsigned i = 0; i < count; i++) {
        unit_t *const member = adc_member(u, count, i);
        if (member->activity == REGULAR) {
            unit_t *const leader = adc_leader(member, REGULAR);
            leader->regular_waits = true;
            machine_cancel(u->model.machine, &leader->done);
        }
    }
    if ((reg(&u->model, ADC_CR1) & JDISCEN) == 0) {
        u->injected_index = 0;
    }
    mark_started(u, count, JSTRT);
    begin(u, INJECTED, adc_start_tick(u, time_ps, INJECTED_LATENCY));
}

/* ---- Results ---- */

static uint32_t aligned(const unit_t *u, int32_t value) {
    const unsigned bits = adc_resolution(u);
    if ((reg(&u->model, ADC_CR2) & 0x800u) == 0) {
        return (uint32_t)value & 0xFFFFu;
    }
    return ((uint32_t)value << (bits == 6 ? 2 : 16 - bits)) & 0xFFFFu;
}

static void watchdog(unit_t *u, activity_t group, unsigned channel, uint32_t value) {
    const uint32_t cr1 = reg(&u->model, ADC_CR1);
    if ((cr1 >> (group == INJECTED ? 22 : 23) & 1u) == 0 || ((cr1 & 0x200u) && (cr1 & 31u) != channel)) {
        return;
    }
    const uint32_t full = value << (12 - adc_resolution(u));
    if (full > reg(&u->model, ADC_HTR) || full < reg(&u->model, ADC_LTR)) {
        u->model.value[ADC_SR / 4] |= AWD;
    }
}

static void overrun(unit_t *u) {
    machine_violation(u->model.machine, "%s: overrun, a result was lost (OVR)", model_name(&u->model));
    u->model.value[ADC_SR / 4] |= OVR;
    if (adc_by_common(u)) {
        adc_common_overrun(adc_of(u));
    }
    dma_line(u->model.chip, u->request, false);
}

static void store_regular(unit_t *u, unsigned index, bool last) {
    const uint32_t cr2 = reg(&u->model, ADC_CR2), value = u->result >> (12 - adc_resolution(u));
    const bool by_common = adc_by_common(u);
    watchdog(u, REGULAR, adc_channel(u, REGULAR, index), value);
    if (u->unread && !by_common && (cr2 & (DMA | EOCS)) != 0 && !u->no_more_requests) {
        overrun(u);
        return;
    }
    u->model.value[ADC_DR / 4] = aligned(u, (int32_t)value);
    u->unread = true;
    if (last || (cr2 & EOCS) != 0) {
        u->model.value[ADC_SR / 4] |= EOC;
    }
    if (by_common) {
        if (!adc_common_keep(adc_of(u), reg(&u->model, ADC_DR))) {
            overrun(u);
        }
    } else if ((cr2 & DMA) != 0 && !u->no_more_requests) {
        dma_line(u->model.chip, u->request, true);
    }
}

static void store_injected(unit_t *u, unsigned index) {
    const uint32_t value = u->result >> (12 - adc_resolution(u));
    watchdog(u, INJECTED, adc_channel(u, INJECTED, index), value);
    u->model.value[ADC_JDR1 / 4 + index] = aligned(u, (int32_t)value - (int32_t)reg(&u->model, ADC_JOFR1 + 4 * index));
}

/* ---- What runs next ---- */

static void next_injected(unit_t *leader, unsigned count, int64_t tick) {
    const bool last = ++leader->injected_index >= adc_length(leader, INJECTED);
    if (!last && (reg(&leader->model, ADC_CR1) & JDISCEN) == 0) {
        begin(leader, INJECTED, tick);
        return;
    }
    if (last) {
        leader->injected_index = 0;
        mark_started(leader, count, JEOC);
    }
    for (unsigned i = 0; i < count; i++) {
        unit_t *const u = adc_member(leader, count, i);
        if (u->regular_waits) {
            u->regular_waits = false;
            begin(u, REGULAR, tick);
        }
    }
}

static void next_regular(unit_t *leader, bool last, int64_t tick) {
    const uint32_t cr1 = reg(&leader->model, ADC_CR1);
    const bool continuous = (reg(&leader->model, ADC_CR2) & CONT) != 0;
    leader->index = last ? 0 : leader->index + 1;
    if (reg(&leader->model, ADC_SR) & OVR) {
        return;
    }
    const bool pause = (cr1 & DISCEN) != 0 && (leader->index % (field(cr1, 13, 3) + 1)) == 0;
    if (last && (cr1 & JAUTO) != 0) {
        leader->regular_waits = continuous;
        leader->injected_index = 0;
        begin(leader, INJECTED, tick);
    } else if (last ? continuous : !pause) {
        begin(leader, REGULAR, tick);
    }
}

static void conversion_done(void *context, int64_t time_ps) {
    unit_t *const leader = context;
    adc_t *const adc = adc_of(leader);
    const activity_t group = leader->activity;
    const unsigned count = adc_members(leader, group), index = place(leader, group);
    const int64_t tick = clock_tick(&leader->model.chip->pclk2, time_ps);
    const bool last = index + 1 >= adc_length(leader, REGULAR);
    for (unsigned i = 0; i < count; i++) {
        unit_t *const u = adc_member(leader, count, i);
        u->activity = IDLE;
        if (group == REGULAR) {
            store_regular(u, index, last);
        } else {
            store_injected(u, index);
        }
    }
    if (group == REGULAR) {
        next_regular(leader, last, tick);
        if (!adc_common_request(adc) && count > 1) {
            overrun(leader); /* Nobody fetched them. */
        }
    } else {
        next_injected(leader, count, tick);
    }
    for (unsigned i = 0; i < count; i++) {
        adc_interrupt(adc_member(leader, count, i));
    }
}

void adc_group_init(unit_t *u) {
    machine_event_init(&u->done, conversion_done, u);
}

void adc_stop(unit_t *u) {
    machine_cancel(u->model.machine, &u->done);
    u->activity = IDLE;
    u->regular_waits = u->unread = false;
    u->index = u->injected_index = 0;
}

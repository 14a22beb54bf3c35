/* tim_counter.c: the counter, its updates, and the next moment that somebody observes.
 *
 * The counter is computed from the time: it has base_count at tick base_tick of the timer's clock. Nothing happens
 * while it merely counts; an event is scheduled for the next update or compare that something observes (interrupt, DMA,
 * trigger), and everything else is caught up on access.
 */
#include "emulator/peripherals/tim.h"

static int64_t maximum(const tim_t *t) {
    return t->what->wide ? 0xFFFFFFFF : 0xFFFF;
}
static int64_t last_count(const tim_t *t) {
    return t->base_count <= t->reload ? (int64_t)t->reload : maximum(t);
}
static int64_t overflow_tick(const tim_t *t) {
    return t->base_tick + (last_count(t) + 1 - t->base_count) * tim_step(t);
}

void tim_load(tim_t *t) {
    t->prescaler = t->model.value[TIM_PSC / 4];
    t->reload = t->model.value[TIM_ARR / 4];
    for (unsigned i = 0; i < t->what->channels; i++) {
        if (!tim_is_capture(t, i)) {
            t->compare[i] = t->model.value[TIM_CCR1 / 4 + i];
        }
    }
    t->repetition = t->what->advanced ? t->model.value[TIM_RCR / 4] : 0;
}

/* The counter starts anew at tick; the state is whole before anything outside is told. */
static void update_event(tim_t *t, int64_t tick, bool by_software) {
    const uint32_t cr1 = t->model.value[TIM_CR1 / 4];
    const int64_t time_ps = clock_time(t->clock, tick);
    const bool happens = (cr1 & UDIS) == 0 && (by_software || t->repetition == 0);
    if (happens) {
        tim_load(t);
    } else if (!by_software && t->repetition > 0) {
        t->repetition--;
    }
    if (happens && !by_software && (cr1 & OPM) != 0) {
        t->running = false;
        t->model.value[TIM_CR1 / 4] &= ~CEN;
    }
    for (unsigned i = 0; i < t->what->channels; i++) {
        if (!tim_is_capture(t, i) && tim_compare_mode(t, i) >= 6) {
            tim_evaluate_reference(t, i, false, 0, time_ps);
        }
    }
    if (happens) {
        tim_update_enables(t, time_ps);
    }
    const unsigned master_mode = tim_master_mode(t);
    if (happens && (master_mode == 2 || (by_software && master_mode == 0))) {
        tim_trgo(t, true, true, time_ps);
    }
    if (happens && (!by_software || (cr1 & URS) == 0)) {
        t->model.value[TIM_SR / 4] |= UIF;
        tim_interrupt(t);
        tim_pulse_dma(t, 8, t->what->dma_update);
    }
    for (unsigned i = 0; i < t->what->channels && happens && tim_asks_at_update(t); i++) {
        tim_pulse_dma(t, 9 + i, t->what->dma_channel[i]);
    }
}

static void overflow(tim_t *t, int64_t tick) {
    const bool regular = t->base_count <= t->reload;
    t->base_tick = tick;
    t->base_count = 0;
    t->marked = -1;
    if (!regular) { /* The counter was beyond ARR and ran to its end. */
        return;
    }
    for (unsigned i = 0; i < t->what->channels; i++) {
        if (!tim_is_capture(t, i) && t->compare[i] > t->reload) {
            t->model.value[TIM_SR / 4] |= 2u << i;
        }
    }
    update_event(t, tick, false);
}

/* Whole periods in which nothing changes and nobody looks. */
static void skip(tim_t *t, int64_t tick) {
    const int64_t period = ((int64_t)t->reload + 1) * tim_step(t);
    if (t->base_count != 0 || tick - t->base_tick < 4 * period || (t->model.value[TIM_CR1 / 4] & OPM) != 0 ||
        t->repetition != 0 || (t->what->advanced && t->model.value[TIM_RCR / 4] != 0) ||
        t->prescaler != t->model.value[TIM_PSC / 4] || t->reload != t->model.value[TIM_ARR / 4]) {
        return;
    }
    for (unsigned i = 0; i < t->what->channels; i++) {
        if (!tim_is_capture(t, i) && t->compare[i] != t->model.value[TIM_CCR1 / 4 + i]) {
            return;
        }
    }
    t->base_tick += ((tick - t->base_tick) / period - 2) * period;
}

void tim_advance(tim_t *t, int64_t tick) {
    if (tim_counting(t)) {
        skip(t, tick);
    }
    while (tim_counting(t)) {
        const int64_t over = overflow_tick(t);
        const int64_t limit = tick < over ? tim_position(t, tick) : last_count(t);
        int64_t next = INT64_MAX;
        for (unsigned i = 0; i < t->what->channels; i++) {
            if (t->compare[i] > t->marked && t->compare[i] <= limit && t->compare[i] < next && !tim_is_capture(t, i)) {
                next = t->compare[i];
            }
        }
        if (next != INT64_MAX) {
            const int64_t at = next > t->base_count ? t->base_tick + (next - t->base_count) * tim_step(t)
                                                    : t->base_tick;
            t->marked = next;
            for (unsigned i = 0; i < t->what->channels; i++) {
                if (!tim_is_capture(t, i) && t->compare[i] == next && t->marked == next) {
                    tim_compare_match(t, i, at);
                }
            }
        } else if (tick < over) {
            t->marked = limit > t->marked ? limit : t->marked;
            return;
        } else {
            overflow(t, over);
        }
    }
}

/* The tick of the next update or compare that somebody observes; INT64_MAX: there is none. */
static int64_t next_observed(const tim_t *t) {
    const uint32_t dier = t->model.value[TIM_DIER / 4];
    const unsigned master_mode = tim_trgo_heard(t) ? tim_master_mode(t) : 0;
    const uint32_t channel_bits = tim_asks_at_update(t) ? 0x2u : 0x202u;
    const bool automatic = (t->model.value[TIM_BDTR / 4] & (AOE | MOE)) == AOE;
    bool update = (dier & 0x101u) != 0 || master_mode == 2 || automatic ||
                  (tim_asks_at_update(t) && (dier & 0x1E00u) != 0);
    int64_t tick = INT64_MAX;
    const int64_t over = overflow_tick(t), last = last_count(t);
    bool later = false; /* An observed compare lies beyond the overflow. */
    for (unsigned i = 0; i < t->what->channels; i++) {
        if (tim_is_capture(t, i)) {
            continue;
        }
        const unsigned mode = tim_compare_mode(t, i);
        const bool moves = mode != 0 && mode != 4 && mode != 5, /* Neither frozen nor forced. */
            wired = moves && ((t->wired[TIM_PIN_CHANNEL] | t->wired[TIM_PIN_COMPLEMENT]) >> i & 1u) != 0,
                   heard = wired || tim_channel_heard(t, i) || master_mode == 4 + i;
        if (!heard && (dier & (channel_bits << i)) == 0 && !(i == 0 && master_mode == 3)) {
            continue;
        }
        update = update || (heard && mode >= 6);
        if (t->compare[i] > t->marked && t->compare[i] <= last) {
            const int64_t at = t->compare[i] > t->base_count
                                   ? t->base_tick + (t->compare[i] - t->base_count) * tim_step(t)
                                   : t->base_tick;
            tick = at < tick ? at : tick;
        } else {
            later = true;
        }
    }
    return (update || later) && over < tick ? over : tick;
}

void tim_plan(tim_t *t) {
    const int64_t tick = tim_counting(t) ? next_observed(t) : INT64_MAX;
    if (tick == INT64_MAX) {
        machine_cancel(t->model.machine, &t->event);
    } else {
        machine_schedule(t->model.machine, &t->event, clock_time(t->clock, tick));
    }
}

static void observed(void *context, int64_t time_ps) {
    tim_t *const t = context;
    tim_advance(t, clock_tick(t->clock, time_ps));
    tim_plan(t);
}

void tim_counter_init(tim_t *t) {
    machine_event_init(&t->event, observed, t);
}

void tim_start(tim_t *t, int64_t tick) {
    t->running = true;
    t->base_tick = tick;
    t->marked = t->base_count - 1;
}

void tim_restart_counter(tim_t *t, int64_t tick) {
    t->base_count = 0;
    t->base_tick = tick;
    t->marked = -1;
    update_event(t, tick, true);
}

void tim_rebase(tim_t *t, int64_t tick) {
    if (tim_counting(t) && tick > t->base_tick) {
        const int64_t steps = (tick - t->base_tick) / tim_step(t);
        t->base_count += steps;
        t->base_tick += steps * tim_step(t);
    }
}

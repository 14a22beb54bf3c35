/* tim.c: timers 1 to 14, counting up (RM0090 chapters 17 to 20).
 *
 * The counter is computed from the time: it has base_count at tick base_tick of the timer's clock. Nothing happens while it merely counts; an event is
 * scheduled for the next update or compare that something observes (interrupt, DMA, trigger), and everything else is caught up on access.
 * Not there, and loud: counting down and centre-aligned, encoder, gated and external-clock modes, ETR, break, commutation, outputs to pins.
 * A capture without filter has no synchroniser delay (two to three ticks on silicon).
 */
#include "tim.h"

#define CEN 1u
#define UDIS 2u
#define URS 4u
#define OPM 8u
#define ARPE 0x80u
#define UIF 1u
#define TIF 0x40u
#define MOE 0x8000u
#define CCDS 8u /* CR2: compare and capture requests go out at the update. */

struct tim {
    model_t model;
    const tim_description_t *what;
    const clock_domain_t *clock;
    bool running;
    int64_t base_tick, base_count;
    int64_t marked; /* Counter values up to this one have been compared since the last overflow. */
    uint32_t prescaler, reload, compare[4], repetition; /* Active (shadow) values. */
    bool reference[4], output[4], silent_trigger;
    machine_event_t event;
    struct {
        tim_t *timer;
        unsigned input;
        bool raw, level;
        machine_event_t filter;
    } input[4];
    uint8_t edges[4];
    bool update_line, channel_line, trigger_line;
    unsigned burst_index;
    dma_source_t burst_source;
};

static uint32_t mode_bits(const tim_t *t, unsigned channel) { return field(t->model.value[(channel < 2 ? TIM_CCMR1 : TIM_CCMR2) / 4], 8 * (channel % 2), 8); }
static bool is_capture(const tim_t *t, unsigned channel) { return (mode_bits(t, channel) & 3u) != 0; }
static unsigned enable_bits(const tim_t *t, unsigned channel) { return field(t->model.value[TIM_CCER / 4], 4 * channel, 4); }
static int64_t maximum(const tim_t *t) { return t->what->wide ? 0xFFFFFFFF : 0xFFFF; }
static int64_t step(const tim_t *t) { return (int64_t)t->prescaler + 1; }
static int64_t last_count(const tim_t *t) { return t->base_count <= t->reload ? (int64_t)t->reload : maximum(t); }
static int64_t overflow_tick(const tim_t *t) { return t->base_tick + (last_count(t) + 1 - t->base_count) * step(t); }
static bool counting(const tim_t *t) { return t->running && t->reload != 0; }

static int64_t position(const tim_t *t, int64_t tick)
{
    return counting(t) && tick > t->base_tick ? t->base_count + (tick - t->base_tick) / step(t) : t->base_count;
}

static int64_t now_tick(const tim_t *t) { return clock_tick(t->clock, machine_now(t->model.machine)); }

static void interrupt(tim_t *t)
{
    const uint32_t active = t->model.value[TIM_SR / 4] & t->model.value[TIM_DIER / 4];
    const bool separate = t->what->irq_update != t->what->irq_channels;
    chip_irq_shared(t->model.chip, t->what->irq_update, &t->update_line, separate ? (active & UIF) != 0 : (active & 0x5Fu) != 0);
    if (separate) {
        chip_irq_shared(t->model.chip, t->what->irq_channels, &t->channel_line, (active & 0x1Eu) != 0);
        chip_irq_shared(t->model.chip, t->what->irq_trigger, &t->trigger_line, (active & TIF) != 0);
    }
}

static void pulse_dma(tim_t *t, unsigned enable_bit, dma_source_t source)
{
    if ((t->model.value[TIM_DIER / 4] >> enable_bit & 1u) != 0 && source != DMA_NONE) {
        t->burst_index = 0;
        t->burst_source = source;
        dma_line_pulse(t->model.chip, source);
    }
}

/* A compare or capture asks at once, or with CCDS at the next update. */
static bool asks_at_update(const tim_t *t) { return (t->model.value[TIM_CR2 / 4] & CCDS) != 0; }

static void channel_dma(tim_t *t, unsigned channel)
{
    if (!asks_at_update(t)) {
        pulse_dma(t, 9 + channel, t->what->dma_channel[channel]);
    }
}

static void slave_trigger(tim_t *t, int64_t time_ps);

/* TRGO rose (and fell at once, if a pulse). */
static void trgo(tim_t *t, bool rising, bool pulse, int64_t time_ps)
{
    chip_t *const chip = t->model.chip;
    if (t->what->trgo == TRIGGER_NONE) {
        return;
    }
    if (chip->trigger_heard[t->what->trgo]) {
        adc_trigger_edge(chip, t->what->trgo, rising, time_ps);
        if (pulse) {
            adc_trigger_edge(chip, t->what->trgo, !rising, time_ps);
        }
    }
    if (rising) {
        dac_trigger_edge(chip, t->what->trgo, time_ps);
        const unsigned number = (unsigned)(t->what - tim_descriptions) + 1;
        for (unsigned i = 0; i < TIM_COUNT; i++) {
            tim_t *const slave = chip->tim[i];
            const uint32_t smcr = slave->model.value[TIM_SMCR / 4];
            if ((smcr & 7u) != 0 && field(smcr, 4, 3) < 4 && slave->what->master[field(smcr, 4, 3)] == number) {
                slave_trigger(slave, time_ps);
            }
        }
    }
}

/* OCxREF and what follows from it. */
static void set_reference(tim_t *t, unsigned channel, bool level, int64_t time_ps)
{
    chip_t *const chip = t->model.chip;
    if (t->reference[channel] != level) {
        t->reference[channel] = level;
        if (field(t->model.value[TIM_CR2 / 4], 4, 3) == 4 + channel) {
            trgo(t, level, false, time_ps);
        }
    }
    const unsigned enable = enable_bits(t, channel);
    const bool driven = (enable & 1u) != 0 && (!t->what->advanced || (t->model.value[TIM_BDTR / 4] & MOE) != 0);
    const bool output = driven && (t->reference[channel] != ((enable & 2u) != 0));
    if (t->output[channel] != output) {
        t->output[channel] = output;
        if (t->what->first_channel_trigger != TRIGGER_NONE) {
            adc_trigger_edge(chip, (trigger_t)(t->what->first_channel_trigger + channel), output, time_ps);
        }
    }
}

static void evaluate_reference(tim_t *t, unsigned channel, bool match, int64_t count, int64_t time_ps)
{
    bool level = t->reference[channel];
    switch (field(mode_bits(t, channel), 4, 3)) {
    case 1: level = match ? true : level; break;
    case 2: level = match ? false : level; break;
    case 3: level = match ? !level : level; break;
    case 4: level = false; break;
    case 5: level = true; break;
    case 6: level = count < t->compare[channel]; break;
    case 7: level = count >= t->compare[channel]; break;
    default: break;
    }
    set_reference(t, channel, level, time_ps);
}

static bool channel_heard(const tim_t *t, unsigned channel)
{
    return t->what->first_channel_trigger != TRIGGER_NONE && t->model.chip->trigger_heard[(unsigned)t->what->first_channel_trigger + channel];
}

static void compare_match(tim_t *t, unsigned channel, int64_t tick)
{
    const int64_t time_ps = clock_time(t->clock, tick);
    t->model.value[TIM_SR / 4] |= 2u << channel;
    evaluate_reference(t, channel, true, t->compare[channel], time_ps);
    if (channel == 0 && field(t->model.value[TIM_CR2 / 4], 4, 3) == 3) {
        trgo(t, true, true, time_ps);
    }
    if (channel_heard(t, channel) && !t->silent_trigger) {
        const bool driven = (enable_bits(t, channel) & 1u) != 0 && (!t->what->advanced || (t->model.value[TIM_BDTR / 4] & MOE) != 0);
        if (!driven || field(mode_bits(t, channel), 4, 3) == 0) {
            t->silent_trigger = true;
            machine_violation(t->model.machine, "%s: a converter waits for CC%u, but OC%u never changes: it needs an OC%uM other than frozen, CC%uE%s", model_name(&t->model),
                              channel + 1, channel + 1, channel + 1, channel + 1, t->what->advanced ? " and MOE" : "");
        }
    }
    interrupt(t);
    channel_dma(t, channel);
}

/* Preloaded values become active. */
static void load(tim_t *t)
{
    t->prescaler = t->model.value[TIM_PSC / 4];
    t->reload = t->model.value[TIM_ARR / 4];
    for (unsigned i = 0; i < t->what->channels; i++) {
        if (!is_capture(t, i)) {
            t->compare[i] = t->model.value[TIM_CCR1 / 4 + i];
        }
    }
    t->repetition = t->what->advanced ? t->model.value[TIM_RCR / 4] : 0;
}

/* The counter starts anew at tick; the state is whole before anything outside is told. */
static void update_event(tim_t *t, int64_t tick, bool by_software)
{
    const uint32_t cr1 = t->model.value[TIM_CR1 / 4];
    const int64_t time_ps = clock_time(t->clock, tick);
    const bool happens = (cr1 & UDIS) == 0 && (by_software || t->repetition == 0);
    if (happens) {
        load(t);
    } else if (!by_software && t->repetition > 0) {
        t->repetition--;
    }
    if (happens && !by_software && (cr1 & OPM) != 0) {
        t->running = false;
        t->model.value[TIM_CR1 / 4] &= ~CEN;
    }
    for (unsigned i = 0; i < t->what->channels; i++) {
        if (!is_capture(t, i) && field(mode_bits(t, i), 4, 3) >= 6) {
            evaluate_reference(t, i, false, 0, time_ps);
        }
    }
    const unsigned master_mode = field(t->model.value[TIM_CR2 / 4], 4, 3);
    if (happens && (master_mode == 2 || (by_software && master_mode == 0))) {
        trgo(t, true, true, time_ps);
    }
    if (happens && (!by_software || (cr1 & URS) == 0)) {
        t->model.value[TIM_SR / 4] |= UIF;
        interrupt(t);
        pulse_dma(t, 8, t->what->dma_update);
    }
    for (unsigned i = 0; i < t->what->channels && happens && asks_at_update(t); i++) {
        pulse_dma(t, 9 + i, t->what->dma_channel[i]);
    }
}

static void overflow(tim_t *t, int64_t tick)
{
    const bool regular = t->base_count <= t->reload;
    t->base_tick = tick;
    t->base_count = 0;
    t->marked = -1;
    if (!regular) { /* The counter was beyond ARR and ran to its end. */
        return;
    }
    for (unsigned i = 0; i < t->what->channels; i++) {
        if (!is_capture(t, i) && t->compare[i] > t->reload) {
            t->model.value[TIM_SR / 4] |= 2u << i;
        }
    }
    update_event(t, tick, false);
}

/* Whole periods in which nothing changes and nobody looks. */
static void skip(tim_t *t, int64_t tick)
{
    const int64_t period = ((int64_t)t->reload + 1) * step(t);
    if (t->base_count != 0 || tick - t->base_tick < 4 * period || (t->model.value[TIM_CR1 / 4] & OPM) != 0 || t->repetition != 0 ||
        (t->what->advanced && t->model.value[TIM_RCR / 4] != 0) || t->prescaler != t->model.value[TIM_PSC / 4] || t->reload != t->model.value[TIM_ARR / 4]) {
        return;
    }
    for (unsigned i = 0; i < t->what->channels; i++) {
        if (!is_capture(t, i) && t->compare[i] != t->model.value[TIM_CCR1 / 4 + i]) {
            return;
        }
    }
    t->base_tick += ((tick - t->base_tick) / period - 2) * period;
}

/* Catch up with everything up to and including tick. */
static void advance(tim_t *t, int64_t tick)
{
    if (counting(t)) {
        skip(t, tick);
    }
    while (counting(t)) {
        const int64_t over = overflow_tick(t);
        const int64_t limit = tick < over ? position(t, tick) : last_count(t);
        int64_t next = INT64_MAX;
        for (unsigned i = 0; i < t->what->channels; i++) {
            if (t->compare[i] > t->marked && t->compare[i] <= limit && t->compare[i] < next && !is_capture(t, i)) {
                next = t->compare[i];
            }
        }
        if (next != INT64_MAX) {
            const int64_t at = next > t->base_count ? t->base_tick + (next - t->base_count) * step(t) : t->base_tick;
            t->marked = next;
            for (unsigned i = 0; i < t->what->channels; i++) {
                if (!is_capture(t, i) && t->compare[i] == next && t->marked == next) {
                    compare_match(t, i, at);
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

static bool trgo_heard(const tim_t *t)
{
    if (t->what->trgo == TRIGGER_NONE) {
        return false;
    }
    bool heard = t->model.chip->trigger_heard[t->what->trgo] || t->model.chip->trigger_wanted[t->what->trgo];
    const unsigned number = (unsigned)(t->what - tim_descriptions) + 1;
    for (unsigned i = 0; i < TIM_COUNT && !heard; i++) {
        const tim_t *const slave = t->model.chip->tim[i];
        const uint32_t smcr = slave ? slave->model.value[TIM_SMCR / 4] : 0;
        heard = (smcr & 7u) != 0 && field(smcr, 4, 3) < 4 && slave->what->master[field(smcr, 4, 3)] == number;
    }
    return heard;
}

/* Schedule the next tick that somebody observes. */
static void plan(tim_t *t)
{
    machine_cancel(t->model.machine, &t->event);
    if (!counting(t)) {
        return;
    }
    const uint32_t dier = t->model.value[TIM_DIER / 4];
    const unsigned master_mode = trgo_heard(t) ? field(t->model.value[TIM_CR2 / 4], 4, 3) : 0;
    const uint32_t channel_bits = asks_at_update(t) ? 0x2u : 0x202u;
    bool update = (dier & 0x101u) != 0 || master_mode == 2 || (asks_at_update(t) && (dier & 0x1E00u) != 0);
    int64_t tick = INT64_MAX;
    const int64_t over = overflow_tick(t), last = last_count(t);
    bool later = false; /* An observed compare lies beyond the overflow. */
    for (unsigned i = 0; i < t->what->channels; i++) {
        if (is_capture(t, i)) {
            continue;
        }
        const bool heard = channel_heard(t, i) || master_mode == 4 + i;
        if (!heard && (dier & (channel_bits << i)) == 0 && !(i == 0 && master_mode == 3)) {
            continue;
        }
        update = update || (heard && field(mode_bits(t, i), 4, 3) >= 6);
        if (t->compare[i] > t->marked && t->compare[i] <= last) {
            const int64_t at = t->compare[i] > t->base_count ? t->base_tick + (t->compare[i] - t->base_count) * step(t) : t->base_tick;
            tick = at < tick ? at : tick;
        } else {
            later = true;
        }
    }
    if ((update || later) && over < tick) {
        tick = over;
    }
    if (tick != INT64_MAX) {
        machine_schedule(t->model.machine, &t->event, clock_time(t->clock, tick));
    }
}

static void observed(void *context, int64_t time_ps)
{
    tim_t *const t = context;
    advance(t, clock_tick(t->clock, time_ps));
    plan(t);
}

static void start(tim_t *t, int64_t tick)
{
    t->running = true;
    t->base_tick = tick;
    t->marked = t->base_count - 1;
}

static void restart_counter(tim_t *t, int64_t tick)
{
    t->base_count = 0;
    t->base_tick = tick;
    t->marked = -1;
    update_event(t, tick, true);
}

static void slave_trigger(tim_t *t, int64_t time_ps)
{
    const int64_t tick = clock_tick(t->clock, time_ps);
    advance(t, tick);
    t->model.value[TIM_SR / 4] |= TIF;
    switch (field(t->model.value[TIM_SMCR / 4], 0, 3)) {
    case 4: restart_counter(t, tick); break;
    case 6:
        if (!t->running) {
            t->model.value[TIM_CR1 / 4] |= CEN;
            start(t, tick);
        }
        break;
    default: break;
    }
    interrupt(t);
    pulse_dma(t, 14, t->what->dma_trigger);
    plan(t);
}

/* ---- Input capture ---- */

static void capture(tim_t *t, unsigned channel, int64_t time_ps)
{
    static const uint8_t every[4] = {1, 2, 4, 8};
    if (++t->edges[channel] < every[field(mode_bits(t, channel), 2, 2)]) {
        return;
    }
    t->edges[channel] = 0;
    const int64_t tick = clock_tick(t->clock, time_ps);
    advance(t, tick);
    uint32_t *const sr = &t->model.value[TIM_SR / 4];
    t->model.value[TIM_CCR1 / 4 + channel] = (uint32_t)position(t, tick);
    *sr |= (*sr & 2u << channel) ? 0x200u << channel : 0;
    *sr |= 2u << channel;
    interrupt(t);
    channel_dma(t, channel);
    plan(t);
}

static bool edge_wanted(const tim_t *t, unsigned channel, bool level)
{
    switch (enable_bits(t, channel) & 0xAu) {
    case 0x0: return level;
    case 0x2: return !level;
    case 0xA: return true;
    default:
        machine_violation(t->model.machine, "%s_CCER: CC%uNP set with CC%uP clear is reserved for inputs", model_name(&t->model), channel + 1, channel + 1);
        return false;
    }
}

/* The level of TIx after the filter changed. */
static void filtered_edge(tim_t *t, unsigned input, bool level, int64_t time_ps)
{
    for (unsigned channel = 0; channel < t->what->channels; channel++) {
        const unsigned selection = mode_bits(t, channel) & 3u;
        const bool mine = (selection == 1 && channel == input) || (selection == 2 && (channel ^ 1u) == input);
        if (mine && (enable_bits(t, channel) & 1u) != 0 && edge_wanted(t, channel, level)) {
            capture(t, channel, time_ps);
        }
    }
    const uint32_t smcr = t->model.value[TIM_SMCR / 4];
    const unsigned source = field(smcr, 4, 3);
    if ((smcr & 7u) != 0 && ((source == 4 && input == 0) || (source == 5 + input && edge_wanted(t, input, level)))) {
        slave_trigger(t, time_ps);
    }
}

static int64_t filter_ticks(const tim_t *t, unsigned input)
{
    static const uint16_t ticks[16] = {0, 2, 4, 8, 12, 16, 24, 32, 48, 64, 80, 96, 128, 160, 192, 256}; /* Samples times divider. */
    /* The filter is that of the first channel that listens to this input. */
    unsigned setting = 0;
    for (unsigned channel = 0; channel < t->what->channels && setting == 0; channel++) {
        const unsigned selection = mode_bits(t, channel) & 3u;
        if ((selection == 1 && channel == input) || (selection == 2 && (channel ^ 1u) == input)) {
            setting = field(mode_bits(t, channel), 4, 4);
        }
    }
    const unsigned division = setting < 4 ? 0 : field(t->model.value[TIM_CR1 / 4], 8, 2);
    return (int64_t)ticks[setting] << division;
}

static void filter_done(void *context, int64_t time_ps)
{
    tim_t *const t = *(tim_t **)context; /* First member of the input. */
    for (unsigned i = 0; i < 4; i++) {
        if ((void *)&t->input[i] == context && t->input[i].raw != t->input[i].level) {
            t->input[i].level = t->input[i].raw;
            filtered_edge(t, i, t->input[i].level, time_ps);
        }
    }
}

void tim_edge(chip_t *chip, unsigned pin, bool level, int64_t time_ps)
{
    for (unsigned i = 0; i < tim_pin_count; i++) {
        if (tim_pins[i].pin != pin) {
            continue;
        }
        tim_t *const t = chip->tim[tim_pins[i].timer - 1];
        if (!t->model.clocked || t->model.in_reset || !chip_pin_is_alternate(chip, pin, tim_pins[i].alternate)) {
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
            machine_schedule(chip->machine, &t->input[input].filter, clock_time(t->clock, clock_tick(t->clock, time_ps) + ticks));
        }
    }
}

/* ---- Registers ---- */

static void check_modes(tim_t *t, uint32_t offset, uint32_t value)
{
    const char *missing = NULL;
    if (offset == TIM_CR1 && (value & 0x70u) != 0) {
        missing = "counting down or centre-aligned";
    } else if (offset == TIM_CR2 && (value & 0x85u) != 0) {
        missing = "preloaded control bits and the exclusive-or input";
    } else if (offset == TIM_SMCR && ((value & 0xFF00u) != 0 || ((value & 7u) != 0 && (value & 7u) != 4 && (value & 7u) != 6) || ((value & 7u) != 0 && (value & 0x70u) == 0x70u))) {
        missing = "slave modes other than reset and trigger, and the external trigger";
    } else if (offset == TIM_BDTR && (value & 0x1000u) != 0) {
        missing = "break";
    } else if ((offset == TIM_CCMR1 || offset == TIM_CCMR2) && ((value & 3u) == 3 || (value & 0x300u) == 0x300u)) {
        missing = "capture from TRC";
    } else if (offset == TIM_OR && value != 0) {
        missing = "remapped inputs";
    }
    if (missing != NULL) {
        model_missing(&t->model, missing);
    }
}

static void check_pins(tim_t *t)
{
    for (unsigned i = 0; i < tim_pin_count; i++) {
        const unsigned number = (unsigned)(t->what - tim_descriptions) + 1, channel = tim_pins[i].channel;
        if (tim_pins[i].timer == number && (enable_bits(t, channel) & 1u) != 0 && !is_capture(t, channel) &&
            chip_pin_is_alternate(t->model.chip, tim_pins[i].pin, tim_pins[i].alternate)) {
            model_missing(&t->model, "compare outputs to pins");
        }
    }
}

static void write_channel_mode(tim_t *t, uint32_t offset, uint32_t value)
{
    const uint32_t old = t->model.value[offset / 4];
    for (unsigned i = 0; i < 2; i++) {
        const unsigned channel = (offset == TIM_CCMR1 ? 0 : 2) + i;
        if (((old ^ value) >> (8 * i) & 3u) != 0 && (enable_bits(t, channel) & 1u) != 0) {
            machine_violation(t->model.machine, "%s: CC%uS is writable only while CC%uE is 0", model_name(&t->model), channel + 1, channel + 1);
            return;
        }
    }
    t->model.value[offset / 4] = value;
    for (unsigned i = 0; i < 2; i++) {
        const unsigned channel = (offset == TIM_CCMR1 ? 0 : 2) + i;
        if (channel < t->what->channels && !is_capture(t, channel)) {
            if ((value >> (8 * i) & 8u) == 0) { /* OCxPE off: active at once. */
                t->compare[channel] = t->model.value[TIM_CCR1 / 4 + channel];
            }
            evaluate_reference(t, channel, false, position(t, now_tick(t)), machine_now(t->model.machine));
        }
    }
}

static void generate(tim_t *t, uint32_t value, int64_t tick)
{
    if (value & 0xA0u) {
        model_missing(&t->model, "commutation and break (EGR)");
    }
    if (value & 1u) {
        restart_counter(t, tick);
    }
    for (unsigned i = 0; i < t->what->channels; i++) {
        if ((value & 2u << i) == 0) {
            continue;
        }
        if (is_capture(t, i)) {
            capture(t, i, machine_now(t->model.machine));
        } else {
            compare_match(t, i, tick);
        }
    }
    if (value & TIF) {
        t->model.value[TIM_SR / 4] |= TIF;
        interrupt(t);
        pulse_dma(t, 14, t->what->dma_trigger);
    }
}

static uint32_t burst_register(tim_t *t)
{
    const uint32_t dcr = t->model.value[TIM_DCR / 4];
    const uint32_t offset = 4 * (field(dcr, 0, 5) + t->burst_index);
    t->burst_index = t->burst_index == field(dcr, 8, 5) ? 0 : t->burst_index + 1;
    return offset;
}

static void set(model_t *model, uint32_t offset, uint32_t value);

static void burst_write(tim_t *t, uint32_t value)
{
    const uint32_t offset = burst_register(t);
    if (offset >= TIM_DCR || t->model.slot[offset / 4] == 0) {
        machine_violation(t->model.machine, "%s_DMAR: the burst reaches offset 0x%02X, where no register is", model_name(&t->model), (unsigned)offset);
    } else {
        set(&t->model, offset, value);
    }
    if (t->burst_index != 0 && t->burst_source != DMA_NONE) {
        dma_line_pulse(t->model.chip, t->burst_source);
    }
}

static void write_cr1(tim_t *t, uint32_t value, int64_t tick)
{
    t->model.value[TIM_CR1 / 4] = value;
    if ((value & ARPE) == 0) {
        t->reload = t->model.value[TIM_ARR / 4];
    }
    if ((value & CEN) != 0 && !t->running) {
        start(t, tick + 1); /* The counter starts one clock after CEN. */
        if (field(t->model.value[TIM_CR2 / 4], 4, 3) == 1) {
            trgo(t, true, false, machine_now(t->model.machine));
        }
    } else if ((value & CEN) == 0 && t->running) {
        t->base_count = position(t, tick);
        t->running = false;
        if (field(t->model.value[TIM_CR2 / 4], 4, 3) == 1) {
            trgo(t, false, false, machine_now(t->model.machine));
        }
    }
}

/* Before the counter's rule changes: its present value becomes the base, the prescaler's phase kept. */
static void rebase(tim_t *t, int64_t tick)
{
    if (counting(t) && tick > t->base_tick) {
        const int64_t steps = (tick - t->base_tick) / step(t);
        t->base_count += steps;
        t->base_tick += steps * step(t);
    }
}

static void set(model_t *model, uint32_t offset, uint32_t value)
{
    tim_t *const t = (tim_t *)model;
    const int64_t tick = now_tick(t);
    advance(t, tick);
    check_modes(t, offset, value);
    t->silent_trigger = false;
    switch (offset) {
    case TIM_CR1: write_cr1(t, value, tick); break;
    case TIM_SR: model->value[TIM_SR / 4] &= value; interrupt(t); break;
    case TIM_EGR: generate(t, value, tick); break;
    case TIM_DIER: {
        const uint32_t gone = model->value[TIM_DIER / 4] & ~value;
        model->value[TIM_DIER / 4] = value;
        for (unsigned i = 0; i < 7; i++) { /* A request that waits falls with its enable bit. */
            const dma_source_t source = i == 0 ? t->what->dma_update : i < 5 ? t->what->dma_channel[i - 1] : i == 6 ? t->what->dma_trigger : DMA_NONE;
            if ((gone >> (8 + i) & 1u) != 0 && source != DMA_NONE) {
                dma_line(model->chip, source, false);
            }
        }
        interrupt(t);
        break;
    }
    case TIM_CCMR1:
    case TIM_CCMR2: write_channel_mode(t, offset, value); break;
    case TIM_CCER:
    case TIM_BDTR:
        if (offset == TIM_BDTR && (field(model->value[TIM_BDTR / 4], 8, 2)) != 0 && ((model->value[TIM_BDTR / 4] ^ value) & 0xFFu) != 0) {
            machine_violation(model->machine, "%s_BDTR: DTG is locked until reset", model_name(model));
            value = (value & ~0xFFu) | (model->value[TIM_BDTR / 4] & 0xFFu);
        }
        model->value[offset / 4] = value;
        for (unsigned i = 0; i < t->what->channels; i++) {
            if (!is_capture(t, i)) {
                set_reference(t, i, t->reference[i], machine_now(model->machine));
            }
        }
        check_pins(t);
        break;
    case TIM_CNT:
        t->base_count = value;
        t->base_tick = tick;
        t->marked = (int64_t)value - 1;
        break;
    case TIM_ARR:
        model->value[TIM_ARR / 4] = value;
        if ((model->value[TIM_CR1 / 4] & ARPE) == 0) {
            rebase(t, tick);
            if (t->running && t->reload == 0) {
                t->base_tick = tick;
            }
            t->reload = value;
        }
        break;
    case TIM_DMAR: burst_write(t, value); break;
    case TIM_DCR:
        t->burst_index = 0;
        model->value[offset / 4] = value;
        break;
    default:
        if (offset >= TIM_CCR1 && offset < TIM_CCR1 + 16) {
            const unsigned channel = (offset - TIM_CCR1) / 4;
            if (is_capture(t, channel)) {
                machine_violation(model->machine, "%s: CCR%u written, but it is read-only while the channel captures", model_name(model), channel + 1);
                break;
            }
            model->value[offset / 4] = value;
            if ((mode_bits(t, channel) & 8u) == 0) {
                t->compare[channel] = value;
                evaluate_reference(t, channel, false, position(t, tick), machine_now(model->machine));
            }
        } else {
            model->value[offset / 4] = value;
        }
        break;
    }
    plan(t);
}

static uint32_t get(model_t *model, uint32_t offset)
{
    tim_t *const t = (tim_t *)model;
    if (offset == TIM_SR || offset == TIM_CNT || offset == TIM_CR1 || offset == TIM_DMAR) {
        advance(t, now_tick(t));
    }
    if (offset == TIM_CNT) {
        return (uint32_t)position(t, now_tick(t));
    }
    if (offset == TIM_DMAR) {
        const uint32_t target = burst_register(t);
        const uint32_t value = target < TIM_DCR ? get(model, target) : 0;
        if (t->burst_index != 0 && t->burst_source != DMA_NONE) {
            dma_line_pulse(model->chip, t->burst_source);
        }
        return value;
    }
    if (offset >= TIM_CCR1 && offset < TIM_CCR1 + 16 && is_capture(t, (offset - TIM_CCR1) / 4)) {
        model->value[TIM_SR / 4] &= ~(2u << (offset - TIM_CCR1) / 4); /* Reading the capture clears its flag. */
        interrupt(t);
    }
    return offset == TIM_EGR ? 0 : reg(model, offset);
}

static void restart(model_t *model)
{
    tim_t *const t = (tim_t *)model;
    machine_cancel(model->machine, &t->event);
    t->running = false;
    t->base_count = 0;
    t->marked = -1;
    t->silent_trigger = false;
    t->burst_index = 0;
    load(t);
    t->repetition = 0;
    for (unsigned i = 0; i < 4; i++) {
        machine_cancel(model->machine, &t->input[i].filter);
        t->input[i].level = t->input[i].raw = false;
        t->reference[i] = t->output[i] = false;
        t->edges[i] = 0;
    }
    interrupt(t);
}

void tim_before_change(chip_t *chip)
{
    for (unsigned i = 0; i < TIM_COUNT; i++) {
        if (chip->tim[i]->running) {
            advance(chip->tim[i], now_tick(chip->tim[i]));
        }
    }
}

void tim_after_change(chip_t *chip)
{
    for (unsigned i = 0; i < TIM_COUNT; i++) {
        plan(chip->tim[i]);
    }
}

void tim_create(chip_t *chip)
{
    struct storage {
        tim_t tim[TIM_COUNT];
        model_description_t description[TIM_COUNT];
    } *const storage = chip_allocate(chip, sizeof *storage);
    for (unsigned i = 0; i < TIM_COUNT; i++) {
        tim_t *const t = &storage->tim[i];
        const tim_description_t *const what = &tim_descriptions[i];
        chip->tim[i] = t;
        t->what = what;
        t->clock = what->bus == BUS_APB2 ? &chip->timer2 : &chip->timer1;
        machine_event_init(&t->event, observed, t);
        for (unsigned n = 0; n < 4; n++) {
            t->input[n].timer = t;
            t->input[n].input = n;
            machine_event_init(&t->input[n].filter, filter_done, &t->input[n]);
        }
        storage->description[i] = (model_description_t){.name = what->name, .base = what->base, .size = 0x400, .bus = what->bus, .read_widths = WIDTH_ANY,
            .write_widths = WIDTH_16 | WIDTH_32, .registers = what->registers, .register_count = what->register_count, .get = get, .set = set, .restart = restart};
        model_attach(chip, &t->model, &storage->description[i]);
    }
}

void tim_pin_edge(machine_t *machine, unsigned pin, bool level, int64_t time_ps) { tim_edge(chip_of(machine), pin, level, time_ps); }

#include "core/timing/chip_clock.h"

#define FRACTION_BITS     32 /* Fractional bits of positions and periods. */
#define ONE               (INT64_C(1) << FRACTION_BITS)
#define HELD_CYCLES_MAX   1000u       /* Cycles after which the drift is left alone: long after the lock. */
#define DRIFT_MAX         (ONE / 600) /* Largest drift that is believed, 1 ppm/s: more is an outlier. */
#define UNSEEN_DRIFT_PPT  20000       /* Drift that nothing shows, millionths of a millionth a second: 0.02 ppm/s. */
#define SCATTER_BITS      8           /* Fractional bits of the scatter. */
#define SCATTER_EDGES     8           /* Edges over which it is averaged. */
#define MESSAGE_TICKS_MAX (1 << 26)   /* Largest time in a message, 0.4 s: its products stay below 2^63. */

const chip_clock_source_t chip_clock_wire = {.gate_ticks = 336, .lock_ticks = 84, .memory_edges = 6, .floor_ticks = 8};
const chip_clock_source_t chip_clock_link = {
    .gate_ticks = 504, .lock_ticks = 84, .memory_edges = 16, .floor_ticks = 42};
const chip_clock_source_t chip_clock_field = {
    .gate_ticks = 504, .lock_ticks = 84, .memory_edges = 16, .floor_ticks = 42};

/* Returns the largest deviation of a period or a cycle from nominal that two good crystals can show. */
static int64_t tolerance(int64_t nominal) {
    return nominal / 1000000 * CHIP_CLOCK_SEARCH_PPM;
}

static uint64_t nominal_period(const chip_clock_t *clock) {
    return (uint64_t)clock->config.nominal_ticks << FRACTION_BITS;
}

/* Returns the signed difference of two positions modulo 2^64. */
static int64_t difference(uint64_t a, uint64_t b) {
    return (int64_t)(a - b);
}

static void set_period(chip_clock_t *clock, int64_t period) {
    const int64_t nominal = (int64_t)nominal_period(clock);
    const int64_t limit = tolerance(nominal);
    /* Within these limits the planner always keeps up with the target: the two differ by at most half a chip. */
    const int64_t low = nominal - limit, high = nominal + limit;
    clock->period = (uint64_t)(period < low ? low : period > high ? high : period);
}

bool chip_clock_init(chip_clock_t *clock, const chip_clock_config_t *config) {
    const uint32_t margin = config->nominal_ticks / 100u;
    if (config->chips < 31u || config->chips > 2047u || config->minimum_ticks == 0u ||
        config->minimum_ticks + margin > config->nominal_ticks ||
        config->nominal_ticks + margin > config->maximum_ticks) {
        return false;
    }
    *clock = (chip_clock_t){.config = *config, .source = chip_clock_wire, .locked = !config->follow};
    clock->period = nominal_period(clock);
    return true;
}

/* A cycle begins without an edge in the one before: the period drifts on as it did. The filter's estimate is that of
 * alpha / beta cycles ago. */
static void hold_over(chip_clock_t *clock, uint32_t cycles) {
    const int64_t lag = cycles == 2u ? (4 * clock->memory - 2) / 6 : 0;
    const int64_t drift = clock->drift_edges == CHIP_CLOCK_DRIFT_CYCLES ? clock->drift : 0;
    set_period(clock, (int64_t)clock->period + drift * (1 + lag));
    const int64_t slope = drift < 0 ? -drift : drift;
    const int64_t moved = (slope * clock->config.chips >> FRACTION_BITS / 2) * cycles * cycles / 2;
    if (moved > (int64_t)clock->source.lock_ticks << FRACTION_BITS / 2 || cycles > CHIP_CLOCK_HOLDOVER_CYCLES) {
        clock->locked = false;
        clock->good_edges = 0;
    }
}

/* How many cycles began since the last edge: none while it is still to come, as a message may tell of a cycle before it
 * begins. */
static uint32_t cycles_without_edge(const chip_clock_t *clock) {
    const int32_t cycles = (int32_t)(clock->cycle - clock->edge_cycle);
    return cycles > 0 ? (uint32_t)cycles : 0u;
}

chip_clock_chip_t chip_clock_plan(chip_clock_t *clock) {
    clock->target += clock->period + ((uint64_t)(int64_t)clock->detune_ticks << FRACTION_BITS);
    /* The shift rounds down to whole ticks. */
    const int64_t wanted = difference(clock->target, (uint64_t)clock->position << FRACTION_BITS) >> FRACTION_BITS;
    const uint16_t period_ticks = wanted < clock->config.minimum_ticks   ? clock->config.minimum_ticks
                                  : wanted > clock->config.maximum_ticks ? clock->config.maximum_ticks
                                                                         : (uint16_t)wanted;
    const uint32_t slot = clock->chip % CHIP_CLOCK_HISTORY;
    clock->history[slot].position = clock->position;
    clock->history[slot].cycle = clock->cycle;
    clock->history[slot].code_chip = clock->code_chip;
    clock->history[slot].period_ticks = period_ticks;
    const chip_clock_chip_t planned = {clock->cycle + clock->cycle_shift, clock->code_chip, period_ticks,
                                       clock->position};

    clock->position += period_ticks;
    clock->chip++;
    clock->code_chip++;
    if (clock->code_chip == clock->config.chips) {
        clock->code_chip = 0;
        clock->cycle++;
        const uint32_t missed = cycles_without_edge(clock);
        if (clock->tracking && missed > 1u && missed <= HELD_CYCLES_MAX) {
            hold_over(clock, missed);
        }
    }
    return planned;
}

static void count_rejected(chip_clock_t *clock) {
    if (clock->edges_rejected < UINT32_MAX) {
        clock->edges_rejected++;
    }
}

bool chip_clock_mark(const chip_clock_t *clock, uint32_t chip, uint32_t ticks, chip_clock_mark_t *mark) {
    const uint32_t age = clock->chip - chip;
    if (age == 0u || age > CHIP_CLOCK_HISTORY || ticks > 2u * clock->config.maximum_ticks) {
        return false;
    }
    const uint32_t slot = chip % CHIP_CLOCK_HISTORY;
    const uint32_t chips = clock->config.chips, code_chip = clock->history[slot].code_chip;
    const int64_t period = (int64_t)clock->period;
    mark->position = clock->history[slot].position + ticks;
    mark->cycle = clock->history[slot].cycle + clock->cycle_shift;
    if (code_chip <= chips / 2u) {
        mark->cycle_ticks = (int32_t)((code_chip * period) >> FRACTION_BITS) + (int32_t)ticks;
    } else {
        /* The chips between this one's end and chip 0. */
        const int64_t whole = ((int64_t)code_chip + 1 - (int64_t)chips) * period;
        mark->cycle_ticks = (int32_t)(whole >> FRACTION_BITS) + (int32_t)ticks -
                            (int32_t)clock->history[slot].period_ticks;
        mark->cycle++;
    }
    return true;
}

/* Begins to learn the master's edges: none of those before counts. */
static void forget_edges(chip_clock_t *clock) {
    clock->candidate_edges = 0;
    clock->memory = 2;
    clock->drift = 0;
    clock->drift_edges = 0;
}

/* Jumps to the nearest chip of the master, whose period is the estimate's and who began chip 0 at edge. */
static void acquire(chip_clock_t *clock, uint64_t edge) {
    const uint64_t span = clock->period * clock->config.chips;
    int64_t lead = difference((uint64_t)clock->position << FRACTION_BITS, edge);
    uint32_t ahead = 0;
    for (; lead < 0; lead += (int64_t)span) { /* A message may tell of a cycle to come. */
        edge -= span;
        ahead++;
    }
    const uint32_t chips = (uint32_t)(((uint64_t)lead + clock->period / 2u) / clock->period);
    clock->target = edge + chips * clock->period;
    clock->code_chip = (uint16_t)(chips % clock->config.chips);
    clock->cycle++; /* The cycle under way is cut short. */
    clock->edge_cycle = clock->cycle - chips / clock->config.chips + ahead;
    clock->tracking = true;
    clock->locked = false;
    clock->good_edges = 0;
    forget_edges(clock);
    clock->scatter = (uint32_t)clock->source.lock_ticks << SCATTER_BITS >> 2;
}

/* Takes what an edge was off the estimate, ticks with 32 fractional bits. */
static void learn_scatter(chip_clock_t *clock, int64_t residual) {
    const int32_t size = (int32_t)((residual < 0 ? -residual : residual) >> (FRACTION_BITS - SCATTER_BITS));
    clock->scatter = (uint32_t)((int32_t)clock->scatter + (size - (int32_t)clock->scatter) / SCATTER_EDGES);
}

/* Takes the change of the settled period in so many cycles. */
static void learn_drift(chip_clock_t *clock, int64_t change, int32_t cycles) {
    const int64_t told = change / cycles;
    if (clock->drift_edges < CHIP_CLOCK_DRIFT_CYCLES) {
        clock->drift_edges++;
    }
    clock->drift += ((told < -DRIFT_MAX  ? -DRIFT_MAX
                      : told > DRIFT_MAX ? DRIFT_MAX
                                         : told) -
                     clock->drift) /
                    clock->drift_edges;
}

/* Returns ticks of the master as own ones, with 32 fractional bits. */
static int64_t own_ticks(const chip_clock_t *clock, int32_t master_ticks) {
    const int64_t slower = (int64_t)(clock->period - nominal_period(clock));
    return (int64_t)master_ticks * ONE + master_ticks * slower / clock->config.nominal_ticks;
}

/* Takes an edge that fits no estimate, which came `since` ticks of the master before position, and compares it with
 * the candidate: edges whole cycles apart make an estimate. Returns true if they led to one. */
static bool search(chip_clock_t *clock, uint64_t position, int32_t since) {
    const uint32_t chips = clock->config.chips, chip = clock->chip;
    const int64_t cycle = (int64_t)nominal_period(clock) * (int64_t)chips;
    if (clock->candidate_edges > 0u) {
        int64_t cycles = 0, off = INT64_MAX;
        const int64_t own = difference(position, clock->candidate_position);
        int64_t masters = (since - clock->candidate_since) * ONE;
        if (chip - clock->candidate_chip <= (CHIP_CLOCK_SEARCH_CYCLES + 1u) * chips) {
            off = own - masters;
            while (cycles < CHIP_CLOCK_SEARCH_CYCLES && off > tolerance(masters)) {
                masters += cycle;
                off -= cycle;
                cycles++;
            }
        }
        const int64_t limit = tolerance(masters);
        if (cycles > 0 && off >= -limit && off <= limit) {
            clock->candidate_edges++;
            clock->candidate_chip = chip;
            clock->candidate_position = position;
            clock->candidate_since = since;
            const bool found = clock->candidate_edges == (clock->tracking ? 3u : 2u);
            if (found) {
                set_period(clock, own / (masters >> FRACTION_BITS) * clock->config.nominal_ticks);
                acquire(clock, position - (uint64_t)own_ticks(clock, since));
            }
            return found;
        }
        if (!clock->tracking) {
            count_rejected(clock);
        }
        if (cycles <= 1 && off < 0) {
            return false; /* It came within a cycle of the candidate, and is more likely the glitch of the two. */
        }
    }
    clock->candidate_edges = 1;
    clock->candidate_chip = chip;
    clock->candidate_position = position;
    clock->candidate_since = since;
    return false;
}

/* Takes the edge of a master who began a cycle `since` of its ticks before position, where the chip clock was early by
 * phase. Returns true if the estimate now counts this edge. */
static bool take_edge(chip_clock_t *clock, uint64_t position, int32_t since, int32_t phase) {
    if (!clock->tracking) {
        return search(clock, position, since);
    }
    const uint64_t edge = position - (uint64_t)own_ticks(clock, since);
    /* The estimate's start of a cycle that is nearest to the edge lies `ahead` chips before the next chip to plan. */
    const int32_t chips = clock->config.chips;
    const int64_t span = (int64_t)clock->period * chips;
    int32_t ahead = clock->code_chip;
    uint32_t cycle = clock->cycle;
    int64_t residual = difference(edge, clock->target - (uint64_t)clock->code_chip * clock->period);
    for (; residual < -span / 2; residual += span) {
        ahead += chips;
        cycle--;
    }
    for (; residual > span / 2; residual -= span) {
        ahead -= chips;
        cycle++;
    }
    const int32_t cycles = (int32_t)(cycle - clock->edge_cycle);
    const int64_t gate = (int64_t)clock->source.gate_ticks << FRACTION_BITS;
    if (cycles <= 0 || residual > gate || residual < -gate) {
        count_rejected(clock);
        return search(clock, position, since);
    }
    if (!clock->compared) {
        clock->phase_ticks = phase;
    }
    learn_scatter(clock, residual);
    if (clock->memory < clock->source.memory_edges) {
        clock->memory++;
    }
    const int64_t before = (int64_t)clock->period, edges = clock->memory, divisor = edges * (edges + 1);
    set_period(clock, before + residual * 6 / divisor / ((int64_t)cycles * chips));
    clock->target += (uint64_t)(residual * (4 * edges - 2) / divisor + ((int64_t)clock->period - before) * ahead);
    if (clock->memory == clock->source.memory_edges) {
        learn_drift(clock, (int64_t)clock->period - before, cycles);
    }
    clock->edge_cycle = cycle;
    clock->candidate_edges = 0;
    if (phase > clock->source.lock_ticks || phase < -clock->source.lock_ticks) {
        clock->good_edges = 0;
    } else if (clock->good_edges < CHIP_CLOCK_LOCK_EDGES) {
        clock->good_edges++;
    }
    clock->locked = clock->good_edges == CHIP_CLOCK_LOCK_EDGES;
    return true;
}

bool chip_clock_edge(chip_clock_t *clock, uint32_t chip, uint16_t ticks) {
    chip_clock_mark_t mark;
    if (!clock->config.follow) {
        return false;
    }
    if (ticks > clock->config.maximum_ticks || !chip_clock_mark(clock, chip, ticks, &mark)) {
        count_rejected(clock);
        return false;
    }
    return take_edge(clock, (uint64_t)mark.position << FRACTION_BITS, 0, mark.cycle_ticks);
}

/* Returns the phase against a message, ticks with 32 fractional bits. */
static int64_t message_phase(const chip_clock_t *clock, const chip_clock_mark_t *mark, int32_t master_ticks) {
    const int64_t cycle = (int64_t)clock->period * clock->config.chips;
    const int64_t phase = (mark->cycle_ticks * ONE - own_ticks(clock, master_ticks)) % cycle;
    return phase + (phase < -cycle / 2 ? cycle : phase > cycle / 2 ? -cycle : 0);
}

static bool dated(int32_t master_ticks) {
    return master_ticks <= MESSAGE_TICKS_MAX && master_ticks >= -MESSAGE_TICKS_MAX;
}

int32_t chip_clock_told(const chip_clock_t *clock, int32_t ticks) {
    const int64_t slower = (int64_t)(clock->period - nominal_period(clock));
    const int64_t more = ticks * slower / (int64_t)(clock->period >> FRACTION_BITS);
    return ticks - (int32_t)((more + ONE / 2) >> FRACTION_BITS);
}

bool chip_clock_phase(const chip_clock_t *clock, const chip_clock_mark_t *mark, int32_t master_ticks, int32_t *phase) {
    if (dated(master_ticks)) {
        *phase = (int32_t)(message_phase(clock, mark, master_ticks) >> FRACTION_BITS) + clock->late_ticks;
    }
    return dated(master_ticks);
}

bool chip_clock_message(chip_clock_t *clock, const chip_clock_mark_t *mark, int32_t master_ticks) {
    if (!clock->config.follow) {
        return false;
    }
    if (!dated(master_ticks)) {
        count_rejected(clock);
        return false;
    }
    const int32_t phase = (int32_t)(message_phase(clock, mark, master_ticks) >> FRACTION_BITS);
    return take_edge(clock, (uint64_t)mark->position << FRACTION_BITS, master_ticks, phase);
}

bool chip_clock_at(const chip_clock_t *clock, uint32_t chip, chip_clock_chip_t *planned) {
    const uint32_t age = clock->chip - chip;
    if (age == 0u || age > CHIP_CLOCK_HISTORY) {
        return false;
    }
    const uint32_t slot = chip % CHIP_CLOCK_HISTORY;
    planned->cycle = clock->history[slot].cycle + clock->cycle_shift;
    planned->code_chip = clock->history[slot].code_chip;
    planned->period_ticks = clock->history[slot].period_ticks;
    planned->position = clock->history[slot].position;
    return true;
}

bool chip_clock_contested(const chip_clock_t *clock) {
    return clock->tracking && clock->candidate_edges > 0u && cycles_without_edge(clock) > 1u &&
           clock->chip - clock->candidate_chip <= clock->config.chips;
}

void chip_clock_jump(chip_clock_t *clock, uint64_t edge, uint64_t period) {
    if (clock->config.follow) {
        set_period(clock, (int64_t)period);
        acquire(clock, edge);
    }
}

void chip_clock_correct(chip_clock_t *clock, int64_t phase, int64_t period, int32_t residual_ticks, bool locked) {
    if (!clock->config.follow) {
        return;
    }
    set_period(clock, (int64_t)clock->period + period);
    clock->target += (uint64_t)phase;
    if (!clock->compared) {
        clock->phase_ticks = residual_ticks;
    }
    learn_scatter(clock, (int64_t)residual_ticks * ONE);
    clock->drift = 0;
    clock->drift_edges = 0;
    clock->edge_cycle = clock->cycle;
    clock->locked = locked;
}

void chip_clock_late(chip_clock_t *clock, int16_t ticks) {
    clock->target += (uint64_t)((int64_t)(ticks - clock->late_ticks) * ONE);
    clock->late_ticks = ticks;
}

chip_clock_quality_t chip_clock_quality(const chip_clock_t *clock, uint32_t ticks_per_us) {
    const int64_t slower = difference(clock->period, nominal_period(clock)) >> SCATTER_BITS;
    chip_clock_quality_t quality = {.age_us = UINT32_MAX, .error_ns = UINT32_MAX};
    quality.rate_ppb = (int32_t)(slower * 1000000000 /
                                 ((int64_t)clock->config.nominal_ticks << (FRACTION_BITS - SCATTER_BITS)));
    if (!clock->config.follow) {
        quality.age_us = 0;
        quality.error_ns = 0;
        return quality;
    }
    const uint32_t cycles = cycles_without_edge(clock);
    if (!clock->tracking || cycles > HELD_CYCLES_MAX) {
        return quality;
    }
    const uint64_t chips = (uint64_t)cycles * clock->config.chips + clock->code_chip;
    const uint64_t age_us = chips * clock->config.nominal_ticks / ticks_per_us;
    const uint64_t scatter = clock->scatter;
    const uint64_t slope = (uint64_t)(clock->drift < 0 ? -clock->drift : clock->drift) * clock->config.chips;
    const uint64_t held = cycles > 1u ? cycles : 0u;
    const uint64_t age_ms = age_us / 1000u;
    /* All in 1/256 ticks; in t ms an unseen drift makes drift t^2 / 2. */
    const uint64_t error = ((uint64_t)clock->source.floor_ticks << SCATTER_BITS) + 2u * scatter +
                           held * 2u * scatter / clock->memory +
                           (slope >> (FRACTION_BITS - SCATTER_BITS)) * held * held / 2u +
                           age_ms * age_ms * UNSEEN_DRIFT_PPT / 2000000u * (ticks_per_us << SCATTER_BITS) / 1000000u;
    const uint64_t error_ns = error * 1000u / ((uint64_t)ticks_per_us << SCATTER_BITS);
    quality.age_us = (uint32_t)age_us;
    quality.error_ns = error_ns < UINT32_MAX ? (uint32_t)error_ns : UINT32_MAX;
    return quality;
}

void chip_clock_forget(chip_clock_t *clock, const chip_clock_source_t *source) {
    clock->source = *source;
    clock->tracking = false;
    clock->locked = false;
    clock->compared = false;
    clock->detune_ticks = 0;
    clock->late_ticks = 0;
    clock->candidate_edges = 0;
}

void chip_clock_change(chip_clock_t *clock, const chip_clock_source_t *source) {
    clock->source = *source;
    clock->memory = source->memory_edges;
    clock->compared = false;
    clock->candidate_edges = 0;
}

bool chip_clock_compare(chip_clock_t *clock, uint32_t chip, uint16_t ticks) {
    chip_clock_mark_t mark;
    if (ticks > clock->config.maximum_ticks || !chip_clock_mark(clock, chip, ticks, &mark)) {
        return false;
    }
    clock->phase_ticks = mark.cycle_ticks;
    clock->compared = true;
    const int32_t gate = clock->source.gate_ticks;
    const int32_t phase = mark.cycle_ticks + clock->late_ticks;
    return phase >= -gate && phase <= gate;
}

/* ---- Leading ---- */

void chip_clock_lead(chip_clock_t *clock, bool anew) {
    clock->config.follow = false;
    clock->tracking = false;
    clock->locked = true;
    clock->compared = false;
    clock->detune_ticks = 0;
    clock->phase_ticks = 0;
    if (anew) {
        clock->code_chip = 0;
        clock->cycle++; /* The cycle under way is cut short. */
        clock->cycle_shift = 0u - clock->cycle;
    }
}

void chip_clock_yield(chip_clock_t *clock, const chip_clock_source_t *source) {
    clock->source = *source;
    clock->tracking = true;
    clock->good_edges = CHIP_CLOCK_LOCK_EDGES;
    forget_edges(clock);
    clock->edge_cycle = clock->cycle - 1u;
    clock->compared = false;
    clock->config.follow = true;
}

void chip_clock_number_cycle(chip_clock_t *clock, uint32_t cycle) {
    clock->cycle_shift = cycle - clock->edge_cycle;
}

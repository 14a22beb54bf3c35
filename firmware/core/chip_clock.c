#include "chip_clock.h"

#define FRACTION_BITS 32
#define GATE ((int64_t)CHIP_CLOCK_GATE_TICKS << FRACTION_BITS)

/* Largest deviation of a period or a cycle from nominal that two good crystals can show. */
static int64_t tolerance(uint64_t nominal) {
    return (int64_t)(nominal / 1000000u * CHIP_CLOCK_SEARCH_PPM);
}

static uint64_t nominal_period(const chip_clock_t *clock) {
    return (uint64_t)clock->config.nominal_ticks << FRACTION_BITS;
}

/* Signed difference of two positions modulo 2^64. */
static int64_t difference(uint64_t a, uint64_t b) {
    return (int64_t)(a - b);
}

static void set_period(chip_clock_t *clock, int64_t period) {
    const int64_t nominal = (int64_t)nominal_period(clock);
    const int64_t limit = tolerance(nominal_period(clock));
    /* Within these limits the planner always keeps up with the target: they differ by at most half a chip, for ever. */
    const int64_t low = nominal - limit, high = nominal + limit;
    clock->period = (uint64_t)(period < low ? low : period > high ? high : period);
}

bool chip_clock_init(chip_clock_t *clock, const chip_clock_config_t *config) {
    const uint32_t margin = config->nominal_ticks / 100u;
    if (config->chips < 31u || config->chips > 2047u || config->nominal_ticks == 0u || config->minimum_ticks == 0u ||
        config->minimum_ticks + margin > config->nominal_ticks || config->nominal_ticks + margin > config->maximum_ticks) {
        return false;
    }
    *clock = (chip_clock_t){.config = *config, .locked = !config->follow};
    clock->period = nominal_period(clock);
    return true;
}

chip_clock_chip_t chip_clock_plan(chip_clock_t *clock) {
    clock->target += clock->period + ((uint64_t)(int64_t)clock->detune_ticks << FRACTION_BITS);
    const int64_t wanted = difference(clock->target, (uint64_t)clock->position << FRACTION_BITS) >> FRACTION_BITS; /* Rounds down. */
    const uint16_t period_ticks = wanted < clock->config.minimum_ticks   ? clock->config.minimum_ticks
                                  : wanted > clock->config.maximum_ticks ? clock->config.maximum_ticks
                                                                         : (uint16_t)wanted;
    const uint32_t slot = clock->chip % CHIP_CLOCK_HISTORY;
    clock->history[slot].position = clock->position;
    clock->history[slot].cycle = clock->cycle;
    clock->history[slot].code_chip = clock->code_chip;
    clock->history[slot].period_ticks = period_ticks;
    const chip_clock_chip_t planned = {clock->cycle + clock->cycle_shift, clock->code_chip, period_ticks, clock->position};

    clock->position += period_ticks;
    clock->chip++;
    clock->code_chip++;
    if (clock->code_chip == clock->config.chips) {
        clock->code_chip = 0;
        clock->cycle++;
        if (clock->config.follow && clock->cycle - clock->edge_cycle > CHIP_CLOCK_HOLDOVER_CYCLES) {
            clock->locked = false;
            clock->good_edges = 0;
        }
    }
    return planned;
}

static void count_rejected(chip_clock_t *clock) {
    if (clock->edges_rejected < UINT32_MAX) {
        clock->edges_rejected++;
    }
}

/* Chip clock minus sync wire at an edge, by the chip that was really executing. */
static int32_t phase_at(const chip_clock_t *clock, uint32_t slot, uint32_t ticks) {
    const uint32_t chips = clock->config.chips;
    const uint32_t code_chip = clock->history[slot].code_chip;
    const int64_t period = (int64_t)clock->period;
    if (code_chip <= chips / 2u) {
        return (int32_t)((code_chip * period) >> FRACTION_BITS) + (int32_t)ticks;
    }
    const int64_t whole = ((int64_t)code_chip + 1 - (int64_t)chips) * period; /* Chips between this one's end and chip 0. */
    return (int32_t)(whole >> FRACTION_BITS) + (int32_t)ticks - (int32_t)clock->history[slot].period_ticks;
}

/* The master began chip 0 at edge and has this period: take both over, and jump to its nearest chip. */
static void acquire(chip_clock_t *clock, uint64_t edge, int64_t period) {
    set_period(clock, period);
    const int64_t lead = difference((uint64_t)clock->position << FRACTION_BITS, edge);
    const uint32_t chips = lead <= 0 ? 0u : (uint32_t)(((uint64_t)lead + clock->period / 2u) / clock->period);
    clock->target = edge + chips * clock->period;
    clock->code_chip = (uint16_t)(chips % clock->config.chips);
    clock->cycle++; /* The cycle under way is cut short. */
    clock->edge_cycle = clock->cycle - chips / clock->config.chips;
    clock->tracking = true;
    clock->locked = false;
    clock->good_edges = 0;
    clock->candidate_edges = 0;
}

/* An edge that fits no estimate: look for others whole cycles apart from it. */
static void search(chip_clock_t *clock, uint32_t chip, uint64_t edge) {
    const uint32_t chips = clock->config.chips;
    const uint64_t cycle = nominal_period(clock) * chips;
    if (clock->candidate_edges > 0u) {
        uint32_t cycles = 0;
        int64_t off = INT64_MAX;
        if (chip - clock->candidate_chip <= (CHIP_CLOCK_SEARCH_CYCLES + 1u) * chips) {
            off = difference(edge, clock->candidate_position);
            while (cycles < CHIP_CLOCK_SEARCH_CYCLES && off > tolerance(cycle) * cycles) {
                off -= (int64_t)cycle;
                cycles++;
            }
        }
        const int64_t limit = tolerance(cycle) * cycles;
        if (cycles > 0u && off >= -limit && off <= limit) {
            const int64_t period = difference(edge, clock->candidate_position) / (int64_t)(cycles * chips);
            clock->candidate_edges++;
            clock->candidate_chip = chip;
            clock->candidate_position = edge;
            if (clock->candidate_edges == (clock->tracking ? 3u : 2u)) {
                acquire(clock, edge, period);
            }
            return;
        }
        if (!clock->tracking) {
            count_rejected(clock);
        }
        if (cycles <= 1u && off < 0) {
            return; /* Sooner than a cycle after the candidate: more likely a glitch than the candidate was. */
        }
    }
    clock->candidate_edges = 1;
    clock->candidate_chip = chip;
    clock->candidate_position = edge;
}

void chip_clock_edge(chip_clock_t *clock, uint32_t chip, uint16_t ticks) {
    if (!clock->config.follow) {
        return;
    }
    const uint32_t age = clock->chip - chip;
    if (age == 0u || age > CHIP_CLOCK_HISTORY || ticks > clock->config.maximum_ticks) {
        count_rejected(clock);
        return;
    }
    const uint32_t slot = chip % CHIP_CLOCK_HISTORY;
    const uint64_t edge = (uint64_t)(clock->history[slot].position + ticks) << FRACTION_BITS;
    if (!clock->tracking) {
        search(clock, chip, edge);
        return;
    }

    /* The estimate's start of a cycle nearest to the edge: ahead chips before the next chip to plan. */
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
    if (cycles <= 0 || residual > GATE || residual < -GATE) {
        count_rejected(clock);
        search(clock, chip, edge);
        return;
    }
    clock->phase_ticks = phase_at(clock, slot, ticks);
    const int64_t before = (int64_t)clock->period;
    set_period(clock, before + residual / 8 / ((int64_t)cycles * chips));
    clock->target += (uint64_t)(residual / 2 + ((int64_t)clock->period - before) * ahead);
    clock->edge_cycle = cycle;
    clock->candidate_edges = 0;
    if (clock->phase_ticks > CHIP_CLOCK_LOCK_TICKS || clock->phase_ticks < -CHIP_CLOCK_LOCK_TICKS) {
        clock->good_edges = 0;
    } else if (clock->good_edges < CHIP_CLOCK_LOCK_EDGES) {
        clock->good_edges++;
    }
    clock->locked = clock->good_edges == CHIP_CLOCK_LOCK_EDGES;
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

void chip_clock_jump(chip_clock_t *clock, uint64_t edge, uint64_t period) {
    if (clock->config.follow) {
        acquire(clock, edge, (int64_t)period);
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
    clock->edge_cycle = clock->cycle;
    clock->locked = locked;
}

void chip_clock_forget(chip_clock_t *clock) {
    clock->tracking = false;
    clock->locked = false;
    clock->compared = false;
    clock->detune_ticks = 0;
    clock->good_edges = 0;
    clock->candidate_edges = 0;
}

void chip_clock_compare(chip_clock_t *clock, uint32_t chip, uint16_t ticks) {
    const uint32_t age = clock->chip - chip;
    if (age > 0u && age <= CHIP_CLOCK_HISTORY && ticks <= clock->config.maximum_ticks) {
        clock->phase_ticks = phase_at(clock, chip % CHIP_CLOCK_HISTORY, ticks);
        clock->compared = true;
    }
}

void chip_clock_number_cycle(chip_clock_t *clock, uint32_t cycle) {
    clock->cycle_shift = cycle - clock->edge_cycle;
}

#include "core/drive/current.h"

#include <string.h>

#define REFERENCE_MAX   4095   /* Largest set-point, counts. */
#define KEPT_RAMPING    0.875f /* Share of the old sums that is kept block after block. */
#define KEPT_HOLDING    0.96875f
#define PRIOR           0.0625f  /* Chips that asked for nothing and got nothing. */
#define ADAPTED         0.25f    /* Largest change of the set-point from that of a driver without error. */
#define OFFSET_SHARE    0.1f     /* Largest offset, of the amplitude. */
#define ONE             65536.0f /* The factor 1 with 16 fractional bits. */
#define FINE            16       /* Parts of a count in which set-points are planned. */
#define SHORT_COUNTS    6        /* A chip may be so much off what is expected, counts of sense, */
#define SHORT_SHIFT     6        /* and 1/64; */
#define LEFT_OUT_SHIFT  3        /* short by 1/8 more it does not count. */
#define SHORT_AMPLITUDE 0.995f   /* Share of the target below which headroom is lost. */
#define WAY_DONE        3        /* Amid a chip the current has done 3/8 of its way, */
#define WAY_PARTS       8        /* see current.h. */
#define SHORT_BLOCKS    33u      /* Blocks for which that is told: a cycle of degree 10. */

bool current_configure(current_t *current, const current_config_t *config) {
    /* The comparisons are written so that a value that is not a number fails. */
    if (!(config->reference_A > 0.0f && config->amplitude_A >= 0.0f && config->open_fraction >= 0.0f &&
          config->open_fraction <= 1.0f)) {
        return false;
    }
    const float scale = config->reference_A / config->sense_A; /* Where it is above 0, the sense is. */
    if (!(config->amplitude_A / config->sense_A <= (float)(CURRENT_MID_SCALE - 1) && scale >= 1.0f / 1024.0f &&
          scale <= 8.0f)) {
        return false;
    }
    guard_t guard = current->guard;
    if (!guard_configure(&guard, &config->guard, config->sense_A, config->reference_A)) {
        return false;
    }
    const float least_A = config->amplitude_A > 4.0f * CURRENT_OPEN_MINIMUM_A ? 0.25f * config->amplitude_A
                                                                              : CURRENT_OPEN_MINIMUM_A;
    const float open_above = config->open_fraction > 0.0f ? least_A / config->reference_A : (float)REFERENCE_MAX;
    *current = (current_t){
        .state = CURRENT_OFF,
        .zero = current->zero,
        .zeros = current->zeros,
        .guard = guard,
        .config = *config,
        .open_above = (uint16_t)(open_above < (float)REFERENCE_MAX ? open_above : (float)REFERENCE_MAX),
        .open_share = (uint32_t)(config->open_fraction * ONE),
    };
    return true;
}

bool current_alike(const current_t *one, const current_t *other) {
    const current_config_t *const a = &one->config, *const b = &other->config;
    return a->sense_A == b->sense_A && a->reference_A == b->reference_A && a->amplitude_A == b->amplitude_A &&
           a->open_fraction == b->open_fraction && a->several_levels == b->several_levels;
}

bool current_ready(const current_t *current) {
    return current->zeros >= CURRENT_ZERO_CHIPS;
}

/* The state is written last: the interrupts act on it. */
static void set_state(current_t *current, current_state_t state) {
    __atomic_store_n(&current->state, (uint8_t)state, __ATOMIC_RELEASE);
}

void current_start(current_t *current) {
    if (current->state != CURRENT_OFF) {
        return;
    }
    memset(current->line, 0, sizeof current->line);
    for (uint32_t i = 0; i < 2u; i++) {
        current->line[i].gain = current->config.reference_A / current->config.sense_A;
        current->line[i].gain_q = (uint32_t)(current->line[i].gain * ONE);
    }
    current->reference = 0;
    current->measured_A = 0.0f;
    current->dc_A = 0.0f;
    current->target_A = 0.0f;
    current->chips = 0;
    current->headroom_lost = false;
    current->strayed = false;
    current->short_blocks = 0;
    set_state(current, CURRENT_RAMPING);
}

void current_stop(current_t *current) {
    if (current->state != CURRENT_FAULT) {
        set_state(current, CURRENT_OFF);
    }
    current->reference = 0;
    current->line[0].scale = 0;
    current->line[1].scale = 0;
    current->headroom_lost = false;
}

/* Returns the set-point with which a direction brings a level along it, 1/16 counts; below 0 it cannot. */
static int32_t wanted(const current_line_t *line, int32_t along) {
    return along * (int32_t)line->scale / CURRENT_ONE - line->shift + line->carry;
}

int16_t current_set_point(current_t *current, int32_t level) {
    const int32_t size = level < 0 ? -level : level;
    bool negative = level < 0;
    if (size == 0 || current->line[negative].scale == 0u) {
        return 0;
    }
    int32_t fine = wanted(&current->line[negative], size);
    const int32_t other = fine < 0 ? wanted(&current->line[!negative], -size) : 0;
    if (other > 0) { /* This direction's offset alone is more than the level. */
        fine = other;
        negative = !negative;
    }
    current_line_t *const line = &current->line[negative];
    int32_t count = (fine + FINE / 2) >> 4;
    if (count < 0 || count > REFERENCE_MAX) {
        current->strayed |= count > 0;
        count = count < 0 ? 0 : REFERENCE_MAX;
        line->carry = 0;
    } else {
        line->carry = fine - count * FINE;
    }
    return (int16_t)(negative ? -count : count);
}

static float within(float value, float low, float high) {
    return value < low ? low : value > high ? high : value;
}

/* Adds the sums of the block to those that forget; a direction that had no chip forgets nothing. */
static void gather(current_line_t *line, float kept) {
    if (line->block_count == 0) {
        return;
    }
    line->count = kept * line->count + (float)line->block_count;
    line->asked = kept * line->asked + (float)line->block_asked;
    line->came = kept * line->came + (float)line->block_came;
    line->product = kept * line->product + (float)line->block_product;
    line->square = kept * line->square + (float)line->block_square;
    line->block_count = line->block_asked = line->block_came = line->block_product = line->block_square = 0;
}

/* Fits the line of a direction, and the set-point that it needs for the target. */
static void fit(current_t *current, current_line_t *line, float sign) {
    const current_config_t *const config = &current->config;
    const float nominal = config->reference_A / config->sense_A; /* Counts of sense for one of reference. */
    const float n = line->count + PRIOR, spread = n * line->square - line->asked * line->asked;
    const float zero = sign * current->zero;
    const float came = line->came - zero * line->count, product = line->product - zero * line->asked;
    if (!config->several_levels) {
        line->gain = line->square > 0.0f ? product / line->square : nominal; /* The offset stays 0. */
    } else {
        line->gain = spread > 0.0f ? (n * product - line->asked * came) / spread : nominal;
        line->offset = (came - line->gain * line->asked) / n;
    }
    const float gain = within(line->gain, nominal / (1.0f + ADAPTED), nominal / (1.0f - ADAPTED));
    const float most = OFFSET_SHARE * config->amplitude_A / config->sense_A;
    const float offset = within(line->offset, -most, most);
    line->gain_q = (uint32_t)(gain * ONE);
    line->offset_q = (int32_t)offset;
    const float limit = (float)(REFERENCE_MAX * FINE);
    line->shift = (int32_t)(offset / gain * (float)FINE);
    line->scale = (uint32_t)within(current->target_A / (gain * config->sense_A) * (float)FINE + 0.5f, 0.0f, limit);
}

/* Tells what came of the block, with the set-points that were in force, and plans the next ones. */
static void end_block(current_t *current) {
    const current_config_t *const config = &current->config;
    const bool holding = current->state == CURRENT_HOLDING;
    const float next = current->target_A + config->amplitude_A / (float)CURRENT_RAMP_BLOCKS;
    const bool arrived = next >= config->amplitude_A * 0.99999f; /* 33 thirty-thirds may fall short of one. */
    float level[2] = {0.0f, 0.0f};
    current->target_A = arrived ? config->amplitude_A : next;
    uint32_t reference = 0;
    for (uint32_t i = 0; i < 2u; i++) {
        current_line_t *const line = &current->line[i];
        const float set_point = (float)((int32_t)line->scale - line->shift) / (float)FINE;
        gather(line, holding ? KEPT_HOLDING : KEPT_RAMPING);
        fit(current, line, i == 0 ? 1.0f : -1.0f);
        if (line->count > 0.0f) {
            const int32_t wanted = ((int32_t)line->scale - line->shift + FINE / 2) / FINE;
            const uint32_t count = (uint32_t)(wanted < 0 ? 0 : wanted > REFERENCE_MAX ? REFERENCE_MAX : wanted);
            level[i] = (set_point * line->gain + line->offset) * config->sense_A;
            reference = count > reference ? count : reference;
        }
    }
    const bool both = current->line[0].count > 0.0f && current->line[1].count > 0.0f;
    current->measured_A = both ? 0.5f * (level[0] + level[1]) : level[0] + level[1];
    current->dc_A = both ? 0.5f * (level[0] - level[1]) : 0.0f;
    current->reference = (uint16_t)reference;
    if (holding && (current->strayed || current->measured_A < SHORT_AMPLITUDE * current->target_A)) {
        current->short_blocks = SHORT_BLOCKS;
    }
    current->headroom_lost = current->short_blocks > 0u;
    current->short_blocks = (uint8_t)(current->short_blocks - current->headroom_lost);
    current->strayed = false;
    current->chips = 0;
    current->state = arrived ? CURRENT_HOLDING : CURRENT_RAMPING;
}

/* A chip without current tells the zero of the sense; the first after a driven one may still see the current fall. */
static void take_zero(current_t *current, int32_t came) {
    if (current->quiet) {
        if (current->zeros < CURRENT_ZERO_MEMORY) {
            current->zeros++;
        }
        current->zero += ((float)came - current->zero) / (float)current->zeros;
    }
    current->quiet = true;
}

/* Returns the current in a direction, counts of sense from its zero. */
static int32_t along_of(const current_t *current, bool negative, int32_t came) {
    const int32_t above = came - (int32_t)current->zero;
    return negative ? -above : above;
}

/* Returns what a chip that asks for so much is expected to bring in its direction, counts of sense. */
static int32_t expect(const current_line_t *line, uint32_t asked) {
    return (int32_t)(asked * line->gain_q >> 16) + line->offset_q;
}

/* Returns the least of it with which the coil is not open. */
static int32_t least_of(const current_t *current, int32_t expected) {
    return (int32_t)((uint32_t)(expected > 0 ? expected : 0) * current->open_share >> 16);
}

/* Returns whether the coil is open amid a chip: neither has the current arrived, nor does it move as one that will. */
static bool stands_still(const current_t *current, uint32_t asked, bool negative, int32_t began, int32_t came) {
    if (asked <= current->open_above) {
        return false;
    }
    const int32_t start = along_of(current, negative, began), along = along_of(current, negative, came);
    const int32_t least = least_of(current, expect(&current->line[negative], asked));
    const int32_t way = least > start ? least - start : 0;
    return along < least - way + way * WAY_DONE / WAY_PARTS;
}

/* Returns whether the coil is open, and keeps the chip for the line. */
static bool take_driven(current_t *current, uint32_t asked, bool negative, int32_t came) {
    current_line_t *const line = &current->line[negative];
    const int32_t along = along_of(current, negative, came), sensed = negative ? -came : came;
    const int32_t expected = expect(line, asked);
    if (asked > current->open_above && along < least_of(current, expected)) {
        return true;
    }
    const bool holding = current->state == CURRENT_HOLDING;
    const int32_t allowed = (expected >> SHORT_SHIFT) + SHORT_COUNTS, missing = expected - along;
    current->strayed |= missing > allowed || missing < -allowed;
    if (!holding || (asked > 0u && missing <= allowed + (expected >> LEFT_OUT_SHIFT))) {
        line->block_count++;
        line->block_asked += (int32_t)asked;
        line->block_came += sensed;
        line->block_product += (int32_t)asked * sensed;
        line->block_square += (int32_t)(asked * asked);
    }
    current->chips++;
    if (current->chips == CURRENT_BLOCK_CHIPS) {
        end_block(current);
    }
    return false;
}

/* The bridge is about to go off. */
static cause_t fail(current_t *current, cause_t cause) {
    current->reference = 0;
    current->cause = (uint8_t)cause;
    set_state(current, CURRENT_FAULT);
    return cause;
}

/* Returns why the current is in its fault state. Without a cause nobody has put it there: a bit of the state flipped.
 */
static cause_t standing(const current_t *current) {
    return current->cause != (uint8_t)CAUSE_NONE ? (cause_t)current->cause : CAUSE_EXCESS;
}

static uint32_t size_of(int16_t set_point) {
    return (uint32_t)(set_point < 0 ? -set_point : set_point);
}

cause_t current_edge(current_t *current, int16_t set_point, uint16_t count) {
    if (current->state == CURRENT_FAULT) {
        return standing(current);
    }
    const cause_t cause = guard_edge(&current->guard, size_of(set_point), (int32_t)count - CURRENT_MID_SCALE);
    return cause != CAUSE_NONE ? fail(current, cause) : CAUSE_NONE;
}

cause_t current_middle(current_t *current, int16_t set_point, uint16_t start, uint16_t count) {
    const cause_t cause = current_edge(current, set_point, count);
    if (cause != CAUSE_NONE || current->state == CURRENT_OFF) {
        return cause;
    }
    const int32_t began = (int32_t)start - CURRENT_MID_SCALE, came = (int32_t)count - CURRENT_MID_SCALE;
    const bool open = stands_still(current, size_of(set_point), set_point < 0, began, came);
    return open ? fail(current, CAUSE_OPEN_COIL) : CAUSE_NONE;
}

cause_t current_sample(current_t *current, bool driven, int16_t set_point, uint16_t count) {
    const int32_t came = (int32_t)count - CURRENT_MID_SCALE;
    const uint32_t asked = size_of(set_point);
    const cause_t cause = guard_sample(&current->guard, asked, came); /* In a fault, too: its mean square goes on. */
    if (current->state == CURRENT_FAULT) {
        return standing(current);
    }
    if (cause != CAUSE_NONE) {
        return fail(current, cause);
    }
    if (!driven) {
        take_zero(current, came);
        return CAUSE_NONE;
    }
    current->quiet = false;
    const bool open = current->state != CURRENT_OFF && take_driven(current, asked, set_point < 0, came);
    return open ? fail(current, CAUSE_OPEN_COIL) : CAUSE_NONE;
}

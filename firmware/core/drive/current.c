#include "core/drive/current.h"

#define MID_SCALE     2048     /* Count of the sense at 0 A. */
#define MAGNITUDE_MAX 2046u    /* Largest magnitude that is measured, counts; beyond lie the rails. */
#define REFERENCE_MAX 4095.0f  /* Largest set-point, counts. */
#define KEPT          0.875f   /* Share of the old sums that is kept block after block. */
#define ADAPTED       0.25f    /* Largest change of the reference from that of a driver without error. */
#define ONE           65536.0f /* The factor 1 with 16 fractional bits. */

bool current_configure(current_t *current, const current_config_t *config) {
    /* The comparisons are written so that a value that is not a number fails. */
    if (!(config->sense_A > 0.0f && config->reference_A > 0.0f && config->amplitude_A >= 0.0f &&
          config->over_current_A >= 0.0f && config->open_fraction >= 0.0f && config->open_fraction <= 1.0f)) {
        return false;
    }
    const float scale = config->reference_A / config->sense_A;
    if (!(config->amplitude_A / config->sense_A <= (float)(MID_SCALE - 1) && scale >= 1.0f / 1024.0f &&
          scale <= 8.0f)) {
        return false;
    }
    const float limit = config->over_current_A / config->sense_A;
    const float least_A = config->amplitude_A > 4.0f * CURRENT_OPEN_MINIMUM_A ? 0.25f * config->amplitude_A
                                                                              : CURRENT_OPEN_MINIMUM_A;
    const float open_above = config->open_fraction > 0.0f ? least_A / config->reference_A : REFERENCE_MAX;
    *current = (current_t){
        .state = CURRENT_OFF,
        .fault = CURRENT_FAULT_NONE,
        .config = *config,
        .open_above = (uint16_t)(open_above < REFERENCE_MAX ? open_above : REFERENCE_MAX),
        .over_count = limit < (float)MAGNITUDE_MAX ? (uint16_t)limit : (uint16_t)MAGNITUDE_MAX,
    };
    return true;
}

/* The state is written last: the interrupt acts on it. */
static void set_state(current_t *current, current_state_t state) {
    __atomic_store_n(&current->state, (uint8_t)state, __ATOMIC_RELEASE);
}

void current_start(current_t *current) {
    if (current->state != CURRENT_OFF || current->fault != CURRENT_FAULT_NONE) {
        return;
    }
    current->reference = 0;
    current->measured_A = 0.0f;
    current->target_A = 0.0f;
    current->count = 0.0f;
    current->asked = 0.0f;
    current->came = 0.0f;
    current->product = 0.0f;
    current->square = 0.0f;
    current->block_asked = 0;
    current->block_came = 0;
    current->block_product = 0;
    current->block_square = 0;
    current->chips = 0;
    current->open_scale = 0;
    set_state(current, CURRENT_RAMPING);
}

void current_stop(current_t *current) {
    if (current->fault == CURRENT_FAULT_NONE) {
        set_state(current, CURRENT_OFF);
    }
    current->reference = 0;
}

void current_clear(current_t *current) {
    set_state(current, CURRENT_OFF);
    current->fault = CURRENT_FAULT_NONE;
}

static bool trip(current_t *current, current_fault_t fault) {
    current->fault = (uint8_t)fault;
    current->reference = 0;
    set_state(current, CURRENT_FAULT);
    return false;
}

/* Adds the sums of the block to those that forget. */
static void gather(current_t *current) {
    current->count = KEPT * current->count + (float)current->chips;
    current->asked = KEPT * current->asked + (float)current->block_asked;
    current->came = KEPT * current->came + (float)current->block_came;
    current->product = KEPT * current->product + (float)current->block_product;
    current->square = KEPT * current->square + (float)current->block_square;
    current->block_asked = 0;
    current->block_came = 0;
    current->block_product = 0;
    current->block_square = 0;
    current->chips = 0;
}

static float within(float value, float low, float high) {
    return value < low ? low : value > high ? high : value;
}

static void end_block(current_t *current) {
    const current_config_t *const config = &current->config;
    gather(current);
    const float nominal = config->reference_A / config->sense_A; /* Counts of sense for one of reference. */
    const float n = current->count + 1.0f, spread = n * current->square - current->asked * current->asked;
    const float estimated = spread > 0.0f ? (n * current->product - current->asked * current->came) / spread : nominal;
    const float gain = within(estimated, nominal / (1.0f + ADAPTED), nominal / (1.0f - ADAPTED));
    current->measured_A = (float)current->reference * estimated * config->sense_A;
    current->open_scale = (uint32_t)(gain * config->open_fraction * ONE);

    const float next = current->target_A + config->amplitude_A / (float)CURRENT_RAMP_BLOCKS;
    const bool arrived = next >= config->amplitude_A * 0.99999f; /* 33 thirty-thirds may fall short of one. */
    current->target_A = arrived ? config->amplitude_A : next;
    current->reference = (uint16_t)within(current->target_A / (gain * config->sense_A) + 0.5f, 0.0f, REFERENCE_MAX);
    current->state = arrived ? CURRENT_HOLDING : CURRENT_RAMPING;
}

bool current_sample(current_t *current, int16_t set_point, uint16_t count) {
    if (current->fault != CURRENT_FAULT_NONE) {
        return false;
    }
    if (current->state == CURRENT_OFF) {
        return true;
    }
    const int32_t came = (int32_t)count - MID_SCALE;
    const uint32_t magnitude = (uint32_t)(came < 0 ? -came : came);
    if (magnitude > current->over_count) {
        return trip(current, CURRENT_FAULT_OVER);
    }
    const uint32_t asked = (uint32_t)(set_point < 0 ? -set_point : set_point);
    const int32_t along = set_point < 0 ? -came : came, least = (int32_t)(asked * current->open_scale >> 16);
    if (asked > current->open_above && along < least) {
        return trip(current, CURRENT_FAULT_OPEN);
    }
    current->block_asked += set_point;
    current->block_came += came;
    current->block_product += set_point * came;
    current->block_square += set_point * set_point;
    current->chips++;
    if (current->chips == CURRENT_BLOCK_CHIPS) {
        end_block(current);
    }
    return true;
}

#include "current.h"

#define MID_SCALE 2048u
#define MAGNITUDE_MAX 2046u /* Beyond lie the rails. */
#define REFERENCE_MAX 4095
#define ONE 65536.0f

bool current_configure(current_t *current, const current_config_t *config) {
    /* Written so that a value that is not a number fails. */
    if (!(config->sense_A > 0.0f && config->reference_A > 0.0f && config->amplitude_A >= 0.0f && config->over_current_A >= 0.0f &&
          config->open_fraction >= 0.0f && config->open_fraction <= 1.0f)) {
        return false;
    }
    const float amplitude = config->amplitude_A / config->sense_A;
    const float scale = config->sense_A / config->reference_A;
    if (!(amplitude <= (float)(MID_SCALE - 1u) && scale <= 1024.0f)) {
        return false;
    }
    const float limit = config->over_current_A / config->sense_A;
    *current = (current_t){
        .state = CURRENT_OFF,
        .fault = CURRENT_FAULT_NONE,
        .amplitude = (uint32_t)(amplitude * ONE),
        .over_count = limit < (float)MAGNITUDE_MAX ? (uint16_t)limit : (uint16_t)MAGNITUDE_MAX,
        .open_fraction = (uint32_t)(config->open_fraction * ONE),
        .open_minimum = (uint32_t)(CURRENT_OPEN_MINIMUM_A / config->sense_A * ONE),
        .reference_scale = (uint32_t)(scale * ONE),
        .sense_A = config->sense_A,
    };
    current->step = current->amplitude / CURRENT_RAMP_BLOCKS + 1u;
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
    current->target = 0;
    current->trim = 0;
    current->sum = 0;
    current->mean = 0;
    current->chips = 0;
    current->open_count = 0;
    current->reference = 0;
    set_state(current, CURRENT_RAMPING);
}

void current_stop(current_t *current) {
    if (current->fault == CURRENT_FAULT_NONE) {
        set_state(current, CURRENT_OFF);
    }
}

void current_clear(current_t *current) {
    set_state(current, CURRENT_OFF);
    __atomic_store_n(&current->fault, (uint8_t)CURRENT_FAULT_NONE, __ATOMIC_RELEASE);
}

static current_action_t trip(current_t *current, current_fault_t fault) {
    current->fault = (uint8_t)fault;
    current->state = CURRENT_FAULT;
    current->reference = 0;
    return CURRENT_DRIVE_OFF;
}

/* One block has been measured: correct, move the ramp on, and tell the new reference. */
static current_action_t end_block(current_t *current) {
    current->mean = (current->sum << 16) / CURRENT_BLOCK_CHIPS; /* At most 31 * 2046 * 2^16, just below 2^32. */
    current->sum = 0;
    current->chips = 0;

    const int32_t limit = (int32_t)(current->amplitude / 4u);
    const int32_t trim = current->trim + ((int32_t)current->target - (int32_t)current->mean) / 4;
    current->trim = trim > limit ? limit : trim < -limit ? -limit : trim;

    const uint32_t target = current->target + current->step;
    current->target = target < current->amplitude ? target : current->amplitude;
    current->state = current->target == current->amplitude ? CURRENT_HOLDING : CURRENT_RAMPING;
    const bool armed = current->target >= current->amplitude / 4u && current->target >= current->open_minimum;
    current->open_count = armed ? (uint16_t)((uint64_t)current->target * current->open_fraction >> 32) : 0u;

    const int64_t counts = ((int64_t)current->target + current->trim) * current->reference_scale >> 32;
    const uint16_t reference = (uint16_t)(counts < 0 ? 0 : counts > REFERENCE_MAX ? REFERENCE_MAX : counts);
    if (reference == current->reference) {
        return CURRENT_KEEP;
    }
    current->reference = reference;
    return CURRENT_SET_REFERENCE;
}

current_action_t current_sample(current_t *current, uint16_t count) {
    if (current->fault != CURRENT_FAULT_NONE) {
        return CURRENT_DRIVE_OFF;
    }
    if (current->state == CURRENT_OFF) {
        return CURRENT_KEEP;
    }
    const uint32_t magnitude = count >= MID_SCALE ? count - MID_SCALE : MID_SCALE - count;
    if (magnitude > current->over_count) {
        return trip(current, CURRENT_FAULT_OVER);
    }
    if (magnitude < current->open_count) {
        return trip(current, CURRENT_FAULT_OPEN);
    }
    current->sum += magnitude;
    current->chips++;
    return current->chips < CURRENT_BLOCK_CHIPS ? CURRENT_KEEP : end_block(current);
}

float current_amperes(const current_t *current, uint32_t amount) {
    return (float)amount / ONE * current->sense_A;
}

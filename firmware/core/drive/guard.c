#include "core/drive/guard.h"

#define MAGNITUDE_MAX 2046u    /* Largest magnitude that is measured, counts; beyond lie the rails. */
#define EXCESS        1.375f   /* A driver may err by a quarter (current.h), and a tenth is left for what settles. */
#define EXCESS_A      0.5f     /* Current that nobody has to explain, A: offset of sense and driver, noise. */
#define ONE           65536.0f /* The factor 1 with 16 fractional bits. */
#define NO_LIMIT      1e9f     /* A mean square that no current has, counts. */
#define ASKED_MOST    4095u    /* Largest size of a set-point, counts. */

bool guard_configure(guard_t *guard, const guard_config_t *config, float sense_A, float reference_A) {
    /* The comparisons are written so that a value that is not a number fails. */
    if (!(config->over_current_A >= 0.0f && config->rms_A >= 0.0f && config->rms_chips >= 1.0f)) {
        return false;
    }
    if (guard->excess_scale == 0u) { /* The first time after a reset. */
        guard->before = guard->latest = (uint16_t)ASKED_MOST;
    }
    const float limit = config->over_current_A / sense_A, mean = config->rms_A / sense_A;
    guard->over_count = limit < (float)MAGNITUDE_MAX ? (uint16_t)limit : (uint16_t)MAGNITUDE_MAX;
    guard->excess_scale = (uint32_t)(EXCESS * ONE * reference_A / sense_A);
    guard->excess_count = (uint32_t)(EXCESS_A / sense_A);
    guard->heat_limit = mean > 0.0f ? mean * mean : NO_LIMIT;
    guard->heat_share = 1.0f / config->rms_chips;
    return true;
}

/* Judges the size of a current against its limit and against the most that may explain it, counts of set-point. */
static inline cause_t judge(const guard_t *guard, uint32_t most, uint32_t magnitude) {
    if (magnitude > guard->over_count) {
        return CAUSE_OVER_CURRENT;
    }
    /* 4095 counts of 8 times the sense's, and the excess, just fit 32 bits. */
    return magnitude > (most * guard->excess_scale >> 16) + guard->excess_count ? CAUSE_EXCESS : CAUSE_NONE;
}

cause_t guard_edge(const guard_t *guard, uint32_t asked, int32_t came) {
    return judge(guard, asked > guard->latest ? asked : guard->latest, (uint32_t)(came < 0 ? -came : came));
}

cause_t guard_sample(guard_t *guard, uint32_t asked, int32_t came) {
    const uint32_t magnitude = (uint32_t)(came < 0 ? -came : came);
    const uint32_t most = asked > guard->before ? asked : guard->before;
    const cause_t cause = judge(guard, most, magnitude);
    guard->latest = (uint16_t)most;
    guard->before = (uint16_t)asked;
    guard->heat += ((float)(magnitude * magnitude) - guard->heat) * guard->heat_share;
    if (cause != CAUSE_NONE) {
        return cause;
    }
    return guard->heat > guard->heat_limit ? CAUSE_OVERLOAD : CAUSE_NONE;
}

#include "services/liveness.h"

#include <string.h>

void liveness_start(liveness_t *liveness, hal_t *hal, hal_role_t role) {
    memset(liveness, 0, sizeof *liveness);
    liveness->hal = hal;
    liveness->fed_us = (uint32_t)hal_microseconds(hal);
    liveness->needed = 1u << LIVENESS_LINK;
    if (hal_clock(hal) != HAL_CLOCK_SLOW) {
        liveness->needed |= 1u << LIVENESS_BLOCKS;
        liveness->needed |= hal_role_drives(role) ? 1u << LIVENESS_CURRENTS : 0u;
        liveness->needed |= hal_role_samples(role) ? 1u << LIVENESS_SAMPLES : 0u;
    }
}

/* Samples are handed on at every block, and read 0 where the converters have lost them. A converter that stands still
 * is started again every other block, and counted as an overrun each time. */
static void judge_samples(liveness_t *liveness) {
    hal_counters_t counters;
    hal_counters(liveness->hal, &counters);
    if (counters.converter_overruns != liveness->overruns) {
        liveness->overruns = counters.converter_overruns;
        liveness->seen[LIVENESS_SAMPLES] = liveness->moves[LIVENESS_SAMPLES];
    }
}

static uint32_t standing_still(const liveness_t *liveness) {
    uint32_t still = 0;
    for (uint32_t part = 0; part < LIVENESS_PARTS; part++) {
        const uint32_t least = part == LIVENESS_SAMPLES ? LIVENESS_GOOD_BLOCKS : 1u;
        if (liveness->moves[part] - liveness->seen[part] < least) {
            still |= 1u << part;
        }
    }
    return still & liveness->needed;
}

void liveness_step(liveness_t *liveness, uint64_t now_us) {
    judge_samples(liveness);
    const uint32_t still = standing_still(liveness);
    const uint32_t since_us = (uint32_t)now_us - liveness->fed_us;
    if (still == 0) {
        hal_watchdog_kick(liveness->hal);
        hal_note_stalled(liveness->hal, 0);
        for (uint32_t part = 0; part < LIVENESS_PARTS; part++) {
            liveness->seen[part] = liveness->moves[part];
        }
        liveness->fed_us = (uint32_t)now_us;
    } else if (since_us > LIVENESS_PATIENCE_US) {
        hal_note_stalled(liveness->hal, still);
    }
}

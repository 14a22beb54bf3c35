#include "sync.h"

#include "hal.h"

void sync_clock_init(chip_clock_t *clock, bool follow) {
    const chip_clock_config_t config = {
        .chips = 1023,
        .nominal_ticks = HAL_CHIP_TICKS,
        .minimum_ticks = HAL_CHIP_TICKS_MIN,
        .maximum_ticks = HAL_CHIP_TICKS_MAX,
        .follow = follow,
    };
    (void)chip_clock_init(clock, &config); /* The constants lie in its ranges. */
}

void sync_number(chip_clock_t *clock, uint32_t cycle, uint32_t age_us) {
    if (clock->tracking && clock->config.follow && age_us < SYNC_FRESH_US) {
        chip_clock_number_cycle(clock, cycle);
    }
}

int32_t sync_phase(int32_t ticks) {
    return (int32_t)((int64_t)ticks * 100 / (int32_t)(HAL_TICKS_PER_SECOND / 1000000u));
}

#include "sync.h"

#include "hal.h"

sync_format_t sync_format(uint32_t degree) {
    return (sync_format_t){
        .degree = (uint16_t)degree,
        .chips = (uint16_t)((1u << degree) - 1u),
        .cycles = (uint16_t)(degree < 10u ? 1u << (10u - degree) : 1u),
    };
}

void sync_clock_init(chip_clock_t *clock, const sync_format_t *format, bool follow) {
    const chip_clock_config_t config = {
        .chips = (uint16_t)(format->chips * format->cycles),
        .nominal_ticks = HAL_CHIP_TICKS,
        .minimum_ticks = HAL_CHIP_TICKS_MIN,
        .maximum_ticks = HAL_CHIP_TICKS_MAX,
        .follow = follow,
    };
    (void)chip_clock_init(clock, &config); /* All formats lie in its ranges. */
}

bool sync_number(chip_clock_t *clock, const sync_format_t *format, uint32_t chips, uint32_t cycle, uint32_t age_us) {
    if (chips != format->chips) {
        if (clock->config.follow) {
            chip_clock_forget(clock);
        }
        return false;
    }
    if (clock->tracking && clock->config.follow && age_us < SYNC_FRESH_US) {
        chip_clock_number_cycle(clock, cycle / format->cycles);
    }
    return true;
}

int32_t sync_phase(int32_t ticks) {
    return (int32_t)((int64_t)ticks * 100 / (int32_t)(HAL_TICKS_PER_SECOND / 1000000u));
}

#include "services/timing.h"

#include <string.h>

void timing_start(timing_t *timing, const parameters_t *parameters, bool can_lead) {
    memset(timing, 0, sizeof *timing);
    timing->format = sync_format(parameters_unsigned(parameters, PARAMETER_DEGREE));
    timing->master = can_lead && parameters_unsigned(parameters, PARAMETER_SYNC_MASTER) == 1;
    sync_clock_init(&timing->clock, &timing->format, !timing->master);
    if (!timing->master && parameters_unsigned(parameters, PARAMETER_SYNC_SOURCE) == SYNC_BY_CAN) {
        sync_link_follow(&timing->link, &timing->clock, true);
    }
}

void timing_serve(timing_t *timing, hal_t *hal) {
    sync_link_serve(&timing->link, &timing->clock, &timing->format, hal);
}

void timing_edge(timing_t *timing, hal_t *hal, uint32_t chip, uint16_t ticks) {
    if (timing->by_field || timing->link.follows) {
        chip_clock_compare(&timing->clock, chip, ticks);
    } else {
        chip_clock_edge(&timing->clock, chip, ticks);
    }
    timing->edge_us = (uint32_t)hal_microseconds(hal);
}

void timing_step(timing_t *timing, node_t *node) {
    node->counters[COUNTER_SYNC_REJECTED] = timing->clock.edges_rejected;
    if (node->sync_received) {
        node->sync_received = false;
        const uint32_t age_us = (uint32_t)hal_microseconds(node->hal) - timing->edge_us;
        node->counters[COUNTER_OTHER_DEGREE] += !sync_number(&timing->clock, &timing->format, &timing->link,
                                                             node->sync_chips, node->sync_cycle, age_us);
    }
}

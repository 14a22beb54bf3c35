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

/* Counts up, and stops at the maximum. */
static void count(node_t *node, uint32_t counter) {
    node->counters[counter] += node->counters[counter] < UINT32_MAX;
}

/* Makes a master a follower: the interrupts find a clock that ignores edges until it is searching. */
static void step_back(timing_t *timing, const parameters_t *parameters) {
    timing->master = false;
    if (parameters_unsigned(parameters, PARAMETER_SYNC_SOURCE) == SYNC_BY_CAN) {
        sync_link_follow(&timing->link, &timing->clock, true);
    } else {
        chip_clock_forget(&timing->clock, &chip_clock_wire);
    }
    timing->clock.config.follow = true;
}

/* Takes the SYNC of another master with the same length of cycle. */
static void meet_rival(timing_t *timing, node_t *node, uint32_t now_us) {
    count(node, COUNTER_OTHER_MASTERS);
    if (node->sync_node >= node->id) {
        return;
    }
    timing->rival_syncs = now_us - timing->rival_us < TIMING_RIVAL_US ? timing->rival_syncs + 1u : 1u;
    timing->rival_us = now_us;
    if (timing->rival_syncs >= TIMING_RIVAL_SYNCS) {
        step_back(timing, &node->parameters);
    }
}

/* Takes the SYNC of a master with another length of cycle. */
static void meet_other_degree(timing_t *timing, node_t *node, uint32_t now_us) {
    count(node, COUNTER_OTHER_DEGREE);
    timing->sound = timing->sound && now_us - timing->sound_us < TIMING_SOUND_US;
    if (!timing->sound) {
        sync_distrust(&timing->clock, &timing->link);
    }
}

void timing_step(timing_t *timing, node_t *node) {
    node->counters[COUNTER_SYNC_REJECTED] = timing->clock.edges_rejected;
    if (!node->sync_received) {
        return;
    }
    node->sync_received = false;
    const uint32_t now_us = (uint32_t)hal_microseconds(node->hal);
    const sync_told_t told = sync_number(&timing->clock, &timing->format, &timing->link, node->sync_chips,
                                         node->sync_cycle, now_us - timing->edge_us);
    if (told == SYNC_OTHER_LENGTH) {
        meet_other_degree(timing, node, now_us);
    } else if (timing->master) {
        meet_rival(timing, node, now_us);
    } else if (told == SYNC_NUMBERED) {
        timing->sound = true;
        timing->sound_us = now_us;
    }
}

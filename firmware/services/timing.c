#include "services/timing.h"

#include <string.h>

#include "goldfield.h"

#define AGE_US       100000u /* Unit of CLOCK.age, us. */
#define RATE_MAX_PPB 524287  /* Largest CLOCK.rate. */

static uint32_t period_us(const sync_format_t *format) {
    const uint64_t ticks = (uint64_t)format->chips * format->cycles * HAL_CHIP_TICKS;
    return (uint32_t)(ticks / (HAL_TICKS_PER_SECOND / 1000000u));
}

void timing_start(timing_t *timing, const node_t *node, bool can_lead) {
    memset(timing, 0, sizeof *timing);
    const parameters_t *const parameters = &node->parameters;
    timing->format = sync_format(parameters_unsigned(parameters, PARAMETER_DEGREE));
    const uint32_t rank = can_lead ? parameters_unsigned(parameters, PARAMETER_SYNC_MASTER) : 0u;
    election_start(&timing->election, rank, timing->format.cycles, period_us(&timing->format),
                   hal_microseconds(node->hal));
    timing->elects = rank > 0u;
    sync_clock_init(&timing->clock, &timing->format, true);
    const uint32_t by = parameters_unsigned(parameters, PARAMETER_SYNC_SOURCE);
    source_automatic(&timing->source, &timing->link, by == SYNC_AUTOMATIC);
    if (by == SYNC_BY_CAN) {
        sync_link_follow(&timing->link, &timing->clock, true);
    }
}

/* ---- In the context of plan ---- */

/* Makes the leader a follower. What its messages tell of the other leader must be younger than two sync periods. */
static void follow(timing_t *timing) {
    chip_clock_t *const clock = &timing->clock;
    sync_link_t *const link = &timing->link;
    const chip_clock_source_t *const source = link->follows ? &chip_clock_link : &chip_clock_wire;
    const bool fresh = link->compared && link->rival_node == timing->leader &&
                       clock->chip - link->rival_chip < 2u * clock->config.chips;
    if (fresh && link->rival_phase <= SYNC_NEAR_TICKS && link->rival_phase >= -SYNC_NEAR_TICKS) {
        chip_clock_yield(clock, source);
    } else {
        chip_clock_forget(clock, source);
        clock->config.follow = true;
    }
    link->compared = false;
}

void timing_serve(timing_t *timing, hal_t *hal, uint32_t block) {
    if (timing->clock.chip != block * HAL_BLOCK_CHIPS) {
        hal_reset(hal); /* What has changed its count has changed its time, too, which it would chase. */
    }
    if (timing->master && hal_clock(hal) != HAL_CLOCK_CRYSTAL) {
        timing->turn = TIMING_FOLLOW; /* Nobody could follow. */
    }
    const uint8_t turn = timing->turn;
    if (turn == TIMING_LEAD) {
        chip_clock_lead(&timing->clock, !timing->knows);
        timing->announce = true;
    } else if (turn == TIMING_FOLLOW) {
        follow(timing);
    }
    if (turn != TIMING_STAY) {
        timing->master = turn == TIMING_LEAD;
        timing->turn = TIMING_STAY;
    }
    sync_link_serve(&timing->link, &timing->clock, &timing->format, hal);
    if (timing->source.automatic && !timing->master) {
        source_choose(&timing->source, &timing->clock, &timing->link);
    }
    if (timing->asked) {
        timing->quality = chip_clock_quality(&timing->clock, HAL_TICKS_PER_SECOND / 1000000u);
        timing->asked = false;
    }
}

void timing_edge(timing_t *timing, hal_t *hal, uint32_t chip, uint16_t ticks) {
    if (timing->master) {
        return; /* It may be the board's own edge. */
    }
    const bool compares = timing->source.by_field || timing->link.follows;
    const bool fits = compares ? chip_clock_compare(&timing->clock, chip, ticks)
                               : chip_clock_edge(&timing->clock, chip, ticks);
    timing->signs += fits;
    source_edge(&timing->source, &timing->clock, fits);
    if (fits && !compares) {
        timing->edge_us = (uint32_t)hal_microseconds(hal);
    }
}

/* ---- Main ---- */

/* Counts up, and stops at the maximum. */
static void count(node_t *node, uint32_t counter) {
    node->counters[counter] += node->counters[counter] < UINT32_MAX;
}

/* Takes the SYNC of another leader with the same length of cycle, which a leader heard. */
static void meet_rival(timing_t *timing, node_t *node, uint64_t now_us) {
    const election_leader_t other = {.rank = node->sync_rank, .node = node->sync_node, .cycle = node->sync_cycle};
    count(node, COUNTER_OTHER_MASTERS);
    if (timing->turn == TIMING_STAY && election_yields(&timing->election, node->id, &other, now_us)) {
        timing->leader = other.node;
        timing->leader_us = now_us;
        election_heard(&timing->election, now_us);
        timing->turn = TIMING_FOLLOW;
    }
}

/* Takes the SYNC of a master with another length of cycle. */
static void meet_other_degree(timing_t *timing, node_t *node, uint64_t now_us) {
    count(node, COUNTER_OTHER_DEGREE);
    timing->sound = timing->sound && (uint32_t)now_us - timing->sound_us < TIMING_SOUND_US;
    if (!timing->sound) {
        sync_distrust(&timing->clock, &timing->link);
    }
}

/* Returns whether a SYNC's number is that of the own clock, nearly. */
static bool near_own(const timing_t *timing, uint32_t cycle) {
    const uint32_t own = (timing->clock.cycle + timing->clock.cycle_shift) * timing->format.cycles;
    const uint32_t limit = TIMING_NEAR_PERIODS * (uint32_t)timing->format.cycles;
    return ((cycle - own + limit) & SYNC_CYCLE_MASK) <= 2u * limit;
}

/* Takes the SYNC of a leader with the same length of cycle, which a follower heard. */
static void hear_leader(timing_t *timing, node_t *node, uint64_t now_us) {
    const bool silent = timing->leader == 0u || now_us - timing->leader_us >= 2u * (uint64_t)timing->election.period_us;
    if ((node->sync_node == timing->leader || silent) &&
        sync_number(&timing->clock, &timing->format, &timing->link, node->sync_chips, node->sync_cycle,
                    (uint32_t)now_us - timing->edge_us) == SYNC_NUMBERED) {
        timing->leader = node->sync_node;
        timing->leader_us = now_us;
        timing->sound = true;
        timing->sound_us = (uint32_t)now_us;
    }
    if (!timing->clock.locked || near_own(timing, node->sync_cycle)) {
        election_heard(&timing->election, now_us);
    }
}

static void take_sync(timing_t *timing, node_t *node, uint64_t now_us) {
    if (node->sync_chips != timing->format.chips) {
        meet_other_degree(timing, node, now_us);
    } else if (timing->master) {
        meet_rival(timing, node, now_us);
    } else if (node->sync_node != node->id) {
        hear_leader(timing, node, now_us);
    }
}

/* Looks whether a board with a rank that does not lead is to begin. */
static void elect(timing_t *timing, node_t *node, uint64_t now_us) {
    if (timing->signs != timing->signs_seen) {
        timing->signs_seen = timing->signs;
        election_heard(&timing->election, now_us);
    }
    if (node->others_in_step) {
        node->others_in_step = false;
        election_held(&timing->election, now_us);
    }
    timing->knows = timing->knows || timing->clock.locked;
    if (timing->turn == TIMING_STAY && hal_clock(node->hal) == HAL_CLOCK_CRYSTAL &&
        election_due(&timing->election, timing->clock.locked, now_us)) {
        timing->turn = TIMING_LEAD;
    }
}

static uint8_t source(const timing_t *timing) {
    return timing->master            ? GOLDFIELD_CLOCK_SOURCE_OWN_CHOICE
           : timing->source.by_field ? GOLDFIELD_CLOCK_SOURCE_FIELD_CHOICE
           : timing->link.follows    ? GOLDFIELD_CLOCK_SOURCE_CAN_CHOICE
                                     : GOLDFIELD_CLOCK_SOURCE_WIRE_CHOICE;
}

static void send_clock(const timing_t *timing, node_t *node) {
    const chip_clock_quality_t *const quality = &timing->quality;
    const bool known = quality->error_ns < UINT32_MAX;
    const uint32_t age = quality->age_us / AGE_US;
    const uint32_t error_ns = node_count(quality->error_ns, timing->source.by_field ? timing->field_error_ns : 0u);
    const struct goldfield_clock_t clock = {
        .source = known ? source(timing) : (uint8_t)GOLDFIELD_CLOCK_SOURCE_NONE_CHOICE,
        .locked = timing->clock.locked,
        .rank = (uint8_t)timing->election.rank,
        .leader = (uint16_t)(timing->master                      ? node->id
                             : !known || timing->source.by_field ? 0u
                             : timing->link.follows              ? timing->link.leader
                                                                 : timing->leader),
        .age = (uint8_t)(age < UINT8_MAX ? age : UINT8_MAX),
        .rate = node_clamp(quality->rate_ppb, RATE_MAX_PPB),
        .error = (uint16_t)(error_ns < UINT16_MAX ? error_ns : UINT16_MAX),
    };
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_clock_pack(data, &clock, sizeof data);
    node_send(node, NODE_BOTH, GOLDFIELD_CLOCK_FRAME_ID, 0, data, length);
}

/* Sends CLOCK behind each heartbeat: plan tells the clock's quality first. */
static void tell(timing_t *timing, node_t *node) {
    if (timing->told_us != (uint32_t)node->heartbeat_us) {
        timing->asking = timing->told_us != 0u;
        timing->asked = timing->asking;
        timing->told_us = (uint32_t)node->heartbeat_us;
    } else if (!timing->asked) {
        timing->asking = false;
        send_clock(timing, node);
    }
}

void timing_step(timing_t *timing, node_t *node) {
    node->counters[COUNTER_SYNC_REJECTED] = timing->clock.edges_rejected;
    node->counters[COUNTER_SYNC_CHANGES] = timing->source.changes;
    if (timing->asking || timing->told_us != (uint32_t)node->heartbeat_us) {
        tell(timing, node);
    }
    if (node->sync_received) {
        node->sync_received = false;
        take_sync(timing, node, hal_microseconds(node->hal));
    }
    if (timing->elects && !timing->master) {
        elect(timing, node, hal_microseconds(node->hal));
    }
}

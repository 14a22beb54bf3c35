#include "core/timing/election.h"

#define RANKS_BEHIND      14u /* Ranks behind the first. */
#define LATE_SYNC_PERIODS 3u  /* Most sync periods between two messages that count together. */

void election_start(election_t *election, uint32_t rank, uint32_t cycles, uint32_t period_us, uint64_t now_us) {
    *election = (election_t){.rank = rank, .cycles = cycles, .period_us = period_us, .heard_us = now_us};
}

void election_heard(election_t *election, uint64_t now_us) {
    election->heard_us = now_us;
}

void election_held(election_t *election, uint64_t now_us) {
    election->held = true;
    election->held_us = now_us;
}

uint32_t election_wait_us(const election_t *election, bool in_step, uint64_t now_us) {
    const uint32_t first = election->period_us * 9u / 4u, room = (ELECTION_LAST_US - first) / RANKS_BEHIND;
    const uint32_t step = room < ELECTION_STEP_US ? room : ELECTION_STEP_US;
    const bool others = election->held && now_us - election->held_us < ELECTION_HELD_FOR_US;
    return (!in_step && others ? ELECTION_HELD_US : first) + (election->rank - 1u) * step;
}

bool election_due(const election_t *election, bool in_step, uint64_t now_us) {
    return election->rank > 0u && now_us - election->heard_us >= election_wait_us(election, in_step, now_us);
}

/* Returns whether a message follows the one before as those of one clock do. */
static bool follows(const election_t *election, const election_leader_t *next, uint64_t now_us) {
    const uint32_t cycles = (next->cycle - election->rival.cycle) & ELECTION_CYCLE_MASK;
    const uint32_t periods = cycles / election->cycles;
    if (election->rival_syncs == 0u || next->node != election->rival.node || next->rank != election->rival.rank ||
        periods == 0u || periods > LATE_SYNC_PERIODS) {
        return false;
    }
    const uint64_t passed = now_us - election->rival_us, due = (uint64_t)periods * election->period_us;
    return passed + election->period_us / 2u >= due && passed <= due + election->period_us / 2u;
}

bool election_yields(election_t *election, uint32_t node, const election_leader_t *other, uint64_t now_us) {
    const bool precedes = other->rank < election->rank || (other->rank == election->rank && other->node < node);
    if (!precedes || other->rank == 0u) {
        return false;
    }
    election->rival_syncs = follows(election, other, now_us) ? election->rival_syncs + 1u : 1u;
    election->rival = *other;
    election->rival_us = now_us;
    if (election->rival_syncs < ELECTION_SYNCS) {
        return false;
    }
    election->rival_syncs = 0;
    return true;
}

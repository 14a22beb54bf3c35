/* election.h: who of several boards leads the time. Every board that may lead has a rank: 1 is the master, 2 to 15 are
 * its deputies, 0 never leads. Nothing is agreed by messages: a board leads when no leader was seen for a time that
 * grows with its rank, so that the first deputy that is in step is heard before the next one's time is up.
 *
 * Calls, in the order they are made (all of them from main)
 *   1. election_start   once, at the start of the board.
 *   2. election_heard   for each sign of a leader: an edge of the sync wire that fits, or a SYNC.
 *      election_held    when another board tells that it is in step.
 *   3. election_due     each turn of a board that does not lead: true when it is to lead.
 *   4. election_yields  for each SYNC of another leader that a leader hears: true when it is to follow that one.
 *
 * Waiting. P is the sync period (sync.h), 0.1 s for most codes.
 *   in step, or nobody is:     2.25 P + (rank - 1) step;  step = 50 ms, with long codes less, so that rank 15 leads
 *                              within 0.95 s. With P = 0.1 s: 0.225 s for rank 1, 0.275 s for rank 2, 0.925 s for 15.
 *   not in step, others are:   1.25 s + (rank - 1) step
 * In 2.25 P one sign may be lost, with either witness. The quarter puts the end of the waiting well away from the next
 * edge. A new leader tells so at once by SYNC on CAN, which takes the bus before all else. With a wire alone its first
 * edge tells, up to a period later: there ranks must be two apart (2, 4, 6; with degree 11 seven). A board that has
 * just started waits as long, from its start on, and so follows whoever leads already: two signs of a leader come
 * within 2.25 P. A board that is not in step lets those that are lead first, since it alone would move the time of all;
 * that others are in step it knows from what they tell of themselves (election_held), within the last second.
 *
 * Two that lead. Who leads keeps, unless two lead: then the lower rank keeps, of equal ranks the lower node number, as
 * both see. The other steps back after ELECTION_SYNCS messages in a row, each numbered one to three sync periods behind
 * the one before and as much later on its own clock, within half a period: a stray, repeated or invented message, or a
 * flood of them, does not make one step back. Two of one rank and one number both keep: they cannot tell each other
 * from themselves.
 *
 * Why a master that returns follows. To hand the time back would be one more change of the leader, with the error of
 * one more, for nothing: all leaders are equally good.
 */
#ifndef GOLDFIELD_ELECTION_H
#define GOLDFIELD_ELECTION_H

#include <stdbool.h>
#include <stdint.h>

#define ELECTION_RANK_MAX    15u
#define ELECTION_STEP_US     50000u   /* Most time that a board waits longer than that of the rank before, us. */
#define ELECTION_LAST_US     950000u  /* Longest wait of a board that is in step, us. */
#define ELECTION_HELD_US     1250000u /* Wait of rank 1 if it is not in step and others are, us: after all others. */
#define ELECTION_HELD_FOR_US 1000000u /* Age up to which it counts that another board was in step, us. */
#define ELECTION_SYNCS       3u /* Messages of a leader with precedence, in a row, that make a leader step back. */
#define ELECTION_CYCLE_MASK  0xFFFFFu /* The bits of a cycle number in a message. */

/* A leader as its SYNC tells. */
typedef struct {
    uint32_t rank, node;
    uint32_t cycle; /* 20 bits. */
} election_leader_t;

/* Private. */
typedef struct {
    uint32_t rank, period_us;
    uint32_t cycles;         /* Cycles in a sync period. */
    uint64_t heard_us;       /* The latest sign of a leader, or the start. */
    uint64_t held_us;        /* When another board told that it is in step, */
    bool held;               /* if ever. */
    election_leader_t rival; /* The latest SYNC of a leader with precedence, */
    uint64_t rival_us;       /* when it came, */
    uint32_t rival_syncs;    /* and how many came in a row. */
} election_t;

/* Begin to wait. The rank is at most ELECTION_RANK_MAX; a sync period has so many cycles and lasts period_us, 250 ms at
 * most. */
void election_start(election_t *election, uint32_t rank, uint32_t cycles, uint32_t period_us, uint64_t now_us);

void election_heard(election_t *election, uint64_t now_us);
void election_held(election_t *election, uint64_t now_us);

/* Returns how long the board waits for a sign of a leader, us, if it is in step or not. */
uint32_t election_wait_us(const election_t *election, bool in_step, uint64_t now_us);

/* Returns whether a board that does not lead is to lead now. */
bool election_due(const election_t *election, bool in_step, uint64_t now_us);

/* Take a SYNC of another leader, which a leader with the number `node` heard.
 * Returns whether it is to step back now. */
bool election_yields(election_t *election, uint32_t node, const election_leader_t *other, uint64_t now_us);

#endif

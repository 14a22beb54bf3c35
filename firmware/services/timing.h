/* timing.h: a board's chip clock together with what it follows, as beacon, sensor and anchor have it: the sync wire,
 * messages on CAN, or (sensor only) the field. A follower takes the cycle's number from SYNC (sync.h).
 *
 * Calls, in the order they are made
 *   1. timing_start  once; parameters degree, sync_master and sync_source are read then, and never again.
 *   2. timing_serve  from plan, before each block's chips are planned with chip_clock_plan.
 *   3. timing_edge   from sync, for each edge of the sync wire.
 *   4. timing_step   once a turn of the main loop.
 *
 * Leading (election.h; parameter sync_master is the rank). Every board begins as a follower. One with a rank leads when
 * it sees no leader any more; it looks at both of a leader's signs, whatever it follows itself, so that a link of its
 * own that is broken makes no second leader:
 *   - an edge of the sync wire that the chip clock takes, or that lies within its gate of a cycle's start;
 *   - a SYNC with its length of cycle. If the board is in step the number must be near its own (TIMING_NEAR_PERIODS).
 * It then goes on with the phase, the period and the numbers that it has: no follower sees more of a step than the two
 * clocks differ by. A board that has followed nobody since its start begins with cycle 0. Without its crystal a board
 * does not lead.
 *
 * Two that lead. Both notice: each hears the other's SYNC, and counts it (COUNTER_OTHER_MASTERS). Which of them steps
 * back, election.h tells. That one has compared its clock with the other's messages on CAN. Within SYNC_NEAR_TICKS it
 * goes over to following without losing its lock; else it is unlocked, its drive is off, and it searches, as
 * sync_source says. That a wire joined two that ran apart its followers see by edges that do not fit: they lose the
 * lock, too.
 *
 * Numbers. A follower of the wire takes the number of a cycle from the SYNC of one leader, and from another's only when
 * that one was silent for two sync periods: of two that lead one drives the wire that it follows.
 *
 * Masters of another length of cycle. Such a SYNC is counted (COUNTER_OTHER_DEGREE). It is ignored as long as the
 * wire's master is sound: it has numbered an edge of the wire within TIMING_SOUND_US. Else the wire may be that
 * master's and is forgotten, though its edges fit.
 *
 * Automatic (sync_source 3; source.h) chooses between the wire, CAN and, on a sensor, the field.
 *
 * CLOCK goes with each heartbeat: what the clock follows, whom, and how well (chip_clock_quality).
 *
 * A sync wire that is there but not followed is only compared: chip_clock_t.phase_ticks is then the difference to it.
 *
 * Contexts: timing_serve and timing_edge are called from their interrupts, the others from main. Memory: 1.8 kB.
 */
#ifndef GOLDFIELD_TIMING_H
#define GOLDFIELD_TIMING_H

#include "core/timing/chip_clock.h"
#include "core/timing/election.h"
#include "hal/hal.h"
#include "services/node.h"
#include "services/source.h"
#include "services/sync.h"

#define TIMING_SOUND_US     500000u /* Age up to which the latest good SYNC tells that the wire is sound, us. */
#define TIMING_NEAR_PERIODS 2       /* Largest difference of a SYNC's number from the own one, sync periods. */
#define TIMING_STEP_TICKS   168     /* Largest step of a leader that begins to follow and stays locked: 1 us. */

/* What main asks plan to do. */
typedef enum { TIMING_STAY = 0, TIMING_LEAD = 1, TIMING_FOLLOW = 2 } timing_turn_t;

typedef struct {
    sync_format_t format; /* How chips make cycles and sync periods. */
    chip_clock_t clock;
    sync_link_t link;
    election_t election;
    volatile bool master;  /* The board leads: it runs free, and the other boards follow it. */
    volatile uint8_t turn; /* A timing_turn_t: main writes it, plan acts on it and writes TIMING_STAY. */
    uint32_t told_us;      /* The heartbeat with which CLOCK was sent last, us. */
    volatile bool asked;   /* Main asks plan for the quality of the clock: it clears this when it is there. */
    bool asking;           /* Main waits for it. */
    chip_clock_quality_t quality;
    volatile bool announce;    /* The board has begun to lead in a cycle whose SYNC nobody sent: drive.h sends it. */
    uint32_t field_error_ns;   /* Twice the standard deviation of the phase by the field. Main sets it. */
    source_t source;           /* What the clock follows, and what else is there. */
    bool elects;               /* The board has a rank. */
    bool knows;                /* The clock was locked to a leader once: phase and numbers are others', too. */
    volatile uint32_t signs;   /* Edges of the wire that are a sign of a leader; the interrupt counts them, */
    uint32_t signs_seen;       /* and main has seen so many. */
    uint32_t leader;           /* The node whose SYNC numbers the wire's edges, */
    uint64_t leader_us;        /* and when it did so last. */
    bool sound;                /* The wire's master numbered an edge at sound_us. */
    uint32_t sound_us;         /* When it did so, us. */
    volatile uint32_t edge_us; /* When the latest edge that the clock took came, us; one word: it is never torn. */
} timing_t;

/* Make the chip clock that the node's parameters ask for. can_lead: the board may lead, as all boards that drive. */
void timing_start(timing_t *timing, const node_t *node, bool can_lead);

/* Begin or end to lead if main has asked for it, and take the messages on CAN since the last call, before a block is
 * planned. The chip clock and the board count the same chips, from 0 on, whatever the clock follows: where they differ,
 * a bit has flipped, and the board starts anew. Costs about 1,100 instructions when a FOLLOW_UP came, else 25. */
void timing_serve(timing_t *timing, hal_t *hal, uint32_t block);

/* Take an edge of the sync wire, with what hal_events_t.sync tells of it. */
void timing_edge(timing_t *timing, hal_t *hal, uint32_t chip, uint16_t ticks);

/* Take the SYNC that the node received, if one came, and write the node's counters. Called after upkeep_step. */
void timing_step(timing_t *timing, node_t *node);

#endif

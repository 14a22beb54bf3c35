/* timing.h: a board's chip clock together with what it follows, as beacon, sensor and anchor have it: the sync wire,
 * messages on CAN, or (sensor only) the field. A follower takes the cycle's number from SYNC (sync.h).
 *
 * Calls, in the order they are made
 *   1. timing_start  once; parameters degree and sync_master are read then, and never again.
 *   2. timing_serve  from plan, before each block's chips are planned with chip_clock_plan.
 *   3. timing_edge   from sync, for each edge of the sync wire.
 *   4. timing_step   once a turn of the main loop.
 *
 * Two masters. Both notice: each hears the other's SYNC, and counts it (COUNTER_OTHER_MASTERS). The one with the lowest
 * node number keeps; any other steps back after TIMING_RIVAL_SYNCS of them, and follows the one that keeps, by wire or
 * by CAN as its parameter sync_source says, until its next reset. It drives nothing before its clock is locked. Two
 * masters of one number both keep: they cannot tell each other from themselves.
 *
 * Masters of another length of cycle. Such a SYNC is counted (COUNTER_OTHER_DEGREE). It is ignored as long as the
 * wire's master is sound: it has numbered an edge of the wire within TIMING_SOUND_US. Else the wire may be that
 * master's and is forgotten, though its edges fit.
 *
 * A sync wire that is there but not followed is only compared: chip_clock_t.phase_ticks is then the difference to it.
 *
 * Contexts: timing_serve and timing_edge are called from their interrupts, the others from main. Memory: 1.8 kB.
 */
#ifndef GOLDFIELD_TIMING_H
#define GOLDFIELD_TIMING_H

#include "core/timing/chip_clock.h"
#include "hal/hal.h"
#include "services/node.h"
#include "services/sync.h"

#define TIMING_SOUND_US    500000u  /* Age up to which the latest good SYNC tells that the wire is sound, us. */
#define TIMING_RIVAL_US    1000000u /* Longest time between two SYNCs of a rival that count together, us. */
#define TIMING_RIVAL_SYNCS 3u       /* So many SYNCs of a rival make a master step back: one may be an accident. */

typedef struct {
    sync_format_t format; /* How chips make cycles and sync periods. */
    chip_clock_t clock;
    sync_link_t link;
    volatile bool master;      /* The board runs free, and the other boards follow it. */
    volatile bool by_field;    /* Set by the application: acquire.h serves the clock, so the wire must not. */
    bool sound;                /* The wire's master numbered an edge at sound_us. */
    uint32_t sound_us;         /* When it did so, us. */
    uint32_t rival_syncs;      /* SYNCs in succession of masters with lower numbers. */
    uint32_t rival_us;         /* When the latest of them came, us. */
    volatile uint32_t edge_us; /* When the latest edge of the sync wire came, us; one word, so that it is never torn. */
} timing_t;

/* Make the chip clock that the parameters ask for. can_lead: the board may be sync master, as all boards that drive. */
void timing_start(timing_t *timing, const parameters_t *parameters, bool can_lead);

/* Take the messages on CAN since the last call. Costs about 1,100 instructions when a FOLLOW_UP came, else 20. */
void timing_serve(timing_t *timing, hal_t *hal);

/* Take an edge of the sync wire, with what hal_events_t.sync tells of it. */
void timing_edge(timing_t *timing, hal_t *hal, uint32_t chip, uint16_t ticks);

/* Take the SYNC that the node received, if one came, and write the node's counters. Called after upkeep_step. */
void timing_step(timing_t *timing, node_t *node);

#endif

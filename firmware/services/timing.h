/* timing.h: a board's chip clock together with what it follows, as beacon, sensor and anchor have it: the sync wire,
 * messages on CAN, or (sensor only) the field. A follower takes the cycle's number from SYNC (sync.h).
 *
 * Calls, in the order they are made
 *   1. timing_start  once; parameters degree and sync_master are read then, and never again.
 *   2. timing_serve  from plan, before each block's chips are planned with chip_clock_plan.
 *   3. timing_edge   from sync, for each edge of the sync wire.
 *   4. timing_step   once a turn of the main loop.
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

typedef struct {
    sync_format_t format; /* How chips make cycles and sync periods. */
    chip_clock_t clock;
    sync_link_t link;
    bool master;               /* The board runs free, and the other boards follow it. */
    volatile bool by_field;    /* Set by the application: acquire.h serves the clock, so the wire must not. */
    volatile uint32_t edge_us; /* When the latest edge of the sync wire came, us; one word, so that it is never torn. */
} timing_t;

/* Make the chip clock that the parameters ask for. can_lead: the board may be sync master, as all boards that drive. */
void timing_start(timing_t *timing, const parameters_t *parameters, bool can_lead);

/* Take the messages on CAN since the last call. Costs about 1,100 instructions when a FOLLOW_UP came, else 20. */
void timing_serve(timing_t *timing, hal_t *hal);

/* Take an edge of the sync wire, with what hal_events_t.sync tells of it. */
void timing_edge(timing_t *timing, hal_t *hal, uint32_t chip, uint16_t ticks);

/* Take the SYNC that the node received, if one came, and write the node's counters. Called after node_step. */
void timing_step(timing_t *timing, node_t *node);

#endif

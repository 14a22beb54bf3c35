/* timing.h: a board's chip clock and what it follows, as beacon, sensor and anchor have it: the sync wire, messages on
 * CAN, or (sensor) the field.
 *
 * Parameters degree and sync_master are read once, at start. A follower takes the cycle's number from SYNC (sync.h). A
 * sync wire that is there but not followed is only compared: chip_clock_t.phase_ticks.
 *
 * Contexts: timing_serve from plan, before chips are planned; timing_edge from sync; the rest from main. Memory: 1.8
 * kB.
 */
#ifndef GOLDFIELD_TIMING_H
#define GOLDFIELD_TIMING_H

#include "core/timing/chip_clock.h"
#include "hal/hal.h"
#include "services/node.h"
#include "services/sync.h"

typedef struct {
    sync_format_t format;
    chip_clock_t clock;
    sync_link_t link;
    bool master; /* Runs free; the other boards follow it. */
    volatile bool
        by_field; /* The application's wish: somebody else serves the clock (acquire.h), so the wire must not. */
    volatile uint32_t edge_us; /* When the latest edge of the sync wire came; one word, so that it is never torn. */
} timing_t;

/* From the parameters. can_lead: the board may be sync master, as all that drive. */
void timing_start(timing_t *timing, const parameters_t *parameters, bool can_lead);

/* Messages on CAN since the last call: at most about 1,100 instructions, when a FOLLOW_UP came, else 20. */
void timing_serve(timing_t *timing, hal_t *hal);

/* An edge of the sync wire, as hal_events_t.sync has it. */
void timing_edge(timing_t *timing, hal_t *hal, uint32_t chip, uint16_t ticks);

/* One turn of the main loop, after node_step: a SYNC that the node received; the node's counters. */
void timing_step(timing_t *timing, node_t *node);

#endif

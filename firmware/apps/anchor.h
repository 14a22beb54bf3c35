/* anchor.h: the application of an anchor: a beacon that also carries a sensor, as in US patent 6,691,074. It drives
 * its coil in step with the other boards and, with the same chips, measures the fields of all of them; what anchors
 * measure of each other tells where they stand.
 *
 * Calls: anchor_start once, then anchor_step after each hal_wait().
 *
 * Which module runs when
 *   plan, current, fault  drive.h, which also has the states (HEARTBEAT.state).
 *   samples               sense.h.
 *   sync                  the edge goes to the chip clock (timing.h).
 *   main                  upkeep; what a beacon sends (drive.h) and what a sensor sends (sense.h), under one node
 *                         number; parameters, those of beacon and of sensor, in one page.
 * The board reports cycles whether its own coil is on or not, also in the states fault and syncing.
 *
 * Synchronisation. The sync master is one of the anchors or beacons; it measures like the others, on its own chip
 * clock. sync_source 1, the field, is for sensors: here it counts as 0. A master's SYNC may wait for main's other
 * work: 0.5 ms behind a cycle's end, 12 ms where it also computes poses; no later than sync.h takes it
 * (SYNC_FRESH_US).
 *
 * Its own field. Its own code belongs into the code list. That FIELD is the field of its own coil at its own sensor, a
 * fixed vector of the mounting (and the current), up to a thousand times those of the others; without it the others'
 * fields cannot be separated from what it leaves in them. Both ranges must hold it: that of FIELD, +-52.4 uT, and the
 * converter's, which the sum of all fields and the earth's must not leave (EPOCH_STATUS.saturated). boards/pinout.md
 * tells how far from the coil that is.
 *
 * Memory: 88 kB, and onboard.h and tracking.h.
 *
 * Time, as tests/firmware/apps/test_app_instructions.py counts it (Cortex-M4, -O2), with two channels: samples and
 * plan of a block take 10,300 + 6,700 instructions, with the block's current interrupts 29,000 of the 509,000 ticks of
 * a block. With degree 10 a report of 8 codes takes 68,000, main with nothing to do 452.
 */
#ifndef GOLDFIELD_ANCHOR_H
#define GOLDFIELD_ANCHOR_H

#include "hal/hal.h"
#include "services/drive.h"
#include "services/node.h"
#include "services/sense.h"
#include "services/timing.h"

/* Private but for tests. */
typedef struct {
    hal_t *hal;
    node_t node;
    timing_t timing;
    drive_t drive;
    sense_t sense;
} anchor_t;

/* Say hello, read the parameters, prepare the waveform and start the chip engine. What the arguments point at must live
 * for ever. No DMA touches *onboard and *tracking. */
void anchor_start(anchor_t *anchor, onboard_t *onboard, tracking_t *tracking, hal_t *hal);

/* Run one turn of the main loop. */
void anchor_step(anchor_t *anchor);

#endif

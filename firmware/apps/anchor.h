/* anchor.h: the application of an anchor: a beacon that also carries a sensor, as in US patent 6,691,074. It drives its
 * coil in step with the other boards and, with the same chips, measures the fields of all of them. What anchors measure
 * of each other tells where they stand.
 *
 * Which module runs when
 *   plan, current, fault: drive.h, which also has the states (HEARTBEAT.state).       samples: sense.h.       sync: the
 *     edge to the chip clock (timing.h).
 *   main: node; what a beacon sends (drive.h) and what a sensor sends (sense.h), of one node; parameters, those of
 *     beacon and of sensor, in one page.
 * The sync master is one of the anchors or beacons; it measures like the others, on its own chip clock. sync_source 1,
 * the field, is for sensors: here it counts as 0. Its SYNC may wait for main's other work: 0.5 ms behind a cycle's end,
 * 12 ms where it also computes poses; no later than sync.h takes it (SYNC_FRESH_US). It reports cycles whether its own
 * coil is on or not, also in the states fault and syncing.
 *
 * Its own field. Its own code belongs into the code list: that FIELD is the field of its own coil at its own sensor, a
 * fixed vector of the mounting (and the current), up to a thousand times those of the others; without it the others'
 * fields cannot be separated from what it leaves in them. Both ranges must hold it: that of FIELD, +-52.4 uT, and the
 * converter's, which the sum of all fields and the earth's must not leave (EPOCH_STATUS.saturated). How far from the
 * coil that is: boards/pinout.md.
 *
 * Memory: 80 kB. Time: tests/firmware/apps/test_app_instructions.py counts (Cortex-M4, -O2), with two channels: samples
 * and plan of a block 10,300 + 4,400 instructions, with the block's current interrupts 19,700 of the 509,000 ticks of a
 * block; with degree 10 a report of 8 codes 68,000, main with nothing to do 235.
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

/* Hello, parameters, waveform, chip engine. *anchor and *hal must live for ever. */
void anchor_start(anchor_t *anchor, hal_t *hal);

/* One turn of the main loop, to be called after each hal_wait(). */
void anchor_step(anchor_t *anchor);

#endif

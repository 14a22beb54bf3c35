/* sensor.h: the application of a sensor board: samples the field at the end of each chip and reports one vector a code
 * and cycle.
 *
 * Which module runs when
 *   plan (once a block): lengths of the next 31 chips from chip_clock, so that chips end with the beacons' chips.
 *   samples (once a block): sense.h.
 *   sync: the edge to chip_clock.
 *   With sync_source 1 (the field) acquire.h rules the chip clock instead of the wire: plan and samples serve it, main
 *     does its work piece by piece, samples are without
 *   the last conversion, and own chips run 3.12 us behind the beacons'. A wire that is there all the same is only
 *     compared: EPOCH_STATUS.phase.
 *   With sync_source 2 it follows SYNC and FOLLOW_UP on CAN (sync.h); a wire is only compared, likewise.
 *   main: node; reports (sense.h).
 *
 * States: starting (no block yet), syncing, running (locked), clock_fallback.
 *
 * The degree of the codes is a parameter, read once at start. Field synchronisation is for degree 10: with another,
 * sync_source 1 counts as 0. All others act from the next report on.
 *
 * Memory: 71 kB, and acquire.h. Time: tests/firmware/apps/test_app_instructions.py counts (Cortex-M4, -O2): plan of a
 * block 2,000 instructions, samples of a block 14,300 at most (with sync_source 1 16,800), with degree 10 a report of 8
 * codes 67,000, main with nothing to do 180.
 */
#ifndef GOLDFIELD_SENSOR_H
#define GOLDFIELD_SENSOR_H

#include "core/timing/acquire.h"
#include "hal/hal.h"
#include "services/node.h"
#include "services/sense.h"
#include "services/timing.h"

/* Private but for tests. */
typedef struct {
    hal_t *hal;
    node_t node;
    timing_t timing;
    sense_t sense;
    acquire_t *acquire;
} sensor_t;

/* Hello, parameters, chip engine. *sensor, *acquire and *hal must live for ever. No DMA touches *acquire. */
void sensor_start(sensor_t *sensor, acquire_t *acquire, hal_t *hal);

/* One turn of the main loop, to be called after each hal_wait(). */
void sensor_step(sensor_t *sensor);

#endif

/* sensor.h: the application of a sensor board: it samples the field at the end of each chip and reports one vector for
 * each code and cycle.
 *
 * Calls: sensor_start once, then sensor_step after each hal_wait().
 *
 * Which module runs when
 *   plan     once a block: lengths of the next 31 chips from chip_clock, so that chips end with the beacons' chips.
 *   samples  once a block: sense.h.
 *   sync     the edge goes to the chip clock (timing.h).
 *   main     upkeep; reports (sense.h).
 *
 * Sources of time (parameter sync_source)
 *   0  The chip clock follows the sync wire.
 *   1  acquire.h rules the chip clock by the field instead. plan and samples serve it, main does its work piece by
 *      piece, samples are without the last conversion, and own chips run 3.12 us behind the beacons'. A wire that is
 *      there all the same is only compared: EPOCH_STATUS.phase. Field synchronisation is for degree 10; with another,
 *      1 counts as 0.
 *   2  The chip clock follows SYNC and FOLLOW_UP on CAN (sync.h); a wire is only compared, likewise.
 *
 *   3  The chip clock chooses: the wire, CAN, and where both are silent the field (source.h). A sensor that was in step
 *      goes over with the phase that it has, tracks the 16 strongest of the codes that it reports, and keeps its lock.
 *      With strongest above 0 and an empty code list it can follow the field only after it has been in step with a
 *      wire or with CAN, since only then has it heard codes.
 *
 * States: starting (no block yet), syncing, running (locked), clock_fallback.
 *
 * The degree of the codes is a parameter that is read once, at start. All others act from the next report on.
 *
 * Memory: 79 kB, and acquire.h, onboard.h and tracking.h.
 *
 * Time, as tests/firmware/apps/test_app_instructions.py counts it (Cortex-M4, -O2): plan of a block takes 2,000
 * instructions, samples of a block 14,300 at most (with sync_source 1 16,800), with degree 10 a report of 8 codes
 * 67,000, main with nothing to do 270.
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
    uint32_t replaced_cycle; /* The cycle whose strongest codes are tracked. */
} sensor_t;

/* Say hello, read the parameters and start the chip engine. What the arguments point at must live for ever. No
 * DMA touches *acquire, *onboard and *tracking. */
void sensor_start(sensor_t *sensor, acquire_t *acquire, onboard_t *onboard, tracking_t *tracking, hal_t *hal);

/* Run one turn of the main loop. */
void sensor_step(sensor_t *sensor);

#endif

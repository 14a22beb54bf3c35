/* beacon.h: the application of a beacon board: it drives its coil, or its two crossed coils, in step with the other
 * boards.
 *
 * Calls: beacon_start once, then beacon_step after each hal_wait().
 *
 * Which module runs when
 *   plan, current, fault  drive.h, which also has the states (HEARTBEAT.state).
 *   sync                  the edge goes to the chip clock (timing.h).
 *   main                  upkeep; SYNC if master, DRIVE_STATUS, parameters (drive.h).
 *
 * Memory: 23 kB.
 *
 * Time, as tests/firmware/apps/test_app_instructions.py counts it (Cortex-M4, -O2), for one channel and, in brackets,
 * for a rotating field: plan of a block takes 4,600 (6,500) instructions, current 250 (320), once in 31 chips 590
 * (680), main with nothing to do 315.
 */
#ifndef GOLDFIELD_BEACON_H
#define GOLDFIELD_BEACON_H

#include "hal/hal.h"
#include "services/drive.h"
#include "services/node.h"
#include "services/timing.h"

/* Private but for tests. */
typedef struct {
    hal_t *hal;
    node_t node;
    timing_t timing;
    drive_t drive;
} beacon_t;

/* Say hello, read the parameters, prepare the waveform and start the chip engine. *beacon and *hal must live for ever.
 * Costs about 300,000 instructions, with a rotating field of 2047 chips 450,000 (2.7 ms). */
void beacon_start(beacon_t *beacon, hal_t *hal);

/* Run one turn of the main loop. */
void beacon_step(beacon_t *beacon);

#endif

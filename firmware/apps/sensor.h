/* sensor.h: the application of a sensor board: samples the field at the end of each chip and reports one vector a code and cycle.
 *
 * Which module runs when
 *   plan (once a block): lengths of the next 31 chips from chip_clock, so that chips end with the beacons' chips.
 *   samples (once a block): each chip's burst to one sample (epoch_sample), labelled by chip_clock_at, into the cycle being collected (epoch_feed); as CHIP if streamed.
 *   sync: the edge to chip_clock.
 *   With sync_source 1 (the field) acquire.h rules the chip clock instead of the wire: plan and samples serve it, main does its work piece by piece, samples are without
 *   the last conversion, and own chips run 3.12 us behind the beacons'. A wire that is there all the same is only compared: EPOCH_STATUS.phase.
 *   With sync_source 2 it follows SYNC and FOLLOW_UP on CAN (sync.h); a wire is only compared, likewise.
 *   main: node; a complete cycle is transformed (epoch_read) while the next is collected, and reported on both links: EPOCH, EPOCH_STATUS,
 *   EPOCH_OFFSET, one FIELD for each code of the list. With parts 3 each third of a cycle is, with its PARTs, before that.
 *   If it is to, the sensor then computes its own pose and sends it (onboard.h).
 *
 * States: starting (no block yet), syncing, running (locked), clock_fallback. Cycles are reported locked or not; EPOCH_STATUS.locked tells. A cycle that the chip
 * clock cut short, and one that main was too late for, is dropped and counted (counter 13). Also counted is one whose report found no room in the queue of a link, which then
 * carries nothing of it: a report comes whole or not at all.
 *
 * Numbers and times. Cycles count from 0 at start, until SYNC tells the number of the cycle that the latest edge of the sync wire began. EPOCH.time is the middle of the
 * cycle in microseconds of the sensor's own chip clock since its start; exact to 1 us.
 *
 * Parameters act from the next report on. stream sends every chip on serial (164 kB/s of 200 kB/s); chips that find no room are dropped and counted
 * as lost messages (counter 4).
 *
 * Cycles. The degree of the codes is a parameter, read once at start. Field synchronisation and thirds are for degree 10: with another, sync_source 1 counts as 0 and parts 3 as 1.
 * Short cycles leave little time. A report of n codes is n + 3 messages, and 3 of the pose. Without poses, on CAN (at most 160 us each) a cycle of degree 5 has room for 15 codes, of degree 6 for 35, of the others
 * for all 64; on serial (80 us) of degree 5 for 34, which is more than 31 chips tell apart. Poses (parameter pose) take up to 12 ms with no prior, 1.2 ms from the
 * pose before: cycles that end meanwhile are dropped.
 *
 * Memory: about 73 kB, and acquire.h. Time: tests/firmware/apps/test_app_instructions.py counts (Cortex-M4, -O2): plan of a block 1,800 instructions, samples of a block
 * 18,000 (with sync_source 1 30,000), with degree 10 a report of 8 codes 66,000, main with nothing to do 150.
 * With parts 3 the thirds of a cycle take 206,000 in main (three transforms, 171,000), 1.2 % of a cycle, and main must be back within a third of a cycle. The messages of more than
 * 60 codes then outrun the queue of CAN at the end of a cycle: what finds no room is counted as lost (counter 4).
 * Latency from the end of a cycle to the report's first byte: the rest of the block (at most 3.03 ms) and the transform (0.5 ms).
 */
#ifndef GOLDFIELD_SENSOR_H
#define GOLDFIELD_SENSOR_H

#include "acquire.h"
#include "chip_clock.h"
#include "epoch.h"
#include "hal.h"
#include "node.h"
#include "onboard.h"
#include "sync.h"

#define SENSOR_STREAM_MESSAGES 128u /* Four blocks of chips. */

/* Private but for tests. */
typedef struct {
    hal_t *hal;
    node_t node;
    sync_format_t format;
    chip_clock_t clock;
    epoch_collector_t collector;
    epoch_sums_t part, cycle; /* Just read, and what is complete of its cycle. */
    epoch_calibration_t calibration;
    epoch_selection_t selection;
    onboard_t onboard;
    acquire_t *acquire;
    uint32_t unsent;               /* Cycles for whose report a link had no room. */
    sync_link_t link;
    volatile bool by_field;        /* The chip clock follows the field: acquire is the interrupts'. */
    volatile bool streaming;
    volatile bool sampled;         /* A block has been taken. */
    uint64_t ticks;                /* Length of all chips taken so far. */
    uint64_t cycle_start_ticks;    /* Of the cycle being collected. */
    uint64_t middle_ticks;         /* Of the cycle that is main's. */
    volatile uint32_t edge_us;     /* When the latest edge of the sync wire came; one word, so that it is never torn. */
    queue_t stream;
    frame_t stream_messages[SENSOR_STREAM_MESSAGES];
    uint32_t stream_id;            /* Identifier of a CHIP with index 0. */
} sensor_t;

/* Hello, parameters, chip engine. *sensor, *acquire and *hal must live for ever. No DMA touches *acquire. */
void sensor_start(sensor_t *sensor, acquire_t *acquire, hal_t *hal);

/* One turn of the main loop, to be called after each hal_wait(). A complete cycle costs about 60,000 instructions and 800 for each code. */
void sensor_step(sensor_t *sensor);

#endif

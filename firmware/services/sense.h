/* sense.h: the part of an application that measures the field: from the samples of a block to one vector a code and
 * cycle, on both links.
 *
 * Which module runs when
 *   samples (once a block): each chip's burst to one sample (epoch_sample), labelled by chip_clock_at, into the cycle
 *     being collected (epoch_feed); as CHIP if streamed.
 *   main: a complete cycle is transformed (epoch_read) while the next is collected, and reported on both links: EPOCH,
 *     EPOCH_STATUS,
 *   EPOCH_OFFSET, one FIELD for each code of the list. With parts 3 each third of a cycle is, with its PARTs, before
 *     that.
 *   If it is to, the board then computes its own pose and sends it (onboard.h).
 *
 * Cycles are reported locked or not; EPOCH_STATUS.locked tells. A cycle that the chip clock cut short, and one that
 * main was too late for, is dropped and counted (counter 13). Also counted is one whose report found no room in the
 * queue of a link, which then carries nothing of it: a report comes whole or not at all.
 *
 * Numbers and times. Cycles count from 0 at start, until SYNC tells the number of the cycle that the latest edge of the
 * sync wire began. EPOCH.time is the middle of the cycle in microseconds of the board's own chip clock since its start;
 * exact to 1 us.
 *
 * Parameters act from the next report on. stream sends every chip on serial (164 kB/s of 200 kB/s); chips that find no
 * room are dropped and counted as lost messages (counter 4).
 *
 * Cycles. The degree of the codes is a parameter, read once at start. Thirds are for degree 10: with another, parts 3
 * counts as 1. Short cycles leave little time. A report of n codes is n + 3 messages, and 3 of the pose. Without poses,
 * on CAN (at most 160 us each) a cycle of degree 5 has room for 15 codes, of degree 6 for 35, of the others for all 64;
 * on serial (80 us) of degree 5 for 34, which is more than 31 chips tell apart. Poses (parameter pose) take up to 12 ms
 * with no prior, 1.2 ms from the pose before: cycles that end meanwhile are dropped.
 *
 * Memory: 62 kB. Time: samples of a block 10,300 instructions, with parts 3 14,300 (following the field 16,800), with
 * degree 10 a report of 8 codes 67,000 (tests/firmware/apps/test_app_instructions.py). With parts 3 the thirds of a
 * cycle take 206,000 in main (three transforms, 171,000), 1.2 % of a cycle, and main must be back within a third of a
 * cycle. The messages of more than 60 codes then outrun the queue of CAN at the end of a cycle: a third or a report
 * that finds no room there is left out of that link and counted (counter 13). Latency from the end of a cycle to the
 * report's first byte: the rest of the block (at most 3.03 ms) and the transform (0.5 ms).
 */
#ifndef GOLDFIELD_SENSE_H
#define GOLDFIELD_SENSE_H

#include "core/codes/epoch.h"
#include "core/link/queue.h"
#include "core/timing/acquire.h"
#include "hal/hal.h"
#include "services/node.h"
#include "services/onboard.h"
#include "services/timing.h"

#define SENSE_STREAM_MESSAGES 128u /* Four blocks of chips. */

/* Private but for tests, sampled and selection. */
typedef struct {
    node_t *node;
    const timing_t *timing;
    epoch_collector_t collector;
    epoch_sums_t part, cycle; /* Just read, and what is complete of its cycle. */
    epoch_calibration_t calibration;
    epoch_selection_t selection; /* Codes reported. */
    onboard_t onboard;
    uint32_t unsent; /* Reports, of thirds too, for which a link had no room. */
    volatile bool streaming;
    volatile bool sampled;      /* A block has been taken. */
    uint64_t ticks;             /* Length of all chips taken so far. */
    uint64_t cycle_start_ticks; /* Of the cycle being collected. */
    uint64_t middle_ticks;      /* Of the cycle that is main's. */
    queue_t stream;
    frame_t stream_messages[SENSE_STREAM_MESSAGES];
    uint32_t stream_id; /* Identifier of a CHIP with index 0. */
} sense_t;

/* Main, before the chip engine starts; node and timing are started, and live for ever. */
void sense_start(sense_t *sense, node_t *node, const timing_t *timing);

/* Main, when a parameter changed. */
void sense_configure(sense_t *sense);

/* The samples of a block, as hal_events_t.samples has them. acquire: NULL, or what synchronises by the field: it
 * gets every burst, and samples are without the last conversion. */
void sense_samples(sense_t *sense, uint32_t block, const hal_samples_t *samples, acquire_t *acquire);

/* One turn of the main loop, before node_step: a complete cycle, if there is one, costs about 60,000 instructions
 * and 800 for each code. */
void sense_step(sense_t *sense);

/* And after node_step, when the fields are on their way: chips that are streamed, and the own pose, whose messages
 * leave in the next turn. */
void sense_spare(sense_t *sense);

#endif

/* sense.h: the part of an application that measures the field: it turns the samples of each block into one vector for
 * each code and cycle, and reports them on both links.
 *
 * Calls, in the order they are made
 *   1. sense_start      main, once, before the chip engine starts.
 *   2. sense_samples    interrupt, once a block: each chip's burst becomes one sample (epoch_sample), is labelled by
 *                       chip_clock_at, and goes into the cycle being collected (epoch_feed) and into the block
 *                       (blocks.h); it is also sent as CHIP if chips are streamed.
 *   3. sense_blocks     main, first in a turn: a block leaves as BLOCK and BLOCK_SUMs at once, and its sums go to the
 *                       sensor's own track (tracking.h), which sends its pose.
 *   4. sense_step       main, once a turn: a complete cycle is transformed while the next is collected, and reported on
 *                       both links: EPOCH, EPOCH_STATUS, EPOCH_OFFSET, one FIELD for each code that is selected.
 *      sense_spare      main, after upkeep_step: streamed chips leave, and the board computes its own pose and sends
 * it, if it is to (onboard.h). sense_configure  main, when a parameter has changed: it acts from the next report on.
 *
 * Reports. Cycles are reported locked or not; EPOCH_STATUS.locked tells. A cycle that the chip clock cut short, and
 * one that main was too late for, is dropped, and counted (counter 13) unless the clock had not been locked before. A
 * report that finds no room in the queue of a link is counted there, too, and that link then carries nothing of it: a
 * report comes whole or not at all.
 *
 * Selection. Selected are the codes of the parameter code_list, or, with strongest = K above 0, the K strongest of each
 * cycle (strongest.h), chosen before it is reported; in a cycle without lock the selection stays. Blocks carry the
 * selection as it is when their sums are made: that of the cycle reported last. They are made and sent in one go, so
 * that a change falls between blocks; what waits are samples. A track of the board's own (pose_blocks) needs the same
 * codes all the time: with strongest its poses fail (tracking.h). Its poses of cycles take what is both selected and in
 * the code list (onboard.h); synchronisation by the field takes the code list (sync_source 1), or the strongest of what
 * is selected (3; source.h).
 *
 * Numbers and times. Cycles count from 0 at start, until SYNC tells the number of the cycle that the latest edge of
 * the sync wire began. EPOCH.time is the middle of the cycle in microseconds of the board's own chip clock since its
 * start, exact to 1 us.
 *
 * Stream. Parameter stream sends every chip on serial (164 kB/s of 200 kB/s). Chips that find no room are dropped and
 * counted as lost messages (counter 4).
 *
 * Short cycles. The degree of the codes is a parameter, read once at start. Short cycles leave little time: a report of
 * n codes is n + 3 messages, and 4 of the pose. So many codes fit without poses, at the highest rates:
 *   link     a message     degree 5   degree 6   other degrees
 *   CAN      160 us           15         35         all 64
 *   serial    80 us           34         all 64     all 64
 * 34 is more than 31 chips tell apart. Poses (parameter pose) take 7 ms with no prior, 3 ms from the pose before,
 * and 27 ms where fields and site do not agree (pose.h); cycles that end meanwhile are answered as failed.
 *
 * Blocks that are sent come first: a step of a pose, of up to 1.3 ms, begins only in the 1.2 ms after a block (and at
 * least one does), so that the next one leaves at once. Where the sensor makes poses of blocks itself they wait, since
 * there is no time to lose.
 *
 * Blocks (parameter blocks) take half of CAN or a quarter of serial for 8 codes (framing.md, "Budget").
 *
 * Memory: 68 kB, and onboard.h and tracking.h.
 *
 * Time (tests/firmware/apps/test_app_instructions.py): the samples of a block take 10,600 instructions, with blocks
 * 12,500, when following the field 17,100; with degree 10 a report of 8 codes takes 67,000, and 70,000 more
 * where the strongest are chosen, 190,000 in a cycle in which all of them are new.
 *
 * Latency from the end of a cycle to the report's first byte: the rest of the block (at most 3.03 ms) and the
 * transform (0.5 ms).
 */
#ifndef GOLDFIELD_SENSE_H
#define GOLDFIELD_SENSE_H

#include "core/codes/epoch.h"
#include "core/codes/strongest.h"
#include "core/link/queue.h"
#include "core/timing/acquire.h"
#include "hal/hal.h"
#include "services/blocks.h"
#include "services/node.h"
#include "services/onboard.h"
#include "services/timing.h"
#include "services/tracking.h"

#define SENSE_TURN_US         2000u /* Time in a turn after which no step of a pose begins: a block takes 3 ms. */
#define SENSE_BEGIN_US        1200u /* Time behind a block that is sent after which none begins: one takes 1.3 ms. */
#define SENSE_STREAM_MESSAGES 128u  /* Length of the queue of streamed chips: four blocks. */

/* Private but for tests, sampled and selection. */
typedef struct {
    node_t *node;
    const timing_t *timing;
    epoch_collector_t collector;
    epoch_sums_t cycle; /* The sums of the latest cycle. */
    epoch_calibration_t calibration;
    epoch_selection_t selection; /* The codes that are reported. */
    strongest_t strongest;
    uint32_t most; /* The most codes that are chosen by their strength; 0: those of the code list. */
    blocks_t blocks;
    onboard_t *onboard;
    tracking_t *tracking;
    block_t block;              /* Lent to it: it would fill the core-coupled memory. */
    bool tracks_first;          /* Spare time goes to the start of the track first, then to the pose of a cycle. */
    uint64_t block_us;          /* When the latest block was seen, us. */
    bool begun;                 /* A step of a pose has begun since then. */
    uint32_t unsent;            /* Reports of cycles for which a link had no room. */
    volatile bool streaming;    /* Every chip is sent on serial. */
    volatile bool sampled;      /* A block has been taken. */
    uint64_t ticks;             /* Length of all chips taken so far, ticks. */
    uint64_t cycle_start_ticks; /* The value of ticks at the start of the cycle being collected. */
    uint64_t middle_ticks;      /* The value of ticks in the middle of the cycle that is main's. */
    queue_t stream;             /* Streamed chips that wait for the serial port. */
    frame_t stream_messages[SENSE_STREAM_MESSAGES];
    uint32_t stream_id; /* The identifier of a CHIP with index 0. */
} sense_t;

/* Read the parameters and begin to collect; main calls it before the chip engine starts. node and timing have been
 * started, and live for ever, as do onboard and tracking, which no DMA touches. */
void sense_start(sense_t *sense, node_t *node, const timing_t *timing, onboard_t *onboard, tracking_t *tracking);

/* Read the parameters again. */
void sense_configure(sense_t *sense);

/* Read the parameter code_list. Returns how many codes it has. */
uint32_t sense_code_list(const sense_t *sense, uint16_t codes[EPOCH_CODES_MAX]);

/* Returns whether codes are in the code list, or were chosen by their strength. */
bool sense_has_codes(const sense_t *sense);

/* Tell the codes, at most so many, that were strongest of those reported in the latest cycle, strongest first. Costs
 * about 30 instructions for each of them and each code that is reported.
 * Returns how many they are. */
uint32_t sense_strongest(const sense_t *sense, uint16_t *codes, uint32_t most);

/* Take the samples of a block, as hal_events_t.samples has them. acquire is NULL, or the module that synchronises by
 * the field: it gets every burst. Samples of chips that are late (source_late) are made without the last conversion. */
void sense_samples(sense_t *sense, uint32_t block, const hal_samples_t *samples, acquire_t *acquire);

/* Make the sums of the blocks that wait, if blocks are wanted, send them, and make their poses (tracking.h): none is
 * begun after SENSE_TURN_US, and none is taken while a track starts. Costs 700 instructions a code and 3,000 for each
 * block, and what a pose costs. */
void sense_blocks(sense_t *sense);

/* Report a complete cycle, if there is one: one turn of the main loop, before upkeep_step. A cycle costs about
 * 60,000 instructions and 800 for each code. */
void sense_step(sense_t *sense);

/* Do what can wait until the fields are on their way, after upkeep_step: send streamed chips, and compute the board's
 * own pose, whose messages leave in the next turn. */
void sense_spare(sense_t *sense);

#endif

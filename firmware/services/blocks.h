/* blocks.h: the sums of each block of 31 chips (block_sums.h), made and sent as soon as the block is over: BLOCK and
 * one BLOCK_SUM for each reported code, on the links that the parameter blocks names.
 *
 * Calls, in the order they are made (main, but for blocks_chip)
 *   1. blocks_start      once.
 *   2. blocks_configure  at start, and when a parameter has changed.
 *   3. blocks_chip       interrupt, for each chip that was sampled.
 *   4. blocks_step       once a turn, again and again until it returns NULL.
 *
 * The sums are made if any link carries them, or if poses of the block filter are wanted (parameters pose = 1 and
 * pose_blocks above 0). A link gets a block whole or not at all, and only if its queue then still holds the report of a
 * cycle: more codes than a link can carry cost blocks, and never the fields. On CAN a board keeps to its part of the
 * bus (bus_share.h): with more than 12 codes, or with other sensors there, it leaves some blocks out, evenly. They are
 * not counted: block_low tells the receiver.
 *
 * Time from the end of the block's last chip to the first byte (8 codes, an instruction a cycle): 75 us in the sample
 * interrupt and 65 us in main (tests/firmware/apps/test_app_instructions.py). The last byte follows after 80 us a
 * message on serial, and at most 160 us on CAN, at the highest rates.
 *
 * Memory: 3.2 kB.
 */
#ifndef GOLDFIELD_BLOCKS_H
#define GOLDFIELD_BLOCKS_H

#include "core/codes/block_sums.h"
#include "hal/hal.h"
#include "services/node.h"
#include "services/pose_report.h"

/* Messages of a cycle's report besides its FIELDs: EPOCH, EPOCH_STATUS, EPOCH_OFFSET, and those of the pose. A block
 * leaves room for them. */
#define BLOCKS_REPORT_BESIDE (3u + POSE_REPORT_MESSAGES)

/* Fields are private. */
typedef struct {
    code_bits_t codes;
    block_collector_t collector;
    block_sums_t sums;    /* Those of the latest block. */
    node_links_t links;   /* The links that carry blocks. */
    volatile bool wanted; /* Blocks are collected. */
} blocks_t;

/* Prepare for the codes of a family. */
void blocks_start(blocks_t *blocks, const gold_family_t *family);

/* Read the parameters again. */
void blocks_configure(blocks_t *blocks, const parameters_t *parameters);

/* Take a sampled chip, as of block_collect, if blocks are wanted. */
static inline void blocks_chip(blocks_t *blocks, uint32_t absolute_chip, uint32_t cycle, uint32_t code_chip,
                               const int16_t sample[EPOCH_AXES], uint32_t saturated, bool locked) {
    if (blocks->wanted) {
        block_collect(&blocks->collector, absolute_chip, cycle, code_chip, sample, saturated, locked);
    }
}

/* Returns whether any block waits. */
static inline bool blocks_waiting(const blocks_t *blocks) {
    return block_ready(&blocks->collector) != NULL;
}

/* Make the sums of the oldest block that waits, and send them at once. Returns them, valid until the next call, or NULL
 * if there is none. */
const block_sums_t *blocks_step(blocks_t *blocks, node_t *node, const epoch_selection_t *selection,
                                const epoch_calibration_t *calibration);

#endif

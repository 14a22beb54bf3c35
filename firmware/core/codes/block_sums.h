/* block_sums.h: sums of each 31 successive samples with each code, and without: what a filter needs to make a pose 330
 * times a second (docs/blocks.md). A collector gathers labelled samples into blocks, a few of which may wait for main.
 *
 * Calls, in the order they are made
 *   1. block_collect_init  once.
 *   2. block_collect       interrupt, for each chip that was sampled.
 *   3. block_ready         main; then block_sums, and block_release.
 *
 * Which blocks. A block is the 31 chips that the chip engine executes together: absolute chips 31 k to 31 k + 30. It
 * may begin at any chip of the code, and run into the next cycle. It is handed over if every chip was sampled, each is
 * the code's next one after that before it, and the chip clock was locked at all of them. All others are left out; so
 * are those that come while main holds BLOCKS_WAITING of them. Their numbers tell how many.
 *
 * Scale. As in epoch.h, with c[t] of the code's 31 chips in place of a whole period, and not divided by anything:
 *   sum_t c[t] B[t] = M (R / 8 - (zero - 2048) S),   R = sum_t c[t] sample[t],   S = sum_t c[t].
 *
 * Contexts: block_collect is called from the sample interrupt, block_ready, block_sums and block_release from main.
 */
#ifndef GOLDFIELD_BLOCK_SUMS_H
#define GOLDFIELD_BLOCK_SUMS_H

#include <stddef.h>

#include "core/codes/code_bits.h"
#include "core/codes/epoch.h"

#define BLOCK_CHIPS    CODE_BITS_CHIPS /* Chips in a block. */
#define BLOCKS_WAITING 8u              /* Most blocks that wait for main: as long as a start takes (tracking.h). */

/* ---- Collecting ---- */

typedef struct {
    int16_t samples[BLOCK_CHIPS][EPOCH_AXES]; /* As epoch_sample makes them. */
    uint32_t number;                          /* The block's number, its first absolute chip over 31. */
    uint32_t cycle;                           /* The number of the cycle of its first chip. */
    uint16_t chip;                            /* The code chip of its first chip. */
    uint8_t saturated;                        /* A bit for each axis with a saturated conversion: 1 x, 2 y, 4 z. */
} block_samples_t;

/* Fields are private. */
typedef struct {
    block_samples_t blocks[BLOCKS_WAITING];
    uint32_t length;           /* N, the chips in a cycle. */
    uint32_t next, next_code;  /* The absolute and the code chip that continue the block being filled. */
    uint32_t filled, released; /* Blocks handed over to main, and given back by it, modulo 2^32. */
} block_collector_t;

/* Prepare to collect blocks of codes of this length. */
void block_collect_init(block_collector_t *collector, uint32_t length);

/* Take a sampled chip: its absolute number, what chip_clock_at says of it, its sample, and which axes are saturated, a
 * bit each as in block_samples_t. Chips come in order. Costs about 75 instructions. */
void block_collect(block_collector_t *collector, uint32_t absolute_chip, uint32_t cycle, uint32_t code_chip,
                   const int16_t sample[EPOCH_AXES], uint32_t saturated, bool locked);

/* Returns the oldest block that waits, main's until block_release; NULL if there is none. */
static inline const block_samples_t *block_ready(const block_collector_t *collector) {
    const uint32_t filled = __atomic_load_n(&collector->filled, __ATOMIC_ACQUIRE);
    return filled == collector->released ? NULL : &collector->blocks[collector->released % BLOCKS_WAITING];
}

/* Give that block back to the collector. */
void block_release(block_collector_t *collector);

/* ---- Sums ---- */

typedef struct {
    uint32_t number, cycle; /* As in block_samples_t. */
    uint16_t chip;
    uint8_t unmeasured;                             /* A bit for each axis of the field that was not measured. */
    uint32_t count;                                 /* The codes of the selection. */
    uint32_t bits[EPOCH_CODES_MAX];                 /* The chips of each code in this block, as of code_bits_at. */
    float sums_T[EPOCH_CODES_MAX + 1u][EPOCH_AXES]; /* Sums of field times code, T; row count is the plain sum. */
} block_sums_t;

/* Make the sums of a block with each code of the selection, in its order, and without. An axis of the field that the
 * calibration computes from a saturated one is not measured. Costs about 420 instructions a code and 720. */
void block_sums(const block_samples_t *block, const code_bits_t *codes, const epoch_selection_t *selection,
                const epoch_calibration_t *calibration, block_sums_t *sums);

#endif

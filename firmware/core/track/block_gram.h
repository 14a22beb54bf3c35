/* block_gram.h: what is known of a block of successive chips, block_t, and the products of its columns, which follow
 * from the codes alone. docs/blocks.md has the equations of this folder.
 *
 * Calls, in the order they are made: block_gram with the bits of the codes; then the caller sets the sums. Where
 * beacons are left out, block_leave_out (block_out.h) follows.
 *
 * Columns. Column i is the code of beacon i, +1 for a bit of 0 and -1 for a bit of 1; the last column is all ones and
 * stands for the ambient field. Sample t is tau_t = (t - (m - 1) / 2) chips from the middle of a block of m chips, so
 * that the last sample is (m - 1) / 2 chips after the middle. A column of zeros in gram and moment, with sums of zero,
 * tells nothing and is allowed.
 *
 * Method. The product of two columns has as many -1 as their exclusive or has ones; the count and the sum of the
 * places of these ones come out of one tree of sums within the word.
 *
 * Time (Cortex-M4): about 55 instructions for each pair of columns. Memory: block_t takes 9.1 kB.
 */
#ifndef GOLDFIELD_BLOCK_GRAM_H
#define GOLDFIELD_BLOCK_GRAM_H

#include <stdint.h>

#define BLOCK_BEACONS   32u                  /* Most beacons. */
#define BLOCK_COLUMNS   (BLOCK_BEACONS + 1u) /* Their columns, and the one of the ambient field. */
#define BLOCK_CHIPS_MAX 32u                  /* Most chips of a block. */

typedef struct {
    uint32_t columns;                           /* Beacons and 1. */
    float gram[BLOCK_COLUMNS][BLOCK_COLUMNS];   /* G0: the sums over the chips of column times column. */
    float moment[BLOCK_COLUMNS][BLOCK_COLUMNS]; /* G1: those of column times tau times column, s. */
    float sums_uT[BLOCK_COLUMNS][3]; /* S: the sums of column times calibrated sample, in the sensor's frame. */
} block_t;

/* Set columns, gram and moment of a block of so many beacons (at most BLOCK_BEACONS) and chips (1..BLOCK_CHIPS_MAX).
 * Bit t of bits[i] is the bit of code i in the block's chip t; bits behind the last chip do not count. */
void block_gram(const uint32_t *bits, uint32_t beacons, uint32_t chips, float chip_s, block_t *block);

#endif

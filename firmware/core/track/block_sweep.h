/* block_sweep.h: what a block of chips tells of the turn rate by the sweep of the ambient field: how fast that field
 * changes in the sensor's frame as the sensor turns. It makes attitudes of agile motion at .2 mG up to a quarter more
 * accurate (docs/blocks.md).
 *
 * Calls: block_sweep after block_measure (block_measure.h), with the same block; what it makes goes to
 * block_kalman_update beside the rest.
 *
 * Method. The ramp are the shares of the columns that come nearest to the time within the block; the rows of the sums
 * with these shares tell of the sweep. It is computed by conjugate gradients on the gram matrix: what few steps do not
 * tell of columns that depend on others, single precision does not see either. From these rows is taken what the
 * observed numbers of block_measure have told already.
 *
 * Limits. Where the observed numbers leave less than 1e-2 of the information on the sweep, as with one beacon and
 * mostly with two, it is left out. It is known no better than 5 uT/s, by which the ambient field changes within a block
 * itself, near iron.
 *
 * Time (Cortex-M4, -O3): 22,900 instructions a block with 8 beacons, 43,000 with 16, 102,000 with 32. With 8, the
 * updates of the four filters by these rows are 3,200 each of that. The sensor does without it; the host asks for it.
 */
#ifndef GOLDFIELD_BLOCK_SWEEP_H
#define GOLDFIELD_BLOCK_SWEEP_H

#include <stdint.h>

#include "core/track/block_measure.h"

#define BLOCK_SWEEPS 3u /* Rows that tell of the sweep. */

typedef struct {
    float rows[BLOCK_SWEEPS][BLOCK_ROW]; /* [A y], as those of block_measure_t; the columns of position are zero. */
} block_sweep_t;

/* Compute the rows of the sweep, from a block and what block_measure has made of it.
 * Returns how many of them tell something; the others are zero. */
uint32_t block_sweep(const block_t *block, const block_measure_t *measure, block_sweep_t *sweep);

#endif

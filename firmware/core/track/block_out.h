/* block_out.h: beacons that are not to be believed, taken out of a block; and the fields of a block, separated.
 *
 * Calls: block_leave_out once for each beacon, after block_gram and the sums. block_separate begins the start with no
 * prior: it gives the fields that core/pose locates.
 *
 * Method. The signal of a beacon that is left out is still in the samples, so its field is taken as unknown and
 * eliminated: Gauss on the rows of gram, moment and sums. The column becomes zeros, and all others stay where they are.
 *
 * Time (Cortex-M4, -O3), with 8, 16 and 32 beacons: block_leave_out 6,000, 8,400 and 17,000 instructions,
 * block_separate 11,400, 41,700 and 233,000.
 */
#ifndef GOLDFIELD_BLOCK_OUT_H
#define GOLDFIELD_BLOCK_OUT_H

#include <stdbool.h>

#include "core/track/block_gram.h"

/* Take the beacon of a column out of a block. */
void block_leave_out(block_t *block, uint32_t column);

/* Separate the fields of a block in place: each row of sums_uT becomes the field of its column, uT in the sensor's
 * frame, the last one the ambient field's; gram becomes the covariance of these fields over the variance of a sample,
 * the same for each axis. Columns of zeros are passed over and stay so: their fields are 0.
 * Returns false, with gram and sums_uT destroyed, if the columns are not independent enough in so few chips. */
bool block_separate(block_t *block);

#endif

/* block_cycle.h: the fields of a code cycle as a sensor in motion would have measured them at rest in the middle of the
 * cycle: what the residuals of its blocks leave of them, beside the fields at the track's own pose. By themselves, the
 * sums of a cycle mix the fields of all places that the sensor has been to; these can be judged like those of a sensor
 * that stands still.
 *
 * Calls, in the order they are made: block_cycle_clear at first, and when the track starts anew; block_cycle_add with
 * each block, of the same columns from one clear to the next; when that returns true, residual_uT are the sums to
 * separate, and block_cycle_field makes a field of each.
 *
 * Method. A cycle of BLOCK_CYCLE_BLOCKS blocks sums every code over a whole period, so that the sums of the residuals
 * (block_residual.h) separate like those of a cycle (core/codes/separation.h). To them the fields at the predicted pose
 * in the middle of the cycle are added, and all is turned into the sensor's frame there. Errors of the prediction come
 * back as a shift of the pose that is located from these fields.
 *
 * Limits. Cycles of BLOCK_CYCLE_CHIPS chips only (degree 10): other lengths are no multiple of a block, or one block.
 *
 * Memory: 500 bytes.
 */
#ifndef GOLDFIELD_BLOCK_CYCLE_H
#define GOLDFIELD_BLOCK_CYCLE_H

#include <stdbool.h>
#include <stdint.h>

#include "core/track/block_residual.h"
#include "core/track/block_select.h"

#define BLOCK_CYCLE_CHIPS  1023u                                    /* Chips in a cycle. */
#define BLOCK_CYCLE_LENGTH 31u                                      /* Chips in a block. */
#define BLOCK_CYCLE_BLOCKS (BLOCK_CYCLE_CHIPS / BLOCK_CYCLE_LENGTH) /* Blocks in a cycle. */

typedef struct {
    const loop_t *coils;                 /* Those of the site ... */
    uint8_t rows[BLOCK_BEACONS];         /* ... of which these are the columns, ... */
    uint32_t count;                      /* ... so many. */
    uint32_t blocks;                     /* Blocks that are summed, fewer than all without the one with chip 0. */
    uint32_t next;                       /* The number of the block that continues them. */
    float residual_uT[BLOCK_COLUMNS][3]; /* Sums of their residuals, site's frame, uT. */
    float position_m[3], quaternion[4];  /* The pose in the middle of the cycle. */
} block_cycle_t;

/* Begin anew, with columns for those of the coils that were selected. The coils must live on. */
void block_cycle_clear(block_cycle_t *cycle, const loop_t *coils, const block_select_t *select);

/* Returns whether a cycle begins with the block that begins at a code chip: code chip 0 is in it. */
static inline bool block_cycle_begins(uint32_t chip) {
    return chip == 0u || chip + BLOCK_CYCLE_LENGTH > BLOCK_CYCLE_CHIPS;
}

/* Add the block of a number that begins at a code chip: its residual at the state that the filter predicts for its
 * middle. Returns true if a cycle is complete now, which the next call gives up. */
bool block_cycle_add(block_cycle_t *cycle, uint32_t number, uint32_t chip, float chip_s,
                     const block_residual_t *residual, const block_state_t *predicted);

/* Turn the separated residual of a column, uT in the site's frame, into its field in the sensor's frame, in place. */
void block_cycle_field(const block_cycle_t *cycle, uint32_t column, float field_uT[3]);

#endif

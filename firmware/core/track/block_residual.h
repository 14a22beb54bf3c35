/* block_residual.h: what a state leaves of the sums of a block, and whether that is more than noise and what is known
 * of the errors can make.
 *
 * Calls: block_residual with the block before beacons are left out of it; then block_residual_worst.
 *
 * Method. With S the sums of the block, R and B the attitude and the fields at the state, and G0 the gram matrix, the
 * residuals in the site's frame are S R' - G0 B (docs/blocks.md; what changes within a block is 1e-4 of the field). The
 * gate of block_filter.h looks only at what a block tells of the pose, so that a beacon that is silent, or all of them,
 * can lead it astray step by step. Here the residual of each beacon is compared with its variance by noise, by the
 * uncertainty of the state and by the declared errors of the site, to which the other beacons add theirs through the
 * gram matrix.
 *
 * Time (Cortex-M4): block_residual about 250 instructions a code and 10 for each pair, block_residual_worst 60 and 6.
 */
#ifndef GOLDFIELD_BLOCK_RESIDUAL_H
#define GOLDFIELD_BLOCK_RESIDUAL_H

#include <stdbool.h>
#include <stdint.h>

#include "core/track/block_errors.h"
#include "core/track/block_measure.h"

#define BLOCK_RESIDUAL_MOST 9.0f /* Largest square over its expectation: noise alone exceeds it in 6 of a million. */

typedef struct {
    float field_uT[BLOCK_COLUMNS][3]; /* Fields of the model, site's frame; the last one the ambient that is seen. */
    float left_uT[BLOCK_COLUMNS][3];  /* Residuals of the sums, site's frame. */
} block_residual_t;

/* How uncertain a state is: variances, each the sum over three axes. */
typedef struct {
    float position_m2, attitude_rad2, ambient_uT2;
} block_doubt_t;

/* Compute fields and residuals of a block of so many coils at a state. */
void block_residual(const block_t *block, const loop_t *coils, uint32_t count, const block_state_t *state,
                    block_residual_t *residual);

/* Returns the beacon whose residual is furthest beyond what it should be, or count if all are as small as that. A bit
 * of out stands for each beacon that does not count. */
uint32_t block_residual_worst(const block_residual_t *residual, const block_t *block, const loop_t *coils,
                              uint32_t count, const block_state_t *state, const block_doubt_t *doubt,
                              const block_site_errors_t *errors, float noise_uT, uint32_t out);

#endif

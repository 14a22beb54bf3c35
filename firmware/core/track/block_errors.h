/* block_errors.h: how far the pose of block_filter.h may be off because the site is not as declared: the positions,
 * axes and currents of the beacons, the gains and axes of the sensor. These errors are the same in every block, so they
 * do not average out, and no noise stands for them. docs/blocks.md has the equations.
 *
 * Calls: block_errors after block_filter_update, as often as the covariance is told; it changes slowly. What it gives
 * is added to the covariance of block_filter_output.
 *
 * Time (Cortex-M4, -O3): 48,000 instructions with 8 beacons, 93,000 with 16, 182,000 with 32.
 */
#ifndef GOLDFIELD_BLOCK_ERRORS_H
#define GOLDFIELD_BLOCK_ERRORS_H

#include "core/track/block_measure.h"

/* Standard deviations of what is declared of a beacon. */
typedef struct {
    float position_sd_m, axis_sd_rad, current_sd; /* Position, axis, and current (relative). */
} block_beacon_errors_t;

/* Standard deviations of what is declared of the site: one entry for each coil, and the sensor's. */
typedef struct {
    const block_beacon_errors_t *beacons;
    float gain_sd, axis_sd_rad; /* Gains (relative) and directions of the sensor's axes. */
} block_site_errors_t;

/* Compute the covariance of position (m) and a small turn in the site's frame (rad) by the errors of the site, around
 * the reference of *measure. It is zero in directions of which the block tells nothing. */
void block_errors(const block_measure_t *measure, const loop_t *coils, uint32_t count,
                  const block_site_errors_t *errors, float covariance[6][6]);

#endif

/* tracking_start.h: the first blocks of a track of the sensor's own (tracking.h): their sums are added until the fields
 * of all beacons can be separated, and these are located with no prior.
 *
 * Order: tracking_start_add for each block, tracking_start_search once, then pose_step of core/pose/pose.h until it is
 * done.
 * Contexts: main only. Time: some 40 instructions a pair of beacons and block; the search is the caller's, in steps.
 */
#ifndef GOLDFIELD_TRACKING_START_H
#define GOLDFIELD_TRACKING_START_H

#include "services/tracking_state.h"

/* Add a block to those that have been gathered: its moments are not needed. */
void tracking_start_add(tracking_t *tracking, const block_sums_t *sums);

/* Begin to locate the fields of the blocks gathered, in the memory that was lent (`work`); the pose will be `start`.
 * Returns false if they cannot be separated. */
bool tracking_start_search(tracking_t *tracking);

#endif

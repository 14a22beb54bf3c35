/* tracking_judge.h: what a pose of the sensor's own track (tracking.h) is worth: which beacons it is from, whether what
 * is known of it is enough for a linear filter, and its status, reason and protection level.
 *
 * Contexts: main only. Time: some 20 instructions a beacon, tracking_is_vague 180.
 */
#ifndef GOLDFIELD_TRACKING_JUDGE_H
#define GOLDFIELD_TRACKING_JUDGE_H

#include "services/tracking_state.h"

/* Deviation of the position, over the distance to the nearest beacon, beyond which nothing linear holds. */
#define TRACKING_WEAK_DISTANCE 0.25f

/* Returns whether the beacon of a row is not to be believed, or its coil is not known. */
bool tracking_is_out(const tracking_t *tracking, uint32_t row);

/* Returns the distance from a position to the nearest beacon that is believed, m. */
float tracking_nearest_m(const tracking_t *tracking, const float position_m[3]);

/* Returns whether a pose is vague: what its errors change in the field of a beacon by their second order is more than
 * the noise of a field after so many chips allows. The filter, which is linear, is not to go on from such a pose for
 * long. */
bool tracking_is_vague(const tracking_t *tracking, const pose_t *pose, float chips);

/* Set status, reason, left_out and protection_m of a pose of the track whose numbers are set. */
void tracking_judge(const tracking_t *tracking, pose_t *pose);

#endif

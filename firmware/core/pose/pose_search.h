/* pose_search.h: where to start a fit with no prior: on a shell around the strongest beacon, with the attitude
 * profiled out. The calls are pose_search_begin, pose_search until it returns true, then pose_search_attitude for each
 * candidate that is fitted.
 *
 * Method. The magnitude of the strongest field fixes the distance in each direction, |B| = k sqrt(1 + 3 cos^2) / r^3,
 * so that the unknown position lies on a shell around that beacon: a search in two dimensions, whatever the size of
 * the site. At each of so many points, evenly spread, Wahba's loss is what remains of the measured
 * fields with the best attitude there; the best few points that are clearly apart are the candidates.
 *
 * Time: about 2,500 instructions a direction with 8 beacons; it grows with the number of beacons. pose.h has the
 * total.
 */
#ifndef GOLDFIELD_POSE_SEARCH_H
#define GOLDFIELD_POSE_SEARCH_H

#include "core/pose/pose_problem.h"

#define POSE_SEARCH_CANDIDATES 6u /* Most candidates that are kept. */

typedef struct {
    float position_m[3];
    float loss; /* Wahba's loss there. */
} pose_candidate_t;

typedef struct {
    uint32_t count;
    pose_candidate_t candidates[POSE_SEARCH_CANDIDATES]; /* The best first. */
    uint32_t directions, next;                           /* Directions to look in, and the next one. */
    float x, y;                                          /* Where that one points, seen along the poles. */
} pose_candidates_t;

/* Begin to look in so many directions (300 are about 12 degrees apart). */
void pose_search_begin(uint32_t directions, pose_candidates_t *found);

/* Look for candidates for a problem of at least one beacon in the next directions, so many at most. Those outside the
 * half-space are left out. Returns whether all directions are done. */
bool pose_search(const pose_problem_t *problem, uint32_t most, pose_candidates_t *found);

/* Compute the best attitude at a position. */
void pose_search_attitude(const pose_problem_t *problem, const float position_m[3], float quaternion[4]);

#endif

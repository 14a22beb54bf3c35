/* pose_live.h: the pose of each cycle in time, though to explain what is wrong with its fields takes several cycles.
 *
 * Calls, for each cycle: pose_live_begin, then pose_live_step until the pose is complete; pose_live_spare while no pose
 * is being computed. pose_live_forget comes first of all, and when site or sensor have changed.
 *
 * Method. Each cycle is tracked or searched with all beacons. If its fields do not agree with the site, they are
 * reviewed in the time that the poses leave (pose_explain): what the review comes to is the verdict for the cycles from
 * then on. If it leaves out a beacon, later cycles are located without it as long as their own fields agree (Again in
 * pose_explain.h); if not, or before there is a verdict, the pose by all beacons is inconsistent. Its reason is that of
 * the verdict. As long as fields do not agree there is always a review under way, of the latest of them that it found.
 * A verdict serves up to POSE_LIVE_CYCLES poses after the one whose fields it is from.
 *
 * Time and memory: see pose.h; 18.2 kB. Contexts: one.
 */
#ifndef GOLDFIELD_POSE_LIVE_H
#define GOLDFIELD_POSE_LIVE_H

#include "core/pose/pose.h"

#define POSE_LIVE_CYCLES 20u /* Most poses for which a verdict serves: a review takes up to 6 cycles. */

/* Private but for tests, and busy. */
typedef struct {
    pose_work_t work, review; /* For the latest cycle, and for the one that is being explained. */
    pose_t reviewed;
    pose_verdict_t verdict;
    uint32_t age, review_age; /* Poses begun after the one that the verdict is from, and the review. */
    bool busy, reviewing;     /* A pose is being computed, and a review. */
} pose_live_t;

/* Give up pose and review, and forget the verdict. */
void pose_live_forget(pose_live_t *live);

/* Begin the pose of a cycle, as pose_begin with track does. A pose that is not complete is given up. */
void pose_live_begin(pose_live_t *live, const pose_site_t *site, const pose_field_t *fields, pose_t *pose);

/* Do the next step of the pose. Returns true when *pose is complete. */
bool pose_live_step(pose_live_t *live, pose_t *pose);

/* Whether there is a pose or a review to go on with. */
static inline bool pose_live_at_work(const pose_live_t *live) {
    return live->busy || live->reviewing;
}

/* Do a step of the review, if there is one. Returns whether there was. */
bool pose_live_spare(pose_live_t *live);

#endif

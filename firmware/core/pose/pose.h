/* pose.h: position and attitude of the sensor from the fields of one cycle, in single precision: the location of
 * host/goldfield/locate on the board itself.
 *
 * Calls: pose_begin, then pose_step until it returns true, so that a long computation does not hold up the board.
 * pose_find and pose_track do it at once. A board that is to have the pose of each cycle in time calls pose_live.h.
 *
 * Method. With no prior, pose_solve finds the pose that explains the fields best. Tracking starts a fit from the
 * previous pose, and falls back to the search when that does not explain the fields. If no pose passes the tests of
 * pose_faults, pose_explain says what is wrong, and leaves out one faulty beacon. That takes longer than all the rest:
 * with a verdict of a cycle before, pose_begin makes it be left for later, and the pose is inconsistent unless the
 * fields agree without the beacon of that verdict.
 *
 * Differences from the host's location: one beacon is left out at most, not two; of more than 12 the most suspect 12
 * are tried. The sensor's distortion is named as strength or gains only. Errors
 * of the sensor are taken at the measured field, and a rough start knows no pose to take the errors of the site at.
 * The search is not a global one: near a coil another pose may be missed. A fault in a direction with less than 3e-6 of
 * its variance in the residuals counts as not detectable: close to a coil the status is more often unverified.
 *
 * Limits. Any mix of axes, moments and heights is allowed; coils are exact at any range. At least POSE_BEACONS_LEAST
 * beacons are needed. Sensors with fewer than three axes are not here but on the host.
 *
 * Images. Coplanar coils that all point across their plane have an exact mirror pose, p mirrored and the sensor turned
 * half around the normal, with exactly the same fields. The half-space decides, if there is one; else the status is
 * ambiguous. Nearly coplanar ones (a quarter of their extent) are tried too, and judged by the fields. So is the place
 * across the middle of all coils, from four times their extent on: coils around a point have the same fields there.
 *
 * Accuracy. Model, weights and covariance (pose_covariance) are the host's; the poses agree within a tenth of the
 * Cramer-Rao bound (tests/firmware/core/pose/test_pose.py; at a tenth of the noise, 0.2 mG, and about a radius from a
 * coil, rounding can make it a fifth).
 *
 * Time (Cortex-M4, gcc 12 -O3, counted in Unicorn by tests/firmware/core/pose/test_pose_instructions.py, 8 beacons in
 * a cube). Every loop is bounded; time grows with the number of beacons heard. In brackets: with declared errors.
 *   pose_find    1,001,000 instructions (1,080,000) when a pose explains the fields.
 *   pose_track   236,000 instructions (392,000), at most 250,000 (423,000) with the previous pose 0.1 m and 0.1 rad
 *                away; when it has to search, those of pose_find too.
 *   pose_step    at most 422,000 instructions (602,000, 3.6 ms at an instruction a cycle and 168 MHz, in a review).
 *   pose_live    when nothing explains the fields 2,230,000 a cycle (2,940,000, 18 ms), with one beacon left out by the
 *                verdict of a cycle before 2,150,000 (4,490,000, 27 ms); a review 9,600,000 (13,600,000, 81 ms), which
 *                in the time that poses leave of cycles of 100 ms takes two of them.
 *
 * Memory: pose_work_t 9.0 kB, pose_site_t 2,856 bytes, both the caller's; stack 2.9 kB.

 */
#ifndef GOLDFIELD_POSE_H
#define GOLDFIELD_POSE_H

#include "core/pose/pose_explain.h"

#define POSE_BEACONS_LEAST     3u   /* Fewest beacons that are located from: 9 components for 6 unknowns. */
#define POSE_TRACK_EVALUATIONS 14u  /* Most evaluations in the fit from the previous pose. */
#define POSE_STEPS_MOST        160u /* Most steps of a pose. */

typedef enum { POSE_STEP_BEGIN, POSE_STEP_TRACK, POSE_STEP_AGAIN, POSE_STEP_ALL, POSE_STEP_EXPLAIN } pose_stage_t;

/* What the explanation of one cycle's fields came to, for later cycles. */
typedef struct {
    uint32_t row;         /* Row of the beacon that was left out, or POSE_NOBODY. */
    pose_reason_t reason; /* Why no pose was good; POSE_REASON_PENDING if nothing is known. */
} pose_verdict_t;

/* Memory of one pose, from pose_begin to its last pose_step; its contents need not live from pose to pose. */
typedef struct {
    pose_solver_t solver; /* With the problem. */
    pose_explain_t explain;
    pose_verdict_t verdict;
    pose_stage_t stage; /* What comes after the search that is under way. */
    bool known;         /* There is a previous pose; at first it is in solver.best. */
    bool later;         /* What is wrong with the fields is not explained here. */
    bool alarmed;       /* The fields of all beacons do not agree with the site. */
} pose_work_t;

/* Begin a pose. fields has one entry for each beacon of the site, site->count of them; fields that are not finite count
 * as not heard. With track, *pose is the previous pose: it is where the first step starts, unless it failed. With
 * a verdict, which is copied, fields that do not agree with the site are left for pose_review; it is NULL otherwise. */
void pose_begin(const pose_site_t *site, const pose_field_t *fields, bool track, const pose_verdict_t *verdict,
                pose_work_t *work, pose_t *pose);

/* Begin to explain the fields of a complete pose that was alarmed, by steps of its own. *pose becomes what it would
 * have been without a verdict. */
void pose_review(const pose_work_t *work, pose_work_t *review, pose_t *pose);

/* Do the next step. Returns true when *pose is complete, at the latest with step POSE_STEPS_MOST. It never fails but
 * by status. */
bool pose_step(pose_work_t *work, pose_t *pose);

/* Locate with no prior: pose_begin and all steps. */
void pose_find(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose);

/* Locate from the previous pose, *pose, which is replaced: pose_begin with track and all steps. */
void pose_track(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose);

#endif

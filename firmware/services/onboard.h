/* onboard.h: the sensor's own pose: from one cycle's plain correlations to POSE_POSITION, POSE_ATTITUDE and
 * POSE_QUALITY on both links.
 *
 * Active with parameter pose = 1. The beacon of place i in the code list is row i of the parameters "beacons"
 * (framing.md); noise gives the weights, half_space resolves the mirror of coplanar coils. Lost chips scale the sums;
 * saturated and lost ones widen the noise by the part of the offset that no longer cancels.
 *
 * onboard_take copies a cycle's sums while they are there; onboard_step computes, at once or later in main: until then
 * a further cycle replaces the first. Each taken cycle gives three messages, whatever happens; the status tells.
 *
 * Memory: 8.4 kB. Time: onboard_step as pose.h, and about 25 instructions a code and axis for the separation; nothing
 * without a cycle. Contexts: main only.
 */
#ifndef GOLDFIELD_ONBOARD_H
#define GOLDFIELD_ONBOARD_H

#include "core/codes/epoch.h"
#include "core/codes/separation.h"
#include "core/pose/pose.h"
#include "services/node.h"

/* Private but for tests. */
typedef struct {
    bool active, due;
    bool separable; /* The code list can be separated. */
    float noise_T;
    separation_t separation;
    pose_site_t site;
    float sums[EPOCH_AXES][EPOCH_CODES_MAX]; /* Of the cycle taken: correlations, later fields, T. */
    float mean[EPOCH_AXES];
    uint32_t cycle;
    uint32_t chips;              /* N */
    uint32_t missing, saturated; /* Of these. */
    pose_field_t fields[POSE_BEACONS_MAX];
    pose_work_t work;
    pose_t pose;
} onboard_t;

/* Read the parameters; forgets the pose that tracking starts from. chips: of a cycle. A selection that left out a
 * code of the list makes every pose fail. Bound: 8 parameters for each code. */
void onboard_configure(onboard_t *onboard, const parameters_t *parameters, uint32_t chips,
                       const epoch_selection_t *selection);

/* Take a whole cycle, if active. About 250 instructions a code. */
void onboard_take(onboard_t *onboard, const epoch_sums_t *cycle, const epoch_calibration_t *calibration,
                  const epoch_selection_t *selection);

/* Compute and send the pose of the cycle taken, if there is one. */
void onboard_step(onboard_t *onboard, node_t *node);

#endif

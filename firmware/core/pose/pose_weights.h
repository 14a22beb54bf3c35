/* pose_weights.h: how far measured fields may be off the model if site and sensor are as declared, as the weights of a
 * fit.
 *
 * Calls: pose_weights_rough from a rough start, pose_weights_at around a pose; then pose_weights_whiten for each beacon
 * and pose_weights_sensor for the sensor's part.
 *
 * Method. Beacon i is off by a shift, a turn about its centre and a part of its current. With B its field, G the
 * gradient and q the point seen from the coil, its components in the site's frame have the covariance
 *   C_i = sigma^2 I + s_p^2 G G' + s_a^2 J J' + s_c^2 B B',   J = -[B]x + G [q]x,
 * and the inverse of its Cholesky factor whitens them. The sensor measures (1 + E) h in place of h. Three gains and
 * three pairs of axes that lean towards each other are common to all beacons: six unknowns with a prior, which a fit
 * eliminates (core/math/nuisance.h). Their effects are taken at the measured field, not at the modelled one as on the
 * host: the difference is of second order. Axes that all lean alike are a turn of the sensor; pose_covariance has it.
 *
 * A rough start knows no pose. Its weights are one number a beacon: the mean of the above over all directions, from a
 * dipole as far off as its field is weak.
 *
 * Rounding. Fields are good to about POSE_WEIGHTS_ROUNDING of their size, which is part of sigma. Below a noise of a
 * few millionths of the strongest field the result is limited by single precision, and says so in its covariance.
 *
 * Time (Cortex-M4, -O3): pose_weights_at about 700 instructions a beacon.
 */
#ifndef GOLDFIELD_POSE_WEIGHTS_H
#define GOLDFIELD_POSE_WEIGHTS_H

#include "core/pose/pose_problem.h"

#define POSE_WEIGHTS_ROUNDING 1e-6f /* Error of a field by rounding, relative to its size. */
#define POSE_WEIGHTS_SENSOR   6u    /* Unknowns of the sensor: three gains and three pairs of axes. */

/* Set the weights of all beacons from magnitudes alone, with a model error, relative to each field, on top. */
void pose_weights_rough(pose_problem_t *problem, float model_error);

/* Set the weights of all beacons around a position. */
void pose_weights_at(pose_problem_t *problem, const float position_m[3]);

/* Multiply a vector of components of a beacon in the site's frame by its weights, in place. */
static inline void pose_weights_whiten(const pose_heard_t *heard, float *x, float *y, float *z) {
    const float *w = heard->whitening;
    *z = w[3] * *x + w[4] * *y + w[5] * *z;
    *y = w[1] * *x + w[2] * *y;
    *x = w[0] * *x;
}

/* Compute what the sensor's errors, in standard deviations, do to a beacon's whitened residuals. attitude is R. */
void pose_weights_sensor(const pose_problem_t *problem, const pose_heard_t *heard, const float attitude[3][3],
                         float effects[3][POSE_WEIGHTS_SENSOR]);

#endif

/* pose_fit.h: the position and attitude that best explain measured fields, from a start near by: Levenberg and
 * Marquardt on the components. The calls are pose_fit_robust from a rough start, then pose_fit.
 *
 * Method. The whitened residual of beacon i is (R b_i - B_i(p)) / s_i in the site's frame, with s_i^2 = sigma_i^2 +
 * (model_error |b_i|)^2. With an attitude turned by theta, its Jacobian is (G_i dp + B_i x dtheta) / s_i. Model error
 * widens the basin of convergence: strong, curved beacons near by no longer dominate. Everything is in metres relative
 * to an origin near the sensor, and in microtesla, where single precision does best.
 *
 * Rounding. Fields are good to about POSE_FIT_ROUNDING of their size, which is part of s_i. Below a noise of a few
 * millionths of the strongest field the result is limited by single precision, and says so in its covariance.
 *
 * Time: an evaluation takes about 1,400 instructions a beacon; there are at most as many as the caller allows.
 * Contexts: one. There is no hidden state.
 */
#ifndef GOLDFIELD_POSE_FIT_H
#define GOLDFIELD_POSE_FIT_H

#include <stdbool.h>
#include <stdint.h>

#include "core/math/triangle.h"
#include "core/pose/pose_problem.h"

#define POSE_FIT_ROUNDING 1e-6f /* Error of a field by rounding, relative to its size. */
#define POSE_FIT_ROBUST   0.03f /* Model error of a first fit: from rough starts it ends in the right valley. */

typedef struct {
    float position_m[3];
    float quaternion[4];
    float cost;     /* Sum of squared whitened residuals: chi-square with 3 count - 6 degrees of freedom. */
    float rounding; /* Rounding of the strongest field's residual, in its standard deviations. */
    bool converged; /* The last step promised to lower the cost by next to nothing. */
    /* Whitened Jacobian at the pose, by position, then by a turn in the site's frame: the information is R'R. */
    triangle_t triangle;
} pose_fit_t;

#define POSE_FIT_HOPELESS 1e30f /* Cost of a fit that cannot be: its fields are not finite. */

/* Fit from fit->position_m and fit->quaternion, in place, with at most limit evaluations of all fields (at least one);
 * the rest of *fit is set. cost is POSE_FIT_HOPELESS if the fields at the start are not finite.
 * Returns how many evaluations it took. */
uint32_t pose_fit(const pose_problem_t *problem, uint32_t limit, pose_fit_t *fit);

/* Fit in the same way from a rough start, with the model error POSE_FIT_ROBUST: near the right pose the cost is then
 * below chi-square, in a wrong valley it is not. */
uint32_t pose_fit_robust(const pose_problem_t *problem, uint32_t limit, pose_fit_t *fit);

/* Compute the field of one beacon at a position, and the whitened Jacobian of its components in the site's frame: six
 * columns; the seventh is left alone. */
void pose_fit_rows(const pose_heard_t *heard, const float position_m[3], float inverse_sigma, triangle_rows_t rows,
                   float field_uT[3]);

/* Returns 1/s_i. */
float pose_fit_inverse_sigma(const pose_heard_t *heard, float model_error);

#endif

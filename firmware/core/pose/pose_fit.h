/* pose_fit.h: the position and attitude that best explain measured fields, from a start near by: Levenberg and
 * Marquardt on the components. The calls are pose_fit_robust from a rough start, then pose_fit.
 *
 * Method. The whitened residual of beacon i is W_i (R b_i - B_i(p)) in the site's frame, with W_i the weights of
 * pose_weights. With an attitude turned by theta, its Jacobian is W_i (G_i dp + B_i x dtheta). The sensor's errors are
 * eliminated as a nuisance: cost and information are those of all errors together. The weights are taken at the start,
 * and up to three times again at what was found, until that stays; the last evaluation is with weights of its own
 * place. The robust fit has a model error that widens the basin of convergence: strong, curved beacons near by no
 * longer dominate.
 *
 * Time: an evaluation takes about 1,400 instructions a beacon, 4,000 with errors of the sensor, and 700 more with
 * weights of its own; there are at most as many as the caller allows. Contexts: one. There is no hidden state.
 */
#ifndef GOLDFIELD_POSE_FIT_H
#define GOLDFIELD_POSE_FIT_H

#include <stdbool.h>
#include <stdint.h>

#include "core/math/nuisance.h"
#include "core/math/triangle.h"
#include "core/pose/pose_weights.h"

#define POSE_FIT_ROBUST 0.03f /* Model error of a first fit: from rough starts it ends in the right valley. */

typedef struct {
    float position_m[3];
    float quaternion[4];
    float cost;     /* Sum of squared whitened residuals: chi-square with 3 count - 6 degrees of freedom. */
    float rounding; /* Rounding of the strongest field's residual, in its standard deviations. */
    /* Whitened Jacobian at the pose, by position, then by a turn in the site's frame: the information is R'R. */
    triangle_t triangle;
    nuisance_t sensor; /* The sensor's errors, eliminated. */
} pose_fit_t;

#define POSE_FIT_HOPELESS 1e30f /* Cost of a fit that cannot be: its fields are not finite. */

/* Fit from fit->position_m and fit->quaternion, in place, with at most limit evaluations of all fields (at least one);
 * the rest of *fit is set, and the problem's weights are those around it. cost is POSE_FIT_HOPELESS if the fields at
 * the start are not finite.
 * Returns how many evaluations it took. */
uint32_t pose_fit(pose_problem_t *problem, uint32_t limit, pose_fit_t *fit);

/* Fit in the same way from a rough start, with the model error POSE_FIT_ROBUST: near the right pose the cost is then
 * below chi-square, in a wrong valley it is not. */
uint32_t pose_fit_robust(pose_problem_t *problem, uint32_t limit, pose_fit_t *fit);

/* Compute the field of one beacon at a position, and the Jacobian of its components in the site's frame: six columns;
 * the seventh is left alone. Nothing is whitened. */
void pose_fit_model(const pose_heard_t *heard, const float position_m[3], triangle_rows_t rows, float field_uT[3]);

/* Compute the whitened rows of one beacon, the residual in the seventh column, and what the sensor's errors do to the
 * residual. attitude is R. The modelled field is not whitened. */
void pose_fit_rows(const pose_problem_t *problem, const pose_heard_t *heard, const float position_m[3],
                   const float attitude[3][3], triangle_rows_t rows, float effects[3][NUISANCE_UNKNOWNS],
                   float field_uT[3]);

/* Returns whether the sensor has declared errors; without, all effects are 0. */
static inline bool pose_fit_has_nuisance(const pose_problem_t *problem) {
    return problem->gain_sd > 0.0f || problem->axis_sd_rad > 0.0f;
}

#endif

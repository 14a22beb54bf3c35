/* pose_fit.h: position and attitude that best explain measured fields, from a start near by: Levenberg and Marquardt on
 * the components.
 *
 * Whitened residual of beacon i: (R b_i - B_i(p)) / s_i in the site's frame, s_i^2 = sigma_i^2 + (model_error |b_i|)^2.
 * With an attitude turned by theta, its Jacobian is (G_i dp + B_i x dtheta) / s_i. Model error widens the basin of
 * convergence: strong, curved beacons near by no longer dominate. Everything is in metres relative to an origin near
 * the sensor, and in microtesla, where single precision does best.
 *
 * Rounding: fields are good to about POSE_FIT_ROUNDING of their size, which is part of s_i: below a noise of a few
 * millionths of the strongest field the result is limited by single precision, and says so in its covariance. Time: an
 * evaluation about 1,400 instructions a beacon, at most as many as the caller allows. Contexts: one. No hidden state.
 */
#ifndef GOLDFIELD_POSE_FIT_H
#define GOLDFIELD_POSE_FIT_H

#include <stdbool.h>
#include <stdint.h>

#include "core/math/triangle.h"
#include "core/pose/loop_field.h"

#define POSE_FIT_BEACONS  64u
#define POSE_FIT_ROUNDING 1e-6f
#define POSE_FIT_ROBUST   0.03f /* Model error of a first fit: converges from rough starts, ends in the right valley. */

/* One beacon that was heard. */
typedef struct {
    loop_t loop;       /* Its coil, centre relative to the origin. */
    float field_uT[3]; /* Measured, in the sensor's frame. */
    float magnitude_uT;
    float sigma_uT; /* Standard deviation of each component. */
} pose_heard_t;

/* What is to be fitted. */
typedef struct {
    uint32_t count;
    pose_heard_t heard[POSE_FIT_BEACONS];
} pose_problem_t;

typedef struct {
    float position_m[3];
    float quaternion[4];
    float cost;     /* Sum of squared whitened residuals: chi-square with 3 count - 6 degrees of freedom. */
    float rounding; /* Of the residual of the strongest field, in its standard deviations. */
    bool converged;
    triangle_t
        triangle; /* Whitened Jacobian at the pose: the information is R'R; position, then turn in the site's frame. */
} pose_fit_t;

#define POSE_FIT_HOPELESS 1e30f

/* Fit from fit->position_m and fit->quaternion, in place, with at most limit evaluations of all fields (at least
 * one); the rest of *fit is set. Returns how many it took. cost is POSE_FIT_HOPELESS if the fields at the start are
 * not finite. */
uint32_t pose_fit(const pose_problem_t *problem, uint32_t limit, pose_fit_t *fit);

/* The same from a rough start, with the model error POSE_FIT_ROBUST: near the right pose the cost is then below
 * chi-square, in a wrong valley it is not. */
uint32_t pose_fit_robust(const pose_problem_t *problem, uint32_t limit, pose_fit_t *fit);

/* Whitened Jacobian of one beacon's components in the site's frame at a position: six columns; the seventh is left
 * alone. field_uT is set. */
void pose_fit_rows(const pose_heard_t *heard, const float position_m[3], float inverse_sigma, triangle_rows_t rows,
                   float field_uT[3]);

/* 1/s_i. */
float pose_fit_inverse_sigma(const pose_heard_t *heard, float model_error);

#endif

#include "core/pose/pose_weights.h"

#include "core/math/roots.h"
#include "core/math/vector3.h"

static float noise2(const pose_heard_t *heard) {
    const float rounding = POSE_WEIGHTS_ROUNDING * heard->magnitude_uT;
    return heard->sigma_uT * heard->sigma_uT + rounding * rounding;
}

/* A dipole's gradient has a Frobenius norm of about 4 |B| / r, the effect of a turn is about 1.7 |B|, and |B| is
 * about 1.5 k / r^3. */
void pose_weights_rough(pose_problem_t *problem, float model_error) {
    const float sensor2 = problem->gain_sd * problem->gain_sd + 2.0f * problem->axis_sd_rad * problem->axis_sd_rad;
    for (uint32_t i = 0; i < problem->count; i++) {
        pose_heard_t *heard = &problem->heard[i];
        const float k = heard->loop.k_uT_m3 > 0.0f ? heard->loop.k_uT_m3 : -heard->loop.k_uT_m3;
        const float curvature = inverse_cube_root(1.5f * k / heard->magnitude_uT);
        const bool outside = curvature * heard->loop.radius_m < 1.0f;
        const float place = 4.0f * heard->position_sd_m * (outside ? curvature : 1.0f / heard->loop.radius_m);
        const float beacon2 = place * place + 3.0f * heard->axis_sd_rad * heard->axis_sd_rad +
                              heard->current_sd * heard->current_sd;
        const float relative2 = model_error * model_error + (beacon2 + sensor2) / 3.0f;
        const float weight = inverse_square_root(noise2(heard) + relative2 * heard->magnitude_uT * heard->magnitude_uT);
        heard->whitening[0] = heard->whitening[2] = heard->whitening[5] = weight;
        heard->whitening[1] = heard->whitening[3] = heard->whitening[4] = 0.0f;
    }
}

/* Computes C_i, its lower triangle row by row. */
static void covariance(const pose_heard_t *heard, const float position_m[3], float least, float c[6]) {
    float b[3], gradient[3][3], turn[3][3], q[3];
    loop_field_and_gradient(&heard->loop, position_m, b, gradient);
    vector3_subtract(position_m, heard->loop.centre_m, q);
    const float b_cross[3][3] = {{0.0f, -b[2], b[1]}, {b[2], 0.0f, -b[0]}, {-b[1], b[0], 0.0f}};
    for (uint32_t row = 0; row < 3u; row++) {
        float moved[3]; /* The row of G [q]x. */
        vector3_cross(gradient[row], q, moved);
        vector3_subtract(moved, b_cross[row], turn[row]);
    }
    const float place2 = heard->position_sd_m * heard->position_sd_m, axis2 = heard->axis_sd_rad * heard->axis_sd_rad,
                current2 = heard->current_sd * heard->current_sd;
    uint32_t entry = 0;
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column <= row; column++) {
            c[entry] = place2 * vector3_dot(gradient[row], gradient[column]) +
                       axis2 * vector3_dot(turn[row], turn[column]) + current2 * b[row] * b[column] +
                       (row == column ? least : 0.0f);
            entry++;
        }
    }
}

/* Returns 1 / sqrt(pivot); no pivot of C_i is below its noise but by rounding. */
static float inverse_pivot(float pivot, float least) {
    return inverse_square_root(pivot > least ? pivot : least);
}

/* Computes the inverse of the Cholesky factor of c, both lower triangles row by row. */
static void invert_factor(const float c[6], float least, float w[6]) {
    w[0] = inverse_pivot(c[0], least);
    const float l10 = c[1] * w[0], l20 = c[3] * w[0];
    w[2] = inverse_pivot(c[2] - l10 * l10, least);
    const float l21 = (c[4] - l20 * l10) * w[2];
    w[5] = inverse_pivot(c[5] - l20 * l20 - l21 * l21, least);
    w[1] = -l10 * w[0] * w[2];
    w[3] = -(l20 * w[0] + l21 * w[1]) * w[5];
    w[4] = -l21 * w[2] * w[5];
}

void pose_weights_at(pose_problem_t *problem, const float position_m[3]) {
    for (uint32_t i = 0; i < problem->count; i++) {
        pose_heard_t *heard = &problem->heard[i];
        const float least = noise2(heard);
        if (heard->position_sd_m > 0.0f || heard->axis_sd_rad > 0.0f || heard->current_sd > 0.0f) {
            float c[6];
            covariance(heard, position_m, least, c);
            invert_factor(c, least, heard->whitening);
        } else {
            heard->whitening[0] = heard->whitening[2] = heard->whitening[5] = inverse_square_root(least);
            heard->whitening[1] = heard->whitening[3] = heard->whitening[4] = 0.0f;
        }
    }
}

void pose_weights_sensor(const pose_problem_t *problem, const pose_heard_t *heard, const float attitude[3][3],
                         float effects[3][POSE_WEIGHTS_SENSOR]) {
    const float *b = heard->field_uT;
    const float gain = problem->gain_sd, lean = 0.70710678f * problem->axis_sd_rad; /* That of each axis of a pair. */
    for (uint32_t row = 0; row < 3u; row++) {
        const float *r = attitude[row];
        for (uint32_t axis = 0; axis < 3u; axis++) {
            effects[row][axis] = gain * r[axis] * b[axis];
        }
        effects[row][3] = lean * (r[0] * b[1] + r[1] * b[0]);
        effects[row][4] = lean * (r[0] * b[2] + r[2] * b[0]);
        effects[row][5] = lean * (r[1] * b[2] + r[2] * b[1]);
    }
    for (uint32_t column = 0; column < POSE_WEIGHTS_SENSOR; column++) {
        pose_weights_whiten(heard, &effects[0][column], &effects[1][column], &effects[2][column]);
    }
}

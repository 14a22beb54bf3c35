#include "core/pose/pose_result.h"

#include "core/math/roots.h"
#include "core/pose/pose_covariance.h"

#define WEAK_POSITION     0.25f /* Largest deviation of the position, over the distance to the nearest beacon. */
#define WEAK_ATTITUDE_RAD 0.5f  /* Largest deviation of the attitude, rad; beyond either nothing linear holds. */
#define HEARD             1.0f  /* Least energy over the noise of all fields at a pose, the sum of squares. */

/* Returns whether the greatest eigenvalue of a symmetric matrix is beyond a limit: limit I - matrix then is not
 * positive definite (Sylvester). */
static bool beyond(const float m[3][3], float limit) {
    const float a = limit - m[0][0], b = limit - m[1][1], c = limit - m[2][2];
    const float minor = a * b - m[0][1] * m[0][1];
    const float determinant = minor * c - a * m[1][2] * m[1][2] - b * m[0][2] * m[0][2] -
                              2.0f * m[0][1] * m[1][2] * m[0][2];
    return !(a > 0.0f && minor > 0.0f && determinant > 0.0f);
}

/* Returns whether all beacons' fields at a position are nothing to the noise. */
static bool unheard(const pose_problem_t *problem, const float position_m[3]) {
    float energy = 0.0f;
    for (uint32_t i = 0; i < problem->count; i++) {
        const float sigma = problem->heard[i].sigma_uT;
        float field[3];
        loop_field(&problem->heard[i].loop, position_m, field);
        energy += (field[0] * field[0] + field[1] * field[1] + field[2] * field[2]) / (sigma * sigma);
    }
    return !(energy > HEARD);
}

static void judge(const pose_problem_t *problem, const pose_fit_t *fit, pose_reason_t wrong, bool contested,
                  pose_t *pose) {
    const float near2 = pose_problem_nearest2(problem, fit->position_m);
    const bool weak = beyond((const float(*)[3])pose->position_cov_m2, WEAK_POSITION * WEAK_POSITION * near2) ||
                      beyond((const float(*)[3])pose->attitude_cov_rad2, WEAK_ATTITUDE_RAD * WEAK_ATTITUDE_RAD);
    const bool unsafe = !(pose->protection_m <= problem->alert_limit_m);
    if (wrong == POSE_REASON_NONE && !pose_problem_inside(problem, fit->position_m)) {
        wrong = POSE_REASON_HALF_SPACE;
    }
    if (weak && unheard(problem, fit->position_m)) { /* The attitude is unknown there: all others are spared. */
        pose_fail(pose, wrong != POSE_REASON_NONE ? wrong : POSE_REASON_NO_POSE);
        return;
    }
    pose->status = wrong != POSE_REASON_NONE ? POSE_INCONSISTENT
                   : contested               ? POSE_AMBIGUOUS
                   : weak                    ? POSE_WEAK
                   : unsafe                  ? POSE_UNVERIFIED
                                             : POSE_OK;
    pose->reason = wrong != POSE_REASON_NONE ? wrong
                   : contested               ? POSE_REASON_RIVAL
                   : weak                    ? POSE_REASON_WEAK
                   : unsafe                  ? POSE_REASON_UNVERIFIED
                                             : POSE_REASON_NONE;
}

void pose_result(pose_problem_t *problem, const pose_fit_t *fit, const pose_faults_t *faults, pose_reason_t wrong,
                 bool contested, pose_t *pose) {
    float covariance[TRIANGLE_UNKNOWNS][TRIANGLE_UNKNOWNS];
    if (!pose_covariance(problem, fit, covariance)) {
        pose_fail(pose, POSE_REASON_NO_POSE);
        return;
    }
    const float sign = fit->quaternion[3] < 0.0f ? -1.0f : 1.0f;
    for (uint32_t row = 0; row < 3u; row++) {
        pose->position_m[row] = fit->position_m[row] + problem->origin_m[row];
        for (uint32_t column = 0; column < 3u; column++) {
            pose->position_cov_m2[row][column] = covariance[row][column];
            pose->attitude_cov_rad2[row][column] = covariance[3u + row][3u + column];
        }
    }
    for (uint32_t i = 0; i < 4u; i++) {
        pose->quaternion[i] = sign * fit->quaternion[i];
    }
    pose->residual = square_root(fit->cost / (float)pose_problem_freedom(problem));
    pose->protection_m = faults->level_m;
    pose->used = problem->count;
    judge(problem, fit, wrong, contested, pose);
}

void pose_fail(pose_t *pose, pose_reason_t reason) {
    pose->status = POSE_FAILED;
    pose->reason = reason;
}

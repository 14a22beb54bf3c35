#include "core/pose/pose_fit.h"

#include "core/math/quaternion.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"

/* Least promise of a step, in cost, after which a fit goes on: 3 % of a deviation. The step itself is taken. */
#define TOLERANCE     1e-3f
#define DAMPING_FAR   1e-3f  /* Damping of the first step from a rough start. */
#define DAMPING_NEAR  1e-6f  /* Damping of the first step from a good start. */
#define DAMPING_LEAST 1e-9f  /* Least damping of all steps but the last. */
#define DAMPING_LAST  1e-12f /* Damping of the last step, which goes all the way along ill-determined directions. */
#define DAMPING_MOST  1e8f   /* Damping with which a fit ends, since no step lowers the cost any more: rounding. */
#define GRAIN         3e-7f  /* Rounding of a field and of what is compared with it, relative. */

float pose_fit_inverse_sigma(const pose_heard_t *heard, float model_error) {
    const float relative2 = model_error * model_error + POSE_FIT_ROUNDING * POSE_FIT_ROUNDING;
    return inverse_square_root(heard->sigma_uT * heard->sigma_uT +
                               relative2 * heard->magnitude_uT * heard->magnitude_uT);
}

void pose_fit_rows(const pose_heard_t *heard, const float position_m[3], float inverse_sigma, triangle_rows_t rows,
                   float field_uT[3]) {
    float gradient[3][3];
    loop_field_and_gradient(&heard->loop, position_m, field_uT, gradient);
    const float x = inverse_sigma * field_uT[0], y = inverse_sigma * field_uT[1], z = inverse_sigma * field_uT[2];
    const float turn[3][3] = {{0.0f, -z, y}, {z, 0.0f, -x}, {-y, x, 0.0f}};
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            rows[row][column] = inverse_sigma * gradient[row][column];
            rows[row][3u + column] = turn[row][column];
        }
    }
}

static void evaluate(const pose_problem_t *problem, float model_error, pose_fit_t *fit) {
    float attitude[3][3];
    quaternion_matrix(fit->quaternion, attitude);
    triangle_init(&fit->triangle);
    fit->cost = 0.0f;
    float greatest = 0.0f;
    for (uint32_t i = 0; i < problem->count; i++) {
        const pose_heard_t *heard = &problem->heard[i];
        const float weight = pose_fit_inverse_sigma(heard, model_error);
        triangle_rows_t rows;
        float field[3];
        pose_fit_rows(heard, fit->position_m, weight, rows, field);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            const float residual = weight * (vector3_dot(attitude[axis], heard->field_uT) - field[axis]);
            rows[axis][TRIANGLE_UNKNOWNS] = residual;
            fit->cost += residual * residual;
        }
        triangle_add(&fit->triangle, rows);
        greatest = weight * heard->magnitude_uT > greatest ? weight * heard->magnitude_uT : greatest;
    }
    fit->rounding = GRAIN * greatest;
    if (!(fit->cost < POSE_FIT_HOPELESS)) { /* True also for what is not a number. */
        fit->cost = POSE_FIT_HOPELESS;
    }
}

/* Returns what an undamped step would lower the cost by, if the model were linear. The damped step's promise is no
 * measure: it hides ill-determined directions. */
static float decrement(const triangle_t *triangle) {
    float sum = 0.0f;
    for (uint32_t i = 0; i < TRIANGLE_UNKNOWNS; i++) {
        sum += triangle->r[i][TRIANGLE_UNKNOWNS] * triangle->r[i][TRIANGLE_UNKNOWNS];
    }
    return sum;
}

static uint32_t minimise(const pose_problem_t *problem, float model_error, float damping, uint32_t limit,
                         pose_fit_t *fit) {
    fit->converged = false;
    evaluate(problem, model_error, fit);
    uint32_t evaluations = 1;
    while (!fit->converged && fit->cost < POSE_FIT_HOPELESS && damping < DAMPING_MOST && evaluations < limit) {
        float step[TRIANGLE_UNKNOWNS];
        pose_fit_t trial = *fit;
        fit->converged = decrement(&fit->triangle) < TOLERANCE + fit->rounding * fit->rounding;
        triangle_solve(&fit->triangle, fit->converged ? DAMPING_LAST : damping, step);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            trial.position_m[axis] += step[axis];
        }
        quaternion_turn(trial.quaternion, step + 3);
        evaluate(problem, model_error, &trial);
        evaluations++;
        if (trial.cost <= fit->cost + 2.0f * fit->rounding * square_root(fit->cost)) {
            trial.converged = fit->converged;
            *fit = trial;
            damping = damping > 10.0f * DAMPING_LEAST ? 0.1f * damping : DAMPING_LEAST;
        } else {
            damping *= 8.0f;
        }
    }
    return evaluations;
}

uint32_t pose_fit(const pose_problem_t *problem, uint32_t limit, pose_fit_t *fit) {
    return minimise(problem, 0.0f, DAMPING_NEAR, limit, fit);
}

uint32_t pose_fit_robust(const pose_problem_t *problem, uint32_t limit, pose_fit_t *fit) {
    return minimise(problem, POSE_FIT_ROBUST, DAMPING_FAR, limit, fit);
}

#include "core/pose/pose_fit.h"

#include "core/math/quaternion.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"

/* Least promise of a step, in cost, after which a fit goes on: 3 % of a deviation. The step itself is taken. */
#define TOLERANCE     1e-3f
#define ROUGHLY       1.0f   /* The same with weights of another place than the end. */
#define ROUNDS        3u     /* Most times that the weights are taken again. */
#define DAMPING_FAR   1e-3f  /* Damping of the first step from a rough start. */
#define DAMPING_NEAR  1e-6f  /* Damping of the first step from a good start. */
#define DAMPING_LEAST 1e-9f  /* Least damping of all steps but the last. */
#define DAMPING_LAST  1e-12f /* Damping of the last step, which goes all the way along ill-determined directions. */
#define GRAIN         3e-7f  /* Rounding of a field and of what is compared with it, relative. */

void pose_fit_model(const pose_heard_t *heard, const float position_m[3], triangle_rows_t rows, float field_uT[3]) {
    float gradient[3][3];
    loop_field_and_gradient(&heard->loop, position_m, field_uT, gradient);
    const float x = field_uT[0], y = field_uT[1], z = field_uT[2];
    const float turn[3][3] = {{0.0f, -z, y}, {z, 0.0f, -x}, {-y, x, 0.0f}};
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            rows[row][column] = gradient[row][column];
            rows[row][3u + column] = turn[row][column];
        }
    }
}

/* Computes the whitened rows of one beacon, the residual in the seventh column. */
static void whitened_rows(const pose_heard_t *heard, const float position_m[3], const float attitude[3][3],
                          triangle_rows_t rows, float field_uT[3]) {
    pose_fit_model(heard, position_m, rows, field_uT);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        rows[axis][TRIANGLE_UNKNOWNS] = vector3_dot(attitude[axis], heard->field_uT) - field_uT[axis];
    }
    for (uint32_t column = 0; column < TRIANGLE_COLUMNS; column++) {
        pose_weights_whiten(heard, &rows[0][column], &rows[1][column], &rows[2][column]);
    }
}

void pose_fit_rows(const pose_problem_t *problem, const pose_heard_t *heard, const float position_m[3],
                   const float attitude[3][3], triangle_rows_t rows, float effects[3][NUISANCE_UNKNOWNS],
                   float field_uT[3]) {
    whitened_rows(heard, position_m, attitude, rows, field_uT);
    pose_weights_sensor(problem, heard, attitude, effects);
}

/* Returns a bound of a beacon's field in standard deviations of its most exact component. */
static float clarity(const pose_heard_t *heard) {
    const float x = heard->whitening[0], y = heard->whitening[2], z = heard->whitening[5];
    return heard->magnitude_uT * (x > y ? x > z ? x : z : y > z ? y : z);
}

static void evaluate(const pose_problem_t *problem, bool nuisance, pose_fit_t *fit) {
    float attitude[3][3];
    quaternion_matrix(fit->quaternion, attitude);
    triangle_init(&fit->triangle);
    nuisance_init(&fit->sensor);
    fit->cost = 0.0f;
    float greatest = 0.0f;
    for (uint32_t i = 0; i < problem->count; i++) {
        const pose_heard_t *heard = &problem->heard[i];
        triangle_rows_t rows;
        float field[3];
        whitened_rows(heard, fit->position_m, (const float(*)[3])attitude, rows, field);
        if (nuisance) {
            float effects[3][NUISANCE_UNKNOWNS];
            pose_weights_sensor(problem, heard, (const float(*)[3])attitude, effects);
            nuisance_eliminate(&fit->sensor, effects, rows);
        }
        for (uint32_t axis = 0; axis < 3u; axis++) {
            fit->cost += rows[axis][TRIANGLE_UNKNOWNS] * rows[axis][TRIANGLE_UNKNOWNS];
        }
        triangle_add(&fit->triangle, rows);
        greatest = clarity(heard) > greatest ? clarity(heard) : greatest;
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

static bool settled(const pose_fit_t *fit, float tolerance) {
    return decrement(&fit->triangle) < tolerance + fit->rounding * fit->rounding;
}

/* Goes on from an evaluated fit until the promise of a step is below tolerance, with at most limit evaluations. Returns
 * how many it took. */
static uint32_t minimise(const pose_problem_t *problem, bool nuisance, float damping, float tolerance, uint32_t limit,
                         pose_fit_t *fit) {
    uint32_t evaluations = 0;
    bool last = false;
    while (!last && fit->cost < POSE_FIT_HOPELESS && evaluations < limit) {
        float step[TRIANGLE_UNKNOWNS];
        pose_fit_t trial = *fit;
        last = settled(fit, tolerance);
        triangle_solve(&fit->triangle, last ? DAMPING_LAST : damping, step);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            trial.position_m[axis] += step[axis];
        }
        quaternion_turn(trial.quaternion, step + 3);
        evaluate(problem, nuisance, &trial);
        evaluations++;
        if (trial.cost <= fit->cost + 2.0f * fit->rounding * square_root(fit->cost)) {
            *fit = trial;
            damping = damping > 10.0f * DAMPING_LEAST ? 0.1f * damping : DAMPING_LEAST;
        } else {
            damping *= 8.0f;
        }
    }
    return evaluations;
}

uint32_t pose_fit(pose_problem_t *problem, uint32_t limit, pose_fit_t *fit) {
    const bool nuisance = pose_fit_has_nuisance(problem);
    pose_weights_at(problem, fit->position_m);
    evaluate(problem, nuisance, fit);
    uint32_t evaluations = 1;
    if (problem->exact_beacons) {
        return evaluations + minimise(problem, nuisance, DAMPING_NEAR, TOLERANCE, limit - evaluations, fit);
    }
    for (uint32_t round = 0; round < ROUNDS && evaluations + 1u < limit && !settled(fit, TOLERANCE); round++) {
        evaluations += 1u + minimise(problem, nuisance, DAMPING_NEAR, ROUGHLY, limit - evaluations - 1u, fit);
        pose_weights_at(problem, fit->position_m);
        evaluate(problem, nuisance, fit);
    }
    return evaluations;
}

uint32_t pose_fit_robust(pose_problem_t *problem, uint32_t limit, pose_fit_t *fit) {
    pose_weights_rough(problem, POSE_FIT_ROBUST);
    evaluate(problem, false, fit);
    return 1u + minimise(problem, false, DAMPING_FAR, TOLERANCE, limit - 1u, fit);
}

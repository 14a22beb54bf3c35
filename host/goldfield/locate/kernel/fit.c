#include "fit.h"

#include <math.h>
#include <string.h>

#include "linear.h"

/* Damping relative to the diagonal: at first, its least, after success, after failure, and where there is no hope
 * left. */
#define FIRST_DAMPING    1e-3
#define LEAST_DAMPING    1e-9
#define EASED            0.1
#define TIGHTENED        8.0
#define HOPELESS_DAMPING 1e12

void gf_clear(gf_squares_t *squares) {
    memset(squares, 0, sizeof *squares);
}

void gf_add(gf_squares_t *squares, size_t unknowns, double residual, const double slope[]) {
    squares->cost += residual * residual;
    for (size_t k = 0; k < unknowns; ++k) {
        squares->gradient[k] += slope[k] * residual;
        for (size_t l = 0; l < unknowns; ++l) {
            squares->normal[k][l] += slope[k] * slope[l];
        }
    }
}

static bool propose(const gf_squares_t *squares, size_t unknowns, double damping, double step[6]) {
    double damped[6][6];
    double largest = 0.0;
    memcpy(damped, squares->normal, sizeof damped);
    for (size_t k = 0; k < unknowns; ++k) {
        largest = fmax(largest, damped[k][k]);
    }
    for (size_t k = 0; k < unknowns; ++k) {
        damped[k][k] += damping * damped[k][k] + 1e-12 * largest +
                        1e-300; /* a direction of which nothing is known stays */
    }
    return gf_solve(unknowns, (const double(*)[6])damped, squares->gradient, step);
}

bool gf_minimise(gf_evaluate_t evaluate, const void *problem, size_t unknowns, size_t iterations, double tolerance,
                 gf_pose_t *pose, gf_squares_t *squares) {
    double damping = FIRST_DAMPING;
    bool near = false;
    evaluate(problem, pose, squares);
    if (!isfinite(squares->cost)) {
        return false;
    }
    for (size_t trial = 0; trial < iterations && !near && damping <= HOPELESS_DAMPING; ++trial) {
        double step[6];
        if (!propose(squares, unknowns, damping, step)) {
            damping *= TIGHTENED;
            continue;
        }
        double promise = 0.0;
        for (size_t k = 0; k < unknowns; ++k) {
            promise += squares->gradient[k] * step[k];
        }
        near = promise < tolerance;
        gf_pose_t there = *pose;
        for (size_t k = 0; k < 3; ++k) {
            there.position_m[k] += step[k];
        }
        if (unknowns == 6) {
            gf_turn(there.rotation, step + 3);
        }
        gf_squares_t next;
        evaluate(problem, &there, &next);
        if (next.cost <= squares->cost) {
            *pose = there;
            *squares = next;
            damping = fmax(EASED * damping, LEAST_DAMPING);
        } else {
            damping *= TIGHTENED;
        }
    }
    return near;
}

typedef struct {
    const gf_coils_t *coils;
    double weight[3 * GF_MOST_COILS];
    double whitened[3 * GF_MOST_COILS]; /* measured components over their standard deviations */
} pose_problem_t;

static void evaluate_pose(const void *argument, const gf_pose_t *pose, gf_squares_t *squares) {
    const pose_problem_t *const problem = argument;
    gf_components_t components;
    gf_components(problem->coils, pose, problem->weight, &components);
    gf_clear(squares);
    for (size_t c = 0; c < 3 * problem->coils->count; ++c) {
        gf_add(squares, 6, problem->whitened[c] - components.value[c], components.slope[c]);
    }
}

/* One Newton step towards the nearest rotation: removes the rounding of many turns. */
static void straighten(double r[3][3]) {
    double out[3][3];
    for (size_t i = 0; i < 3; ++i) {
        for (size_t j = 0; j < 3; ++j) {
            double sum = 1.5 * r[i][j];
            for (size_t k = 0; k < 3; ++k) {
                sum -= 0.5 * r[i][k] * (r[0][k] * r[0][j] + r[1][k] * r[1][j] + r[2][k] * r[2][j]);
            }
            out[i][j] = sum;
        }
    }
    memcpy(r, out, sizeof out);
}

void gf_fit(const gf_coils_t *coils, size_t epochs, const double *field_T, const double *sigma_T, double model_error,
            size_t iterations, double tolerance, double *position_m, double *rotation, double *cost,
            double *information, uint8_t *converged) {
    const size_t n = coils->count;
    for (size_t e = 0; e < epochs; ++e) {
        const double *const field = field_T + 3 * n * e;
        pose_problem_t problem = {.coils = coils};
        gf_pose_t pose;
        gf_squares_t squares;
        gf_weights(n, field, sigma_T + n * e, model_error, problem.weight);
        for (size_t c = 0; c < 3 * n; ++c) {
            problem.whitened[c] = isfinite(field[c]) ? problem.weight[c] * field[c] : 0.0;
        }
        memcpy(pose.position_m, position_m + 3 * e, sizeof pose.position_m);
        memcpy(pose.rotation, rotation + 9 * e, sizeof pose.rotation);
        converged[e] = gf_minimise(evaluate_pose, &problem, 6, iterations, tolerance, &pose, &squares);
        straighten(pose.rotation);
        memcpy(position_m + 3 * e, pose.position_m, sizeof pose.position_m);
        memcpy(rotation + 9 * e, pose.rotation, sizeof pose.rotation);
        memcpy(information + 36 * e, squares.normal, sizeof squares.normal);
        cost[e] = squares.cost;
    }
}

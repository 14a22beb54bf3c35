#include "descent.h"

#include <math.h>
#include <string.h>

#include "linear.h"

/* Damping relative to the diagonal: at first, its least, after success, after failure, and without hope. */
#define FIRST_DAMPING    1e-3
#define LEAST_DAMPING    1e-9
#define EASED            0.1
#define TIGHTENED        6.0
#define HOPELESS_DAMPING 1e9

/* Weight of the plane that holds a position, relative to the information about the position. */
#define STIFFNESS 1e4

void gf_soften(gf_epoch_t *epoch, double error) {
    for (size_t i = 0; i < epoch->coils->count; ++i) {
        const double *const b = epoch->field_T + 3 * i;
        const double square = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
        const double variance = epoch->sigma_T[i] * epoch->sigma_T[i] + error * error * square;
        epoch->weight[i] = isfinite(square) ? 1.0 / variance : 0.0;
    }
}

/* The squares at a pose; the cost is not finite once the evaluations are used up. */
static void evaluate(gf_epoch_t *epoch, const gf_pose_t *pose, gf_squares_t *out) {
    gf_clear(out);
    if (epoch->evaluations >= epoch->most_evaluations) {
        out->cost = INFINITY;
        return;
    }
    ++epoch->evaluations;
    gf_add_vectors(out, epoch->coils, pose, epoch->field_T, epoch->weight);
}

/* The normal matrix, damped relative to its diagonal. */
static void damp(const gf_epoch_t *epoch, const gf_squares_t *squares, double damping, double damped[6][6]) {
    double largest = 0.0;
    memcpy(damped, squares->normal, sizeof squares->normal);
    for (size_t k = 0; k < 6; ++k) {
        largest = damped[k][k] > largest ? damped[k][k] : largest;
    }
    for (size_t k = 0; k < 6; ++k) {
        damped[k][k] += damping * damped[k][k] + 1e-14 * largest + 1e-300;
    }
    if (!epoch->held) {
        return;
    }
    const double stiffness = STIFFNESS * (damped[0][0] + damped[1][1] + damped[2][2]);
    for (size_t k = 0; k < 3; ++k) {
        for (size_t l = 0; l < 3; ++l) {
            damped[k][l] += stiffness * epoch->normal[k] * epoch->normal[l];
        }
    }
}

/* Whether the undamped step promises to lower the cost by less than this. */
static bool is_least(const gf_epoch_t *epoch, const gf_squares_t *squares, double tolerance) {
    double damped[6][6];
    double promise;
    damp(epoch, squares, 0.0, damped);
    return gf_promise(6, (const double(*)[6])damped, squares->gradient, &promise) && promise < tolerance;
}

/* The step of Levenberg and Marquardt. */
static bool propose(const gf_epoch_t *epoch, const gf_squares_t *squares, double damping, double step[6]) {
    double damped[6][6];
    damp(epoch, squares, damping, damped);
    return gf_solve(6, (const double(*)[6])damped, squares->gradient, step);
}

void gf_descend(gf_epoch_t *epoch, size_t trials, double tolerance, gf_minimum_t *minimum) {
    gf_squares_t *const squares = &minimum->squares;
    double damping = FIRST_DAMPING;
    minimum->converged = false;
    bool moved = true; /* since the undamped step was last looked at */
    evaluate(epoch, &minimum->pose, squares);
    for (size_t trial = 0; trial < trials && isfinite(squares->cost); ++trial) {
        if (moved && is_least(epoch, squares, tolerance)) {
            minimum->converged = true;
            return;
        }
        moved = false;
        if (damping > HOPELESS_DAMPING) {
            return;
        }
        double step[6];
        if (!propose(epoch, squares, damping, step)) {
            damping *= TIGHTENED;
            continue;
        }
        gf_pose_t there = minimum->pose;
        for (size_t k = 0; k < 3; ++k) {
            there.position_m[k] += step[k];
        }
        gf_turn(there.rotation, step + 3);
        gf_squares_t next;
        evaluate(epoch, &there, &next);
        if (next.cost <= squares->cost) {
            minimum->pose = there;
            *squares = next;
            moved = true;
            damping = fmax(EASED * damping, LEAST_DAMPING);
        } else {
            damping *= TIGHTENED;
        }
    }
}

void gf_difference(const gf_pose_t *from, const gf_pose_t *to, double out[6]) {
    double turn[3][3];
    for (size_t i = 0; i < 3; ++i) {
        out[i] = to->position_m[i] - from->position_m[i];
        for (size_t j = 0; j < 3; ++j) {
            const double *const a = to->rotation[i];
            const double *const b = from->rotation[j];
            turn[i][j] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        }
    }
    const double axis[3] = {turn[2][1] - turn[1][2], turn[0][2] - turn[2][0], turn[1][0] - turn[0][1]};
    const double sine = 0.5 * sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
    const double angle = atan2(sine, 0.5 * (turn[0][0] + turn[1][1] + turn[2][2] - 1.0));
    const double ratio = sine > 1e-9 ? 0.5 * angle / sine : 0.5;
    for (size_t k = 0; k < 3; ++k) {
        out[3 + k] = ratio * axis[k];
    }
}

double gf_form(const double normal[6][6], const double d[6]) {
    double sum = 0.0;
    for (size_t k = 0; k < 6; ++k) {
        for (size_t l = 0; l < 6; ++l) {
            sum += d[k] * normal[k][l] * d[l];
        }
    }
    return sum;
}

#include "fit.h"

#include <math.h>
#include <string.h>

#include "linear.h"
#include "whiten.h"

/* Damping relative to the diagonal: at first, its least, after success, after failure, and where there is no hope
 * left. */
#define FIRST_DAMPING    1e-3
#define LEAST_DAMPING    1e-9
#define EASED            0.1
#define TIGHTENED        8.0
#define HOPELESS_DAMPING 1e12

/* How often components are whitened anew at most, and the square of a pose's shift, in its standard deviations, that
 * changes their covariance too little to do so. */
#define MOST_ROUNDS 4
#define SETTLED     1e-2

void gf_clear(gf_squares_t *squares) {
    memset(squares, 0, sizeof *squares);
}

/* Residuals and slopes in the site's frame: r = R b - B, dB = G dp + B x d_theta. */
static void add_vector(gf_squares_t *squares, const gf_sources_t *s, size_t coil, const double residual_T[3],
                       double weight) {
    const double x = s->field_T[0][coil];
    const double y = s->field_T[1][coil];
    const double z = s->field_T[2][coil];
    const double xx = s->gradient_T_m[0][coil];
    const double yy = s->gradient_T_m[1][coil];
    const double zz = s->gradient_T_m[2][coil];
    const double xy = s->gradient_T_m[3][coil];
    const double xz = s->gradient_T_m[4][coil];
    const double yz = s->gradient_T_m[5][coil];
    const double slope[3][6] = {
        {xx, xy, xz, 0.0, -z, y},
        {xy, yy, yz, z, 0.0, -x},
        {xz, yz, zz, -y, x, 0.0},
    };
    for (size_t c = 0; c < 3; ++c) {
        squares->cost += weight * residual_T[c] * residual_T[c];
        for (size_t k = 0; k < 6; ++k) {
            const double weighted = weight * slope[c][k];
            squares->gradient[k] += weighted * residual_T[c];
            for (size_t l = k; l < 6; ++l) {
                squares->normal[k][l] += weighted * slope[c][l];
            }
        }
    }
}

void gf_add_vectors(gf_squares_t *squares, const gf_coils_t *coils, const gf_pose_t *pose, const double *field_T,
                    const double *weight) {
    gf_sources_t sources;
    gf_sources(coils, pose->position_m, &sources);
    for (size_t i = 0; i < coils->count; ++i) {
        if (!(weight[i] > 0.0)) {
            continue;
        }
        const double *const b = field_T + 3 * i;
        double r[3];
        for (size_t k = 0; k < 3; ++k) {
            const double *const row = pose->rotation[k];
            r[k] = row[0] * b[0] + row[1] * b[1] + row[2] * b[2] - sources.field_T[k][i];
        }
        add_vector(squares, &sources, i, r, weight[i]);
    }
    for (size_t k = 0; k < 6; ++k) {
        for (size_t l = 0; l < k; ++l) {
            squares->normal[k][l] = squares->normal[l][k];
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
                 gf_pose_t *pose, gf_squares_t *squares, size_t *evaluations) {
    double damping = FIRST_DAMPING;
    bool near = false;
    evaluate(problem, pose, squares);
    ++*evaluations;
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
        ++*evaluations;
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

typedef struct {
    const gf_coils_t *coils;
    const double *field_T;
    double weight[GF_MOST_COILS]; /* inverse variance of a component */
} vector_problem_t;

typedef struct {
    const gf_coils_t *coils;
    gf_whitening_t whitening;
    double whitened[3 * GF_MOST_COILS];
} site_problem_t;

static void evaluate_pose(const void *argument, const gf_pose_t *pose, gf_squares_t *squares) {
    const pose_problem_t *const problem = argument;
    gf_components_t components;
    gf_components(problem->coils, pose, problem->weight, &components);
    gf_clear(squares);
    for (size_t c = 0; c < 3 * problem->coils->count; ++c) {
        gf_add(squares, 6, problem->whitened[c] - components.value[c], components.slope[c]);
    }
}

/* The same where all three components of a coil are known or none. */
static void evaluate_vectors(const void *argument, const gf_pose_t *pose, gf_squares_t *squares) {
    const vector_problem_t *const problem = argument;
    gf_clear(squares);
    gf_add_vectors(squares, problem->coils, pose, problem->field_T, problem->weight);
}

/* The same with errors of the site and the sensor: with V of gf_whitening_t, J' (1 - V V') J in place of J' J. */
static void evaluate_with_errors(const void *argument, const gf_pose_t *pose, gf_squares_t *squares) {
    const site_problem_t *const problem = argument;
    const gf_whitening_t *const whitening = &problem->whitening;
    const size_t n = problem->coils->count;
    gf_components_t components;
    gf_components(problem->coils, pose, whitening->weight, &components);
    gf_whitened(n, whitening, &components);
    gf_clear(squares);
    double of_slope[GF_SHARED][6] = {{0.0}};
    double of_residual[GF_SHARED] = {0.0};
    for (size_t c = 0; c < 3 * n; ++c) {
        const double residual = problem->whitened[c] - components.value[c];
        gf_add(squares, 6, residual, components.slope[c]);
        for (size_t k = 0; whitening->is_shared && k < GF_SHARED; ++k) {
            const double v = whitening->shared[c][k];
            of_residual[k] += v * residual;
            for (size_t l = 0; l < 6; ++l) {
                of_slope[k][l] += v * components.slope[c][l];
            }
        }
    }
    for (size_t k = 0; k < GF_SHARED; ++k) {
        squares->cost -= of_residual[k] * of_residual[k];
        for (size_t i = 0; i < 6; ++i) {
            squares->gradient[i] -= of_slope[k][i] * of_residual[k];
            for (size_t j = 0; j < 6; ++j) {
                squares->normal[i][j] -= of_slope[k][i] * of_slope[k][j];
            }
        }
    }
}

/* Square of a small shift of the pose in its standard deviations. */
static double shift2(const gf_pose_t *from, const gf_pose_t *to, const double information[6][6]) {
    double shift[6];
    double sum = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        const size_t l = (k + 1) % 3;
        const size_t m = (k + 2) % 3;
        shift[k] = to->position_m[k] - from->position_m[k];
        shift[3 + k] = 0.0;
        for (size_t c = 0; c < 3; ++c) {
            shift[3 + k] += 0.5 *
                            (to->rotation[m][c] * from->rotation[l][c] - to->rotation[l][c] * from->rotation[m][c]);
        }
    }
    for (size_t k = 0; k < 6; ++k) {
        for (size_t l = 0; l < 6; ++l) {
            sum += shift[k] * information[k][l] * shift[l];
        }
    }
    return sum;
}

static bool fit_with_errors(const gf_coils_t *coils, const gf_errors_t *errors, const double *field_T,
                            const double *sigma_T, size_t iterations, double tolerance, gf_pose_t *pose,
                            gf_squares_t *squares, size_t *evaluations) {
    site_problem_t problem;
    bool near = false;
    problem.coils = coils;
    for (size_t round = 0; round < MOST_ROUNDS; ++round) {
        const gf_pose_t before = *pose;
        gf_whiten(coils, errors, field_T, sigma_T, pose, &problem.whitening);
        ++*evaluations;
        for (size_t c = 0; c < 3 * coils->count; ++c) {
            problem.whitened[c] = isfinite(field_T[c]) ? field_T[c] : 0.0;
        }
        gf_whiten_values(coils->count, &problem.whitening, problem.whitened);
        near = gf_minimise(evaluate_with_errors, &problem, 6, iterations, tolerance, pose, squares, evaluations);
        if (!(shift2(&before, pose, (const double(*)[6])squares->normal) > SETTLED)) {
            break;
        }
    }
    return near;
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

/* Inverse variances of whole vectors from the weights of components; false if a coil is known in part. */
static bool weigh_vectors(size_t coils, const double *weight, double *out) {
    for (size_t i = 0; i < coils; ++i) {
        const double *const w = weight + 3 * i;
        if ((w[0] > 0.0) != (w[1] > 0.0) || (w[0] > 0.0) != (w[2] > 0.0)) {
            return false;
        }
        out[i] = w[0] * w[0];
    }
    return true;
}

static bool fit_plainly(const gf_coils_t *coils, const double *field_T, const double *sigma_T, double model_error,
                        size_t iterations, double tolerance, gf_pose_t *pose, gf_squares_t *squares,
                        size_t *evaluations) {
    pose_problem_t problem = {.coils = coils};
    vector_problem_t vectors = {.coils = coils, .field_T = field_T};
    gf_weights(coils->count, field_T, sigma_T, model_error, problem.weight);
    if (weigh_vectors(coils->count, problem.weight, vectors.weight)) {
        return gf_minimise(evaluate_vectors, &vectors, 6, iterations, tolerance, pose, squares, evaluations);
    }
    for (size_t c = 0; c < 3 * coils->count; ++c) {
        problem.whitened[c] = isfinite(field_T[c]) ? problem.weight[c] * field_T[c] : 0.0;
    }
    return gf_minimise(evaluate_pose, &problem, 6, iterations, tolerance, pose, squares, evaluations);
}

size_t gf_fit(const gf_coils_t *coils, const gf_errors_t *errors, size_t epochs, const double *field_T,
              const double *sigma_T, double model_error, size_t iterations, double tolerance, double *position_m,
              double *rotation, double *cost, double *information, uint8_t *converged) {
    const size_t n = coils->count;
    size_t evaluations = 0;
    for (size_t e = 0; e < epochs; ++e) {
        const double *const field = field_T + 3 * n * e;
        const double *const sigma = sigma_T + n * e;
        gf_pose_t pose;
        gf_squares_t squares;
        memcpy(pose.position_m, position_m + 3 * e, sizeof pose.position_m);
        memcpy(pose.rotation, rotation + 9 * e, sizeof pose.rotation);
        converged[e] =
            errors == NULL
                ? fit_plainly(coils, field, sigma, model_error, iterations, tolerance, &pose, &squares, &evaluations)
                : fit_with_errors(coils, errors, field, sigma, iterations, tolerance, &pose, &squares, &evaluations);
        straighten(pose.rotation);
        memcpy(position_m + 3 * e, pose.position_m, sizeof pose.position_m);
        memcpy(rotation + 9 * e, pose.rotation, sizeof pose.rotation);
        memcpy(information + 36 * e, squares.normal, sizeof squares.normal);
        cost[e] = squares.cost;
    }
    return evaluations;
}

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

/* What is summed over the coils. With a coil's field B, the symmetric gradient G and the residual r = R b - B, the
 * slopes are dB = G dp + B x d_theta: they have few elements of their own. */
enum {
    COST,                  /* r.r */
    GRADIENT,              /* G r and r x B */
    SHIFTS = GRADIENT + 6, /* G G, row by row from the diagonal on */
    CROSSED = SHIFTS + 6,  /* G times the matrix of B x, row by row */
    TURNS = CROSSED + 9,   /* B.B - B B', row by row from the diagonal on */
    PRODUCTS = TURNS + 6
};

/* One coil a column, so that the compiler works on several at a time. A coil that was not heard counts 0, even where
 * its field is not finite. */
static void multiply_out(size_t n, const gf_sources_t *s, const double rotation[3][3], const double *field_T,
                         const double *weight, double out[PRODUCTS][GF_MOST_COILS]) {
    for (size_t i = 0; i < n; ++i) {
        const bool heard = weight[i] > 0.0;
        const double w = weight[i];
        const double a = heard ? field_T[3 * i] : 0.0;
        const double b = heard ? field_T[3 * i + 1] : 0.0;
        const double c = heard ? field_T[3 * i + 2] : 0.0;
        const double x = heard ? s->field_T[0][i] : 0.0;
        const double y = heard ? s->field_T[1][i] : 0.0;
        const double z = heard ? s->field_T[2][i] : 0.0;
        const double xx = heard ? s->gradient_T_m[0][i] : 0.0;
        const double yy = heard ? s->gradient_T_m[1][i] : 0.0;
        const double zz = heard ? s->gradient_T_m[2][i] : 0.0;
        const double xy = heard ? s->gradient_T_m[3][i] : 0.0;
        const double xz = heard ? s->gradient_T_m[4][i] : 0.0;
        const double yz = heard ? s->gradient_T_m[5][i] : 0.0;
        const double rx = rotation[0][0] * a + rotation[0][1] * b + rotation[0][2] * c - x;
        const double ry = rotation[1][0] * a + rotation[1][1] * b + rotation[1][2] * c - y;
        const double rz = rotation[2][0] * a + rotation[2][1] * b + rotation[2][2] * c - z;
        const double wx = w * x;
        const double wy = w * y;
        const double wz = w * z;
        out[COST][i] = w * (rx * rx + ry * ry + rz * rz);
        out[GRADIENT][i] = w * (xx * rx + xy * ry + xz * rz);
        out[GRADIENT + 1][i] = w * (xy * rx + yy * ry + yz * rz);
        out[GRADIENT + 2][i] = w * (xz * rx + yz * ry + zz * rz);
        out[GRADIENT + 3][i] = wz * ry - wy * rz;
        out[GRADIENT + 4][i] = wx * rz - wz * rx;
        out[GRADIENT + 5][i] = wy * rx - wx * ry;
        out[SHIFTS][i] = w * (xx * xx + xy * xy + xz * xz);
        out[SHIFTS + 1][i] = w * (xx * xy + xy * yy + xz * yz);
        out[SHIFTS + 2][i] = w * (xx * xz + xy * yz + xz * zz);
        out[SHIFTS + 3][i] = w * (xy * xy + yy * yy + yz * yz);
        out[SHIFTS + 4][i] = w * (xy * xz + yy * yz + yz * zz);
        out[SHIFTS + 5][i] = w * (xz * xz + yz * yz + zz * zz);
        out[CROSSED][i] = xy * wz - xz * wy;
        out[CROSSED + 1][i] = xz * wx - xx * wz;
        out[CROSSED + 2][i] = xx * wy - xy * wx;
        out[CROSSED + 3][i] = yy * wz - yz * wy;
        out[CROSSED + 4][i] = yz * wx - xy * wz;
        out[CROSSED + 5][i] = xy * wy - yy * wx;
        out[CROSSED + 6][i] = yz * wz - zz * wy;
        out[CROSSED + 7][i] = zz * wx - xz * wz;
        out[CROSSED + 8][i] = xz * wy - yz * wx;
        out[TURNS][i] = wy * y + wz * z;
        out[TURNS + 1][i] = -wx * y;
        out[TURNS + 2][i] = -wx * z;
        out[TURNS + 3][i] = wx * x + wz * z;
        out[TURNS + 4][i] = -wy * z;
        out[TURNS + 5][i] = wx * x + wy * y;
    }
}

/* The sum of a column, even and odd elements apart. */
static inline double sum_of(size_t n, const double *value) {
    double even = 0.0;
    double odd = 0.0;
    size_t i = 0;
    for (; i + 1 < n; i += 2) {
        even += value[i];
        odd += value[i + 1];
    }
    return even + odd + (i < n ? value[i] : 0.0);
}

void gf_add_vectors(gf_squares_t *squares, const gf_coils_t *coils, const gf_pose_t *pose, const double *field_T,
                    const double *weight) {
    gf_sources_t sources;
    double product[PRODUCTS][GF_MOST_COILS];
    double sum[PRODUCTS];
    gf_sources(coils, pose->position_m, &sources);
    multiply_out(coils->count, &sources, (const double(*)[3])pose->rotation, field_T, weight, product);
    for (size_t k = 0; k < PRODUCTS; ++k) {
        sum[k] = sum_of(coils->count, product[k]);
    }
    squares->cost += sum[COST];
    const double *shift = sum + SHIFTS;
    const double *turn = sum + TURNS;
    for (size_t k = 0; k < 3; ++k) {
        squares->gradient[k] += sum[GRADIENT + k];
        squares->gradient[3 + k] += sum[GRADIENT + 3 + k];
        for (size_t l = k; l < 3; ++l, ++shift, ++turn) {
            squares->normal[k][l] = squares->normal[l][k] = *shift;
            squares->normal[3 + k][3 + l] = squares->normal[3 + l][3 + k] = *turn;
        }
        for (size_t l = 0; l < 3; ++l) {
            squares->normal[k][3 + l] = squares->normal[3 + l][k] = sum[CROSSED + 3 * k + l];
        }
    }
}

static bool propose(const gf_squares_t *squares, size_t unknowns, double damping, double step[6]) {
    double damped[6][6];
    double largest = 0.0;
    memcpy(damped, squares->normal, sizeof damped);
    for (size_t k = 0; k < unknowns; ++k) {
        largest = damped[k][k] > largest ? damped[k][k] : largest;
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

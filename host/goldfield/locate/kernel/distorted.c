#include <math.h>
#include <string.h>

#include "fit.h"
#include "linear.h"

/* Distortions that the fields cannot tell apart share what they tell: relative to the diagonal of their squares. */
#define RIDGE 1e-12

typedef struct {
    const gf_coils_t *coils;
    double weight[3 * GF_MOST_COILS];
    double whitened[3 * GF_MOST_COILS]; /* measured components over their standard deviations */
    size_t count;                       /* of distortions */
    double fixed[3][3];
    double basis[GF_MOST_UNKNOWNS][3][3];
} distorted_problem_t;

/* The distortion that fits best at a pose, and what the components are there. */
typedef struct {
    gf_components_t components;
    double column[3 * GF_MOST_COILS][6]; /* of each distortion, whitened */
    double factor[6][6];                 /* of their squares: gf_factor() */
    double matrix[3][3];                 /* S */
} distorted_t;

static void multiply(const double matrix[3][3], const double *vector, double out[3]) {
    for (size_t r = 0; r < 3; ++r) {
        out[r] = matrix[r][0] * vector[0] + matrix[r][1] * vector[1] + matrix[r][2] * vector[2];
    }
}

/* count is that of the problem: where it is a constant, the compiler unrolls the loops. */
static inline bool solve_distortion(const distorted_problem_t *problem, size_t count, const gf_pose_t *pose,
                                    distorted_t *out) {
    double along[6] = {0.0};
    double gain[6] = {0.0};
    double square[6][6] = {{0.0}};
    gf_components(problem->coils, pose, problem->weight, &out->components);
    for (size_t first = 0; first < 3 * problem->coils->count; first += 3) {
        double part[3];
        const double *const value = out->components.value + first;
        multiply(problem->fixed, value, part);
        for (size_t k = 0; k < count; ++k) {
            double column[3];
            multiply(problem->basis[k], value, column);
            for (size_t c = 0; c < 3; ++c) {
                out->column[first + c][k] = column[c];
                along[k] += column[c] * (problem->whitened[first + c] - part[c]);
            }
        }
        for (size_t c = first; c < first + 3; ++c) {
            for (size_t k = 0; k < count; ++k) {
                for (size_t l = 0; l <= k; ++l) {
                    square[k][l] += out->column[c][k] * out->column[c][l];
                }
            }
        }
    }
    for (size_t k = 0; k < count; ++k) {
        square[k][k] *= 1.0 + RIDGE;
    }
    const bool solved = gf_factor(count, (const double(*)[6])square, out->factor);
    if (solved) {
        gf_substitute(count, (const double(*)[6])out->factor, along, gain);
    }
    memcpy(out->matrix, problem->fixed, sizeof out->matrix);
    for (size_t k = 0; k < count; ++k) {
        for (size_t c = 0; c < 9; ++c) {
            out->matrix[c / 3][c % 3] += gain[k] * problem->basis[k][c / 3][c % 3];
        }
    }
    return solved;
}

/* Variable projection as Kaufman has it: the slopes lose what the distortions can take up, J' (1 - Q Q') J. The
 * residuals have nothing along the columns already. */
static inline void project(size_t count, const distorted_t *at, double of_slope[6][6], gf_squares_t *squares) {
    for (size_t l = 0; l < 6; ++l) {
        double along[6];
        double taken[6];
        for (size_t k = 0; k < count; ++k) {
            along[k] = of_slope[k][l];
        }
        gf_substitute(count, (const double(*)[6])at->factor, along, taken);
        for (size_t m = 0; m < 6; ++m) {
            for (size_t k = 0; k < count; ++k) {
                squares->normal[m][l] -= of_slope[k][m] * taken[k];
            }
        }
    }
}

static inline void evaluate(const distorted_problem_t *problem, size_t count, const gf_pose_t *pose,
                            gf_squares_t *squares) {
    distorted_t at;
    double of_slope[6][6] = {{0.0}};
    gf_clear(squares);
    if (!solve_distortion(problem, count, pose, &at)) {
        squares->cost = INFINITY;
        return;
    }
    for (size_t first = 0; first < 3 * problem->coils->count; first += 3) {
        double value[3];
        multiply((const double(*)[3])at.matrix, at.components.value + first, value);
        for (size_t c = 0; c < 3; ++c) {
            double slope[6];
            for (size_t l = 0; l < 6; ++l) {
                slope[l] = 0.0;
                for (size_t r = 0; r < 3; ++r) {
                    slope[l] += at.matrix[c][r] * at.components.slope[first + r][l];
                }
                for (size_t k = 0; k < count; ++k) {
                    of_slope[k][l] += at.column[first + c][k] * slope[l];
                }
            }
            gf_add(squares, 6, problem->whitened[first + c] - value[c], slope);
        }
    }
    project(count, &at, of_slope, squares);
}

static void evaluate_distorted(const void *argument, const gf_pose_t *pose, gf_squares_t *squares) {
    const distorted_problem_t *const problem = argument;
    if (problem->count == 1) {
        evaluate(problem, 1, pose, squares);
    } else if (problem->count == 6) {
        evaluate(problem, 6, pose, squares);
    } else {
        evaluate(problem, problem->count, pose, squares);
    }
}

size_t gf_fit_distorted(const gf_coils_t *coils, size_t epochs, const double *field_T, const double *sigma_T,
                        double model_error, const double *fixed, size_t count, const double *basis, size_t iterations,
                        double tolerance, double *position_m, double *rotation, double *cost, double *distortion) {
    const size_t n = coils->count;
    size_t evaluations = epochs; /* one more for the distortion at the end of each */
    distorted_problem_t problem = {.coils = coils, .count = count};
    memcpy(problem.fixed, fixed, sizeof problem.fixed);
    memcpy(problem.basis, basis, count * sizeof problem.basis[0]);
    for (size_t e = 0; e < epochs; ++e) {
        const double *const field = field_T + 3 * n * e;
        gf_pose_t pose;
        gf_squares_t squares;
        distorted_t at;
        memcpy(pose.position_m, position_m + 3 * e, sizeof pose.position_m);
        memcpy(pose.rotation, rotation + 9 * e, sizeof pose.rotation);
        gf_weights(n, field, sigma_T + n * e, model_error, problem.weight);
        for (size_t c = 0; c < 3 * n; ++c) {
            problem.whitened[c] = isfinite(field[c]) ? problem.weight[c] * field[c] : 0.0;
        }
        (void)gf_minimise(evaluate_distorted, &problem, 6, iterations, tolerance, &pose, &squares, &evaluations);
        (void)solve_distortion(&problem, count, &pose, &at);
        memcpy(position_m + 3 * e, pose.position_m, sizeof pose.position_m);
        memcpy(rotation + 9 * e, pose.rotation, sizeof pose.rotation);
        memcpy(distortion + 9 * e, at.matrix, sizeof at.matrix);
        cost[e] = squares.cost;
    }
    return evaluations;
}

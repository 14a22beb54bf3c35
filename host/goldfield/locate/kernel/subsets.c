#include <math.h>
#include <string.h>

#include "kernel.h"

typedef struct {
    const gf_coils_t *coils;
    const gf_errors_t *errors;
    const gf_subsets_t *given;
    const gf_subset_fits_t *fits;
    size_t evaluations;
} subsets_t;

/* A pose with what a fit tells of it. */
typedef struct {
    double position_m[3];
    double rotation[9];
    double cost;
    double information[36];
    uint8_t converged;
} fitted_t;

static void read_pose(const double *position_m, const double *rotation, size_t row, fitted_t *fitted) {
    memcpy(fitted->position_m, position_m + 3 * row, sizeof fitted->position_m);
    memcpy(fitted->rotation, rotation + 9 * row, sizeof fitted->rotation);
}

static void keep(const subsets_t *subsets, size_t row, const fitted_t *fitted) {
    const gf_subset_fits_t *const fits = subsets->fits;
    memcpy(fits->position_m + 3 * row, fitted->position_m, sizeof fitted->position_m);
    memcpy(fits->rotation + 9 * row, fitted->rotation, sizeof fitted->rotation);
    memcpy(fits->information + 36 * row, fitted->information, sizeof fitted->information);
    fits->cost[row] = fitted->cost;
    fits->converged[row] = fitted->converged;
}

/* The iterations that each of so many fits may take of what is left after so many evaluations more. */
static size_t affordable(const subsets_t *subsets, size_t iterations, size_t fits, size_t more) {
    const size_t most = subsets->given->most_evaluations;
    const size_t spent = subsets->evaluations + more;
    const size_t each = most > spent ? (most - spent) / fits : 0;
    return each < iterations ? each : iterations;
}

static void fit_roughly(subsets_t *subsets, size_t row, size_t iterations, fitted_t *fitted) {
    const gf_subsets_t *const given = subsets->given;
    const size_t n = subsets->coils->count;
    subsets->evaluations += gf_fit(subsets->coils, NULL, 1, given->field_T + 3 * n * row, given->sigma_T + n * row,
                                   given->model_error, iterations, given->rough_tolerance, fitted->position_m,
                                   fitted->rotation, &fitted->cost, fitted->information, &fitted->converged);
}

static void fit_to_the_end(subsets_t *subsets, size_t count, const size_t *rows) {
    const gf_subsets_t *const given = subsets->given;
    const size_t n = subsets->coils->count;
    const double *const sigma_T = subsets->errors == NULL ? given->sigma_T : given->noise_T;
    const size_t iterations = count > 0 ? affordable(subsets, given->final_iterations, count, 0) : 0;
    for (size_t k = 0; k < count; ++k) {
        const size_t row = rows[k];
        fitted_t fitted;
        read_pose(subsets->fits->position_m, subsets->fits->rotation, row, &fitted);
        subsets->evaluations += gf_fit(subsets->coils, subsets->errors, 1, given->field_T + 3 * n * row,
                                       sigma_T + n * row, 0.0, iterations, given->final_tolerance, fitted.position_m,
                                       fitted.rotation, &fitted.cost, fitted.information, &fitted.converged);
        keep(subsets, row, &fitted);
    }
}

/* The start at which a subset costs least; the only one needs no evaluation. */
static size_t choose(subsets_t *subsets, size_t row, size_t first, size_t count, const double *position_m,
                     const double *rotation) {
    double least = INFINITY;
    size_t chosen = first;
    for (size_t start = first; count > 1 && start < first + count; ++start) {
        fitted_t there;
        read_pose(position_m, rotation, start, &there);
        fit_roughly(subsets, row, 0, &there);
        if (there.cost < least) {
            least = there.cost;
            chosen = start;
        }
    }
    return chosen;
}

/* Fit each subset roughly from the best of its starts, which are a stride apart from the next one's, and keep what
 * costs less than what is known. */
static void try_starts(subsets_t *subsets, size_t count, size_t stride, const double *position_m,
                       const double *rotation) {
    const size_t rows = subsets->given->count;
    const size_t iterations = affordable(subsets, subsets->given->rough_iterations, rows, count > 1 ? rows * count : 0);
    for (size_t row = 0; count > 0 && row < rows; ++row) {
        fitted_t fitted;
        read_pose(position_m, rotation, choose(subsets, row, stride * row, count, position_m, rotation), &fitted);
        fit_roughly(subsets, row, iterations, &fitted);
        if (isfinite(fitted.cost) && !(subsets->fits->cost[row] <= fitted.cost)) {
            keep(subsets, row, &fitted);
        }
    }
}

static double cost_of(const subsets_t *subsets, size_t row) {
    const double cost = subsets->fits->cost[row];
    return isfinite(cost) ? cost : INFINITY;
}

static bool is_among(size_t row, size_t count, const size_t *rows) {
    for (size_t k = 0; k < count; ++k) {
        if (rows[k] == row) {
            return true;
        }
    }
    return false;
}

/* The rows of the lowest costs, the best first. Returns how many there are. */
static size_t find_best(const subsets_t *subsets, size_t best[GF_MOST_POOL]) {
    const size_t rows = subsets->given->count;
    size_t count = 0;
    for (; count < subsets->given->pool && count < rows; ++count) {
        best[count] = rows;
        for (size_t row = 0; row < rows; ++row) {
            if (!is_among(row, count, best) &&
                (best[count] == rows || cost_of(subsets, row) < cost_of(subsets, best[count]))) {
                best[count] = row;
            }
        }
    }
    return count;
}

static void share(subsets_t *subsets) {
    double position_m[3 * GF_MOST_POOL];
    double rotation[9 * GF_MOST_POOL];
    size_t best[GF_MOST_POOL];
    const size_t count = find_best(subsets, best);
    for (size_t k = 0; k < count; ++k) {
        memcpy(position_m + 3 * k, subsets->fits->position_m + 3 * best[k], 3 * sizeof position_m[0]);
        memcpy(rotation + 9 * k, subsets->fits->rotation + 9 * best[k], 9 * sizeof rotation[0]);
    }
    try_starts(subsets, count, 0, position_m, rotation);
}

/* The best to the end, then all that may cost as little as these do then. */
static void end(subsets_t *subsets) {
    size_t best[GF_MOST_POOL];
    size_t likely[GF_MOST_SUBSETS];
    size_t others = 0;
    double least = INFINITY;
    const size_t count = find_best(subsets, best);
    fit_to_the_end(subsets, count, best);
    for (size_t k = 0; k < count; ++k) {
        least = fmin(least, cost_of(subsets, best[k]));
    }
    for (size_t row = 0; row < subsets->given->count; ++row) {
        if (cost_of(subsets, row) < least + subsets->given->clear_cost && !is_among(row, count, best)) {
            likely[others++] = row;
        }
    }
    fit_to_the_end(subsets, others, likely);
}

size_t gf_fit_subsets(const gf_coils_t *coils, const gf_errors_t *errors, const gf_subsets_t *given,
                      const gf_subset_fits_t *fits, bool *hopeless) {
    subsets_t subsets = {.coils = coils, .errors = errors, .given = given, .fits = fits};
    size_t best[GF_MOST_POOL];
    try_starts(&subsets, given->starts, given->starts, given->start_m, given->start_rotation);
    share(&subsets);
    *hopeless = find_best(&subsets, best) == 0 || !(cost_of(&subsets, best[0]) < given->unfit_cost);
    if (!*hopeless) {
        end(&subsets);
    }
    return subsets.evaluations;
}

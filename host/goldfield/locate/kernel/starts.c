#include <float.h>
#include <math.h>
#include <string.h>

#include "fit.h"
#include "wahba.h"

#define LEAST_MAGNITUDE_T 1e-30
#define ITERATIONS        25
#define TOLERANCE         1e-2 /* a tenth of a standard deviation: the fit that follows does better anyway */

typedef struct {
    const gf_coils_t *coils;
    double target[GF_MOST_COILS]; /* range, or logarithm of the magnitude */
    double weight[GF_MOST_COILS]; /* 0 if the beacon was not heard */
} magnitudes_t;

static void evaluate_ranges(const void *argument, const gf_pose_t *pose, gf_squares_t *squares) {
    const magnitudes_t *const problem = argument;
    gf_clear(squares);
    for (size_t i = 0; i < problem->coils->count; ++i) {
        double slope[3];
        double square = 0.0;
        for (size_t k = 0; k < 3; ++k) {
            slope[k] = pose->position_m[k] - problem->coils->centre_m[k][i];
            square += slope[k] * slope[k];
        }
        const double range = sqrt(square);
        const double w = problem->weight[i];
        for (size_t k = 0; k < 3; ++k) {
            slope[k] *= w / fmax(range, 1e-9);
        }
        gf_add(squares, 3, (problem->target[i] - range) * w, slope);
    }
}

static void evaluate_logarithms(const void *argument, const gf_pose_t *pose, gf_squares_t *squares) {
    const magnitudes_t *const problem = argument;
    gf_sources_t sources;
    gf_sources(problem->coils, pose->position_m, &sources);
    gf_clear(squares);
    for (size_t i = 0; i < problem->coils->count; ++i) {
        const double x = sources.field_T[0][i];
        const double y = sources.field_T[1][i];
        const double z = sources.field_T[2][i];
        const double square = x * x + y * y + z * z;
        const double w = problem->weight[i];
        const double scale = w / square;
        const double slope[3] = {
            scale * (x * sources.gradient_T_m[0][i] + y * sources.gradient_T_m[3][i] + z * sources.gradient_T_m[4][i]),
            scale * (x * sources.gradient_T_m[3][i] + y * sources.gradient_T_m[1][i] + z * sources.gradient_T_m[5][i]),
            scale * (x * sources.gradient_T_m[4][i] + y * sources.gradient_T_m[5][i] + z * sources.gradient_T_m[2][i]),
        };
        gf_add(squares, 3, (problem->target[i] - 0.5 * log(square)) * w, slope);
    }
}

/* The attitude at a position; weight has 3 n reciprocal standard deviations. */
static void align(const gf_coils_t *coils, const double position_m[3], const double *field_T, const double *weight,
                  double rotation[3][3]) {
    gf_sources_t sources;
    double inverse_variance[GF_MOST_COILS];
    gf_sources(coils, position_m, &sources);
    for (size_t i = 0; i < coils->count; ++i) {
        inverse_variance[i] = weight[3 * i] * weight[3 * i];
    }
    gf_attitude(coils->count, &sources, field_T, inverse_variance, rotation);
}

/* Returns the evaluations of the field that it took. */
static size_t start(const gf_coils_t *coils, const double *field_T, const double *sigma_T, double range_error,
                    double magnitude_error, double vector_error, gf_pose_t *pose) {
    const size_t n = coils->count;
    magnitudes_t ranges = {.coils = coils};
    magnitudes_t logarithms = {.coils = coils};
    double weight[3 * GF_MOST_COILS];
    double middle[3] = {0.0};
    double total = 0.0;
    double nearest = DBL_MAX;
    gf_weights(n, field_T, sigma_T, vector_error, weight);
    for (size_t i = 0; i < n; ++i) {
        if (!(weight[3 * i] > 0.0)) {
            continue;
        }
        const double *const b = field_T + 3 * i;
        const double magnitude = fmax(sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2]), LEAST_MAGNITUDE_T);
        const double noise = sigma_T[i] / magnitude;
        const double range = cbrt(1.5 * GF_MU0_OVER_4PI * coils->moment_A_m2[i] / magnitude);
        ranges.target[i] = range;
        ranges.weight[i] = 1.0 / (range * hypot(range_error, noise / 3.0));
        logarithms.target[i] = log(magnitude);
        logarithms.weight[i] = 1.0 / hypot(magnitude_error, noise);
        const double share = 1.0 / (range * range);
        total += share;
        nearest = fmin(nearest, range);
        for (size_t k = 0; k < 3; ++k) {
            middle[k] += share * coils->centre_m[k][i];
        }
    }
    for (size_t k = 0; k < 3; ++k) {
        /* In the plane of coplanar coils the trilateration has no slope across it: start off the plane. */
        pose->position_m[k] = middle[k] / total + 0.3 * nearest * coils->across[k];
    }
    gf_squares_t squares;
    size_t without_field = 0;
    size_t evaluations = 1; /* for the attitude */
    (void)gf_minimise(evaluate_ranges, &ranges, 3, ITERATIONS, TOLERANCE, pose, &squares, &without_field);
    (void)gf_minimise(evaluate_logarithms, &logarithms, 3, ITERATIONS, TOLERANCE, pose, &squares, &evaluations);
    align(coils, pose->position_m, field_T, weight, pose->rotation);
    return evaluations;
}

size_t gf_starts(const gf_coils_t *coils, size_t epochs, const double *field_T, const double *sigma_T,
                 double range_error, double magnitude_error, double vector_error, double *position_m,
                 double *rotation) {
    size_t evaluations = 0;
    for (size_t e = 0; e < epochs; ++e) {
        gf_pose_t pose = {{0.0}, {{0.0}}};
        evaluations += start(coils, field_T + 3 * coils->count * e, sigma_T + coils->count * e, range_error,
                             magnitude_error, vector_error, &pose);
        memcpy(position_m + 3 * e, pose.position_m, sizeof pose.position_m);
        memcpy(rotation + 9 * e, pose.rotation, sizeof pose.rotation);
    }
    return evaluations;
}

#include "core/track/block_errors.h"

#include <stdint.h>

#include "core/math/vector3.h"

#define BEACON_ERRORS 7u /* Errors of a beacon: three of its position, three of its axis, its current. */
#define SENSOR_ERRORS 6u /* Errors of the sensor: three gains, three pairs of axes that lean towards each other. */
#define HALF_ROOT     0.70710678f
#define AMBIENT       3u /* Observed numbers before those of the pose: the ambient field. */

typedef float effects_t[3][BEACON_ERRORS];

/* Computes what a beacon's errors, each of one standard deviation, do to its field. */
static void beacon_effects(const block_measure_t *measure, const loop_t *coil, uint32_t i,
                           const block_beacon_errors_t *errors, effects_t effects) {
    const float *const b = measure->model[i].field_uT;
    const float b_cross[3][3] = {{0.0f, -b[2], b[1]}, {b[2], 0.0f, -b[0]}, {-b[1], b[0], 0.0f}};
    float gradient[3][3], offset[3];
    block_field_expand(measure->model[i].gradient, gradient);
    vector3_subtract(measure->reference.position_m, coil->centre_m, offset);
    for (uint32_t row = 0; row < 3u; row++) {
        float turned[3]; /* The row of G [q]x: as if the coil stood still and the point were turned around it. */
        vector3_cross(gradient[row], offset, turned);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            effects[row][axis] = errors->position_sd_m * gradient[row][axis];
            effects[row][3u + axis] = errors->axis_sd_rad * (turned[axis] - b_cross[row][axis]);
        }
        effects[row][6] = errors->current_sd * b[row];
    }
}

/* Adds what an error of one field, e, does to the gradient of the likelihood, times sigma^2. */
static void add_effect(const block_measure_t *measure, uint32_t i, const float e[3], float d[BLOCK_OBSERVED]) {
    const float *const sum = measure->sum[i].gradient;
    float crossed[3];
    vector3_cross(e, measure->sum[i].field_uT, crossed);
    d[3] += sum[0] * e[0] + sum[1] * e[1] + sum[2] * e[2];
    d[4] += sum[1] * e[0] + sum[3] * e[1] + sum[4] * e[2];
    d[5] += sum[2] * e[0] + sum[4] * e[1] - (sum[0] + sum[3]) * e[2];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        d[axis] += measure->ambient_sum[i] * e[axis];
        d[6u + axis] += crossed[axis];
    }
}

/* Adds to a covariance the square of the bias L^-1 d that the pose has by an error with gradient d; L = U U', and A has
 * U' in it. pivots are the inverse of U's diagonal, 0 where it is 0. */
static void add_bias(const block_measure_t *measure, const float pivots[BLOCK_OBSERVED], const float d[BLOCK_OBSERVED],
                     float covariance[6][6]) {
    const float weight = 1.0f / (measure->noise_uT * measure->noise_uT);
    float x[BLOCK_OBSERVED];
    for (uint32_t i = 0; i < BLOCK_OBSERVED; i++) { /* U x = d. */
        x[i] = weight * d[i];
        for (uint32_t k = 0; k < i; k++) {
            x[i] -= measure->rows[k][block_measure_diagonal(i)] * x[k];
        }
        x[i] *= pivots[i];
    }
    for (uint32_t i = BLOCK_OBSERVED; i-- > AMBIENT;) { /* U' x = x, as far as the pose. */
        for (uint32_t k = i + 1u; k < BLOCK_OBSERVED; k++) {
            x[i] -= measure->rows[i][block_measure_diagonal(k)] * x[k];
        }
        x[i] *= pivots[i];
    }
    for (uint32_t row = 0; row < 6u; row++) {
        for (uint32_t column = 0; column < 6u; column++) {
            covariance[row][column] += x[AMBIENT + row] * x[AMBIENT + column];
        }
    }
}

/* Computes what an error of the sensor of one standard deviation does to a field of the site's frame. */
static void sensor_effect(const block_measure_t *measure, const block_site_errors_t *errors, const float field[3],
                          uint32_t error, float e[3]) {
    const uint32_t first = error < 3u ? error : error == 5u ? 1u : 0u;
    const uint32_t second = error < 3u ? error : error == 3u ? 1u : 2u;
    const float size = error < 3u ? 0.5f * errors->gain_sd : HALF_ROOT * errors->axis_sd_rad;
    float seen[2] = {0.0f, 0.0f}; /* The two components in the sensor's frame. */
    for (uint32_t row = 0; row < 3u; row++) {
        seen[0] += measure->rotation[row][first] * field[row];
        seen[1] += measure->rotation[row][second] * field[row];
    }
    for (uint32_t row = 0; row < 3u; row++) {
        e[row] = size * (measure->rotation[row][first] * seen[1] + measure->rotation[row][second] * seen[0]);
    }
}

void block_errors(const block_measure_t *measure, const loop_t *coils, uint32_t count,
                  const block_site_errors_t *errors, float covariance[6][6]) {
    float pivots[BLOCK_OBSERVED];
    for (uint32_t row = 0; row < BLOCK_OBSERVED; row++) {
        const float pivot = measure->rows[row][block_measure_diagonal(row)];
        pivots[row] = pivot > 0.0f ? 1.0f / pivot : 0.0f;
    }
    for (uint32_t row = 0; row < 6u; row++) {
        for (uint32_t column = 0; column < 6u; column++) {
            /* Axes of the sensor that all lean alike are a turn: only the attitude tells of it. */
            covariance[row][column] = row == column && row >= 3u ? 0.5f * errors->axis_sd_rad * errors->axis_sd_rad
                                                                 : 0.0f;
        }
    }
    for (uint32_t i = 0; i < count; i++) {
        effects_t effects;
        beacon_effects(measure, &coils[i], i, &errors->beacons[i], effects);
        for (uint32_t k = 0; k < BEACON_ERRORS; k++) {
            const float e[3] = {effects[0][k], effects[1][k], effects[2][k]};
            float d[BLOCK_OBSERVED] = {0.0f};
            add_effect(measure, i, e, d);
            add_bias(measure, pivots, d, covariance);
        }
    }
    for (uint32_t k = 0; k < SENSOR_ERRORS; k++) {
        float d[BLOCK_OBSERVED] = {0.0f};
        /* What it does to the ambient field, that field takes, and nobody else. */
        for (uint32_t i = 0; i < count; i++) {
            float e[3];
            sensor_effect(measure, errors, measure->model[i].field_uT, k, e);
            add_effect(measure, i, e, d);
        }
        add_bias(measure, pivots, d, covariance);
    }
}

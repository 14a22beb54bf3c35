#include "core/track/block_kalman.h"

#include <stddef.h>
#include <string.h>

#include "core/math/logarithm.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"
#include "core/track/block_matrix.h"

#define N BLOCK_STATES
#define Z BLOCK_OBSERVED

#define AMBIENT_WALK 5.0f  /* Walk of the ambient field, uT per root second: a moving sensor passes iron. */
#define OFFSET_WALK  0.02f /* Walk of the sensor's offset, uT per root second: it warms up. */
#define LARGE        1e18f /* A product of pivots beyond which its logarithm is taken. */

/* Adds to a covariance what white acceleration does to a vector and to its rate. length is that of a row. */
static void agitate(float *covariance, uint32_t length, uint32_t vector, uint32_t rate, float agility2, float seconds) {
    const float variance = agility2 * (seconds > 0.0f ? seconds : -seconds);
    const float middle = 0.5f * seconds * variance, far = seconds * seconds * variance * (1.0f / 3.0f);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        float *const of_vector = &covariance[(vector + axis) * length + axis];
        float *const of_rate = &covariance[(rate + axis) * length + axis];
        of_vector[vector] += far;
        of_vector[rate] += middle;
        of_rate[vector] += middle;
        of_rate[rate] += variance;
    }
}

/* Applies F to p and theta of so many columns of a covariance, p += T v and theta <- turn theta + T w, whose elements
 * are step apart, the columns stride. With both exchanged the columns are rows. */
static inline void transit(float *covariance, size_t step, size_t stride, uint32_t count, const float turn[3][3],
                           float seconds) {
    float *x = covariance;
    for (uint32_t column = 0; column < count; column++) {
        const float theta[3] = {x[BLOCK_THETA * step], x[(BLOCK_THETA + 1u) * step], x[(BLOCK_THETA + 2u) * step]};
        for (uint32_t axis = 0; axis < 3u; axis++) {
            x[(BLOCK_P + axis) * step] += seconds * x[(BLOCK_V + axis) * step];
            x[(BLOCK_THETA + axis) * step] = vector3_dot(turn[axis], theta) + seconds * x[(BLOCK_W + axis) * step];
        }
        x += stride;
    }
}

/* Moves a covariance on, of which the columns of p and theta beyond their own rows are left as they were. */
static inline void propagate(float *covariance, uint32_t length, const float turn[3][3], float acceleration2,
                             float turn2, float seconds) {
    transit(covariance, length, 1, length, turn, seconds);
    transit(covariance, 1, length, BLOCK_V, turn, seconds);
    agitate(covariance, length, BLOCK_P, BLOCK_V, acceleration2, seconds);
    agitate(covariance, length, BLOCK_THETA, BLOCK_W, turn2, seconds);
}

void block_kalman_predict(block_kalman_t *filter, float seconds) {
    float(*const covariance)[N] = filter->covariance, turn[3][3];
    const float passed = seconds > 0.0f ? seconds : -seconds;
    block_state_advance(&filter->state, seconds, turn);
    propagate(covariance[0], N, (const float(*)[3])turn, filter->acceleration2, filter->turn2, seconds);
    for (uint32_t row = BLOCK_V; row < N; row++) {
        for (uint32_t column = BLOCK_P; column < BLOCK_V; column++) {
            covariance[row][column] = covariance[column][row];
        }
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        covariance[BLOCK_E + axis][BLOCK_E + axis] += AMBIENT_WALK * AMBIENT_WALK * passed;
        covariance[BLOCK_B + axis][BLOCK_B + axis] += OFFSET_WALK * OFFSET_WALK * passed;
    }
}

void block_kalman_ahead(block_state_t *state, float covariance[BLOCK_E][BLOCK_E], float acceleration2, float turn2,
                        float seconds) {
    float turn[3][3];
    block_state_advance(state, seconds, turn);
    propagate(covariance[0], BLOCK_E, (const float(*)[3])turn, acceleration2, turn2, seconds);
}

/* Computes y - A x, x the state less the reference. */
static void observe(const block_state_t *state, const block_measure_t *measure, float y[Z]) {
    float x[N]; /* The errors: up to the turn rate they are in the order of the columns of A, and e then becomes a. */
    block_state_subtract(state, &measure->reference, x);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        x[BLOCK_ROW_A + axis] += vector3_dot(measure->rotation[axis], &x[BLOCK_B]);
    }
    for (uint32_t row = 0; row < Z; row++) {
        float sum = measure->rows[row][BLOCK_ROW_Y];
        for (uint32_t k = 0; k < BLOCK_ROW_Y; k++) {
            sum -= measure->rows[row][k] * x[k];
        }
        y[row] = sum;
    }
}

/* Computes P A'. The part of the ambient field at the sensor, a, has in P the columns of e
 * and of R b. */
static void weigh(const float covariance[N][N], const block_measure_t *measure, float pa[N][Z]) {
    for (uint32_t i = 0; i < N; i += 3u) {
        const float *const p = covariance[i];
        float ambient[3][3];
        matrix3_load(ambient, &p[BLOCK_E], N);
        matrix3_add_transposed(ambient, &p[BLOCK_B], N, measure->rotation[0], 3);
        for (uint32_t j = 0; j < Z; j += 3u) { /* Left of the diagonal A is zero. */
            const float *const a = measure->rows[j];
            float sum[3][3] = {{0.0f}};
            for (uint32_t k = j; k < BLOCK_ROW_A; k += 3u) {
                matrix3_add_transposed(sum, &p[k], N, &a[k], BLOCK_ROW);
            }
            matrix3_add_transposed(sum, ambient[0], 3, &a[BLOCK_ROW_A], BLOCK_ROW);
            matrix3_store((const float(*)[3])sum, &pa[i][j], Z);
        }
    }
}

/* Computes the lower triangle of M = 1 + A P A', and what is beside it in the blocks of the
 * diagonal. */
static void innovate(const float pa[N][Z], const block_measure_t *measure, float m[Z][Z]) {
    for (uint32_t j = 0; j < Z; j += 3u) {
        float ambient[3][3];
        matrix3_load(ambient, &pa[BLOCK_E][j], Z);
        matrix3_add(ambient, measure->rotation[0], 3, &pa[BLOCK_B][j], Z);
        for (uint32_t i = j; i < Z; i += 3u) {
            const float *const a = measure->rows[i];
            const float one = i == j ? 1.0f : 0.0f;
            float sum[3][3] = {{one, 0.0f, 0.0f}, {0.0f, one, 0.0f}, {0.0f, 0.0f, one}};
            for (uint32_t k = i; k < BLOCK_ROW_A; k += 3u) {
                matrix3_add(sum, &a[k], BLOCK_ROW, &pa[k][j], Z);
            }
            matrix3_add(sum, &a[BLOCK_ROW_A], BLOCK_ROW, ambient[0], 3);
            matrix3_store((const float(*)[3])sum, &m[i][j], Z);
        }
    }
}

/* Factors a block of the diagonal, M = V V', in place, with the inverse of V's diagonal on it.
 * Returns its determinant. */
static inline float factor3(float v[3][3]) {
    float determinant = 1.0f;
    for (uint32_t j = 0; j < 3u; j++) {
        const float pivot = v[j][j] > 1.0f ? v[j][j] : 1.0f; /* Less is rounding. */
        determinant *= pivot;
        v[j][j] = 1.0f / square_root(pivot);
        for (uint32_t i = j + 1u; i < 3u; i++) {
            v[i][j] *= v[j][j];
            for (uint32_t k = j + 1u; k <= i; k++) {
                v[i][k] -= v[i][j] * v[k][j];
            }
        }
    }
    return determinant;
}

/* Solves x V' = x in place, for three rows x and a block of the diagonal. */
static inline void solve3(float x[3][3], const float v[3][3]) {
    for (uint32_t row = 0; row < 3u; row++) {
        x[row][0] *= v[0][0];
        x[row][1] = (x[row][1] - x[row][0] * v[1][0]) * v[1][1];
        x[row][2] = (x[row][2] - x[row][0] * v[2][0] - x[row][1] * v[2][1]) * v[2][2];
    }
}

/* Factors M in place by blocks.
 * Returns the logarithm of its determinant. */
static float factor(float m[Z][Z]) {
    float logarithm = 0.0f;
    for (uint32_t j = 0; j < Z; j += 3u) {
        float v[3][3], below[3][3];
        matrix3_load(v, &m[j][j], Z);
        logarithm += natural_logarithm(factor3(v));
        matrix3_store((const float(*)[3])v, &m[j][j], Z);
        for (uint32_t i = j + 3u; i < Z; i += 3u) {
            matrix3_load(below, &m[i][j], Z);
            solve3(below, (const float(*)[3])v);
            matrix3_store((const float(*)[3])below, &m[i][j], Z);
            for (uint32_t k = j + 3u; k <= i; k += 3u) {
                float left[3][3];
                matrix3_load(left, &m[i][k], Z);
                matrix3_subtract_transposed(left, below[0], 3, &m[k][j], Z);
                matrix3_store((const float(*)[3])left, &m[i][k], Z);
            }
        }
    }
    return logarithm;
}

/* Solves V y = y in place.
 * Returns the sum of the squares of what it becomes. */
static float solve(const float v[Z][Z], float y[Z]) {
    float sum = 0.0f;
    for (uint32_t i = 0; i < Z; i++) {
        for (uint32_t k = 0; k < i; k++) {
            y[i] -= v[i][k] * y[k];
        }
        y[i] *= v[i][i];
        sum += y[i] * y[i];
    }
    return sum;
}

/* Turns P A' into G = P A' V'^-1 in place, and computes the step G y. */
static void gain(float g[N][Z], const float v[Z][Z], const float y[Z], float step[N]) {
    for (uint32_t i = 0; i < N; i += 3u) {
        float sum[3] = {0.0f, 0.0f, 0.0f};
        for (uint32_t j = 0; j < Z; j += 3u) {
            float own[3][3], own_v[3][3];
            matrix3_load(own, &g[i][j], Z);
            matrix3_load(own_v, &v[j][j], Z);
            for (uint32_t k = 0; k < j; k += 3u) {
                matrix3_subtract_transposed(own, &g[i][k], Z, &v[j][k], Z);
            }
            solve3(own, (const float(*)[3])own_v);
            matrix3_store((const float(*)[3])own, &g[i][j], Z);
            for (uint32_t row = 0; row < 3u; row++) {
                sum[row] += vector3_dot(own[row], &y[j]);
            }
        }
        memcpy(&step[i], sum, sizeof sum);
    }
}

/* Subtracts G G' from the covariance. */
static void shrink(float covariance[N][N], const float g[N][Z]) {
    for (uint32_t i = 0; i < N; i += 3u) {
        for (uint32_t j = 0; j <= i; j += 3u) {
            float left[3][3];
            matrix3_load(left, &covariance[i][j], N);
            for (uint32_t k = 0; k < Z; k += 3u) {
                matrix3_subtract_transposed(left, &g[i][k], Z, &g[j][k], Z);
            }
            for (uint32_t row = 0; row < 3u; row++) {
                for (uint32_t column = 0; column < 3u; column++) {
                    covariance[i + row][j + column] = covariance[j + column][i + row] = left[row][column];
                }
            }
        }
    }
}

bool block_kalman_update(block_kalman_t *filter, const block_measure_t *measure, float limit, float *chi_square,
                         float *log_determinant) {
    float y[Z], m[Z][Z], pa[N][Z], step[N];
    observe(&filter->state, measure, y);
    weigh((const float(*)[N])filter->covariance, measure, pa);
    innovate((const float(*)[Z])pa, measure, m);
    *log_determinant = factor(m);
    *chi_square = solve((const float(*)[Z])m, y);
    if (!(*chi_square <= limit)) {
        return false;
    }
    gain(pa, (const float(*)[Z])m, y, step);
    shrink(filter->covariance, (const float(*)[Z])pa);
    block_state_move(&filter->state, step);
    return true;
}

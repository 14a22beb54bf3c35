#include "core/track/block_kalman.h"

#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#include "core/math/logarithm.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"
#include "core/track/block_matrix.h"

#define N BLOCK_STATES

#define AMBIENT_WALK 5.0f  /* Walk of the ambient field, uT per root second: a moving sensor passes iron. */
#define OFFSET_WALK  0.02f /* Walk of the sensor's offset, uT per root second: it warms up. */
#define LARGE        1e18f /* A product of pivots beyond which its logarithm is taken. */

#define GROUP 3u /* Rows of A that are taken at once; each group has zeros in the columns of those before it. */

typedef float group_t[N][GROUP];

/* Adds to a covariance what white acceleration does to a vector and to its rate. length is that of a row. */
static void agitate(float *covariance, size_t length, uint32_t vector, uint32_t rate, float agility2, float seconds) {
    const float variance = agility2 * (seconds > 0.0f ? seconds : -seconds);
    const float middle = 0.5f * seconds * variance, far = seconds * seconds * variance * (1.0f / 3.0f);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        covariance[(vector + axis) * length + vector + axis] += far;
        covariance[(rate + axis) * length + vector + axis] += middle;
        covariance[(rate + axis) * length + rate + axis] += variance;
    }
}

/* Applies F to the first six elements of a vector, p += T v and theta <- turn theta + T w, which lie step apart. v and
 * w are given in their order, motion_step apart. */
static inline void transit(float *x, size_t step, const float *motion, size_t motion_step, const float turn[3][3],
                           float seconds) {
    const float theta[3] = {x[3 * step], x[4 * step], x[5 * step]};
    for (uint32_t axis = 0; axis < 3u; axis++) {
        x[axis * step] += seconds * motion[axis * motion_step];
        x[(3u + axis) * step] = vector3_dot(turn[axis], theta) + seconds * motion[(3u + axis) * motion_step];
    }
}

/* Moves so many rows of a covariance on, which have that length. */
static inline void propagate(float *covariance, size_t length, const float turn[3][3], float acceleration2, float turn2,
                             float seconds) {
    float *const motion = &covariance[BLOCK_V * length];
    for (uint32_t row = 0; row < BLOCK_V; row++) { /* Right of them is what stands below, in columns. */
        transit(&covariance[row * length], 1, &motion[row], length, turn, seconds);
    }
    for (uint32_t row = BLOCK_V; row < length; row++) {
        transit(&covariance[row * length], 1, &covariance[row * length + BLOCK_V], 1, turn, seconds);
    }
    for (uint32_t column = 0; column < BLOCK_V; column++) {
        transit(&covariance[column], length, &motion[column], length, turn, seconds);
    }
    agitate(covariance, length, BLOCK_P, BLOCK_V, acceleration2, seconds);
    agitate(covariance, length, BLOCK_THETA, BLOCK_W, turn2, seconds);
}

void block_kalman_predict(block_kalman_t *filter, float seconds) {
    float(*const covariance)[N] = filter->covariance, turn[3][3];
    const float passed = seconds > 0.0f ? seconds : -seconds;
    block_state_advance(&filter->state, seconds, turn);
    propagate(covariance[0], N, (const float(*)[3])turn, filter->acceleration2, filter->turn2, seconds);
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

/* Returns the first column of a group of rows that is not zero. */
static inline uint32_t first_column(uint32_t row) {
    return row < 6u ? row : row < BLOCK_OBSERVED ? BLOCK_V : BLOCK_THETA;
}

/* Adds to six rows of P A' what a column of P does, whose elements lie step apart. */
static inline void weigh_column(const float *p, size_t step, const float *a, float sum[6][GROUP]) {
    for (uint32_t i = 0; i < 6u; i++) {
        for (uint32_t j = 0; j < GROUP; j++) {
            sum[i][j] += p[i * step] * a[(size_t)j * BLOCK_ROW];
        }
    }
}

/* Computes P A' for a group of rows, from the blocks of six rows and columns on and below the diagonal of P. */
static inline void weigh(const float covariance[N][N], const float rows[GROUP][BLOCK_ROW], uint32_t first, group_t pa) {
    for (uint32_t i = 0; i < N; i += 6u) {
        float sum[6][GROUP] = {{0.0f}};
        uint32_t k = first;
        for (; k < i + 6u; k++) {
            weigh_column(&covariance[i][k], N, &rows[0][k], sum);
        }
        for (; k < N; k++) {
            weigh_column(&covariance[k][i], 1, &rows[0][k], sum);
        }
        memcpy(pa[i], sum, sizeof sum);
    }
}

/* Computes the lower triangle of M = 1 + A P A', and y - A x. */
static inline void innovate(const float rows[GROUP][BLOCK_ROW], uint32_t first, const group_t pa, const float x[N],
                            float m[GROUP][GROUP], float y[GROUP]) {
    float sum[GROUP][GROUP] = {{1.0f, 0.0f, 0.0f}, {0.0f, 1.0f, 0.0f}, {0.0f, 0.0f, 1.0f}};
    float left[GROUP] = {rows[0][BLOCK_ROW_Y], rows[1][BLOCK_ROW_Y], rows[2][BLOCK_ROW_Y]};
    for (uint32_t three = first; three < N; three += 3u) {
        for (uint32_t k = three; k < three + 3u; k++) {
            for (uint32_t i = 0; i < GROUP; i++) {
                for (uint32_t j = 0; j <= i; j++) {
                    sum[i][j] += rows[i][k] * pa[k][j];
                }
                left[i] -= rows[i][k] * x[k];
            }
        }
    }
    memcpy(m, sum, sizeof sum);
    memcpy(y, left, sizeof left);
}

/* Factors M = V V' in place, with the inverse of V's diagonal on it.
 * Returns its determinant. */
static inline float factor(float v[GROUP][GROUP]) {
    float determinant = 1.0f;
    for (uint32_t j = 0; j < GROUP; j++) {
        const float pivot = v[j][j] > 1.0f ? v[j][j] : 1.0f; /* Less is rounding. */
        determinant *= pivot;
        v[j][j] = 1.0f / square_root(pivot);
        for (uint32_t i = j + 1u; i < GROUP; i++) {
            v[i][j] *= v[j][j];
            for (uint32_t k = j + 1u; k <= i; k++) {
                v[i][k] -= v[i][j] * v[k][j];
            }
        }
    }
    return determinant;
}

/* Solves V x = x in place. */
static inline void solve(const float v[GROUP][GROUP], float x[GROUP]) {
    x[0] *= v[0][0];
    x[1] = (x[1] - x[0] * v[1][0]) * v[1][1];
    x[2] = (x[2] - x[0] * v[2][0] - x[1] * v[2][1]) * v[2][2];
}

/* Turns P A' into G = P A' V'^-1 in place, and adds the step G y to x. */
static inline void gain(group_t g, const float v[GROUP][GROUP], const float y[GROUP], float x[N]) {
    for (uint32_t three = 0; three < N; three += 3u) {
        for (uint32_t i = three; i < three + 3u; i++) {
            solve(v, g[i]);
            x[i] += vector3_dot(g[i], y);
        }
    }
}

/* Computes P - G G', the blocks of six rows and columns on and below the diagonal. */
static void shrink(const float from[N][N], const group_t g, float to[N][N]) {
    for (uint32_t i = 0; i < N; i += 6u) {
        const float *p = from[i], *other = g[0];
        float *left = to[i], own[6][GROUP];
        for (uint32_t row = 0; row < 6u; row++) {
            for (uint32_t k = 0; k < GROUP; k++) {
                own[row][k] = -g[i + row][k];
            }
        }
        for (uint32_t pairs = i / 2u + 3u; pairs > 0u; pairs--) {
            for (uint32_t column = 0; column < 2u; column++) {
                const float *const g_other = &other[(size_t)column * GROUP];
                for (uint32_t row = 0; row < 6u; row++) {
                    left[row * N + column] = p[row * N + column] + own[row][0] * g_other[0] + own[row][1] * g_other[1] +
                                             own[row][2] * g_other[2];
                }
            }
            p += 2u;
            left += 2u;
            other += (size_t)2 * GROUP;
        }
    }
}

float block_kalman_update(block_kalman_t *filter, const block_measure_t *measure, const block_sweep_t *sweep,
                          float limit, float *log_determinant) {
    const uint32_t end = sweep != NULL ? BLOCK_OBSERVED + BLOCK_SWEEPS : BLOCK_OBSERVED;
    float x[N], before[N], rest[N][N], chi_square = 0.0f;
    group_t g;
    const float(*covariance)[N] = (const float(*)[N])filter->covariance;
    block_state_subtract(&filter->state, &measure->reference, x);
    *log_determinant = 0.0f;
    for (uint32_t row = 0; row < end; row += GROUP) {
        const float(*const rows)[BLOCK_ROW] = row < BLOCK_OBSERVED ? &measure->rows[row] : sweep->rows;
        float v[GROUP][GROUP], y[GROUP];
        weigh(covariance, rows, first_column(row), g);
        innovate(rows, first_column(row), (const float(*)[GROUP])g, x, v, y);
        *log_determinant += natural_logarithm(factor(v));
        solve((const float(*)[GROUP])v, y);
        chi_square += vector3_dot(y, y);
        const bool last = row + GROUP == end;
        if (last && !(chi_square <= limit)) {
            return chi_square;
        }
        gain(g, (const float(*)[GROUP])v, y, x);
        shrink(covariance, (const float(*)[GROUP])g, last ? filter->covariance : rest);
        covariance = (const float(*)[N])rest;
    }
    block_state_subtract(&filter->state, &measure->reference, before);
    for (uint32_t i = 0; i < N; i++) {
        x[i] -= before[i];
    }
    block_state_move(&filter->state, x, &filter->state);
    return chi_square;
}

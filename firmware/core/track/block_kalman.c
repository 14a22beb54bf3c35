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

#define GROUP 3u /* Rows of A that are taken at once. */

typedef float group_t[N][GROUP];

/* Adds to a covariance what white acceleration does to a vector and to its rate. length is that of a row. */
static inline void agitate(float *covariance, size_t length, uint32_t vector, uint32_t rate, float agility2,
                           float seconds) {
    const float variance = agility2 * (seconds > 0.0f ? seconds : -seconds);
    const float middle = 0.5f * seconds * variance, far = seconds * seconds * variance * (1.0f / 3.0f);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        covariance[(vector + axis) * length + vector + axis] += far;
        covariance[(rate + axis) * length + vector + axis] += middle;
        covariance[(rate + axis) * length + rate + axis] += variance;
    }
}

/* Applies F to the first six elements of a row, p += T v and theta <- turn theta + T w. motion has v and w. */
static inline void transit(float *x, const float *motion, const float turn[3][3], float seconds) {
    const float theta[3] = {x[3], x[4], x[5]};
    for (uint32_t axis = 0; axis < 3u; axis++) {
        x[axis] += seconds * motion[axis];
        x[3u + axis] = vector3_dot(turn[axis], theta) + seconds * motion[3u + axis];
    }
}

/* Turns the rows and columns of theta, in those of p and theta. */
static inline void turn_both(float *covariance, size_t length, const float turn[3][3]) {
    float turned[3][BLOCK_V];
    for (uint32_t column = 0; column < BLOCK_V; column++) {
        float theta[3];
        for (uint32_t k = 0; k < 3u; k++) {
            theta[k] = covariance[(BLOCK_THETA + k) * length + column];
        }
        for (uint32_t axis = 0; axis < 3u; axis++) {
            turned[axis][column] = vector3_dot(turn[axis], theta);
        }
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        float *const row = &covariance[(BLOCK_THETA + axis) * length];
        for (uint32_t column = 0; column < 3u; column++) {
            row[column] = turned[axis][column];
        }
        for (uint32_t column = 0; column <= axis; column++) {
            row[BLOCK_THETA + column] = vector3_dot(turn[column], &turned[axis][BLOCK_THETA]);
        }
    }
}

/* Moves so many rows of a covariance P on, which have that length: the rows of the rates and those behind by F' from
 * the right, then those of z = (p, theta), with D the turn of theta alone, u the rates, and Y what stands by then in
 * the rows of u: D P_zz D' + T (Y + Y') - T^2 P_uu. */
static inline void propagate(float *covariance, size_t length, const float turn[3][3], float acceleration2, float turn2,
                             float seconds) {
    const float *const motion = &covariance[BLOCK_V * length];
    for (uint32_t row = BLOCK_V; row < length; row++) {
        transit(&covariance[row * length], &covariance[row * length + BLOCK_V], turn, seconds);
    }
    turn_both(covariance, length, turn);
    for (uint32_t row = 0; row < BLOCK_V; row++) {
        for (uint32_t column = 0; column <= row; column++) {
            const float rates = motion[row * length + BLOCK_V + column];
            const float both = motion[row * length + column] + motion[column * length + row];
            const float moved = covariance[row * length + column] + seconds * (both - seconds * rates);
            covariance[row * length + column] = covariance[column * length + row] = moved;
        }
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

/* Adds to six rows of P A' what three columns of P do. The elements of a column lie step apart, the columns next. */
static inline void weigh_columns(const float *p, size_t step, size_t next, const float *a, float sum[6][GROUP]) {
    for (uint32_t k = 0; k < 3u; k++) {
        for (uint32_t i = 0; i < 6u; i++) {
            for (uint32_t j = 0; j < GROUP; j++) {
                sum[i][j] += p[i * step + k * next] * a[(size_t)j * BLOCK_ROW + k];
            }
        }
    }
}

/* The columns of a group of rows that are not zero: from first on, before end. */
typedef struct {
    uint32_t first, end;
} columns_t;

/* Returns the columns of the group that begins with a row. */
static inline columns_t columns_of(uint32_t row) {
    return row == 0u   ? (columns_t){BLOCK_P, N}
           : row == 3u ? (columns_t){BLOCK_P, BLOCK_E}
           : row == 6u ? (columns_t){BLOCK_THETA, BLOCK_E}
                       : (columns_t){BLOCK_THETA, BLOCK_B}; /* The sweep. */
}

/* Computes P A' for a group of rows, from the blocks of six rows and columns on and below the diagonal of P. */
static inline void weigh(const float covariance[N][N], const float rows[GROUP][BLOCK_ROW], columns_t columns,
                         group_t pa) {
    for (uint32_t i = 0; i < N; i += 6u) {
        const uint32_t below = i + 6u < columns.end ? i + 6u : columns.end;
        float sum[6][GROUP] = {{0.0f}};
        uint32_t k = columns.first;
        for (; k < below; k += 3u) {
            weigh_columns(&covariance[i][k], N, 1, &rows[0][k], sum);
        }
        for (; k < columns.end; k += 3u) {
            weigh_columns(&covariance[k][i], 1, N, &rows[0][k], sum);
        }
        for (uint32_t row = 0; row < 6u; row++) {
            for (uint32_t j = 0; j < GROUP; j++) {
                pa[i + row][j] = sum[row][j];
            }
        }
    }
}

/* Computes the lower triangle of M = 1 + A P A', and y - A x. */
static inline void innovate(const float rows[GROUP][BLOCK_ROW], columns_t columns, const group_t pa, const float x[N],
                            float m[GROUP][GROUP], float y[GROUP]) {
    float sum[GROUP][GROUP], left[GROUP];
    for (uint32_t i = 0; i < GROUP; i++) {
        for (uint32_t j = 0; j <= i; j++) {
            sum[i][j] = i == j ? 1.0f : 0.0f;
        }
        left[i] = rows[i][BLOCK_ROW_Y];
    }
    for (uint32_t three = columns.first; three < columns.end; three += 3u) {
        for (uint32_t k = 0; k < 3u; k++) {
            for (uint32_t i = 0; i < GROUP; i++) {
                for (uint32_t j = 0; j <= i; j++) {
                    sum[i][j] += rows[i][three + k] * pa[three + k][j];
                }
                left[i] -= rows[i][three + k] * x[three + k];
            }
        }
    }
    for (uint32_t i = 0; i < GROUP; i++) {
        for (uint32_t j = 0; j <= i; j++) {
            m[i][j] = sum[i][j];
        }
        y[i] = left[i];
    }
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
        for (uint32_t i = 0; i < 3u; i++) {
            solve(v, g[three + i]);
            x[three + i] += vector3_dot(g[three + i], y);
        }
    }
}

/* Computes six rows of P - G G' in three columns; own are the negative rows of G that belong to the rows, other those
 * that belong to the columns. In a block on the diagonal, whose columns these are from the first on, what is above the
 * diagonal is copied from below. */
static inline void shrink_columns(const float *p, const float own[6][GROUP], const float *other, bool diagonal,
                                  uint32_t first, float *left) {
    for (uint32_t column = first; column < first + 3u; column++) {
        for (uint32_t row = diagonal ? column : 0u; row < 6u; row++) {
            const float shrunk = p[row * N + column] + own[row][0] * other[0] + own[row][1] * other[1] +
                                 own[row][2] * other[2];
            left[row * N + column] = shrunk;
            if (diagonal && row != column) {
                left[column * N + row] = shrunk;
            }
        }
        other += GROUP;
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
        for (uint32_t threes = i / 3u; threes > 0u; threes--) {
            shrink_columns(p, (const float(*)[GROUP])own, other, false, 0, left);
            p += 3u;
            left += 3u;
            other += (size_t)3 * GROUP;
        }
        shrink_columns(p, (const float(*)[GROUP])own, other, true, 0, left);
        shrink_columns(p, (const float(*)[GROUP])own, other + (size_t)3 * GROUP, true, 3, left);
    }
}

float block_kalman_update(block_kalman_t *filter, const block_measure_t *measure, const block_sweep_t *sweep,
                          float limit, float *log_determinant) {
    const uint32_t end = sweep != NULL ? BLOCK_OBSERVED + BLOCK_SWEEPS : BLOCK_OBSERVED;
    float x[N], before[N], rest[N][N], chi_square = 0.0f;
    group_t g;
    const float(*covariance)[N] = (const float(*)[N])filter->covariance;
    block_state_subtract(&filter->state, &measure->reference, before);
    memcpy(x, before, sizeof x);
    *log_determinant = 0.0f;
    for (uint32_t row = 0; row < end; row += GROUP) {
        const float(*const rows)[BLOCK_ROW] = row < BLOCK_OBSERVED ? &measure->rows[row] : sweep->rows;
        float v[GROUP][GROUP], y[GROUP];
        const columns_t columns = columns_of(row);
        weigh(covariance, rows, columns, g);
        innovate(rows, columns, (const float(*)[GROUP])g, x, v, y);
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
    for (uint32_t i = 0; i < N; i++) {
        x[i] -= before[i];
    }
    block_state_move(&filter->state, x, &filter->state);
    return chi_square;
}

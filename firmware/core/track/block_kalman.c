#include "core/track/block_kalman.h"

#include <string.h>

#include "core/math/logarithm.h"
#include "core/math/quaternion.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"

#define N BLOCK_STATES
#define Z BLOCK_OBSERVED

#define AMBIENT_WALK 5.0f  /* Walk of the ambient field, uT per root second: a moving sensor passes iron. */
#define OFFSET_WALK  0.02f /* Walk of the sensor's offset, uT per root second: it warms up. */
#define LARGE        1e18f /* A product of pivots beyond which its logarithm is taken. */

/* Adds to a filter's covariance what white acceleration does to a vector and, three rows on, to its rate. */
static void agitate(float covariance[N][N], uint32_t vector, uint32_t rate, float agility, float seconds) {
    const float variance = agility * agility * (seconds > 0.0f ? seconds : -seconds);
    const float middle = 0.5f * seconds * variance, far = seconds * seconds * variance * (1.0f / 3.0f);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        covariance[vector + axis][vector + axis] += far;
        covariance[vector + axis][rate + axis] += middle;
        covariance[rate + axis][vector + axis] += middle;
        covariance[rate + axis][rate + axis] += variance;
    }
}

/* Applies F to p and theta of so many columns: p += T v, theta <- turn theta + T w. With step N the columns are those
 * of the covariance, with step 1 its rows. */
static inline void transition(float *first, uint32_t step, uint32_t stride, uint32_t count, const float turn[3][3],
                              float seconds) {
    for (uint32_t c = 0; c < count; c++) {
        float *const x = first + c * stride;
        const float theta[3] = {x[BLOCK_THETA * step], x[(BLOCK_THETA + 1u) * step], x[(BLOCK_THETA + 2u) * step]};
        for (uint32_t axis = 0; axis < 3u; axis++) {
            x[(BLOCK_P + axis) * step] += seconds * x[(BLOCK_V + axis) * step];
            x[(BLOCK_THETA + axis) * step] = vector3_dot(turn[axis], theta) + seconds * x[(BLOCK_W + axis) * step];
        }
    }
}

void block_kalman_predict(block_kalman_t *filter, float seconds) {
    block_state_t *const state = &filter->state;
    float(*const covariance)[N] = filter->covariance;
    float turned[3], step[4], turn[3][3];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        state->position_m[axis] += seconds * state->velocity_m_s[axis];
        turned[axis] = seconds * state->rate_rad_s[axis];
    }
    quaternion_exp(turned, step);
    quaternion_multiply(step, state->quaternion, state->quaternion);
    quaternion_matrix(step, turn);
    transition(covariance[0], N, 1, N, (const float(*)[3])turn, seconds);
    transition(covariance[0], 1, N, BLOCK_V, (const float(*)[3])turn, seconds);
    for (uint32_t row = BLOCK_V; row < N; row++) {
        for (uint32_t column = BLOCK_P; column < BLOCK_V; column++) {
            covariance[row][column] = covariance[column][row];
        }
    }
    agitate(covariance, BLOCK_P, BLOCK_V, filter->acceleration, seconds);
    agitate(covariance, BLOCK_THETA, BLOCK_W, filter->turn, seconds);
    const float passed = seconds > 0.0f ? seconds : -seconds;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        covariance[BLOCK_E + axis][BLOCK_E + axis] += AMBIENT_WALK * AMBIENT_WALK * passed;
        covariance[BLOCK_B + axis][BLOCK_B + axis] += OFFSET_WALK * OFFSET_WALK * passed;
    }
}

/* Computes y - A x, x the state less the reference. */
static void observe(const block_state_t *state, const block_measure_t *measure, float y[Z]) {
    const block_state_t *const from = &measure->reference;
    const float back[4] = {-from->quaternion[0], -from->quaternion[1], -from->quaternion[2], from->quaternion[3]};
    float turn[4], offset[3], z[Z], motion[6];
    quaternion_multiply(state->quaternion, back, turn);
    vector3_subtract(state->offset_uT, from->offset_uT, offset);
    /* The angle over its sine, of half of the turn, by the series of the arc sine. */
    const float sine2 = vector3_dot(turn, turn);
    const float scale = (turn[3] < 0.0f ? -2.0f : 2.0f) * (1.0f + sine2 * (1.0f / 6.0f + sine2 * (3.0f / 40.0f)));
    for (uint32_t axis = 0; axis < 3u; axis++) {
        z[axis] = state->position_m[axis] - from->position_m[axis];
        z[3u + axis] = scale * turn[axis];
        z[6u + axis] = state->ambient_uT[axis] - from->ambient_uT[axis] + vector3_dot(measure->rotation[axis], offset);
        motion[axis] = state->velocity_m_s[axis] - from->velocity_m_s[axis];
        motion[3u + axis] = state->rate_rad_s[axis] - from->rate_rad_s[axis];
    }
    for (uint32_t column = 0; column < Z; column++) {
        float sum = measure->side[column];
        for (uint32_t k = column; k < Z; k++) {
            sum -= measure->factor[k][column] * z[k];
        }
        for (uint32_t k = 0; k < 6u; k++) {
            sum -= measure->motion[column][k] * motion[k];
        }
        y[column] = sum;
    }
}

/* Computes P A', A of the block being [U' in the columns of p and theta, W, U' in those of e, U' R in those of b]. */
static void weight(const float covariance[N][N], const block_measure_t *measure, float pa[N][Z]) {
    for (uint32_t row = 0; row < N; row++) {
        const float *const p = covariance[row];
        float ambient[3]; /* What the ambient field at the sensor has in this row. */
        for (uint32_t axis = 0; axis < 3u; axis++) {
            ambient[axis] = p[BLOCK_E + axis] + vector3_dot(measure->rotation[axis], &p[BLOCK_B]);
        }
        for (uint32_t column = 0; column < Z; column++) {
            const float *const w = measure->motion[column];
            float sum = 0.0f;
            for (uint32_t k = column; k < 6u; k++) {
                sum += p[k] * measure->factor[k][column];
            }
            for (uint32_t k = column < 6u ? 6u : column; k < Z; k++) {
                sum += ambient[k - 6u] * measure->factor[k][column];
            }
            for (uint32_t k = 0; k < 6u; k++) {
                sum += p[BLOCK_V + k] * w[k];
            }
            pa[row][column] = sum;
        }
    }
}

/* Computes the lower triangle of M = 1 + A P A'. */
static void innovation(const float pa[N][Z], const block_measure_t *measure, float m[Z][Z]) {
    float ambient[3][Z];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float *const r = measure->rotation[axis];
        for (uint32_t column = 0; column < Z; column++) {
            ambient[axis][column] = pa[BLOCK_E + axis][column] + r[0] * pa[BLOCK_B][column] +
                                    r[1] * pa[BLOCK_B + 1][column] + r[2] * pa[BLOCK_B + 2][column];
        }
    }
    for (uint32_t row = 0; row < Z; row++) {
        const float *const w = measure->motion[row];
        for (uint32_t column = 0; column <= row; column++) {
            float sum = row == column ? 1.0f : 0.0f;
            for (uint32_t k = row; k < 6u; k++) {
                sum += measure->factor[k][row] * pa[k][column];
            }
            for (uint32_t k = row < 6u ? 6u : row; k < Z; k++) {
                sum += measure->factor[k][row] * ambient[k - 6u][column];
            }
            for (uint32_t k = 0; k < 6u; k++) {
                sum += w[k] * pa[BLOCK_V + k][column];
            }
            m[row][column] = sum;
        }
    }
}

/* Factors M = V V' in place, with the inverse of V's diagonal on it, and solves V y = y in place.
 * Returns the logarithm of M's determinant. */
static float factor(float v[Z][Z], float y[Z]) {
    float product = 1.0f, logarithm = 0.0f;
    for (uint32_t j = 0; j < Z; j++) {
        float pivot = v[j][j];
        for (uint32_t k = 0; k < j; k++) {
            pivot -= v[j][k] * v[j][k];
            y[j] -= v[j][k] * y[k];
        }
        pivot = pivot > 1.0f ? pivot : 1.0f; /* Less is rounding. */
        const float over = 1.0f / square_root(pivot);
        v[j][j] = over;
        y[j] *= over;
        for (uint32_t i = j + 1u; i < Z; i++) {
            float sum = v[i][j];
            for (uint32_t k = 0; k < j; k++) {
                sum -= v[i][k] * v[j][k];
            }
            v[i][j] = over * sum;
        }
        product *= pivot;
        if (product > LARGE) {
            logarithm += natural_logarithm(product);
            product = 1.0f;
        }
    }
    return logarithm + natural_logarithm(product);
}

/* Turns P A' into G = P A' V'^-1 in place, and computes the step G y. */
static void gain(float g[N][Z], const float v[Z][Z], const float y[Z], float step[N]) {
    for (uint32_t row = 0; row < N; row++) {
        float own[Z], sum = 0.0f;
        for (uint32_t column = 0; column < Z; column++) {
            float left = g[row][column];
            for (uint32_t k = 0; k < column; k++) {
                left -= own[k] * v[column][k];
            }
            own[column] = left * v[column][column];
            sum += own[column] * y[column];
        }
        memcpy(g[row], own, sizeof own);
        step[row] = sum;
    }
}

/* Subtracts G G' from the covariance. */
static void shrink(float covariance[N][N], const float g[N][Z]) {
    for (uint32_t row = 0; row < N; row++) {
        for (uint32_t column = 0; column <= row; column++) {
            float sum = covariance[row][column];
            for (uint32_t k = 0; k < Z; k++) {
                sum -= g[row][k] * g[column][k];
            }
            covariance[row][column] = covariance[column][row] = sum;
        }
    }
}

static void move(block_state_t *state, const float step[N]) {
    float turn[4];
    quaternion_exp(&step[BLOCK_THETA], turn);
    quaternion_multiply(turn, state->quaternion, state->quaternion);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        state->position_m[axis] += step[BLOCK_P + axis];
        state->velocity_m_s[axis] += step[BLOCK_V + axis];
        state->rate_rad_s[axis] += step[BLOCK_W + axis];
        state->ambient_uT[axis] += step[BLOCK_E + axis];
        state->offset_uT[axis] += step[BLOCK_B + axis];
    }
}

bool block_kalman_update(block_kalman_t *filter, const block_measure_t *measure, float limit, float *chi_square,
                         float *log_determinant) {
    float y[Z], m[Z][Z], pa[N][Z], step[N];
    observe(&filter->state, measure, y);
    weight((const float(*)[N])filter->covariance, measure, pa);
    innovation((const float(*)[Z])pa, measure, m);
    *log_determinant = factor(m, y);
    *chi_square = 0.0f;
    for (uint32_t column = 0; column < Z; column++) {
        *chi_square += y[column] * y[column];
    }
    if (!(*chi_square <= limit)) {
        return false;
    }
    gain(pa, (const float(*)[Z])m, y, step);
    shrink(filter->covariance, (const float(*)[Z])pa);
    move(&filter->state, step);
    return true;
}

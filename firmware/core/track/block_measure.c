#include "core/track/block_measure.h"

#include <stdbool.h>
#include <string.h>

#include "core/math/quaternion.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"
#include "core/track/block_matrix.h"

#define LEAST_PIVOT 1e-6f /* Least pivot of the information, over its own diagonal, that is not rounding. */

static void multiply(const float matrix[3][3], const float vector[3], float product[3]) {
    for (uint32_t i = 0; i < 3u; i++) {
        product[i] = vector3_dot(matrix[i], vector);
    }
}

/* Expands the five numbers of a symmetric gradient without trace. */
static inline void expand(const float five[5], float gradient[3][3]) {
    gradient[0][0] = five[0];
    gradient[0][1] = gradient[1][0] = five[1];
    gradient[0][2] = gradient[2][0] = five[2];
    gradient[1][1] = five[3];
    gradient[1][2] = gradient[2][1] = five[4];
    gradient[2][2] = -five[0] - five[3];
}

/* Computes field and gradient of each column, in the site's frame. */
static void model(const loop_t *coils, uint32_t ambient, block_measure_t *measure) {
    const block_state_t *const at = &measure->reference;
    for (uint32_t i = 0; i < ambient; i++) {
        float gradient[3][3];
        loop_field_and_gradient(&coils[i], at->position_m, measure->field_uT[i], gradient);
        const float five[5] = {gradient[0][0], gradient[0][1], gradient[0][2], gradient[1][1], gradient[1][2]};
        memcpy(measure->gradient[i], five, sizeof five);
    }
    memcpy(measure->field_uT[ambient], at->ambient_uT, sizeof at->ambient_uT);
    memset(measure->gradient[ambient], 0, sizeof measure->gradient[ambient]);
}

/* Sums fields and gradients over the columns for a row of the block. */
static void sum_row(const block_t *block, uint32_t i, block_measure_t *measure) {
    float field[3] = {0.0f}, gradient[5] = {0.0f}, field_moment[3] = {0.0f}, gradient_moment[5] = {0.0f};
    for (uint32_t j = 0; j < block->columns; j++) {
        const float weight = block->gram[i][j], moment = block->moment[i][j];
        for (uint32_t axis = 0; axis < 3u; axis++) {
            field[axis] += weight * measure->field_uT[j][axis];
            field_moment[axis] += moment * measure->field_uT[j][axis];
        }
        for (uint32_t k = 0; k < 5u; k++) {
            gradient[k] += weight * measure->gradient[j][k];
            gradient_moment[k] += moment * measure->gradient[j][k];
        }
    }
    memcpy(measure->field_sum[i], field, sizeof field);
    memcpy(measure->gradient_sum[i], gradient, sizeof gradient);
    memcpy(measure->field_moment[i], field_moment, sizeof field_moment);
    memcpy(measure->gradient_moment[i], gradient_moment, sizeof gradient_moment);
    measure->ambient_sum[i] = block->gram[i][block->columns - 1u];
}

/* Computes what the model leaves of the sums of a row, turned into the site's frame. offset is that of the sensor in
 * the site's frame. */
static inline void leave(const block_measure_t *measure, uint32_t i, const float sums_uT[3], const float offset[3],
                         float residual[3]) {
    float moment[3][3], turned[3];
    expand(measure->gradient_moment[i], moment);
    vector3_cross(measure->reference.rate_rad_s, measure->field_moment[i], turned);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float moved = vector3_dot(moment[axis], measure->reference.velocity_m_s) - turned[axis];
        const float still = measure->field_sum[i][axis] + measure->ambient_sum[i] * offset[axis];
        residual[axis] = vector3_dot(measure->rotation[axis], sums_uT) - still - moved;
    }
}

/* Computes the gradient of the likelihood, times sigma^2. */
static void descend(const block_t *block, const block_measure_t *measure, float side[BLOCK_OBSERVED]) {
    float offset[3], residual[3] = {0.0f}, crossed[3], by_p[3] = {0.0f}, by_theta[3] = {0.0f};
    multiply((const float(*)[3])measure->rotation, measure->reference.offset_uT, offset);
    for (uint32_t i = 0; i < block->columns; i++) {
        float gradient[3][3];
        leave(measure, i, block->sums_uT[i], offset, residual);
        expand(measure->gradient[i], gradient);
        vector3_cross(residual, measure->field_uT[i], crossed);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            by_p[axis] += vector3_dot(gradient[axis], residual);
            by_theta[axis] += crossed[axis];
        }
    }
    memcpy(&side[0], by_p, sizeof by_p);
    memcpy(&side[3], by_theta, sizeof by_theta);
    memcpy(&side[6], residual, sizeof residual); /* That of the last row, the ambient field's. */
}

/* Sums the products of gradients with what they were summed to. */
static void square(uint32_t count, const float gradient[][5], const float sum[][5], float product[3][3]) {
    float total[3][3] = {{0.0f}};
    for (uint32_t i = 0; i < count; i++) {
        float left[3][3], right[3][3];
        expand(gradient[i], left);
        expand(sum[i], right);
        matrix3_add(total, left[0], 3, right[0], 3);
    }
    matrix3_store((const float(*)[3])total, product[0], 3);
}

/* Sums the rows of gradients, crossed with fields. */
static void cross(uint32_t count, const float gradient[][5], const float field[][3], float product[3][3]) {
    float total[3][3] = {{0.0f}};
    for (uint32_t i = 0; i < count; i++) {
        float rows[3][3], crossed[3];
        expand(gradient[i], rows);
        for (uint32_t row = 0; row < 3u; row++) {
            vector3_cross(rows[row], field[i], crossed);
            for (uint32_t column = 0; column < 3u; column++) {
                total[row][column] += crossed[column];
            }
        }
    }
    matrix3_store((const float(*)[3])total, product[0], 3);
}

/* Sums the products [B]x' [b]x = (B b) 1 - b B' of fields B with what they were summed to, b. */
static void turn(uint32_t count, const float field[][3], const float sum[][3], float product[3][3]) {
    float total[3][3] = {{0.0f}};
    for (uint32_t i = 0; i < count; i++) {
        for (uint32_t row = 0; row < 3u; row++) {
            for (uint32_t column = 0; column < 3u; column++) {
                total[row][column] -= sum[i][row] * field[i][column];
            }
        }
    }
    const float trace = total[0][0] + total[1][1] + total[2][2];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        total[axis][axis] -= trace;
    }
    matrix3_store((const float(*)[3])total, product[0], 3);
}

static void store(float rows[BLOCK_OBSERVED][BLOCK_ROW], uint32_t row, uint32_t column, const float block[3][3]) {
    matrix3_store(block, &rows[row][column], BLOCK_ROW);
}

/* Composes [L K g], times sigma^2; of L the upper triangle of blocks. */
static void compose(const block_t *block, block_measure_t *measure) {
    const uint32_t count = block->columns, last = count - 1u;
    const float(*const gradient)[5] = (const float(*)[5])measure->gradient;
    const float(*const field)[3] = (const float(*)[3])measure->field_uT;
    const float(*const gradient_moment)[5] = (const float(*)[5])measure->gradient_moment;
    const float(*const field_moment)[3] = (const float(*)[3])measure->field_moment;
    const float *const b = measure->field_sum[last], *const m = field_moment[last];
    const float weight = measure->ambient_sum[last];
    float(*const rows)[BLOCK_ROW] = measure->rows, part[3][3], side[BLOCK_OBSERVED];
    square(count, gradient, (const float(*)[5])measure->gradient_sum, part);
    store(rows, 0, BLOCK_ROW_P, (const float(*)[3])part);
    cross(count, gradient, (const float(*)[3])measure->field_sum, part);
    store(rows, 0, BLOCK_ROW_THETA, (const float(*)[3])part);
    square(count, gradient, gradient_moment, part);
    store(rows, 0, BLOCK_ROW_V, (const float(*)[3])part);
    cross(count, gradient, field_moment, part);
    store(rows, 0, BLOCK_ROW_W, (const float(*)[3])part);
    expand(measure->gradient_sum[last], part);
    store(rows, 0, BLOCK_ROW_A, (const float(*)[3])part);
    turn(count, field, (const float(*)[3])measure->field_sum, part);
    store(rows, 3, BLOCK_ROW_THETA, (const float(*)[3])part);
    cross(count, gradient_moment, field, part);
    for (uint32_t i = 0; i < 3u; i++) {
        for (uint32_t j = 0; j < 3u; j++) {
            rows[3u + i][BLOCK_ROW_V + j] = part[j][i];
        }
    }
    turn(count, field, field_moment, part);
    store(rows, 3, BLOCK_ROW_W, (const float(*)[3])part);
    const float from_turn[3][3] = {{0.0f, b[2], -b[1]}, {-b[2], 0.0f, b[0]}, {b[1], -b[0], 0.0f}};
    store(rows, 3, BLOCK_ROW_A, from_turn);
    expand(gradient_moment[last], part);
    store(rows, 6, BLOCK_ROW_V, (const float(*)[3])part);
    const float turning[3][3] = {{0.0f, -m[2], m[1]}, {m[2], 0.0f, -m[0]}, {-m[1], m[0], 0.0f}};
    store(rows, 6, BLOCK_ROW_W, turning);
    const float ambient[3][3] = {{weight, 0.0f, 0.0f}, {0.0f, weight, 0.0f}, {0.0f, 0.0f, weight}};
    store(rows, 6, BLOCK_ROW_A, ambient);
    const float none[3][3] = {{0.0f}};
    store(rows, 3, BLOCK_ROW_P, none);
    store(rows, 6, BLOCK_ROW_P, none);
    store(rows, 6, BLOCK_ROW_THETA, none);
    descend(block, measure, side);
    for (uint32_t i = 0; i < BLOCK_OBSERVED; i++) {
        rows[i][BLOCK_ROW_Y] = side[i];
    }
}

/* Returns the column of the diagonal in a row. */
static inline uint32_t diagonal(uint32_t row) {
    return row < 6u ? row : BLOCK_ROW_A - 6u + row;
}

/* Eliminates [L K g] to [A y] = U^-1 [L K g], of which the first part is U'. Rows that tell nothing become zero.
 * Returns how many tell something. */
static uint32_t eliminate(float rows[BLOCK_OBSERVED][BLOCK_ROW], float noise) {
    float whole[BLOCK_OBSERVED];
    uint32_t rank = 0;
    for (uint32_t j = 0; j < BLOCK_OBSERVED; j++) {
        whole[j] = rows[j][diagonal(j)];
    }
    for (uint32_t j = 0; j < BLOCK_OBSERVED; j++) {
        const float pivot = rows[j][diagonal(j)];
        const bool told = !(pivot <= LEAST_PIVOT * whole[j]); /* What is not a number stays one. */
        const float scale = told ? 1.0f / (noise * square_root(pivot)) : 0.0f;
        float own[BLOCK_ROW];
        for (uint32_t column = 0; column < BLOCK_ROW; column++) {
            own[column] = rows[j][column] = scale * rows[j][column];
        }
        for (uint32_t i = j + 1u; i < BLOCK_OBSERVED; i++) {
            const float factor = noise * noise * rows[j][diagonal(i)];
            for (uint32_t column = 0; column < BLOCK_ROW; column++) {
                rows[i][column] -= factor * own[column];
            }
            rows[i][diagonal(j)] = 0.0f;
        }
        rank += told ? 1u : 0u;
    }
    return rank;
}

void block_measure(const block_t *block, const loop_t *coils, block_measure_t *measure) {
    quaternion_matrix(measure->reference.quaternion, measure->rotation);
    model(coils, block->columns - 1u, measure);
    for (uint32_t i = 0; i < block->columns; i++) {
        sum_row(block, i, measure);
    }
    compose(block, measure);
    measure->rank = eliminate(measure->rows, measure->noise_uT);
}

#include "core/track/block_measure.h"

#include <stdbool.h>
#include <string.h>

#include "core/math/quaternion.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"

#define LEAST_PIVOT 1e-6f /* Least pivot of the information, over its own diagonal, that is not rounding. */

typedef float matrix9_t[BLOCK_OBSERVED][BLOCK_OBSERVED];

/* The sums over the columns j for one row i of the block. */
typedef struct {
    float field[3], gradient[5];            /* Of G0_ij B_j and G0_ij G_j. */
    float field_moment[3], slope_moment[5]; /* Of G1_ij B_j and G1_ij G_j. */
} row_t;

/* Sums over the rows i of J_i' times the sums of a row: the products of all with position and turn. */
typedef struct {
    float pp[3][3], pt[3][3], tp[3][3], tt[3][3];
} products_t;

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

static void sum_row(const block_t *block, const block_measure_t *measure, uint32_t i, row_t *row) {
    *row = (row_t){{0.0f}, {0.0f}, {0.0f}, {0.0f}};
    for (uint32_t j = 0; j < block->columns; j++) {
        const float weight = block->gram[i][j], moment = block->moment[i][j];
        for (uint32_t axis = 0; axis < 3u; axis++) {
            row->field[axis] += weight * measure->field_uT[j][axis];
            row->field_moment[axis] += moment * measure->field_uT[j][axis];
        }
        for (uint32_t k = 0; k < 5u; k++) {
            row->gradient[k] += weight * measure->gradient[j][k];
            row->slope_moment[k] += moment * measure->gradient[j][k];
        }
    }
}

/* Computes what the model leaves of the sums of a row, turned into the site's frame. */
static void leave(const block_measure_t *measure, const float sums[3], const row_t *row, const float offset[3],
                  float residual[3]) {
    float slope[3][3], moved[3], turned[3], measured[3];
    expand(row->slope_moment, slope);
    multiply((const float(*)[3])slope, measure->reference.velocity_m_s, moved);
    vector3_cross(measure->reference.rate_rad_s, row->field_moment, turned);
    multiply((const float(*)[3])measure->rotation, sums, measured);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        residual[axis] = measured[axis] - row->field[axis] - offset[axis] - (moved[axis] - turned[axis]);
    }
}

/* Adds J_i' times the sums of a row. */
static inline void add_products(const float field[3], const float gradient[3][3], const float field_sum[3],
                                const float five_sum[5], products_t *products) {
    float sum[3][3], crossed[3];
    expand(five_sum, sum);
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            products->pp[row][column] += vector3_dot(gradient[row], sum[column]);
            products->tt[row][column] += field_sum[row] * field[column];
        }
        vector3_cross(gradient[row], field_sum, crossed);
        for (uint32_t column = 0; column < 3u; column++) {
            products->pt[row][column] += crossed[column];
        }
        vector3_cross(sum[row], field, crossed);
        for (uint32_t column = 0; column < 3u; column++) {
            products->tp[column][row] += crossed[column];
        }
    }
}

/* Composes nine rows of six columns from the products and the sums of the ambient field's row. */
static void compose(const products_t *products, const float ambient_field[3], const float ambient_five[5],
                    float composed[BLOCK_OBSERVED][6]) {
    const float *const b = ambient_field;
    const float cross[3][3] = {{0.0f, -b[2], b[1]}, {b[2], 0.0f, -b[0]}, {-b[1], b[0], 0.0f}};
    const float trace = products->tt[0][0] + products->tt[1][1] + products->tt[2][2];
    float gradient[3][3];
    expand(ambient_five, gradient);
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            composed[row][column] = products->pp[row][column];
            composed[row][3u + column] = products->pt[row][column];
            composed[3u + row][column] = products->tp[row][column];
            composed[3u + row][3u + column] = (row == column ? trace : 0.0f) - products->tt[row][column];
            composed[6u + row][column] = gradient[row][column];
            composed[6u + row][3u + column] = cross[row][column];
        }
    }
}

/* Sums the rows of the block: information, gradient, and what the motion adds to it, all times sigma^2. */
static void sum_block(const block_t *block, const float offset[3], block_measure_t *measure) {
    const uint32_t ambient = block->columns - 1u;
    products_t still = {0}, moving = {0};
    float *const side = measure->side, residual[3], offset_sum[3], gradient[3][3], crossed[3];
    row_t row;
    memset(side, 0, sizeof measure->side);
    for (uint32_t i = 0; i <= ambient; i++) {
        const float weight = block->gram[i][ambient];
        sum_row(block, measure, i, &row);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            offset_sum[axis] = weight * offset[axis];
        }
        leave(measure, block->sums_uT[i], &row, offset_sum, residual);
        expand(measure->gradient[i], gradient);
        add_products(measure->field_uT[i], (const float(*)[3])gradient, row.field, row.gradient, &still);
        add_products(measure->field_uT[i], (const float(*)[3])gradient, row.field_moment, row.slope_moment, &moving);
        vector3_cross(residual, measure->field_uT[i], crossed);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            side[axis] += vector3_dot(gradient[axis], residual);
            side[3u + axis] += crossed[axis];
        }
        memcpy(measure->field_sum[i], row.field, sizeof row.field);
        memcpy(measure->gradient_sum[i], row.gradient, sizeof row.gradient);
        measure->ambient_sum[i] = weight;
    }
    memcpy(&side[6], residual, sizeof residual); /* That of the last row, the ambient field's. */
    float information[BLOCK_OBSERVED][6];
    compose(&still, row.field, row.gradient, information);
    compose(&moving, row.field_moment, row.slope_moment, measure->motion);
    for (uint32_t i = 0; i < BLOCK_OBSERVED; i++) {
        memcpy(measure->factor[i], information[i], sizeof information[i]);
        for (uint32_t j = 6; j < BLOCK_OBSERVED; j++) {
            measure->factor[i][j] = i == j ? measure->ambient_sum[ambient] : 0.0f;
        }
    }
}

/* Factors the information in place into U, and solves U y = side and U W = motion in place. Columns that tell nothing
 * become zero. */
static uint32_t factor(block_measure_t *measure) {
    float(*const u)[BLOCK_OBSERVED] = measure->factor;
    uint32_t rank = 0;
    for (uint32_t j = 0; j < BLOCK_OBSERVED; j++) {
        float pivot = u[j][j], *const y = &measure->side[j], *const w = measure->motion[j];
        for (uint32_t k = 0; k < j; k++) {
            pivot -= u[j][k] * u[j][k];
            *y -= u[j][k] * measure->side[k];
            for (uint32_t column = 0; column < 6u; column++) {
                w[column] -= u[j][k] * measure->motion[k][column];
            }
        }
        const bool told = pivot > LEAST_PIVOT * u[j][j];
        const float over = told ? 1.0f / square_root(pivot) : 0.0f;
        u[j][j] = over * pivot;
        *y *= over;
        for (uint32_t column = 0; column < 6u; column++) {
            w[column] *= over;
        }
        for (uint32_t i = j + 1u; i < BLOCK_OBSERVED; i++) {
            float sum = u[i][j];
            for (uint32_t k = 0; k < j; k++) {
                sum -= u[i][k] * u[j][k];
            }
            u[i][j] = over * sum;
            u[j][i] = 0.0f;
        }
        rank += told ? 1u : 0u;
    }
    return rank;
}

void block_measure(const block_t *block, const loop_t *coils, block_measure_t *measure) {
    const float weight = 1.0f / (measure->noise_uT * measure->noise_uT);
    float offset[3];
    quaternion_matrix(measure->reference.quaternion, measure->rotation);
    multiply((const float(*)[3])measure->rotation, measure->reference.offset_uT, offset);
    model(coils, block->columns - 1u, measure);
    sum_block(block, offset, measure);
    for (uint32_t row = 0; row < BLOCK_OBSERVED; row++) {
        measure->side[row] *= weight;
        for (uint32_t column = 0; column < 6u; column++) {
            measure->motion[row][column] *= weight;
        }
        for (uint32_t column = 0; column < BLOCK_OBSERVED; column++) {
            measure->factor[row][column] *= weight;
        }
    }
    measure->rank = factor(measure);
}

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

/* Computes field and gradient of each column at the place, in the site's frame. */
static void model(const loop_t *coils, uint32_t ambient, block_measure_t *measure) {
    const block_place_t *const at = &measure->place;
    for (uint32_t i = 0; i < ambient; i++) {
        block_field_t *const field = &measure->model[i];
        float gradient[3][3];
        loop_field_and_gradient(&coils[i], at->position_m, field->field_uT, gradient);
        field->gradient[0] = gradient[0][0];
        field->gradient[1] = gradient[0][1];
        field->gradient[2] = gradient[0][2];
        field->gradient[3] = gradient[1][1];
        field->gradient[4] = gradient[1][2];
    }
    measure->model[ambient] = (block_field_t){
        .field_uT = {at->ambient_uT[0], at->ambient_uT[1], at->ambient_uT[2]},
    };
}

/* Sums fields and gradients over the columns for a row of the block. */
static void sum_row(const block_t *block, uint32_t i, block_measure_t *measure) {
    const float *gram = block->gram[i], *moment = block->moment[i];
    block_field_t sum = {.gradient = {0.0f}}, moments = {.gradient = {0.0f}};
    const uint32_t ambient = block->columns - 1u; /* Its gradient is zero. */
    for (uint32_t axis = 0; axis < 3u; axis++) {
        sum.field_uT[axis] = gram[ambient] * measure->model[ambient].field_uT[axis];
        moments.field_uT[axis] = moment[ambient] * measure->model[ambient].field_uT[axis];
    }
    for (uint32_t j = 0; j < ambient; j++) {
        const block_field_t *const other = &measure->model[j];
        for (uint32_t axis = 0; axis < 3u; axis++) {
            sum.field_uT[axis] += gram[j] * other->field_uT[axis];
            moments.field_uT[axis] += moment[j] * other->field_uT[axis];
        }
        for (uint32_t k = 0; k < 5u; k++) {
            sum.gradient[k] += gram[j] * other->gradient[k];
            moments.gradient[k] += moment[j] * other->gradient[k];
        }
    }
    measure->sum[i] = sum;
    measure->moment[i] = moments;
    measure->ambient_sum[i] = gram[ambient];
}

/* Computes what the model leaves of the sums of a row, turned into the site's frame. offset is that of the sensor in
 * the site's frame. */
static inline void leave(const block_measure_t *measure, uint32_t i, const float sums_uT[3], const float offset[3],
                         float residual[3]) {
    float moved[3];
    block_field_change(&measure->moment[i], &measure->reference, moved);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float still = measure->sum[i].field_uT[axis] + measure->ambient_sum[i] * offset[axis];
        residual[axis] = vector3_dot(measure->rotation[axis], sums_uT) - still - moved[axis];
    }
}

/* Computes by how much the fields at the reference differ from those of the model, which are of another place. */
static void differ(const loop_t *coils, uint32_t ambient, const block_measure_t *measure,
                   float more_uT[BLOCK_COLUMNS][3]) {
    for (uint32_t i = 0; i <= ambient; i++) {
        if (i < ambient) {
            loop_field(&coils[i], measure->reference.position_m, more_uT[i]);
        } else {
            memcpy(more_uT[i], measure->reference.ambient_uT, sizeof more_uT[i]);
        }
        vector3_subtract(more_uT[i], measure->model[i].field_uT, more_uT[i]);
    }
}

/* Takes what differs from the model from what this leaves of a row. */
static inline void take_more(uint32_t count, const float *gram, const float more_uT[BLOCK_COLUMNS][3],
                             float residual[3]) {
    for (uint32_t j = 0; j < count; j++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            residual[axis] -= gram[j] * more_uT[j][axis];
        }
    }
}

/* Computes the gradient of the likelihood, times sigma^2, which is the right side of the rows. */
static void descend(const block_t *block, const loop_t *coils, block_measure_t *measure) {
    float offset[3], residual[3] = {0.0f}, crossed[3], by_p[3] = {0.0f}, by_theta[3] = {0.0f},
                     more_uT[BLOCK_COLUMNS][3];
    multiply((const float(*)[3])measure->rotation, measure->reference.offset_uT, offset);
    if (measure->held) {
        differ(coils, block->columns - 1u, measure, more_uT);
    }
    for (uint32_t i = 0; i < block->columns; i++) {
        float gradient[3][3];
        leave(measure, i, block->sums_uT[i], offset, residual);
        if (measure->held) {
            take_more(block->columns, block->gram[i], (const float(*)[3])more_uT, residual);
        }
        block_field_expand(measure->model[i].gradient, gradient);
        vector3_cross(residual, measure->model[i].field_uT, crossed);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            by_p[axis] += vector3_dot(gradient[axis], residual);
            by_theta[axis] += crossed[axis];
        }
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        measure->rows[axis][BLOCK_ROW_Y] = residual[axis]; /* That of the last row, the ambient field's. */
        measure->rows[3u + axis][BLOCK_ROW_Y] = by_p[axis];
        measure->rows[6u + axis][BLOCK_ROW_Y] = by_theta[axis];
    }
}

/* Sums the products of gradients with what they were summed to, into a block of rows: all, or its upper triangle, where
 * it is symmetric. With the moments it is not where a beacon was left out. */
static inline void square(uint32_t count, const block_field_t *fields, const block_field_t *sums, bool upper,
                          float *rows) {
    float total[3][3] = {{0.0f}};
    for (uint32_t i = 0; i < count; i++) {
        float left[3][3], right[3][3];
        block_field_expand(fields[i].gradient, left);
        block_field_expand(sums[i].gradient, right);
        for (uint32_t row = 0; row < 3u; row++) {
            for (uint32_t column = upper ? row : 0u; column < 3u; column++) {
                total[row][column] += vector3_dot(left[row], right[column]);
            }
        }
    }
    matrix3_store((const float(*)[3])total, rows, BLOCK_ROW);
}

/* Sums the rows of gradients, crossed with fields, into a block of rows. */
static void cross(uint32_t count, const block_field_t *gradients, const block_field_t *fields, float *rows) {
    float total[3][3] = {{0.0f}};
    for (uint32_t i = 0; i < count; i++) {
        float gradient[3][3], crossed[3];
        block_field_expand(gradients[i].gradient, gradient);
        for (uint32_t row = 0; row < 3u; row++) {
            vector3_cross(gradient[row], fields[i].field_uT, crossed);
            for (uint32_t column = 0; column < 3u; column++) {
                total[row][column] += crossed[column];
            }
        }
    }
    matrix3_store((const float(*)[3])total, rows, BLOCK_ROW);
}

/* Sums the products [B]x' [b]x = (B b) 1 - b B' of fields B with what they were summed to, b, into a block of rows. */
static void turn(uint32_t count, const block_field_t *fields, const block_field_t *sums, float *rows) {
    float total[3][3] = {{0.0f}};
    for (uint32_t i = 0; i < count; i++) {
        for (uint32_t row = 0; row < 3u; row++) {
            for (uint32_t column = 0; column < 3u; column++) {
                total[row][column] -= sums[i].field_uT[row] * fields[i].field_uT[column];
            }
        }
    }
    const float trace = total[0][0] + total[1][1] + total[2][2];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        total[axis][axis] -= trace;
    }
    matrix3_store((const float(*)[3])total, rows, BLOCK_ROW);
}

/* Stores [b]x in a block of rows. */
static inline void store_cross(const float b[3], float *rows) {
    const float block[3][3] = {{0.0f, -b[2], b[1]}, {b[2], 0.0f, -b[0]}, {-b[1], b[0], 0.0f}};
    matrix3_store(block, rows, BLOCK_ROW);
}

/* Stores a multiple of the unit matrix in a block of rows. */
static inline void store_unit(float value, float *rows) {
    const float block[3][3] = {{value, 0.0f, 0.0f}, {0.0f, value, 0.0f}, {0.0f, 0.0f, value}};
    matrix3_store(block, rows, BLOCK_ROW);
}

/* Turns a block of rows over. */
static inline void transpose(float *rows) {
    for (uint32_t i = 1; i < 3u; i++) {
        for (uint32_t j = 0; j < i; j++) {
            const float below = rows[i * BLOCK_ROW + j];
            rows[i * BLOCK_ROW + j] = rows[j * BLOCK_ROW + i];
            rows[j * BLOCK_ROW + i] = below;
        }
    }
}

/* Composes [L K], times sigma^2; of L the upper triangle of blocks. */
static void compose(uint32_t count, block_measure_t *measure) {
    const uint32_t last = count - 1u;
    const block_field_t *const fields = measure->model, *const sums = measure->sum, *const moments = measure->moment;
    float(*const rows)[BLOCK_ROW] = measure->rows, part[3][3];
    store_unit(measure->ambient_sum[last], &rows[0][BLOCK_E]);
    block_field_expand(sums[last].gradient, part);
    matrix3_store((const float(*)[3])part, &rows[0][BLOCK_P], BLOCK_ROW);
    store_cross(sums[last].field_uT, &rows[0][BLOCK_THETA]);
    block_field_expand(moments[last].gradient, part);
    matrix3_store((const float(*)[3])part, &rows[0][BLOCK_V], BLOCK_ROW);
    store_cross(moments[last].field_uT, &rows[0][BLOCK_W]);
    square(count, fields, sums, true, &rows[3][BLOCK_P]);
    cross(count, fields, sums, &rows[3][BLOCK_THETA]);
    square(count, fields, moments, false, &rows[3][BLOCK_V]);
    cross(count, fields, moments, &rows[3][BLOCK_W]);
    turn(count, fields, sums, &rows[6][BLOCK_THETA]);
    cross(count, moments, fields, &rows[6][BLOCK_V]);
    transpose(&rows[6][BLOCK_V]);
    turn(count, fields, moments, &rows[6][BLOCK_W]);
}

/* Takes a row times a factor from another, in the columns from first to that of the ambient field and on the right
 * side. */
static inline void subtract_row(float *row, float factor, const float *other, uint32_t first) {
    for (uint32_t column = first; column < BLOCK_E; column++) {
        row[column] -= factor * other[column];
    }
    row[BLOCK_ROW_Y] -= factor * other[BLOCK_ROW_Y];
}

/* Eliminates [L K g] to [A y] = U^-1 [L K g], of which the first part is U', for the ambient field, of which L is a
 * multiple of the unit matrix, and sets the columns of the sensor's offset, which adds to it in the sensor's frame.
 * Returns how many rows tell something. */
static uint32_t eliminate_ambient(float rows[BLOCK_OBSERVED][BLOCK_ROW], const float rotation[3][3], float noise) {
    const float pivot = rows[0][BLOCK_E];
    const bool told = !(pivot <= 0.0f); /* What is not a number stays one. */
    const float scale = told ? 1.0f / (noise * square_root(pivot)) : 0.0f;
    for (uint32_t j = 0; j < 3u; j++) {
        float own[BLOCK_ROW];
        for (uint32_t column = BLOCK_P; column < BLOCK_E; column++) {
            own[column] = rows[j][column] *= scale;
        }
        own[BLOCK_ROW_Y] = rows[j][BLOCK_ROW_Y] *= scale;
        rows[j][BLOCK_E + j] = scale * pivot;
        for (uint32_t axis = 0; axis < 3u; axis++) {
            rows[j][BLOCK_B + axis] = scale * pivot * rotation[j][axis];
        }
        for (uint32_t i = 3; i < BLOCK_OBSERVED; i++) {
            const uint32_t first = i < 6u ? BLOCK_P : BLOCK_THETA; /* One of the turn has no column of the position. */
            subtract_row(rows[i], noise * noise * own[block_measure_diagonal(i)], own, first);
        }
    }
    return told ? 3u : 0u;
}

/* Does the same for three rows from j on of position or turn, whose columns begin with first. Rows that tell nothing
 * become zero. */
static inline uint32_t eliminate(float rows[BLOCK_OBSERVED][BLOCK_ROW], const float whole[BLOCK_OBSERVED], float noise,
                                 uint32_t j, uint32_t first) {
    const uint32_t group = j + 3u;
    uint32_t rank = 0;
    for (; j < group; j++) {
        const float pivot = rows[j][block_measure_diagonal(j)];
        const bool told = !(pivot <= LEAST_PIVOT * whole[j]); /* What is not a number stays one. */
        const float scale = told ? 1.0f / (noise * square_root(pivot)) : 0.0f;
        float own[BLOCK_ROW] = {0}; /* Columns before first are not used. */
        for (uint32_t column = first; column < BLOCK_E; column++) {
            own[column] = rows[j][column] *= scale;
        }
        own[BLOCK_ROW_Y] = rows[j][BLOCK_ROW_Y] *= scale;
        for (uint32_t i = j + 1u; i < BLOCK_OBSERVED; i++) {
            const float factor = noise * noise * own[block_measure_diagonal(i)];
            subtract_row(rows[i], factor, own, i < group ? first : BLOCK_THETA);
            rows[i][block_measure_diagonal(j)] = 0.0f;
        }
        rank += told ? 1u : 0u;
    }
    return rank;
}

void block_measure(const block_t *block, const loop_t *coils, block_measure_t *measure) {
    quaternion_matrix(measure->reference.quaternion, measure->rotation);
    if (!measure->held) {
        memcpy(measure->place.position_m, measure->reference.position_m, sizeof measure->place.position_m);
        memcpy(measure->place.ambient_uT, measure->reference.ambient_uT, sizeof measure->place.ambient_uT);
    }
    if (!measure->held || !measure->known) {
        model(coils, block->columns - 1u, measure);
    }
    for (uint32_t i = 0; i < block->columns; i++) {
        sum_row(block, i, measure);
    }
    compose(block->columns, measure);
    descend(block, coils, measure);
    float whole[BLOCK_OBSERVED];
    for (uint32_t i = 0; i < BLOCK_OBSERVED; i++) {
        whole[i] = measure->rows[i][block_measure_diagonal(i)];
    }
    measure->rank = eliminate_ambient(measure->rows, (const float(*)[3])measure->rotation, measure->noise_uT);
    measure->rank += eliminate(measure->rows, whole, measure->noise_uT, 3, BLOCK_P);
    measure->rank += eliminate(measure->rows, whole, measure->noise_uT, 6, BLOCK_THETA);
}

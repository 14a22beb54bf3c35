#include "core/track/block_sweep.h"

#include <stdbool.h>

#include "core/math/roots.h"
#include "core/math/vector3.h"

/* Least pivot, over its own diagonal: few columns do not tell the sweep from their fields. */
#define LEAST_PIVOT 1e-2f
#define LEAST_REST  1e-8f /* Square of what the ramp may leave, over what it should be. */
#define RAMP_STEPS  12u
#define UNEVEN      5.0f /* How fast the ambient field may change within a block by itself, uT/s: near iron. */

/* What the shares of the ramp make of a block. */
typedef struct {
    block_field_t sum, moment; /* The sums of block_measure_t, ... */
    float ambient;             /* ... those of the last column of the gram matrix, ... */
    float sums_uT[3];          /* ... and those of the block. */
    float square;              /* The sum of the squares of the ramp over the samples, s^2. */
} ramp_t;

static float product(const float *left, const float *right, uint32_t count) {
    float sum = 0.0f;
    for (uint32_t i = 0; i < count; i++) {
        sum += left[i] * right[i];
    }
    return sum;
}

/* Computes the shares f of the ramp, G0 f = the last column of G1, by conjugate gradients. */
static void solve_ramp(const block_t *block, float shares[BLOCK_COLUMNS]) {
    const uint32_t count = block->columns;
    float rest[BLOCK_COLUMNS], along[BLOCK_COLUMNS], changed[BLOCK_COLUMNS];
    for (uint32_t i = 0; i < count; i++) {
        rest[i] = along[i] = block->moment[i][count - 1u];
        shares[i] = 0.0f;
    }
    float square = product(rest, rest, count);
    const float least = LEAST_REST * square;
    for (uint32_t step = 0; step < RAMP_STEPS && square > least; step++) {
        for (uint32_t i = 0; i < count; i++) {
            changed[i] = product(block->gram[i], along, count);
        }
        const float length = square / product(along, changed, count), before = square;
        for (uint32_t i = 0; i < count; i++) {
            shares[i] += length * along[i];
            rest[i] -= length * changed[i];
        }
        square = product(rest, rest, count);
        for (uint32_t i = 0; i < count; i++) {
            along[i] = rest[i] + square / before * along[i];
        }
    }
}

/* Adds a field, times a weight. */
static void add_field(block_field_t *sum, float weight, const block_field_t *field) {
    for (uint32_t axis = 0; axis < 3u; axis++) {
        sum->field_uT[axis] += weight * field->field_uT[axis];
    }
    for (uint32_t k = 0; k < 5u; k++) {
        sum->gradient[k] += weight * field->gradient[k];
    }
}

/* Sums what the block has with the shares of the ramp. */
static void weigh(const block_t *block, const block_measure_t *measure, ramp_t *ramp) {
    float shares[BLOCK_COLUMNS];
    solve_ramp(block, shares);
    *ramp = (ramp_t){.ambient = 0.0f};
    for (uint32_t i = 0; i < block->columns; i++) {
        add_field(&ramp->sum, shares[i], &measure->sum[i]);
        add_field(&ramp->moment, shares[i], &measure->moment[i]);
        ramp->ambient += shares[i] * measure->ambient_sum[i];
        ramp->square += shares[i] * product(block->gram[i], shares, block->columns);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            ramp->sums_uT[axis] += shares[i] * block->sums_uT[i][axis];
        }
    }
}

/* Computes what one component of the sweep has in common with position and turn: J' of summed fields. */
static void couple(const block_field_t *field, uint32_t axis, float by[6]) {
    const float unit[3] = {axis == 0u ? 1.0f : 0.0f, axis == 1u ? 1.0f : 0.0f, axis == 2u ? 1.0f : 0.0f};
    float gradient[3][3];
    block_field_expand(field->gradient, gradient);
    for (uint32_t k = 0; k < 3u; k++) {
        by[k] = gradient[axis][k];
    }
    vector3_cross(unit, field->field_uT, &by[3]);
}

/* Computes the part y = U^-1 c of a component of the sweep that the observed numbers tell already; L = U U' is their
 * information, and the rows have U' in them. */
static void known_part(const block_measure_t *measure, const ramp_t *ramp, uint32_t axis, float weight,
                       float y[BLOCK_OBSERVED]) {
    float c[BLOCK_OBSERVED] = {0.0f};
    c[axis] = ramp->ambient;
    couple(&ramp->sum, axis, &c[3]);
    for (uint32_t i = 0; i < BLOCK_OBSERVED; i++) {
        const float pivot = measure->rows[i][block_measure_diagonal(i)];
        float left = weight * c[i];
        for (uint32_t k = 0; k < i; k++) {
            left -= measure->rows[k][block_measure_diagonal(i)] * y[k];
        }
        y[i] = pivot > 0.0f ? left / pivot : 0.0f;
    }
}

/* Computes what the model leaves of the sums, turned into the site's frame. */
static void leave(const block_measure_t *measure, const ramp_t *ramp, float residual[3]) {
    float moved[3];
    block_field_change(&ramp->moment, &measure->reference, moved);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float offset = vector3_dot(measure->rotation[axis], measure->reference.offset_uT);
        const float still = ramp->sum.field_uT[axis] + ramp->ambient * offset;
        residual[axis] = vector3_dot(measure->rotation[axis], ramp->sums_uT) - still - moved[axis];
    }
}

/* Composes the columns of velocity and turn rate and the right side, less what the observed numbers tell already, and
 * the upper triangle of the information on the sweep that is left. */
static void compose(const block_measure_t *measure, const ramp_t *ramp, float weight, block_sweep_t *sweep,
                    float information[3][3]) {
    float residual[3], known[3][BLOCK_OBSERVED];
    leave(measure, ramp, residual);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        float *const row = sweep->rows[axis];
        float by[6];
        couple(&ramp->moment, axis, by);
        known_part(measure, ramp, axis, weight, known[axis]);
        for (uint32_t k = 0; k < 6u; k++) {
            row[BLOCK_V + k] = weight * by[k];
        }
        row[BLOCK_ROW_Y] = weight * residual[axis];
        for (uint32_t i = 0; i < BLOCK_OBSERVED; i++) {
            for (uint32_t column = BLOCK_V; column < BLOCK_E; column++) {
                row[column] -= known[axis][i] * measure->rows[i][column];
            }
            row[BLOCK_ROW_Y] -= known[axis][i] * measure->rows[i][BLOCK_ROW_Y];
        }
        for (uint32_t other = 0; other <= axis; other++) {
            const float whole = other == axis ? weight * ramp->square : 0.0f;
            information[other][axis] = whole - product(known[other], known[axis], BLOCK_OBSERVED);
        }
    }
}

/* Factors the information to U U' in place, U' above, and multiplies the rows by U^-1. Rows that tell nothing become
 * zero.
 * Returns how many tell something. */
static uint32_t eliminate(float information[3][3], float least, block_sweep_t *sweep) {
    uint32_t rank = 0;
    for (uint32_t j = 0; j < 3u; j++) {
        const float pivot = information[j][j];
        const bool told = !(pivot <= least); /* What is not a number stays one. */
        const float scale = told ? 1.0f / square_root(pivot) : 0.0f;
        for (uint32_t column = BLOCK_V; column < BLOCK_ROW; column++) {
            sweep->rows[j][column] *= scale;
        }
        for (uint32_t i = j; i < 3u; i++) {
            information[j][i] *= scale;
        }
        for (uint32_t i = j + 1u; i < 3u; i++) {
            for (uint32_t column = BLOCK_V; column < BLOCK_ROW; column++) {
                sweep->rows[i][column] -= information[j][i] * sweep->rows[j][column];
            }
            for (uint32_t k = i; k < 3u; k++) {
                information[i][k] -= information[j][i] * information[j][k];
            }
        }
        rank += told ? 1u : 0u;
    }
    return rank;
}

/* Sets the columns of turn and ambient field: the sweep s = e x w turns with the sensor and changes with the field. The
 * turn rate is done. All is known no better than the ambient field's own changes let it be. */
static void fold(const block_state_t *at, const float root[3][3], float even, block_sweep_t *sweep) {
    float swept[3];
    vector3_cross(at->ambient_uT, at->rate_rad_s, swept);
    for (uint32_t i = 0; i < BLOCK_SWEEPS; i++) {
        float *const row = sweep->rows[i];
        vector3_cross(root[i], swept, &row[BLOCK_THETA]);
        vector3_cross(at->rate_rad_s, root[i], &row[BLOCK_E]);
        for (uint32_t column = BLOCK_THETA; column < BLOCK_ROW; column++) {
            row[column] *= even;
        }
    }
}

uint32_t block_sweep(const block_t *block, const block_measure_t *measure, block_sweep_t *sweep) {
    const float weight = 1.0f / (measure->noise_uT * measure->noise_uT);
    ramp_t ramp;
    float information[3][3] = {{0.0f}}; /* It stays zero below the diagonal. */
    *sweep = (block_sweep_t){.rows = {{0.0f}}};
    weigh(block, measure, &ramp);
    compose(measure, &ramp, weight, sweep, information);
    const float whole = weight * ramp.square;
    const uint32_t rank = eliminate(information, LEAST_PIVOT * whole, sweep);
    fold(&measure->reference, (const float(*)[3])information, 1.0f / square_root(1.0f + UNEVEN * UNEVEN * whole),
         sweep);
    return rank;
}

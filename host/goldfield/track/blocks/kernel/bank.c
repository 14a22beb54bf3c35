#include "bank.h"

#include <math.h>

#include "core/track/block_filter.h"

#define MICROTESLA     1e6 /* Microtesla in a tesla. */
#define UT_M3_PER_A_M2 0.1 /* mu0 / (4 pi) in uT m^3 for each A m^2. */
#define STATE          19u /* Numbers of a state. */

typedef struct {
    loop_t coils[BLOCK_BEACONS];
    block_filter_t filter;
    block_t block;
} bank_t;

/* Returns in how many of its own units the kernel has one SI unit of an error. */
static double unit(uint32_t error) {
    return error >= BLOCK_E ? MICROTESLA : 1.0;
}

size_t gf_bank_size(void) {
    return sizeof(bank_t);
}

void gf_bank_init(void *memory, uint32_t count, const double *coils) {
    bank_t *const bank = memory;
    for (uint32_t i = 0; i < count; i++) {
        const double *const coil = &coils[(size_t)8 * i];
        for (uint32_t axis = 0; axis < 3u; axis++) {
            bank->coils[i].centre_m[axis] = (float)coil[axis];
            bank->coils[i].axis[axis] = (float)coil[3u + axis];
        }
        bank->coils[i].k_uT_m3 = (float)(UT_M3_PER_A_M2 * coil[6]);
        bank->coils[i].radius_m = (float)coil[7];
    }
    block_filter_init(&bank->filter, bank->coils, count, 1.0f);
}

/* Returns the places of a state's numbers in the structure, in their order; those from the 13th on are fields. */
static float *number(block_state_t *state, uint32_t place) {
    return place < 3u    ? &state->position_m[place]
           : place < 7u  ? &state->quaternion[place - 3u]
           : place < 10u ? &state->velocity_m_s[place - 7u]
           : place < 13u ? &state->rate_rad_s[place - 10u]
           : place < 16u ? &state->ambient_uT[place - 13u]
                         : &state->offset_uT[place - 16u];
}

void gf_bank_start(void *memory, const double *state, const double *covariance) {
    bank_t *const bank = memory;
    block_state_t start;
    float own[BLOCK_STATES][BLOCK_STATES];
    for (uint32_t i = 0; i < STATE; i++) {
        *number(&start, i) = (float)(state[i] * (i < 13u ? 1.0 : MICROTESLA));
    }
    for (uint32_t row = 0; row < BLOCK_STATES; row++) {
        for (uint32_t column = 0; column < BLOCK_STATES; column++) {
            own[row][column] = (float)(covariance[(size_t)row * BLOCK_STATES + column] * unit(row) * unit(column));
        }
    }
    block_filter_begin(&bank->filter, &start, (const float(*)[BLOCK_STATES])own);
}

bool gf_bank_update(void *memory, const double *gram, const double *moment, const double *sums_T, double noise_T,
                    double seconds, double *log_likelihood) {
    bank_t *const bank = memory;
    const uint32_t columns = bank->filter.count + 1u;
    bank->filter.measure.noise_uT = (float)(MICROTESLA * noise_T);
    bank->block.columns = columns;
    for (uint32_t row = 0; row < columns; row++) {
        for (uint32_t column = 0; column < columns; column++) {
            bank->block.gram[row][column] = (float)gram[(size_t)row * columns + column];
            bank->block.moment[row][column] = (float)moment[(size_t)row * columns + column];
        }
        for (uint32_t axis = 0; axis < 3u; axis++) {
            bank->block.sums_uT[row][axis] = (float)(MICROTESLA * sums_T[(size_t)3 * row + axis]);
        }
    }
    const bool taken = block_filter_update_swept(&bank->filter, &bank->block, (float)seconds);
    *log_likelihood = (double)bank->filter.log_likelihood;
    return taken;
}

void gf_bank_predict(void *memory, double seconds) {
    bank_t *const bank = memory;
    block_filter_predict(&bank->filter, (float)seconds);
}

/* Writes the rotation matrix of a quaternion in single precision, whose length is nearly 1. */
static void matrix_of(const float quaternion[4], double rotation[9]) {
    const double x = (double)quaternion[0], y = (double)quaternion[1], z = (double)quaternion[2];
    const double w = (double)quaternion[3];
    const double twice = 2.0 / (x * x + y * y + z * z + w * w);
    rotation[0] = 1.0 - twice * (y * y + z * z);
    rotation[1] = twice * (x * y - z * w);
    rotation[2] = twice * (x * z + y * w);
    rotation[3] = twice * (x * y + z * w);
    rotation[4] = 1.0 - twice * (x * x + z * z);
    rotation[5] = twice * (y * z - x * w);
    rotation[6] = twice * (x * z - y * w);
    rotation[7] = twice * (y * z + x * w);
    rotation[8] = 1.0 - twice * (x * x + y * y);
}

void gf_bank_output(const void *memory, double seconds, double *state, double *rotation, double *covariance,
                    double agility[2]) {
    const bank_t *const bank = memory;
    block_kalman_t whole;
    block_mix_whole(bank->filter.filters, bank->filter.best, &whole);
    agility[0] = sqrt((double)whole.acceleration2);
    agility[1] = sqrt((double)whole.turn2);
    block_kalman_predict(&whole, (float)seconds);
    for (uint32_t i = 0; i < STATE; i++) {
        state[i] = (double)*number(&whole.state, i) / (i < 13u ? 1.0 : MICROTESLA);
    }
    matrix_of(whole.state.quaternion, rotation);
    for (uint32_t row = 0; row < BLOCK_STATES; row++) {
        for (uint32_t column = 0; column < BLOCK_STATES; column++) {
            const uint32_t low = row > column ? row : column, high = row > column ? column : row;
            const double kept = (double)whole.covariance[low][high]; /* That above the diagonal is not kept up. */
            covariance[(size_t)row * BLOCK_STATES + column] = kept / (unit(row) * unit(column));
        }
    }
}

#include "core/track/block_residual.h"

#include "core/math/quaternion.h"
#include "core/math/vector3.h"

#define GRADIENT 4.0f /* Largest norm of a dipole's gradient, squared 18, over field and distance. */

/* Computes what the samples are of. */
static void model(const loop_t *coils, uint32_t count, const block_state_t *state, const float attitude[3][3],
                  float field_uT[BLOCK_COLUMNS][3]) {
    for (uint32_t i = 0; i < count; i++) {
        loop_field(&coils[i], state->position_m, field_uT[i]);
    }
    for (uint32_t row = 0; row < 3u; row++) {
        field_uT[count][row] = state->ambient_uT[row] + vector3_dot(attitude[row], state->offset_uT);
    }
}

void block_residual(const block_t *block, const loop_t *coils, uint32_t count, const block_state_t *state,
                    block_residual_t *residual) {
    float attitude[3][3];
    quaternion_matrix(state->quaternion, attitude);
    model(coils, count, state, attitude, residual->field_uT);
    for (uint32_t i = 0; i <= count; i++) {
        float x = 0.0f, y = 0.0f, z = 0.0f;
        for (uint32_t j = 0; j <= count; j++) {
            const float product = block->gram[i][j];
            x += product * residual->field_uT[j][0];
            y += product * residual->field_uT[j][1];
            z += product * residual->field_uT[j][2];
        }
        residual->left_uT[i][0] = vector3_dot(attitude[0], block->sums_uT[i]) - x;
        residual->left_uT[i][1] = vector3_dot(attitude[1], block->sums_uT[i]) - y;
        residual->left_uT[i][2] = vector3_dot(attitude[2], block->sums_uT[i]) - z;
    }
}

/* Returns the variance of a modelled field, summed over three axes, uT^2. */
static float field_variance(const float field_uT[3], const loop_t *coil, const block_beacon_errors_t *beacon,
                            const block_site_errors_t *errors, const block_state_t *state, const block_doubt_t *doubt) {
    float away[3];
    vector3_subtract(state->position_m, coil->centre_m, away);
    const float distance2 = vector3_dot(away, away) + coil->radius_m * coil->radius_m;
    const float position2 = doubt->position_m2 + 3.0f * beacon->position_sd_m * beacon->position_sd_m;
    const float relative2 = doubt->attitude_rad2 + beacon->current_sd * beacon->current_sd +
                            2.0f * beacon->axis_sd_rad * beacon->axis_sd_rad + errors->gain_sd * errors->gain_sd +
                            2.0f * errors->axis_sd_rad * errors->axis_sd_rad;
    return vector3_dot(field_uT, field_uT) * (relative2 + GRADIENT * GRADIENT * position2 / distance2);
}

uint32_t block_residual_worst(const block_residual_t *residual, const block_t *block, const loop_t *coils,
                              uint32_t count, const block_state_t *state, const block_doubt_t *doubt,
                              const block_site_errors_t *errors, float noise_uT, uint32_t out) {
    float variance[BLOCK_COLUMNS], most = BLOCK_RESIDUAL_MOST;
    uint32_t worst = count;
    for (uint32_t i = 0; i < count; i++) {
        variance[i] = field_variance(residual->field_uT[i], &coils[i], &errors->beacons[i], errors, state, doubt);
    }
    variance[count] = doubt->ambient_uT2;
    for (uint32_t i = 0; i < count; i++) {
        if ((out >> i & 1u) != 0u) {
            continue;
        }
        float expected = 3.0f * noise_uT * noise_uT * block->gram[i][i];
        for (uint32_t j = 0; j <= count; j++) {
            expected += block->gram[i][j] * block->gram[i][j] * variance[j];
        }
        const float square = vector3_dot(residual->left_uT[i], residual->left_uT[i]);
        if (!(square <= most * expected)) { /* So is what is not a number. */
            most = square / expected;
            worst = i;
        }
    }
    return worst;
}

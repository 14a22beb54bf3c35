#include "core/track/block_state.h"

#include <stdint.h>

#include "core/math/quaternion.h"
#include "core/math/vector3.h"

void block_state_move(const block_state_t *from, const float errors[BLOCK_STATES], block_state_t *state) {
    float turn[4];
    quaternion_exp(&errors[BLOCK_THETA], turn);
    quaternion_multiply(turn, from->quaternion, state->quaternion);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        state->position_m[axis] = from->position_m[axis] + errors[BLOCK_P + axis];
        state->velocity_m_s[axis] = from->velocity_m_s[axis] + errors[BLOCK_V + axis];
        state->rate_rad_s[axis] = from->rate_rad_s[axis] + errors[BLOCK_W + axis];
        state->ambient_uT[axis] = from->ambient_uT[axis] + errors[BLOCK_E + axis];
        state->offset_uT[axis] = from->offset_uT[axis] + errors[BLOCK_B + axis];
    }
}

void block_state_subtract(const block_state_t *state, const block_state_t *other, float errors[BLOCK_STATES]) {
    const float back[4] = {-other->quaternion[0], -other->quaternion[1], -other->quaternion[2], other->quaternion[3]};
    float turn[4];
    quaternion_multiply(state->quaternion, back, turn);
    /* The angle over its sine, of half of the turn, by the series of the arc sine. */
    const float x = vector3_dot(turn, turn);
    const float series = 1.0f + x * (1.0f / 6 + x * (3.0f / 40 + x * (15.0f / 336 + x * (105.0f / 3456))));
    const float scale = turn[3] < 0.0f ? -2.0f * series : 2.0f * series;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        errors[BLOCK_P + axis] = state->position_m[axis] - other->position_m[axis];
        errors[BLOCK_THETA + axis] = scale * turn[axis];
        errors[BLOCK_V + axis] = state->velocity_m_s[axis] - other->velocity_m_s[axis];
        errors[BLOCK_W + axis] = state->rate_rad_s[axis] - other->rate_rad_s[axis];
        errors[BLOCK_E + axis] = state->ambient_uT[axis] - other->ambient_uT[axis];
        errors[BLOCK_B + axis] = state->offset_uT[axis] - other->offset_uT[axis];
    }
}

void block_state_advance(block_state_t *state, float seconds, float turn[3][3]) {
    float turned[3], step[4];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        state->position_m[axis] += seconds * state->velocity_m_s[axis];
        turned[axis] = seconds * state->rate_rad_s[axis];
    }
    quaternion_exp(turned, step);
    quaternion_multiply(step, state->quaternion, state->quaternion);
    quaternion_matrix(step, turn);
}

#include "core/track/block_cycle.h"

#include <string.h>

#include "core/math/quaternion.h"

/* Forgets what is summed. */
static void forget(block_cycle_t *cycle) {
    cycle->blocks = 0;
    memset(cycle->residual_uT, 0, sizeof cycle->residual_uT);
}

void block_cycle_clear(block_cycle_t *cycle, const loop_t *coils, const block_select_t *select) {
    cycle->coils = coils;
    cycle->count = select->count;
    memcpy(cycle->rows, select->rows, sizeof cycle->rows);
    forget(cycle);
}

/* Keeps the pose so many seconds after the prediction. */
static void keep_middle(block_cycle_t *cycle, const block_state_t *state, float seconds) {
    float turn[3];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        cycle->position_m[axis] = state->position_m[axis] + seconds * state->velocity_m_s[axis];
        turn[axis] = seconds * state->rate_rad_s[axis];
    }
    memcpy(cycle->quaternion, state->quaternion, sizeof cycle->quaternion);
    quaternion_turn(cycle->quaternion, turn);
}

bool block_cycle_add(block_cycle_t *cycle, uint32_t number, uint32_t chip, float chip_s,
                     const block_residual_t *residual, const block_state_t *predicted) {
    if (block_cycle_begins(chip)) {
        forget(cycle);
    } else if (number != cycle->next) {
        return false; /* So are those that follow, until a cycle begins. */
    }
    cycle->next = number + 1u;
    for (uint32_t i = 0; i <= cycle->count; i++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            cycle->residual_uT[i][axis] += residual->left_uT[i][axis];
        }
    }
    if (cycle->blocks == BLOCK_CYCLE_BLOCKS / 2u) {
        const int32_t chips = (int32_t)(BLOCK_CYCLE_CHIPS / 2u) - (int32_t)(chip + BLOCK_CYCLE_LENGTH / 2u);
        keep_middle(cycle, predicted, (float)chips * chip_s);
    }
    cycle->blocks++;
    return cycle->blocks == BLOCK_CYCLE_BLOCKS;
}

void block_cycle_field(const block_cycle_t *cycle, uint32_t column, float field_uT[3]) {
    float attitude[3][3], field[3];
    quaternion_matrix(cycle->quaternion, attitude);
    loop_field(&cycle->coils[cycle->rows[column]], cycle->position_m, field);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        field[axis] += field_uT[axis];
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        field_uT[axis] = attitude[0][axis] * field[0] + attitude[1][axis] * field[1] + attitude[2][axis] * field[2];
    }
}

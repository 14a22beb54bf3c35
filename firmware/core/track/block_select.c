#include "core/track/block_select.h"

#include <stdbool.h>

#include "core/math/quaternion.h"
#include "core/math/vector3.h"

#define STAYS 1.44f /* Square of how much stronger another must be for one of the strongest to go: a fifth. */

static uint32_t ones(uint32_t x) {
    x -= x >> 1 & 0x55555555u;
    x = (x & 0x33333333u) + (x >> 2 & 0x33333333u);
    return ((x + (x >> 4)) & 0x0F0F0F0Fu) * 0x01010101u >> 24;
}

/* Returns the most beacons of those that are offered, a bit each, by the squares of their fields. */
static uint32_t strongest(const float square[BLOCK_BEACONS], uint32_t count, uint32_t offered, uint32_t most) {
    uint32_t chosen = 0;
    for (uint32_t k = 0; k < most && chosen != offered; k++) {
        uint32_t best = count;
        for (uint32_t i = 0; i < count; i++) {
            const bool free = ((offered & ~chosen) >> i & 1u) != 0u;
            best = free && (best == count || square[i] > square[best]) ? i : best;
        }
        chosen |= 1u << best;
    }
    return chosen;
}

/* Chooses the next guests of those that are offered, unless the present ones have not had their time or are held. */
static void choose_guests(block_select_t *select, uint32_t count, uint32_t offered, bool hold) {
    const bool present = select->guests != 0u && (select->guests & ~offered) == 0u;
    if (present && (hold || select->cycles < BLOCK_GUEST_CYCLES)) {
        select->cycles++;
        return;
    }
    uint32_t left = BLOCK_GUESTS;
    const uint32_t from = select->next;
    select->guests = 0;
    select->cycles = 1;
    for (uint32_t k = 0; k < count && left > 0u; k++) {
        const uint32_t row = (from + k) % count;
        if ((offered >> row & 1u) != 0u) {
            select->guests |= 1u << row;
            select->next = row + 1u;
            left--;
        }
    }
}

void block_select(block_select_t *select, const loop_t *coils, uint32_t count, const float position_m[3], uint32_t out,
                  bool hold) {
    const uint32_t all = count < 32u ? (1u << count) - 1u : UINT32_MAX, believed = all & ~out;
    uint32_t chosen = all;
    if (ones(believed) > BLOCK_SELECTED) {
        float square[BLOCK_BEACONS] = {0.0f};
        for (uint32_t i = 0; i < count; i++) {
            float field[3];
            loop_field(&coils[i], position_m, field);
            square[i] = vector3_dot(field, field) * ((select->strong >> i & 1u) != 0u ? STAYS : 1.0f);
        }
        select->strong = strongest(square, count, believed, BLOCK_SELECTED - BLOCK_GUESTS);
        choose_guests(select, count, believed & ~select->strong, hold);
        chosen = select->strong | select->guests | (all & out);
    }
    select->count = 0;
    for (uint32_t i = 0; i < count; i++) {
        if ((chosen >> i & 1u) != 0u) {
            select->rows[select->count++] = (uint8_t)i;
        }
    }
}

void block_select_reduce(const block_select_t *select, const loop_t *coils, uint32_t count, const uint32_t *bits,
                         uint32_t chips, const block_state_t *state, block_t *block) {
    const uint32_t in_block = UINT32_MAX >> (BLOCK_CHIPS_MAX - chips);
    float attitude[3][3];
    quaternion_matrix(state->quaternion, attitude);
    for (uint32_t row = 0, column = 0; row < count; row++) {
        if (column < select->count && select->rows[column] == row) {
            column++;
            continue;
        }
        float field[3], seen[3];
        loop_field(&coils[row], state->position_m, field);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            seen[axis] = attitude[0][axis] * field[0] + attitude[1][axis] * field[1] + attitude[2][axis] * field[2];
        }
        for (uint32_t i = 0; i <= select->count; i++) {
            const uint32_t other = i < select->count ? bits[select->rows[i]] : 0u;
            const float gram = (float)((int32_t)chips - 2 * (int32_t)ones((bits[row] ^ other) & in_block));
            for (uint32_t axis = 0; axis < 3u; axis++) {
                block->sums_uT[i][axis] -= gram * seen[axis];
            }
        }
    }
}

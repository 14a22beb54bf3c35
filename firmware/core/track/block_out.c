#include "core/track/block_out.h"

#define INDEPENDENT 1e-4f /* Least share of a column that the columns before it may leave unexplained. */

/* Takes a multiple of one row of sums from another. */
static inline void subtract_sums(block_t *block, uint32_t row, float factor, uint32_t other) {
    for (uint32_t axis = 0; axis < 3u; axis++) {
        block->sums_uT[row][axis] -= factor * block->sums_uT[other][axis];
    }
}

void block_leave_out(block_t *block, uint32_t column) {
    const float pivot = block->gram[column][column];
    for (uint32_t row = 0; row < block->columns && pivot > 0.0f; row++) {
        const float factor = row == column ? 0.0f : block->gram[row][column] / pivot;
        for (uint32_t j = 0; j < block->columns; j++) {
            block->gram[row][j] -= factor * block->gram[column][j];
            block->moment[row][j] -= factor * block->moment[column][j];
        }
        subtract_sums(block, row, factor, column);
    }
    for (uint32_t i = 0; i < block->columns; i++) {
        block->gram[i][column] = block->gram[column][i] = 0.0f;
        block->moment[i][column] = block->moment[column][i] = 0.0f;
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        block->sums_uT[column][axis] = 0.0f;
    }
}

/* Eliminates a column from all rows but its own (Gauss and Jordan), in place. */
static void eliminate(block_t *block, uint32_t k) {
    const float over = 1.0f / block->gram[k][k];
    block->gram[k][k] = 1.0f;
    for (uint32_t j = 0; j < block->columns; j++) {
        block->gram[k][j] *= over;
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        block->sums_uT[k][axis] *= over;
    }
    for (uint32_t row = 0; row < block->columns; row++) {
        if (row == k) {
            continue;
        }
        const float factor = block->gram[row][k];
        block->gram[row][k] = 0.0f;
        for (uint32_t j = 0; j < block->columns; j++) {
            block->gram[row][j] -= factor * block->gram[k][j];
        }
        subtract_sums(block, row, factor, k);
    }
}

bool block_separate(block_t *block) {
    float whole[BLOCK_COLUMNS] = {0.0f};
    for (uint32_t k = 0; k < block->columns; k++) {
        whole[k] = block->gram[k][k];
    }
    for (uint32_t k = 0; k < block->columns; k++) {
        if (whole[k] > 0.0f) {
            if (!(block->gram[k][k] > INDEPENDENT * whole[k])) {
                return false;
            }
            eliminate(block, k);
        }
    }
    return true;
}

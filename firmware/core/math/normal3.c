#include "core/math/normal3.h"

#include <string.h>

/* Eliminates by Gauss and Jordan on matrix | right, with so many columns of right; right becomes the solution. */
static void eliminate(float matrix[3][3], float right[3][3], uint32_t columns) {
    for (uint32_t i = 0; i < 3u; i++) {
        const float pivot = matrix[i][i] > 1e-20f ? 1.0f / matrix[i][i] : 1e20f;
        for (uint32_t row = 0; row < 3u; row++) {
            const float factor = matrix[row][i] * pivot;
            if (row == i) {
                continue;
            }
            for (uint32_t column = 0; column < 3u; column++) {
                matrix[row][column] -= factor * matrix[i][column];
            }
            for (uint32_t column = 0; column < columns; column++) {
                right[row][column] -= factor * right[i][column];
            }
        }
    }
    for (uint32_t i = 0; i < 3u; i++) {
        for (uint32_t column = 0; column < columns; column++) {
            right[i][column] = matrix[i][i] > 1e-20f ? right[i][column] / matrix[i][i] : right[i][column] * 1e20f;
        }
    }
}

void normal3_invert(const float matrix[3][3], float inverse[3][3]) {
    float left[3][3];
    memcpy(left, matrix, sizeof left);
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            inverse[row][column] = row == column ? 1.0f : 0.0f;
        }
    }
    eliminate(left, inverse, 3);
}

void normal3_solve(const normal3_t *normal, float x[3]) {
    float left[3][3], right[3][3];
    memcpy(left, normal->matrix, sizeof left);
    for (uint32_t row = 0; row < 3u; row++) {
        right[row][0] = normal->side[row];
    }
    eliminate(left, right, 1);
    for (uint32_t row = 0; row < 3u; row++) {
        x[row] = right[row][0];
    }
}

/* block_matrix.h: products of blocks of three rows and three columns within larger matrices, of which this folder's
 * calculations consist. A block is given by its first element and the length of a row of its matrix.
 *
 * They are inline, and every loop has a constant length: unrolled, sums stay in registers, and a product takes two
 * loads for each three multiplications.
 */
#ifndef GOLDFIELD_BLOCK_MATRIX_H
#define GOLDFIELD_BLOCK_MATRIX_H

#include <stdint.h>

static inline void matrix3_load(float block[3][3], const float *from, uint32_t length) {
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            block[row][column] = from[row * length + column];
        }
    }
}

static inline void matrix3_store(const float block[3][3], float *to, uint32_t length) {
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            to[row * length + column] = block[row][column];
        }
    }
}

/* Add the product A B. */
static inline void matrix3_add(float sum[3][3], const float *a, uint32_t a_length, const float *b, uint32_t b_length) {
    for (uint32_t k = 0; k < 3u; k++) {
        for (uint32_t row = 0; row < 3u; row++) {
            for (uint32_t column = 0; column < 3u; column++) {
                sum[row][column] += a[row * a_length + k] * b[k * b_length + column];
            }
        }
    }
}

/* Add the product A B'. */
static inline void matrix3_add_transposed(float sum[3][3], const float *a, uint32_t a_length, const float *b,
                                          uint32_t b_length) {
    for (uint32_t k = 0; k < 3u; k++) {
        for (uint32_t row = 0; row < 3u; row++) {
            for (uint32_t column = 0; column < 3u; column++) {
                sum[row][column] += a[row * a_length + k] * b[column * b_length + k];
            }
        }
    }
}

/* Subtract the product A B'. */
static inline void matrix3_subtract_transposed(float sum[3][3], const float *a, uint32_t a_length, const float *b,
                                               uint32_t b_length) {
    for (uint32_t k = 0; k < 3u; k++) {
        for (uint32_t row = 0; row < 3u; row++) {
            for (uint32_t column = 0; column < 3u; column++) {
                sum[row][column] -= a[row * a_length + k] * b[column * b_length + k];
            }
        }
    }
}

#endif

/* block_kalman.h: one Kalman filter of the bank of block_filter.h: its state, its prediction, and its update by the
 * nine observed numbers of a block.
 *
 * Calls: block_kalman_predict to the middle of the block, then block_kalman_update with what block_measure.h makes of
 * the block.
 *
 * Method. The covariance is kept whole and made symmetric by each update. With the information of the block as a
 * Cholesky factor, the matrix that is inverted is the unit matrix and something positive, whatever the block tells: its
 * pivots are at least 1, in single precision too.
 */
#ifndef GOLDFIELD_BLOCK_KALMAN_H
#define GOLDFIELD_BLOCK_KALMAN_H

#include <stdbool.h>
#include <stdint.h>

#include "core/track/block_measure.h"

#define BLOCK_STATES 18u /* Errors of the state: six vectors, in this order. */

/* Where the vectors of the state begin in the covariance. */
enum { BLOCK_P = 0, BLOCK_THETA = 3, BLOCK_V = 6, BLOCK_W = 9, BLOCK_E = 12, BLOCK_B = 15 };

typedef struct {
    block_state_t state;
    float covariance[BLOCK_STATES][BLOCK_STATES]; /* In the units of the state. */
    float acceleration, turn;                     /* Agility, m/s^2 and rad/s^2 per root hertz. */
    float likelihood;                             /* Its logarithm, of the last while. */
} block_kalman_t;

/* Move the state and its covariance on by so many seconds. */
void block_kalman_predict(block_kalman_t *filter, float seconds);

/* Take the block that was measured, if its chi-square is below limit; *chi_square and *log_determinant tell its
 * likelihood in any case.
 * Returns whether it was taken; if not, the filter stays as it is. */
bool block_kalman_update(block_kalman_t *filter, const block_measure_t *measure, float limit, float *chi_square,
                         float *log_determinant);

#endif

/* block_kalman.h: one Kalman filter of the bank of block_filter.h: its state, its prediction, and its update by the
 * nine observed numbers of a block, and by the sweep of the ambient field where that is known.
 *
 * Calls: block_kalman_predict to the middle of the block, then block_kalman_update with what block_measure.h makes of
 * the block, and block_sweep.h if it is asked.
 *
 * Method. The rows are taken three at a time, each group with the covariance that those before it have left: what
 * is inverted is the unit matrix and something positive, whatever the block tells, and its pivots are at least 1, in
 * single precision too. The first groups leave their covariance on the stack, so that a block that is refused changes
 * nothing. Of a covariance the blocks of six rows and columns on and below the diagonal are kept up; those above are
 * not.
 *
 * Time (Cortex-M4, -O3): block_kalman_predict 1,100 instructions, block_kalman_update 10,300.
 */
#ifndef GOLDFIELD_BLOCK_KALMAN_H
#define GOLDFIELD_BLOCK_KALMAN_H

#include <stdint.h>

#include "core/track/block_measure.h"
#include "core/track/block_sweep.h"

typedef struct {
    block_state_t state;
    float covariance[BLOCK_STATES][BLOCK_STATES]; /* In the units of the state, on and below the diagonal. */
    float acceleration2, turn2;                   /* Squared agility, (m/s^2)^2 and (rad/s^2)^2 per hertz. */
    float probability;                            /* That the sensor moves as this filter expects. */
} block_kalman_t;

/* Move the state and its covariance on by so many seconds. */
void block_kalman_predict(block_kalman_t *filter, float seconds);

/* Move a state and the covariance, on and below the diagonal, of its errors up to the turn rate on by so many seconds,
 * with squared agilities. */
void block_kalman_ahead(block_state_t *state, float covariance[BLOCK_E][BLOCK_E], float acceleration2, float turn2,
                        float seconds);

/* Take the block that was measured, with the rows of its sweep or NULL, if its chi-square is at most limit;
 * *log_determinant tells its likelihood in any case.
 * Returns the chi-square; if it exceeds limit, or is not a number, the filter stays as it is. */
float block_kalman_update(block_kalman_t *filter, const block_measure_t *measure, const block_sweep_t *sweep,
                          float limit, float *log_determinant);

#endif

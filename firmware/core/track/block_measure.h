/* block_measure.h: what a block of chips tells of position, attitude and ambient field, around a reference state.
 *
 * Calls: block_measure once for each block; block_errors (block_errors.h) uses what it leaves.
 *
 * The fields that a block is compared with are those at the reference. Their slopes are taken there, too, or kept from
 * a place where they were taken before (held): of a sensor that stands still the slopes do not change, and where the
 * reference wanders by its own errors, their changes would seem to tell what no block tells.
 *
 * Method. The nine observed numbers are the ambient field as the sensor sees it, position, and a small turn in the
 * site's frame: in this order, since the ambient field has twice as many columns of the state as each of the others,
 * and what is eliminated first has no column in the rows that follow. All sums are turned into the site's frame. Field
 * and gradient of each coil come from loop_field.h, and the gram and moment matrices are multiplied with them once:
 * nothing of the size of the block is inverted. Information and gradient follow in closed form, because the attitude's
 * Jacobians are cross products and the gradient of a field outside the wire has only five different numbers.
 *
 * Limits. Information below 1e-6 of its own diagonal is left out: with fields of which one is more than about 500 times
 * as strong as the others, single precision does not see what those tell.
 *
 * Time (Cortex-M4, -O3): 11,400 instructions with 8 beacons, 22,600 with 16, 56,300 with 32; with slopes that are kept
 * less.
 */
#ifndef GOLDFIELD_BLOCK_MEASURE_H
#define GOLDFIELD_BLOCK_MEASURE_H

#include <stdbool.h>
#include <stdint.h>

#include "core/pose/loop_field.h"
#include "core/track/block_field.h"
#include "core/track/block_gram.h"
#include "core/track/block_state.h"

#define BLOCK_OBSERVED 9u  /* Observed numbers, and rows that tell of them. */
#define BLOCK_ROW      19u /* Length of a row. */

/* Columns of a row: those of the state's errors, in their order, and the right side. */
enum { BLOCK_ROW_Y = BLOCK_STATES };

/* What the slopes of fields and ambient field depend on. */
typedef struct {
    float position_m[3], ambient_uT[3];
} block_place_t;

typedef struct {
    block_state_t reference;               /* The state around which the block is linearised. */
    bool held;                             /* The slopes are those of place, else of the reference, which becomes it. */
    bool known;                            /* With held: the model is that of place, and need not be computed. */
    block_place_t place;                   /* Where the slopes are taken. */
    float noise_uT;                        /* Standard deviation of a component of a sample. */
    float rotation[3][3];                  /* Its attitude R. */
    float rows[BLOCK_OBSERVED][BLOCK_ROW]; /* [A y]: A x = y but for noise of unit variance, x being the
                                              state less the reference. Three rows each of the ambient
                                              field, with all columns; of the position, without those
                                              of ambient field and offset; and of the turn, without
                                              those and the position's. Columns that a row is without
                                              are zero and not set. */
    uint32_t rank;                         /* Rows of A that are not zero. */
    block_field_t model[BLOCK_COLUMNS];    /* Those of the columns at place, of which the last is the ambient one ... */
    block_field_t sum[BLOCK_COLUMNS];      /* ... and for each row their sums, weighted with the gram matrix ... */
    block_field_t moment[BLOCK_COLUMNS];   /* ... and with the moment matrix. */
    float ambient_sum[BLOCK_COLUMNS];      /* The last column of the gram matrix. */
} block_measure_t;

/* Returns the column of the rows in which the diagonal of an observed number stands. */
static inline uint32_t block_measure_diagonal(uint32_t number) {
    return number < 3u ? BLOCK_E + number : number - 3u;
}

/* Compute the rest of *measure, whose reference, noise, held and known the caller has set, from a block and the coils
 * of its columns but the last. Results are not finite where the reference lies on a wire. */
void block_measure(const block_t *block, const loop_t *coils, block_measure_t *measure);

#endif

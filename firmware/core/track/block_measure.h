/* block_measure.h: what a block of chips tells of position, attitude and ambient field, around a reference state.
 *
 * Calls: block_measure once for each block; block_errors (block_errors.h) uses what it leaves.
 *
 * Method. The nine observed numbers are position, a small turn in the site's frame, and the ambient field as the sensor
 * sees it. All sums are turned into the site's frame. Field and gradient of each coil come from loop_field.h, and the
 * gram and moment matrices are multiplied with them once: nothing of the size of the block is inverted. Information and
 * gradient follow in closed form, because the attitude's Jacobians are cross products and the gradient of a field
 * outside the wire has only five different numbers.
 *
 * Limits. Information below 1e-6 of its own diagonal is left out: with fields of which one is more than about 500 times
 * as strong as the others, single precision does not see what those tell.
 */
#ifndef GOLDFIELD_BLOCK_MEASURE_H
#define GOLDFIELD_BLOCK_MEASURE_H

#include <stdint.h>

#include "core/pose/loop_field.h"
#include "core/track/block_gram.h"

#define BLOCK_OBSERVED 9u /* Observed numbers. */

/* The state of the sensor. */
typedef struct {
    float position_m[3], quaternion[4]; /* Attitude x, y, z, w: B_site = R B_sensor. */
    float velocity_m_s[3], rate_rad_s[3];
    float ambient_uT[3]; /* Ambient field in the site's frame. */
    float offset_uT[3];  /* Offset of the sensor in its own frame. */
} block_state_t;

typedef struct {
    block_state_t reference;                      /* The state around which the block is linearised. */
    float noise_uT;                               /* Standard deviation of a component of a sample. */
    float rotation[3][3];                         /* Its attitude R. */
    float factor[BLOCK_OBSERVED][BLOCK_OBSERVED]; /* U, lower triangle: the information is U U'. */
    float motion[BLOCK_OBSERVED][6];              /* W: U W is what velocity and turn rate add to the gradient. */
    float side[BLOCK_OBSERVED];                   /* y: U y is the gradient at the reference. */
    uint32_t rank;                                /* Columns of U that are not zero. */
    /* Of each column: the field (of the last one, the ambient field), the five numbers xx, xy, xz, yy, yz of its
     * gradient, and the sums of both over the columns, weighted with the gram matrix. */
    float field_uT[BLOCK_COLUMNS][3], gradient[BLOCK_COLUMNS][5];
    float field_sum[BLOCK_COLUMNS][3], gradient_sum[BLOCK_COLUMNS][5];
    float ambient_sum[BLOCK_COLUMNS]; /* The last column of the gram matrix. */
} block_measure_t;

/* Compute the rest of *measure, whose reference and noise the caller has set, from a block and the coils of its columns
 * but the last. Results are not finite where the reference lies on a wire. */
void block_measure(const block_t *block, const loop_t *coils, block_measure_t *measure);

#endif

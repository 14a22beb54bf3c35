/* block_field.h: a field with its gradient, of a column or summed over columns, and what follows from it.
 * All of it is inline, since it stands in the innermost loops of what a block tells.
 */
#ifndef GOLDFIELD_BLOCK_FIELD_H
#define GOLDFIELD_BLOCK_FIELD_H

#include <stdint.h>

#include "core/math/vector3.h"
#include "core/track/block_state.h"

/* A field in the site's frame, uT, and the five numbers xx, xy, xz, yy, yz of its gradient, uT/m. */
typedef struct {
    float field_uT[3], gradient[5];
} block_field_t;

/* Expand the five numbers of a symmetric gradient without trace. */
static inline void block_field_expand(const float five[5], float gradient[3][3]) {
    gradient[0][0] = five[0];
    gradient[0][1] = gradient[1][0] = five[1];
    gradient[0][2] = gradient[2][0] = five[2];
    gradient[1][1] = five[3];
    gradient[1][2] = gradient[2][1] = five[4];
    gradient[2][2] = -five[0] - five[3];
}

/* Compute how fast a field changes in the frame of a sensor that moves so, turned into the site's frame, uT/s. */
static inline void block_field_change(const block_field_t *field, const block_state_t *state, float change[3]) {
    float gradient[3][3], turned[3];
    block_field_expand(field->gradient, gradient);
    vector3_cross(state->rate_rad_s, field->field_uT, turned);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        change[axis] = vector3_dot(gradient[axis], state->velocity_m_s) - turned[axis];
    }
}

#endif

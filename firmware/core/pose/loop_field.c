#include "core/pose/loop_field.h"

#include <stdint.h>

#include "core/math/roots.h"
#include "core/math/vector3.h"

#define ENOUGH  1e-4f  /* Largest relative difference of the two means at the end; the next step would square it. */
#define TINY_M2 1e-20f /* Added to rho^2 against 0/0 on the axis, where the quotient multiplies radial vectors. */

/* The quantities that field and gradient share. */
typedef struct {
    float offset[3], radial[3]; /* The point from the centre, and the part of that across the axis. */
    float height, rho2, u, s, w2;
    float i10, j11; /* The means I_10 and I_11 / w. */
} integrals_t;

/* Returns the arithmetic-geometric mean of greatest and least. *tau becomes the sum of 2^(n-1) c_n^2 / w^2 over its
 * steps, with c_n their half differences. */
static float mean_of(float greatest, float least, float *tau) {
    const float total = greatest + least;
    float a = 0.5f * total, b = square_root(greatest * least);
    const float quarter_w = 0.125f * total * (greatest - least);
    float c_over_w = 1.0f / total, weight = 1.0f;
    *tau = c_over_w * c_over_w;
    for (uint32_t step = 0; step < LOOP_MEAN_STEPS; step++) {
        const float next = 0.5f * (a + b);
        c_over_w *= quarter_w * c_over_w / next;
        weight *= 2.0f;
        *tau += weight * c_over_w * c_over_w;
        b = square_root(a * b);
        a = next;
        if (a - b <= ENOUGH * a) {
            break;
        }
    }
    return 0.5f * (a + b);
}

static void integrate(const loop_t *loop, const float point_m[3], integrals_t *i) {
    vector3_subtract(point_m, loop->centre_m, i->offset);
    i->height = vector3_dot(loop->axis, i->offset);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        i->radial[axis] = i->offset[axis] - i->height * loop->axis[axis];
    }
    i->rho2 = vector3_dot(i->radial, i->radial);
    const float rho = square_root(i->rho2), height2 = i->height * i->height, a = loop->radius_m;
    const float greatest2 = (rho + a) * (rho + a) + height2, least2 = (rho - a) * (rho - a) + height2;
    i->u = 0.5f * (greatest2 + least2);
    i->s = greatest2 * least2; /* u^2 - w^2 */
    i->w2 = 4.0f * a * a * i->rho2;
    float tau;
    const float mean = mean_of(square_root(greatest2), square_root(least2), &tau);
    const float over = 1.0f / (mean * i->s);
    i->i10 = (i->u - tau * i->w2) * over;
    i->j11 = (1.0f - tau * i->u) * over;
}

static void field_of(const loop_t *loop, const integrals_t *i, float field[3]) {
    const float scale = 2.0f * loop->k_uT_m3;
    const float axial = scale * (i->i10 - 2.0f * i->rho2 * i->j11), lift = scale * 2.0f * i->height * i->j11;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        field[axis] = axial * loop->axis[axis] + lift * i->radial[axis];
    }
}

void loop_field(const loop_t *loop, const float point_m[3], float field_uT[3]) {
    integrals_t i;
    integrate(loop, point_m, &i);
    field_of(loop, &i, field_uT);
}

void loop_field_and_gradient(const loop_t *loop, const float point_m[3], float field_uT[3], float gradient[3][3]) {
    integrals_t i;
    integrate(loop, point_m, &i);
    field_of(loop, &i, field_uT);
    const float scale = 2.0f * loop->k_uT_m3, lift = scale * 2.0f * i.height * i.j11;
    const float i20 = (i.u * i.i10 + i.w2 * (1.0f / 3.0f) * i.j11) / i.s;
    const float q21 = (i.j11 * (1.0f / 3.0f) + i20) / i.u; /* I_21 / w */
    const float along_j = -3.0f * q21, across_j = (1.5f * i20 - 2.0f * i.j11) / (i.rho2 + TINY_M2);
    const float along_i = -3.0f * i20, across_i = 6.0f * loop->radius_m * loop->radius_m * q21;
    float axial_slope[3], lift_slope[3]; /* Slopes of the factors of axis and radial, by position. */
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float j_slope = along_j * i.offset[axis] + across_j * i.radial[axis];
        const float i_slope = along_i * i.offset[axis] + across_i * i.radial[axis];
        axial_slope[axis] = scale * (i_slope - 2.0f * i.rho2 * j_slope - 4.0f * i.j11 * i.radial[axis]) -
                            lift * loop->axis[axis];
        lift_slope[axis] = scale * 2.0f * (i.height * j_slope + i.j11 * loop->axis[axis]);
    }
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            gradient[row][column] = loop->axis[row] * axial_slope[column] + i.radial[row] * lift_slope[column];
        }
        gradient[row][row] += lift;
    }
}

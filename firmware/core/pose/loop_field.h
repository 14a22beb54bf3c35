/* loop_field.h: the field of a circular coil, and its gradient, at any range: exact loop near by, dipole far away, by
 * one formula. Radius 0 is the dipole itself.
 *
 * Method. With the point at height h over the loop's plane and rho from its axis, a the radius, u = a^2 + rho^2 + h^2
 * and w = 2 a rho, the field needs only the means over a turn I_nk = <cos^k / (u - w cos)^(n + 1/2)>. Gauss's
 * arithmetic-geometric mean of the greatest and the least distance to the wire gives them as sums of positive terms:
 * nothing cancels on the axis or far away, where the textbook form with elliptic integrals loses every digit of single
 * precision. The derivation is that of host/goldfield/field/loop.py.
 *
 * Units: metres and microtesla, so that numbers stay near 1 (a coil of 13 A m^2 has 1.3 uT at 1 m): k = mu0/(4 pi) m =
 * 0.1 uT m^3 for each A m^2.
 *
 * Accuracy against magpylib (tests/firmware/core/pose/test_loop_field.py)
 *   distance                                 field, relative   gradient, over field / distance to the wire
 *   beyond two radii                               2e-6                       1e-5
 *   nearer, down to a tenth of the radius
 *   from the wire                                  1e-5                       2e-4
 * On the wire itself the result is large or not finite.
 *
 * Time (Cortex-M4, -O3): the field takes 145 instructions, with gradient 285, from a few radii on; near the wire at
 * most LOOP_MEAN_STEPS steps of the mean.
 */
#ifndef GOLDFIELD_LOOP_FIELD_H
#define GOLDFIELD_LOOP_FIELD_H

#define LOOP_MEAN_STEPS 6u /* Most steps of the arithmetic-geometric mean, which bounds the time near the wire. */

typedef struct {
    float centre_m[3];
    float axis[3];  /* Unit vector; the current runs right-handed around it. */
    float k_uT_m3;  /* mu0/(4 pi) times the moment, uT m^3. */
    float radius_m; /* Radius of the loop, m; 0 is a dipole. */
} loop_t;

/* Compute the field, uT, and its gradient, uT/m, [row i][column j] = dB_i/dp_j, at a point. */
void loop_field_and_gradient(const loop_t *loop, const float point_m[3], float field_uT[3], float gradient[3][3]);

/* Compute the field alone, at half of the time. */
void loop_field(const loop_t *loop, const float point_m[3], float field_uT[3]);

#endif

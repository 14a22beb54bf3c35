/* What metal in the room adds to the coils' fields (goldfield.field.metal).
 *
 * gf_sources() calls gf_add_metal() where gf_coils_t names metal, so that every fit and search has it.
 */
#ifndef GF_LOCATE_METAL_H
#define GF_LOCATE_METAL_H

#include "kernel.h"

/* Add the field of the metal and its gradient at a point of the site's frame to those of n coils, the gradient as xx,
 * yy, zz, xy, xz, yz. Time: 2 x 9 degree^2 n operations for the polynomials, 100 n for each body. Not finite in a
 * body's centre. */
void gf_add_metal(const gf_metal_t *metal, size_t n, const double position_m[3], double field_T[3][GF_MOST_COILS],
                  double gradient_T_m[6][GF_MOST_COILS]);

#endif

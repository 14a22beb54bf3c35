/* Where the field of one coil has a given magnitude: points of the coil's quarter plane rho >= 0, z >= 0, about which
 * the magnitude is symmetric.
 */
#ifndef GF_LOCATE_LEVEL_SET_H
#define GF_LOCATE_LEVEL_SET_H

#include <stdbool.h>

#include "kernel.h"

/* Rays from the wire: 8 lose nothing against 16 in trials. */
#define GF_RAYS 8

typedef struct {
    double rho_m[GF_RAYS];     /* Distance from the coil's axis, */
    double z_m[GF_RAYS];       /* and height above its plane, from the outside inward. */
    double spacing_m[GF_RAYS]; /* Distance between the neighbours of a point, halved. */
    bool around; /* Whether the set is a tube around the wire, which meets the plane inside the coil, not the axis. */
} gf_level_set_t;

/* Trace the level set of a coil of this moment and radius (0 for a dipole) by rays from the wire, evenly spread from
 * the plane outside of the coil to where the set meets the axis or the plane inside, and bisection along each.
 * magnitude_T is positive. The points are within 1 % of their distance from the wire. Bound: 28 evaluations of the
 * field of one coil a ray. */
void gf_level_set(double moment_A_m2, double radius_m, double magnitude_T, gf_level_set_t *out);

#endif

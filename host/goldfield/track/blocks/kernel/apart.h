/* apart.h: how far two estimates of one motion are apart, and what both say together, in double precision.
 *
 * The NumPy functions of `goldfield.track.blocks.pair` are the reference and serve where this library is not built;
 * tests/host/track/blocks/test_kernel_double.py holds them against these.
 */
#ifndef GOLDFIELD_APART_H
#define GOLDFIELD_APART_H

#include <stdbool.h>

/* An estimate: rotation 3 x 3, B_site = R B_sensor; covariance 18 x 18, of which the first twelve rows are used. */
typedef struct {
    const double *position;
    const double *rotation;
    const double *velocity;
    const double *rate;
    const double *covariance;
} gf_estimate_t;

/* Compute by how much the second is off the first, 12 numbers: position, a small rotation, velocity, turn rate; and the
 * squared distance of their poses, if the first knows all that the second does (Hausman, 1978).
 * least_share: the variance of the distance is at least this part of that of the second.
 * Returns false if the covariance of the second's pose is not positive definite. */
bool gf_apart(const gf_estimate_t *seeing, const gf_estimate_t *alone, double least_share, double error[12],
              double *distance2);

/* Write what both say together if the second counts by a weight: position, rotation, velocity, turn rate (18 numbers)
 * and the covariance, 18 x 18. error: that of gf_apart(). */
void gf_between(const gf_estimate_t *seeing, const gf_estimate_t *alone, const double error[12], double weight,
                double *motion, double *covariance);

#endif

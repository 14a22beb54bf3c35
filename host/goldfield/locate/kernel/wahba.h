/* Wahba's problem: the attitude between modelled and measured vectors, and what the best one leaves.
 *
 * Both take the fields of the coils at one point (coils.h), the measured vectors n x 3 in the sensor's frame and n
 * weights, inverse variances, 0 where nothing was measured.
 */
#ifndef GF_LOCATE_WAHBA_H
#define GF_LOCATE_WAHBA_H

#include "coils.h"

/* Rotation R with least sum w |B_site - R b|^2 (Davenport's matrix and its eigenvectors). */
void gf_attitude(size_t coils, const gf_sources_t *sources, const double *field_T, const double *weight,
                 double rotation[3][3]);

/* That least sum without its rotation: the largest root of Davenport's quartic by Newton's method (QUEST). Twelve
 * steps leave 1e-6 of the fields' energy, enough to rank candidates. */
double gf_wahba_loss(size_t coils, const gf_sources_t *sources, const double *field_T, const double *weight);

#endif

/* What the errors of the site and of the sensor do to the measured components: their covariance, and its whitening.
 *
 * The errors of a beacon (place, direction, current) correlate its three components; those of the sensor (gains and
 * leaning of its axes) correlate the components of all beacons. gf_whiten() forms both around a pose, gf_whitened()
 * applies the first to what gf_components() gives for weights of 1 (measured) and 0, and gf_unshare() the second.
 */
#ifndef GF_LOCATE_WHITEN_H
#define GF_LOCATE_WHITEN_H

#include <stdbool.h>

#include "coils.h"

/* Unknowns of the sensor: three gains, and how x and y, x and z, y and z lean together. */
#define GF_SHARED 6

typedef struct {
    double weight[3 * GF_MOST_COILS]; /* 1 where a component was measured, else 0. */
    /* Inverse Cholesky factors W of each beacon's covariance; rows of what was not measured are 0. */
    double beacon[GF_MOST_COILS][3][3];
    /* V of the sensor's part: with S the whitened effects of its unknowns, (1 + S S')^-1 = 1 - V V'. */
    double shared[3 * GF_MOST_COILS][GF_SHARED];
    bool is_shared; /* False if the sensor is exact: V is then 0. */
} gf_whitening_t;

/* Form the whitening of one epoch's components around a pose. field_T is n x 3 and only tells by NaN what was not
 * measured; sigma_T has the noise of each component alone, n. */
void gf_whiten(const gf_coils_t *coils, const gf_errors_t *errors, const double *field_T, const double *sigma_T,
               const gf_pose_t *pose, gf_whitening_t *out);

/* Whiten components of all beacons, one value a component. */
void gf_whiten_values(size_t coils, const gf_whitening_t *whitening, double *value);

/* Whiten what gf_components() gave, values and slopes. */
void gf_whitened(size_t coils, const gf_whitening_t *whitening, gf_components_t *components);

/* Multiply a whitened column of values, or the slopes, by 1 - V V': weighted for the sensor's errors too. */
void gf_unshare_values(size_t coils, const gf_whitening_t *whitening, double *value);
void gf_unshare_slopes(size_t coils, const gf_whitening_t *whitening, double slope[][6]);

#endif

/* even.h: how much the ambient field has changed, in double precision.
 *
 * The NumPy function `_step` of `goldfield.track.blocks.evenness` is the reference and serves where this library is
 * not built; tests/host/track/blocks/test_kernel_double.py holds it against this.
 */
#ifndef GOLDFIELD_EVEN_H
#define GOLDFIELD_EVEN_H

#define GF_USUAL                                                                                                       \
    21 /* What is usual: ambient field and offset, 3, the attitude, 3 x 3, its share of the doubt, 3 x 3. */

/* The limits of `goldfield.track.blocks.evenness`, in its units. */
typedef struct {
    double even_T;
    double gradient_T_m;
    double settling_T_s;
    double fastest_m_s;
    double certain;
    double likely;
    double better;
} gf_even_limits_t;

/* What the beacons alone tell of the sensor: rotation 3 x 3, covariance 18 x 18, of attitude and offset. */
typedef struct {
    const double *rotation;
    const double *velocity;
    const double *offset;
    const double *covariance;
} gf_attitude_t;

/* Hold the ambient field that the sensor sees, in its own frame, against what is usual, which follows.
 * usual: as of the last time; a first number that is NaN begins anew. told: by how much it has changed beyond what says
 * nothing, T, and the share by which fields may be bent; they are not written where there is no field at all. */
void gf_even(const gf_even_limits_t *limits, const gf_attitude_t *known, const double seen_T[3], double seconds,
             double usual[GF_USUAL], double told[2]);

#endif

/* Location in double precision: the hot path of goldfield.locate, one epoch after another without an interpreter.
 * gf_evaluate() is the field model itself. gf_starts() gives poses to start from, gf_fit() the fitted ones, and
 * gf_fit_subsets() those without some of the coils; gf_faults() and gf_covariance() judge them.
 *
 * Python calls the functions of this header through cffi (goldfield/locate/kernel/__init__.py). Each does what a NumPy
 * function of goldfield.locate does, which stays as its reference and as the fallback where this library is not built;
 * tests/host/locate/test_kernel.py holds the two against each other.
 *
 * Units are SI. Matrices are row-major and dense. n is the number of coils, e that of epochs.
 *
 *   field_T   e x n x 3   measured components in the sensor's frame; NaN where nothing was measured
 *   sigma_T   e x n       their standard deviations, positive and finite; with errors the noise alone
 *   position_m  e x 3,    rotation  e x 3 x 3 with B_site = R B_sensor
 *
 * Memory: no heap, no globals; below 80 KiB of stack. Time: about 1 us for an evaluation of the field and a step of a
 * fit with eight coils on a server's core of today. Bad input: a start or a measurement that is not finite gives
 * results that are not finite; counts outside their range are the caller's error and are not checked here.
 */
#ifndef GF_LOCATE_KERNEL_H
#define GF_LOCATE_KERNEL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Coils of one site; the wrapper leaves larger ones to NumPy. */
#define GF_MOST_COILS 64

/* Subsets that gf_fit_subsets() compares at once, and those of them that share their poses. */
#define GF_MOST_SUBSETS 128
#define GF_MOST_POOL    8

/* The magnetic constant over 4 pi, T m/A (CODATA 2022, as SciPy gives it). */
#define GF_MU0_OVER_4PI (1.25663706127e-6 / (4.0 * 3.14159265358979323846))

/* Highest degree of the metal's polynomials, and most of its bodies (goldfield.site.metal). */
#define GF_MOST_DEGREE 5
#define GF_MOST_BODIES 8

/* What metal in the room adds to the fields of n coils (goldfield.field.metal.MetalField): polynomials about a centre,
 * and bodies with a moment for each coil. */
typedef struct {
    double centre_m[3];
    double radius_m;
    size_t degree;      /* 0: no polynomials */
    const double *sums; /* 9 x degree^2 x n: field, then gradient as xx, yy, zz, xy, xz, yz, by the harmonics */
    size_t bodies;
    double body_m[GF_MOST_BODIES][3];
    const double *moment_A_m2; /* bodies x 3 x n */
} gf_metal_t;

/* Circular coils, as loops or, with radius 0, as dipoles (a loop of radius 0 at the same moment is a dipole). */
typedef struct {
    size_t count;
    double centre_m[3][GF_MOST_COILS];
    double axis[3][GF_MOST_COILS];     /* unit vector along the moment */
    double moment_A_m2[GF_MOST_COILS]; /* positive */
    double radius_m[GF_MOST_COILS];
    double across[3];        /* unit vector: off the plane of the coils */
    const gf_metal_t *metal; /* null if there is none */
} gf_coils_t;

/* Standard deviations of what the site says of each coil, and of the sensor's axes (goldfield.site.Survey and
 * SensorSite). Functions take a null pointer where all is exact. */
typedef struct {
    double position_sd_m[GF_MOST_COILS];
    double axis_sd_rad[GF_MOST_COILS];
    double current_sd[GF_MOST_COILS]; /* relative */
    double gain_sd;                   /* relative, of each axis of the sensor */
    double sensor_axis_sd_rad;
    double noise_shape[3][3]; /* covariance of the noise of a coil's components over their variance; the identity unless
                               * the sensor's axes have different gains or lean (goldfield.locate.sensor_axes) */
} gf_errors_t;

/* Field and gradient of every coil at some points of the site's frame (goldfield.field.FieldModel.evaluate). position_m
 * is points x 3. Out: field_T (3 x points x n), gradient_T_m (3 x 3 x points x n); not finite on a wire. */
void gf_evaluate(const gf_coils_t *coils, size_t points, const double *position_m, double *field_T,
                 double *gradient_T_m);

/* Starts with no prior, from complete vectors: trilateration with |B| = 1.5 k/r^3, fit of log |B|, Wahba's problem
 * (goldfield.locate.starts and .wahba; patent, equations 6 to 8). Three errors beside the noise, all relative:
 * range_error in the simple ranges, magnitude_error in |B| (so absolute in its logarithm), vector_error in the vectors
 * of Wahba's problem. Out: position_m, rotation. Bound: 30 evaluations of the field an epoch. Returns how many it took.
 */
size_t gf_starts(const gf_coils_t *coils, size_t epochs, const double *field_T, const double *sigma_T,
                 double range_error, double magnitude_error, double vector_error, double *position_m, double *rotation);

/* Least squares of position and attitude to the components (goldfield.locate.fit.fit_pose, Levenberg-Marquardt).
 * model_error is relative, beside the noise, and counts only where errors is null. With errors the components are
 * whitened around the start, and up to three times again around what was found, until that stays.
 * In and out: position_m, rotation. Out: cost (e), the sum of squared whitened residuals; information (e x 6 x 6) of
 * position and of a small turn in the site's frame; converged (e), 0 or 1. Bound: 1 + iterations evaluations of the
 * field an epoch, with errors four times 2 + iterations. Returns how many it took. */
size_t gf_fit(const gf_coils_t *coils, const gf_errors_t *errors, size_t epochs, const double *field_T,
              const double *sigma_T, double model_error, size_t iterations, double tolerance, double *position_m,
              double *rotation, double *cost, double *information, uint8_t *converged);

/* The same fit, without errors of the site, of a sensor that distorts: b = S R'B with the symmetric S = fixed + sum of
 * f_k basis_k (goldfield.locate.sensor_rivals). fixed is 3 x 3, basis count x 3 x 3, count 1 to 6. At each pose the
 * factors f that fit best are found by linear equations, so that no start is needed for them. Each coil's field is
 * known whole or not at all. In and out: position_m, rotation. Out: cost, distortion S (e x 3 x 3). Bound: 2 +
 * iterations evaluations of the field an epoch. Returns how many it took. */
size_t gf_fit_distorted(const gf_coils_t *coils, size_t epochs, const double *field_T, const double *sigma_T,
                        double model_error, const double *fixed, size_t count, const double *basis, size_t iterations,
                        double tolerance, double *position_m, double *rotation, double *cost, double *distortion);

/* Search of the best pose with no prior, from complete vectors, and of a rival (goldfield.locate.constellation). The
 * best is the global minimum of the cost as far as could be found out within most_evaluations; those on the right side
 * of the half-space, the unit normal and the least component along it, go before others (a normal and component of 0
 * allow all). A rival is another minimum within a cost of 15 of the best that no low way joins with it. Where
 * even with a relative error of the model the cost is above hopeless_cost, a descent is given up; if nothing costs
 * less, neither a rival nor the valley's bend is sought, and the candidates are fitted to the end all the same if the
 * best pose is wanted at any cost. Out: position_m (e x 2 x 3), rotation (e x 2 x 3 x 3), best
 * and rival; found (e), how many of the two there are; widening (e x 6 x 6), to be added to the covariance of the best
 * because its valley bends; evaluations (e). */
void gf_search(const gf_coils_t *coils, size_t epochs, const double *field_T, const double *sigma_T, double model_error,
               const double half_space[4], size_t most_evaluations, double hopeless_cost, bool at_any_cost,
               double *position_m, double *rotation, uint8_t *found, double *widening, uint32_t *evaluations);

/* One epoch without each of some subsets of its coils, and how they are fitted (goldfield.locate.exclusion). */
typedef struct {
    size_t count;          /* of subsets, at most GF_MOST_SUBSETS */
    const double *field_T; /* count x n x 3, NaN for what a subset lacks */
    const double *sigma_T; /* count x n: of the rough fits, */
    const double *noise_T; /* and of those to the end, with errors */
    size_t starts;         /* of each subset beside the pose that is known */
    const double *start_m; /* count x starts x 3 */
    const double *start_rotation;
    double model_error; /* of the rough fits */
    size_t rough_iterations;
    double rough_tolerance;
    size_t final_iterations;
    double final_tolerance;
    size_t pool;       /* best subsets whose poses are starts for all the others, at most GF_MOST_POOL */
    double clear_cost; /* subsets are fitted to the end that cost at most so much more than the best, */
    double unfit_cost; /* and none if all cost more than this even with model error */
    size_t most_evaluations;
} gf_subsets_t;

/* The fits of all subsets; the information and convergence of what was fitted last. */
typedef struct {
    double *position_m;  /* count x 3 */
    double *rotation;    /* count x 3 x 3 */
    double *cost;        /* count */
    double *information; /* count x 6 x 6 */
    uint8_t *converged;  /* count */
} gf_subset_fits_t;

/* Fit each subset roughly from the best of its starts, then from the best poses of all; end the fits that matter
 * (goldfield.locate.exclusion). In and out: fits, which begin as rough ones, or at an infinite cost. Out: hopeless,
 * whether nothing costs less than unfit_cost. Bound: most_evaluations and 1 + starts + pool evaluations of the field a
 * subset. Returns how many it took. */
size_t gf_fit_subsets(const gf_coils_t *coils, const gf_errors_t *errors, const gf_subsets_t *given,
                      const gf_subset_fits_t *fits, bool *hopeless);

/* Where gf_faults() writes. */
typedef struct {
    double *drop;                /* e x n: part of the cost that leaving the beacon out takes away */
    int32_t *freedom;            /* e x n: its degrees of freedom */
    double *scale;               /* e x n: part of the cost that another strength of the beacon takes away */
    double *separation_m;        /* e x n x 3: the position less that without the beacon */
    double *separation_cov_m2;   /* e x n x 3 x 3: covariance of this */
    double *distortion;          /* e x 4: part of the cost that a distortion of the sensor takes away: one gain, one
                                    gain an axis, any symmetric matrix, and the gain of that one axis whose part is
                                    the largest */
    int32_t *distortion_freedom; /* e x 4 */
} gf_fault_tables_t;

/* Statistics of faults around fitted poses, of each beacon and of the sensor (goldfield.locate.fault_statistics, which
 * derives them). least_eigenvalue is as in gf_covariance(); least_share is the part of a variance that must be left in
 * the residuals for a fault to show. Bound: one evaluation of the field an epoch, three with
 * errors. */
void gf_faults(const gf_coils_t *coils, const gf_errors_t *errors, size_t epochs, const double *field_T,
               const double *sigma_T, const double *position_m, const double *rotation, double least_eigenvalue,
               double least_share, const gf_fault_tables_t *out);

/* Mean square error of fitted poses with second-order terms (goldfield.locate.uncertainty.second_order_covariance).
 * Directions whose eigenvalue of the information, scaled to a unit diagonal, is below least_eigenvalue get free_m2
 * and free_rad2 along them. Out: covariance (e x 6 x 6). Bound: 13 evaluations of the field an epoch, 14 with
 * errors. */
void gf_covariance(const gf_coils_t *coils, const gf_errors_t *errors, size_t epochs, const double *field_T,
                   const double *sigma_T, const double *position_m, const double *rotation, double least_eigenvalue,
                   double free_m2, double free_rad2, double *covariance);

#endif

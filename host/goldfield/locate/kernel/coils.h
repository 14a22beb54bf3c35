/* The field of circular coils and its gradient at one point, and what a sensor measures of it with its derivatives.
 *
 * gf_sources() gives the field alone. A fit calls gf_weights() once an epoch, then gf_components() at each trial pose,
 * and gf_turn() for each step. No call keeps a state; n below is coils->count, at most GF_MOST_COILS.
 */
#ifndef GF_LOCATE_COILS_H
#define GF_LOCATE_COILS_H

#include "kernel.h"

typedef struct {
    double position_m[3];
    double rotation[3][3]; /* B_site = R B_sensor */
} gf_pose_t;

/* Structure of arrays, so that the compiler works on several coils at a time. */
typedef struct {
    double field_T[3][GF_MOST_COILS];
    double gradient_T_m[6][GF_MOST_COILS]; /* xx, yy, zz, xy, xz, yz: the curl vanishes, so the gradient is symmetric */
} gf_sources_t;

/* One row a component: coil by coil, the sensor's x, y, z. */
typedef struct {
    double value[3 * GF_MOST_COILS];
    double slope[3 * GF_MOST_COILS][6]; /* by position (1/m), then by a small turn in the site's frame (1/rad) */
} gf_components_t;

/* Field and gradient of each coil at a point of the site's frame. Exact for loops (arithmetic-geometric mean); the
 * results are not finite on a wire. */
void gf_sources(const gf_coils_t *coils, const double position_m[3], gf_sources_t *out);

/* The components that the sensor should measure, over their standard deviations, with derivatives. weight has 3 n
 * reciprocal standard deviations, 0 where nothing was measured. */
void gf_components(const gf_coils_t *coils, const gf_pose_t *pose, const double *weight, gf_components_t *out);

/* Reciprocal standard deviations of one epoch's components, 1/sqrt(sigma^2 + (model_error |B|)^2), 0 where nothing was
 * measured. field_T is n x 3, sigma_T n, weight n x 3. */
void gf_weights(size_t coils, const double *field_T, const double *sigma_T, double model_error, double *weight);

/* Turn by a rotation vector of the site's frame, rad: exp([vector]x) R. */
void gf_turn(double rotation[3][3], const double vector[3]);

#endif

/* Descent to a minimum of the cost of one epoch with complete vectors, as the search makes hundreds of.
 *
 * Fill in a gf_epoch_t once, gf_soften() it as wanted, then gf_descend() from poses. In contrast
 * to gf_minimise() everything counts against one limit of evaluations, a plane can hold the position while the rest of
 * the pose gives way, and the end is where the undamped step promises little: the damped one does so too early on
 * ridges.
 */
#ifndef GF_LOCATE_DESCENT_H
#define GF_LOCATE_DESCENT_H

#include <stdbool.h>

#include "coils.h"
#include "fit.h"

typedef struct {
    const gf_coils_t *coils;
    const double *field_T;        /* n x 3 in the sensor's frame; NaN for a coil that was not heard */
    const double *sigma_T;        /* n */
    double weight[GF_MOST_COILS]; /* inverse variance of a component, 0 if not heard; gf_soften() */
    size_t evaluations;           /* so far, of field and gradient of all coils */
    size_t most_evaluations;      /* after which nothing descends any more */
    bool held;                    /* whether the position moves only in a plane, */
    double normal[3];             /* and its unit normal */
} gf_epoch_t;

typedef struct {
    gf_pose_t pose;
    gf_squares_t squares;
    bool converged;
} gf_minimum_t;

/* Take a relative error of the model into the weights, 1/(sigma^2 + (error |b|)^2). */
void gf_soften(gf_epoch_t *epoch, double error);

/* Descend from minimum->pose by at most this many trials; fills in the rest. tolerance is the decrease of the cost that
 * counts as none. */
void gf_descend(gf_epoch_t *epoch, size_t trials, double tolerance, gf_minimum_t *minimum);

/* Pose error in the unknowns of the fit, from one pose to another: metres, then the rotation vector in
 * rad. */
void gf_difference(const gf_pose_t *from, const gf_pose_t *to, double out[6]);

/* Sum of d' N d. */
double gf_form(const double normal[6][6], const double d[6]);

#endif

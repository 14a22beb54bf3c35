/* What lies around a minimum: walks along its valley, passes to other minima, and the covariance of a curved valley. */
#ifndef GF_LOCATE_WALK_H
#define GF_LOCATE_WALK_H

#include "descent.h"

/* What a covariance lacks: a valley that bends leaves its tangent, which alone the information knows. */
typedef struct {
    gf_pose_t from;
    double cost;
    double information[6][6]; /* of the covariance as widened so far */
    double widening[6][6];    /* what was added to the covariance */
} gf_width_t;

/* Begin with the second-order covariance of a minimum (gf_covariance()) and no widening. Takes 13 evaluations. */
void gf_begin_width(gf_epoch_t *epoch, const gf_minimum_t *minimum, gf_width_t *width);

/* Widen so that a pose of this cost is no more improbable than its cost says: with nu = d' P^-1 d > 3 c, where c is the
 * rise of the cost, but at least 1, P += d d' (1/(3 c) - 1/nu). */
void gf_widen(gf_width_t *width, const gf_pose_t *pose, double cost);

/* Walk along the least determined direction of position from a minimum, ahead (sign 1) or back (-1), until the cost has
 * risen too far, widening on the way. Returns true if it came over a pass: then the pose beyond it is in out. Bound:
 * 200 evaluations. */
bool gf_walk(gf_epoch_t *epoch, const gf_minimum_t *from, double sign, gf_width_t *width, gf_pose_t *out);

/* Whether a way joins two minima on which the cost stays below the limit; on such a way the covariance is widened.
 * Bound: 40 evaluations. */
bool gf_joined(gf_epoch_t *epoch, const gf_minimum_t *from, const gf_minimum_t *to, double limit, gf_width_t *width);

#endif

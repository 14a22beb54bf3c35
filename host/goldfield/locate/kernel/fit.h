/* Nonlinear least squares by Levenberg and Marquardt for three unknowns (a position) or six (a pose).
 *
 * gf_minimise() calls back for the squares at a pose; the callback calls gf_clear() and then gf_add() for each
 * residual.
 */
#ifndef GF_LOCATE_FIT_H
#define GF_LOCATE_FIT_H

#include <stdbool.h>

#include "coils.h"

typedef struct {
    double cost;         /* Sum of squared whitened residuals, */
    double normal[6][6]; /* J' J, the upper left part of as many unknowns as there are, */
    double gradient[6];  /* and J' r, at a pose. */
} gf_squares_t;

/* Empty a sum before the first gf_add(). */
void gf_clear(gf_squares_t *squares);

/* Add one whitened residual with its slope: the model's derivative by each unknown. */
void gf_add(gf_squares_t *squares, size_t unknowns, double residual, const double slope[]);

/* What is minimised: fills in the squares at a pose. */
typedef void (*gf_evaluate_t)(const void *problem, const gf_pose_t *pose, gf_squares_t *squares);

/* Improve a pose until the next step promises to lower the cost by less than tolerance, or after this many trials.
 * Afterwards squares belongs to the pose; its cost is not finite if the start was hopeless. Returns whether it
 * converged. */
bool gf_minimise(gf_evaluate_t evaluate, const void *problem, size_t unknowns, size_t iterations, double tolerance,
                 gf_pose_t *pose, gf_squares_t *squares);

#endif

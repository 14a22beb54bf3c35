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

/* Add one whitened residual with its slope: the model's derivative by each unknown. Inline, so that the compiler
 * unrolls it. */
static inline void gf_add(gf_squares_t *squares, size_t unknowns, double residual, const double slope[]) {
    squares->cost += residual * residual;
    for (size_t k = 0; k < unknowns; ++k) {
        squares->gradient[k] += slope[k] * residual;
        for (size_t l = 0; l < unknowns; ++l) {
            squares->normal[k][l] += slope[k] * slope[l];
        }
    }
}

/* Add the residuals of all coils at a pose, where each coil is known with all three components or not at all: they are
 * compared in the site's frame, which is quicker. field_T is n x 3 in the sensor's frame; weight n, the inverse
 * variance of a component, 0 for a coil that was not heard. The sum was empty before. */
void gf_add_vectors(gf_squares_t *squares, const gf_coils_t *coils, const gf_pose_t *pose, const double *field_T,
                    const double *weight);

/* What is minimised: fills in the squares at a pose. */
typedef void (*gf_evaluate_t)(const void *problem, const gf_pose_t *pose, gf_squares_t *squares);

/* Improve a pose until the next step promises to lower the cost by less than tolerance, or after this many trials.
 * Afterwards squares belongs to the pose; its cost is not finite if the start was hopeless. evaluations is increased by
 * how often evaluate was called. Returns whether it converged. */
bool gf_minimise(gf_evaluate_t evaluate, const void *problem, size_t unknowns, size_t iterations, double tolerance,
                 gf_pose_t *pose, gf_squares_t *squares, size_t *evaluations);

#endif

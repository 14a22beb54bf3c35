/* pose_covariance.h: how far a fitted pose may be wrong, with the second-order terms of the model.
 *
 * Near a beacon the range is known to micrometres and the direction to centimetres. The poses that fit lie on a curved
 * ridge, and the Gauss-Newton covariance, which knows only its tangent, is overconfident many times across it.
 *
 * Method. With L L' the Gauss-Newton covariance, J the whitened Jacobian, and second differences over one standard
 * deviation along each of the six columns of L,
 *   q_ai = (J L)' (dJ_a L_i) / 2,   m = sum_a q_aa,
 *   covariance = L (I + (m m' + 2 sum_ai q_ai q_ai') / 4) L'.
 * The host computes the same in host/goldfield/locate/uncertainty.py.
 *
 * J is without what the sensor's errors explain of it; the turn by which all axes of the sensor lean alike is added.
 *
 * Time: about 15,700 instructions a beacon. Stack: 2 kB.
 */
#ifndef GOLDFIELD_POSE_COVARIANCE_H
#define GOLDFIELD_POSE_COVARIANCE_H

#include "core/pose/pose_fit.h"

/* Compute the covariance of the position (m) and a small turn in the site's frame (rad), of a fit by pose_fit. The
 * problem's weights become those around it.
 * Returns false, with a meaningless covariance, if the measurements do not tell all six. */
bool pose_covariance(pose_problem_t *problem, const pose_fit_t *fit,
                     float covariance[TRIANGLE_UNKNOWNS][TRIANGLE_UNKNOWNS]);

#endif

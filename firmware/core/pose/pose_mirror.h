/* pose_mirror.h: the images of a pose. Coils in a plane that point across it have the same fields at p mirrored, with
 * the sensor turned half around the normal; coils around a point have them at the place across it. What is nearly so
 * has images that nearly fit. The calls are pose_mirror_plane, then pose_mirror_reflect and pose_mirror_across.
 *
 * Time: about 60 instructions a beacon.
 */
#ifndef GOLDFIELD_POSE_MIRROR_H
#define GOLDFIELD_POSE_MIRROR_H

#include "core/pose/pose_fit.h"

/* Compute the plane of nearly coplanar coils that point across it: its unit normal, and as its point their mean; and of
 * any coils the square of how far the farthest is from that.
 * Returns false if there is no plane. */
bool pose_mirror_plane(const pose_problem_t *problem, float point_m[3], float normal[3], float *extent2_m2);

/* Compute position and attitude of a pose's image: p' = p - 2 (p - point) . n n, and half a turn about n, the
 * quaternion (n, 0), before the attitude's. */
void pose_mirror_reflect(const float point_m[3], const float n[3], const pose_fit_t *fit, pose_fit_t *image);

/* Returns whether the coils are nearly around the point, as seen from a position. */
bool pose_mirror_is_far(const float point_m[3], float extent2_m2, const float position_m[3]);

/* Compute position and attitude of a pose's image by the point: p' = point - (p - point), and the same attitude. The
 * image may be the pose itself. */
void pose_mirror_across(const float point_m[3], const pose_fit_t *fit, pose_fit_t *image);

#endif

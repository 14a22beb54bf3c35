/* pose_mirror.h: the mirror pose of coils in a plane that point across it. Exactly coplanar ones have the same fields
 * at p mirrored, with the sensor turned half around the normal. The calls are pose_mirror_plane, then
 * pose_mirror_reflect.
 *
 * Time: about 60 instructions a beacon.
 */
#ifndef GOLDFIELD_POSE_MIRROR_H
#define GOLDFIELD_POSE_MIRROR_H

#include "core/pose/pose_fit.h"

/* Compute the plane of nearly coplanar coils that point across it: its unit normal, and as its point their mean.
 * Returns false if the coils are not such. */
bool pose_mirror_plane(const pose_problem_t *problem, float point_m[3], float normal[3]);

/* Compute position and attitude of a pose's image: p' = p - 2 (p - point) . n n, and half a turn about n, the
 * quaternion (n, 0), before the attitude's. */
void pose_mirror_reflect(const float point_m[3], const float n[3], const pose_fit_t *fit, pose_fit_t *image);

#endif

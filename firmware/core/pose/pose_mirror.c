#include "core/pose/pose_mirror.h"

#include <string.h>

#include "core/math/roots.h"
#include "core/math/vector3.h"

/* Largest thickness over extent, tilt, and extent over the distance to the sensor, with which an image is tried. */
#define FLAT 0.25f

bool pose_mirror_plane(const pose_problem_t *problem, float point_m[3], float normal[3], float *extent2_m2) {
    memset(point_m, 0, 3u * sizeof *point_m);
    memset(normal, 0, 3u * sizeof *normal);
    for (uint32_t i = 0; i < problem->count; i++) {
        const loop_t *loop = &problem->heard[i].loop;
        const float sign = vector3_dot(loop->axis, problem->heard[0].loop.axis) < 0.0f ? -1.0f : 1.0f;
        for (uint32_t axis = 0; axis < 3u; axis++) {
            point_m[axis] += loop->centre_m[axis] / (float)problem->count;
            normal[axis] += sign * loop->axis[axis];
        }
    }
    const float scale = inverse_square_root(vector3_dot(normal, normal));
    float extent2 = 0.0f, thickness2 = 0.0f, least_cosine2 = 1.0f;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        normal[axis] *= scale;
    }
    for (uint32_t i = 0; i < problem->count; i++) {
        const loop_t *loop = &problem->heard[i].loop;
        float offset[3];
        vector3_subtract(loop->centre_m, point_m, offset);
        const float height = vector3_dot(offset, normal), cosine = vector3_dot(loop->axis, normal),
                    distance2 = vector3_dot(offset, offset);
        thickness2 = height * height > thickness2 ? height * height : thickness2;
        extent2 = distance2 > extent2 ? distance2 : extent2;
        least_cosine2 = cosine * cosine < least_cosine2 ? cosine * cosine : least_cosine2;
    }
    *extent2_m2 = extent2;
    return thickness2 <= FLAT * FLAT * extent2 && least_cosine2 >= 1.0f - FLAT * FLAT;
}

void pose_mirror_reflect(const float point_m[3], const float n[3], const pose_fit_t *fit, pose_fit_t *image) {
    float offset[3], turned[3];
    const float *q = fit->quaternion;
    vector3_subtract(fit->position_m, point_m, offset);
    const float height = vector3_dot(offset, n);
    vector3_cross(n, q, turned);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        image->position_m[axis] = fit->position_m[axis] - 2.0f * height * n[axis];
        image->quaternion[axis] = q[3] * n[axis] + turned[axis];
    }
    image->quaternion[3] = -vector3_dot(n, q);
}

bool pose_mirror_is_far(const float point_m[3], float extent2_m2, const float position_m[3]) {
    float offset[3];
    vector3_subtract(position_m, point_m, offset);
    return extent2_m2 <= FLAT * FLAT * vector3_dot(offset, offset);
}

void pose_mirror_across(const float point_m[3], const pose_fit_t *fit, pose_fit_t *image) {
    for (uint32_t axis = 0; axis < 3u; axis++) {
        image->position_m[axis] = 2.0f * point_m[axis] - fit->position_m[axis];
    }
    memmove(image->quaternion, fit->quaternion, sizeof image->quaternion);
}

#include "core/pose/pose_problem.h"

#include <string.h>

#include "core/math/chi_square.h"
#include "core/math/microtesla.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"

#define ANY_NOISE 4.753f /* Normal deviate of the fields themselves, which noise exceeds in one of a million. */
#define GREATEST  1e15f  /* Largest field that is taken, uT; beyond it squares overflow. */

static bool hear(const pose_site_t *site, const pose_field_t *fields, uint32_t row, pose_heard_t *heard) {
    const pose_beacon_t *beacon = &site->beacons[row];
    const pose_field_t *measured = &fields[row];
    const float length2 = vector3_dot(beacon->axis, beacon->axis);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        heard->field_uT[axis] = MICROTESLA * measured->field_T[axis];
        heard->loop.axis[axis] = beacon->axis[axis] * inverse_square_root(length2);
        heard->loop.centre_m[axis] = beacon->position_m[axis];
    }
    heard->row = row;
    heard->position_sd_m = beacon->position_sd_m;
    heard->axis_sd_rad = beacon->axis_sd_rad;
    heard->current_sd = beacon->current_sd;
    heard->magnitude_uT = square_root(vector3_dot(heard->field_uT, heard->field_uT));
    heard->sigma_uT = MICROTESLA * measured->sigma_T;
    heard->loop.k_uT_m3 = UT_M3_PER_A_M2 * beacon->moment_A_m2;
    heard->loop.radius_m = beacon->radius_m > 0.0f ? beacon->radius_m : 0.0f;
    return length2 > 0.0f && beacon->moment_A_m2 != 0.0f && heard->sigma_uT > 0.0f && heard->sigma_uT < GREATEST &&
           heard->magnitude_uT > 0.0f && heard->magnitude_uT < GREATEST; /* False also for what is not a number. */
}

void pose_problem(const pose_site_t *site, const pose_field_t *fields, pose_problem_t *problem) {
    float most = 0.0f;
    problem->count = 0;
    problem->exact_beacons = true;
    memset(problem->origin_m, 0, sizeof problem->origin_m);
    for (uint32_t i = 0; i < site->count && i < POSE_BEACONS_MAX; i++) {
        pose_heard_t *heard = &problem->heard[problem->count];
        if (hear(site, fields, i, heard)) {
            problem->count++;
            problem->exact_beacons = problem->exact_beacons && !(heard->position_sd_m > 0.0f) &&
                                     !(heard->axis_sd_rad > 0.0f) && !(heard->current_sd > 0.0f);
            if (heard->magnitude_uT > most) {
                most = heard->magnitude_uT;
                memcpy(problem->origin_m, site->beacons[i].position_m, sizeof problem->origin_m);
            }
        }
    }
    for (uint32_t i = 0; i < problem->count; i++) {
        vector3_subtract(problem->heard[i].loop.centre_m, problem->origin_m, problem->heard[i].loop.centre_m);
    }
    vector3_subtract(site->half_space_point_m, problem->origin_m, problem->point_m);
    memcpy(problem->normal, site->half_space_normal, sizeof problem->normal);
    problem->alert_limit_m = site->alert_limit_m;
    problem->gain_sd = site->gain_sd;
    problem->axis_sd_rad = site->axis_sd_rad;
}

uint32_t pose_problem_freedom(const pose_problem_t *problem) {
    return 3u * problem->count - 6u;
}

bool pose_problem_audible(const pose_problem_t *problem) {
    float energy = 0.0f;
    for (uint32_t i = 0; i < problem->count; i++) {
        const float ratio = problem->heard[i].magnitude_uT / problem->heard[i].sigma_uT;
        energy += ratio * ratio;
    }
    return energy > chi_square_limit(3.0f * (float)problem->count, ANY_NOISE);
}

bool pose_problem_inside(const pose_problem_t *problem, const float position_m[3]) {
    float offset[3];
    vector3_subtract(position_m, problem->point_m, offset);
    return vector3_dot(offset, problem->normal) >= 0.0f;
}

float pose_problem_nearest2(const pose_problem_t *problem, const float position_m[3]) {
    float least = GREATEST;
    for (uint32_t i = 0; i < problem->count; i++) {
        float offset[3];
        vector3_subtract(position_m, problem->heard[i].loop.centre_m, offset);
        const float distance2 = vector3_dot(offset, offset);
        least = distance2 < least ? distance2 : least;
    }
    return least;
}

void pose_problem_negate(pose_problem_t *problem) {
    const float reversed[3] = {-1.0f, -1.0f, -1.0f};
    pose_problem_scale(problem, reversed);
}

void pose_problem_scale(pose_problem_t *problem, const float scale[3]) {
    for (uint32_t i = 0; i < problem->count; i++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            problem->heard[i].field_uT[axis] *= scale[axis];
        }
    }
}

void pose_problem_leave_out(pose_problem_t *problem, uint32_t place, bool out) {
    const uint32_t last = out ? problem->count - 1u : problem->count;
    const pose_heard_t heard = problem->heard[place];
    problem->heard[place] = problem->heard[last];
    problem->heard[last] = heard;
    problem->count = out ? last : last + 1u;
}

#include "core/pose/pose.h"

#include <string.h>

#include "core/math/quaternion.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"
#include "core/pose/pose_covariance.h"

#define MICROTESLA        1e6f   /* Microtesla in a tesla. */
#define UT_M3_PER_A_M2    0.1f   /* mu0 / (4 pi) in uT m^3 for each A m^2. */
#define ENOUGH_BEACONS    4u     /* Fewest beacons with one answer; with fewer all candidates are fitted. */
#define LEAST_EVALUATIONS 12u    /* Fewest evaluations that are worth the name of a fit. */
#define RIVAL_COST        15.0f  /* Distance in cost of a rival: a pose so much worse is right in one case of e^7.5. */
#define SUSPECT           2.326f /* Normal deviate, one-sided, beyond which a cost is suspect: 1 in 100. */
#define IMPROBABLE        3.54f  /* Normal deviate beyond which a cost is improbable: 1 in 5,000. */
#define FLAT              0.25f  /* Largest thickness over extent, and tilt, with which the mirror pose is tried. */
#define WEAK_POSITION     0.25f  /* Largest deviation of the position, over the distance to the nearest beacon. */
#define WEAK_ATTITUDE_RAD 0.5f   /* Largest deviation of the attitude, rad; beyond either nothing linear holds. */
#define GREATEST          1e15f  /* Largest field that is taken, uT; beyond it squares overflow. */

/* Returns the chi-square that is exceeded with the probability of a normal deviate (Wilson and Hilferty, 1931). */
static float chi_square(uint32_t freedom, float deviate) {
    const float f = (float)freedom, part = 2.0f / (9.0f * f);
    const float root = 1.0f - part + deviate * square_root(part);
    return f * root * root * root;
}

static uint32_t freedom(const pose_problem_t *problem) {
    return 3u * problem->count - TRIANGLE_UNKNOWNS;
}

static bool explains(const pose_problem_t *problem, const pose_fit_t *fit, float deviate) {
    return fit->cost <= chi_square(freedom(problem), deviate);
}

/* ---- From site and fields to the problem ---- */

static bool hear(const pose_beacon_t *beacon, const pose_field_t *measured, pose_heard_t *heard) {
    const float length2 = vector3_dot(beacon->axis, beacon->axis);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        heard->field_uT[axis] = MICROTESLA * measured->field_T[axis];
        heard->loop.axis[axis] = beacon->axis[axis] * inverse_square_root(length2);
        heard->loop.centre_m[axis] = beacon->position_m[axis];
    }
    heard->magnitude_uT = square_root(vector3_dot(heard->field_uT, heard->field_uT));
    heard->sigma_uT = MICROTESLA * measured->sigma_T;
    heard->loop.k_uT_m3 = UT_M3_PER_A_M2 * beacon->moment_A_m2;
    heard->loop.radius_m = beacon->radius_m > 0.0f ? beacon->radius_m : 0.0f;
    return length2 > 0.0f && beacon->moment_A_m2 != 0.0f && heard->sigma_uT > 0.0f && heard->sigma_uT < GREATEST &&
           heard->magnitude_uT > 0.0f && heard->magnitude_uT < GREATEST; /* False also for what is not a number. */
}

static void pose_problem(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work) {
    pose_problem_t *problem = &work->problem;
    float most = 0.0f;
    problem->count = 0;
    memset(work->origin_m, 0, sizeof work->origin_m);
    for (uint32_t i = 0; i < site->count && i < POSE_BEACONS_MAX; i++) {
        pose_heard_t *heard = &problem->heard[problem->count];
        if (hear(&site->beacons[i], &fields[i], heard)) {
            problem->count++;
            if (heard->magnitude_uT > most) {
                most = heard->magnitude_uT;
                memcpy(work->origin_m, site->beacons[i].position_m, sizeof work->origin_m);
            }
        }
    }
    for (uint32_t i = 0; i < problem->count; i++) {
        vector3_subtract(problem->heard[i].loop.centre_m, work->origin_m, problem->heard[i].loop.centre_m);
    }
    vector3_subtract(site->half_space_point_m, work->origin_m, work->point_m);
    memcpy(work->normal, site->half_space_normal, sizeof work->normal);
}

static bool inside(const pose_work_t *work, const pose_fit_t *fit) {
    float offset[3];
    vector3_subtract(fit->position_m, work->point_m, offset);
    return vector3_dot(offset, work->normal) >= 0.0f;
}

static float nearest2(const pose_problem_t *problem, const float position_m[3]) {
    float least = GREATEST;
    for (uint32_t i = 0; i < problem->count; i++) {
        float offset[3];
        vector3_subtract(position_m, problem->heard[i].loop.centre_m, offset);
        const float distance2 = vector3_dot(offset, offset);
        least = distance2 < least ? distance2 : least;
    }
    return least;
}

/* Returns whether two fits are different poses: apart by a twentieth of the distance to the nearest beacon, or by 0.2
 * rad. */
static bool different(const pose_problem_t *problem, const pose_fit_t *a, const pose_fit_t *b) {
    float offset[3], overlap = 0.0f;
    vector3_subtract(a->position_m, b->position_m, offset);
    for (uint32_t i = 0; i < 4u; i++) {
        overlap += a->quaternion[i] * b->quaternion[i]; /* The cosine of half the angle between. */
    }
    return vector3_dot(offset, offset) > 0.0025f * nearest2(problem, a->position_m) || overlap * overlap < 0.99f;
}

/* ---- The mirror ---- */

/* Computes the plane of nearly coplanar coils that point across it: its unit normal, and as its point their mean.
 * Returns false if the coils are not such. */
static bool mirror_plane(const pose_problem_t *problem, float point_m[3], float normal[3]) {
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
    return thickness2 <= FLAT * FLAT * extent2 && least_cosine2 >= 1.0f - FLAT * FLAT;
}

/* The image of a pose lies at p' = p - 2 (p - point) . n n. The sensor makes half a turn about n: the quaternion (n,
 * 0) before the attitude's. */
static void reflect(const float point_m[3], const float n[3], const pose_fit_t *fit, pose_fit_t *image) {
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

/* ---- Result ---- */

/* Returns whether the greatest eigenvalue of a symmetric matrix is beyond a limit: limit I - matrix then is not
 * positive definite (Sylvester). */
static bool beyond(const float m[3][3], float limit) {
    const float a = limit - m[0][0], b = limit - m[1][1], c = limit - m[2][2];
    const float minor = a * b - m[0][1] * m[0][1];
    const float determinant = minor * c - a * m[1][2] * m[1][2] - b * m[0][2] * m[0][2] -
                              2.0f * m[0][1] * m[1][2] * m[0][2];
    return !(a > 0.0f && minor > 0.0f && determinant > 0.0f);
}

/* Puts the best fit, and whether it has a rival, into *pose. */
static void conclude(pose_work_t *work, bool contested, pose_t *pose) {
    const pose_problem_t *problem = &work->problem;
    float point[3], normal[3], covariance[TRIANGLE_UNKNOWNS][TRIANGLE_UNKNOWNS];
    if (mirror_plane(problem, point, normal)) {
        reflect(point, normal, &work->best, &work->image);
        pose->iterations += pose_fit(problem, POSE_MIRROR_EVALUATIONS, &work->image);
        if (different(problem, &work->image, &work->best) && work->image.cost - work->best.cost < RIVAL_COST) {
            const bool here = inside(work, &work->best), there = inside(work, &work->image);
            contested = contested || here == there;
            if (here == there ? work->image.cost < work->best.cost - 1.0f : there) {
                work->best = work->image;
            }
        }
    }
    const pose_fit_t *best = &work->best;
    if (!pose_covariance(problem, best, covariance)) {
        pose->status = POSE_FAILED;
        return;
    }
    const float sign = best->quaternion[3] < 0.0f ? -1.0f : 1.0f;
    for (uint32_t row = 0; row < 3u; row++) {
        pose->position_m[row] = best->position_m[row] + work->origin_m[row];
        for (uint32_t column = 0; column < 3u; column++) {
            pose->position_cov_m2[row][column] = covariance[row][column];
            pose->attitude_cov_rad2[row][column] = covariance[3u + row][3u + column];
        }
    }
    for (uint32_t i = 0; i < 4u; i++) {
        pose->quaternion[i] = sign * best->quaternion[i];
    }
    const uint32_t degrees = freedom(problem);
    const bool weak = beyond((const float(*)[3])pose->position_cov_m2,
                             WEAK_POSITION * WEAK_POSITION * nearest2(problem, best->position_m)) ||
                      beyond((const float(*)[3])pose->attitude_cov_rad2, WEAK_ATTITUDE_RAD * WEAK_ATTITUDE_RAD);
    pose->residual = square_root(best->cost / (float)degrees);
    pose->status = !explains(problem, best, IMPROBABLE) || !inside(work, best) ? POSE_INCONSISTENT
                   : contested                                                 ? POSE_AMBIGUOUS
                   : weak                                                      ? POSE_WEAK
                                                                               : POSE_OK;
}

/* Notes a fit with the noise alone. *rival becomes the least cost of another pose. */
static void note(pose_work_t *work, const pose_fit_t *fit, float *rival) {
    pose_fit_t *best = &work->best;
    const bool other = best->cost < POSE_FIT_HOPELESS && different(&work->problem, best, fit) && inside(work, fit) &&
                       inside(work, best);
    const float worse = fit->cost > best->cost ? fit->cost : best->cost;
    *rival = other && worse < *rival ? worse : *rival;
    if (fit->cost < best->cost) {
        *best = *fit;
    }
}

/* Fits the candidates that are plausible with model error, or else the least implausible; the best goes into
 * work->best. Returns true if another pose explains the fields as well. */
static bool fit_candidates(pose_work_t *work, uint32_t *iterations) {
    const pose_problem_t *problem = &work->problem;
    const pose_candidates_t *candidates = &work->candidates;
    pose_fit_t *fit = &work->other, *last_resort = &work->image;
    uint32_t left = POSE_FIND_EVALUATIONS;
    float rival = POSE_FIT_HOPELESS;
    work->best.cost = last_resort->cost = POSE_FIT_HOPELESS;
    for (uint32_t i = 0; i < candidates->count && left >= POSE_ROBUST_EVALUATIONS + LEAST_EVALUATIONS; i++) {
        memcpy(fit->position_m, candidates->candidates[i].position_m, sizeof fit->position_m);
        pose_search_attitude(problem, fit->position_m, fit->quaternion);
        left -= pose_fit_robust(problem, POSE_ROBUST_EVALUATIONS, fit);
        if (explains(problem, fit, SUSPECT)) {
            left -= pose_fit(problem, left, fit);
            note(work, fit, &rival);
        } else if (fit->cost < last_resort->cost) {
            *last_resort = *fit;
        }
        if (problem->count >= ENOUGH_BEACONS && inside(work, &work->best) && explains(problem, &work->best, SUSPECT)) {
            break;
        }
    }
    if (work->best.cost >= POSE_FIT_HOPELESS && last_resort->cost < POSE_FIT_HOPELESS) {
        work->best = *last_resort;
        left -= pose_fit(problem, left, &work->best);
    }
    *iterations += POSE_FIND_EVALUATIONS - left;
    return rival - work->best.cost < RIVAL_COST;
}

static void begin(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose) {
    pose_problem(site, fields, work);
    pose->used = work->problem.count;
    pose->iterations = 0;
    pose->tracked = false;
}

static void search(pose_work_t *work, pose_t *pose) {
    pose->status = POSE_FAILED;
    if (work->problem.count >= POSE_BEACONS_LEAST) {
        pose_search(&work->problem, work->point_m, work->normal, &work->candidates);
        const bool contested = fit_candidates(work, &pose->iterations);
        if (work->best.cost < POSE_FIT_HOPELESS) {
            conclude(work, contested, pose);
        }
    }
}

void pose_find(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose) {
    begin(site, fields, work, pose);
    search(work, pose);
}

void pose_track(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose) {
    const bool known = pose->status != POSE_FAILED;
    begin(site, fields, work, pose);
    if (known && work->problem.count >= ENOUGH_BEACONS) {
        vector3_subtract(pose->position_m, work->origin_m, work->best.position_m);
        memcpy(work->best.quaternion, pose->quaternion, sizeof pose->quaternion);
        pose->iterations += pose_fit(&work->problem, POSE_TRACK_EVALUATIONS, &work->best);
        if (inside(work, &work->best) && explains(&work->problem, &work->best, IMPROBABLE)) {
            pose->tracked = true;
            conclude(work, false, pose);
            return;
        }
    }
    search(work, pose);
}

#include "core/pose/pose.h"

#include <string.h>

#include "core/math/quaternion.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"
#include "core/pose/pose_covariance.h"
#include "core/pose/pose_mirror.h"

#define MICROTESLA        1e6f   /* Microtesla in a tesla. */
#define UT_M3_PER_A_M2    0.1f   /* mu0 / (4 pi) in uT m^3 for each A m^2. */
#define ENOUGH_BEACONS    4u     /* Fewest beacons with one answer; with fewer all candidates are fitted. */
#define LEAST_EVALUATIONS 12u    /* Fewest evaluations that are worth the name of a fit. */
#define RIVAL_COST        15.0f  /* Distance in cost of a rival: a pose so much worse is right in one case of e^7.5. */
#define SUSPECT           2.326f /* Normal deviate, one-sided, beyond which a cost is suspect: 1 in 100. */
#define ANY_NOISE         4.753f /* Normal deviate of the fields themselves, which noise exceeds in one of a million. */
#define NEGATED           4.265f /* Normal deviate up to which the negated fields are explained: 1 in 100,000. */
#define CLEARLY           25.0f  /* What the next best explanation must cost more for a beacon to be left out. */
#define WEAK_POSITION     0.25f  /* Largest deviation of the position, over the distance to the nearest beacon. */
#define WEAK_ATTITUDE_RAD 0.5f   /* Largest deviation of the attitude, rad; beyond either nothing linear holds. */
#define LEAST_GAIN        0.3f   /* Least gain of an axis that one round of fitting the gains takes. */
#define SAME_GAIN         0.06f  /* Largest difference of gains that are one strength. */
#define GREATEST          1e15f  /* Largest field that is taken, uT; beyond it squares overflow. */

static uint32_t freedom(const pose_problem_t *problem) {
    return 3u * problem->count - TRIANGLE_UNKNOWNS;
}

static bool explains(const pose_problem_t *problem, const pose_fit_t *fit, float deviate) {
    return fit->cost <= pose_faults_chi_square(freedom(problem), deviate);
}

/* ---- From site and fields to the problem ---- */

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
        if (hear(site, fields, i, heard)) {
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
    work->alert_limit_m = site->alert_limit_m;
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

/* Goes over to the mirror image of the best fit, if there is one that is better or on the right side. Returns whether
 * both explain the fields. */
static bool settle(pose_work_t *work, pose_t *pose) {
    const pose_problem_t *problem = &work->problem;
    float point[3], normal[3];
    if (!pose_mirror_plane(problem, point, normal)) {
        return false;
    }
    pose_mirror_reflect(point, normal, &work->best, &work->image);
    pose->iterations += pose_fit(problem, POSE_MIRROR_EVALUATIONS, &work->image);
    if (!different(problem, &work->image, &work->best) || work->image.cost - work->best.cost >= RIVAL_COST) {
        return false;
    }
    const bool here = inside(work, &work->best), there = inside(work, &work->image);
    if (here == there ? work->image.cost < work->best.cost - 1.0f : there) {
        work->best = work->image;
    }
    return here == there;
}

static bool fail(pose_t *pose, pose_reason_t reason) {
    pose->status = POSE_FAILED;
    pose->reason = reason;
    return true;
}

/* Puts the best fit into *pose. wrong says what is wrong with it, POSE_REASON_NONE if it explains the fields. Returns
 * true: the pose is complete. */
static bool conclude(pose_work_t *work, pose_reason_t wrong, bool contested, pose_t *pose) {
    const pose_problem_t *problem = &work->problem;
    const pose_fit_t *best = &work->best;
    float covariance[TRIANGLE_UNKNOWNS][TRIANGLE_UNKNOWNS];
    if (!pose_covariance(problem, best, covariance)) {
        return fail(pose, POSE_REASON_NO_POSE);
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
    const bool weak = beyond((const float(*)[3])pose->position_cov_m2,
                             WEAK_POSITION * WEAK_POSITION * nearest2(problem, best->position_m)) ||
                      beyond((const float(*)[3])pose->attitude_cov_rad2, WEAK_ATTITUDE_RAD * WEAK_ATTITUDE_RAD);
    pose->residual = square_root(best->cost / (float)freedom(problem));
    pose->protection_m = work->faults.level_m;
    pose->used = problem->count;
    const bool unsafe = !(pose->protection_m <= work->alert_limit_m);
    wrong = wrong == POSE_REASON_NONE && !inside(work, best) ? POSE_REASON_HALF_SPACE : wrong;
    pose->status = wrong != POSE_REASON_NONE ? POSE_INCONSISTENT
                   : contested               ? POSE_AMBIGUOUS
                   : weak                    ? POSE_WEAK
                   : unsafe                  ? POSE_UNVERIFIED
                                             : POSE_OK;
    pose->reason = wrong != POSE_REASON_NONE ? wrong
                   : contested               ? POSE_REASON_RIVAL
                   : weak                    ? POSE_REASON_WEAK
                   : unsafe                  ? POSE_REASON_UNVERIFIED
                                             : POSE_REASON_NONE;
    return true;
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
 * work->best. budget bounds the evaluations. Returns true if another pose explains the fields as well. */
static bool fit_candidates(pose_work_t *work, uint32_t budget, uint32_t *iterations) {
    const pose_problem_t *problem = &work->problem;
    const pose_candidates_t *candidates = &work->candidates;
    pose_fit_t *fit = &work->other, *last_resort = &work->image;
    uint32_t left = budget;
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
    *iterations += budget - left;
    return rival - work->best.cost < RIVAL_COST;
}

/* Searches with no prior; the best fit goes into work->best. Returns true if another pose explains the fields as well.
 */
static bool search(pose_work_t *work, uint32_t directions, uint32_t budget, pose_t *pose) {
    pose_search(&work->problem, directions, work->point_m, work->normal, &work->candidates);
    return fit_candidates(work, budget, &pose->iterations);
}

/* Returns whether the fields are more than noise. */
static bool audible(const pose_problem_t *problem) {
    float energy = 0.0f;
    for (uint32_t i = 0; i < problem->count; i++) {
        const float ratio = problem->heard[i].magnitude_uT / problem->heard[i].sigma_uT;
        energy += ratio * ratio;
    }
    return energy > pose_faults_chi_square(3u * problem->count, ANY_NOISE);
}

/* ---- Steps ---- */

/* Step 1: the pose by all beacons. */
static bool by_all(pose_work_t *work, pose_t *pose) {
    const pose_problem_t *problem = &work->problem;
    if (problem->count < POSE_BEACONS_LEAST) {
        return fail(pose, POSE_REASON_FEW);
    }
    if (!audible(problem)) {
        return fail(pose, POSE_REASON_NOISE);
    }
    if (work->known && problem->count >= ENOUGH_BEACONS) {
        pose->iterations += pose_fit(problem, POSE_TRACK_EVALUATIONS, &work->best);
        if (inside(work, &work->best) && pose_faults(problem, &work->best, &work->faults) && !work->faults.alarm) {
            pose->tracked = true;
            const bool contested = settle(work, pose);
            return conclude(work, POSE_REASON_NONE, contested, pose);
        }
    }
    work->contested = search(work, POSE_FIND_DIRECTIONS, POSE_FIND_EVALUATIONS, pose);
    if (work->best.cost >= POSE_FIT_HOPELESS) {
        return fail(pose, POSE_REASON_NO_POSE);
    }
    work->contested = settle(work, pose) || work->contested;
    if (!pose_faults(problem, &work->best, &work->faults)) {
        if (explains(problem, &work->best, SUSPECT)) {
            return fail(pose, POSE_REASON_NO_POSE);
        }
    } else if (!work->faults.alarm) {
        return conclude(work, POSE_REASON_NONE, work->contested, pose);
    }
    work->full = work->best;
    work->step = POSE_STEP_NEGATED;
    return false;
}

static void negate(pose_problem_t *problem) {
    for (uint32_t i = 0; i < problem->count; i++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            problem->heard[i].field_uT[axis] *= -1.0f;
        }
    }
}

/* Returns to the pose by all beacons, which does not explain the fields. */
static bool unexplained(pose_work_t *work, pose_reason_t reason, pose_t *pose) {
    work->best = work->full;
    if (!pose_faults(&work->problem, &work->best, &work->faults)) {
        return fail(pose, POSE_REASON_NO_POSE);
    }
    return conclude(work, reason, false, pose);
}

/* Step 2: the negated fields. */
static bool by_negated(pose_work_t *work, pose_t *pose) {
    negate(&work->problem);
    (void)search(work, POSE_FIND_DIRECTIONS, POSE_FIND_EVALUATIONS, pose);
    work->next_cost = work->best.cost;
    const bool mirrored = explains(&work->problem, &work->best, NEGATED) &&
                          work->full.cost - work->best.cost >= CLEARLY;
    negate(&work->problem);
    if (mirrored || work->problem.count < POSE_LEFT_OUT_LEAST) {
        return unexplained(work, mirrored ? POSE_REASON_NEGATED : POSE_REASON_UNEXPLAINED, pose);
    }
    work->step = POSE_STEP_GAINS;
    return false;
}

static void scale_axes(pose_problem_t *problem, const float scale[3]) {
    for (uint32_t i = 0; i < problem->count; i++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            problem->heard[i].field_uT[axis] *= scale[axis];
        }
    }
}

/* Step 3: another strength of all fields, or other gains of the sensor's axes. */
static bool by_gains(pose_work_t *work, pose_t *pose) {
    pose_problem_t *problem = &work->problem;
    float total[3] = {1.0f, 1.0f, 1.0f};
    work->best = work->full;
    for (uint32_t round = 0; round < POSE_GAIN_ROUNDS && pose_faults(problem, &work->best, &work->faults); round++) {
        float scale[3];
        for (uint32_t axis = 0; axis < 3u; axis++) {
            const float gain = 1.0f + work->faults.gain[axis];
            scale[axis] = 1.0f / (gain > LEAST_GAIN ? gain < 1.0f / LEAST_GAIN ? gain : 1.0f / LEAST_GAIN : LEAST_GAIN);
            total[axis] *= scale[axis];
        }
        scale_axes(problem, scale);
        pose->iterations += pose_fit(problem, POSE_MIRROR_EVALUATIONS, &work->best);
    }
    const float back[3] = {1.0f / total[0], 1.0f / total[1], 1.0f / total[2]};
    scale_axes(problem, back);
    const float mean = (total[0] + total[1] + total[2]) / 3.0f;
    bool same = true;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float apart = total[axis] / mean - 1.0f;
        same = same && apart < SAME_GAIN && apart > -SAME_GAIN;
    }
    work->next_cost = work->best.cost < work->next_cost ? work->best.cost : work->next_cost;
    work->whole = !explains(problem, &work->best, NEGATED) ? POSE_REASON_UNEXPLAINED
                  : same                                   ? POSE_REASON_STRENGTH
                                                           : POSE_REASON_GAINS;
    work->tried = 0;
    work->rest.cost = POSE_FIT_HOPELESS;
    work->step = POSE_STEP_WITHOUT;
    if (!pose_faults(problem, &work->full, &work->faults)) { /* It tells nothing of who is suspect. */
        memset(work->faults.drop, 0, sizeof work->faults.drop);
    }
    return false;
}

/* Takes the beacon of a place out of the problem, or, called again, puts it back. */
static void leave_out(pose_problem_t *problem, uint32_t place, bool out) {
    const uint32_t last = out ? problem->count - 1u : problem->count;
    const pose_heard_t heard = problem->heard[place];
    problem->heard[place] = problem->heard[last];
    problem->heard[last] = heard;
    problem->count = out ? last : last + 1u;
}

/* Steps 4: without the most suspect beacon that has not been left out yet. */
static bool without_one(pose_work_t *work, pose_t *pose) {
    pose_problem_t *problem = &work->problem;
    uint32_t place = 0;
    for (uint32_t i = 1; i < problem->count; i++) {
        place = work->faults.drop[i] > work->faults.drop[place] ? i : place;
    }
    work->faults.drop[place] = -1.0f; /* Drops are not below 0. */
    leave_out(problem, place, true);
    const bool contested = search(work, POSE_WITHOUT_DIRECTIONS, POSE_WITHOUT_EVALUATIONS, pose);
    leave_out(problem, place, false);
    if (work->best.cost < work->rest.cost) {
        work->next_cost = work->rest.cost < work->next_cost ? work->rest.cost : work->next_cost;
        work->rest = work->best;
        work->rest_contested = contested;
        work->left_out = place;
    } else if (work->best.cost < work->next_cost) {
        work->next_cost = work->best.cost;
    }
    work->tried++;
    if (work->tried == problem->count || work->tried == POSE_LEFT_OUT_TRIED) {
        work->step = POSE_STEP_DECIDE;
    }
    return false;
}

/* Step 5: whether one beacon is to be left out. */
static bool decide(pose_work_t *work, pose_t *pose) {
    pose_problem_t *problem = &work->problem;
    for (uint32_t i = 0; i < problem->count && work->rest.cost < POSE_FIT_HOPELESS; i++) {
        if (i != work->left_out) { /* From the best one's pose: a search may have missed it. */
            work->other = work->rest;
            leave_out(problem, i, true);
            pose->iterations += pose_fit(problem, POSE_MIRROR_EVALUATIONS, &work->other);
            leave_out(problem, i, false);
            work->next_cost = work->other.cost < work->next_cost ? work->other.cost : work->next_cost;
        }
    }
    leave_out(problem, work->left_out, true);
    work->best = work->rest;
    const bool contested = settle(work, pose) || work->rest_contested;
    const bool agrees = explains(problem, &work->best, SUSPECT) && pose_faults(problem, &work->best, &work->faults) &&
                        !work->faults.alarm;
    if (agrees && work->next_cost - work->best.cost >= CLEARLY) {
        (void)conclude(work, POSE_REASON_NONE, contested, pose);
        pose->reason = pose->status == POSE_OK ? POSE_REASON_LEFT_OUT : pose->reason;
        pose->left_out = problem->heard[problem->count].row;
        return true;
    }
    leave_out(problem, work->left_out, false);
    return unexplained(work, work->whole == POSE_REASON_UNEXPLAINED && agrees ? POSE_REASON_BEACON : work->whole, pose);
}

void pose_begin(const pose_site_t *site, const pose_field_t *fields, bool track, pose_work_t *work, pose_t *pose) {
    pose_problem(site, fields, work);
    work->known = track && pose->status != POSE_FAILED;
    if (work->known) {
        vector3_subtract(pose->position_m, work->origin_m, work->best.position_m);
        memcpy(work->best.quaternion, pose->quaternion, sizeof pose->quaternion);
    }
    work->step = POSE_STEP_ALL;
    pose->used = work->problem.count;
    pose->left_out = POSE_NOBODY;
    pose->iterations = 0;
    pose->tracked = false;
}

bool pose_step(pose_work_t *work, pose_t *pose) {
    switch (work->step) {
    case POSE_STEP_ALL:
        return by_all(work, pose);
    case POSE_STEP_NEGATED:
        return by_negated(work, pose);
    case POSE_STEP_GAINS:
        return by_gains(work, pose);
    case POSE_STEP_WITHOUT:
        return without_one(work, pose);
    default:
        return decide(work, pose);
    }
}

void pose_find(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose) {
    pose_begin(site, fields, false, work, pose);
    while (!pose_step(work, pose)) {
    }
}

void pose_track(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose) {
    pose_begin(site, fields, true, work, pose);
    while (!pose_step(work, pose)) {
    }
}

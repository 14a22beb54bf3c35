#include "services/tracking_judge.h"

#include "core/math/microtesla.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"

#define WEAK_ATTITUDE 0.5f  /* Standard deviation of the attitude beyond which nothing linear holds, rad. */
#define PROTECTION_SD 3.29f /* Deviate of what noise alone exceeds in one of a thousand cases. */
/* What errors of second order add to the field of a dipole, over the field and the square of their part of the
 * distance: half of 3 times 4. */
#define CURVATURE 6.0f
/* Largest such part of a field over its noise: tracks from more of it drift, and poses of cycles farther from all
 * coils, where the track itself knows better, have less. */
#define VAGUE 3.0f

bool tracking_is_out(const tracking_t *tracking, uint32_t row) {
    return row == tracking->verdict.left_out || row == tracking->suspect || tracking->coils[row].k_uT_m3 == 0.0f;
}

static float trace(const float matrix[3][3]) {
    return matrix[0][0] + matrix[1][1] + matrix[2][2];
}

static float deviation(const float covariance[3][3]) {
    return square_root(trace(covariance));
}

float tracking_nearest_m(const tracking_t *tracking, const float position_m[3]) {
    float nearest2 = 1e30f;
    for (uint32_t i = 0; i < tracking->count; i++) {
        float away[3];
        vector3_subtract(position_m, tracking->coils[i].centre_m, away);
        const float away2 = vector3_dot(away, away);
        nearest2 = !tracking_is_out(tracking, i) && away2 < nearest2 ? away2 : nearest2;
    }
    return square_root(nearest2);
}

/* Returns whether nothing linear holds over the errors of a pose. */
static bool is_weak(const tracking_t *tracking, const pose_t *pose) {
    return deviation(pose->attitude_cov_rad2) > WEAK_ATTITUDE ||
           deviation(pose->position_cov_m2) > TRACKING_WEAK_DISTANCE * tracking_nearest_m(tracking, pose->position_m);
}

bool tracking_is_vague(const tracking_t *tracking, const pose_t *pose, float chips) {
    const float position_m2 = trace(pose->position_cov_m2), turn_rad2 = trace(pose->attitude_cov_rad2);
    float most2 = 0.0f;
    for (uint32_t i = 0; i < tracking->count; i++) {
        const loop_t *const coil = &tracking->coils[i];
        float away[3], field[3];
        if (tracking_is_out(tracking, i)) {
            continue;
        }
        vector3_subtract(pose->position_m, coil->centre_m, away);
        loop_field(coil, pose->position_m, field);
        const float distance2 = vector3_dot(away, away) + coil->radius_m * coil->radius_m;
        const float part = CURVATURE * position_m2 / distance2 + 0.5f * turn_rad2;
        const float second2 = part * part * vector3_dot(field, field);
        most2 = second2 > most2 ? second2 : most2;
    }
    const float noise_uT = MICROTESLA * tracking->onboard->noise_T;
    return most2 * chips > VAGUE * VAGUE * noise_uT * noise_uT;
}

void tracking_judge(const tracking_t *tracking, pose_t *pose) {
    const onboard_verdict_t *const verdict = &tracking->verdict;
    const float noise_m = PROTECTION_SD * deviation(pose->position_cov_m2);
    pose->status = verdict->status;
    pose->reason = verdict->reason;
    pose->left_out = tracking->suspect != POSE_NOBODY ? tracking->suspect : verdict->left_out;
    pose->protection_m = verdict->protection_m > noise_m ? verdict->protection_m : noise_m;
    if (pose->status != POSE_OK && pose->status != POSE_UNVERIFIED) {
        return;
    }
    if (tracking->suspect != POSE_NOBODY) {
        pose->reason = POSE_REASON_LEFT_OUT;
    }
    if (tracking->filter.refused >= TRACKING_DOUBTS || tracking->misfits >= TRACKING_DOUBTS) {
        pose->status = POSE_INCONSISTENT;
        pose->reason = POSE_REASON_PENDING;
    } else if (tracking->ambiguous) {
        pose->status = POSE_AMBIGUOUS;
        pose->reason = POSE_REASON_RIVAL;
    } else if (tracking->vague > 0u || is_weak(tracking, pose)) {
        pose->status = POSE_WEAK;
        pose->reason = POSE_REASON_WEAK;
    } else if (pose->protection_m > tracking->onboard->site.alert_limit_m) {
        pose->status = POSE_UNVERIFIED;
        pose->reason = POSE_REASON_UNVERIFIED;
    }
}

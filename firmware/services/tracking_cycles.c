#include "services/tracking_cycles.h"

#include <string.h>

#include "core/math/microtesla.h"
#include "services/tracking_judge.h"

#define CYCLE_S ((float)BLOCK_CYCLE_CHIPS * (float)HAL_CHIP_TICKS / (float)HAL_TICKS_PER_SECOND)

/* Returns whether a verdict tells where the sensor was. */
static bool tells(const onboard_verdict_t *verdict) {
    return verdict->status != POSE_AMBIGUOUS && verdict->status != POSE_INCONSISTENT;
}

/* Returns whether a cycle was located so far from the track that the deviations of both do not explain it. */
static bool is_astray(const tracking_t *tracking, float away_m) {
    const pose_t *const cycle = &tracking->onboard->pose;
    block_pose_t track;
    block_filter_output(&tracking->filter, 0.0f, &track);
    float variance_m2 = 0.0f;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        variance_m2 += cycle->position_cov_m2[axis][axis] + track.covariance[axis][axis];
    }
    return away_m * away_m > TRACKING_ASTRAY * TRACKING_ASTRAY * variance_m2;
}

/* Begins the track anew from a cycle of it: where that was located, and the motion since then has brought it. */
static void begin_again(tracking_t *tracking) {
    const onboard_t *const onboard = tracking->onboard;
    block_start_t there = {.ambient_sd_uT = MICROTESLA * onboard->noise_T};
    memcpy(there.position_m, onboard->pose.position_m, sizeof there.position_m);
    memcpy(there.quaternion, onboard->pose.quaternion, sizeof there.quaternion);
    memcpy(there.position_cov_m2, onboard->pose.position_cov_m2, sizeof there.position_cov_m2);
    memcpy(there.attitude_cov_rad2, onboard->pose.attitude_cov_rad2, sizeof there.attitude_cov_rad2);
    block_filter_shift(&tracking->filter, onboard->located_m, onboard->located_q, &there, CYCLE_S);
    block_filter_keep_slopes(&tracking->filter, true);
}

/* Looks whether a cycle of the track was located where the track is. Of two poses that explained the start as well, one
 * that was located with no prior tells which is the right one; of a track that is vague or astray, where it is. */
static tracking_cycles_t resolve(tracking_t *tracking, const onboard_verdict_t *verdict) {
    const bool searches = tracking->ambiguous || tracking->vague > 0u;
    if (!tells(verdict) || !verdict->beside || (searches && !verdict->searched)) {
        return TRACKING_CYCLES_NOTHING;
    }
    tracking->ambiguous = false;
    if (tracking->state != TRACKING_FOLLOWS) {
        return TRACKING_CYCLES_NOTHING;
    }
    const float *const here_m = tracking->filter.filters[tracking->filter.best].state.position_m;
    const bool astray = is_astray(tracking, verdict->away_m);
    if (tracking->vague > 0u) {
        tracking->vague -= astray && verdict->by_track ? 0u : 1u;
    } else if (verdict->away_m > TRACKING_WEAK_DISTANCE * tracking_nearest_m(tracking, here_m)) {
        return TRACKING_CYCLES_LOST; /* It is elsewhere: far from all beacons a wrong track contradicts no block. */
    } else if (tracking_is_vague(tracking, &tracking->onboard->pose, (float)BLOCK_CYCLE_CHIPS)) {
        tracking->rests = tracking->rests || tracking->unrest == 0u;
        tracking->unrest = TRACKING_UNREST_CYCLES;
    } else if (astray && tracking->unrest > 0u) {
        tracking->vague = verdict->by_track ? 1u : 0u;
    } else {
        return TRACKING_CYCLES_NOTHING;
    }
    begin_again(tracking);
    return TRACKING_CYCLES_MOVED;
}

/* Decides how the next cycle of a track that started vague is taken. What it makes of a cycle is worse than the cycle
 * itself if the sensor rests, as the track's own unrest is in it, and the only one that fits if the sensor moves: where
 * one does not fit the other is tried, once. A review of what a motion has mixed is given up.
 * Returns whether a verdict counts: one that fits, or the second that does not. */
static bool counts(tracking_t *tracking, const onboard_verdict_t *verdict) {
    const bool fits = verdict->status != POSE_INCONSISTENT, twice = tracking->unfit;
    if (tracking->unrest == 0u) {
        tracking->rests = false;
        return true;
    }
    tracking->unrest--;
    tracking->unfit = !fits;
    if (!fits && !verdict->by_track && !twice) {
        pose_live_forget(&tracking->onboard->live);
    }
    tracking->rests = tracking->unrest > 0u && (fits ? tracking->rests : !tracking->rests);
    return fits || twice;
}

tracking_cycles_t tracking_cycles_look(tracking_t *tracking) {
    const onboard_t *const onboard = tracking->onboard;
    if (tracking->judged == onboard->judged) {
        return TRACKING_CYCLES_NOTHING;
    }
    tracking->judged = onboard->judged;
    const onboard_verdict_t *const verdict = &onboard->verdict;
    if (verdict->beside && !counts(tracking, verdict)) {
        return TRACKING_CYCLES_NOTHING;
    }
    tracking_cycles_t told = resolve(tracking, verdict);
    if (verdict->beside || tracking->doubted || onboard->chips != BLOCK_CYCLE_CHIPS) {
        tracking->verdict = *verdict;
        if (verdict->status != POSE_INCONSISTENT) {
            tracking->suspect = POSE_NOBODY;
            tracking->doubted = tracking->doubted && !verdict->beside;
        } else if (tracking->doubted && verdict->beside && tracking->state == TRACKING_FOLLOWS) {
            told = TRACKING_CYCLES_LOST; /* It began when nothing fitted, and nothing fits it. */
        }
    }
    return told;
}

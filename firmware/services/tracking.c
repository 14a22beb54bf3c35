#include "services/tracking.h"

#include <string.h>

#include "core/math/microtesla.h"
#include "core/math/quaternion.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"
#include "core/track/block_out.h"
#include "services/pose_report.h"
#include "services/tracking_cycles.h"
#include "services/tracking_judge.h"
#include "services/tracking_start.h"

#define BLOCK_S ((float)BLOCK_CHIPS * TRACKING_CHIP_S)
#define HALF_S                                                                                                         \
    (0.5f * (float)(BLOCK_CHIPS - 1u) * TRACKING_CHIP_S)        /* From the middle of a block to its last sample, s. */
#define GAP_S (((float)BLOCK_FILTER_REFUSALS + 0.5f) * BLOCK_S) /* Longest time without a block that is bridged, s. */

/* ---- Configuration ---- */

static void read_beacon(tracking_t *tracking, uint32_t row) {
    const pose_beacon_t *const beacon = &tracking->onboard->site.beacons[row];
    loop_t *const coil = &tracking->coils[row];
    const float length2 = vector3_dot(beacon->axis, beacon->axis);
    const float scale = length2 > 0.0f ? inverse_square_root(length2) : 0.0f;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        coil->centre_m[axis] = beacon->position_m[axis];
        coil->axis[axis] = scale * beacon->axis[axis];
    }
    coil->k_uT_m3 = length2 > 0.0f ? UT_M3_PER_A_M2 * beacon->moment_A_m2 : 0.0f;
    coil->radius_m = beacon->radius_m > 0.0f ? beacon->radius_m : 0.0f;
    tracking->beacon_errors[row] = (block_beacon_errors_t){
        beacon->position_sd_m,
        beacon->axis_sd_rad,
        beacon->current_sd,
    };
    tracking->exact = tracking->exact && !(beacon->position_sd_m > 0.0f) && !(beacon->axis_sd_rad > 0.0f) &&
                      !(beacon->current_sd > 0.0f);
}

static void lose(tracking_t *tracking) {
    tracking->state = TRACKING_LOST;
    tracking->gathered = 0;
    tracking->suspect = POSE_NOBODY;
    tracking->start = (pose_t){.status = POSE_FAILED, .reason = POSE_REASON_LATE, .left_out = POSE_NOBODY};
}

void tracking_configure(tracking_t *tracking, onboard_t *onboard, const parameters_t *parameters) {
    if (tracking->state == TRACKING_SEARCHES) {
        onboard_take_back(onboard);
    }
    tracking->onboard = onboard;
    const bool poses = parameters_unsigned(parameters, PARAMETER_POSE) == 1u;
    tracking->every = poses ? parameters_unsigned(parameters, PARAMETER_POSE_BLOCKS) : 0u;
    tracking->able = onboard->separable && !onboard->chosen && onboard->site.count <= BLOCK_BEACONS;
    tracking->count = tracking->able ? onboard->site.count : 0u;
    tracking->exact = !(onboard->site.gain_sd > 0.0f) && !(onboard->site.axis_sd_rad > 0.0f);
    for (uint32_t i = 0; i < tracking->count; i++) {
        read_beacon(tracking, i);
    }
    tracking->errors = (block_site_errors_t){
        .beacons = tracking->used_errors,
        .gain_sd = onboard->site.gain_sd,
        .axis_sd_rad = onboard->site.axis_sd_rad,
    };
    memset(tracking->site_covariance, 0, sizeof tracking->site_covariance);
    tracking->verdict.left_out = POSE_NOBODY;
    tracking->doubted = tracking->ambiguous = false;
    tracking->vague = 0;
    tracking->judged = onboard->judged;
    lose(tracking);
    tracking->select = (block_select_t){0};
    block_filter_init(&tracking->filter, tracking->used, 0, MICROTESLA * onboard->noise_T);
}

/* ---- Answers ---- */

static void send(const tracking_t *tracking, node_t *node, const pose_t *pose) {
    if (tracking->number % tracking->every != 0u) {
        return;
    }
    const uint32_t last = tracking->chip + BLOCK_CHIPS - 1u, chips = tracking->onboard->chips;
    const uint32_t cycle = tracking->cycle + (last < chips ? 0u : 1u);
    const node_links_t links = node_motion_room(node, NODE_BOTH, POSE_REPORT_MESSAGES, 0);
    pose_report(pose, cycle, 1u + last % chips, node, links);
    node_flush(node);
}

/* Sends the pose at the end of the latest block. */
static void send_pose(const tracking_t *tracking, node_t *node) {
    if (tracking->number % tracking->every != 0u) {
        return;
    }
    block_pose_t found;
    block_filter_output(&tracking->filter, tracking->behind_s + HALF_S, &found);
    pose_t pose = {.tracked = tracking->gathered == 0u};
    memcpy(pose.position_m, found.state.position_m, sizeof pose.position_m);
    memcpy(pose.quaternion, found.state.quaternion, sizeof pose.quaternion);
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            pose.position_cov_m2[row][column] = found.covariance[row][column] + tracking->site_covariance[row][column];
            pose.attitude_cov_rad2[row][column] = found.covariance[3u + row][3u + column] +
                                                  tracking->site_covariance[3u + row][3u + column];
        }
    }
    for (uint32_t i = 0; i < tracking->select.count; i++) {
        pose.used += tracking_is_out(tracking, tracking->select.rows[i]) ? 0u : 1u;
    }
    pose.residual = found.freedom > 0u ? square_root(found.chi_square / (float)found.freedom) : 0.0f;
    tracking_judge(tracking, &pose);
    send(tracking, node, &pose);
}

/* ---- Blocks ---- */

/* Selects the beacons that have columns from the next block on. */
static void select(tracking_t *tracking, const float position_m[3]) {
    uint32_t out = 0;
    for (uint32_t i = 0; i < tracking->count; i++) {
        out |= tracking_is_out(tracking, i) ? 1u << i : 0u;
    }
    block_select(&tracking->select, tracking->coils, tracking->count, position_m, out,
                 tracking->verdict.status == POSE_INCONSISTENT);
    for (uint32_t i = 0; i < tracking->select.count; i++) {
        tracking->used[i] = tracking->coils[tracking->select.rows[i]];
        tracking->used_errors[i] = tracking->beacon_errors[tracking->select.rows[i]];
    }
    tracking->selected = tracking->number;
    block_filter_coils(&tracking->filter, tracking->used, tracking->select.count);
    block_cycle_clear(&tracking->moving, tracking->coils, &tracking->select);
}

/* Makes the block of the filter, with columns for the beacons that were selected. */
static void make_block(tracking_t *tracking, const block_sums_t *sums, const block_state_t *predicted) {
    const block_select_t *const select = &tracking->select;
    uint32_t bits[BLOCK_BEACONS];
    for (uint32_t i = 0; i < select->count; i++) {
        bits[i] = sums->bits[select->rows[i]];
    }
    block_gram(bits, select->count, BLOCK_CHIPS, TRACKING_CHIP_S, tracking->block);
    for (uint32_t i = 0; i <= select->count; i++) {
        const uint32_t row = i < select->count ? select->rows[i] : tracking->count;
        for (uint32_t axis = 0; axis < 3u; axis++) {
            tracking->block->sums_uT[i][axis] = MICROTESLA * sums->sums_T[row][axis];
        }
    }
    block_select_reduce(select, tracking->coils, tracking->count, sums->bits, BLOCK_CHIPS, predicted, tracking->block);
}

/* Predicts the state in the middle of the block, and how uncertain it is. */
static void predict(const tracking_t *tracking, block_state_t *predicted, block_doubt_t *doubt) {
    const block_kalman_t *const best = &tracking->filter.filters[tracking->filter.best];
    *predicted = best->state;
    float turned[3][3];
    block_state_advance(predicted, tracking->behind_s, turned);
    float attitude[3][3];
    quaternion_matrix(best->state.quaternion, attitude);
    const float time2 = tracking->behind_s * tracking->behind_s;
    const float noise_uT = MICROTESLA * tracking->onboard->noise_T, noise2 = noise_uT * noise_uT;
    *doubt = (block_doubt_t){0};
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const uint32_t p = BLOCK_P + axis, theta = BLOCK_THETA + axis, v = BLOCK_V + axis, w = BLOCK_W + axis;
        doubt->position_m2 += best->covariance[p][p] + time2 * best->covariance[v][v];
        doubt->attitude_rad2 += best->covariance[theta][theta] + time2 * best->covariance[w][w];
        doubt->ambient_uT2 += best->covariance[BLOCK_E + axis][BLOCK_E + axis] +
                              best->covariance[BLOCK_B + axis][BLOCK_B + axis];
        for (uint32_t other = 0; other < 3u; other++) { /* Only the sum of ambient field and offset is known well. */
            doubt->ambient_uT2 += 2.0f * attitude[axis][other] * best->covariance[BLOCK_E + axis][BLOCK_B + other];
        }
    }
    const float least_uT2 = 3.0f * noise2 / (float)BLOCK_CHIPS; /* The difference of large numbers is rounded. */
    doubt->ambient_uT2 = doubt->ambient_uT2 > least_uT2 ? doubt->ambient_uT2 : least_uT2;
}

/* Counts blocks that do not fit; the beacon that fits worst in each of some in a row is left out. */
static void suspect(tracking_t *tracking, uint32_t worst) {
    if (worst == tracking->count) {
        tracking->misfits -= tracking->misfits > 0u ? 1u : 0u;
        tracking->accused = 0;
        return;
    }
    tracking->misfits++;
    tracking->accused = worst == tracking->worst ? tracking->accused + 1u : 1u;
    tracking->worst = worst;
    if (tracking->accused == TRACKING_DOUBTS && tracking->suspect == POSE_NOBODY) {
        tracking->suspect = worst;
        tracking->misfits = 0;
    }
}

/* Compares the block, with no beacon left out, with what the track predicts, and adds it to the cycle that onboard.h
 * locates. */
static void compare(tracking_t *tracking, const block_state_t *predicted, const block_doubt_t *doubt, uint32_t out) {
    const uint32_t count = tracking->select.count;
    block_residual_t residual;
    block_residual(tracking->block, tracking->used, count, predicted, &residual);
    const uint32_t worst = block_residual_worst(&residual, tracking->block, tracking->used, count, predicted, doubt,
                                                &tracking->errors, MICROTESLA * tracking->onboard->noise_T, out);
    suspect(tracking, worst < count ? tracking->select.rows[worst] : tracking->count);
    if (tracking->onboard->chips == BLOCK_CYCLE_CHIPS &&
        block_cycle_add(&tracking->moving, tracking->number, tracking->chip, TRACKING_CHIP_S, &residual, predicted)) {
        onboard_take_track(tracking->onboard, &tracking->moving, tracking->cycle, tracking->rests,
                           tracking->ambiguous || tracking->vague > 0u);
    }
}

/* Returns a bit for each column whose beacon is not to be believed. */
static uint32_t columns_out(const tracking_t *tracking) {
    uint32_t out = 0;
    for (uint32_t i = 0; i < tracking->select.count; i++) {
        out |= tracking_is_out(tracking, tracking->select.rows[i]) ? 1u << i : 0u;
    }
    return out;
}

static void leave_out(block_t *block, uint32_t out) {
    for (uint32_t i = 0; out != 0u; i++, out >>= 1) {
        if ((out & 1u) != 0u) {
            block_leave_out(block, i);
        }
    }
}

/* Returns whether the beacons are to be selected anew: with each cycle. */
static bool selects(const tracking_t *tracking) {
    return tracking->onboard->chips == BLOCK_CYCLE_CHIPS ? block_cycle_begins(tracking->chip)
                                                         : tracking->number - tracking->selected >= BLOCK_CYCLE_BLOCKS;
}

/* Moves the track on to a block. Returns false if it is lost. */
static bool follow(tracking_t *tracking, const block_sums_t *sums) {
    if (tracking->behind_s > GAP_S) {
        return false;
    }
    if (sums->unmeasured != 0u) {
        return true;
    }
    block_state_t predicted;
    block_doubt_t doubt;
    predict(tracking, &predicted, &doubt);
    if (selects(tracking)) {
        select(tracking, predicted.position_m);
    }
    make_block(tracking, sums, &predicted);
    compare(tracking, &predicted, &doubt, columns_out(tracking));
    leave_out(tracking->block, columns_out(tracking)); /* Another may be suspected now. */
    const bool taken = block_filter_update(&tracking->filter, tracking->block, tracking->behind_s);
    tracking->behind_s = 0.0f;
    tracking->gathered = 0;
    if (taken && !tracking->exact && tracking->number - tracking->errors_number >= TRACKING_ERRORS_BLOCKS) {
        tracking->errors_number = tracking->number;
        block_errors(&tracking->filter.measure, tracking->used, tracking->select.count, &tracking->errors,
                     tracking->site_covariance);
    }
    return tracking->misfits < BLOCK_FILTER_REFUSALS && !block_filter_lost(&tracking->filter);
}

/* ---- Start ---- */

/* Gathers a block for a start, and begins to search when there are enough. */
static void gather(tracking_t *tracking, node_t *node, const block_sums_t *sums, bool more) {
    const uint32_t needed = 1u + tracking->count / TRACKING_COLUMNS_A_BLOCK;
    if (!tracking->able) {
        tracking->start.reason = POSE_REASON_NO_POSE;
    } else if (sums->unmeasured != 0u || (more && tracking->gathered == 0u) || !onboard_lends(tracking->onboard)) {
        tracking->gathered = 0;
    } else {
        tracking_start_add(tracking, sums);
    }
    if (!tracking->able || tracking->gathered < needed) {
        send(tracking, node, &tracking->start);
        return;
    }
    tracking->behind_s = 0.5f * (float)(needed - 1u) * BLOCK_S;
    tracking->work = onboard_lend(tracking->onboard);
    if (tracking_start_search(tracking)) {
        tracking->state = TRACKING_SEARCHES;
        return;
    }
    onboard_take_back(tracking->onboard);
    tracking->gathered = 0;
    pose_fail(&tracking->start, POSE_REASON_NO_POSE);
    send(tracking, node, &tracking->start);
}

/* After the search: begins the track, if there is anything to begin from. */
static void begin(tracking_t *tracking, node_t *node) {
    const pose_t *const found = &tracking->start;
    onboard_take_back(tracking->onboard);
    const bool contradicts = found->status == POSE_INCONSISTENT;
    tracking->contradictions += contradicts ? 1u : 0u;
    if (found->status == POSE_FAILED || (contradicts && tracking->contradictions < TRACKING_PATIENCE)) {
        tracking->state = TRACKING_LOST;
        tracking->gathered = 0;
        tracking->doubted = tracking->doubted && found->reason != POSE_REASON_NOISE; /* Silence explains it. */
        send(tracking, node, found);
        return;
    }
    tracking->contradictions = 0;
    tracking->ambiguous = found->status == POSE_AMBIGUOUS;
    const uint32_t last = tracking->count;
    block_start_t start = {
        .ambient_sd_uT = MICROTESLA * tracking->onboard->noise_T * square_root(tracking->block->gram[last][last]),
    };
    memcpy(start.position_m, found->position_m, sizeof start.position_m);
    memcpy(start.quaternion, found->quaternion, sizeof start.quaternion);
    memcpy(start.position_cov_m2, found->position_cov_m2, sizeof start.position_cov_m2);
    memcpy(start.attitude_cov_rad2, found->attitude_cov_rad2, sizeof start.attitude_cov_rad2);
    memcpy(start.ambient_uT, tracking->block->sums_uT[last], sizeof start.ambient_uT);
    block_filter_start(&tracking->filter, &start);
    tracking->misfits = tracking->accused = 0;
    select(tracking, found->position_m);
    const bool vague = tracking->onboard->chips == BLOCK_CYCLE_CHIPS &&
                       tracking_is_vague(tracking, found, (float)(tracking->gathered * BLOCK_CHIPS));
    block_filter_keep_slopes(&tracking->filter, false);
    tracking->vague = vague ? TRACKING_VAGUE_CYCLES : 0u;
    tracking->unrest = vague ? TRACKING_UNREST_CYCLES : 0u;
    tracking->rests = vague;
    tracking->unfit = false;
    tracking->state = TRACKING_FOLLOWS;
    tracking->errors_number = tracking->number - TRACKING_ERRORS_BLOCKS;
    tracking->verdict.status = found->status;
    tracking->verdict.reason = found->reason;
    tracking->verdict.protection_m = found->protection_m;
    if (tracking->doubted && found->status != POSE_INCONSISTENT) {
        tracking->verdict.status = POSE_INCONSISTENT;
        tracking->verdict.reason = POSE_REASON_PENDING;
    }
    send_pose(tracking, node);
}

/* ---- Calls ---- */

/* Lets the cycle that was located since the last block, if any, tell of the track. */
static void look_at_cycles(tracking_t *tracking) {
    const tracking_cycles_t told = tracking_cycles_look(tracking);
    if (told == TRACKING_CYCLES_LOST) {
        lose(tracking);
    } else if (told == TRACKING_CYCLES_MOVED) {
        select(tracking, tracking->filter.filters[tracking->filter.best].state.position_m);
    }
}

bool tracking_takes(const tracking_t *tracking) {
    return tracking->every == 0u || tracking->state == TRACKING_FOLLOWS ||
           (tracking->state == TRACKING_LOST && onboard_lends(tracking->onboard));
}

void tracking_take(tracking_t *tracking, node_t *node, const block_sums_t *sums, bool more) {
    if (tracking->every == 0u) {
        return;
    }
    const uint32_t blocks = sums->number - tracking->number;
    tracking->number = sums->number;
    tracking->cycle = sums->cycle;
    tracking->chip = sums->chip;
    tracking->behind_s += (float)blocks * BLOCK_S;
    look_at_cycles(tracking);
    if (tracking->state == TRACKING_FOLLOWS) {
        if (follow(tracking, sums)) {
            send_pose(tracking, node);
            return;
        }
        tracking->doubted = tracking->behind_s == 0.0f; /* The block was looked at. */
        lose(tracking);
    }
    if (blocks != 1u) {
        tracking->gathered = 0;
    }
    gather(tracking, node, sums, more);
}

bool tracking_search(tracking_t *tracking, node_t *node) {
    if (tracking->state != TRACKING_SEARCHES) {
        return false;
    }
    if (pose_step(tracking->work, &tracking->start)) {
        begin(tracking, node);
    }
    return true;
}

#include "services/onboard.h"

#include <string.h>

#include "core/math/microtesla.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"
#include "services/pose_report.h"

/* Prepares the separation of a selection. Returns whether there is one. */
static bool prepare(onboard_t *onboard, const epoch_selection_t *selection) {
    uint16_t codes[EPOCH_CODES_MAX];
    int16_t sums[EPOCH_CODES_MAX];
    for (uint32_t i = 0; i < selection->count; i++) {
        codes[i] = selection->codes[i].code;
        sums[i] = selection->codes[i].sum;
    }
    return separation_init(&onboard->separation, onboard->chips, codes, sums, selection->count);
}

/* Reads which code each row has. */
static void read_list(onboard_t *onboard, const parameters_t *parameters) {
    onboard->told_apart = true;
    for (uint32_t i = 0; i < onboard->site.count; i++) {
        onboard->listed[i] = (uint16_t)parameters_unsigned(parameters, PARAMETER_CODE_LIST + i);
        for (uint32_t j = 0; j < i; j++) {
            onboard->told_apart = onboard->told_apart && onboard->listed[i] != onboard->listed[j];
        }
    }
}

/* Finds the rows of the codes that were chosen, and prepares their separation. */
static void choose(onboard_t *onboard, const epoch_selection_t *selection) {
    onboard->separable = prepare(onboard, selection) && onboard->told_apart;
    for (uint32_t i = 0; i < selection->count; i++) {
        uint32_t row = 0;
        while (row < onboard->site.count && onboard->listed[row] != selection->codes[i].code) {
            row++;
        }
        onboard->rows[i] = (uint8_t)(row < onboard->site.count ? row : ONBOARD_NO_ROW);
    }
}

void onboard_configure(onboard_t *onboard, const parameters_t *parameters, uint32_t chips,
                       const epoch_selection_t *selection) {
    onboard->chips = chips;
    onboard->active = parameters_unsigned(parameters, PARAMETER_POSE) == 1u;
    onboard->due = onboard->due && onboard->active;
    onboard->moved = false;
    pose_live_forget(&onboard->live);
    onboard->noise_T = parameters_float(parameters, PARAMETER_NOISE);
    onboard->pose.status = POSE_FAILED;
    const uint32_t listed = parameters_unsigned(parameters, PARAMETER_CODE_COUNT);
    onboard->chosen = parameters_unsigned(parameters, PARAMETER_STRONGEST) > 0u;
    onboard->site.count = onboard->chosen ? listed : selection->count;
    for (uint32_t i = 0; i < onboard->site.count; i++) {
        const uint32_t row = PARAMETER_BEACONS + PARAMETER_BEACONS_STRIDE * i;
        pose_beacon_t *beacon = &onboard->site.beacons[i];
        for (uint32_t axis = 0; axis < 3u; axis++) {
            beacon->position_m[axis] = parameters_float(parameters, row + axis);
            beacon->axis[axis] = parameters_float(parameters, row + 3u + axis);
        }
        beacon->moment_A_m2 = parameters_float(parameters, row + 6u);
        beacon->radius_m = parameters_float(parameters, row + 7u);
        const uint32_t survey = PARAMETER_SURVEY + PARAMETER_SURVEY_STRIDE * i;
        beacon->position_sd_m = parameters_float(parameters, survey);
        beacon->axis_sd_rad = parameters_float(parameters, survey + 1u);
        beacon->current_sd = parameters_float(parameters, survey + 2u);
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        onboard->site.half_space_point_m[axis] = parameters_float(parameters, PARAMETER_HALF_SPACE + axis);
        onboard->site.half_space_normal[axis] = parameters_float(parameters, PARAMETER_HALF_SPACE + 3u + axis);
    }
    onboard->site.alert_limit_m = parameters_float(parameters, PARAMETER_ALERT_LIMIT);
    onboard->site.gain_sd = parameters_float(parameters, PARAMETER_GAIN_SD);
    onboard->site.axis_sd_rad = parameters_float(parameters, PARAMETER_AXIS_SD);
    if (onboard->chosen) {
        read_list(onboard, parameters);
        return;
    }
    for (uint32_t i = 0; i < EPOCH_CODES_MAX; i++) {
        onboard->rows[i] = (uint8_t)i;
    }
    /* With a code left out beacons would be taken for others. */
    onboard->separable = prepare(onboard, selection) && selection->count == listed;
}

/* Makes fields, T, of the separated residuals of the track. Beacons that it did not use have none. */
static void restore(onboard_t *onboard) {
    const block_cycle_t *const moving = &onboard->moving;
    for (uint32_t row = 0, column = 0; row < onboard->separation.count; row++) {
        pose_field_t *const field = &onboard->fields[row];
        if (column == moving->count || moving->rows[column] != row) {
            field->sigma_T = 0.0f;
            continue;
        }
        float field_uT[3];
        for (uint32_t axis = 0; axis < 3u; axis++) {
            field_uT[axis] = MICROTESLA * field->field_T[axis];
        }
        block_cycle_field(moving, column++, field_uT);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            field->field_T[axis] = field_uT[axis] / MICROTESLA;
        }
    }
}

static void separate(onboard_t *onboard) {
    const float chips = (float)onboard->chips, scale = chips / (float)(onboard->chips - onboard->missing);
    const float disturbed = (float)(onboard->missing + onboard->saturated),
                offset2 = vector3_dot(onboard->mean, onboard->mean);
    const float extra2 = offset2 * disturbed / (chips * chips);
    for (uint32_t axis = 0; axis < EPOCH_AXES; axis++) {
        separation_apply(&onboard->separation, onboard->mean[axis], onboard->sums[axis]);
    }
    memset(onboard->fields, 0, sizeof onboard->fields); /* Nothing was heard of rows without a field. */
    for (uint32_t i = 0; i < onboard->separation.count; i++) {
        if (onboard->rows[i] == ONBOARD_NO_ROW) {
            continue;
        }
        pose_field_t *const field = &onboard->fields[onboard->rows[i]];
        for (uint32_t axis = 0; axis < EPOCH_AXES; axis++) {
            field->field_T[axis] = scale * onboard->sums[axis][i];
        }
        field->sigma_T = square_root(
            onboard->noise_T * onboard->noise_T * separation_variance(&onboard->separation, i) + extra2);
    }
    if (onboard->by_track) {
        restore(onboard);
    }
}

void onboard_take_track(onboard_t *onboard, const block_cycle_t *moving, uint32_t cycle, bool rests, bool doubted) {
    onboard->moving = *moving;
    onboard->moving_rests = rests;
    onboard->moving_doubted = doubted;
    onboard->moving_cycle = cycle;
    onboard->moved = true;
}

/* Takes the residuals of the track in place of the sums of the cycle. */
static void copy_residuals(onboard_t *onboard) {
    const block_cycle_t *const moving = &onboard->moving;
    const float scale = 1.0f / (MICROTESLA * (float)onboard->chips);
    onboard->missing = onboard->saturated = 0;
    memset(onboard->sums, 0, sizeof onboard->sums); /* The others tell next to nothing of a whole cycle. */
    for (uint32_t axis = 0; axis < EPOCH_AXES; axis++) {
        for (uint32_t i = 0; i < moving->count; i++) {
            onboard->sums[axis][moving->rows[i]] = scale * moving->residual_uT[i][axis];
        }
        onboard->mean[axis] = scale * moving->residual_uT[moving->count][axis];
    }
}

void onboard_take(onboard_t *onboard, node_t *node, const epoch_sums_t *cycle, const epoch_calibration_t *calibration,
                  const epoch_selection_t *selection) {
    if (!onboard->active || cycle->missing >= cycle->chips) {
        return;
    }
    if (onboard->due) {
        const pose_t late = {.status = POSE_FAILED, .reason = POSE_REASON_LATE, .left_out = POSE_NOBODY};
        pose_report(&late, onboard->cycle, POSE_REPORT_CYCLE, node, NODE_BOTH);
    }
    if (onboard->chosen) {
        choose(onboard, selection);
    }
    onboard->due = true;
    onboard->cycle = cycle->cycle;
    onboard->beside = onboard->moved && onboard->moving_cycle == cycle->cycle;
    onboard->by_track = onboard->beside && !onboard->moving_rests;
    onboard->moved = false;
    if (onboard->by_track) {
        copy_residuals(onboard);
        return;
    }
    onboard->missing = cycle->missing;
    onboard->saturated = cycle->saturated;
    epoch_offset(cycle, calibration, onboard->mean);
    for (uint32_t i = 0; i < selection->count; i++) {
        float field[EPOCH_AXES];
        epoch_field(cycle, calibration, selection, i, field);
        for (uint32_t axis = 0; axis < EPOCH_AXES; axis++) {
            onboard->sums[axis][i] = field[axis];
        }
    }
}

/* Begins the pose of the cycle taken. */
static void begin(onboard_t *onboard, node_t *node) {
    onboard->due = onboard->owed = false;
    onboard->located = onboard->cycle;
    onboard->located_by_track = onboard->by_track;
    onboard->located_beside = onboard->beside;
    if (!onboard->separable) {
        onboard->pose = (pose_t){.status = POSE_FAILED, .reason = POSE_REASON_NO_POSE, .left_out = POSE_NOBODY};
        pose_report(&onboard->pose, onboard->located, POSE_REPORT_CYCLE, node, NODE_BOTH);
        return;
    }
    separate(onboard);
    memcpy(onboard->located_m, onboard->moving.position_m, sizeof onboard->located_m);
    memcpy(onboard->located_q, onboard->moving.quaternion, sizeof onboard->located_q);
    if (onboard->beside) { /* The track knows better than the pose of the cycle before. */
        memcpy(onboard->pose.position_m, onboard->moving.position_m, sizeof onboard->pose.position_m);
        memcpy(onboard->pose.quaternion, onboard->moving.quaternion, sizeof onboard->pose.quaternion);
        onboard->pose.status = onboard->moving_doubted ? POSE_FAILED : POSE_OK;
    }
    pose_live_begin(&onboard->live, &onboard->site, onboard->fields, &onboard->pose);
}

static void judge(onboard_t *onboard) {
    const pose_t *const pose = &onboard->pose;
    if (pose->status != POSE_FAILED) {
        float away[3];
        vector3_subtract(pose->position_m, onboard->located_m, away);
        onboard->verdict = (onboard_verdict_t){
            .status = pose->status,
            .reason = pose->reason,
            .left_out = pose->left_out,
            .protection_m = pose->protection_m,
            .by_track = onboard->located_by_track,
            .beside = onboard->located_beside,
            .away_m = square_root(vector3_dot(away, away)),
            .searched = !pose->tracked,
        };
        onboard->judged++;
    }
}

bool onboard_step(onboard_t *onboard, node_t *node) {
    if (onboard->live.busy) {
        if (pose_live_step(&onboard->live, &onboard->pose)) {
            judge(onboard);
            pose_report(&onboard->pose, onboard->located, POSE_REPORT_CYCLE, node, NODE_BOTH);
        }
        return true;
    }
    if (onboard->due && !onboard->lent) {
        begin(onboard, node);
        return true;
    }
    return pose_live_spare(&onboard->live);
}

bool onboard_lends(const onboard_t *onboard) {
    return !onboard->live.busy && !onboard->owed;
}

pose_work_t *onboard_lend(onboard_t *onboard) {
    onboard->lent = true;
    return &onboard->live.work;
}

void onboard_take_back(onboard_t *onboard) {
    onboard->lent = false;
    onboard->owed = onboard->due;
}

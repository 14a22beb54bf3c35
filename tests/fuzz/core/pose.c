/* pose.c: fields and a site that are anything that the parameters allow. A pose that is called good is finite, turned
 * by a unit quaternion, in the half-space, and protected within the alert limit, and its covariances are such; a pose
 * is there after no more steps than promised; and what is not finite never passes for a pose at all. */
#include "core/pose/pose_live.h"

#include "fuzz.h"

#define BEACONS_MOST 10u
#define LIMIT        1e6f /* The largest coordinate and moment of the table of parameters. */

static bool is_finite(const float *values, size_t count) {
    for (size_t i = 0; i < count; i++) {
        if (!(values[i] - values[i] == 0.0f)) {
            return false;
        }
    }
    return true;
}

/* A number of the table of parameters: a likely one, or whatever is in range. */
static float in_range(input_t *input, float likely, float least, float most) {
    const uint32_t how = take_u8(input);
    if (how < 250u) {
        return (least < 0.0f ? -likely : 0.0f) + take_between(input, 0.0f, least < 0.0f ? 2.0f * likely : likely);
    }
    const float value = take_float(input);
    return value >= least && value <= most ? value : how % 2u == 0u ? least : most;
}

static void take_site(input_t *input, pose_site_t *site) {
    memset(site, 0, sizeof *site);
    site->count = take_u8(input) % (BEACONS_MOST + 1u);
    for (uint32_t i = 0; i < site->count; i++) {
        pose_beacon_t *const beacon = &site->beacons[i];
        for (uint32_t axis = 0; axis < 3u; axis++) {
            beacon->position_m[axis] = in_range(input, 3.0f, -LIMIT, LIMIT);
            beacon->axis[axis] = in_range(input, 1.0f, -LIMIT, LIMIT);
        }
        beacon->moment_A_m2 = in_range(input, 20.0f, -LIMIT, LIMIT);
        beacon->radius_m = in_range(input, 0.3f, -LIMIT, LIMIT);
        beacon->position_sd_m = in_range(input, 0.005f, 0.0f, 1.0f);
        beacon->axis_sd_rad = in_range(input, 0.005f, 0.0f, 1.0f);
        beacon->current_sd = in_range(input, 0.005f, 0.0f, 1.0f);
    }
    const bool bounded = take_u8(input) % 2u == 1u;
    for (uint32_t axis = 0; bounded && axis < 3u; axis++) {
        site->half_space_point_m[axis] = in_range(input, 3.0f, -LIMIT, LIMIT);
        site->half_space_normal[axis] = in_range(input, 1.0f, -LIMIT, LIMIT);
    }
    site->alert_limit_m = in_range(input, 1.0f, 0.0f, LIMIT);
    site->gain_sd = in_range(input, 0.005f, 0.0f, 0.5f);
    site->axis_sd_rad = in_range(input, 0.005f, 0.0f, 0.5f);
}

/* Fields of a sensor somewhere among the beacons, of dipoles, with an error; or anything. */
static void take_fields(input_t *input, const pose_site_t *site, pose_field_t *fields) {
    const uint32_t how = take_u8(input);
    float at[3];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        at[axis] = take_between(input, -4.0f, 4.0f);
    }
    for (uint32_t i = 0; i < site->count; i++) {
        const pose_beacon_t *const beacon = &site->beacons[i];
        float r[3], distance2 = 1e-6f, along = 0.0f;
        for (uint32_t axis = 0; axis < 3u; axis++) {
            r[axis] = at[axis] - beacon->position_m[axis];
            distance2 += r[axis] * r[axis];
            along += r[axis] * beacon->axis[axis];
        }
        for (uint32_t axis = 0; axis < 3u; axis++) {
            const float scale = 1e-7f * beacon->moment_A_m2 / (distance2 * distance2);
            fields[i].field_T[axis] = scale * (3.0f * along * r[axis] / distance2 - beacon->axis[axis]);
            if (how % 4u == 1u) {
                fields[i].field_T[axis] *= take_between(input, 0.5f, 1.5f);
            } else if (how % 4u == 2u) {
                fields[i].field_T[axis] = take_between(input, -1e-5f, 1e-5f);
            } else if (how % 4u == 3u) {
                fields[i].field_T[axis] = take_float(input);
            }
        }
        fields[i].sigma_T = how >= 128u ? take_float(input) : 2e-8f;
    }
}

static void judge(const pose_site_t *site, const pose_t *pose) {
    REQUIRE(pose->status <= POSE_UNVERIFIED && pose->reason <= POSE_REASON_LATE && pose->used <= site->count);
    if (pose->status == POSE_FAILED) {
        return;
    }
    const float *const q = pose->quaternion;
    REQUIRE(is_finite(pose->position_m, 3) && is_finite(q, 4) && pose->used >= POSE_BEACONS_LEAST);
    const float norm2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    REQUIRE(norm2 > 0.999f && norm2 < 1.001f && q[3] >= 0.0f);
    if (pose->status != POSE_OK) {
        return;
    }
    REQUIRE(is_finite(&pose->position_cov_m2[0][0], 9) && is_finite(&pose->attitude_cov_rad2[0][0], 9));
    REQUIRE(is_finite(&pose->residual, 1) && pose->residual >= 0.0f);
    REQUIRE(pose->protection_m >= 0.0f && pose->protection_m <= site->alert_limit_m);
    float height = 0.0f, scale = 0.0f;
    for (uint32_t i = 0; i < 3u; i++) {
        REQUIRE(pose->position_cov_m2[i][i] >= 0.0f && pose->attitude_cov_rad2[i][i] >= 0.0f);
        const float off = pose->position_m[i] - site->half_space_point_m[i], term = off * site->half_space_normal[i];
        height += term;
        scale += term > 0.0f ? term : -term;
    }
    REQUIRE(height >= -1e-4f * scale);
}

static uint32_t run(const pose_site_t *site, const pose_field_t *fields, bool track, pose_t *pose) {
    static pose_work_t work;
    pose_begin(site, fields, track, NULL, &work, pose);
    uint32_t steps = 1;
    while (!pose_step(&work, pose)) {
        steps++;
        REQUIRE(steps <= POSE_STEPS_MOST);
    }
    judge(site, pose);
    return steps;
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size) {
    static pose_site_t site;
    static pose_live_t live;
    pose_field_t fields[POSE_BEACONS_MAX] = {0};
    input_t input = {bytes, size};
    const uint32_t mode = take_u8(&input);
    take_site(&input, &site);
    take_fields(&input, &site, fields);
    pose_t pose = {.status = POSE_FAILED};
    (void)run(&site, fields, false, &pose);
    if (mode % 4u == 1u) {
        take_fields(&input, &site, fields);
        (void)run(&site, fields, true, &pose);
    } else if (mode % 4u == 2u) {
        pose_live_forget(&live);
        for (uint32_t cycle = 0; cycle < 3u; cycle++) {
            pose_live_begin(&live, &site, fields, &pose);
            for (uint32_t steps = 0; !pose_live_step(&live, &pose); steps++) {
                REQUIRE(steps < POSE_STEPS_MOST);
            }
            judge(&site, &pose);
            for (uint32_t i = 0; i < 40u && pose_live_spare(&live); i++) {
            }
            take_fields(&input, &site, fields);
        }
    }
    return 0;
}

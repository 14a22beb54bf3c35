#include "services/pose_report.h"

#include "core/codes/epoch.h"
#include "core/math/roots.h"
#include "goldfield.h"

#define NOBODY          255u     /* Value of left_out if no beacon is. */
#define PROTECTION_MOST 1048575u /* Greatest value of protection: nothing is promised. */

/* Returns value / resolution as the nearest whole number from 0 to limit. */
static uint32_t clamped(float value, float resolution, uint32_t limit) {
    const float scaled = value / resolution + 0.5f;
    return scaled >= (float)limit ? limit : scaled > 0.0f ? (uint32_t)scaled : 0u;
}

/* Returns a component of a unit quaternion in units of 2^-14; 1 itself does not fit 15 bits. */
static int16_t component(float value) {
    return (int16_t)node_clamp(epoch_integer(value, 1.0f / 16384.0f), 16383);
}

static float root_of_trace(const float matrix[3][3]) {
    return square_root(matrix[0][0] + matrix[1][1] + matrix[2][2]);
}

void pose_report(const pose_t *pose, uint32_t cycle, uint32_t index, node_t *node, node_links_t links) {
    const bool found = pose->status != POSE_FAILED;
    const uint8_t cycle_low = (uint8_t)(cycle & 0xFu);
    uint8_t data[8];
    const struct goldfield_pose_position_t position = {
        .x = found ? epoch_integer(pose->position_m[0], 1e-4f) : EPOCH_OUT_OF_RANGE,
        .y = found ? epoch_integer(pose->position_m[1], 1e-4f) : EPOCH_OUT_OF_RANGE,
        .z = found ? epoch_integer(pose->position_m[2], 1e-4f) : EPOCH_OUT_OF_RANGE,
        .cycle_low = cycle_low,
    };
    uint8_t length = (uint8_t)goldfield_pose_position_pack(data, &position, sizeof data);
    node_send(node, links, GOLDFIELD_POSE_POSITION_FRAME_ID, index, data, length);

    const struct goldfield_pose_attitude_t attitude = {
        .x = found ? component(pose->quaternion[0]) : 0,
        .y = found ? component(pose->quaternion[1]) : 0,
        .z = found ? component(pose->quaternion[2]) : 0,
        .w = found ? component(pose->quaternion[3]) : 0,
        .cycle_low = cycle_low,
    };
    length = (uint8_t)goldfield_pose_attitude_pack(data, &attitude, sizeof data);
    node_send(node, links, GOLDFIELD_POSE_ATTITUDE_FRAME_ID, index, data, length);

    const struct goldfield_pose_quality_t quality = {
        .cycle_low = cycle_low,
        .status = (uint8_t)pose->status,
        .tracked = pose->tracked,
        .used = (uint8_t)pose->used,
        .iterations = (uint8_t)(pose->iterations < 255u ? pose->iterations : 255u),
        .residual = (uint16_t)(found ? clamped(pose->residual, 0.01f, 4095u) : 0u),
        .sigma_position = (uint16_t)(found ? clamped(root_of_trace(pose->position_cov_m2), 1e-4f, 65535u) : 65535u),
        .sigma_attitude = (uint16_t)(found ? clamped(root_of_trace(pose->attitude_cov_rad2), 5e-4f, 8191u) : 8191u),
    };
    length = (uint8_t)goldfield_pose_quality_pack(data, &quality, sizeof data);
    node_send(node, links, GOLDFIELD_POSE_QUALITY_FRAME_ID, index, data, length);

    const struct goldfield_pose_integrity_t integrity = {
        .cycle_low = cycle_low,
        .reason = (uint8_t)pose->reason,
        .left_out = (uint8_t)(pose->left_out < NOBODY ? pose->left_out : NOBODY),
        .protection = found ? clamped(pose->protection_m, 1e-3f, PROTECTION_MOST) : PROTECTION_MOST,
    };
    length = (uint8_t)goldfield_pose_integrity_pack(data, &integrity, sizeof data);
    node_send(node, links, GOLDFIELD_POSE_INTEGRITY_FRAME_ID, index, data, length);
}

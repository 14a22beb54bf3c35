#include "services/tracking_start.h"

#include "core/math/microtesla.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"
#include "core/track/block_out.h"
#include "services/tracking_judge.h"

#define START_VELOCITY 3.0f /* Standard deviations with which the filter begins: m/s ... */
#define START_RATE     4.0f /* ... and rad/s. */

/* Makes a block with columns for all beacons. */
static void make_whole_block(tracking_t *tracking, const block_sums_t *sums) {
    block_gram(sums->bits, tracking->count, BLOCK_CHIPS, TRACKING_CHIP_S, tracking->block);
    for (uint32_t i = 0; i <= tracking->count; i++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            tracking->block->sums_uT[i][axis] = MICROTESLA * sums->sums_T[i][axis];
        }
    }
}

/* Adds a block to those that have been gathered: its moments are not needed. */
static void add_block(tracking_t *tracking, const block_sums_t *sums) {
    for (uint32_t i = 0; i <= tracking->count; i++) {
        const uint32_t bits = i < tracking->count ? sums->bits[i] : 0u;
        for (uint32_t j = 0; j <= tracking->count; j++) {
            const uint32_t other = j < tracking->count ? sums->bits[j] : 0u;
            const int32_t product = (int32_t)BLOCK_CHIPS - 2 * __builtin_popcount(bits ^ other);
            tracking->block->gram[i][j] += (float)product;
        }
        for (uint32_t axis = 0; axis < 3u; axis++) {
            tracking->block->sums_uT[i][axis] += MICROTESLA * sums->sums_T[i][axis];
        }
    }
}

/* Returns the sum of the squares of how fast the separated fields may change by motion, uT^2/s^2: those of dipoles by
 * 3 B / r. */
static float slopes2(const tracking_t *tracking) {
    const float *const ambient = tracking->block->sums_uT[tracking->count];
    float sum = START_RATE * START_RATE * vector3_dot(ambient, ambient);
    for (uint32_t i = 0; i < tracking->count; i++) {
        const float field2 = vector3_dot(tracking->block->sums_uT[i], tracking->block->sums_uT[i]);
        const float k = tracking->coils[i].k_uT_m3, radius = tracking->coils[i].radius_m;
        if (tracking_is_out(tracking, i) || !(field2 > 0.0f)) {
            continue;
        }
        const float away = 1.0f / inverse_cube_root(1.5f * (k < 0.0f ? -k : k) * inverse_square_root(field2));
        const float rate = START_RATE + 3.0f * START_VELOCITY / (away > radius ? away : radius);
        sum += rate * rate * field2;
    }
    return sum;
}

/* Returns the variance, uT^2, of a component of a separated field: noise, and what the others, which change during the
 * blocks, leave in it. Their products with time have a variance of m (m^2 - 1) / 12 chips^2 in m chips. */
static float variance(const tracking_t *tracking, uint32_t row, float sum2) {
    const float noise_uT = MICROTESLA * tracking->onboard->noise_T;
    const float chips = (float)(tracking->gathered * BLOCK_CHIPS);
    float row2 = 0.0f;
    for (uint32_t j = 0; j <= tracking->count; j++) {
        row2 += tracking->block->gram[row][j] * tracking->block->gram[row][j];
    }
    const float times2 = chips * (chips * chips - 1.0f) / 12.0f * TRACKING_CHIP_S * TRACKING_CHIP_S;
    return noise_uT * noise_uT * tracking->block->gram[row][row] + times2 * row2 * sum2;
}

void tracking_start_add(tracking_t *tracking, const block_sums_t *sums) {
    if (tracking->gathered == 0u) {
        make_whole_block(tracking, sums);
    } else {
        add_block(tracking, sums);
    }
    tracking->gathered++;
}

bool tracking_start_search(tracking_t *tracking) {
    for (uint32_t i = 0; i < tracking->count; i++) {
        if (tracking_is_out(tracking, i)) {
            block_leave_out(tracking->block, i);
        }
    }
    if (!block_separate(tracking->block)) {
        return false;
    }
    const float sum2 = slopes2(tracking);
    pose_field_t fields[BLOCK_BEACONS];
    for (uint32_t i = 0; i < tracking->count; i++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            fields[i].field_T[axis] = tracking->block->sums_uT[i][axis] / MICROTESLA;
        }
        fields[i].sigma_T = tracking_is_out(tracking, i) ? 0.0f : square_root(variance(tracking, i, sum2)) / MICROTESLA;
    }
    const pose_verdict_t unknown = {.row = POSE_NOBODY, .reason = POSE_REASON_PENDING};
    pose_begin(&tracking->onboard->site, fields, false, &unknown, tracking->work, &tracking->start);
    return true;
}

/* The track of core/track under the address and undefined-behaviour sanitizers, with every number of beacons, at rest
 * and in motion, with noise and with sums that are none. Exit 0: nothing found. Results are judged by the other tests;
 * here only what the sanitizers see. */
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "core/track/block_cycle.h"
#include "core/track/block_errors.h"
#include "core/track/block_filter.h"
#include "core/track/block_out.h"
#include "core/track/block_residual.h"
#include "core/track/block_select.h"

#define CHIPS   31u
#define CHIP_S  9.775e-5f
#define BLOCK_S ((float)CHIPS * CHIP_S)
#define NOISE   0.02f

static uint32_t random_state = 12345;

static uint32_t noise(void) { /* xorshift32, Marsaglia 2003 */
    random_state ^= random_state << 13;
    random_state ^= random_state >> 17;
    return random_state ^= random_state << 5;
}

static float within(float most) { /* Evenly from -most to most. */
    return most * ((float)(noise() >> 8) / 8388608.0f - 1.0f);
}

static void sites(loop_t coils[BLOCK_BEACONS], block_beacon_errors_t errors[BLOCK_BEACONS]) {
    for (uint32_t i = 0; i < BLOCK_BEACONS; i++) {
        coils[i] = (loop_t){{within(2.0f), within(2.0f), within(2.0f)}, {0.0f}, 1.3f, i % 4u == 0u ? 0.0f : 0.15f};
        coils[i].axis[i % 3u] = 1.0f;
        errors[i] = (block_beacon_errors_t){0.003f, 0.005f, 0.004f};
    }
}

/* Takes a block whose sums are those of the filter's own state, and noise; or of none. */
static void take(block_filter_t *filter, block_t *block, const block_select_t *select, const loop_t *all,
                 uint32_t count, uint32_t number) {
    uint32_t bits[BLOCK_BEACONS], used[BLOCK_BEACONS];
    for (uint32_t i = 0; i < count; i++) {
        bits[i] = noise();
    }
    for (uint32_t i = 0; i < select->count; i++) {
        used[i] = bits[select->rows[i]];
    }
    block_gram(used, select->count, CHIPS, CHIP_S, block);
    const block_state_t state = filter->filters[filter->best].state;
    static block_residual_t residual;
    memset(block->sums_uT, 0, sizeof block->sums_uT);
    block_residual(block, filter->coils, select->count, &state, &residual);
    for (uint32_t i = 0; i <= select->count; i++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            block->sums_uT[i][axis] = number % 13u == 12u ? NAN : -residual.left_uT[i][axis] + within(0.1f);
        }
    }
    block_select_reduce(select, all, count, bits, CHIPS, &state, block);
    if (number % 5u == 4u) {
        block_leave_out(block, noise() % (select->count + 1u));
    }
    (void)(number % 3u == 2u ? block_filter_update_swept : block_filter_update)(filter, block, BLOCK_S);
}

static void fly(uint32_t count) {
    static loop_t coils[BLOCK_BEACONS], used[BLOCK_BEACONS];
    static block_beacon_errors_t errors[BLOCK_BEACONS];
    static block_filter_t filter;
    static block_t block;
    const block_site_errors_t site = {errors, 0.006f, 0.007f};
    sites(coils, errors);
    block_select_t select = {0};
    block_start_t start = {{0.1f, 0.2f, 0.3f}, {0.0f, 0.0f, 0.0f, 1.0f}, {{0.0f}},
                           {{0.0f}},           {20.0f, 5.0f, -40.0f},    0.1f};
    for (uint32_t axis = 0; axis < 3u; axis++) {
        start.position_cov_m2[axis][axis] = start.attitude_cov_rad2[axis][axis] = 1e-5f;
    }
    block_filter_init(&filter, coils, count, NOISE);
    block_filter_start(&filter, &start);
    for (uint32_t number = 0; number < 40u; number++) {
        if (number % 4u == 0u) {
            const uint32_t out = number % 8u == 0u ? 0u : noise();
            block_select(&select, coils, count, filter.filters[filter.best].state.position_m, out, number % 3u == 0u);
            for (uint32_t i = 0; i < select.count; i++) {
                used[i] = coils[select.rows[i]];
            }
            block_filter_coils(&filter, used, select.count);
            block_filter_keep_slopes(&filter, number >= 20u);
        }
        take(&filter, &block, &select, coils, count, number);
        float covariance[6][6];
        block_errors(&filter.measure, filter.coils, select.count, &site, covariance);
        block_pose_t pose;
        block_filter_output(&filter, 0.5f * BLOCK_S, &pose);
        block_filter_shift(&filter, pose.state.position_m, pose.state.quaternion, &start, 0.1f);
        (void)block_separate(&block);
    }
}

int main(void) {
    for (uint32_t count = 0; count <= BLOCK_BEACONS; count++) {
        fly(count);
    }
    return 0;
}

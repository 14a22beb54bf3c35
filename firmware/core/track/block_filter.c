#include "core/track/block_filter.h"

#include <string.h>

#include "core/math/chi_square.h"
#include "core/math/quaternion.h"
#include "core/math/vector3.h"

#define REFUSED  4.265f /* Normal deviate of the gate, which a block as described passes in all but one of 100,000. */
#define MEMORY_S 0.15f  /* Time over which likelihoods are compared. */
#define BEHIND   3.0f   /* By how much a copy's log likelihood is less than that of the filter it was copied from. */
#define HUGE_UT  1e6f   /* Sum beyond which a block is no data, uT. */

/* Standard deviations at a start, beside the pose's. */
#define START_DEVIATION 2.0f /* Of the pose, over those it was located with. */
#define START_VELOCITY  3.0f /* m/s. */
#define START_RATE      4.0f /* rad/s. */
#define START_FIELD     5.0f /* Of the ambient field, and of the offset, uT. */

static const float agilities[BLOCK_FILTERS][2] = {{0.05f, 0.1f}, {0.5f, 1.0f}, {2.0f, 4.0f}, {8.0f, 15.0f}};

void block_filter_init(block_filter_t *filter, const loop_t *coils, uint32_t count, float noise_uT) {
    memset(filter, 0, sizeof *filter);
    filter->coils = coils;
    filter->count = count;
    filter->measure.noise_uT = noise_uT;
    filter->refused = BLOCK_FILTER_REFUSALS;
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        filter->filters[k].acceleration = agilities[k][0];
        filter->filters[k].turn = agilities[k][1];
    }
}

bool block_filter_lost(const block_filter_t *filter) {
    return filter->refused >= BLOCK_FILTER_REFUSALS;
}

/* Lets a filter go on as another, with its own agility. */
static void copy(block_kalman_t *filter, const block_kalman_t *other) {
    const float acceleration = filter->acceleration, turn = filter->turn;
    *filter = *other;
    filter->acceleration = acceleration;
    filter->turn = turn;
}

void block_filter_start(block_filter_t *filter, const block_start_t *start) {
    block_kalman_t *const first = &filter->filters[0];
    const float field2 = START_FIELD * START_FIELD, noise2 = start->ambient_sd_uT * start->ambient_sd_uT;
    float rotation[3][3];
    memset(&first->state, 0, sizeof first->state);
    memset(first->covariance, 0, sizeof first->covariance);
    memcpy(first->state.position_m, start->position_m, sizeof start->position_m);
    memcpy(first->state.quaternion, start->quaternion, sizeof start->quaternion);
    quaternion_matrix(start->quaternion, rotation);
    for (uint32_t row = 0; row < 3u; row++) {
        first->state.ambient_uT[row] = vector3_dot(rotation[row], start->ambient_uT);
        for (uint32_t column = 0; column < 3u; column++) {
            const float scale = START_DEVIATION * START_DEVIATION;
            first->covariance[BLOCK_P + row][BLOCK_P + column] = scale * start->position_cov_m2[row][column];
            first->covariance[BLOCK_THETA + row][BLOCK_THETA + column] = scale * start->attitude_cov_rad2[row][column];
        }
        first->covariance[BLOCK_V + row][BLOCK_V + row] = START_VELOCITY * START_VELOCITY;
        first->covariance[BLOCK_W + row][BLOCK_W + row] = START_RATE * START_RATE;
        first->covariance[BLOCK_E + row][BLOCK_E + row] = field2 + noise2;
        first->covariance[BLOCK_B + row][BLOCK_B + row] = field2;
    }
    first->likelihood = 0.0f;
    for (uint32_t k = 1; k < BLOCK_FILTERS; k++) {
        copy(&filter->filters[k], first);
    }
    filter->best = 0;
    filter->refused = 0;
    filter->chi_square = 0.0f;
    filter->freedom = 0;
}

/* Returns whether all sums are numbers of a possible size. */
static bool plausible(const block_t *block) {
    bool all = true;
    for (uint32_t i = 0; i < block->columns; i++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            const float sum = block->sums_uT[i][axis];
            all = all && sum < HUGE_UT && sum > -HUGE_UT;
        }
    }
    return all;
}

void block_filter_predict(block_filter_t *filter, float seconds) {
    const float x = (seconds > 0.0f ? seconds : 0.0f) / MEMORY_S;
    const float kept = 1.0f / (1.0f + x * (1.0f + x * (0.5f + x * (1.0f / 6.0f)))); /* exp(-x) for small x. */
    for (uint32_t k = 0; k < BLOCK_FILTERS && !block_filter_lost(filter); k++) {
        block_kalman_predict(&filter->filters[k], seconds);
        filter->filters[k].likelihood *= kept;
    }
}

/* Gives the block that was measured to all filters.
 * Returns which of them took it, a bit each; the likelihoods are updated, and best is the likeliest that took it. */
static uint32_t take(block_filter_t *filter) {
    const float limit = chi_square_limit((float)filter->measure.rank, REFUSED);
    float gain[BLOCK_FILTERS], chi_square[BLOCK_FILTERS];
    uint32_t took = 0, best = BLOCK_FILTERS;
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        float log_determinant;
        if (block_kalman_update(&filter->filters[k], &filter->measure, limit, &chi_square[k], &log_determinant)) {
            took |= 1u << k;
        }
        gain[k] = -0.5f * (chi_square[k] + log_determinant);
    }
    for (uint32_t k = 0; k < BLOCK_FILTERS && took != 0u; k++) {
        filter->filters[k].likelihood += gain[k];
        if ((took >> k & 1u) != 0u &&
            (best == BLOCK_FILTERS || filter->filters[k].likelihood > filter->filters[best].likelihood)) {
            best = k;
        }
    }
    if (took != 0u) {
        filter->best = best;
        filter->chi_square = chi_square[best];
        filter->freedom = filter->measure.rank;
    }
    return took;
}

bool block_filter_update(block_filter_t *filter, const block_t *block, float seconds) {
    block_filter_predict(filter, seconds);
    if (block_filter_lost(filter) || block->columns != filter->count + 1u || !plausible(block)) {
        return false;
    }
    filter->measure.reference = filter->filters[filter->best].state;
    block_measure(block, filter->coils, &filter->measure);
    const uint32_t took = take(filter);
    if (took == 0u) {
        filter->refused++;
        return false;
    }
    filter->refused = 0;
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        if ((took >> k & 1u) == 0u) {
            copy(&filter->filters[k], &filter->filters[filter->best]);
            filter->filters[k].likelihood -= BEHIND;
        }
    }
    return true;
}

void block_filter_output(const block_filter_t *filter, float seconds, block_pose_t *pose) {
    block_kalman_t ahead = filter->filters[filter->best];
    block_kalman_predict(&ahead, seconds);
    pose->state = ahead.state;
    for (uint32_t row = 0; row < 6u; row++) {
        memcpy(pose->covariance[row], ahead.covariance[row], sizeof pose->covariance[row]);
    }
    pose->chi_square = filter->chi_square;
    pose->freedom = filter->freedom;
}

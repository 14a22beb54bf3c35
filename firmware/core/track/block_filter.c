#include "core/track/block_filter.h"

#include <stddef.h>
#include <string.h>

#include "core/math/chi_square.h"
#include "core/math/logarithm.h"
#include "core/math/quaternion.h"
#include "core/math/vector3.h"

#define REFUSED  4.265f /* Normal deviate of the gate, which a block as described passes in all but one of 100,000. */
#define MIX_S    0.012f /* Time after which the filters are mixed. */
#define CHANGE_S 0.5f   /* Time in which the sensor begins to move in another way. */
#define HUGE_UT  1e6f   /* Sum beyond which a block is no data, uT. */
#define MOVES    3.0f   /* Deviations beyond which a sensor moves, or has moved on. */

/* Standard deviations at a start, beside the pose's. */
#define START_DEVIATION 2.0f /* Factor on those that the pose was located with. */
#define START_VELOCITY  3.0f /* m/s. */
#define START_RATE      4.0f /* rad/s. */
/* Deviations of a pose by which the motion in its time is uncertain: its sums have that of a line through as many
 * poses, the root of 12, over its time. */
#define MOVED       3.5f
#define START_FIELD 5.0f /* Ambient field, and offset, uT. */

/* The last filter always has the greatest agility, the others have three neighbours of the rest. */
static const float agilities[][2] = {{0.01f, 0.02f}, {0.05f, 0.08f}, {0.25f, 0.3f},
                                     {0.5f, 1.0f},   {2.0f, 4.0f},   {8.0f, 15.0f}};

#define MOST      ((uint32_t)(sizeof agilities / sizeof agilities[0]) - 1u)
#define FOLLOWERS (BLOCK_FILTERS - 1u)
#define BEGIN     (MOST - FOLLOWERS) /* A track begins with the greatest: nobody knows yet how the sensor moves. */
#define LIKELY    0.4f /* Probability of much agility from which on it is asked whether more is wanted, ... */
#define CERTAIN   0.5f /* ... and of the least agile filter from which on it is asked whether less is enough. */

/* Gives a filter an agility. Each of the followers has every third of them, in turn. */
static void expect(block_filter_t *filter, uint32_t which) {
    block_kalman_t *const one = &filter->filters[which == MOST ? FOLLOWERS : which % FOLLOWERS];
    one->acceleration2 = agilities[which][0] * agilities[which][0];
    one->turn2 = agilities[which][1] * agilities[which][1];
}

/* Lets the followers have the agilities next to the likeliest one: if that is likely to be the greatest of theirs or
 * beyond, the filter with the least takes the next above them; if it is certain to be the least, the other way round.
 * It goes on with what it knows. */
static void follow(block_filter_t *filter) {
    const block_kalman_t *const filters = filter->filters;
    const uint32_t least = filter->least % FOLLOWERS, greatest = (filter->least + FOLLOWERS - 1u) % FOLLOWERS;
    const float agile = filters[greatest].probability + filters[FOLLOWERS].probability;
    if (agile > LIKELY && filter->least + FOLLOWERS < MOST) {
        expect(filter, filter->least + FOLLOWERS);
        filter->least++;
    } else if (filters[least].probability > CERTAIN && filter->least > 0u) {
        filter->least--;
        expect(filter, filter->least);
    }
}

void block_filter_init(block_filter_t *filter, const loop_t *coils, uint32_t count, float noise_uT) {
    memset(filter, 0, sizeof *filter);
    filter->coils = coils;
    filter->count = count;
    filter->measure.noise_uT = noise_uT;
    filter->refused = BLOCK_FILTER_REFUSALS;
}

void block_filter_coils(block_filter_t *filter, const loop_t *coils, uint32_t count) {
    filter->measure.known = false;
    filter->coils = coils;
    filter->count = count;
}

bool block_filter_lost(const block_filter_t *filter) {
    return filter->refused >= BLOCK_FILTER_REFUSALS;
}

void block_filter_begin(block_filter_t *filter, const block_state_t *state,
                        const float covariance[BLOCK_STATES][BLOCK_STATES]) {
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        block_kalman_t *const one = &filter->filters[k];
        one->state = *state;
        memcpy(one->covariance, covariance, sizeof one->covariance);
        one->probability = 1.0f / (float)BLOCK_FILTERS;
        expect(filter, BEGIN + k);
    }
    filter->least = BEGIN;
    filter->kept = false;
    filter->best = 0;
    filter->refused = 0;
    filter->unmixed_s = 0.0f;
    filter->chi_square = 0.0f;
    filter->freedom = 0;
}

void block_filter_start(block_filter_t *filter, const block_start_t *start) {
    const float field2 = START_FIELD * START_FIELD, noise2 = start->ambient_sd_uT * start->ambient_sd_uT;
    const float scale = START_DEVIATION * START_DEVIATION;
    float rotation[3][3], covariance[BLOCK_STATES][BLOCK_STATES] = {{0.0f}};
    block_state_t state = {{0.0f}, {0.0f}, {0.0f}, {0.0f}, {0.0f}, {0.0f}};
    memcpy(state.position_m, start->position_m, sizeof start->position_m);
    memcpy(state.quaternion, start->quaternion, sizeof start->quaternion);
    quaternion_matrix(start->quaternion, rotation);
    for (uint32_t row = 0; row < 3u; row++) {
        state.ambient_uT[row] = vector3_dot(rotation[row], start->ambient_uT);
        for (uint32_t column = 0; column < 3u; column++) {
            covariance[BLOCK_P + row][BLOCK_P + column] = scale * start->position_cov_m2[row][column];
            covariance[BLOCK_THETA + row][BLOCK_THETA + column] = scale * start->attitude_cov_rad2[row][column];
        }
        covariance[BLOCK_V + row][BLOCK_V + row] = START_VELOCITY * START_VELOCITY;
        covariance[BLOCK_W + row][BLOCK_W + row] = START_RATE * START_RATE;
        covariance[BLOCK_E + row][BLOCK_E + row] = field2 + noise2;
        covariance[BLOCK_B + row][BLOCK_B + row] = field2;
    }
    block_filter_begin(filter, &state, (const float(*)[BLOCK_STATES])covariance);
}

static float least(float a, float b) {
    return a < b ? a : b;
}

static float trace(const float matrix[3][3]) {
    return matrix[0][0] + matrix[1][1] + matrix[2][2];
}

void block_filter_shift(block_filter_t *filter, const float from_m[3], const float from[4], const block_start_t *there,
                        float seconds) {
    const block_state_t now = filter->filters[filter->best].state;
    block_state_t was = now, is = now, moved;
    memcpy(was.position_m, from_m, sizeof was.position_m);
    memcpy(was.quaternion, from, sizeof was.quaternion);
    memcpy(is.position_m, there->position_m, sizeof is.position_m);
    memcpy(is.quaternion, there->quaternion, sizeof is.quaternion);
    float errors[BLOCK_STATES];
    block_state_subtract(&is, &was, errors);
    block_state_move(&now, errors, &moved);
    const float unmixed_s = filter->unmixed_s;
    block_filter_start(filter, there);
    filter->unmixed_s = unmixed_s;
    const float moved2 = MOVED * MOVED / (seconds * seconds);
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        block_kalman_t *const one = &filter->filters[k];
        one->state = moved;
        for (uint32_t axis = 0; axis < 3u; axis++) {
            const uint32_t v = BLOCK_V + axis, w = BLOCK_W + axis;
            one->covariance[v][v] = least(one->covariance[v][v], moved2 * trace(there->position_cov_m2));
            one->covariance[w][w] = least(one->covariance[w][w], moved2 * trace(there->attitude_cov_rad2));
        }
    }
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

void block_filter_keep_slopes(block_filter_t *filter, bool keep) {
    filter->keeps = keep;
    filter->kept = filter->kept && keep;
}

void block_filter_predict(block_filter_t *filter, float seconds) {
    if (block_filter_lost(filter)) {
        return;
    }
    filter->unmixed_s += seconds;
    if (filter->unmixed_s >= MIX_S) {
        const float change = (1.0f - exponential(-filter->unmixed_s / CHANGE_S)) / (float)(BLOCK_FILTERS - 1u);
        follow(filter);
        block_mix(filter->filters, filter->best, change);
        filter->unmixed_s = 0.0f;
    }
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        block_kalman_predict(&filter->filters[k], seconds);
    }
}

/* Returns the variance of one of the vectors of a state, summed over its axes. */
static float variance(const block_kalman_t *filter, uint32_t first) {
    float sum = 0.0f;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        sum += filter->covariance[first + axis][first + axis];
    }
    return sum;
}

static float square(const float vector[3]) {
    return vector3_dot(vector, vector);
}

/* Returns whether the sensor stands still where the slopes were taken, for all that is known. The ambient field turns
 * with the attitude that it was seen from. */
static bool stands(const block_filter_t *filter) {
    const block_kalman_t *const best = &filter->filters[filter->best];
    const block_state_t *const state = &best->state;
    const float field2 = START_FIELD * START_FIELD +
                         square(state->ambient_uT) * (variance(best, BLOCK_THETA) + filter->kept_rad2);
    float moved[3], turned[3];
    vector3_subtract(state->position_m, filter->measure.place.position_m, moved);
    vector3_subtract(state->ambient_uT, filter->measure.place.ambient_uT, turned);
    return square(state->velocity_m_s) <= MOVES * MOVES * variance(best, BLOCK_V) &&
           square(moved) <= MOVES * MOVES * (variance(best, BLOCK_P) + filter->kept_m2) &&
           square(turned) <= MOVES * MOVES * field2;
}

/* Decides whether the slopes of the block before are kept; those that are taken anew may be kept from then on if this
 * one keeps any. */
static void settle(block_filter_t *filter, bool keeps) {
    const block_kalman_t *const best = &filter->filters[filter->best];
    filter->measure.held = keeps && filter->kept && stands(filter);
    filter->kept = keeps;
    if (!filter->measure.held) {
        filter->kept_m2 = variance(best, BLOCK_P);
        filter->kept_rad2 = variance(best, BLOCK_THETA);
    }
}

/* Gives the block that was measured to all filters, with the rows of its sweep or NULL.
 * Returns whether any took it. */
static inline bool take(block_filter_t *filter, const block_sweep_t *sweep) {
    const float limit = chi_square_limit((float)filter->measure.rank, REFUSED);
    float likelihood[BLOCK_FILTERS], chi_square[BLOCK_FILTERS];
    bool taken = false;
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        float log_determinant;
        chi_square[k] = block_kalman_update(&filter->filters[k], &filter->measure, sweep, limit, &log_determinant);
        taken = taken || chi_square[k] <= limit;
        likelihood[k] = -0.5f * (chi_square[k] + log_determinant);
    }
    if (taken) {
        filter->best = block_mix_weigh(filter->filters, likelihood, &filter->log_likelihood);
        filter->chi_square = chi_square[filter->best];
        filter->freedom = filter->measure.rank;
    }
    return taken;
}

/* Moves on and takes a block, with its sweep if there is room for it. It is inline, so that the sensor's update has
 * nothing of the sweep in it. */
static inline bool update(block_filter_t *filter, const block_t *block, float seconds, block_sweep_t *sweep) {
    block_filter_predict(filter, seconds);
    if (block_filter_lost(filter) || block->columns != filter->count + 1u || !plausible(block)) {
        return false;
    }
    filter->measure.reference = filter->filters[filter->best].state;
    settle(filter, filter->keeps && sweep == NULL);
    block_measure(block, filter->coils, &filter->measure);
    filter->measure.known = true;
    if (sweep != NULL) {
        filter->measure.rank += block_sweep(block, &filter->measure, sweep);
    }
    const bool taken = take(filter, sweep);
    filter->refused = taken ? 0u : filter->refused + 1u;
    return taken;
}

bool block_filter_update(block_filter_t *filter, const block_t *block, float seconds) {
    return update(filter, block, seconds, NULL);
}

bool block_filter_update_swept(block_filter_t *filter, const block_t *block, float seconds) {
    block_sweep_t sweep;
    return update(filter, block, seconds, &sweep);
}

void block_filter_output(const block_filter_t *filter, float seconds, block_pose_t *pose) {
    block_mix_output(filter->filters, filter->best, seconds, &pose->state, pose->covariance);
    pose->chi_square = filter->chi_square;
    pose->freedom = filter->freedom;
}

#include "core/timing/edge_track.h"

#include <string.h>

#include "core/math/normal3.h"
#include "core/math/roots.h"

#define CONVERSIONS 8u    /* Conversions in a burst. */
#define ITERATIONS  6u    /* Iterations of Gauss and Newton. */
#define HALVINGS    16u   /* Halvings of the interval in which a contrast is looked for. */
#define MISFIT      16.0f /* Largest chi squared of two looks that fit: 0.03 % are larger. */
/* Variance of an edge besides noise, ticks^2: (0.05 us)^2, since the beacons' edges lie up to 48 ns apart, and the
 * ramp is a model. */
#define EDGE_VARIANCE 70.0f
/* Growth of the rate's variance in a chip, (ticks a chip)^2: 0.05 ppm in 1 s, for the crystals' temperature. */
#define RATE_WALK 6.6e-11f
#define RISE_MIN  300.0f   /* Shortest rise, ticks: 1.8 us. */
#define RISE_MAX  20000.0f /* Longest rise that a first look is taken for, ticks: 119 us, more than a chip. */
#define STEP_MAX  400.0f   /* Largest change of the time in one iteration, ticks: two conversions. */

/* The height on the ramp, in ticks of it, and its slope. */
typedef struct {
    float height, slope;
} ramp_t;

/* Returns what one conversion shows, a time after the beacons' edge. */
static ramp_t ramp(float time, float lag) {
    if (!(time > 0.0f)) {
        return (ramp_t){0.0f, 0.0f};
    }
    const float slope = 1.0f - edge_decay(time / lag);
    return (ramp_t){time - lag * slope, slope};
}

/* Returns what the late conversions show minus what the early ones do, with the last one a time after the edge. */
static ramp_t contrast(const edge_burst_t *burst, float time) {
    ramp_t sum = {0.0f, 0.0f};
    for (uint32_t i = 0; i < CONVERSIONS; i++) {
        const float share = i < burst->early ? -1.0f / (float)burst->early : 1.0f / (float)(CONVERSIONS - burst->early);
        const ramp_t one = ramp(time - (float)(CONVERSIONS - 1u - i) * burst->conversion_ticks, burst->lag_ticks);
        sum.height += share * one.height;
        sum.slope += share * one.slope;
    }
    return sum;
}

/* Returns the time at which the contrast has a height, by halving the interval: the contrast grows until all
 * conversions are on the ramp. */
static float time_of_contrast(const edge_burst_t *burst, float height) {
    float low = 0.0f, high = (float)CONVERSIONS * burst->conversion_ticks;
    for (uint32_t step = 0; step < HALVINGS; step++) {
        const float time = 0.5f * (low + high);
        if (contrast(burst, time).height < height) {
            low = time;
        } else {
            high = time;
        }
    }
    return 0.5f * (low + high);
}

void edge_track_start(edge_track_t *track, const edge_fit_t *fit, float time_ticks) {
    *track = (edge_track_t){.time_ticks = time_ticks, .rise_ticks = fit->rise_ticks, .rise_known = true};
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            /* A later edge is a shorter time after it. */
            const float sign = (row == 2u) != (column == 2u) ? -1.0f : 1.0f;
            track->covariance[row][column] = sign * fit->covariance[row][column];
        }
    }
    track->covariance[0][0] += EDGE_VARIANCE;
}

void edge_track_known(edge_track_t *track, float time_ticks, float time_deviation, float rate_deviation) {
    *track = (edge_track_t){.time_ticks = time_ticks};
    track->covariance[0][0] = time_deviation * time_deviation + EDGE_VARIANCE;
    track->covariance[1][1] = rate_deviation * rate_deviation;
}

void edge_track_rise(edge_track_t *track, const edge_burst_t *burst, const edge_look_t looks[2]) {
    if (track->rise_known) {
        return;
    }
    const float share = 0.5f * (looks[0].share + looks[1].share), height = contrast(burst, track->time_ticks).height;
    const float rise = share * RISE_MAX > height ? height / share : RISE_MAX;
    track->rise_ticks = rise > RISE_MIN ? rise : RISE_MIN;
    track->covariance[2][2] = track->rise_ticks * track->rise_ticks;
    track->rise_known = true;
}

void edge_track_move(edge_track_t *track, float chips) {
    float(*p)[3] = track->covariance;
    track->time_ticks += chips * track->rate;
    p[0][0] += chips * (2.0f * p[0][1] + chips * p[1][1]);
    p[0][1] += chips * p[1][1];
    p[0][2] += chips * p[1][2];
    p[1][0] = p[0][1];
    p[2][0] = p[0][2];
    p[1][1] += chips * RATE_WALK;
}

float edge_track_variance(const edge_track_t *track, float chips) {
    return track->covariance[0][0] + chips * (2.0f * track->covariance[0][1] + chips * track->covariance[1][1]);
}

bool edge_track_blind(const edge_track_t *track, const edge_burst_t *burst, const edge_look_t looks[2]) {
    const float share = 0.5f * (looks[0].share + looks[1].share),
                expected = contrast(burst, track->time_ticks).height / track->rise_ticks;
    const float deviation = 0.5f * square_root(looks[0].variance + looks[1].variance);
    return share < 2.0f * deviation && share < expected - 3.0f * deviation;
}

/* Iterates Gauss and Newton from a time. Returns chi squared. */
static float iterate(edge_track_t *track, const edge_burst_t *burst, const edge_look_t looks[2], float time) {
    const float before[3] = {track->time_ticks, track->rate, track->rise_ticks};
    float known[3][3], x[3] = {time, track->rate, track->rise_ticks}, misfit = 0.0f;
    normal3_invert((const float(*)[3])track->covariance, known);
    normal3_t normal;
    for (uint32_t i = 0; i <= ITERATIONS; i++) {
        memcpy(normal.matrix, known, sizeof known);
        misfit = 0.0f;
        for (uint32_t row = 0; row < 3u; row++) {
            normal.side[row] = 0.0f;
            for (uint32_t column = 0; column < 3u; column++) {
                normal.side[row] += known[row][column] * (before[column] - x[column]);
            }
            misfit += normal.side[row] * (before[row] - x[row]);
        }
        for (uint32_t k = 0; k < 2u; k++) {
            const ramp_t seen = contrast(burst, x[0] + looks[k].chips * x[1]);
            const float share = seen.height / x[2], by_time = seen.slope / x[2];
            const float slope[3] = {by_time, by_time * looks[k].chips, -share / x[2]};
            const float error = looks[k].share - share,
                        weight = 1.0f / (looks[k].variance + EDGE_VARIANCE * by_time * by_time);
            normal3_add(&normal, slope, error, weight);
            misfit += weight * error * error;
        }
        if (i < ITERATIONS) {
            float step[3];
            normal3_solve(&normal, step);
            x[0] += step[0] < -STEP_MAX ? -STEP_MAX : step[0] > STEP_MAX ? STEP_MAX : step[0];
            x[1] += step[1];
            x[2] = x[2] + step[2] < RISE_MIN ? RISE_MIN : x[2] + step[2];
        }
    }
    track->time_ticks = x[0];
    track->rate = x[1];
    track->rise_ticks = x[2];
    normal3_invert((const float(*)[3])normal.matrix, track->covariance);
    return misfit;
}

void edge_track_update(edge_track_t *track, const edge_burst_t *burst, const edge_look_t looks[2]) {
    const edge_track_t before = *track;
    if (iterate(track, burst, looks, before.time_ticks) < MISFIT) {
        return;
    }
    *track = before;
    const float time = time_of_contrast(burst, 0.5f * (looks[0].share + looks[1].share) * track->rise_ticks);
    track->covariance[0][0] += (time - before.time_ticks) * (time - before.time_ticks);
    (void)iterate(track, burst, looks, time);
}

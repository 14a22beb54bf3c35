#include "core/timing/edge_fit.h"

#include "core/math/normal3.h"

#define STEPS       8u      /* Iterations. */
#define UNKNOWNS    3.0f    /* Onset, slip and rise. */
#define MIDDLE_CHIP 511.0f  /* Chip of the record at which the onset holds. */
#define RISE_START  5000.0f /* Rise with which the fit starts, ticks: 30 us. */
#define RISE_MIN    300.0f  /* Shortest and longest rise, ticks: 1.8 us and 48 us. */
#define RISE_MAX    8000.0f
#define SLIP_MAX    5.0f /* Largest slip, ticks a chip: 300 ppm. */

static float limit(float value, float low, float high) {
    return value < low ? low : value > high ? high : value;
}

/* The integral S and the height R of an endless ramp. */
typedef struct {
    float integral, height;
} ramp_t;

static ramp_t ramp(float t, float lag) {
    if (!(t > 0.0f)) {
        return (ramp_t){0.0f, 0.0f};
    }
    const float height = t - lag * (1.0f - edge_decay(t / lag));
    return (ramp_t){0.5f * t * t - lag * height, height};
}

/* A(t) L of an edge of rise L, and its derivatives by t and by L. */
typedef struct {
    float value, by_time, by_rise;
} edge_t;

static edge_t edge(float t, float rise, float lag) {
    const ramp_t foot = ramp(t, lag), head = ramp(t - rise, lag);
    return (edge_t){foot.integral - head.integral, foot.height - head.height, head.height};
}

/* Returns what a bin should show of level or step, and the derivatives. */
static edge_t model(const edge_shape_t *shape, float t, float rise, bool step) {
    const float half = 0.5f * shape->burst_ticks;
    const edge_t late = edge(t + half, rise, shape->lag_ticks), early = edge(t - half, rise, shape->lag_ticks);
    const float scale = (step ? 2.0f : 1.0f) / (shape->burst_ticks * rise);
    edge_t sum = {late.value - early.value, late.by_time - early.by_time, late.by_rise - early.by_rise};
    if (step) {
        const edge_t middle = edge(t, rise, shape->lag_ticks);
        sum = (edge_t){late.value + early.value - 2.0f * middle.value,
                       late.by_time + early.by_time - 2.0f * middle.by_time,
                       late.by_rise + early.by_rise - 2.0f * middle.by_rise};
    }
    return (edge_t){scale * sum.value, scale * sum.by_time, scale * (sum.by_rise - sum.value / rise)};
}

/* What levels or steps alone tell: normal equations about the present fit, what the fit leaves of the squares, the
 * spread that there was about their mean, and the number of bins. */
typedef struct {
    normal3_t normal;
    float left, spread, bins;
} part_t;

static part_t linearise(const edge_bin_t bins[EDGE_FIT_SWEEPS][EDGE_FIT_BINS], const edge_shape_t *shape,
                        const edge_fit_t *fit, bool step) {
    part_t part = {.left = 0.0f};
    float sum = 0.0f, squares = 0.0f, weights = 0.0f;
    for (uint32_t i = 0; i < EDGE_FIT_SWEEPS * EDGE_FIT_BINS; i++) {
        const edge_bin_t *bin = &bins[i / EDGE_FIT_BINS][i % EDGE_FIT_BINS];
        if (!(bin->weight > 0.0f)) {
            continue;
        }
        const float seen = bin->product / bin->weight, chip = bin->chip / bin->weight - MIDDLE_CHIP;
        const float t = bin->phase / bin->weight * shape->chip_ticks - fit->onset_ticks -
                        fit->slip_ticks_per_chip * chip;
        const edge_t shown = model(shape, t, fit->rise_ticks, step);
        const float slope[3] = {-shown.by_time, -shown.by_time * chip, shown.by_rise};
        const float error = seen - shown.value;
        normal3_add(&part.normal, slope, error, bin->weight);
        part.left += bin->weight * error * error;
        part.bins += 1.0f;
        sum += bin->weight * seen;
        squares += bin->weight * seen * seen;
        weights += bin->weight;
    }
    part.spread = weights > 0.0f ? squares - sum * sum / weights : 0.0f;
    return part;
}

/* Adds normal equations, weighted by the variance that their residuals show. */
static void weigh(normal3_t *sum, const part_t *part) {
    const float information = (part->bins - UNKNOWNS) / (part->left + 1e-20f);
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            sum->matrix[row][column] += information * part->normal.matrix[row][column];
        }
        sum->side[row] += information * part->normal.side[row];
    }
}

bool edge_fit(const edge_profile_t *profile, const edge_shape_t *shape, edge_fit_t *fit) {
    *fit = (edge_fit_t){.onset_ticks = -0.5f * RISE_START, .rise_ticks = RISE_START};
    for (uint32_t i = 0; i < STEPS; i++) {
        const part_t level = linearise(profile->level, shape, fit, false),
                     step = linearise(profile->step, shape, fit, true);
        if (!(level.bins > UNKNOWNS) || !(step.bins > UNKNOWNS)) {
            return false;
        }
        normal3_t normal = {.side = {0.0f}};
        weigh(&normal, &level);
        weigh(&normal, &step);
        if (i + 1u == STEPS) {
            normal3_invert((const float(*)[3])normal.matrix, fit->covariance);
            return level.left < 0.5f * level.spread;
        }
        float change[3];
        normal3_solve(&normal, change);
        fit->onset_ticks += limit(change[0], -1000.0f, 1000.0f);
        fit->slip_ticks_per_chip = limit(fit->slip_ticks_per_chip + limit(change[1], -2.0f, 2.0f), -SLIP_MAX, SLIP_MAX);
        fit->rise_ticks = limit(fit->rise_ticks + limit(change[2], -1500.0f, 1500.0f), RISE_MIN, RISE_MAX);
    }
    return false;
}

#include "edge_fit.h"

#define STEPS 20u
#define MIDDLE_CHIP 511.0f
#define RISE_START 5000.0f /* 30 us. */
#define RISE_MIN 300.0f
#define RISE_MAX 8000.0f
#define SLIP_MAX 5.0f      /* 300 ppm of a chip. */

static float limit(float value, float low, float high) { return value < low ? low : value > high ? high : value; }

/* F and its derivatives by t and by L. */
typedef struct {
    float value, by_time, by_rise;
} ramp_t;

static ramp_t ramp(float t, float rise) {
    if (t <= 0.0f) {
        return (ramp_t){0.0f, 0.0f, 0.0f};
    }
    if (t >= rise) {
        return (ramp_t){t - 0.5f * rise, 1.0f, -0.5f};
    }
    const float share = t / rise;
    return (ramp_t){0.5f * t * share, share, -0.5f * share * share};
}

static ramp_t fraction(float t, float rise, float burst) {
    const ramp_t late = ramp(t + 0.5f * burst, rise), early = ramp(t - 0.5f * burst, rise);
    return (ramp_t){(late.value - early.value) / burst, (late.by_time - early.by_time) / burst, (late.by_rise - early.by_rise) / burst};
}

/* Solve the symmetric a x = b by elimination; damping keeps a positive. */
static void solve(float a[3][3], float b[3], float x[3]) {
    for (uint32_t i = 0; i < 3u; i++) {
        a[i][i] = a[i][i] * 1.001f + 1e-20f;
    }
    for (uint32_t i = 0; i < 2u; i++) {
        for (uint32_t row = i + 1u; row < 3u; row++) {
            const float factor = a[row][i] / a[i][i];
            for (uint32_t column = i; column < 3u; column++) {
                a[row][column] -= factor * a[i][column];
            }
            b[row] -= factor * b[i];
        }
    }
    x[2] = b[2] / a[2][2];
    x[1] = (b[1] - a[1][2] * x[2]) / a[1][1];
    x[0] = (b[0] - a[0][1] * x[1] - a[0][2] * x[2]) / a[0][0];
}

bool edge_fit(const edge_profile_t *profile, float bin_ticks, float burst_ticks, edge_fit_t *fit) {
    float left = 0.0f, spread = 0.0f;
    *fit = (edge_fit_t){-0.5f * RISE_START, 0.0f, RISE_START};
    for (uint32_t step = 0; step < STEPS; step++) {
        float a[3][3] = {{0.0f}}, b[3] = {0.0f}, change[3];
        float sum = 0.0f, squares = 0.0f, weights = 0.0f;
        left = 0.0f;
        for (uint32_t sweep = 0; sweep < EDGE_FIT_SWEEPS; sweep++) {
            for (uint32_t bin = 0; bin < EDGE_FIT_BINS; bin++) {
                const float weight = profile->weight[sweep][bin];
                if (!(weight > 0.0f)) {
                    continue;
                }
                const float seen = profile->product[sweep][bin] / weight;
                const float chip = profile->moment[sweep][bin] / weight - MIDDLE_CHIP;
                const float x = ((float)bin + 0.5f - 0.5f * (float)EDGE_FIT_BINS) * bin_ticks;
                const ramp_t model = fraction(x - fit->onset_ticks - fit->slip_ticks_per_chip * chip, fit->rise_ticks, burst_ticks);
                const float slope[3] = {-model.by_time, -model.by_time * chip, model.by_rise};
                const float error = seen - model.value;
                for (uint32_t row = 0; row < 3u; row++) {
                    for (uint32_t column = 0; column < 3u; column++) {
                        a[row][column] += weight * slope[row] * slope[column];
                    }
                    b[row] += weight * slope[row] * error;
                }
                left += weight * error * error;
                sum += weight * seen;
                squares += weight * seen * seen;
                weights += weight;
            }
        }
        if (!(weights > 0.0f)) {
            return false;
        }
        spread = squares - sum * sum / weights;
        solve(a, b, change);
        fit->onset_ticks += limit(change[0], -1000.0f, 1000.0f);
        fit->slip_ticks_per_chip = limit(fit->slip_ticks_per_chip + limit(change[1], -2.0f, 2.0f), -SLIP_MAX, SLIP_MAX);
        fit->rise_ticks = limit(fit->rise_ticks + limit(change[2], -1500.0f, 1500.0f), RISE_MIN, RISE_MAX);
    }
    return left < 0.5f * spread;
}

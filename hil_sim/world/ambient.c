#include "world/ambient.h"

#include <math.h>

#include "world/noise.h"

static const double two_pi = 6.283185307179586;
static const double decays_kept = 20.0;

/* Sum of the harmonics, each with the low-pass's loss 1/sqrt(1 + (w lag)^2) and delay atan(w lag). */
static double mains(const ambient_t *ambient, double time_s) {
    const double angular = two_pi * ambient->mains_Hz;
    const double angle = fmod(ambient->mains_Hz * time_s, 1.0) * two_pi + ambient->mains_phase_rad;
    double sum = 0.0;
    for (unsigned i = 0; i < AMBIENT_HARMONICS; ++i) {
        if (ambient->harmonics[i] != 0.0) {
            const double order = (double)(i + 1u);
            const double lag = order * angular * ambient->lag_s;
            sum += ambient->harmonics[i] * sin(order * angle - atan(lag)) / sqrt(1.0 + lag * lag);
        }
    }
    return sum;
}

static double impulse_shape(const ambient_t *ambient, double age_s) {
    const double decay = ambient->impulse_decay_s;
    if (ambient->lag_s <= 0.0) {
        return exp(-age_s / decay);
    }
    const double lag = fabs(ambient->lag_s - decay) < 1e-6 * decay ? decay * (1.0 + 1e-6) : ambient->lag_s;
    return (exp(-age_s / decay) - exp(-age_s / lag)) * decay / (decay - lag);
}

/* Time is cut in cells of at most one decay time and at most a tenth of the mean distance; a cell holds one impulse
 * or none. Two impulses in one cell would have a probability below 0.5 %: the process is Poisson but for those. */
static void add_impulses(const ambient_t *ambient, double time_s, double field_T[3]) {
    const double cell_s = fmin(ambient->impulse_decay_s, 0.1 / ambient->impulse_rate_Hz);
    const double chance = 1.0 - exp(-ambient->impulse_rate_Hz * cell_s);
    const uint64_t when = noise_stream(ambient->seed, NOISE_IMPULSE, 0, 0);
    const uint64_t up = noise_stream(ambient->seed, NOISE_IMPULSE, 0, 1);
    const uint64_t around = noise_stream(ambient->seed, NOISE_IMPULSE, 0, 2);
    const int64_t last = (int64_t)floor(time_s / cell_s);
    const double oldest = floor((time_s - decays_kept * ambient->impulse_decay_s) / cell_s);
    for (int64_t cell = oldest > 0.0 ? (int64_t)oldest : 0; cell <= last; ++cell) {
        const uint64_t counter = (uint64_t)cell;
        const double draw = noise_uniform(when, counter);
        const double age_s = time_s - ((double)cell + draw / chance) *
                                          cell_s; /* Given that it happens, draw/chance is uniform in the cell. */
        if (draw < chance && age_s >= 0.0) {
            const double height = 2.0 * noise_uniform(up, counter) - 1.0;
            const double longitude = two_pi * noise_uniform(around, counter);
            const double level = sqrt(1.0 - height * height);
            const double size_T = ambient->impulse_T * impulse_shape(ambient, age_s);
            field_T[0] += size_T * level * cos(longitude);
            field_T[1] += size_T * level * sin(longitude);
            field_T[2] += size_T * height;
        }
    }
}

void ambient_field(const ambient_t *ambient, int64_t time_ps, double field_T[3]) {
    const double time_s = (double)time_ps * 1e-12;
    const double hum = ambient->mains_Hz > 0.0 ? mains(ambient, time_s) : 0.0;
    for (unsigned i = 0; i < 3u; ++i) {
        field_T[i] = ambient->earth_T[i] + ambient->mains_T[i] * hum;
    }
    if (ambient->impulse_rate_Hz > 0.0) {
        add_impulses(ambient, time_s, field_T);
    }
}

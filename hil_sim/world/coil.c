#include "world/coil.h"

#include <math.h>

#include "world/noise.h"

static const double sense_middle_V = 1.65;

static double seconds(int64_t time_ps) {
    return (double)time_ps * 1e-12;
}

/* Where the low-pass is, elapsed seconds into a slewing segment. The current is limit + b exp(-t/T), the filter's
 * answer to that limit + b T/(T - lag) exp(-t/T), and the rest dies away with the filter's own time constant. */
static double lagged_while_slewing(const coil_t *coil, const coil_segment_t *segment, double elapsed) {
    const double slow = coil->time_constant_s;
    const double lag = coil->config.lag_s;
    const double forced = (segment->current_A - segment->limit_A) * slow / (slow - lag);
    const double rest = segment->lagged_A - segment->limit_A - forced;
    return segment->limit_A + forced * exp(-elapsed / slow) + rest * exp(-elapsed / lag);
}

static double current_in(const coil_t *coil, const coil_segment_t *segment, double elapsed) {
    if (elapsed >= segment->reach_s) {
        return segment->target_A;
    }
    return segment->limit_A + (segment->current_A - segment->limit_A) * exp(-elapsed / coil->time_constant_s);
}

static double lagged_in(const coil_t *coil, const coil_segment_t *segment, double elapsed) {
    if (coil->config.lag_s <= 0.0) {
        return current_in(coil, segment, elapsed);
    }
    if (elapsed >= segment->reach_s) {
        const double rest = segment->lagged_at_reach_A - segment->target_A;
        return segment->target_A + rest * exp(-(elapsed - segment->reach_s) / coil->config.lag_s);
    }
    return lagged_while_slewing(coil, segment, elapsed);
}

/* The segment in force at a time, no later than number head. Before the oldest, the oldest. */
static const coil_segment_t *segment_at(const coil_t *coil, uint64_t head, int64_t time_ps) {
    uint64_t number = head;
    while (number > 0 && head - number < COIL_HISTORY - 1 && coil->segments[number % COIL_HISTORY].start_ps > time_ps) {
        --number;
    }
    return &coil->segments[number % COIL_HISTORY];
}

static double elapsed_in(const coil_segment_t *segment, int64_t time_ps) {
    return time_ps > segment->start_ps ? seconds(time_ps - segment->start_ps) : 0.0;
}

/* What the inputs ask for now. */
static double target(const coil_t *coil) {
    if (coil->open || !coil->enabled || coil->input1 == coil->input2) {
        return 0.0;
    }
    return coil->input1 ? coil->set_point_A : -coil->set_point_A;
}

/* Begin a segment at a time from the state at that time; two changes at one time make one segment. */
static void begin_segment(coil_t *coil, int64_t time_ps) {
    const coil_segment_t *const latest = &coil->segments[coil->head % COIL_HISTORY];
    const double elapsed = elapsed_in(latest, time_ps);
    coil_segment_t next = {
        .start_ps = latest->start_ps > time_ps ? latest->start_ps : time_ps,
        .current_A = coil->open ? 0.0 : current_in(coil, latest, elapsed),
        .lagged_A = lagged_in(coil, latest, elapsed),
        .target_A = target(coil),
    };
    const double full_A = coil->config.supply_V / coil->config.resistance_Ohm;
    next.limit_A = next.target_A > next.current_A ? full_A : -full_A;
    const double ahead = (next.current_A - next.limit_A) / (next.target_A - next.limit_A);
    if (next.current_A == next.target_A) {
        next.reach_s = 0.0;
    } else if (fabs(next.target_A) < full_A && ahead > 0.0) {
        next.reach_s = coil->time_constant_s * log(ahead);
    } else {
        next.reach_s = INFINITY;
    }
    if (coil->config.lag_s > 0.0 && isfinite(next.reach_s)) {
        next.lagged_at_reach_A = lagged_while_slewing(coil, &next, next.reach_s);
    }
    if (next.start_ps != latest->start_ps) {
        ++coil->head;
        ++coil->changes;
    }
    coil->segments[coil->head % COIL_HISTORY] = next;
}

void coil_init(coil_t *coil, const coil_config_t *config) {
    *coil = (coil_t){.config = *config, .time_constant_s = config->inductance_H / config->resistance_Ohm};
    /* Equal time constants would divide by zero; one part in a million apart is the same circuit. */
    if (fabs(coil->config.lag_s - coil->time_constant_s) < 1e-6 * coil->time_constant_s) {
        coil->config.lag_s = coil->time_constant_s * (1.0 + 1e-6);
    }
}

void coil_input(coil_t *coil, unsigned number, bool level, int64_t time_ps) {
    bool *const input = number == 1 ? &coil->input1 : &coil->input2;
    if (*input != level) {
        *input = level;
        begin_segment(coil, time_ps);
    }
}

void coil_enable(coil_t *coil, bool enabled, int64_t time_ps) {
    if (coil->enabled != enabled) {
        coil->enabled = enabled;
        begin_segment(coil, time_ps);
    }
}

void coil_reference(coil_t *coil, double volts, int64_t time_ps) {
    const double set_point_A = volts * coil->config.reference_A_per_V;
    if (coil->set_point_A != set_point_A) {
        coil->set_point_A = set_point_A;
        begin_segment(coil, time_ps);
    }
}

void coil_open(coil_t *coil, bool open, int64_t time_ps) {
    if (coil->open != open) {
        coil->open = open;
        begin_segment(coil, time_ps);
    }
}

double coil_current(const coil_t *coil, int64_t time_ps) {
    const coil_segment_t *const segment = segment_at(coil, coil->head, time_ps);
    return current_in(coil, segment, elapsed_in(segment, time_ps));
}

double coil_lagged(const coil_t *coil, uint64_t head, int64_t time_ps) {
    const coil_segment_t *const segment = segment_at(coil, head, time_ps);
    return lagged_in(coil, segment, elapsed_in(segment, time_ps));
}

double coil_sense(const coil_t *coil, uint64_t seed, uint64_t stream, int64_t time_ps) {
    if (coil->sense_shorted) {
        return 0.0;
    }
    const double noise = coil->config.sense_noise_V * noise_normal(seed, stream, (uint64_t)time_ps);
    return sense_middle_V + coil->config.sense_V_per_A * coil_current(coil, time_ps) + noise;
}

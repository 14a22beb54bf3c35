#include "world/coil.h"

#include <math.h>

#include "world/noise.h"

static const double sense_middle_V = 1.65;
static const double copper_per_K = 0.00393, copper_degC = 20.0;
static const double refresh_s = 0.01; /* A segment of a coil that warms up is not looked at for longer. */

static double seconds(int64_t time_ps) {
    return (double)time_ps * 1e-12;
}

/* ---- The laws of one piece; elapsed counts from its start ---- */

static double current_in(const coil_segment_t *segment, const coil_piece_t *piece, double elapsed) {
    if (piece->held) {
        return piece->current_A;
    }
    return piece->limit_A + (piece->current_A - piece->limit_A) * exp(-elapsed / segment->slow_s);
}

/* Where the low-pass is. A held current leaves it with its own time constant. Else the current is limit + b exp(-t/T),
 * the filter's answer to that limit + b T/(T - lag) exp(-t/T), and the rest dies away with the filter's own. */
static double lagged_in(const coil_t *coil, const coil_segment_t *segment, const coil_piece_t *piece, double elapsed) {
    const double slow = segment->slow_s, lag = coil->config.lag_s;
    if (lag <= 0.0) {
        return current_in(segment, piece, elapsed);
    }
    if (piece->held) {
        return piece->current_A + (piece->lagged_A - piece->current_A) * exp(-elapsed / lag);
    }
    const double forced = (piece->current_A - piece->limit_A) * slow / (slow - lag);
    const double rest = piece->lagged_A - piece->limit_A - forced;
    return piece->limit_A + forced * exp(-elapsed / slow) + rest * exp(-elapsed / lag);
}

/* Returns the integral of the square of the current, A^2 s. */
static double heat_in(const coil_segment_t *segment, const coil_piece_t *piece, double elapsed) {
    if (piece->held) {
        return piece->current_A * piece->current_A * elapsed;
    }
    const double slow = segment->slow_s, limit = piece->limit_A, away = piece->current_A - limit;
    const double once = 1.0 - exp(-elapsed / slow), twice = 1.0 - exp(-2.0 * elapsed / slow);
    return limit * limit * elapsed + 2.0 * limit * away * slow * once + away * away * 0.5 * slow * twice;
}

/* ---- Segments ---- */

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

static const coil_piece_t *piece_at(const coil_segment_t *segment, double elapsed) {
    unsigned i = 0;
    while (i + 1 < segment->count && elapsed >= segment->piece[i].until_s) {
        ++i;
    }
    return &segment->piece[i];
}

/* Appends a law that begins where the one before it is by then, and returns it, held; the first begins at the segment's
 * start, from the current and lagged current that piece[0] has. */
static coil_piece_t *add_piece(const coil_t *coil, coil_segment_t *segment, double since_s) {
    coil_piece_t *const piece = &segment->piece[segment->count++];
    if (segment->count > 1) {
        coil_piece_t *const before = piece - 1;
        before->until_s = since_s;
        piece->current_A = current_in(segment, before, since_s - before->since_s);
        piece->lagged_A = lagged_in(coil, segment, before, since_s - before->since_s);
    }
    piece->since_s = since_s;
    piece->until_s = INFINITY;
    piece->limit_A = piece->current_A;
    piece->held = true;
    return piece;
}

/* From a time on all that the supply has goes toward the target, where the current is then held. */
static void go_to(const coil_t *coil, coil_segment_t *segment, double since_s, double target_A) {
    coil_piece_t *const piece = add_piece(coil, segment, since_s);
    const bool reachable = fabs(target_A) < segment->full_A;
    if (reachable && piece->current_A == target_A) {
        return;
    }
    piece->held = false;
    piece->limit_A = (reachable ? target_A > piece->current_A : target_A > 0.0) ? segment->full_A : -segment->full_A;
    const double ahead = (piece->current_A - piece->limit_A) / (target_A - piece->limit_A);
    if (reachable && ahead > 0.0) {
        coil_piece_t *const held = add_piece(coil, segment, since_s + segment->slow_s * log(ahead));
        held->current_A = held->limit_A = target_A; /* Exactly, not to rounding. */
    }
}

/* What the inputs ask for now, and what the driver makes of it. */
static double target(const coil_t *coil, const coil_segment_t *segment) {
    const coil_config_t *const config = &coil->config;
    const double sign = coil->input1 == coil->input2 ? 0.0 : coil->input1 ? 1.0 : -1.0;
    const double limit_A = config->driver_limit_A > 0.0 ? config->driver_limit_A : INFINITY;
    if (coil->fault[COIL_STUCK_ON]) {
        return limit_A;
    }
    if (!coil->enabled || sign == 0.0) {
        return 0.0;
    }
    if (coil->fault[COIL_RUNAWAY]) {
        return sign * limit_A;
    }
    const double held_A = sign * coil->set_point_A * (1.0 + sign * config->asymmetry) + config->dc_error_A;
    const double spare_V = segment->supply_V - segment->copper_Ohm * fabs(held_A);
    const double late_A = spare_V > 0.0 ? spare_V * config->driver_delay_s / segment->inductance_H : 0.0;
    const double asked_A = held_A + copysign(late_A, held_A);
    return fabs(asked_A) > limit_A ? copysign(limit_A, asked_A) : asked_A;
}

/* Fills in the circuit as it is from now on. */
static void take_circuit(const coil_t *coil, coil_segment_t *segment) {
    const coil_config_t *const config = &coil->config;
    const double left = coil->fault[COIL_SHORTED] ? 1.0 - config->shorted_fraction : 1.0;
    const double warm = 1.0 + copper_per_K * (coil->temperature_degC - copper_degC);
    segment->copper_Ohm = config->resistance_Ohm * left * warm;
    segment->inductance_H = config->inductance_H * left * left;
    segment->supply_V = coil->supply_V;
    segment->slow_s = segment->inductance_H / (segment->copper_Ohm + config->source_Ohm);
    segment->full_A = coil->supply_V / (segment->copper_Ohm + config->source_Ohm);
    /* Equal time constants would divide by zero; one part in a million apart is the same circuit. */
    if (fabs(config->lag_s - segment->slow_s) < 0.5e-6 * segment->slow_s) {
        segment->slow_s = config->lag_s / (1.0 + 1e-6);
    }
}

double coil_temperature(const coil_t *coil, int64_t time_ps) {
    const coil_config_t *const config = &coil->config;
    if (config->thermal_resistance_K_per_W <= 0.0) {
        return coil->temperature_degC;
    }
    const coil_segment_t *const segment = &coil->segments[coil->head % COIL_HISTORY];
    const double elapsed = elapsed_in(segment, time_ps);
    if (elapsed <= 0.0) {
        return coil->temperature_degC;
    }
    double heat = 0.0;
    for (unsigned i = 0; i < segment->count && segment->piece[i].since_s < elapsed; ++i) {
        const coil_piece_t *const piece = &segment->piece[i];
        heat += heat_in(segment, piece, fmin(elapsed, piece->until_s) - piece->since_s);
    }
    const double power = segment->copper_Ohm * heat / elapsed;
    const double tends_to = config->ambient_degC + power * config->thermal_resistance_K_per_W;
    const double slow = config->thermal_resistance_K_per_W * config->heat_capacity_J_per_K;
    return tends_to + (coil->temperature_degC - tends_to) * exp(-elapsed / slow);
}

/* The inputs have changed: the current goes on from where it is. dead_s is how long the bridge is off because of it. */
static void begin_segment(coil_t *coil, double dead_s, int64_t time_ps) {
    const coil_segment_t *const latest = &coil->segments[coil->head % COIL_HISTORY];
    const double elapsed = elapsed_in(latest, time_ps);
    const coil_piece_t *const piece = piece_at(latest, elapsed);
    coil->temperature_degC = coil_temperature(coil, time_ps);
    coil_segment_t next = {
        .start_ps = latest->start_ps > time_ps ? latest->start_ps : time_ps,
        .dead_s = fmax(dead_s, latest->dead_s - elapsed),
        .piece[0].current_A = coil->fault[COIL_OPEN] ? 0.0 : current_in(latest, piece, elapsed - piece->since_s),
        .piece[0].lagged_A = lagged_in(coil, latest, piece, elapsed - piece->since_s),
    };
    take_circuit(coil, &next);
    double since_s = 0.0;
    if (next.dead_s > 0.0 && coil->enabled) {
        go_to(coil, &next, 0.0, 0.0);
        next.count -= next.count > 1 && next.piece[1].since_s >= next.dead_s;
        since_s = next.dead_s;
    }
    go_to(coil, &next, since_s, coil->fault[COIL_OPEN] ? 0.0 : target(coil, &next));
    if (next.start_ps != latest->start_ps) {
        ++coil->head;
        ++coil->changes;
    }
    coil->segments[coil->head % COIL_HISTORY] = next;
}

/* ---- What drives it ---- */

void coil_init(coil_t *coil, const coil_config_t *config) {
    *coil = (coil_t){.config = *config, .supply_V = config->supply_V, .temperature_degC = config->ambient_degC};
    const double slow_s = config->inductance_H / config->resistance_Ohm;
    if (fabs(coil->config.lag_s - slow_s) < 1e-6 * slow_s) {
        coil->config.lag_s = slow_s * (1.0 + 1e-6);
    }
    coil->sense_V = sense_middle_V;
    coil_segment_t *const rest = &coil->segments[0];
    take_circuit(coil, rest);
    go_to(coil, rest, 0.0, 0.0);
}

void coil_input(coil_t *coil, unsigned number, bool level, int64_t time_ps) {
    bool *const input = number == 1 ? &coil->input1 : &coil->input2;
    if (*input != level) {
        *input = level;
        begin_segment(coil, coil->config.dead_time_s, time_ps);
    }
}

void coil_enable(coil_t *coil, bool enabled, int64_t time_ps) {
    if (coil->enabled != enabled) {
        coil->enabled = enabled;
        begin_segment(coil, 0.0, time_ps);
    }
}

void coil_reference(coil_t *coil, double volts, int64_t time_ps) {
    const double offset_A = volts > 0.0 ? coil->config.reference_offset_A : 0.0;
    const double set_point_A = fmax(volts * coil->config.reference_A_per_V + offset_A, 0.0);
    if (coil->set_point_A != set_point_A) {
        coil->set_point_A = set_point_A;
        begin_segment(coil, 0.0, time_ps);
    }
}

void coil_supply(coil_t *coil, double volts, int64_t time_ps) {
    if (coil->supply_V != volts) {
        coil->supply_V = volts;
        begin_segment(coil, 0.0, time_ps);
    }
}

void coil_fault(coil_t *coil, coil_fault_t fault, bool active, int64_t time_ps) {
    if (coil->fault[fault] != active) {
        coil->fault[fault] = active;
        begin_segment(coil, 0.0, time_ps);
    }
}

/* ---- What is seen of it ---- */

double coil_current(const coil_t *coil, int64_t time_ps) {
    const coil_segment_t *const segment = segment_at(coil, coil->head, time_ps);
    const double elapsed = elapsed_in(segment, time_ps);
    const coil_piece_t *const piece = piece_at(segment, elapsed);
    return current_in(segment, piece, elapsed - piece->since_s);
}

double coil_lagged(const coil_t *coil, uint64_t head, int64_t time_ps) {
    const coil_segment_t *const segment = segment_at(coil, head, time_ps);
    const double elapsed = elapsed_in(segment, time_ps);
    const coil_piece_t *const piece = piece_at(segment, elapsed);
    return lagged_in(coil, segment, piece, elapsed - piece->since_s);
}

double coil_sense(coil_t *coil, uint64_t seed, uint64_t stream, int64_t time_ps) {
    const bool warms = coil->config.thermal_resistance_K_per_W > 0.0;
    if (warms && elapsed_in(&coil->segments[coil->head % COIL_HISTORY], time_ps) > refresh_s) {
        begin_segment(coil, 0.0, time_ps);
    }
    if (coil->fault[COIL_SENSE_LOW]) {
        return 0.0;
    }
    if (!coil->fault[COIL_SENSE_HELD]) {
        const double noise = coil->config.sense_noise_V * noise_normal(seed, stream, (uint64_t)time_ps);
        coil->sense_V = sense_middle_V + coil->config.sense_V_per_A * coil_current(coil, time_ps) + noise;
    }
    return coil->sense_V;
}

double coil_bus(const coil_t *coil, int64_t time_ps) {
    const coil_segment_t *const segment = &coil->segments[coil->head % COIL_HISTORY];
    const double elapsed = elapsed_in(segment, time_ps), source_Ohm = coil->config.source_Ohm;
    const coil_piece_t *const piece = piece_at(segment, elapsed);
    const double current_A = current_in(segment, piece, elapsed - piece->since_s);
    if (piece->held) { /* The supply gives the copper's power at the bridge's voltage. */
        const double rest = segment->supply_V * segment->supply_V -
                            4.0 * source_Ohm * segment->copper_Ohm * current_A * current_A;
        return 0.5 * (segment->supply_V + sqrt(fmax(rest, 0.0)));
    }
    return segment->supply_V - source_Ohm * (piece->limit_A > 0.0 ? current_A : -current_A);
}

double thermistor_volts(double temperature_degC) {
    const double ohms = 10e3 * exp(3950.0 * (1.0 / (temperature_degC + 273.15) - 1.0 / 298.15));
    return 3.3 * ohms / (ohms + 10e3);
}

#include "world/coil.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "world/coil_law.h"
#include "world/noise.h"

static const double sense_middle_V = 1.65;
static const double copper_per_K = 0.00393, copper_degC = 20.0;
static const double refresh_s = 0.01; /* A segment of a coil that warms up is not looked at for longer. */
static const double small_share = 0x1p-40;

static double seconds(int64_t time_ps) {
    return (double)time_ps * 1e-12;
}

/* ---- Segments ---- */

/* The number of the segment in force at a time, no later than number head. Before the oldest, the oldest. */
static uint64_t number_at(const coil_t *coil, uint64_t head, int64_t time_ps) {
    uint64_t number = head;
    while (number > 0 && head - number < COIL_HISTORY - 1 && coil->briefs[number % COIL_HISTORY].start_ps > time_ps) {
        --number;
    }
    return number;
}

static const coil_segment_t *segment_at(const coil_t *coil, uint64_t head, int64_t time_ps) {
    return &coil->segments[number_at(coil, head, time_ps) % COIL_HISTORY];
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
 * start, from the currents that piece[0] has. */
static coil_piece_t *add_piece(const coil_t *coil, coil_segment_t *segment, double since_s) {
    coil_piece_t *const piece = &segment->piece[segment->count++];
    if (segment->count > 1) {
        coil_piece_t *const before = piece - 1;
        before->until_s = since_s;
        piece->current_A = coil_law_current(before, since_s - before->since_s);
        piece->second_A = coil_law_second(before, since_s - before->since_s);
        piece->lagged_A = coil_law_lagged(segment, before, coil->config.lag_s, since_s - before->since_s);
    }
    piece->since_s = since_s;
    piece->until_s = INFINITY;
    coil_law_hold(segment, piece);
    return piece;
}

/* From a time on all that the supply has goes toward the target, where the current is then held. */
static void go_to(const coil_t *coil, coil_segment_t *segment, double since_s, double target_A) {
    coil_piece_t *const piece = add_piece(coil, segment, since_s);
    const bool reachable = fabs(target_A) < segment->full_A;
    if (reachable && piece->current_A == target_A) {
        return;
    }
    const bool up = reachable ? target_A > piece->current_A : target_A > 0.0;
    coil_law_drive(segment, piece, up ? segment->full_A : -segment->full_A);
    const double arrives_s = reachable ? coil_law_arrival(segment, piece, target_A) : INFINITY;
    if (isfinite(arrives_s)) {
        coil_piece_t *const held = add_piece(coil, segment, since_s + arrives_s);
        held->current_A = held->limit_A = target_A; /* Exactly, not to rounding. */
    }
}

/* What the inputs ask for now, and what the driver makes of it. */
static double driven(const coil_t *coil, const coil_segment_t *segment) {
    const coil_config_t *const config = &coil->config;
    const bool forward = coil->input1 != coil->fault[COIL_BRIDGE_SWAPPED];
    const double sign = coil->input1 == coil->input2 ? 0.0 : forward ? 1.0 : -1.0;
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
    const double fast_H = segment->first_H -
                          (segment->shorted > 0.0 ? segment->mutual_H * segment->mutual_H / segment->second_H : 0.0);
    const double late_A = spare_V > 0.0 ? spare_V * config->driver_delay_s / fast_H : 0.0;
    const double asked_A = held_A + copysign(late_A, held_A);
    return fabs(asked_A) > limit_A ? copysign(limit_A, asked_A) : asked_A;
}

/* What flows in the coil and what flows in the driver differ by this factor. */
static double turned(const coil_t *coil) {
    return coil->fault[COIL_REVERSED] ? -1.0 : 1.0;
}

/* A time constant that is not the low-pass's: equal ones would divide by zero, and one part in a million apart is the
 * same circuit. */
static double apart(const coil_t *coil, double slow_s) {
    const double lag_s = coil->config.lag_s;
    return fabs(lag_s - slow_s) < 0.5e-6 * slow_s ? lag_s / (1.0 + 1e-6) : slow_s;
}

/* Fills in the circuit as it is from now on. */
static void take_circuit(const coil_t *coil, coil_segment_t *segment) {
    const coil_config_t *const config = &coil->config;
    const double f = coil->fault[COIL_SHORTED] ? config->shorted_fraction : 0.0, k = config->shorted_coupling;
    const double warm = 1.0 + copper_per_K * (coil->temperature_degC - copper_degC);
    const double all_H = config->inductance_H / ((1.0 - f) * (1.0 - f) + 2.0 * k * f * (1.0 - f) + f * f);
    segment->shorted = f;
    segment->copper_Ohm = config->resistance_Ohm * (1.0 - f) * warm;
    segment->second_Ohm = config->resistance_Ohm * f * warm;
    segment->first_H = all_H * (1.0 - f) * (1.0 - f);
    segment->mutual_H = all_H * k * f * (1.0 - f);
    segment->second_H = all_H * f * f;
    segment->supply_V = coil->supply_V;
    const double ohms = segment->loop_Ohm = segment->copper_Ohm + config->source_Ohm;
    segment->full_A = coil->supply_V / ohms;
    segment->slow_s[0] = apart(coil, segment->first_H / ohms);
    if (f > 0.0) { /* (L1 - T r) (L2 - T R2) = M^2 */
        const double one = segment->first_H / ohms, two = segment->second_H / segment->second_Ohm;
        const double product = one * two * (1.0 - k * k), half = 0.5 * (one + two);
        const double slowest = half + sqrt(half * half - product);
        segment->slow_s[0] = apart(coil, slowest);
        segment->slow_s[1] = apart(coil, product / slowest);
        segment->held_s = apart(coil, two);
    }
}

/* Returns the temperature of the copper, with no change waiting. */
static double temperature_at(const coil_t *coil, int64_t time_ps) {
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
        heat += coil_law_heat(segment, piece, fmin(elapsed, piece->until_s) - piece->since_s);
    }
    const double tends_to = config->ambient_degC + heat / elapsed * config->thermal_resistance_K_per_W;
    const double slow = config->thermal_resistance_K_per_W * config->heat_capacity_J_per_K;
    return tends_to + (coil->temperature_degC - tends_to) * exp(-elapsed / slow);
}

/* What jumps when a wire breaks, or turns are shorted or are so no more: the flux of the turns that stay a loop stays.
 * A short begins with the current of all turns in the shorted ones. */
static void keep_flux(const coil_t *coil, const coil_segment_t *before, const coil_segment_t *now,
                      coil_piece_t *piece) {
    if (before->shorted > 0.0 && now->shorted == 0.0) {
        piece->current_A = ((before->first_H + before->mutual_H) * piece->current_A +
                            (before->mutual_H + before->second_H) * piece->second_A) /
                           now->first_H;
        piece->second_A = 0.0;
    } else if (before->shorted == 0.0 && now->shorted > 0.0) {
        piece->second_A = piece->current_A;
    }
    if (coil->fault[COIL_OPEN]) {
        piece->second_A += now->shorted > 0.0 ? now->mutual_H / now->second_H * piece->current_A : 0.0;
        piece->current_A = 0.0;
    }
}

/* Sums up the latest segment. */
static void sum_up(coil_t *coil) {
    const coil_segment_t *const segment = &coil->segments[coil->head % COIL_HISTORY];
    const coil_piece_t *const last = &segment->piece[segment->count - 1u];
    coil->briefs[coil->head % COIL_HISTORY] = (coil_brief_t){
        .start_ps = segment->start_ps,
        .since_s = last->modes > 0 ? INFINITY : last->since_s, /* INFINITY: it is not simple. */
        .limit_A = last->limit_A,
        .rest_A = coil->config.lag_s > 0.0 ? last->lagged_A - last->limit_A : 0.0,
    };
}

/* The inputs have changed: the current goes on from where it is. dead_s is how long the bridge is off because of it. */
static void begin_segment(coil_t *coil, double dead_s, int64_t time_ps) {
    const coil_segment_t *const latest = &coil->segments[coil->head % COIL_HISTORY];
    coil_segment_t *const next = &coil->segments[(coil->head + 1u) % COIL_HISTORY];
    const double elapsed = elapsed_in(latest, time_ps);
    const coil_piece_t *const piece = piece_at(latest, elapsed);
    const double age_s = elapsed - piece->since_s, before_degC = coil->temperature_degC;
    coil->temperature_degC = temperature_at(coil, time_ps);
    memcpy(next, latest, offsetof(coil_segment_t, piece)); /* The circuit is that before, as a rule. */
    next->start_ps = latest->start_ps > time_ps ? latest->start_ps : time_ps;
    next->dead_s = fmax(dead_s, latest->dead_s - elapsed);
    next->count = 0;
    next->piece[0].current_A = coil_law_current(piece, age_s);
    next->piece[0].second_A = coil_law_second(piece, age_s);
    next->piece[0].lagged_A = coil_law_lagged(latest, piece, coil->config.lag_s, age_s);
    if (coil->other_circuit || coil->temperature_degC != before_degC) {
        take_circuit(coil, next);
        keep_flux(coil, latest, next, &next->piece[0]);
        coil->other_circuit = false;
    }
    double since_s = 0.0;
    if (next->dead_s > 0.0 && coil->enabled) {
        go_to(coil, next, 0.0, 0.0);
        next->count -= next->count > 1 && next->piece[1].since_s >= next->dead_s;
        since_s = next->dead_s;
    }
    go_to(coil, next, since_s, coil->fault[COIL_OPEN] ? 0.0 : turned(coil) * driven(coil, next));
    ++coil->made;
    if (next->start_ps != latest->start_ps) {
        ++coil->head;
        ++coil->changes;
    } else {
        coil->segments[coil->head % COIL_HISTORY] = *next;
    }
    sum_up(coil);
}

/* Makes the segment that waits. */
static void settle(coil_t *coil) {
    if (coil->waits) {
        coil->waits = false;
        begin_segment(coil, coil->waits_dead_s, coil->waits_ps);
    }
}

/* Something changes now. What changes at one moment makes one segment: it waits until time goes on or somebody looks.
 */
static void change(coil_t *coil, double dead_s, int64_t time_ps) {
    if (coil->waits && coil->waits_ps != time_ps) {
        settle(coil);
    }
    coil->waits_dead_s = coil->waits ? fmax(coil->waits_dead_s, dead_s) : dead_s;
    coil->waits_ps = time_ps;
    coil->waits = true;
}

/* ---- What drives it ---- */

void coil_init(coil_t *coil, const coil_config_t *config) {
    *coil = (coil_t){.config = *config, .supply_V = config->supply_V, .temperature_degC = config->ambient_degC};
    const double slow_s = config->inductance_H / config->resistance_Ohm;
    if (fabs(coil->config.lag_s - slow_s) < 1e-6 * slow_s) {
        coil->config.lag_s = slow_s * (1.0 + 1e-6);
    }
    coil->sense_V = sense_middle_V;
    take_circuit(coil, &coil->segments[0]);
    go_to(coil, &coil->segments[0], 0.0, 0.0);
    sum_up(coil);
}

void coil_input(coil_t *coil, unsigned number, bool level, int64_t time_ps) {
    bool *const input = number == 1 ? &coil->input1 : &coil->input2;
    if (*input != level) {
        change(coil, coil->config.dead_time_s, time_ps);
        *input = level;
    }
}

void coil_enable(coil_t *coil, bool enabled, int64_t time_ps) {
    if (coil->enabled != enabled) {
        change(coil, 0.0, time_ps);
        coil->enabled = enabled;
    }
}

void coil_reference(coil_t *coil, double volts, int64_t time_ps) {
    const double offset_A = volts > 0.0 ? coil->config.reference_offset_A : 0.0;
    const double set_point_A = fmax(volts * coil->config.reference_A_per_V + offset_A, 0.0);
    if (coil->set_point_A != set_point_A) {
        change(coil, 0.0, time_ps);
        coil->set_point_A = set_point_A;
    }
}

void coil_supply(coil_t *coil, double volts, int64_t time_ps) {
    if (coil->supply_V != volts) {
        change(coil, 0.0, time_ps);
        coil->supply_V = volts;
        coil->other_circuit = true;
    }
}

void coil_fault(coil_t *coil, coil_fault_t fault, bool active, int64_t time_ps) {
    if (coil->fault[fault] != active) {
        change(coil, 0.0, time_ps);
        coil->fault[fault] = active;
        coil->other_circuit = true;
    }
}

void coil_forget(coil_t *coil, int64_t before_ps) {
    enum { FEW = 4 }; /* Segments that are not worth it. */
    settle(coil);
    if (coil->head < FEW) {
        return;
    }
    const size_t place = number_at(coil, coil->head, before_ps) % COIL_HISTORY, head = coil->head % COIL_HISTORY;
    const size_t kept = (head + COIL_HISTORY - place) % COIL_HISTORY + 1u;
    if (place >= kept && head >= place) {
        memcpy(coil->segments, coil->segments + place, kept * sizeof *coil->segments);
        memcpy(coil->briefs, coil->briefs + place, kept * sizeof *coil->briefs);
        coil->head = kept - 1u;
    }
}

/* ---- What is seen of it ---- */

uint64_t coil_head(coil_t *coil) {
    settle(coil);
    return coil->head;
}

double coil_temperature(coil_t *coil, int64_t time_ps) {
    settle(coil);
    return temperature_at(coil, time_ps);
}

double coil_current(coil_t *coil, int64_t time_ps) {
    settle(coil);
    const coil_segment_t *const segment = segment_at(coil, coil->head, time_ps);
    const double elapsed = elapsed_in(segment, time_ps);
    const coil_piece_t *const piece = piece_at(segment, elapsed);
    return coil_law_current(piece, elapsed - piece->since_s);
}

double coil_second(coil_t *coil, int64_t time_ps) {
    settle(coil);
    const coil_segment_t *const segment = segment_at(coil, coil->head, time_ps);
    const double elapsed = elapsed_in(segment, time_ps);
    const coil_piece_t *const piece = piece_at(segment, elapsed);
    return coil_law_second(piece, elapsed - piece->since_s);
}

double coil_lagged(const coil_t *coil, uint64_t head, int64_t time_ps) {
    const coil_segment_t *const segment = segment_at(coil, head, time_ps);
    const double elapsed = elapsed_in(segment, time_ps);
    const coil_piece_t *const piece = piece_at(segment, elapsed);
    return coil_law_lagged(segment, piece, coil->config.lag_s, elapsed - piece->since_s);
}

/* Returns whether a segment is in force at a time, looking no further than number head. */
static bool in_force(const coil_t *coil, uint64_t head, uint64_t number, int64_t time_ps) {
    return number <= head && head - number < COIL_HISTORY - 1 &&
           coil->briefs[number % COIL_HISTORY].start_ps <= time_ps &&
           (number == head || coil->briefs[(number + 1) % COIL_HISTORY].start_ps > time_ps);
}

coil_view_t coil_view(const coil_t *coil, uint64_t head, uint64_t guess, int64_t time_ps) {
    const uint64_t number = in_force(coil, head, guess, time_ps)       ? guess
                            : in_force(coil, head, guess + 1, time_ps) ? guess + 1
                                                                       : number_at(coil, head, time_ps);
    const coil_brief_t *const brief = &coil->briefs[number % COIL_HISTORY];
    const double elapsed = time_ps > brief->start_ps ? seconds(time_ps - brief->start_ps) : 0.0;
    const double age_s = elapsed - brief->since_s, lag_s = coil->config.lag_s;
    coil_view_t view = {.limit_A = brief->limit_A, .until_ps = time_ps, .number = number};
    if (!(age_s >= 0.0)) {
        return view;
    }
    const bool gone = age_s > COIL_GONE_LAGS * lag_s && fabs(brief->rest_A) <= fabs(brief->limit_A);
    view.rest_A = brief->rest_A == 0.0 || gone ? 0.0 : brief->rest_A * exp(-age_s / lag_s);
    if (fabs(view.rest_A) <= small_share * fabs(brief->limit_A)) {
        view.until_ps = number == head ? INT64_MAX : coil->briefs[(number + 1) % COIL_HISTORY].start_ps;
    }
    return view;
}

double coil_sense(coil_t *coil, uint64_t stream, int64_t time_ps) {
    const bool warms = coil->config.thermal_resistance_K_per_W > 0.0;
    settle(coil);
    if (warms && elapsed_in(&coil->segments[coil->head % COIL_HISTORY], time_ps) > refresh_s) {
        begin_segment(coil, 0.0, time_ps);
    }
    if (coil->fault[COIL_SENSE_LOW]) {
        return 0.0;
    }
    if (!coil->fault[COIL_SENSE_HELD]) {
        const double noise = coil->config.sense_noise_V * noise_normal(stream, (uint64_t)time_ps);
        const double current_A = turned(coil) * coil_current(coil, time_ps);
        coil->sense_V = sense_middle_V + coil->config.sense_V_per_A * current_A + noise;
    }
    return coil->sense_V;
}

double coil_bus(coil_t *coil, int64_t time_ps) {
    settle(coil);
    const coil_segment_t *const segment = &coil->segments[coil->head % COIL_HISTORY];
    const double elapsed = elapsed_in(segment, time_ps), source_Ohm = coil->config.source_Ohm;
    const coil_piece_t *const piece = piece_at(segment, elapsed);
    const double current_A = coil_law_current(piece, elapsed - piece->since_s);
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

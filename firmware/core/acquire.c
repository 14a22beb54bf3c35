#include "acquire.h"

#include <stddef.h>
#include <string.h>

#include "gold.h"
#include "roots.h"

#define DEGREE 10u
#define SETTLED (ACQUIRE_BURST - 1u) /* Conversions of the sample. */
#define MID_SCALE 2048
#define PASSES 3u
#define UNSETTLED 0x8000u
#define LOW_BINS 32u                 /* 160 Hz. */
#define PRESENT 6.0f                 /* Share of the codes in the variance, 1 for noise. */
#define MIDDLE (ACQUIRE_CHIPS / 2u)
#define HALVINGS 16u
#define SLOPE_MIN 0.1f               /* Before the edge and far behind it there is no slope; a measurement there still tells the sign. */
#define MODEL_VARIANCE 300.0f        /* (0.1 us)^2 */
#define RISE_VARIANCE 0.005f         /* (7 %)^2: the rise time as a search knows it. */
#define FOOT 0.4f                    /* Of the low-pass's time constant: nearer to the edge, or before it, there is nothing to see, */
#define UNSEEN_VARIANCE 60000.0f     /* and the time is known to (1.5 us)^2. */
#define SEARCH_VARIANCE 18000.0f     /* (0.8 us)^2 and */
#define SEARCH_RATE_VARIANCE 0.04f   /* (12 ppm)^2: errors of a search. */
#define UNSEEN_RECORDS 4u            /* In succession: search anew. */
#define RATE_WALK 6.6e-11f           /* A chip: 0.05 ppm in 1 s, for the crystals' temperature. */

static const float q32 = 4294967296.0f;

void acquire_init(acquire_t *acquire, const acquire_config_t *config) {
    memset(acquire, 0, sizeof *acquire);
    acquire->config = *config;
}

/* ---- Interrupt ---- */

static void record_start(acquire_t *acquire, const chip_clock_t *clock) {
    acquire->from_chip = clock->chip;
    acquire->period = clock->period;
    acquire->count = 0;
    acquire->filling = true;
    acquire->recorded = 0;
}

void acquire_plan(acquire_t *acquire, chip_clock_t *clock) {
    const uint8_t command = __atomic_load_n(&acquire->command, __ATOMIC_ACQUIRE);
    if (command == ACQUIRE_NONE) {
        return;
    }
    clock->detune_ticks = command == ACQUIRE_SWEEP ? ACQUIRE_DETUNE_TICKS : 0;
    if (command == ACQUIRE_SWEEP) {
        clock->locked = false;
    } else if (command == ACQUIRE_JUMP) {
        chip_clock_jump(clock, acquire->edge_position, acquire->edge_period);
    } else if (command == ACQUIRE_CORRECT) {
        const float chips = (float)(clock->chip - acquire->rate_chip);
        const float phase = acquire->phase_change + acquire->rate_change * chips;
        chip_clock_correct(clock, (int64_t)(phase * q32), (int64_t)(acquire->rate_change * q32), acquire->residual_ticks, acquire->good);
    }
    record_start(acquire, clock);
    __atomic_store_n(&acquire->command, ACQUIRE_NONE, __ATOMIC_RELEASE);
}

static void settled_sum(const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES], int32_t sum[ACQUIRE_AXES]) {
    for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
        sum[axis] = -(int32_t)SETTLED * MID_SCALE;
        for (uint32_t i = 0; i < SETTLED; i++) {
            sum[axis] += burst[i][axis];
        }
    }
}

void acquire_feed(acquire_t *acquire, uint32_t chip, const chip_clock_chip_t *planned, const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES]) {
    if (!acquire->filling || (int32_t)(chip - acquire->from_chip) < 0) {
        return;
    }
    if (acquire->count > 0u && chip != acquire->first_chip + acquire->count) {
        acquire->count = 0; /* A gap. */
    }
    if (acquire->count == 0u) {
        acquire->first_chip = chip;
        acquire->first_position = planned->position;
        acquire->first_code_chip = planned->code_chip;
    }
    int32_t sum[ACQUIRE_AXES];
    settled_sum(burst, sum);
    for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
        acquire->field[acquire->count][axis] = (int16_t)sum[axis];
        acquire->step[acquire->count][axis] = (int16_t)((int32_t)SETTLED * (burst[SETTLED][axis] - MID_SCALE) - sum[axis]);
    }
    acquire->count++;
    if (acquire->count >= acquire->length) {
        acquire->filling = false;
        __atomic_store_n(&acquire->recorded, 1u, __ATOMIC_RELEASE);
    }
}

void acquire_sample(const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES], int16_t sample[ACQUIRE_AXES]) {
    int32_t sum[ACQUIRE_AXES];
    settled_sum(burst, sum);
    for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
        sample[axis] = (int16_t)((sum[axis] * (int32_t)ACQUIRE_BURST + (sum[axis] < 0 ? -3 : 3)) / (int32_t)SETTLED);
    }
}

/* ---- Main ---- */

static void command(acquire_t *acquire, acquire_command_t what) {
    acquire->stage = ACQUIRE_RECORDING;
    if (what == ACQUIRE_SWEEP) {
        acquire->tracking = false;
        acquire->detune = ACQUIRE_DETUNE_TICKS;
        acquire->searches++;
    } else {
        acquire->detune = 0;
    }
    acquire->length = acquire->tracking && acquire->captures < ACQUIRE_CAPTURES ? ACQUIRE_CHIPS / 3u : ACQUIRE_CHIPS;
    __atomic_store_n(&acquire->command, (uint8_t)what, __ATOMIC_RELEASE);
}

/* The next up to 16 codes of the list. */
static void choose_codes(acquire_t *acquire) {
    acquire->code_count = acquire->list_count < ACQUIRE_CODES_MAX ? acquire->list_count : ACQUIRE_CODES_MAX;
    for (uint32_t i = 0; i < acquire->code_count; i++) {
        acquire->codes[i] = acquire->list[(acquire->list_first + i) % acquire->list_count];
    }
}

void acquire_codes(acquire_t *acquire, const uint16_t *codes, uint32_t count) {
    uint16_t list[ACQUIRE_LIST_MAX] = {0};
    uint32_t taken = 0;
    for (uint32_t i = 0; i < count && taken < ACQUIRE_LIST_MAX; i++) {
        if (codes[i] <= 1024u) {
            list[taken] = codes[i];
            taken++;
        }
    }
    if (acquire->searches > 0u && taken == acquire->list_count && memcmp(list, acquire->list, taken * sizeof list[0]) == 0) {
        return;
    }
    memcpy(acquire->list, list, taken * sizeof list[0]);
    acquire->list_count = taken;
    acquire->list_first = 0;
    choose_codes(acquire);
    command(acquire, ACQUIRE_SWEEP);
}

static uint32_t modulo(uint32_t chip) { return chip % ACQUIRE_CHIPS; }

/* Sample chip's time in the record, in chips from the first one's. */
static float chip_time(const acquire_t *acquire, uint32_t chip) {
    return (float)chip * (1.0f + (float)acquire->detune / (float)acquire->config.nominal_ticks);
}

static void means(acquire_t *acquire) {
    float variance[ACQUIRE_AXES];
    acquire->variance = 0.0f;
    for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
        int32_t sum = 0;
        for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
            sum += acquire->field[chip][axis];
        }
        acquire->mean[axis] = (float)sum / (float)ACQUIRE_CHIPS;
        variance[axis] = 0.0f;
        for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
            const float value = (float)acquire->field[chip][axis] - acquire->mean[axis];
            variance[axis] += value * value / (float)ACQUIRE_CHIPS;
        }
        acquire->variance += variance[axis];
    }
    const uint32_t least = variance[0] <= variance[1] ? (variance[0] <= variance[2] ? 0u : 2u) : variance[1] <= variance[2] ? 1u : 2u;
    acquire->axes[0] = least == 0u ? 1u : 0u;
    acquire->axes[1] = least == 2u ? 1u : 2u;
}

/* ---- Code phase ---- */

static void search_start(acquire_t *acquire) {
    means(acquire);
    memset(acquire->signal, 0, sizeof acquire->signal);
    memset(acquire->metric, 0, sizeof acquire->metric);
    const uint32_t x = acquire->axes[0], y = acquire->axes[1];
    for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
        fourier_t *place = &acquire->signal[(uint32_t)chip_time(acquire, chip)];
        place->re = (float)acquire->field[chip][x] - acquire->mean[x];
        place->im = (float)acquire->field[chip][y] - acquire->mean[y];
    }
    fourier_forward(acquire->signal);
    for (uint32_t k = 0; k <= 2u * LOW_BINS; k++) {
        acquire->signal[fourier_place(k - LOW_BINS)] = (fourier_t){0.0f, 0.0f};
    }
    acquire->code = 0;
    acquire->stage = ACQUIRE_TRANSFORMING;
}

/* Correlation with a code at all phases p, sum over t of conj(y[t]) c[t + p]; times 2048. */
static void search_code(acquire_t *acquire, uint16_t code) {
    gold_generator_t generator;
    (void)gold_start(&generator, DEGREE, code, 0);
    for (uint32_t t = 0; t < FOURIER_LENGTH; t++) {
        acquire->work[t] = (fourier_t){gold_next(&generator) != 0u ? -1.0f : 1.0f, 0.0f};
    }
    fourier_forward(acquire->work);
    for (uint32_t i = 0; i < FOURIER_LENGTH; i++) {
        const fourier_t a = acquire->signal[i], b = acquire->work[i];
        acquire->work[i] = (fourier_t){a.re * b.re + a.im * b.im, a.re * b.im - a.im * b.re};
    }
    fourier_inverse(acquire->work);
    for (uint32_t p = 0; p < ACQUIRE_CHIPS; p++) {
        acquire->metric[p] += acquire->work[p].re * acquire->work[p].re + acquire->work[p].im * acquire->work[p].im;
    }
}

/* Phase whose metric and the next one's have the largest sum. */
static bool find_peak(acquire_t *acquire) {
    float mean = 0.0f, best = -1.0f;
    for (uint32_t p = 0; p < ACQUIRE_CHIPS; p++) {
        mean += acquire->metric[p] / (float)ACQUIRE_CHIPS;
        const float both = acquire->metric[p] + acquire->metric[modulo(p + 1u)];
        if (both > best) {
            best = both;
            acquire->start_label = p;
        }
    }
    acquire->peak = mean > 0.0f ? best / (2.0f * mean) : 0.0f;
    const float first = acquire->metric[acquire->start_label] - mean, second = acquire->metric[modulo(acquire->start_label + 1u)] - mean;
    const float before = first > 0.0f ? square_root(first) : 0.0f, after = second > 0.0f ? square_root(second) : 0.0f;
    acquire->crossing = before + after > 0.0f ? before / (before + after) : 0.5f;
    return acquire->peak >= (float)ACQUIRE_PEAK;
}

static void search_end(acquire_t *acquire) {
    const bool found = find_peak(acquire);
    if (acquire->tracking) { /* After silence. */
        const uint32_t away = modulo(acquire->start_label + ACQUIRE_CHIPS + 1u - acquire->first_code_chip);
        command(acquire, found && away > 1u ? ACQUIRE_SWEEP : ACQUIRE_AGAIN);
    } else if (!found) {
        acquire->list_first = acquire->list_count > 0u ? (acquire->list_first + acquire->code_count) % acquire->list_count : 0u;
        choose_codes(acquire);
        command(acquire, ACQUIRE_SWEEP);
    } else {
        acquire->pass = 0;
        acquire->code = 0;
        acquire->stage = ACQUIRE_AMPLITUDES;
    }
}

/* ---- Amplitudes ---- */

/* The frame's middle is where the edge was first seen. Code chip before it, and how far from it (-0.5..0.5 chip) the sample lies. */
static uint32_t frame_label(const acquire_t *acquire, uint32_t chip, float *phase) {
    const float time = chip_time(acquire, chip) - acquire->crossing + 0.5f; /* Above -0.5. */
    const uint32_t whole = (uint32_t)(time + 1.0f) - 1u;
    *phase = time - (float)(int32_t)whole - 0.5f;
    return modulo(acquire->start_label + whole + ACQUIRE_CHIPS);
}

/* The chip that a sample shows, if it is settled. */
static bool settled_label(const acquire_t *acquire, uint32_t chip, uint32_t *label) {
    if (acquire->tracking) {
        *label = modulo(acquire->first_code_chip + chip);
        return true;
    }
    float phase;
    *label = frame_label(acquire, chip, &phase);
    if (phase > 0.0f) {
        *label = modulo(*label + 1u);
    }
    return phase > 0.25f || phase < -0.25f;
}

static void residuals_start(acquire_t *acquire) {
    for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
        uint32_t label;
        const bool settled = settled_label(acquire, chip, &label);
        acquire->labels[chip] = (uint16_t)(settled ? label : label | UNSETTLED);
        for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
            acquire->residual[chip][axis] = (float)acquire->field[chip][axis] - acquire->mean[axis];
            acquire->expected[chip][axis] = 0.0f;
        }
    }
    memset(acquire->amplitude, 0, sizeof acquire->amplitude);
}

static void generate(acquire_t *acquire, uint16_t code) {
    gold_generator_t generator;
    (void)gold_start(&generator, DEGREE, code, 0);
    for (uint32_t t = 0; t < ACQUIRE_CHIPS; t++) {
        acquire->chips[t] = gold_next(&generator) != 0u ? -1 : 1;
    }
}

/* Correlate what is left with one code, add it to the code's amplitude and to the expected field, and take it off. */
static void subtract_code(acquire_t *acquire, uint32_t index) {
    generate(acquire, acquire->codes[index]);
    float sum[ACQUIRE_AXES] = {0.0f}, count = 0.0f;
    for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
        const uint32_t label = acquire->labels[chip];
        if ((label & UNSETTLED) == 0u) {
            for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
                sum[axis] += (float)acquire->chips[label] * acquire->residual[chip][axis];
            }
            count += 1.0f;
        }
    }
    for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
        sum[axis] = count > 0.0f ? sum[axis] / count : 0.0f;
        acquire->amplitude[index][axis] += sum[axis];
    }
    for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
        const uint32_t label = acquire->labels[chip] & (UNSETTLED - 1u);
        for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
            acquire->residual[chip][axis] -= sum[axis] * (float)acquire->chips[label];
            acquire->expected[chip][axis] += sum[axis] * (float)acquire->chips[chip];
        }
    }
}

/* ---- Edge ---- */

static void edge_profile(acquire_t *acquire) {
    edge_profile_t *profile = &acquire->profile;
    memset(profile, 0, sizeof *profile);
    float before[ACQUIRE_AXES] = {0.0f}, change_before[ACQUIRE_AXES] = {0.0f}, phase_before = 1.0f;
    for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
        float phase;
        const uint32_t label = frame_label(acquire, chip, &phase), next = modulo(label + 1u);
        const uint32_t sweep = chip * EDGE_FIT_SWEEPS / ACQUIRE_CHIPS;
        uint32_t bin = (uint32_t)((phase + 0.5f) * (float)EDGE_FIT_BINS);
        bin = bin < EDGE_FIT_BINS ? bin : EDGE_FIT_BINS - 1u;
        const bool usable = phase > phase_before; /* Not where the frame begins anew. */
        for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
            const float done = (float)acquire->field[chip][axis] - acquire->expected[label][axis];
            const float change = acquire->expected[next][axis] - acquire->expected[label][axis];
            if (usable) {
                const float weight = (change - change_before[axis]) * (change - change_before[axis]);
                profile->product[sweep][bin] += (done - before[axis]) * (change - change_before[axis]);
                profile->weight[sweep][bin] += weight;
                profile->moment[sweep][bin] += weight * (float)chip;
            }
            before[axis] = done;
            change_before[axis] = change;
        }
        phase_before = phase;
    }
}

static int64_t fixed(float ticks) { return (int64_t)(ticks * q32); }

static void edge_end(acquire_t *acquire) {
    const acquire_config_t *config = &acquire->config;
    edge_profile(acquire);
    if (acquire->code_count == 0u || !edge_fit(&acquire->profile, (float)config->nominal_ticks / (float)EDGE_FIT_BINS,
                                              (float)(SETTLED * config->conversion_ticks), &acquire->edge)) {
        command(acquire, ACQUIRE_SWEEP);
        return;
    }
    float phase;
    const uint32_t label = modulo(frame_label(acquire, MIDDLE, &phase) + 1u); /* The chip that begins at this edge. */
    const float held = (float)config->first_conversion_ticks + 0.5f * (float)((SETTLED - 1u) * config->conversion_ticks);
    const float edge = held + (float)config->nominal_ticks * -phase + acquire->edge.onset_ticks - (float)config->lag_ticks; /* After the start of MIDDLE. */
    const uint64_t step = acquire->period + ((uint64_t)(int64_t)acquire->detune << 32);
    const uint64_t start = ((uint64_t)acquire->first_position << 32) + step * MIDDLE;
    acquire->edge_period = acquire->period + (uint64_t)fixed(acquire->edge.slip_ticks_per_chip);
    const uint32_t last_hold = config->first_conversion_ticks + SETTLED * config->conversion_ticks;
    const float late = (float)config->nominal_ticks + (float)(ACQUIRE_TARGET_TICKS + ACQUIRE_EXTRA_TICKS) - (float)last_hold;
    acquire->edge_position = start + (uint64_t)fixed(edge + late) - label * acquire->edge_period;
    acquire->middle_chip = acquire->first_chip + MIDDLE;
    acquire->extra_ticks = (float)ACQUIRE_EXTRA_TICKS;
    acquire->covariance[0] = SEARCH_VARIANCE;
    acquire->covariance[1] = 0.0f;
    acquire->covariance[2] = SEARCH_RATE_VARIANCE;
    acquire->captures = 0;
    acquire->unseen = 0;
    acquire->tracking = true;
    command(acquire, ACQUIRE_JUMP);
}

/* ---- Tracking ---- */

/* exp(-x), x >= 0, within 0.011; within 0.0015 below 1. */
static float decay(float x) { return 1.0f / (1.0f + x * (1.0f + x * (0.5f + x * (1.0f / 6.0f + x / 24.0f)))); }

/* Height on the ramp, in ticks of it, a time after the beacons' edge: the front end's low-pass rounds its foot. */
static float ramp_height(const acquire_t *acquire, float time) {
    const float lag = (float)acquire->config.lag_ticks;
    return time > 0.0f ? time - lag * (1.0f - decay(time / lag)) : 0.0f;
}

static float ramp_slope(const acquire_t *acquire, float time) {
    return time > 0.0f ? 1.0f - decay(time / (float)acquire->config.lag_ticks) : 0.0f;
}

typedef float ramp_t(const acquire_t *acquire, float time);

/* Of the last conversion minus the mean of the others. */
static float difference(const acquire_t *acquire, ramp_t *ramp, float time) {
    float sum = ramp(acquire, time);
    for (uint32_t i = 1; i <= SETTLED; i++) {
        sum -= ramp(acquire, time - (float)(i * acquire->config.conversion_ticks)) / (float)SETTLED;
    }
    return sum;
}

/* Ticks between the beacons' edge and the last conversion, from how much higher on the ramp that is than the others: this grows until all are on it. Halves the interval. */
static float time_on_ramp(const acquire_t *acquire, float height) {
    float low = 0.0f, high = (float)(ACQUIRE_BURST * acquire->config.conversion_ticks);
    for (uint32_t step = 0; step < HALVINGS; step++) {
        const float time = 0.5f * (low + high);
        if (difference(acquire, ramp_height, time) < height) {
            low = time;
        } else {
            high = time;
        }
    }
    return 0.5f * (low + high);
}

/* Time of the last conversion after the edge from chips first..end-1 of the record, ticks, and its variance. */
static float measure(const acquire_t *acquire, uint32_t first, uint32_t end, float *variance) {
    float product = 0.0f, weight = 0.0f, squares = 0.0f;
    for (uint32_t chip = first; chip < end; chip++) {
        const uint32_t label = modulo(acquire->first_code_chip + chip), next = modulo(label + 1u);
        for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
            const float change = acquire->expected[next][axis] - acquire->expected[label][axis];
            const float step = acquire->step[chip][axis];
            product += change * step;
            weight += change * change;
            squares += step * step;
        }
    }
    const float fraction = product / weight; /* Codes are present: weight is not 0. */
    const float rest = (squares - fraction * product) / (float)(ACQUIRE_AXES * (end - first)) / weight;
    const float time = time_on_ramp(acquire, fraction * acquire->edge.rise_ticks);
    const float slope = difference(acquire, ramp_slope, time);
    const float deviation = acquire->edge.rise_ticks / (slope > SLOPE_MIN ? slope : SLOPE_MIN);
    *variance = rest * deviation * deviation + (time < FOOT * (float)acquire->config.lag_ticks ? UNSEEN_VARIANCE : MODEL_VARIANCE + RISE_VARIANCE * time * time);
    return time;
}

/* One measurement of phase + chips * rate in a Kalman filter. One that does not fit (3 standard deviations) says that the phase is known worse than thought. */
static void update(float state[2], float covariance[3], float value, float chips, float variance) {
    const float innovation = value - state[0] - chips * state[1];
    const float expected = covariance[0] + chips * (2.0f * covariance[1] + chips * covariance[2]) + variance;
    if (innovation * innovation > 9.0f * expected) {
        covariance[0] += innovation * innovation;
    }
    const float phase = covariance[0] + chips * covariance[1], rate = covariance[1] + chips * covariance[2];
    const float total = phase + chips * rate + variance;
    state[0] += phase / total * innovation;
    state[1] += rate / total * innovation;
    covariance[0] -= phase * phase / total;
    covariance[1] -= phase * rate / total;
    covariance[2] -= rate * rate / total;
}

static bool codes_present(const acquire_t *acquire) {
    float power = 0.0f;
    for (uint32_t i = 0; i < acquire->code_count; i++) {
        for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
            power += acquire->amplitude[i][axis] * acquire->amplitude[i][axis];
        }
    }
    return power * (float)ACQUIRE_CHIPS > PRESENT * (float)acquire->code_count * acquire->variance;
}

static void track(acquire_t *acquire) {
    const uint32_t half = acquire->length / 2u, middle = acquire->first_chip + half;
    const float chips = (float)(middle - acquire->middle_chip), quarter = 0.5f * (float)half;
    float *covariance = acquire->covariance, state[2] = {0.0f, 0.0f}, variance;
    covariance[0] += chips * (2.0f * covariance[1] + chips * covariance[2]);
    covariance[1] += chips * covariance[2];
    covariance[2] += chips * RATE_WALK;
    const float on_purpose = (float)ACQUIRE_TARGET_TICKS + acquire->extra_ticks;
    const float first = measure(acquire, 0, half, &variance);
    update(state, covariance, first - on_purpose, -quarter, variance);
    const float second = measure(acquire, half, acquire->length, &variance);
    update(state, covariance, second - on_purpose, quarter, variance);
    acquire->late_ticks = 0.5f * (first + second);
    acquire->deviation_ticks = square_root(covariance[0]);
    const float residual = acquire->late_ticks - (float)ACQUIRE_TARGET_TICKS;
    const bool seen = acquire->late_ticks > FOOT * (float)acquire->config.lag_ticks;
    const float extra = seen ? 0.0f : (float)ACQUIRE_EXTRA_TICKS; /* Look later. */
    acquire->phase_change = extra - state[0] - acquire->extra_ticks;
    acquire->rate_change = -state[1];
    acquire->extra_ticks = extra;
    acquire->unseen = seen ? 0u : acquire->unseen + 1u;
    if (!seen) {
        covariance[0] += SEARCH_VARIANCE;
    }
    acquire->rate_chip = middle;
    acquire->middle_chip = middle;
    acquire->residual_ticks = (int32_t)residual;
    const float cycle = (float)ACQUIRE_CHIPS;
    const float ahead = covariance[0] + cycle * (2.0f * covariance[1] + cycle * covariance[2]);
    acquire->good = seen && ahead < (float)(ACQUIRE_LOCK_TICKS * ACQUIRE_LOCK_TICKS);
    acquire->captures += acquire->captures < ACQUIRE_CAPTURES ? 1u : 0u;
    command(acquire, acquire->unseen < UNSEEN_RECORDS ? ACQUIRE_CORRECT : ACQUIRE_SWEEP);
}

static void measure_end(acquire_t *acquire) {
    acquire->silent = !codes_present(acquire);
    if (acquire->silent) {
        search_start(acquire);
    } else {
        track(acquire);
    }
}

void acquire_step(acquire_t *acquire) {
    switch (acquire->stage) {
    case ACQUIRE_RECORDING:
        if (__atomic_load_n(&acquire->command, __ATOMIC_ACQUIRE) != ACQUIRE_NONE || __atomic_load_n(&acquire->recorded, __ATOMIC_ACQUIRE) == 0u) {
            return;
        }
        if (!acquire->tracking) {
            search_start(acquire);
            return;
        }
        if (acquire->captures < ACQUIRE_CAPTURES) {
            track(acquire);
            return;
        }
        means(acquire);
        acquire->pass = PASSES - 1u; /* A whole cycle: the codes are orthogonal. */
        acquire->code = 0;
        residuals_start(acquire);
        acquire->stage = ACQUIRE_MEASURING;
        return;
    case ACQUIRE_TRANSFORMING:
        if (acquire->code < acquire->code_count) {
            search_code(acquire, acquire->codes[acquire->code]);
            acquire->code++;
        } else {
            search_end(acquire);
        }
        return;
    case ACQUIRE_AMPLITUDES:
    case ACQUIRE_MEASURING:
        if (acquire->stage == ACQUIRE_AMPLITUDES && acquire->pass == 0u && acquire->code == 0u) {
            residuals_start(acquire);
        }
        for (uint32_t i = 0; i < 4u && acquire->code < acquire->code_count; i++) {
            subtract_code(acquire, acquire->code);
            acquire->code++;
        }
        if (acquire->code == acquire->code_count) {
            acquire->code = 0;
            acquire->pass++;
        }
        if (acquire->pass == PASSES) {
            if (acquire->stage == ACQUIRE_AMPLITUDES) {
                acquire->stage = ACQUIRE_EDGE;
            } else {
                measure_end(acquire);
            }
        }
        return;
    case ACQUIRE_EDGE: edge_end(acquire); return;
    default: return;
    }
}

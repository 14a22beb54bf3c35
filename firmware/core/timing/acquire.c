#include "core/timing/acquire.h"

#include <stddef.h>
#include <string.h>

#include "core/math/roots.h"

#define PASSES       2u                   /* Passes over the codes of a sliding record (code_field.h). */
#define MIDDLE       (ACQUIRE_CHIPS / 2u) /* Chip in the middle of a whole record. */
#define CODES_A_STEP 4u                   /* Codes that are subtracted in one acquire_step. */
#define SETTLE_CHIPS 2u /* Chips added to what a slew takes at nominal length, since clocks differ by 300 ppm. */
/* Least time after the edge at which the ramp is seen, low-pass time constants: nearer to the edge, or before it,
 * there is next to nothing to see. */
#define FOOT           0.4f
#define UNSEEN_RECORDS 4u /* Records in succession without a ramp that start a new search. */
/* Standard deviation of the rate of a clock that was in step, ticks a chip: 0.06 ppm. */
#define KNOWN_RATE 1e-3f

static const float q32 = 4294967296.0f; /* 2^32: the scale of positions and periods. */

void acquire_init(acquire_t *acquire, const acquire_config_t *config) {
    memset(acquire, 0, sizeof *acquire);
    acquire->config = *config;
}

static uint32_t last_hold(const acquire_config_t *config) {
    return config->first_conversion_ticks + (ACQUIRE_BURST - 1u) * config->conversion_ticks;
}

int16_t acquire_late_ticks(const acquire_config_t *config) {
    return (int16_t)(config->nominal_ticks + ACQUIRE_TARGET_TICKS - last_hold(config));
}

/* ---- Interrupt ---- */

/* Lets a record begin when the chip clock has slewed to where it is to be: until then bursts lie elsewhere. */
static void record_start(acquire_t *acquire, const chip_clock_t *clock) {
    const int64_t away = (int64_t)(clock->target - ((uint64_t)clock->position << 32)) >> 32;
    const int64_t longer = clock->config.maximum_ticks - clock->config.nominal_ticks,
                  shorter = clock->config.nominal_ticks - clock->config.minimum_ticks;
    acquire->from_chip = clock->chip + SETTLE_CHIPS + (uint32_t)(away < 0 ? -away / shorter : away / longer);
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
        chip_clock_correct(clock, (int64_t)(phase * q32), (int64_t)(acquire->rate_change * q32),
                           acquire->residual_ticks, acquire->good);
    }
    record_start(acquire, clock);
    __atomic_store_n(&acquire->command, ACQUIRE_NONE, __ATOMIC_RELEASE);
}

void acquire_feed(acquire_t *acquire, uint32_t chip, const chip_clock_chip_t *planned,
                  const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES]) {
    if (!acquire->filling || (int32_t)(chip - acquire->from_chip) < 0) {
        return;
    }
    if (chip != acquire->first_chip + acquire->count) {
        acquire->count = 0; /* There was a gap: the record begins anew. */
    }
    if (acquire->count == 0u) {
        acquire->first_chip = chip;
        acquire->first_position = planned->position;
        acquire->first_code_chip = planned->code_chip;
    }
    record_burst(&acquire->record, acquire->count, acquire->cut, burst);
    acquire->count++;
    if (acquire->count >= acquire->length) {
        acquire->filling = false;
        __atomic_store_n(&acquire->recorded, 1u, __ATOMIC_RELEASE);
    }
}

/* ---- Main ---- */

static void command(acquire_t *acquire, acquire_command_t what) {
    acquire->stage = ACQUIRE_RECORDING;
    if (what == ACQUIRE_SWEEP) {
        acquire->tracking = false;
        acquire->searches++;
    }
    acquire->length = acquire->tracking && acquire->captures < ACQUIRE_CAPTURES ? ACQUIRE_CHIPS / 3u : ACQUIRE_CHIPS;
    acquire->cut = acquire->tracking && acquire->extra_ticks == 0u ? RECORD_TRACKING : RECORD_HALVES;
    __atomic_store_n(&acquire->command, (uint8_t)what, __ATOMIC_RELEASE);
}

/* Takes the next codes of the list, up to 16, into use. */
static void choose_codes(acquire_t *acquire) {
    acquire->code_count = acquire->list_count < ACQUIRE_CODES_MAX ? acquire->list_count : ACQUIRE_CODES_MAX;
    for (uint32_t i = 0; i < acquire->code_count; i++) {
        acquire->codes[i] = acquire->list[(acquire->list_first + i) % acquire->list_count];
    }
}

/* Takes a list. Returns whether it is another one than before. */
static bool take_list(acquire_t *acquire, const uint16_t *codes, uint32_t count) {
    uint16_t list[ACQUIRE_LIST_MAX] = {0};
    uint32_t taken = 0;
    for (uint32_t i = 0; i < count && taken < ACQUIRE_LIST_MAX; i++) {
        if (codes[i] <= 1024u) {
            list[taken] = codes[i];
            taken++;
        }
    }
    if (taken == acquire->list_count && memcmp(list, acquire->list, taken * sizeof list[0]) == 0) {
        return false;
    }
    memcpy(acquire->list, list, taken * sizeof list[0]);
    acquire->list_count = taken;
    acquire->list_first = 0;
    choose_codes(acquire);
    return true;
}

void acquire_codes(acquire_t *acquire, const uint16_t *codes, uint32_t count) {
    if (take_list(acquire, codes, count) || acquire->searches == 0u) {
        command(acquire, ACQUIRE_SWEEP);
    }
}

void acquire_known(acquire_t *acquire, const uint16_t *codes, uint32_t count, uint32_t chip, float deviation_ticks) {
    (void)take_list(acquire, codes, count);
    edge_track_known(&acquire->track, (float)ACQUIRE_TARGET_TICKS, deviation_ticks, KNOWN_RATE);
    acquire->captures = ACQUIRE_CAPTURES;
    acquire->middle_chip = chip;
    acquire->tracking = true;
    command(acquire, ACQUIRE_AGAIN);
}

bool acquire_replace(acquire_t *acquire, const uint16_t *codes, uint32_t count) {
    const bool free = acquire->tracking && acquire->captures == ACQUIRE_CAPTURES && acquire->stage == ACQUIRE_RECORDING;
    if (free) {
        (void)take_list(acquire, codes, count);
    }
    return free;
}

/* ---- Search ---- */

static void search_start(acquire_t *acquire) {
    acquire->frame.chip_length = acquire->tracking
                                     ? 1.0f
                                     : 1.0f + (float)ACQUIRE_DETUNE_TICKS / (float)acquire->config.nominal_ticks;
    code_search_start(&acquire->search, &acquire->record, acquire->frame.chip_length);
    acquire->code = 0;
    acquire->stage = ACQUIRE_TRANSFORMING;
}

static void search_end(acquire_t *acquire) {
    const code_peak_t peak = code_search_peak(&acquire->search);
    const bool found = peak.height >= (float)ACQUIRE_PEAK;
    acquire->peak = peak.height;
    if (acquire->tracking) { /* The record follows silence. */
        const uint32_t away = (peak.label + ACQUIRE_CHIPS + 1u - acquire->first_code_chip) % ACQUIRE_CHIPS;
        command(acquire, found && away > 1u ? ACQUIRE_SWEEP : ACQUIRE_AGAIN);
    } else if (!found) {
        acquire->list_first = acquire->list_count > 0u
                                  ? (acquire->list_first + acquire->code_count) % acquire->list_count
                                  : 0u;
        choose_codes(acquire);
        command(acquire, ACQUIRE_SWEEP);
    } else {
        acquire->frame.sliding = true;
        acquire->frame.label = peak.label;
        acquire->frame.crossing = peak.crossing;
        acquire->pass = 0;
        acquire->code = 0;
        code_field_start(&acquire->field, &acquire->record, &acquire->frame);
        acquire->stage = ACQUIRE_AMPLITUDES;
    }
}

static int64_t fixed(float ticks) {
    return (int64_t)(ticks * q32);
}

static void edge_end(acquire_t *acquire) {
    const acquire_config_t *config = &acquire->config;
    const edge_shape_t shape = {(float)config->nominal_ticks, (float)(ACQUIRE_BURST * config->conversion_ticks),
                                (float)config->lag_ticks};
    const edge_profile_t *profile = code_field_profile(&acquire->field, &acquire->record, &acquire->frame);
    if (!edge_fit(profile, &shape, &acquire->edge)) {
        command(acquire, ACQUIRE_SWEEP);
        return;
    }
    float phase;
    /* The code chip that begins at the edge near the middle, and where that edge is after the start of MIDDLE. */
    const uint32_t label = (code_frame_label(&acquire->frame, MIDDLE, &phase) + 1u) % ACQUIRE_CHIPS;
    const float held = (float)config->first_conversion_ticks +
                       0.5f * (float)((ACQUIRE_BURST - 1u) * config->conversion_ticks);
    const float edge = held + (float)config->nominal_ticks * -phase + acquire->edge.onset_ticks;
    const uint64_t step = acquire->period + ((uint64_t)ACQUIRE_DETUNE_TICKS << 32);
    const uint64_t start = ((uint64_t)acquire->first_position << 32) + step * MIDDLE;
    acquire->edge_period = acquire->period + (uint64_t)fixed(acquire->edge.slip_ticks_per_chip);
    const float time = (float)(ACQUIRE_TARGET_TICKS + ACQUIRE_EXTRA_TICKS),
                late = (float)acquire_late_ticks(config) + (float)ACQUIRE_EXTRA_TICKS;
    acquire->edge_position = start + (uint64_t)fixed(edge + late) - label * acquire->edge_period;
    acquire->middle_chip = acquire->first_chip + MIDDLE;
    acquire->extra_ticks = ACQUIRE_EXTRA_TICKS;
    edge_track_start(&acquire->track, &acquire->edge, time);
    acquire->captures = 0;
    acquire->unseen = 0;
    acquire->tracking = true;
    acquire->frame.sliding = false;
    command(acquire, ACQUIRE_JUMP);
}

/* ---- Tracking ---- */

static edge_look_t look(const acquire_t *acquire, uint32_t first, uint32_t end, uint32_t middle) {
    edge_look_t look = {.chips = 0.5f * (float)(first + end) - (float)middle};
    look.share = code_field_step(&acquire->field, &acquire->record, acquire->first_code_chip, first, end,
                                 &look.variance);
    return look;
}

static void track(acquire_t *acquire) {
    const acquire_config_t *config = &acquire->config;
    const uint32_t half = acquire->length / 2u, middle = acquire->first_chip + half;
    const edge_burst_t burst = {(uint32_t)acquire->cut, (float)config->conversion_ticks, (float)config->lag_ticks};
    const edge_look_t looks[2] = {look(acquire, 0, half, half), look(acquire, half, acquire->length, half)};
    edge_track_t *state = &acquire->track;
    edge_track_move(state, (float)(middle - acquire->middle_chip));
    edge_track_rise(state, &burst, looks);
    const bool blind = edge_track_blind(state, &burst, looks);
    edge_track_update(state, &burst, looks);
    const bool seen = !blind || state->time_ticks > FOOT * (float)config->lag_ticks;
    acquire->late_ticks = state->time_ticks;
    acquire->deviation_ticks = square_root(state->covariance[0][0]);
    acquire->captures += acquire->captures < ACQUIRE_CAPTURES ? 1u : 0u;
    if (!seen) {
        state->covariance[0][0] += (float)(ACQUIRE_EXTRA_TICKS * ACQUIRE_EXTRA_TICKS);
    }
    acquire->unseen = seen ? 0u : acquire->unseen + 1u;
    acquire->extra_ticks = seen && acquire->captures >= ACQUIRE_LATE_CAPTURES ? 0u : ACQUIRE_EXTRA_TICKS;
    const float time = (float)(ACQUIRE_TARGET_TICKS + acquire->extra_ticks);
    acquire->phase_change = time - state->time_ticks;
    acquire->rate_change = -state->rate;
    acquire->residual_ticks = (int32_t)(state->time_ticks - (float)ACQUIRE_TARGET_TICKS);
    acquire->rate_chip = middle;
    acquire->middle_chip = middle;
    state->time_ticks = time;
    state->rate = 0.0f;
    const float limit = (float)(ACQUIRE_LOCK_TICKS * ACQUIRE_LOCK_TICKS);
    acquire->good = acquire->extra_ticks == 0u && edge_track_variance(state, (float)ACQUIRE_CHIPS) < limit;
    command(acquire, acquire->unseen < UNSEEN_RECORDS ? ACQUIRE_CORRECT : ACQUIRE_SWEEP);
}

static void record_end(acquire_t *acquire) {
    if (!acquire->tracking) {
        search_start(acquire);
    } else if (acquire->captures < ACQUIRE_CAPTURES) {
        track(acquire); /* The amplitudes are those of the search. */
    } else {
        acquire->frame.label = acquire->first_code_chip;
        acquire->pass = PASSES - 1u; /* One pass is enough: the codes of a whole cycle are orthogonal. */
        acquire->code = 0;
        code_field_start(&acquire->field, &acquire->record, &acquire->frame);
        acquire->stage = ACQUIRE_MEASURING;
    }
}

static void measure_end(acquire_t *acquire) {
    const bool before = acquire->silent;
    acquire->silent = !code_field_present(&acquire->field, acquire->code_count);
    if (acquire->silent) {
        search_start(acquire);
    } else if (before) {
        /* Codes came back somewhere in this record: its amplitudes are no whole cycle's. */
        command(acquire, ACQUIRE_AGAIN);
    } else {
        track(acquire);
    }
}

static void amplitudes(acquire_t *acquire) {
    for (uint32_t i = 0; i < CODES_A_STEP && acquire->code < acquire->code_count; i++) {
        code_field_subtract(&acquire->field, acquire->code, acquire->codes[acquire->code]);
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
}

void acquire_step(acquire_t *acquire) {
    switch (acquire->stage) {
    case ACQUIRE_RECORDING:
        if (__atomic_load_n(&acquire->command, __ATOMIC_ACQUIRE) == ACQUIRE_NONE &&
            __atomic_load_n(&acquire->recorded, __ATOMIC_ACQUIRE) != 0u) {
            record_end(acquire);
        }
        return;
    case ACQUIRE_TRANSFORMING:
        if (acquire->code < acquire->code_count) {
            code_search_add(&acquire->search, acquire->codes[acquire->code]);
            acquire->code++;
        } else {
            search_end(acquire);
        }
        return;
    case ACQUIRE_AMPLITUDES:
    case ACQUIRE_MEASURING:
        amplitudes(acquire);
        return;
    case ACQUIRE_EDGE:
        edge_end(acquire);
        return;
    default:
        return;
    }
}

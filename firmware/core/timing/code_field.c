#include "core/timing/code_field.h"

#include <string.h>

#include "core/codes/gold.h"

#define DEGREE    10u     /* Degree of the codes. */
#define UNSETTLED 0x8000u /* Bit of a label: the sample lies on the ramp and does not count. */
#define PRESENT   6.0f    /* Least share of the codes in the variance with which they are there; noise has 1. */

static uint32_t modulo(uint32_t chip) {
    return chip % ACQUIRE_CHIPS;
}

uint32_t code_frame_label(const code_frame_t *frame, uint32_t chip, float *phase) {
    const float time = (float)chip * frame->chip_length - frame->crossing + 0.5f; /* It is above -0.5. */
    const uint32_t whole = (uint32_t)(time + 1.0f) - 1u;
    *phase = time - (float)(int32_t)whole - 0.5f;
    return modulo(frame->label + whole + ACQUIRE_CHIPS);
}

/* Returns the code chip that a sample shows, marked if it is not settled. */
static uint16_t shown_label(const code_frame_t *frame, uint32_t chip) {
    if (!frame->sliding) {
        return (uint16_t)modulo(frame->label + chip);
    }
    float phase;
    uint32_t label = code_frame_label(frame, chip, &phase);
    if (phase > 0.0f) {
        label = modulo(label + 1u);
    }
    return (uint16_t)(phase > 0.25f || phase < -0.25f ? label : label | UNSETTLED);
}

void code_field_start(code_field_t *field, const acquire_record_t *record, const code_frame_t *frame) {
    float mean[ACQUIRE_AXES], variance[ACQUIRE_AXES];
    record_statistics(record, mean, variance);
    field->variance = variance[0] + variance[1] + variance[2];
    for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
        field->labels[chip] = shown_label(frame, chip);
        for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
            field->residual[chip][axis] = (float)record->field[chip][axis] - mean[axis];
            field->expected[chip][axis] = 0.0f;
        }
    }
    memset(field->amplitude, 0, sizeof field->amplitude);
}

static void generate(code_field_t *field, uint16_t code) {
    gold_generator_t generator;
    (void)gold_start(&generator, DEGREE, code, 0);
    for (uint32_t t = 0; t < ACQUIRE_CHIPS; t++) {
        field->chips[t] = gold_next(&generator) != 0u ? -1 : 1;
    }
}

void code_field_subtract(code_field_t *field, uint32_t number, uint16_t code) {
    generate(field, code);
    float sum[ACQUIRE_AXES] = {0.0f}, count = 0.0f;
    for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
        const uint32_t label = field->labels[chip];
        if ((label & UNSETTLED) == 0u) {
            for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
                sum[axis] += (float)field->chips[label] * field->residual[chip][axis];
            }
            count += 1.0f;
        }
    }
    for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
        sum[axis] = count > 0.0f ? sum[axis] / count : 0.0f;
        field->amplitude[number][axis] += sum[axis];
    }
    for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
        const uint32_t label = field->labels[chip] & (UNSETTLED - 1u);
        for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
            field->residual[chip][axis] -= sum[axis] * (float)field->chips[label];
            field->expected[chip][axis] += sum[axis] * (float)field->chips[chip];
        }
    }
}

bool code_field_present(const code_field_t *field, uint32_t codes) {
    float power = 0.0f;
    for (uint32_t i = 0; i < codes; i++) {
        for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
            power += field->amplitude[i][axis] * field->amplitude[i][axis];
        }
    }
    return power * (float)ACQUIRE_CHIPS > PRESENT * (float)codes * field->variance;
}

static void add_to_bin(edge_bin_t *bin, float seen, float change, float phase, float chip) {
    bin->product += seen * change;
    bin->weight += change * change;
    bin->phase += change * change * phase;
    bin->chip += change * change * chip;
}

const edge_profile_t *code_field_profile(code_field_t *field, const acquire_record_t *record,
                                         const code_frame_t *frame) {
    edge_profile_t *profile = &field->profile;
    memset(profile, 0, sizeof *profile);
    float before[ACQUIRE_AXES] = {0.0f}, change_before[ACQUIRE_AXES] = {0.0f}, phase_before = 1.0f;
    for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
        float phase;
        const uint32_t label = code_frame_label(frame, chip, &phase), next = modulo(label + 1u);
        const uint32_t sweep = chip * EDGE_FIT_SWEEPS / ACQUIRE_CHIPS;
        uint32_t bin = (uint32_t)((phase + 0.5f) * (float)EDGE_FIT_BINS);
        bin = bin < EDGE_FIT_BINS ? bin : EDGE_FIT_BINS - 1u;
        const bool successive = phase > phase_before; /* It is not where the frame begins anew. */
        for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
            const float done = (float)record->field[chip][axis] - field->expected[label][axis];
            const float change = field->expected[next][axis] - field->expected[label][axis];
            if (successive) {
                add_to_bin(&profile->level[sweep][bin], done - before[axis], change - change_before[axis], phase,
                           (float)chip);
            }
            add_to_bin(&profile->step[sweep][bin], (float)record->step[chip][axis], change, phase, (float)chip);
            before[axis] = done;
            change_before[axis] = change;
        }
        phase_before = phase;
    }
    return profile;
}

float code_field_step(const code_field_t *field, const acquire_record_t *record, uint32_t label, uint32_t first,
                      uint32_t end, float *variance) {
    float product = 0.0f, weight = 1e-20f, squares = 0.0f;
    for (uint32_t chip = first; chip < end; chip++) {
        const uint32_t here = modulo(label + chip), next = modulo(here + 1u);
        for (uint32_t axis = 0; axis < ACQUIRE_AXES; axis++) {
            const float change = field->expected[next][axis] - field->expected[here][axis];
            const float step = record->step[chip][axis];
            product += change * step;
            weight += change * change;
            squares += step * step;
        }
    }
    const float share = product / weight;
    *variance = (squares - share * product) / (float)(ACQUIRE_AXES * (end - first)) / weight;
    return share;
}

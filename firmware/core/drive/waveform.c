#include "core/drive/waveform.h"

#include <stddef.h>

#define PI 3.14159265f

uint32_t waveform_channels(uint32_t kind) {
    return kind == WAVEFORM_ROTATING ? 2u : 1u;
}

/* Puts one code into the next part. Returns false if it does not exist or does not fit the cycle. */
static bool add_part(waveform_t *waveform, const waveform_code_t *code) {
    const gold_family_t *const family = gold_family(code->degree);
    if (family == NULL || code->offset >= family->length || code->hold == 0u || code->hold > waveform->length ||
        waveform->length % (code->hold * family->length) != 0u) {
        return false;
    }
    waveform_part_t *const part = &waveform->of.codes.parts[waveform->of.codes.count];
    part->hold = (uint16_t)code->hold;
    waveform->of.codes.count++;
    return gold_start(&part->generator, code->degree, code->index, code->offset);
}

static bool start_codes(waveform_t *waveform, const waveform_code_t *codes, uint32_t count) {
    for (uint32_t i = 0; i < count; i++) {
        if (codes[i].degree != 0u && !add_part(waveform, &codes[i])) {
            return false;
        }
    }
    if (waveform->of.codes.count == 0u) {
        return false;
    }
    waveform->of.codes.share = 1.0f / (float)waveform->of.codes.count;
    return true;
}

static bool start_slot(waveform_t *waveform, const waveform_config_t *config) {
    if (config->slots > waveform->length || config->slot >= config->slots) { /* 0 slots, too. */
        return false;
    }
    const uint32_t chips = waveform->length / config->slots;
    waveform->of.slot.first = (uint16_t)(config->slot * chips);
    waveform->of.slot.end = (uint16_t)((config->slot + 1u) * chips);
    return true;
}

static bool start_tone(waveform_t *waveform, uint32_t periods) {
    waveform->of.tone.step = (uint16_t)periods;
    return periods > 0u && periods <= (waveform->length - 1u) / 2u;
}

static bool start(waveform_t *waveform, uint32_t degree, const waveform_config_t *config) {
    const waveform_code_t plain = {degree, config->code, 0u, 1u};
    switch (config->kind) {
    case WAVEFORM_CODE:
        return start_codes(waveform, &plain, 1u);
    case WAVEFORM_SUPERPOSED:
        return start_codes(waveform, config->codes, WAVEFORM_CODES);
    case WAVEFORM_SLOT:
        return start_slot(waveform, config);
    case WAVEFORM_TONE:
    case WAVEFORM_ROTATING:
        return start_tone(waveform, config->periods);
    default:
        return false;
    }
}

bool waveform_start(waveform_t *waveform, uint32_t degree, const waveform_config_t *config) {
    const gold_family_t *const family = gold_family(degree);
    if (family == NULL) {
        return false;
    }
    waveform_t made = {.kind = (uint16_t)config->kind, .length = family->length};
    if (!start(&made, degree, config)) {
        return false;
    }
    *waveform = made;
    return true;
}

static int16_t rounded(float level) {
    const float units = level * (float)WAVEFORM_ONE;
    return (int16_t)(units < 0.0f ? units - 0.5f : units + 0.5f);
}

static int16_t next_of_codes(waveform_t *waveform) {
    int32_t sum = 0;
    for (uint32_t i = 0; i < waveform->of.codes.count; i++) {
        waveform_part_t *const part = &waveform->of.codes.parts[i];
        if (part->left == 0u) {
            part->left = part->hold;
            part->sign = gold_next(&part->generator) ? -1 : 1;
        }
        part->left--;
        sum += part->sign;
    }
    return rounded((float)sum * waveform->of.codes.share);
}

static int16_t next_of_slot(waveform_t *waveform) {
    const uint16_t chip = waveform->of.slot.chip;
    waveform->of.slot.chip = (uint16_t)(chip + 1u == waveform->length ? 0u : chip + 1u);
    return chip >= waveform->of.slot.first && chip < waveform->of.slot.end ? WAVEFORM_ONE : 0;
}

static uint32_t next_phase(waveform_t *waveform) {
    const uint32_t phase = waveform->of.tone.phase, next = phase + waveform->of.tone.step;
    waveform->of.tone.phase = (uint16_t)(next >= waveform->length ? next - waveform->length : next);
    return phase;
}

/* The cosine of 2 pi phase / N is positive in the first and the last quarter of a period. */
static int16_t next_of_tone(waveform_t *waveform) {
    const uint32_t phase = next_phase(waveform), length = waveform->length;
    return 4u * phase < length || 4u * phase > 3u * length ? WAVEFORM_ONE : -WAVEFORM_ONE;
}

/* Returns the level of sin(2 pi turns), -1/2 <= turns <= 5/4. The angle is folded to a quarter turn, where the series
 * up to x^9 errs by less than 4e-6. */
static int16_t sine(float turns) {
    float folded = turns > 0.75f ? turns - 1.0f : turns;
    if (folded > 0.25f) {
        folded = 0.5f - folded;
    }
    const float x = 2.0f * PI * folded, square = x * x;
    return rounded(
        x * (1.0f + square * (-1.0f / 6.0f +
                              square * (1.0f / 120.0f + square * (-1.0f / 5040.0f + square * (1.0f / 362880.0f))))));
}

static void next_of_rotating(waveform_t *waveform, int16_t level[WAVEFORM_CHANNELS]) {
    const float turns = (float)next_phase(waveform) / (float)waveform->length;
    level[0] = sine(turns + 0.25f);
    level[1] = sine(turns);
}

void waveform_next(waveform_t *waveform, int16_t level[WAVEFORM_CHANNELS]) {
    level[1] = 0;
    switch (waveform->kind) {
    case WAVEFORM_SLOT:
        level[0] = next_of_slot(waveform);
        break;
    case WAVEFORM_TONE:
        level[0] = next_of_tone(waveform);
        break;
    case WAVEFORM_ROTATING:
        next_of_rotating(waveform, level);
        break;
    default:
        level[0] = next_of_codes(waveform);
        break; /* waveform_start makes no other. */
    }
}

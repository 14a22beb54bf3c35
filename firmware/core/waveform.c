#include "waveform.h"

#include <stddef.h>

bool waveform_start(waveform_t *waveform, uint32_t degree, const waveform_config_t *config) {
    const gold_family_t *const family = gold_family(degree);
    if (family == NULL) {
        return false;
    }
    const uint32_t length = family->length;
    waveform_t made = {.kind = (uint16_t)config->kind, .length = (uint16_t)length};
    if (config->kind == WAVEFORM_CODE) {
        if (!gold_start(&made.of.code, degree, config->code, 0)) {
            return false;
        }
    } else if (config->kind == WAVEFORM_SLOT) {
        if (config->slots == 0 || config->slots > length || config->slot >= config->slots) {
            return false;
        }
        const uint32_t chips = length / config->slots;
        made.of.slot.first = (uint16_t)(config->slot * chips);
        made.of.slot.end = (uint16_t)((config->slot + 1u) * chips);
    } else if (config->kind == WAVEFORM_TONE) {
        if (config->periods == 0 || config->periods > (length - 1u) / 2u) {
            return false;
        }
        made.of.tone.step = (uint16_t)config->periods;
    } else {
        return false;
    }
    *waveform = made;
    return true;
}

static int8_t next_of_slot(waveform_t *waveform) {
    const uint16_t chip = waveform->of.slot.chip;
    waveform->of.slot.chip = (uint16_t)(chip + 1u == waveform->length ? 0u : chip + 1u);
    return chip >= waveform->of.slot.first && chip < waveform->of.slot.end ? 1 : 0;
}

/* cos(2 pi phase / N) > 0 in the first and the last quarter of a period. */
static int8_t next_of_tone(waveform_t *waveform) {
    const uint32_t phase = waveform->of.tone.phase, length = waveform->length, next = phase + waveform->of.tone.step;
    waveform->of.tone.phase = (uint16_t)(next >= length ? next - length : next);
    return 4u * phase < length || 4u * phase > 3u * length ? 1 : -1;
}

int8_t waveform_next(waveform_t *waveform) {
    switch (waveform->kind) {
    case WAVEFORM_CODE:
        return gold_next(&waveform->of.code) ? -1 : 1;
    case WAVEFORM_SLOT:
        return next_of_slot(waveform);
    default: /* WAVEFORM_TONE: waveform_start makes no other. */
        return next_of_tone(waveform);
    }
}

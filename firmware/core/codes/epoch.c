#include "core/codes/epoch.h"

#include <stddef.h>
#include <string.h>

#define LANES 0x00010001u /* The number one in each of the two halfwords of a word. */

/* Two conversions are six halfwords, three words: (x, y) (z, x) (y, z). Sums of four halfwords fit a halfword, so
 * words are added whole. A lane is at a rail if lane + 1 has bit 12 (4095), or lane - 1 borrows (0). A borrow
 * reaches the neighbour only from a lane that is itself at the rail. */
bool epoch_sample(const uint16_t burst[EPOCH_BURST][EPOCH_AXES], int16_t sample[EPOCH_AXES]) {
    uint32_t xy = 0, zx = 0, yz = 0, rails = 0;
    for (uint32_t i = 0; i < EPOCH_BURST; i += 2u) {
        uint32_t words[3];
        memcpy(words, burst[i], sizeof words);
        rails |= (words[0] + LANES) | (words[0] - LANES) | (words[1] + LANES) | (words[1] - LANES) |
                 (words[2] + LANES) | (words[2] - LANES);
        xy += words[0];
        zx += words[1];
        yz += words[2];
    }
    const uint32_t middle = EPOCH_BURST * EPOCH_MID_SCALE;
    sample[0] = (int16_t)((xy & 0xFFFFu) + (zx >> 16) - middle);
    sample[1] = (int16_t)((xy >> 16) + (yz & 0xFFFFu) - middle);
    sample[2] = (int16_t)((zx & 0xFFFFu) + (yz >> 16) - middle);
    return (rails & 0xF000F000u) != 0u;
}

void epoch_init(epoch_collector_t *collector, const gold_family_t *family) {
    *collector = (epoch_collector_t){.family = family};
}

static void drop(epoch_collector_t *collector) {
    collector->collecting = false;
    if (collector->dropped < UINT32_MAX) {
        collector->dropped++;
    }
}

/* Hands the cycle that is full to main. Returns false if main is late, and the cycle is dropped. */
static bool hand_over(epoch_collector_t *collector) {
    if (__atomic_load_n(&collector->ready, __ATOMIC_ACQUIRE) != 0u) {
        drop(collector);
        return false;
    }
    collector->filling ^= 1u;
    collector->collecting = false;
    __atomic_store_n(&collector->ready, 1u, __ATOMIC_RELEASE);
    return true;
}

bool epoch_feed(epoch_collector_t *collector, uint32_t absolute_chip, uint32_t cycle, uint16_t code_chip,
                const int16_t sample[EPOCH_AXES], bool saturated, bool locked) {
    bool complete = false;
    epoch_t *epoch = &collector->epochs[collector->filling];
    if (collector->collecting) {
        despread_t *despread = &epoch->despread;
        const uint32_t expected = absolute_chip - epoch->first_chip; /* It is the code chip, unless the clock jumped. */
        if (code_chip == 0u && expected == collector->family->length) { /* The last chips of the cycle are missing. */
            complete = hand_over(collector);
        } else if (expected != code_chip || code_chip < despread->chip) {
            if (collector->began_locked) {
                drop(collector);
            }
            collector->collecting = false; /* Otherwise the clock has only now found its master: nothing is lost. */
        } else {
            despread_skip(despread, code_chip - despread->chip);
        }
    }
    epoch = &collector->epochs[collector->filling];
    if (code_chip == 0u) {
        despread_start(&epoch->despread, collector->family);
        epoch->first_chip = absolute_chip;
        epoch->saturated = 0;
        epoch->locked = true;
        collector->collecting = true;
        collector->began_locked = locked;
    }
    if (!collector->collecting) {
        return complete;
    }
    despread_store(&epoch->despread, sample);
    epoch->cycle = cycle;
    epoch->saturated = (uint16_t)(epoch->saturated + (saturated ? 1u : 0u));
    epoch->locked = epoch->locked && locked;
    return epoch->despread.chip == collector->family->length ? hand_over(collector) : complete;
}

epoch_t *epoch_ready(epoch_collector_t *collector) {
    if (__atomic_load_n(&collector->ready, __ATOMIC_ACQUIRE) == 0u) {
        return NULL;
    }
    return &collector->epochs[collector->filling ^ 1u];
}

void epoch_release(epoch_collector_t *collector) {
    __atomic_store_n(&collector->ready, 0u, __ATOMIC_RELEASE);
}

uint32_t epoch_select(epoch_selection_t *selection, const gold_family_t *family, const uint16_t *codes,
                      uint32_t count) {
    selection->count = 0;
    for (uint32_t i = 0; i < count && i < EPOCH_CODES_MAX; i++) {
        if (codes[i] <= family->length + 1u) {
            selection->codes[selection->count].code = codes[i];
            selection->codes[selection->count].word = despread_word(family, codes[i]);
            selection->codes[selection->count].sum = (int16_t)gold_sum(family->degree, codes[i]);
            selection->count++;
        }
    }
    return selection->count;
}

void epoch_read(const epoch_t *epoch, const epoch_selection_t *selection, epoch_sums_t *sums) {
    for (uint32_t axis = 0; axis < EPOCH_AXES; axis++) {
        for (uint32_t i = 0; i < selection->count; i++) {
            sums->correlation[i][axis] = despread_correlation(&epoch->despread, axis, selection->codes[i].word);
        }
        sums->sum[axis] = epoch->despread.sum[axis];
    }
    sums->chips = epoch->despread.family->length;
    sums->cycle = epoch->cycle;
    sums->missing = epoch->despread.missing;
    sums->saturated = epoch->saturated;
    sums->locked = epoch->locked;
}

void epoch_scale(const epoch_calibration_t *calibration, const int32_t correlation[EPOCH_AXES], float code_sum,
                 float chips, float field_T[EPOCH_AXES]) {
    float counts[EPOCH_AXES];
    for (uint32_t axis = 0; axis < EPOCH_AXES; axis++) {
        const float zero = calibration->zero[axis] - (float)EPOCH_MID_SCALE;
        counts[axis] = ((float)correlation[axis] / (float)EPOCH_BURST - zero * code_sum) / chips;
    }
    for (uint32_t row = 0; row < EPOCH_AXES; row++) {
        field_T[row] = 0.0f;
        for (uint32_t column = 0; column < EPOCH_AXES; column++) {
            field_T[row] += calibration->matrix[row][column] * counts[column];
        }
    }
}

void epoch_field(const epoch_sums_t *sums, const epoch_calibration_t *calibration, const epoch_selection_t *selection,
                 uint32_t index, float field_T[EPOCH_AXES]) {
    epoch_scale(calibration, sums->correlation[index], selection->codes[index].sum, sums->chips, field_T);
}

void epoch_offset(const epoch_sums_t *sums, const epoch_calibration_t *calibration, float offset_T[EPOCH_AXES]) {
    epoch_scale(calibration, sums->sum, sums->chips, sums->chips, offset_T);
}

int32_t epoch_integer(float value, float resolution) {
    const float scaled = value / resolution;
    if (!(scaled >= -524287.0f && scaled <= 524287.0f)) { /* True also for what is not a number. */
        return EPOCH_OUT_OF_RANGE;
    }
    return (int32_t)(scaled < 0.0f ? scaled - 0.5f : scaled + 0.5f);
}

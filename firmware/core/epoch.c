#include "epoch.h"

#include <stddef.h>
#include <string.h>

#include "gold.h"

#define CHIPS_F 1023.0f
#define LANES 0x00010001u /* One in each halfword. */

/* Two conversions are six halfwords, three words: (x, y) (z, x) (y, z). Sums of four halfwords fit a halfword, so words are added whole. A lane is at a rail if
 * lane + 1 has bit 12 (4095), or lane - 1 borrows (0). A borrow reaches the neighbour only from a lane that is itself at the rail. */
bool epoch_sample(const uint16_t burst[EPOCH_BURST][EPOCH_AXES], int16_t sample[EPOCH_AXES]) {
    uint32_t xy = 0, zx = 0, yz = 0, rails = 0;
    for (uint32_t i = 0; i < EPOCH_BURST; i += 2u) {
        uint32_t words[3];
        memcpy(words, burst[i], sizeof words);
        rails |= (words[0] + LANES) | (words[0] - LANES) | (words[1] + LANES) | (words[1] - LANES) | (words[2] + LANES) | (words[2] - LANES);
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

void epoch_init(epoch_collector_t *collector) { *collector = (epoch_collector_t){0}; }

static void drop(epoch_collector_t *collector) {
    collector->collecting = false;
    if (collector->dropped < UINT32_MAX) {
        collector->dropped++;
    }
}

/* The cycle being filled is over. True: handed to main. */
static bool hand_over(epoch_collector_t *collector) {
    if (__atomic_load_n(&collector->ready, __ATOMIC_ACQUIRE) != 0u) {
        drop(collector);
        return false;
    }
    collector->collecting = false;
    collector->filling ^= 1u;
    __atomic_store_n(&collector->ready, 1u, __ATOMIC_RELEASE);
    return true;
}

bool epoch_feed(epoch_collector_t *collector, uint32_t absolute_chip, uint32_t cycle, uint16_t code_chip, const int16_t sample[EPOCH_AXES],
                bool saturated, bool locked) {
    bool complete = false;
    epoch_t *epoch = &collector->epochs[collector->filling];
    if (collector->collecting) {
        const uint32_t expected = absolute_chip - epoch->first_chip; /* Code chip, unless the chip clock jumped. */
        if (expected == DESPREAD_CHIPS && code_chip == 0u) {
            complete = hand_over(collector); /* The last chips of the cycle are missing. */
        } else if (expected != code_chip || code_chip < epoch->despread.chip) {
            drop(collector);
        }
    }
    epoch = &collector->epochs[collector->filling];
    if (code_chip == 0u) {
        despread_start(&epoch->despread);
        epoch->first_chip = absolute_chip;
        epoch->saturated = 0;
        epoch->locked = true;
        collector->collecting = true;
    }
    if (!collector->collecting) {
        return complete;
    }
    despread_skip(&epoch->despread, (uint32_t)code_chip - epoch->despread.chip);
    despread_store(&epoch->despread, sample);
    epoch->cycle = cycle;
    epoch->saturated = (uint16_t)(epoch->saturated + (saturated ? 1u : 0u));
    epoch->locked = epoch->locked && locked;
    if (epoch->despread.chip == DESPREAD_CHIPS) {
        complete = hand_over(collector) || complete;
    }
    return complete;
}

epoch_t *epoch_ready(epoch_collector_t *collector) {
    if (__atomic_load_n(&collector->ready, __ATOMIC_ACQUIRE) == 0u) {
        return NULL;
    }
    return &collector->epochs[collector->filling ^ 1u];
}

void epoch_release(epoch_collector_t *collector) { __atomic_store_n(&collector->ready, 0u, __ATOMIC_RELEASE); }

uint32_t epoch_select(epoch_selection_t *selection, const uint16_t *codes, uint32_t count) {
    selection->count = 0;
    for (uint32_t i = 0; i < count && i < EPOCH_CODES_MAX; i++) {
        if (codes[i] < DESPREAD_CODES) {
            selection->codes[selection->count].code = codes[i];
            selection->codes[selection->count].word = despread_word(codes[i]);
            selection->codes[selection->count].sum = (int16_t)gold_sum(10, codes[i]);
            selection->count++;
        }
    }
    return selection->count;
}

/* M (correlation / (8 N) - (zero - mid-scale) sum / N). */
static void scale(const epoch_calibration_t *calibration, const int32_t correlation[EPOCH_AXES], float code_sum, float field_T[EPOCH_AXES]) {
    float counts[EPOCH_AXES];
    for (uint32_t axis = 0; axis < EPOCH_AXES; axis++) {
        const float zero = calibration->zero[axis] - (float)EPOCH_MID_SCALE;
        counts[axis] = ((float)correlation[axis] / (float)EPOCH_BURST - zero * code_sum) / CHIPS_F;
    }
    for (uint32_t row = 0; row < EPOCH_AXES; row++) {
        field_T[row] = 0.0f;
        for (uint32_t column = 0; column < EPOCH_AXES; column++) {
            field_T[row] += calibration->matrix[row][column] * counts[column];
        }
    }
}

void epoch_field(const despread_t *despread, const epoch_calibration_t *calibration, const epoch_selection_t *selection, uint32_t index,
                 float field_T[EPOCH_AXES]) {
    int32_t correlation[EPOCH_AXES];
    for (uint32_t axis = 0; axis < EPOCH_AXES; axis++) {
        correlation[axis] = despread_correlation(despread, axis, selection->codes[index].code, selection->codes[index].word);
    }
    scale(calibration, correlation, selection->codes[index].sum, field_T);
}

void epoch_offset(const despread_t *despread, const epoch_calibration_t *calibration, float offset_T[EPOCH_AXES]) {
    scale(calibration, despread->sum, CHIPS_F, offset_T);
}

int32_t epoch_integer(float value, float resolution) {
    const float scaled = value / resolution;
    if (!(scaled >= -524287.0f && scaled <= 524287.0f)) { /* Also what is not a number. */
        return EPOCH_OUT_OF_RANGE;
    }
    return (int32_t)(scaled < 0.0f ? scaled - 0.5f : scaled + 0.5f);
}

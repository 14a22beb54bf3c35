#include "core/codes/block_sums.h"

void block_collect_init(block_collector_t *collector, uint32_t length) {
    *collector = (block_collector_t){.length = length};
}

/* Whatever is left out breaks its block: chips come in order, so that none behind it is the one that continues it. */
void block_collect(block_collector_t *collector, uint32_t absolute_chip, uint32_t cycle, uint32_t code_chip,
                   const int16_t sample[EPOCH_AXES], uint32_t saturated, bool locked) {
    const uint32_t t = absolute_chip % BLOCK_CHIPS;
    block_samples_t *const block = &collector->blocks[collector->filled % BLOCKS_WAITING];
    if (!locked) {
        return;
    }
    if (t == 0u) {
        const uint32_t released = __atomic_load_n(&collector->released, __ATOMIC_ACQUIRE);
        if (collector->filled - released == BLOCKS_WAITING) {
            return;
        }
        block->number = absolute_chip / BLOCK_CHIPS;
        block->cycle = cycle;
        block->chip = (uint16_t)code_chip;
        block->saturated = 0;
    } else if (absolute_chip != collector->next || code_chip != collector->next_code) {
        return;
    }
    for (uint32_t axis = 0; axis < EPOCH_AXES; axis++) {
        block->samples[t][axis] = sample[axis];
    }
    block->saturated = (uint8_t)(block->saturated | saturated);
    collector->next = absolute_chip + 1u;
    collector->next_code = code_chip + 1u == collector->length ? 0u : code_chip + 1u;
    if (t + 1u == BLOCK_CHIPS) {
        __atomic_store_n(&collector->filled, collector->filled + 1u, __ATOMIC_RELEASE);
    }
}

void block_release(block_collector_t *collector) {
    __atomic_store_n(&collector->released, collector->released + 1u, __ATOMIC_RELEASE);
}

/* Adds the samples of the chips whose bits are set. */
static void add_samples(const block_samples_t *block, uint32_t chips, int32_t sum[EPOCH_AXES]) {
    int32_t x = 0, y = 0, z = 0;
    for (; chips != 0u; chips &= chips - 1u) {
        const int16_t *const sample = block->samples[__builtin_ctz(chips)];
        x += sample[0];
        y += sample[1];
        z += sample[2];
    }
    sum[0] = x;
    sum[1] = y;
    sum[2] = z;
}

static uint8_t unmeasured_axes(const epoch_calibration_t *calibration, uint32_t saturated) {
    uint32_t unmeasured = 0;
    for (uint32_t row = 0; row < EPOCH_AXES; row++) {
        for (uint32_t column = 0; column < EPOCH_AXES; column++) {
            const bool takes = calibration->matrix[row][column] != 0.0f; /* Else the column has no part in the row. */
            unmeasured |= takes && (saturated >> column & 1u) != 0u ? 1u << row : 0u;
        }
    }
    return (uint8_t)unmeasured;
}

void block_sums(const block_samples_t *block, const code_bits_t *codes, const epoch_selection_t *selection,
                const epoch_calibration_t *calibration, block_sums_t *sums) {
    sums->number = block->number;
    sums->cycle = block->cycle;
    sums->chip = block->chip;
    sums->count = selection->count;
    sums->unmeasured = unmeasured_axes(calibration, block->saturated);
    int32_t plain[EPOCH_AXES];
    add_samples(block, (1u << BLOCK_CHIPS) - 1u, plain);
    epoch_scale(calibration, plain, (float)BLOCK_CHIPS, 1.0f, sums->sums_T[sums->count]);
    for (uint32_t i = 0; i < sums->count; i++) {
        const uint32_t bits = code_bits_at(codes, selection->codes[i].code, block->chip);
        int32_t sum[EPOCH_AXES]; /* First it is the sum of the chips that are -1. */
        add_samples(block, bits, sum);
        for (uint32_t axis = 0; axis < EPOCH_AXES; axis++) {
            sum[axis] = plain[axis] - 2 * sum[axis];
        }
        const int32_t code_sum = (int32_t)BLOCK_CHIPS - 2 * __builtin_popcount(bits);
        epoch_scale(calibration, sum, (float)code_sum, 1.0f, sums->sums_T[i]);
        sums->bits[i] = bits;
    }
}

#include "core/track/block_gram.h"

#define EVERY_OTHER 0x55555555u
#define EVERY_PAIR  0x33333333u
#define EVERY_HALF  0x0F0F0F0Fu

/* Counts the ones of a word and sums their places: first within pairs of bits, then within nibbles and bytes. */
static inline void count_ones(uint32_t x, uint32_t *ones, uint32_t *places) {
    const uint32_t high = x >> 1 & EVERY_OTHER;
    const uint32_t pairs = (x & EVERY_OTHER) + high;
    const uint32_t high_pairs = pairs >> 2 & EVERY_PAIR;
    const uint32_t nibbles = (pairs & EVERY_PAIR) + high_pairs;
    const uint32_t in_nibbles = (high & EVERY_PAIR) + (high >> 2 & EVERY_PAIR) + 2u * high_pairs;
    const uint32_t high_nibbles = nibbles >> 4 & EVERY_HALF;
    const uint32_t bytes = (nibbles & EVERY_HALF) + high_nibbles;
    const uint32_t in_bytes = (in_nibbles & EVERY_HALF) + (in_nibbles >> 4 & EVERY_HALF) + 4u * high_nibbles;
    /* The highest byte of such a product is the sum of all bytes, or of 0, 1, 2 and 3 times each. */
    *ones = bytes * 0x01010101u >> 24;
    *places = (in_bytes * 0x01010101u >> 24) + 8u * (bytes * 0x00010203u >> 24);
}

void block_gram(const uint32_t *bits, uint32_t beacons, uint32_t chips, float chip_s, block_t *block) {
    const uint32_t in_block = UINT32_MAX >> (BLOCK_CHIPS_MAX - chips);
    const int32_t last = (int32_t)chips - 1;
    block->columns = beacons + 1u;
    for (uint32_t i = 0; i <= beacons; i++) {
        const uint32_t own = i < beacons ? bits[i] & in_block : 0u;
        for (uint32_t j = 0; j < i; j++) {
            uint32_t ones, places;
            count_ones(own ^ (bits[j] & in_block), &ones, &places);
            const float gram = (float)((int32_t)chips - 2 * (int32_t)ones);
            const float moment = chip_s * (float)(last * (int32_t)ones - 2 * (int32_t)places);
            block->gram[i][j] = block->gram[j][i] = gram;
            block->moment[i][j] = block->moment[j][i] = moment;
        }
        block->gram[i][i] = (float)chips;
        block->moment[i][i] = 0.0f;
    }
}

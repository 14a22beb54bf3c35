/* cells.h: two slots of flash whose cells are a one, a zero, or weak: what lost its power while it was programmed or
 * erased reads by chance, anew at each start. It follows tests/firmware/core/storage/flash_cells.py. */
#ifndef GOLDFIELD_FUZZ_CELLS_H
#define GOLDFIELD_FUZZ_CELLS_H

#include "fuzz.h"

#define CELLS_SLOTS 2u
#define CELLS_WORDS 192u

typedef struct {
    uint32_t words; /* Words of a slot. */
    uint32_t read[CELLS_SLOTS][CELLS_WORDS];
    uint32_t weak[CELLS_SLOTS][CELLS_WORDS];
    uint32_t stuck[CELLS_SLOTS][CELLS_WORDS]; /* Bits that can no longer be cleared. */
    uint32_t state;                           /* What chances come from. */
} cells_t;

static inline void cells_erase(cells_t *cells, uint32_t slot) {
    memset(cells->read[slot], 0xFF, cells->words * sizeof(uint32_t));
    memset(cells->weak[slot], 0, cells->words * sizeof(uint32_t));
}

static inline void cells_init(cells_t *cells, uint32_t words, uint32_t seed) {
    memset(cells, 0, sizeof *cells);
    cells->words = words;
    cells->state = seed;
    cells_erase(cells, 0);
    cells_erase(cells, 1);
}

/* Switch the power on. */
static inline void cells_start(cells_t *cells) {
    for (uint32_t i = 0; i < CELLS_SLOTS * cells->words; i++) {
        const uint32_t weak = cells->weak[i % CELLS_SLOTS][i / CELLS_SLOTS];
        uint32_t *const read = &cells->read[i % CELLS_SLOTS][i / CELLS_SLOTS];
        if (weak != 0u) {
            *read = (*read & ~weak) | (chance(&cells->state) & weak);
        }
    }
}

static inline void cells_program(cells_t *cells, uint32_t slot, uint32_t index, uint32_t value) {
    const uint32_t cleared = ~value & ~cells->stuck[slot][index];
    cells->read[slot][index] &= ~cleared;
    cells->weak[slot][index] &= ~cleared;
}

static inline void cells_tear_word(cells_t *cells, uint32_t how, uint32_t slot, uint32_t index, uint32_t touched,
                                   uint32_t target) {
    const uint32_t weak = (how == 0u ? 0u : how == 1u ? UINT32_MAX : chance(&cells->state)) & touched;
    const uint32_t changed = chance(&cells->state) & touched & ~weak;
    cells->read[slot][index] = (cells->read[slot][index] & ~changed) | (target & changed);
    cells->weak[slot][index] = (cells->weak[slot][index] & ~changed) | weak;
}

/* Lose the power within a word: how is 0 for some cells changed, 1 for all weak, 2 for each in one of these ways. */
static inline void cells_tear(cells_t *cells, uint32_t how, uint32_t slot, uint32_t index, uint32_t value) {
    const uint32_t unclear = cells->read[slot][index] | cells->weak[slot][index];
    cells_tear_word(cells, how, slot, index, ~value & unclear & ~cells->stuck[slot][index], 0);
}

/* Lose the power within an erasure. */
static inline void cells_tear_erasure(cells_t *cells, uint32_t how, uint32_t slot) {
    for (uint32_t i = 0; i < cells->words; i++) {
        cells_tear_word(cells, how, slot, i, UINT32_MAX, chance(&cells->state));
    }
}

#endif

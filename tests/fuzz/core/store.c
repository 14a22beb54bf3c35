/* store.c: whatever step of a save loses its power, and however often, the next start reads the set before it or the
 * new one, whole; what was said to be kept is read ever after. Sets hold anything, also what looks like the store's own
 * records. The flash may hold anything at first, and a few of its bits may not be programmable. */
#include "core/storage/store.h"

#include "cells.h"
#include "core/storage/crc32.h"
#include "fuzz.h"

#define WORDS_LEAST 4u
#define SET_MAX     24u
#define STEPS_MAX   3000u
#define TURNS_MOST  48u
#define NO_CUT      UINT32_MAX

typedef struct {
    uint32_t words[SET_MAX], count;
    bool there;
} set_t;

typedef struct {
    cells_t cells;
    store_t store;
    set_t kept, maybe; /* What is kept for sure, and what a save that lost its power may have left. */
} board_t;

static bool is(const set_t *set, const uint32_t *words, uint32_t count) {
    return set->there ? words != NULL && count == set->count && memcmp(words, set->words, count * sizeof *words) == 0
                      : words == NULL && count == 0u;
}

/* Looks what the store reads, which must be one of the two. */
static const set_t *look(const board_t *board) {
    uint32_t count;
    const uint32_t *const words = store_read(&board->store, &count);
    if (board->maybe.there && is(&board->maybe, words, count)) {
        return &board->maybe;
    }
    REQUIRE(is(&board->kept, words, count));
    return &board->kept;
}

/* Carries out steps until there are none. Returns false if the power is lost at the step cut. */
static bool work(board_t *board, uint32_t cut, uint32_t how) {
    for (uint32_t i = 0;; i++) {
        const store_step_t step = store_next(&board->store);
        if (step.kind == STORE_NOTHING) {
            return true;
        }
        REQUIRE(i < STEPS_MAX);
        REQUIRE(step.slot < STORE_SLOTS && (step.kind == STORE_ERASE || step.index < board->cells.words));
        if (i == cut && step.kind == STORE_ERASE) {
            cells_tear_erasure(&board->cells, how, step.slot);
            return false;
        }
        if (i == cut) {
            cells_tear(&board->cells, how, step.slot, step.index, step.value);
            return false;
        }
        if (step.kind == STORE_ERASE) {
            cells_erase(&board->cells, step.slot);
        } else {
            cells_program(&board->cells, step.slot, step.index, step.value);
        }
    }
}

/* Switches on: what is read is one of the two, and once it is mended it is that for good. */
static bool start(board_t *board, uint32_t cut, uint32_t how) {
    const store_flash_t flash = {{board->cells.read[0], board->cells.read[1]}, board->cells.words};
    cells_start(&board->cells);
    store_open(&board->store, &flash);
    const set_t found = *look(board);
    if (!work(board, cut, how)) {
        return false;
    }
    REQUIRE(look(board)->count == found.count);
    board->kept = found;
    board->maybe.there = false;
    return true;
}

/* Puts words that are a record of the store into a set. Returns whether all of it, to its commit word, fits. */
static bool forge(set_t *set, uint32_t at) {
    const uint32_t head[2] = {0x47520000u, 0x10000u};
    const uint32_t record[4] = {head[0], head[1], crc32(0, head, sizeof head), 0x5AC3A53Cu};
    for (uint32_t i = 0; i < 4u && at + i < set->count; i++) {
        set->words[at + i] = record[i];
    }
    return at + 4u <= set->count;
}

static void save(board_t *board, input_t *input, uint32_t cut, uint32_t how) {
    set_t set = {.count = take_u8(input) % (SET_MAX + 1u), .there = true};
    const uint32_t look_alike = take_u8(input);
    for (uint32_t i = 0; i < set.count; i++) {
        set.words[i] = chance(&board->cells.state);
    }
    const bool forged = look_alike < 128u && forge(&set, look_alike % SET_MAX);
    const bool fits = board->cells.words >= STORE_OVERHEAD && set.count <= board->cells.words - STORE_OVERHEAD;
    const bool begun = store_save(&board->store, set.words, set.count);
    REQUIRE(begun == (fits && !forged));
    if (!begun) {
        (void)look(board);
        return;
    }
    if (!work(board, cut, how)) {
        board->maybe = set;
        return;
    }
    const store_outcome_t outcome = store_outcome(&board->store);
    REQUIRE(outcome == STORE_SAVED || outcome == STORE_FAILED);
    if (outcome == STORE_SAVED) {
        board->kept = set;
    }
    (void)look(board);
}

static void turns(board_t *board, input_t *input) {
    bool on = start(board, NO_CUT, 0);
    for (uint32_t turn = 0; input->left > 0u && turn < TURNS_MOST; turn++) {
        const uint32_t what = take_u8(input), cut = what % 2u == 0u ? take_u8(input) % 64u : NO_CUT;
        if (on && what < 192u) {
            save(board, input, cut, what / 2u % 3u);
            on = !board->maybe.there;
        } else {
            on = start(board, cut, what / 2u % 3u);
        }
    }
    while (!start(board, NO_CUT, 0)) {
    }
    (void)start(board, NO_CUT, 0);
}

/* Flash that holds anything: reads stay in it, and a save is kept if it is said to be. */
static void anything(board_t *board, input_t *input) {
    static const uint32_t marks[] = {0, UINT32_MAX, 0x47465331u, 0x2D5A1E69u, 0x5AC3A53Cu, 0x3CA5C35Au, 0x47520001u};
    for (uint32_t i = 0; i < STORE_SLOTS * board->cells.words; i++) {
        const uint32_t mark = take_u8(input);
        board->cells.read[i % STORE_SLOTS][i / STORE_SLOTS] = mark < 7u ? marks[mark] : take_u32(input);
    }
    const store_flash_t flash = {{board->cells.read[0], board->cells.read[1]}, board->cells.words};
    store_open(&board->store, &flash);
    uint32_t count, again;
    const uint32_t *const words = store_read(&board->store, &count);
    REQUIRE(words == NULL || count <= board->cells.words);
    (void)crc32(0, words != NULL ? words : &count, count * sizeof *words);
    (void)work(board, NO_CUT, 0);
    const uint32_t data[3] = {1, 2, 3};
    if (store_save(&board->store, data, 3) && work(board, NO_CUT, 0) && store_outcome(&board->store) == STORE_SAVED) {
        store_t other;
        store_open(&other, &flash);
        const uint32_t *const found = store_read(&other, &again);
        REQUIRE(found != NULL && again == 3u && memcmp(found, data, sizeof data) == 0);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size) {
    static board_t board;
    input_t input = {bytes, size};
    const uint32_t mode = take_u8(&input), words = WORDS_LEAST + take_u8(&input) % 92u;
    memset(&board, 0, sizeof board);
    cells_init(&board.cells, words, take_u8(&input));
    if (mode % 4u == 3u) {
        anything(&board, &input);
        return 0;
    }
    for (uint32_t i = 0; mode % 4u == 2u && i < 4u; i++) { /* Worn flash. */
        const uint32_t place = take_u8(&input);
        board.cells.stuck[place % STORE_SLOTS][place / STORE_SLOTS % words] = take_u32(&input);
    }
    turns(&board, &input);
    return 0;
}

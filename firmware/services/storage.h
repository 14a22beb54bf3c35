/* storage.h: a board's parameters in its flash, so that they outlive the loss of power, also at any moment while they
 * are being saved: a board starts with the set before or with the new one (core/storage/store.h).
 *
 * Calls, in the order they are made (all of them from main)
 *   1. storage_start  once, before the chip engine starts: it applies what is saved.
 *   2. storage_save   begins to save what is in force.
 *      storage_step   once a turn until it tells the result.
 *
 * The words of a set are those of parameter_set.h; the slots those of hal_flash_slot(). Where parameters come from: the
 * defaults, over them the parameter page (parameters_load()), over both the newest saved set, which holds every
 * parameter. So a page acts only on a board that has saved nothing; make flash, which writes one, erases the slots.
 *
 * A set that was not whole when the board started, because the power went while it was saved or because the flash
 * has aged, is passed over for the one before it, at last for the page, and is counted; so is what a set of another
 * image holds and this one does not take (storage_found_t).
 *
 * Wear. A set takes 1,022 words of the 4,092 of a slot: four saves fill one, and each slot is erased once in eight.
 * With 10,000 erasures of a sector (data sheet, 5.3.12) that makes 80,000 saves. A save of what is saved already
 * writes nothing.
 *
 * Time. storage_start takes 90,000 instructions for empty slots; it passes over each twice, takes the CRC of each
 * record each time, and programs at most STORAGE_MENDS words to mend. storage_step programs STORAGE_WORDS_A_STEP words,
 * 0.5 ms as a rule and 3.2 ms at most, or erases a slot, 0.25 s and 0.5 s; a save takes 32 steps. The last of them
 * looks through the flash as the next start does: 53,000 instructions for each set that lies there, 412,000 for seven.
 * Memory: 4.2 kB.
 */
#ifndef GOLDFIELD_STORAGE_H
#define GOLDFIELD_STORAGE_H

#include "core/link/parameter_set.h"
#include "core/storage/store.h"
#include "hal/hal.h"

#define STORAGE_WORDS_A_STEP 32u
#define STORAGE_MENDS        64u /* Most words that storage_start programs; a save mends the rest. */

/* No other word that a register may hold in the place of a result is one. */
typedef enum {
    STORAGE_BUSY = 0,         /* The save is under way. */
    STORAGE_KEPT = 0x5AC3,    /* The set is kept. */
    STORAGE_RESTART = 0xC35A, /* It is kept, and a slot was erased for it: the chip engine is out of step (hal.h). */
    STORAGE_FAILED = 0x3CA5,  /* Something did not take it, or it was not written down right: the one before is kept. */
    STORAGE_STRANDED = 0xA53C, /* As STORAGE_FAILED, and a slot was erased: the chip engine is out of step. */
} storage_result_t;

/* What storage_start found. */
typedef struct {
    uint32_t torn;    /* Sets that were not whole, 0 to 2. */
    uint32_t refused; /* Values of the saved set that were not taken; 1 for a set that could not be read at all. */
} storage_found_t;

/* Private but for tests. */
typedef struct {
    hal_t *hal;
    store_t store;
    uint32_t words[PARAMETER_SET_WORDS]; /* The set that is being saved. */
    bool whole;                          /* They are those of the parameters. */
    bool begun;                          /* The store has taken the set, and what was left half done is mended. */
    bool erased;                         /* A slot was erased in this save. */
    bool kept;                           /* The latest step has told that the set is kept. */
} storage_t;

/* Apply what is saved to the parameters, and finish or void what a loss of power has left half done. *hal must live for
 * ever.
 * Returns what it found. */
storage_found_t storage_start(storage_t *storage, hal_t *hal, parameters_t *parameters);

/* Begin to save the parameters as they are now. The save before it must have come to its result. version is that of the
 * image (parameter_set.h). */
void storage_save(storage_t *storage, const parameters_t *parameters, uint32_t version);

/* Do a part of the save; the coil drive must be off (hal.h).
 * Returns STORAGE_BUSY until it is done, then its result. */
storage_result_t storage_step(storage_t *storage);

/* Returns whether the latest step has told that the set is kept: who answers by its result asks for it a second time.
 */
bool storage_is_kept(const storage_t *storage);

#endif

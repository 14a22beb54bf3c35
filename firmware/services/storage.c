#include "services/storage.h"

#include <string.h>

_Static_assert(STORE_SLOTS == HAL_FLASH_SLOTS, "the store's slots are the board's");
_Static_assert(PARAMETER_SET_WORDS <= HAL_FLASH_WORDS - STORE_OVERHEAD, "a set fits in a slot");

/* Carries out a step of the store. Whether it has succeeded the store sees by itself. */
static void carry_out(storage_t *storage, const store_step_t *step) {
    if (step->kind == STORE_ERASE) {
        storage->erased = true;
        (void)hal_flash_erase(storage->hal, step->slot);
    } else {
        (void)hal_flash_program(storage->hal, step->slot, step->index, step->value);
    }
}

/* Whether the parameters are those of a set, if the set is one of this table. */
static bool are_those(const parameters_t *parameters, const uint32_t *words, uint32_t count) {
    return count != PARAMETER_SET_WORDS || parameter_set_holds(parameters, words[1], words); /* With their version. */
}

static store_flash_t flash_of(const storage_t *storage) {
    return (store_flash_t){{hal_flash_slot(storage->hal, 0), hal_flash_slot(storage->hal, 1)}, HAL_FLASH_WORDS};
}

static storage_found_t load(storage_t *storage, parameters_t *parameters) {
    const store_flash_t flash = flash_of(storage);
    store_open(&storage->store, &flash);
    storage_found_t found = {.torn = store_torn(&storage->store)};
    uint32_t count;
    const uint32_t *const words = store_read(&storage->store, &count);
    if (words != NULL && (parameter_set_read(parameters, words, count, &found.refused) != PARAMETER_SET_LOADED ||
                          (found.refused == 0u && !are_those(parameters, words, count)))) {
        found.refused = 1;
    }
    return found;
}

/* The set is loaded twice: what an instruction that goes wrong passes over in one, the other one loads. */
storage_found_t storage_start(storage_t *storage, hal_t *hal, parameters_t *parameters) {
    memset(storage, 0, sizeof *storage);
    storage->hal = hal;
    (void)load(storage, parameters);
    const storage_found_t found = load(storage, parameters);
    for (uint32_t i = 0; i < STORAGE_MENDS; i++) {
        const store_step_t step = store_next(&storage->store);
        if (step.kind == STORE_NOTHING) {
            break;
        }
        carry_out(storage, &step); /* Mending erases nothing. */
    }
    return found;
}

/* The store is opened anew: what a word that was written astray has made of it might write over the set that is kept.
 */
void storage_save(storage_t *storage, const parameters_t *parameters, uint32_t version) {
    const store_flash_t flash = flash_of(storage);
    (void)parameter_set_write(parameters, version, storage->words);
    storage->whole = parameter_set_holds(parameters, version, storage->words);
    store_open(&storage->store, &flash);
    storage->begun = false;
    storage->erased = false;
}

/* Whether the words to be saved are those that a store has. */
static bool has(const store_t *store, const storage_t *storage) {
    uint32_t count;
    const uint32_t *const words = store_read(store, &count);
    return count == PARAMETER_SET_WORDS && memcmp(words, storage->words, sizeof storage->words) == 0;
}

/* The same, by other instructions: one that goes wrong lets nobody think that a set is saved. */
static bool is_saved_again(const storage_t *storage) {
    uint32_t count, differ = 0;
    const uint32_t *const words = store_read(&storage->store, &count);
    for (uint32_t i = 0; i < count && i < PARAMETER_SET_WORDS; i++) {
        differ |= words[i] ^ storage->words[i];
    }
    return count == PARAMETER_SET_WORDS && differ == 0u;
}

/* Whether the next start would find them, looked for in the flash alone: the store that has written them may be wrong
 * about it. */
static bool is_found(const storage_t *storage) {
    const store_flash_t flash = flash_of(storage);
    store_t found;
    store_open(&found, &flash);
    return has(&found, storage);
}

static storage_result_t result(const storage_t *storage) {
    if (store_outcome(&storage->store) == STORE_SAVED && is_found(storage) && is_saved_again(storage)) {
        return storage->erased ? STORAGE_RESTART : STORAGE_KEPT;
    }
    return storage->erased ? STORAGE_STRANDED : STORAGE_FAILED;
}

static storage_result_t go_on(storage_t *storage) {
    for (uint32_t i = 0; i < STORAGE_WORDS_A_STEP; i++) {
        const store_step_t step = store_next(&storage->store);
        if (step.kind != STORE_NOTHING) {
            carry_out(storage, &step);
            if (step.kind == STORE_ERASE) {
                return STORAGE_BUSY; /* The watchdog is fed, and main looks around. */
            }
        } else if (!storage->whole) {
            return STORAGE_FAILED;
        } else if (storage->begun) {
            return result(storage);
        } else if (has(&storage->store, storage)) {
            return is_saved_again(storage) ? STORAGE_KEPT : STORAGE_FAILED;
        } else {
            storage->begun = store_save(&storage->store, storage->words, PARAMETER_SET_WORDS) &&
                             store_saves(&storage->store, storage->words, PARAMETER_SET_WORDS);
            if (!storage->begun) {
                return STORAGE_FAILED; /* Somebody has put a record of the store into the parameters (store.h). */
            }
        }
    }
    return STORAGE_BUSY;
}

storage_result_t storage_step(storage_t *storage) {
    const storage_result_t found = go_on(storage);
    storage->whole = storage->whole && found == STORAGE_BUSY; /* The next save is one only if somebody begins it. */
    storage->kept = found == STORAGE_KEPT || found == STORAGE_RESTART;
    return found;
}

bool storage_is_kept(const storage_t *storage) {
    return storage->kept;
}

#include "core/storage/store.h"

#include <stddef.h>

#include "core/storage/crc32.h"

/* A slot: SLOT, erasures, their complement, READY; records from word 4 on. */
#define SLOT       0x47465331u
#define READY      0x2D5A1E69u
#define SLOT_HEAD  4u
#define SLOT_READY 3u
#define WEAR       1u
/* A record: RECORD | count, sequence, the words, CRC, COMMIT, SETTLED. */
#define RECORD       0x47520000u
#define COUNT_MASK   0xFFFFu
#define BEFORE_DATA  2u
#define AROUND_DATA  3u /* Words in front of the commit word beside the data. */
#define END_WORDS    2u /* Commit and settled word. */
#define BEHIND_DATA  3u /* CRC, commit and settled word. */
#define RECORD_EXTRA 5u
#define COMMIT       0x5AC3A53Cu
#define SETTLED      0x3CA5C35Au
#define ERASED       UINT32_MAX
#define GAP          1u /* Words left free behind what was written last. */
#define ELSEWHERE    2u /* Attempts after which a save goes to the other slot. */
#define WORD_BYTES   4u

enum {
    PHASE_MEND,   /* Look for what the last loss of power has left. */
    PHASE_VOID,   /* Clear commit and settled word of a record. */
    PHASE_RENEW,  /* Program commit and settled word of the newest record. */
    PHASE_DONE,   /* Nothing is to be done. */
    PHASE_CHOOSE, /* Find room for a save. */
    PHASE_RETIRE, /* Clear the words in front of the records of a slot that is to be erased. */
    PHASE_ERASE,  /* Erase a slot. */
    PHASE_HEAD,   /* Program the words in front of the records. */
    PHASE_READY,  /* Program the mark of the erasure once more. */
    PHASE_RECORD, /* Program all of a record but its end. */
    PHASE_COMMIT, /* Program commit and settled word. */
};

static const uint32_t *words_of(const store_t *store, uint32_t slot) {
    return store->flash.slot[slot];
}

/* ---- Reading ---- */

/* Index behind a record that begins here; 0 if none does, or if it would reach beyond the slot. A head that a loss of
 * power has left half programmed may read otherwise each time: where its record ends is asked once, and kept. */
static uint32_t end_of(const store_t *store, const uint32_t *words, uint32_t index) {
    const uint32_t head = words[index], end = index + (head & COUNT_MASK) + RECORD_EXTRA;
    return (head & ~COUNT_MASK) == RECORD && end <= store->flash.words ? end : 0u;
}

/* Whether the CRC of the record between two indices fits, committed or not. */
static bool is_whole(const uint32_t *words, uint32_t index, uint32_t end) {
    const uint32_t checked = end - BEHIND_DATA;
    uint32_t crc = 0;
    for (uint32_t i = index; i < checked; i++) {
        crc = crc32(crc, &words[i], WORD_BYTES);
    }
    return crc == words[checked];
}

static bool is_valid(const uint32_t *words, uint32_t index, uint32_t end) {
    return words[end - END_WORDS] == COMMIT && is_whole(words, index, end);
}

/* Whether what lies in a slot counts: one of the three things in front of the records may be damaged. A slot that is
 * being erased has had all of them cleared, so that of its records nothing can come back, however the erasure ends. */
static bool is_live(const uint32_t *words) {
    const bool marked = words[0] == SLOT, counted = words[WEAR] == ~words[WEAR + 1u],
               ready = words[SLOT_READY] == READY;
    return (marked && counted) || (marked && ready) || (counted && ready);
}

/* What a slot holds. */
typedef struct {
    uint32_t newest;   /* Index of its newest record, 0: none. */
    uint32_t commit;   /* Index of the commit word of that. */
    uint32_t dangling; /* The same of the last begun record behind all good ones, if it is not void; 0: none. */
    uint32_t behind;   /* Index behind the last word that is not erased, and behind all that heads lay claim to. */
    bool ready;        /* Whether records may be added. */
} contents_t;

static contents_t look_through(const store_t *store, uint32_t slot) {
    const uint32_t *const words = words_of(store, slot);
    contents_t found = {.behind = store->flash.words};
    if (found.behind < SLOT_HEAD || !is_live(words)) {
        return found;
    }
    while (found.behind > 0u && words[found.behind - 1u] == ERASED) {
        found.behind--;
    }
    uint32_t index = SLOT_HEAD, reach = 0;
    /* An erased word is no head, and a record without a word of data needs room for all around it. */
    while (index < found.behind && index <= store->flash.words - RECORD_EXTRA) {
        const uint32_t end = end_of(store, words, index);
        reach = end > reach ? end : reach;
        if (end > index && is_valid(words, index, end)) {
            found.newest = index; /* Records follow each other in a slot. */
            found.commit = end - END_WORDS;
            found.dangling = 0;
        } else if (end > index && words[end - 1u] != 0u) {
            found.dangling = end - END_WORDS;
        }
        /* Power that is lost within a head leaves an erased word behind it. A head with its number is whole, and what
         * is in its record is data, whatever it looks like. */
        index = end > index && words[index + 1u] != ERASED ? end : index + 1u;
    }
    found.behind = reach > found.behind ? reach : found.behind;
    found.ready = words[0] == SLOT && words[WEAR] == ~words[WEAR + 1u] && words[SLOT_READY] == READY;
    return found;
}

static void find_newest(store_t *store) {
    for (uint32_t slot = 0; slot < STORE_SLOTS; slot++) {
        const contents_t found = look_through(store, slot);
        store->torn += found.dangling != 0u;
        if (found.newest != 0u) {
            const uint32_t sequence = words_of(store, slot)[found.newest + 1u];
            if (sequence >= store->sequence) {
                store->newest = found.newest;
                store->commit = found.commit;
                store->slot = slot;
                store->sequence = sequence;
            }
        }
    }
}

void store_open(store_t *store, const store_flash_t *flash) {
    *store = (store_t){.flash = *flash, .phase = PHASE_MEND};
    find_newest(store);
}

const uint32_t *store_read(const store_t *store, uint32_t *count) {
    if (store->newest == 0u) {
        *count = 0;
        return NULL;
    }
    *count = store->commit - store->newest - AROUND_DATA;
    return words_of(store, store->slot) + store->newest + BEFORE_DATA;
}

store_outcome_t store_outcome(const store_t *store) {
    return store->outcome;
}

uint32_t store_torn(const store_t *store) {
    return store->torn;
}

uint32_t store_wear(const store_t *store, uint32_t slot) {
    const uint32_t *const words = words_of(store, slot);
    return words[0] == SLOT && words[WEAR] == ~words[WEAR + 1u] ? words[WEAR] : 0u;
}

/* ---- Writing ---- */

static store_step_t program(const store_t *store, uint32_t index, uint32_t value) {
    return (store_step_t){STORE_PROGRAM, store->into, index, value};
}

/* Whether the step that was returned last has become true. */
static bool has_taken(const store_t *store) {
    const store_step_t *const step = &store->step;
    const uint32_t *const words = words_of(store, step->slot);
    if (step->kind == STORE_PROGRAM) {
        return words[step->index] == step->value;
    }
    for (uint32_t i = 0; step->kind == STORE_ERASE && i < store->flash.words; i++) {
        if (words[i] != ERASED) {
            return false;
        }
    }
    return true;
}

/* Look for what is to be mended: first what dangles, then the newest record if it is not settled. */
static uint8_t next_mend(store_t *store) {
    for (uint32_t slot = 0; slot < STORE_SLOTS; slot++) {
        const contents_t found = look_through(store, slot);
        if (found.dangling != 0u) {
            store->at = found.dangling;
            store->into = slot;
            return PHASE_VOID;
        }
    }
    if (store->newest != 0u) {
        store->at = store->commit;
        store->into = store->slot;
        if (words_of(store, store->slot)[store->commit + 1u] != SETTLED) {
            return PHASE_RENEW;
        }
    }
    return PHASE_DONE;
}

/* Find room for a record: behind the newest one, else in the other slot, erased if need be. */
static uint8_t choose(store_t *store) {
    const uint32_t first = store->attempts < ELSEWHERE ? store->slot : 1u - store->slot;
    for (uint32_t i = 0; i < STORE_SLOTS; i++) {
        const uint32_t slot = i == 0u ? first : 1u - first;
        const contents_t found = look_through(store, slot);
        const uint32_t from = found.behind > SLOT_HEAD ? found.behind + GAP : SLOT_HEAD;
        if (found.ready && from + store->count + RECORD_EXTRA <= store->flash.words) {
            store->at = from;
            store->into = slot;
            return PHASE_READY;
        }
    }
    store->into = store->newest != 0u ? 1u - store->slot : first;
    const uint32_t here = store_wear(store, store->into), there = store_wear(store, 1u - store->into);
    store->erased = (here != 0u ? here : there) + 1u; /* Slots are erased by turns. */
    store->at = SLOT_HEAD;
    return is_live(words_of(store, store->into)) ? PHASE_RETIRE : PHASE_ERASE;
}

static uint32_t head_word(const store_t *store) {
    const uint32_t words[SLOT_HEAD] = {SLOT, store->erased, ~store->erased, READY};
    return words[store->cursor];
}

static uint32_t record_word(const store_t *store) {
    if (store->cursor == 0u) {
        return RECORD | store->count;
    }
    if (store->cursor == 1u) {
        return store->sequence + 1u;
    }
    return store->cursor < store->count + BEFORE_DATA ? store->data[store->cursor - BEFORE_DATA] : store->crc;
}

/* Whether words hold a whole record of their own. If a bit of the head in front of them changed, theirs would be
 * found. */
static bool hold_record(const uint32_t *words, uint32_t count) {
    for (uint32_t i = 0; i + AROUND_DATA < count; i++) {
        const uint32_t end = i + (words[i] & COUNT_MASK) + RECORD_EXTRA; /* Its settled word may be missing. */
        if ((words[i] & ~COUNT_MASK) == RECORD && end <= count + 1u && is_valid(words, i, end)) {
            return true;
        }
    }
    return false;
}

bool store_save(store_t *store, const uint32_t *data, uint32_t count) {
    if (store->phase != PHASE_DONE || count > STORE_WORDS_MAX || store->flash.words < STORE_OVERHEAD ||
        count > store->flash.words - STORE_OVERHEAD) {
        return false;
    }
    const uint32_t head[BEFORE_DATA] = {RECORD | count, store->sequence + 1u};
    const uint32_t crc = crc32(crc32(0, head, sizeof head), data, (size_t)count * WORD_BYTES);
    if (hold_record(data, count) || crc == COMMIT) { /* Such a CRC could commit a record in front of it. */
        return false;
    }
    store->data = data;
    store->count = count;
    store->crc = crc;
    store->attempts = 0;
    store->outcome = STORE_BUSY;
    store->phase = PHASE_CHOOSE;
    return true;
}

bool store_saves(const store_t *store, const uint32_t *data, uint32_t count) {
    return store->outcome == STORE_BUSY && store->data == data && store->count == count;
}

/* The step of a phase that its cursor stands in front of. */
static store_step_t step_of(const store_t *store) {
    static const uint32_t ends[2] = {COMMIT, SETTLED};
    const uint32_t cursor = store->cursor, end = store->at + store->count + AROUND_DATA;
    switch (store->phase) {
    case PHASE_ERASE:
        return (store_step_t){STORE_ERASE, store->into, 0, 0};
    /* cppcheck-suppress misra-c2012-16.3 ; the clause above ends by its return */
    case PHASE_RETIRE:
        return program(store, cursor, 0);
    /* cppcheck-suppress misra-c2012-16.3 ; the clause above ends by its return */
    case PHASE_VOID:
        return program(store, store->at + cursor, 0);
    case PHASE_RENEW:
        return program(store, store->at + cursor, ends[cursor]);
    case PHASE_HEAD:
        return program(store, cursor, head_word(store));
    case PHASE_READY:
        return program(store, SLOT_READY, READY);
    case PHASE_RECORD:
        return program(store, store->at + cursor, record_word(store));
    default:
        return program(store, end + cursor, ends[cursor]);
    }
}

/* Steps of a phase. */
static uint32_t length(const store_t *store) {
    switch (store->phase) {
    case PHASE_MEND:
    case PHASE_CHOOSE:
        return 0;
    case PHASE_ERASE:
    case PHASE_READY:
        return 1;
    case PHASE_RETIRE:
    case PHASE_HEAD:
        return SLOT_HEAD;
    case PHASE_RECORD:
        return store->count + AROUND_DATA;
    default:
        return 2;
    }
}

/* What follows when the flash has not taken a save. */
static uint8_t save_anew(store_t *store) {
    if (store->attempts < STORE_ATTEMPTS) {
        return PHASE_CHOOSE;
    }
    store->outcome = STORE_FAILED;
    return PHASE_DONE;
}

/* What follows a phase of which a word, or an erasure, has not taken. */
static uint8_t after_failure(store_t *store) {
    switch (store->phase) {
    case PHASE_VOID:
        return store->outcome == STORE_BUSY ? save_anew(store) : (uint8_t)PHASE_DONE;
    case PHASE_RENEW:
        return PHASE_DONE;
    case PHASE_RETIRE:
        return PHASE_ERASE; /* A worn word: what it says does not count. */
    case PHASE_RECORD:
    case PHASE_COMMIT:
        store->attempts++;
        store->at += store->count + AROUND_DATA;
        return PHASE_VOID;
    default:
        store->attempts++;
        return save_anew(store);
    }
}

/* What follows a phase that has come to its end. */
static uint8_t after(store_t *store) {
    switch (store->phase) {
    case PHASE_MEND:
    case PHASE_RENEW:
        return next_mend(store);
    case PHASE_VOID:
        return store->outcome == STORE_BUSY ? save_anew(store) : next_mend(store);
    case PHASE_CHOOSE:
        return choose(store);
    case PHASE_RETIRE:
        return PHASE_ERASE;
    case PHASE_ERASE:
        return PHASE_HEAD;
    case PHASE_HEAD:
    case PHASE_READY:
        return PHASE_RECORD;
    case PHASE_RECORD:
        return is_whole(words_of(store, store->into), store->at, store->at + store->count + RECORD_EXTRA)
                   ? PHASE_COMMIT
                   : after_failure(store);
    default:
        store->newest = store->at;
        store->commit = store->at + store->count + AROUND_DATA;
        store->slot = store->into;
        store->sequence++;
        store->outcome = STORE_SAVED;
        return PHASE_DONE;
    }
}

store_step_t store_next(store_t *store) {
    if (!has_taken(store)) {
        store->phase = after_failure(store);
        store->cursor = 0;
    }
    store->step = (store_step_t){0};
    while (store->phase != PHASE_DONE) { /* At most three phases without a step follow each other. */
        if (store->cursor < length(store)) {
            store->step = step_of(store);
            store->cursor++;
            return store->step;
        }
        store->phase = after(store);
        store->cursor = 0;
    }
    return store->step;
}

/* store.c: any state of the store, any of its calls; what comes of it is one of these states again. */

/* store_next() takes four turns at most, the last of which finds nothing to do. */
#define COUNTED    's'
#define MOST_TURNS 4u
#include "turns.h"

/* The source itself, so that the harness can name the phases, which are private. */
#include "core/storage/store.c"
#undef while

#include "any.h"
#include "core/link/parameter_set.h"

#define WORDS 4096u
#define COUNT PARAMETER_SET_WORDS
#define SMALL 12u
#define FEW   256u

static uint32_t slot_a[WORDS], slot_b[WORDS]; /* What leaves one does not come into the other. */
static uint32_t data[COUNT];

/* Any step that the store can have returned. Between two calls a phase without steps has returned none. */
static store_step_t any_step(uint32_t steps) {
    store_step_t step = {STORE_NOTHING, any_up_to(STORE_SLOTS - 1u), any_up_to(WORDS - 1u), any_word()};
    if (steps > 0u) {
        step.kind = (store_kind_t)any_up_to(STORE_ERASE);
    }
    return step;
}

/* Steps of the phase, of which the last one has none. */
static uint32_t steps_of(const store_t *store) {
    return store->phase == PHASE_DONE ? 0u : length(store);
}

/* The largest place at which a phase writes. */
static uint32_t last_place(uint8_t phase) {
    return phase >= PHASE_RETIRE ? WORDS - COUNT - RECORD_EXTRA : WORDS - END_WORDS;
}

/* Any state in which a phase can be. */
static store_t any_store(uint8_t phase) {
    store_t store = {.flash = {{slot_a, slot_b}, WORDS}, .data = data, .count = COUNT, .phase = phase};
    fill(slot_a, sizeof slot_a);
    fill(slot_b, sizeof slot_b);
    fill(data, sizeof data);
    store.crc = any_word();
    store.sequence = any_word();
    store.newest = any_up_to(WORDS - RECORD_EXTRA);
    store.commit = any_up_to(WORDS - END_WORDS);
    store.slot = any_up_to(STORE_SLOTS - 1u);
    store.at = any_up_to(last_place(phase));
    store.into = any_up_to(STORE_SLOTS - 1u);
    store.cursor = any_up_to(steps_of(&store));
    store.erased = any_word();
    store.attempts = any_up_to(phase <= PHASE_DONE ? STORE_ATTEMPTS : STORE_ATTEMPTS - 1u);
    store.torn = any_up_to(STORE_SLOTS);
    store.outcome = (store_outcome_t)any_up_to(STORE_FAILED);
    store.step = any_step(steps_of(&store));
    return store;
}

/* Whether a state is one of any_store(). */
static void check(const store_t *store) {
    //@ assert store->phase <= PHASE_COMMIT;
    //@ assert store->newest <= WORDS - RECORD_EXTRA && store->commit <= WORDS - END_WORDS;
    //@ assert store->slot < STORE_SLOTS && store->into < STORE_SLOTS && store->torn <= STORE_SLOTS;
    uint32_t last, steps;
    //@ split store->phase;
    last = last_place(store->phase);
    steps = steps_of(store);
    //@ assert store->at <= last;
    //@ assert store->cursor <= steps;
    //@ assert store->attempts <= STORE_ATTEMPTS;
    //@ assert store->phase <= PHASE_DONE || store->attempts < STORE_ATTEMPTS;
    //@ assert store->step.kind == STORE_NOTHING || steps > 0u;
    //@ assert store->step.kind <= STORE_ERASE && store->step.slot < STORE_SLOTS && store->step.index < WORDS;
}

static void open(void) {
    store_t store;
    const store_flash_t flash = {{slot_a, slot_b}, WORDS};
    fill(slot_a, sizeof slot_a);
    fill(slot_b, sizeof slot_b);
    store_open(&store, &flash);
    check(&store);
}

static void next(void) {
    for (uint8_t phase = PHASE_MEND; phase <= PHASE_COMMIT; phase++) {
        store_t store = any_store(phase);
        turns = 0;
        (void)store_next(&store);
        check(&store);
    }
}

static void save(void) {
    for (uint8_t phase = PHASE_MEND; phase <= PHASE_COMMIT; phase++) {
        store_t store = any_store(phase);
        (void)store_save(&store, data, COUNT);
        check(&store);
    }
    for (uint32_t count = 0; count <= SMALL; count++) {
        store_t store = any_store(PHASE_DONE);
        (void)store_save(&store, data + (COUNT - count), count);
    }
    store_t store = any_store(PHASE_DONE);
    const bool begun = store_save(&store, data, Frama_C_unsigned_int_interval(WORDS - STORE_OVERHEAD + 1u, UINT32_MAX));
    //@ assert !begun;
}

/* The words that are read lie within their slot. A record begins at newest, and its commit word stands so many words
 * behind it as it has beside 3: both are set from one head. */
static void read(void) {
    for (uint32_t newest = SLOT_HEAD; newest <= FEW - RECORD_EXTRA; newest++) {
        store_t held = {.flash = {{slot_a + (WORDS - FEW), slot_b + (WORDS - FEW)}, FEW}, .newest = newest};
        held.slot = any_up_to(STORE_SLOTS - 1u);
        held.commit = Frama_C_unsigned_int_interval(newest + AROUND_DATA, FEW - END_WORDS);
        uint32_t count;
        const uint32_t *const words = store_read(&held, &count);
        //@ assert \valid_read(words + (0 .. count - 1));
    }
    uint32_t none;
    store_t empty = any_store(PHASE_DONE);
    empty.newest = 0;
    (void)store_read(&empty, &none);
    //@ assert none == 0;
    store_t store = any_store((uint8_t)any_up_to(PHASE_COMMIT));
    (void)store_outcome(&store);
    (void)store_saves(&store, data, COUNT);
    (void)store_torn(&store);
    (void)store_wear(&store, any_up_to(STORE_SLOTS - 1u));
}

int main(void) {
    open();
    next();
    save();
    read();
    return 0;
}

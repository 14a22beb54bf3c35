/* store.h: one set of numbers that is kept in flash, so that after a loss of power at any moment either the old set or
 * the new one is there. It decides what is to be programmed and erased; it touches no hardware.
 *
 * Calls, in the order they are made:
 *   1. store_open() looks through both slots;
 *   2. store_next() until it returns STORE_NOTHING: what the last loss of power has left half done is finished or
 *      made void. The set may be read before, and does not change by it;
 *   3. store_read() gives the set;
 *   4. store_save() begins to save another one, and store_next() until STORE_NOTHING goes through with it;
 *      store_outcome() then tells whether it is kept. A set is promised to be kept only from then on.
 * The caller carries out each step that store_next() returns before it asks for the next one, whatever it does
 * meanwhile: a word or an erasure at a time.
 *
 * The flash is two slots of equal size, each of one sector or several that are erased together. A word is programmed
 * from all ones; programming a word once more may only clear further bits. Flash with a checksum of its own for each
 * word, which forbids that, does not do.
 *
 * A slot begins with four words: a mark, how often it was erased, the complement of that, and a mark that the erasure
 * came to its end. Records follow, each a head (a mark, and how many words it holds), a sequence number, the words,
 * the CRC-32 of all these, a commit word and a settled word. The record with the largest number counts; each save adds
 * one behind the others, and one for which there is no room goes to the other slot, which is erased before. What the
 * newest record holds is in the slot that is not touched meanwhile.
 *
 * Power lost within a word or an erasure leaves cells that read now as one and now as zero. So the commit word is
 * programmed only when the words before it read as they should; a committed record that is found unsettled is
 * committed once more, and then settled, before it is relied on; one that is found uncommitted has both words cleared,
 * so that it does not come back at another temperature. A word is left free behind what was last written, and the
 * mark of the erasure is programmed once more before a record is added.
 *
 * Words of a set may look like a record. They are never taken for one: a head is followed by its number only if it was
 * programmed to its end, and what lies within a record with both is skipped, whole or not; a head without its number
 * keeps the room that it lays claim to. A slot's own head is cleared before it is erased, and with two of the three
 * things in it gone nothing counts that is in the slot.
 *
 * A word that does not take its value makes the save begin anew behind it, the third time in the other slot;
 * STORE_ATTEMPTS end it.
 *
 * Contexts: all calls come from main. Memory: store_t takes about 90 bytes. Time: store_open() passes once over both
 * slots, and a few CRCs; store_next() one comparison, at the end of a save the CRC of the record. Wear: a slot of w
 * words is erased once in 2 (w - 4) / (n + 6) saves of n words: 16 KiB and 250 words make 31, and 10,000 erasures
 * 310,000 saves.
 */
#ifndef GOLDFIELD_STORE_H
#define GOLDFIELD_STORE_H

#include <stdbool.h>
#include <stdint.h>

#define STORE_SLOTS     2u
#define STORE_ATTEMPTS  4u /* Times that a save is begun before it has failed. */
#define STORE_WORDS_MAX 0xFFFFu
#define STORE_OVERHEAD  9u /* Words of a slot that a single record cannot use. */

/* Where the slots are: they are read like memory. */
typedef struct {
    const uint32_t *slot[STORE_SLOTS];
    uint32_t words; /* Words of a slot, STORE_OVERHEAD at least. */
} store_flash_t;

typedef enum { STORE_NOTHING = 0, STORE_PROGRAM = 1, STORE_ERASE = 2 } store_kind_t;

/* What the caller is to do with the flash next. */
typedef struct {
    store_kind_t kind;
    uint32_t slot;  /* 0 or 1. */
    uint32_t index; /* The word's place in the slot, STORE_PROGRAM only. */
    uint32_t value; /* The word's value, STORE_PROGRAM only. */
} store_step_t;

typedef enum {
    STORE_IDLE = 0,   /* No save was begun since store_open(). */
    STORE_BUSY = 1,   /* A save is under way. */
    STORE_SAVED = 2,  /* The last save is kept. */
    STORE_FAILED = 3, /* The flash did not take the last save: the set before it is there still. */
} store_outcome_t;

/* The caller's memory; its contents are this module's own. */
typedef struct {
    store_flash_t flash;
    const uint32_t *data; /* What is being saved. */
    uint32_t count;
    uint32_t crc;
    uint32_t sequence; /* The newest record's number. */
    uint32_t newest;   /* Its index in its slot; 0: there is none. */
    uint32_t commit;   /* Index of its commit word. */
    uint32_t slot;     /* Its slot. */
    uint32_t at;       /* Index of the record that is being written or mended. */
    uint32_t into;     /* Its slot. */
    uint32_t cursor;   /* Next word of the phase. */
    uint32_t erased;   /* How often the slot will have been erased. */
    uint32_t attempts;
    uint32_t torn; /* Slots in which store_open() found a record that is not whole behind the good ones. */
    uint8_t phase;
    store_outcome_t outcome;
    store_step_t step; /* The step that was returned last. */
} store_t;

/* Look for the newest record. What is in the flash is not trusted: any contents are allowed. */
void store_open(store_t *store, const store_flash_t *flash);

/* Returns the words of the newest record and how many they are in *count; NULL and 0 if there is none. They stay where
 * they are until the save after the next one. */
const uint32_t *store_read(const store_t *store, uint32_t *count);

/* Begin to save count words, which must stay as they are until the outcome is there.
 * Returns false, with nothing begun, while another save or the mending after store_open() is under way, for more words
 * than a slot holds, flash.words - STORE_OVERHEAD, or STORE_WORDS_MAX, and for words that hold a whole record of this
 * module with its CRC, or whose own CRC is the commit word: they hardly come by chance, and one wrong bit in the head
 * in front of them would have them read in place of the set. */
bool store_save(store_t *store, const uint32_t *data, uint32_t count);

/* Returns whether the save under way is one of these words: a caller that asks, and goes on only then, keeps no words
 * that an erring processor has handed over in their place. */
bool store_saves(const store_t *store, const uint32_t *data, uint32_t count);

/* Returns the next step for the caller to carry out; STORE_NOTHING if all is done. */
store_step_t store_next(store_t *store);

/* Returns what became of the last save. */
store_outcome_t store_outcome(const store_t *store);

/* Returns in how many slots store_open() found a record that was begun and is not whole, or not any more: what it
 * would have held is lost, and the set before it counts. The mending makes it void, so that it is told once. */
uint32_t store_torn(const store_t *store);

/* Returns how often a slot (0 or 1) was erased, as far as it tells: 0 if its head cannot be read. */
uint32_t store_wear(const store_t *store, uint32_t slot);

#endif

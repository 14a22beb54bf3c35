/* install.h: a new image into the slot that does not run, and the running image's word that it is good. It decides what
 * is to be programmed and erased; it touches no hardware. select.h tells what a start makes of it.
 *
 * Calls, in the order they are made:
 *   1. install_open() takes the slots and which of them runs.
 *   2. install_confirm(), once the running image has found itself good; install_next() until INSTALL_NOTHING.
 *   3. install_begin() for a new image; install_next() until INSTALL_NOTHING empties the other slot; install_phase()
 *      then is INSTALL_RECEIVING.
 *   4. The caller programs the words for which install_takes() is true, in any order and each as often as it likes.
 *   5. install_end() checks the whole image; install_next() until INSTALL_NOTHING marks it as pending. The next start
 *      tries it.
 *   install_begin() may be called again at any time, and begins anew.
 * The caller carries out each step before it asks for the next one.
 *
 * The running image is never touched, and must be confirmed before the other slot is emptied: it is the one that comes
 * back. What lies in the other slot is made void before it is erased, so that an erasure that loses its power leaves
 * nothing that looks like an image; the new one gets its number and its mark only when all of it is there and checked.
 *
 * Contexts: main. Memory: install_t takes 110 bytes. Time: install_end() takes a CRC and a signature (image.h), the
 * first install_next() behind an erasure looks through the slot.
 */
#ifndef GOLDFIELD_INSTALL_H
#define GOLDFIELD_INSTALL_H

#include "core/boot/image.h"

typedef enum { INSTALL_NOTHING = 0, INSTALL_PROGRAM = 1, INSTALL_ERASE = 2 } install_kind_t;

/* What the caller is to do with the flash next. */
typedef struct {
    install_kind_t kind;
    uint32_t slot;
    uint32_t index; /* The word's place in the slot; for an erasure, how many words from 0 on must be erased. */
    uint32_t value; /* INSTALL_PROGRAM only. */
} install_step_t;

typedef enum {
    INSTALL_IDLE = 0,       /* Nothing is under way. */
    INSTALL_CONFIRMING = 1, /* The running image is being marked as good. */
    INSTALL_EMPTYING = 2,   /* The other slot is being emptied. */
    INSTALL_RECEIVING = 3,  /* The other slot takes the words of an image. */
    INSTALL_MARKING = 4,    /* The image is whole and good, and is being marked so. */
    INSTALL_PENDING = 5,    /* It is: the next start tries it. */
    INSTALL_FAILED = 6,     /* The flash did not take a word or an erasure. The running image is what it was. */
} install_phase_t;

/* Why an image is not taken before any of it has come. */
typedef enum {
    INSTALL_OK = 0,
    INSTALL_UNCONFIRMED = 1, /* The running image is not confirmed, or no boot loader has started it. */
    INSTALL_LENGTH = 2,      /* The other slot does not hold so much, or it is no whole number of words. */
} install_refusal_t;

/* The caller's memory; its contents are this module's own. */
typedef struct {
    image_flash_t flash;
    uint32_t running;
    uint32_t words; /* Words of the other slot that the new image takes. */
    bool forced;
    install_phase_t phase;
    uint32_t cursor;     /* Next step of the phase. */
    install_step_t step; /* The step that was returned last. */
} install_t;

/* Take the slots, of which one (0 or 1) runs. */
void install_open(install_t *install, const image_flash_t *flash, uint32_t running);

/* Begin to mark the running image as good. Returns whether there is anything to be marked: not if it is confirmed for
 * good, nor if no start has tried it. */
bool install_confirm(install_t *install);

/* Begin to take an image whose code has this many bytes; forced: it may be older than the one that runs.
 * Returns why not. */
install_refusal_t install_begin(install_t *install, uint32_t bytes, bool forced);

/* Returns the next step; INSTALL_NOTHING if there is none until the next call of another function. */
install_step_t install_next(install_t *install);

/* Returns what is under way. */
install_phase_t install_phase(const install_t *install);

/* Returns whether a word of the other slot, by its index, may be programmed now with what has come for it. */
bool install_takes(const install_t *install, uint32_t index);

/* Check the image that was received; if it is good, begin to mark it. Otherwise words may still be programmed.
 * Returns what is wrong; IMAGE_NONE also if none is being received. */
image_status_t install_end(install_t *install);

#endif

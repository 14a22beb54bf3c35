/* select.h: which of two images starts. A new image is started once; if it has not confirmed itself by the next start,
 * the one before it comes back. Whatever step of an update loses its power, one of the two starts.
 *
 * Calls, in the order they are made:
 *   1. select_open() takes the slots;
 *   2. select_next() until it returns no step: the caller programs each word before it asks for the next;
 *   3. select_choice() tells which slot is to be started.
 *
 * The newest image comes first. It starts
 *   confirmed    if it is intact (its CRC; it was checked when it was new);
 *   pending      and never tried, if image_check() finds nothing: for the board, of the role and not older than the
 *                confirmed image in the other slot, and signed. It is marked as tried before it starts, and checked
 *                once more behind that: one instruction that goes wrong starts nothing that nobody has signed;
 * and it is rejected for ever, and the other one looked at, if it was tried and is not confirmed, or fails the check.
 * If all this leaves none, the newest image that is signed starts whatever became of it, since a node without any is
 * out of reach; nothing is marked then. An instruction that goes wrong is no way there past a confirmed image: that one
 * is never rejected, and beside it an older one does not start.
 *
 * Power lost within a word leaves cells that read now as one and now as zero. So a word that a decision rests on is
 * programmed once more, and then a second word behind it, before the decision has effect: IMAGE_SETTLED behind
 * IMAGE_CONFIRMED, which both are MARK, or both void for a rejection. A word that does not take its value (worn flash)
 * costs the pending image its start, and nothing else.
 *
 * Contexts: the boot loader, before anything else runs. Memory: select_t takes 80 bytes. Time: a CRC; a signature,
 * twice, only when an image is tried. It programs at most 6 words, and erases nothing.
 */
#ifndef GOLDFIELD_SELECT_H
#define GOLDFIELD_SELECT_H

#include "core/boot/image.h"

/* A word that the caller is to program. */
typedef struct {
    bool wanted; /* False: there is none any more. */
    uint32_t slot, index, value;
} select_step_t;

/* What starts. */
typedef struct {
    bool found;
    uint32_t slot;
    bool trial; /* It has to confirm itself. */
} select_choice_t;

/* What is known of the image in a slot. */
typedef enum {
    SELECT_NOTHING = 0,   /* No image that could be started. */
    SELECT_PENDING = 1,   /* It wants to be started for the first time. */
    SELECT_TRIED = 2,     /* It was started and is not confirmed. */
    SELECT_CONFIRMED = 3, /* It is good. */
    SELECT_REJECTED = 4,  /* It will not be started any more. */
} select_state_t;

/* The caller's memory; its contents are this module's own. */
typedef struct {
    image_flash_t flash;
    uint32_t order[IMAGE_SLOTS]; /* Slots, the newest first. */
    uint32_t place;              /* Which of them is looked at. */
    uint32_t cursor;             /* Next word of what is done to it. */
    uint8_t phase;
    select_choice_t choice;
} select_t;

/* Returns what the state words of a slot (0 or 1) say. */
select_state_t select_state(const image_flash_t *flash, uint32_t slot);

/* Returns what the image in a slot must be, for what the other slot holds. */
image_demand_t select_demand(const image_flash_t *flash, uint32_t slot);

/* Look at the slots. What is in the flash is not trusted: any contents are allowed. */
void select_open(select_t *select, const image_flash_t *flash);

/* Returns the next word to program. */
select_step_t select_next(select_t *select);

/* Returns what starts, once there are no more steps. */
select_choice_t select_choice(const select_t *select);

#endif

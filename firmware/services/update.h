/* update.h: a new image for this board, over the link on which it is asked for (framing.md, "Updates"). The running
 * image takes it into the other slot, and goes on with its links meanwhile; the next start tries it.
 *
 * Calls, in the order they are made (all of them from main)
 *   1. update_start     once, before the chip engine starts.
 *   2. update_command   for each COMMAND of those below.
 *      update_data      for each UPDATE_DATA.
 *      update_step      once a turn: it tells what is to be done.
 *      update_holds     whether the coil drive must be off.
 *
 * The drive. It is held from the moment that an update is accepted until the board restarts, since the processor stands
 * still for each word and for a second or two while the slot is erased (hal.h), which takes the chip engine its step.
 * So an update ends with a restart in any case: into the new image, or, UPDATE_SILENCE_US after the last block or
 * command of it, into the old one.
 *
 * Trial. An image that was started for the first time confirms itself once it runs for UPDATE_SOUND_US and has heard a
 * command: its host reaches it, so that it could be updated again. The drive is held until then. After UPDATE_TRIAL_US
 * without a command it restarts, and the boot loader comes back to the image before.
 *
 * Time: update_data programs two words, 32 us as a rule; an image of 131,424 bytes comes in 6 s over serial; the
 * command that ends an update checks the signature, 0.1 s at one cycle an instruction. Memory: 330 bytes.
 */
#ifndef GOLDFIELD_UPDATE_H
#define GOLDFIELD_UPDATE_H

#include "core/boot/install.h"
#include "hal/hal.h"

#define UPDATE_PAGE_BLOCKS 1024u /* Blocks of eight bytes that an UPDATE_DATA can number. */
#define UPDATE_SILENCE_US  10000000u
#define UPDATE_SOUND_US    3000000u
#define UPDATE_TRIAL_US    60000000u

/* Indices of COMMAND. */
enum {
    UPDATE_BEGIN = 10,        /* Argument: blocks of eight bytes of the whole image, from the slot's beginning on. */
    UPDATE_BEGIN_FORCED = 11, /* The same; it may be older than the one that runs. */
    UPDATE_PAGE = 12,         /* Argument: the page that follows. */
    UPDATE_MISSING = 13,      /* What is missing of this page. */
    UPDATE_END = 14,          /* Check it, and restart. */
    UPDATE_TELL = 15,         /* Tell your images. */
};

/* What the node is to do. */
typedef enum {
    UPDATE_NOTHING = 0,
    UPDATE_ANSWER = 1, /* Answer the command, by status and value. */
    UPDATE_RESET = 2,  /* Restart. */
} update_action_t;

/* The answer to a command. */
typedef struct {
    update_action_t action; /* UPDATE_NOTHING: the answer comes from update_step(). */
    uint32_t status, value; /* Those of COMMAND_ANSWER. */
} update_answer_t;

/* Private but for tests. */
typedef struct {
    hal_t *hal;
    install_t install;
    uint64_t latest_us; /* Time of the latest block or command of the update under way. */
    uint32_t blocks;    /* Blocks of the image that is being taken. */
    uint32_t page;
    uint8_t got[UPDATE_PAGE_BLOCKS / 8u]; /* A bit for each block of the page. */
    bool holds;                           /* The drive must be off. */
    bool waiting;                         /* An accepted update waits for the drive, or for its erasure. */
    bool trial;                           /* This image has yet to confirm itself. */
    bool heard;                           /* A command has come since the start. */
} update_t;

/* Look at the images. *hal must live for ever. */
void update_start(update_t *update, hal_t *hal);

/* Note that a command has come, whatever it asks for. */
void update_heard(update_t *update);

/* Take a command of the indices above; named: it names this board (framing.md).
 * Returns its answer. */
update_answer_t update_command(update_t *update, uint32_t index, uint32_t argument, bool named, uint64_t now_us);

/* Take a block of the page, two words. */
void update_data(update_t *update, uint32_t index, uint32_t first, uint32_t second, uint64_t now_us);

/* Go on, with the drive on or off. Returns what is to be done; UPDATE_ANSWER: the command that began the update. */
update_answer_t update_step(update_t *update, bool drive_on, uint64_t now_us);

/* Returns whether the drive must be off. It is inline for the idle turn of the main loop. */
static inline bool update_holds(const update_t *update) {
    return update->holds;
}

#endif

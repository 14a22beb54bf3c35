#include "services/update.h"

#include <string.h>

#include "core/boot/select.h"
#include "goldfield.h"

#define WORDS_A_BLOCK 2u
#define WORD_BYTES    4u
#define STATE_BLOCKS  (IMAGE_STATE_WORDS / WORDS_A_BLOCK) /* They never come over a link. */
/* Where the parts of what UPDATE_TELL answers begin, bits. */
enum { TELL_RUNNING = 4, TELL_OTHER = 8, TELL_KEY = 12, TELL_PHASE = 16 };

_Static_assert(HAL_IMAGE_SLOTS == IMAGE_SLOTS && HAL_IMAGE_STATE_WORDS == IMAGE_STATE_WORDS, "the board's are these");
_Static_assert((int)GOLDFIELD_COMMAND_ANSWER_STATUS_NO_IMAGE_CHOICE + (int)IMAGE_UNSIGNED - (int)IMAGE_NONE ==
                   (int)GOLDFIELD_COMMAND_ANSWER_STATUS_WRONG_SIGNATURE_CHOICE,
               "what is wrong with an image is told in the same order");

static update_answer_t answer(uint32_t status, uint32_t value) {
    return (update_answer_t){UPDATE_ANSWER, status, value};
}

/* Carries out a step. Whether it has succeeded install.c sees by itself. */
static void carry_out(const update_t *update, const install_step_t *step) {
    if (step->kind == INSTALL_ERASE) {
        (void)hal_image_erase(update->hal, step->slot, step->index);
    } else {
        (void)hal_image_program(update->hal, step->slot, step->index, step->value);
    }
}

/* Carries out all steps up to the end of what is under way, or to an erasure, so that main looks around behind it. */
static void carry_on(update_t *update) {
    install_step_t step;
    do {
        step = install_next(&update->install);
        if (step.kind != INSTALL_NOTHING) {
            carry_out(update, &step);
        }
    } while (step.kind == INSTALL_PROGRAM);
}

/* Notes whether the drive must be off, and passes an answer on. */
static update_answer_t noting(update_t *update, update_answer_t answered) {
    const install_phase_t phase = install_phase(&update->install);
    update->holds = update->trial || update->waiting || (phase != INSTALL_IDLE && phase != INSTALL_CONFIRMING);
    return answered;
}

void update_start(update_t *update, hal_t *hal) {
    memset(update, 0, sizeof *update);
    update->hal = hal;
    const hal_images_t images = hal_images(hal);
    const image_flash_t flash = {
        .slot = {images.slot[0], images.slot[1]},
        .address = {images.address[0], images.address[1]},
        .words = images.words,
        .board = images.board,
        .key = images.key,
    };
    install_open(&update->install, &flash, images.running);
    update->trial = flash.words != 0u && select_state(&flash, images.running) == SELECT_TRIED;
    update->holds = update->trial;
}

void update_heard(update_t *update) {
    update->heard = true;
}

/* ---- Commands ---- */

static update_answer_t begin(update_t *update, uint32_t blocks, bool forced) {
    const image_flash_t *const flash = &update->install.flash;
    if (update->waiting) {
        return (update_answer_t){0}; /* It is answered when it is done, once though it be asked for again. */
    }
    if (flash->words == 0u) {
        return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE, 0);
    }
    if (flash->key == NULL) {
        return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_NO_KEY_CHOICE, 0);
    }
    const uint32_t words = blocks * WORDS_A_BLOCK;
    const uint32_t bytes = words > IMAGE_CODE ? (words - IMAGE_CODE) * WORD_BYTES : 0u;
    switch (install_begin(&update->install, bytes, forced)) {
    case INSTALL_OK:
        break;
    case INSTALL_UNCONFIRMED:
        return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_UNCONFIRMED_CHOICE, 0);
    default:
        return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_WRONG_LENGTH_CHOICE, 0);
    }
    update->blocks = blocks;
    update->page = 0;
    memset(update->got, 0, sizeof update->got);
    update->waiting = true;
    return (update_answer_t){0};
}

static update_answer_t take_page(update_t *update, uint32_t page) {
    if (install_phase(&update->install) != INSTALL_RECEIVING || page * UPDATE_PAGE_BLOCKS >= update->blocks) {
        return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE, 0);
    }
    if (page != update->page) {
        update->page = page;
        memset(update->got, 0, sizeof update->got);
    }
    return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_OK_CHOICE, page);
}

/* Answers the first block of the page that is missing, and in the upper half how many are. */
static update_answer_t missing(const update_t *update) {
    if (install_phase(&update->install) != INSTALL_RECEIVING) {
        return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE, 0);
    }
    const uint32_t before = update->page * UPDATE_PAGE_BLOCKS, left = update->blocks - before;
    const uint32_t end = left < UPDATE_PAGE_BLOCKS ? left : UPDATE_PAGE_BLOCKS;
    uint32_t first = 0, count = 0;
    for (uint32_t i = end; i-- > (before == 0u ? STATE_BLOCKS : 0u);) {
        if ((update->got[i / 8u] >> i % 8u & 1u) == 0u) {
            first = i;
            count++;
        }
    }
    return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_OK_CHOICE, first | count << 16);
}

static update_answer_t end(update_t *update) {
    if (install_phase(&update->install) != INSTALL_RECEIVING) {
        return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE, 0);
    }
    const image_status_t status = install_end(&update->install);
    if (status != IMAGE_OK) {
        const uint32_t behind = (uint32_t)status - (uint32_t)IMAGE_NONE;
        return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_NO_IMAGE_CHOICE + behind, 0);
    }
    carry_on(update);
    return answer(install_phase(&update->install) == INSTALL_PENDING
                      ? GOLDFIELD_COMMAND_ANSWER_STATUS_OK_RESTARTS_CHOICE
                      : GOLDFIELD_COMMAND_ANSWER_STATUS_FLASH_FAILED_CHOICE,
                  0);
}

static update_answer_t tell(const update_t *update) {
    const install_t *const install = &update->install;
    if (install->flash.words == 0u) {
        return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE, 0);
    }
    const uint32_t running = (uint32_t)select_state(&install->flash, install->running);
    const uint32_t other = (uint32_t)select_state(&install->flash, 1u - install->running);
    const uint32_t key = install->flash.key != NULL ? 1u : 0u, phase = (uint32_t)install_phase(install);
    return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_OK_CHOICE, install->running | running << TELL_RUNNING |
                                                                 other << TELL_OTHER | key << TELL_KEY |
                                                                 phase << TELL_PHASE);
}

static update_answer_t take(update_t *update, uint32_t index, uint32_t argument, bool named, uint64_t now_us) {
    if (index == UPDATE_TELL) {
        return tell(update);
    }
    update->latest_us = now_us;
    switch (index) {
    case UPDATE_PAGE:
        return take_page(update, argument);
    case UPDATE_MISSING:
        return missing(update);
    default:
        break;
    }
    if (!named) {
        return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE, 0);
    }
    return index == UPDATE_END ? end(update) : begin(update, argument, index == UPDATE_BEGIN_FORCED);
}

update_answer_t update_command(update_t *update, uint32_t index, uint32_t argument, bool named, uint64_t now_us) {
    return noting(update, take(update, index, argument, named, now_us));
}

void update_data(update_t *update, uint32_t index, uint32_t first, uint32_t second, uint64_t now_us) {
    const install_t *const install = &update->install;
    const uint32_t slot = 1u - install->running, values[WORDS_A_BLOCK] = {first, second};
    const uint32_t word = (update->page * UPDATE_PAGE_BLOCKS + index) * WORDS_A_BLOCK;
    for (uint32_t i = 0; i < WORDS_A_BLOCK; i++) {
        if (!install_takes(install, word + i)) {
            return;
        }
        const uint32_t *const there = install->flash.slot[slot] + word + i;
        if (*there != values[i]) {
            (void)hal_image_program(update->hal, slot, word + i, values[i]);
        }
        if (*there != values[i]) {
            return;
        }
    }
    update->got[index / 8u] |= (uint8_t)(1u << index % 8u);
    update->latest_us = now_us;
}

/* ---- Turns ---- */

/* A new image confirms itself, or gives up. */
static update_answer_t step_trial(update_t *update, bool drive_on, uint64_t now_us) {
    if (!drive_on && update->heard && now_us >= UPDATE_SOUND_US) {
        (void)install_confirm(&update->install);
        carry_on(update);
        update->trial = false;
    }
    return (update_answer_t){.action = now_us >= UPDATE_TRIAL_US && update->trial ? UPDATE_RESET : UPDATE_NOTHING};
}

static update_answer_t step(update_t *update, bool drive_on, uint64_t now_us) {
    if (update->trial) {
        return step_trial(update, drive_on, now_us);
    }
    if (update->waiting && !drive_on) {
        carry_on(update);
        const install_phase_t phase = install_phase(&update->install);
        update->waiting = phase == INSTALL_EMPTYING;
        update->latest_us = now_us;
        if (phase == INSTALL_RECEIVING) {
            const uint32_t address = update->install.flash.address[1u - update->install.running];
            return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_OK_CHOICE, address);
        }
        if (phase == INSTALL_FAILED) {
            return answer(GOLDFIELD_COMMAND_ANSWER_STATUS_FLASH_FAILED_CHOICE, 0);
        }
    }
    const bool under_way = !update->waiting && install_phase(&update->install) >= INSTALL_RECEIVING;
    const bool silent = under_way && now_us - update->latest_us >= UPDATE_SILENCE_US;
    return (update_answer_t){.action = silent ? UPDATE_RESET : UPDATE_NOTHING};
}

update_answer_t update_step(update_t *update, bool drive_on, uint64_t now_us) {
    return noting(update, step(update, drive_on, now_us));
}

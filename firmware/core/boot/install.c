#include "core/boot/install.h"

#include <stddef.h>

#include "core/boot/select.h"

#define CONFIRM_STEPS 2u
#define EMPTY_STEPS   3u
#define MARK_STEPS    4u
#define WORD_BYTES    4u

void install_open(install_t *install, const image_flash_t *flash, uint32_t running) {
    *install = (install_t){.flash = *flash, .running = running};
}

install_phase_t install_phase(const install_t *install) {
    return install->phase;
}

static void begin(install_t *install, install_phase_t phase) {
    install->phase = phase;
    install->cursor = 0;
    install->step = (install_step_t){0};
}

static bool is_confirmed(const install_t *install) {
    return select_state(&install->flash, install->running) == SELECT_CONFIRMED &&
           install->flash.slot[install->running][IMAGE_SETTLED] == IMAGE_MARK;
}

bool install_confirm(install_t *install) {
    const select_state_t state = select_state(&install->flash, install->running);
    if (is_confirmed(install) || (state != SELECT_TRIED && state != SELECT_CONFIRMED)) {
        return false;
    }
    begin(install, INSTALL_CONFIRMING);
    return true;
}

install_refusal_t install_begin(install_t *install, uint32_t bytes, bool forced) {
    if (!is_confirmed(install)) {
        return INSTALL_UNCONFIRMED;
    }
    if (install->flash.words <= IMAGE_CODE || bytes == 0u || bytes % WORD_BYTES != 0u ||
        bytes > (install->flash.words - IMAGE_CODE) * WORD_BYTES) {
        return INSTALL_LENGTH;
    }
    install->words = IMAGE_CODE + bytes / WORD_BYTES;
    install->forced = forced;
    begin(install, INSTALL_EMPTYING);
    return INSTALL_OK;
}

bool install_takes(const install_t *install, uint32_t index) {
    return install->phase == INSTALL_RECEIVING && index >= IMAGE_STATE_WORDS && index < install->words;
}

image_status_t install_end(install_t *install) {
    const uint32_t other = 1u - install->running;
    if (install->phase != INSTALL_RECEIVING) {
        return IMAGE_NONE;
    }
    image_demand_t demand = select_demand(&install->flash, other);
    if (install->forced) {
        demand.least_version = 0;
    }
    const image_status_t status = image_check(&install->flash, other, &demand);
    if (status == IMAGE_OK) {
        begin(install, INSTALL_MARKING);
    }
    return status;
}

/* ---- Steps ---- */

/* Whether the step that was returned last has become true. */
static bool has_taken(const install_t *install) {
    const install_step_t *const step = &install->step;
    const uint32_t *const words = install->flash.slot[step->slot];
    if (step->kind == INSTALL_PROGRAM) {
        return words[step->index] == step->value;
    }
    for (uint32_t i = 0; step->kind == INSTALL_ERASE && i < step->index; i++) {
        if (words[i] != IMAGE_ERASED) {
            return false;
        }
    }
    return true;
}

static install_step_t program(uint32_t slot, uint32_t index, uint32_t value) {
    return (install_step_t){INSTALL_PROGRAM, slot, index, value};
}

static uint32_t length(const install_t *install) {
    switch (install->phase) {
    case INSTALL_CONFIRMING:
        return CONFIRM_STEPS;
    case INSTALL_EMPTYING:
        return EMPTY_STEPS;
    case INSTALL_MARKING:
        return MARK_STEPS;
    default:
        return 0;
    }
}

/* The step of a phase that its cursor stands in front of. */
static install_step_t step_of(const install_t *install) {
    static const uint32_t good[CONFIRM_STEPS] = {IMAGE_CONFIRMED, IMAGE_SETTLED};
    static const uint32_t empty[EMPTY_STEPS - 1u] = {IMAGE_CONFIRMED, IMAGE_PENDING};
    const uint32_t cursor = install->cursor, other = 1u - install->running;
    const uint32_t sequence = install->flash.slot[install->running][IMAGE_SEQUENCE] + 1u;
    if (install->phase == INSTALL_CONFIRMING) {
        return program(install->running, good[cursor], IMAGE_MARK);
    }
    if (install->phase == INSTALL_EMPTYING) {
        return cursor < EMPTY_STEPS - 1u ? program(other, empty[cursor], IMAGE_VOID)
                                         : (install_step_t){INSTALL_ERASE, other, install->words, 0};
    }
    const install_step_t marks[MARK_STEPS] = {
        program(other, IMAGE_SEQUENCE, sequence),
        program(other, IMAGE_COMPLEMENT, ~sequence),
        program(other, IMAGE_FORCED, install->forced ? IMAGE_MARK : IMAGE_VOID),
        program(other, IMAGE_PENDING, IMAGE_MARK),
    };
    return marks[cursor];
}

static install_phase_t after(install_phase_t phase) {
    return phase == INSTALL_CONFIRMING ? INSTALL_IDLE : phase == INSTALL_EMPTYING ? INSTALL_RECEIVING : INSTALL_PENDING;
}

install_step_t install_next(install_t *install) {
    const uint32_t steps = length(install);
    if (steps == 0u) {
        return (install_step_t){0};
    }
    if (!has_taken(install)) {
        begin(install, INSTALL_FAILED);
    } else if (install->cursor == steps) {
        begin(install, after(install->phase));
    } else {
        install->step = step_of(install);
        install->cursor++;
    }
    return install->step;
}

#include "core/boot/select.h"

#include <stddef.h>

enum {
    PHASE_LOOK,   /* Look at the slot in its place. */
    PHASE_TRY,    /* Mark it as tried; then it starts. */
    PHASE_SETTLE, /* Settle that it is confirmed; then it starts. */
    PHASE_REJECT, /* Settle that it is rejected; then the next one is looked at. */
    PHASE_DONE,
};
#define WORDS_A_PHASE 2u

/* The words of a phase. */
static const struct {
    uint32_t index[WORDS_A_PHASE], value;
} work[] = {
    [PHASE_TRY] = {{IMAGE_PENDING, IMAGE_TRIED}, IMAGE_MARK},
    [PHASE_SETTLE] = {{IMAGE_CONFIRMED, IMAGE_SETTLED}, IMAGE_MARK},
    [PHASE_REJECT] = {{IMAGE_CONFIRMED, IMAGE_SETTLED}, IMAGE_VOID},
};

/* ---- Reading ---- */

/* Returns whether a slot holds a sequence number, and the number in *sequence. */
static bool read_sequence(const image_flash_t *flash, uint32_t slot, uint32_t *sequence) {
    *sequence = flash->slot[slot][IMAGE_SEQUENCE];
    return *sequence == ~flash->slot[slot][IMAGE_COMPLEMENT];
}

select_state_t select_state(const image_flash_t *flash, uint32_t slot) {
    const uint32_t *const words = flash->slot[slot];
    uint32_t sequence;
    if (!read_sequence(flash, slot, &sequence)) {
        return SELECT_NOTHING;
    }
    if (words[IMAGE_CONFIRMED] == IMAGE_VOID) {
        return SELECT_REJECTED;
    }
    if (words[IMAGE_CONFIRMED] == IMAGE_MARK || words[IMAGE_SETTLED] == IMAGE_MARK) {
        return SELECT_CONFIRMED;
    }
    if (words[IMAGE_TRIED] == IMAGE_MARK) {
        return SELECT_TRIED;
    }
    return words[IMAGE_PENDING] == IMAGE_MARK ? SELECT_PENDING : SELECT_NOTHING;
}

image_demand_t select_demand(const image_flash_t *flash, uint32_t slot) {
    const uint32_t other = 1u - slot;
    image_demand_t demand = {.role = IMAGE_ANY_ROLE, .least_version = 0};
    const image_header_t *const header = image_header(flash, other);
    if (header != NULL && select_state(flash, other) == SELECT_CONFIRMED && image_intact(flash, other)) {
        demand.role = header->role;
        demand.least_version = flash->slot[slot][IMAGE_FORCED] == IMAGE_MARK ? 0u : header->version;
    }
    return demand;
}

void select_open(select_t *select, const image_flash_t *flash) {
    *select = (select_t){.flash = *flash, .phase = PHASE_LOOK};
    uint32_t first, second;
    const bool has_first = read_sequence(flash, 0, &first), has_second = read_sequence(flash, 1, &second);
    const uint32_t newest = has_second && (!has_first || second > first) ? 1u : 0u;
    select->order[0] = newest;
    select->order[1] = 1u - newest;
}

select_choice_t select_choice(const select_t *select) {
    return select->choice;
}

/* ---- Deciding ---- */

/* Whether the image in its place is one to be started for the first time. */
static bool is_signed(const select_t *select, const image_demand_t *demand) {
    return image_check(&select->flash, select->order[select->place], demand) == IMAGE_OK;
}

static uint8_t start(select_t *select, bool trial) {
    select->choice = (select_choice_t){.found = true, .slot = select->order[select->place], .trial = trial};
    return PHASE_DONE;
}

/* No slot is left: any image that is signed is better than none. It is checked twice, as in after(). What is demanded
 * is asked again: an instruction that went wrong may have brought it here past a confirmed image, beside which an older
 * one does not start. */
static uint8_t last_resort(select_t *select) {
    for (uint32_t place = 0; place < IMAGE_SLOTS; place++) {
        const image_demand_t demand = select_demand(&select->flash, select->order[place]);
        if (image_check(&select->flash, select->order[place], &demand) == IMAGE_OK) {
            select->place = place;
            return is_signed(select, &demand) ? start(select, true) : (uint8_t)PHASE_DONE;
        }
    }
    return PHASE_DONE;
}

static uint8_t next_slot(select_t *select) {
    select->place++;
    return select->place < IMAGE_SLOTS ? PHASE_LOOK : last_resort(select);
}

/* Whether the second of a phase's words is as it should be: nothing is to be done then. */
static bool is_settled(const select_t *select, uint8_t phase) {
    const uint32_t *const words = select->flash.slot[select->order[select->place]];
    return words[work[phase].index[1]] == work[phase].value;
}

/* Whether the image in its place is confirmed: it is asked for again, and its place read again, before it starts
 * without its signature. */
static bool is_confirmed(const select_t *select) {
    return select_state(&select->flash, select->order[select->place]) == SELECT_CONFIRMED;
}

static uint8_t look(select_t *select) {
    const image_flash_t *const flash = &select->flash;
    const uint32_t slot = select->order[select->place];
    switch (select_state(flash, slot)) {
    case SELECT_PENDING: {
        const image_demand_t demand = select_demand(flash, slot);
        return image_check(flash, slot, &demand) == IMAGE_OK ? PHASE_TRY : PHASE_REJECT;
    }
    case SELECT_CONFIRMED:
        if (!image_intact(flash, slot) || !is_confirmed(select)) {
            return next_slot(select);
        }
        return is_settled(select, PHASE_SETTLE) ? start(select, false) : PHASE_SETTLE;
    case SELECT_TRIED:
        return PHASE_REJECT;
    case SELECT_REJECTED:
        return is_settled(select, PHASE_REJECT) ? next_slot(select) : PHASE_REJECT;
    default:
        return next_slot(select);
    }
}

/* Whether the image that was marked as tried is one that may be: a single instruction that goes wrong, in the check or
 * behind it, starts none that nobody has signed. */
static bool is_good_again(const select_t *select) {
    const image_demand_t demand = select_demand(&select->flash, select->order[select->place]);
    return is_settled(select, PHASE_TRY) && is_signed(select, &demand);
}

/* What follows when the words of a phase are programmed. */
static uint8_t after(select_t *select) {
    switch (select->phase) {
    case PHASE_LOOK:
        return look(select);
    case PHASE_TRY:
        return is_good_again(select) ? start(select, true) : next_slot(select);
    case PHASE_SETTLE:
        return start(select, false);
    default:
        return next_slot(select);
    }
}

/* Whether the words of its phase may be programmed: a confirmed image is not rejected, whatever brought its slot here.
 */
static bool may_mark(const select_t *select) {
    return select->phase != PHASE_LOOK && (select->phase != PHASE_REJECT || !is_confirmed(select));
}

select_step_t select_next(select_t *select) {
    while (select->phase != PHASE_DONE) { /* At most two phases without a step for each slot. */
        if (select->cursor < WORDS_A_PHASE && may_mark(select)) {
            const uint32_t slot = select->order[select->place], index = work[select->phase].index[select->cursor];
            select->cursor++;
            return (select_step_t){true, slot, index, work[select->phase].value};
        }
        select->phase = after(select);
        select->cursor = 0;
    }
    return (select_step_t){0};
}

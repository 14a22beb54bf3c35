/* select.c: slots that hold anything, any state of the choice between them; what comes of it is one of these again. */

/* select_next() takes two turns for each slot, one for what is left of the phase before, and one that finds the end. */
#define COUNTED    's'
#define MOST_TURNS 6u
#include "turns.h"

/* The source itself, so that the harness can name the phases, which are private. */
#include "core/boot/select.c"
#undef while

#include "any.h"

#define WORDS 98304u /* Words of a slot of the STM32F405. */

static uint32_t slot_a[WORDS], slot_b[WORDS]; /* What leaves one does not come into the other. */
static uint8_t key[IMAGE_KEY_BYTES];

static image_flash_t any_flash(uint32_t words) {
    fill(slot_a, sizeof slot_a);
    fill(slot_b, sizeof slot_b);
    fill(key, sizeof key);
    image_flash_t flash = {.slot = {slot_a + (WORDS - words), slot_b + (WORDS - words)}, .words = words};
    flash.address[0] = any_word();
    flash.address[1] = any_word();
    flash.board = any_word();
    flash.key = any_up_to(1) != 0u ? key : NULL;
    return flash;
}

static void image(uint32_t words) {
    const image_flash_t flash = any_flash(words);
    const image_demand_t demand = {any_word(), any_word()};
    const uint32_t slot = any_up_to(IMAGE_SLOTS - 1u);
    const image_header_t *const header = image_header(&flash, slot);
    //@ assert header == \null || \valid_read(header);
    (void)image_intact(&flash, slot);
    (void)image_check(&flash, slot, &demand);
    (void)select_state(&flash, slot);
    (void)select_demand(&flash, slot);
}

/* Any state in which a phase can be between two calls. */
static select_t any_select(uint8_t phase, uint32_t place) {
    select_t select = {.flash = any_flash(WORDS), .phase = phase};
    select.order[0] = any_up_to(IMAGE_SLOTS - 1u);
    select.order[1] = any_up_to(IMAGE_SLOTS - 1u);
    select.place = place;
    select.cursor = any_up_to(phase == PHASE_LOOK || phase == PHASE_DONE ? 0u : WORDS_A_PHASE);
    select.choice.found = any_up_to(1) != 0u;
    select.choice.slot = any_up_to(IMAGE_SLOTS - 1u);
    select.choice.trial = any_up_to(1) != 0u;
    return select;
}

/* Whether a state is one of any_select(). */
static void check(const select_t *select) {
    uint32_t last, steps;
    //@ assert select->phase <= PHASE_DONE;
    //@ split select->phase;
    last = select->phase == PHASE_DONE ? IMAGE_SLOTS : IMAGE_SLOTS - 1u;
    steps = select->phase == PHASE_LOOK || select->phase == PHASE_DONE ? 0u : WORDS_A_PHASE;
    //@ assert select->place <= last;
    //@ assert select->cursor <= steps;
    //@ assert select->order[0] < IMAGE_SLOTS && select->order[1] < IMAGE_SLOTS;
    //@ assert select->choice.slot < IMAGE_SLOTS;
}

int main(void) {
    image(IMAGE_STATE_WORDS);
    image(IMAGE_CODE);
    image(IMAGE_CODE + 1u);
    image(IMAGE_CODE + 2u);
    image(WORDS);
    select_t opened;
    const image_flash_t flash = any_flash(WORDS);
    select_open(&opened, &flash);
    check(&opened);
    for (uint8_t phase = PHASE_LOOK; phase <= PHASE_DONE; phase++) {
        for (uint32_t place = 0; place < (phase == PHASE_DONE ? IMAGE_SLOTS + 1u : IMAGE_SLOTS); place++) {
            select_t select = any_select(phase, place);
            turns = 0;
            const select_step_t step = select_next(&select);
            //@ assert !step.wanted || (step.slot < IMAGE_SLOTS && step.index < IMAGE_STATE_WORDS);
            check(&select);
            (void)select_choice(&select);
        }
    }
    return 0;
}

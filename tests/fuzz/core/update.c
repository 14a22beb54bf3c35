/* update.c: a node that runs a good image, and somebody who brings it anything over a link, with the power lost at any
 * step. What starts is always signed with the node's key, for its board and its role; the slot that runs is never
 * written, but for the words that confirm it; and a node is never without an image. */
#include "core/boot/install.h"
#include "core/boot/select.h"
#include "images.h"

#define STEPS_MOST 12u
#define NEVER      UINT32_MAX

typedef struct {
    cells_t cells;
    const images_t *images;
    install_t install;
    uint32_t running;
    bool trial;
} node_t;

/* Starts. Returns false if the power is lost at the step cut. */
static bool boot(node_t *node, uint32_t cut, uint32_t how) {
    cells_start(&node->cells);
    const image_flash_t flash = images_flash(node->images, &node->cells);
    select_t select;
    select_open(&select, &flash);
    select_step_t step;
    for (uint32_t steps = 0; (step = select_next(&select)).wanted; steps++) {
        REQUIRE(steps < STEPS_MOST);
        if (steps == cut) {
            cells_tear(&node->cells, how, step.slot, step.index, step.value);
            return false;
        }
        cells_program(&node->cells, step.slot, step.index, step.value);
    }
    const select_choice_t choice = select_choice(&select);
    REQUIRE(choice.found);
    const uint32_t image = images_in(node->images, &node->cells, choice.slot);
    REQUIRE(image == GOOD_OLD || image == GOOD_NEW || image == OLDER);
    node->running = choice.slot;
    node->trial = choice.trial;
    install_open(&node->install, &flash, choice.slot);
    return true;
}

/* Carries out the steps of an update. Returns false if the power is lost. */
static bool work(node_t *node, uint32_t cut, uint32_t how) {
    install_step_t step;
    for (uint32_t steps = 0; (step = install_next(&node->install)).kind != INSTALL_NOTHING; steps++) {
        REQUIRE(steps < STEPS_MOST && step.slot < CELLS_SLOTS);
        const bool confirms = step.index == IMAGE_CONFIRMED || step.index == IMAGE_SETTLED;
        REQUIRE(step.slot != node->running || (step.kind == INSTALL_PROGRAM && confirms && step.value == IMAGE_MARK));
        if (step.kind == INSTALL_ERASE) {
            if (steps == cut) {
                cells_tear_erasure(&node->cells, how, step.slot);
                return false;
            }
            cells_erase(&node->cells, step.slot);
        } else if (steps == cut) {
            cells_tear(&node->cells, how, step.slot, step.index, step.value);
            return false;
        } else {
            cells_program(&node->cells, step.slot, step.index, step.value);
        }
    }
    return true;
}

static void receive(node_t *node, uint32_t index, uint32_t value) {
    if (install_takes(&node->install, index)) {
        REQUIRE(index >= IMAGE_STATE_WORDS && index < SLOT_WORDS);
        cells_program(&node->cells, 1u - node->running, index, value);
    }
}

/* Does one thing that whoever has the link may do. Returns false if the power is lost. */
static bool turn(node_t *node, input_t *input) {
    const uint32_t what = take_u8(input), argument = take_u8(input);
    const uint32_t cut = what >= 128u ? what % STEPS_MOST : NEVER;
    switch (what % 8u) {
    case 0:
        return install_confirm(&node->install) ? work(node, cut, argument % 3u) : true;
    case 1:
        if (install_begin(&node->install, argument < 64u ? argument : 4u * images_code_words(argument % IMAGES),
                          what % 16u >= 8u) == INSTALL_OK) {
            return work(node, cut, argument % 3u);
        }
        return true;
    case 2:
    case 3:
        for (uint32_t i = 0; i < SLOT_WORDS; i++) {
            receive(node, i, node->images->words[argument % IMAGES][(1u - node->running) ^ (argument >> 7)][i]);
        }
        return true;
    case 4:
        receive(node, argument, take_u32(input));
        return true;
    case 5:
    case 6:
        return install_end(&node->install) == IMAGE_OK ? work(node, cut, argument % 3u) : true;
    default:
        return boot(node, cut, argument % 3u);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size) {
    static node_t node;
    input_t input = {bytes, size};
    memset(&node, 0, sizeof node);
    node.images = images_get();
    cells_init(&node.cells, SLOT_WORDS, take_u8(&input));
    memcpy(node.cells.read[0], node.images->words[GOOD_OLD][0], 4u * SLOT_WORDS);
    const uint32_t flashed[7] = {7, ~7u, UINT32_MAX, IMAGE_MARK, IMAGE_MARK, IMAGE_MARK, IMAGE_MARK};
    memcpy(node.cells.read[0], flashed, sizeof flashed);
    bool on = boot(&node, NEVER, 0);
    while (input.left > 0u) {
        on = on ? turn(&node, &input) : boot(&node, NEVER, 0);
    }
    (void)boot(&node, NEVER, 0);
    return 0;
}

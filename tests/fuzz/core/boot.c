/* boot.c: two slots of flash that hold anything. No image is started for the first time whose signature does not
 * verify; one that is started as confirmed was marked so, and no bit of it has changed; a node that holds a signed
 * image for its board starts one, whatever the state words say; and after a few starts the marks come to rest. */
#include "core/boot/select.h"

#include "images.h"

#define STEPS_MOST 6u
#define BOOTS      5u

static void fill(cells_t *cells, input_t *input, const images_t *images, uint32_t slot) {
    static const uint32_t values[] = {UINT32_MAX, IMAGE_MARK, IMAGE_VOID, 1, 2, ~1u, ~2u};
    uint32_t *const words = cells->read[slot];
    const uint32_t image = take_u8(input);
    if (image < IMAGES) {
        memcpy(words, images->words[image][slot], sizeof images->words[image][slot]);
    } else {
        for (uint32_t i = IMAGE_STATE_WORDS; i < SLOT_WORDS; i++) {
            words[i] = image < 64u ? images->words[image % IMAGES][1u - slot][i] : chance(&cells->state);
        }
    }
    for (uint32_t i = 0; i < IMAGE_SETTLED + 1u; i++) {
        const uint32_t value = take_u8(input);
        words[i] = value < 7u ? values[value] : UINT32_MAX;
    }
    const uint32_t changes = take_u8(input) % 8u, repairs = take_u8(input);
    for (uint32_t i = 0; i < changes; i++) {
        const uint32_t place = take_u8(input) % SLOT_WORDS;
        words[place] ^= take_u32(input);
    }
    const uint32_t bytes = words[IMAGE_HEADER + 1u];
    if (repairs % 2u == 1u && bytes % 4u == 0u && bytes <= 4u * (SLOT_WORDS - IMAGE_CODE)) {
        words[IMAGE_CRC] = crc32(0, words + IMAGE_HEADER, 64u + bytes);
    }
}

/* Starts once, with the power lost at a step if there is one so far. */
static void boot(cells_t *cells, const images_t *images, uint32_t cut, uint32_t how) {
    cells_start(cells);
    const image_flash_t flash = images_flash(images, cells);
    const select_state_t before[CELLS_SLOTS] = {select_state(&flash, 0), select_state(&flash, 1)};
    select_t select;
    select_open(&select, &flash);
    uint32_t steps = 0;
    for (;; steps++) {
        const select_step_t step = select_next(&select);
        if (!step.wanted) {
            break;
        }
        REQUIRE(step.slot < CELLS_SLOTS && step.index <= IMAGE_SETTLED && steps < STEPS_MOST);
        if (steps == cut) {
            cells_tear(cells, how, step.slot, step.index, step.value);
            return;
        }
        cells_program(cells, step.slot, step.index, step.value);
    }
    const select_choice_t choice = select_choice(&select);
    bool any = false;
    for (uint32_t slot = 0; slot < CELLS_SLOTS; slot++) {
        const uint32_t image = images_in(images, cells, slot);
        any = any || (image < STRANGERS && image != OTHER_BOARD);
    }
    REQUIRE(choice.found || !any);
    if (choice.found) {
        const uint32_t image = images_in(images, cells, choice.slot);
        const uint32_t *const words = cells->read[choice.slot];
        const bool is_signed = image < STRANGERS && image != OTHER_BOARD;
        const bool intact = crc32(0, words + IMAGE_HEADER, 64u + words[IMAGE_HEADER + 1u]) == words[IMAGE_CRC];
        REQUIRE(is_signed || (!choice.trial && before[choice.slot] == SELECT_CONFIRMED && intact));
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size) {
    static cells_t cells;
    const images_t *const images = images_get();
    input_t input = {bytes, size};
    cells_init(&cells, SLOT_WORDS, take_u8(&input));
    fill(&cells, &input, images, 0);
    fill(&cells, &input, images, 1);
    for (uint32_t i = 0; i < BOOTS; i++) {
        const uint32_t how = take_u8(&input);
        boot(&cells, images, how < 3u ? take_u8(&input) % STEPS_MOST : STEPS_MOST, how);
    }
    boot(&cells, images, STEPS_MOST, 0);
    boot(&cells, images, STEPS_MOST, 0);
    memset(cells.weak, 0, sizeof cells.weak);
    const cells_t before = cells; /* Words that do not take their mark are programmed again in vain. */
    boot(&cells, images, STEPS_MOST, 0);
    REQUIRE(memcmp(before.read, cells.read, sizeof cells.read) == 0);
    return 0;
}

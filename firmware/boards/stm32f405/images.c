/* images.c: the flash of the images, of which this program is one (hal.h, "Flash for images").
 *
 * The memory protection lets the other slot and the state words of this image's own be programmed, and nothing of it be
 * executed (guards.c).
 */

#include "boards/stm32f405/stm32f405.h"

extern const uint32_t image_start[]; /* The linker tells where this image's slot begins. */

static volatile uint32_t *const slots[HAL_IMAGE_SLOTS] = {(volatile uint32_t *)IMAGE_SLOT_A,
                                                          (volatile uint32_t *)IMAGE_SLOT_B};

static uint32_t running_slot(void) {
    return (uint32_t)image_start == IMAGE_SLOT_B ? 1u : 0u;
}

/* Whether the processor's supply is enough for words of 32 bits. */
static bool supply_is_good(void) {
    return (PWR->CSR & PWR_CSR_PVDO) == 0;
}

hal_images_t hal_images(const hal_t *hal) {
    (void)hal;
    const key_place_t *const place = (const key_place_t *)KEY_PLACE;
    return (hal_images_t){
        .slot = {(const uint32_t *)IMAGE_SLOT_A, (const uint32_t *)IMAGE_SLOT_B},
        .address = {IMAGE_SLOT_A, IMAGE_SLOT_B},
        .words = IMAGE_BYTES / sizeof(uint32_t),
        .running = running_slot(),
        .board = BOARD_KIND,
        .key = place->mark == KEY_MARK ? place->key : NULL,
    };
}

bool hal_image_program(hal_t *hal, uint32_t slot, uint32_t index, uint32_t value) {
    (void)hal;
    const uint32_t words = slot == running_slot() ? HAL_IMAGE_STATE_WORDS : IMAGE_BYTES / sizeof(uint32_t);
    if (slot >= HAL_IMAGE_SLOTS || index >= words || !supply_is_good())
        return false;
    return flash_program(slots[slot] + index, value);
}

bool hal_image_erase(hal_t *hal, uint32_t slot, uint32_t words) {
    (void)hal;
    const uint32_t bytes = words * sizeof(uint32_t);
    if (slot >= HAL_IMAGE_SLOTS || slot == running_slot() || words > IMAGE_BYTES / sizeof(uint32_t))
        return false;
    bool done = supply_is_good();
    can_deaf(true);
    for (uint32_t i = 0; done && i * SECTOR_BYTES < bytes; i++) {
        watchdog_set_slow(WATCHDOG_RELOAD_LONG);
        done = flash_erase(SLOT_A_SECTOR + slot * SLOT_SECTORS + i);
    }
    can_deaf(false);
    watchdog_set(WATCHDOG_RELOAD);
    return done;
}

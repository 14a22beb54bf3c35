/* flash.c: the two slots for what is saved, sectors 1 and 2 of the flash (RM0090, chapter 3; data sheet, 5.3.12).
 *
 * The program lies in the same flash, and whoever fetches from it while it is busy stands still until it is not
 * (RM0090, 3.5.1 and 3.6): that is main at its next fetch, and each interrupt at its vector. Nothing lies in RAM to go
 * on meanwhile: what it could do is nothing that cannot wait, and code in RAM would be what guards.c forbids. So the
 * watchdog, whose 500 ms may be 340 ms, is not fed during an erasure but given 2 s before it, which are 1.4 s at least.
 * It goes on counting, and ends an erasure that never comes to its end.
 */

#include "boards/stm32f405/stm32f405.h"

#define SLOT_0       ((volatile uint32_t *)0x08004000u) /* Sector 1; sector 2 follows. */
#define FIRST_SECTOR 1u

/* Whether the processor's supply is enough for words of 32 bits. */
static bool supply_is_good(void) {
    return (PWR->CSR & PWR_CSR_PVDO) == 0;
}

const uint32_t *hal_flash_slot(const hal_t *hal, uint32_t slot) {
    (void)hal;
    return (const uint32_t *)SLOT_0 + slot * HAL_FLASH_WORDS;
}

bool hal_flash_program(hal_t *hal, uint32_t slot, uint32_t index, uint32_t value) {
    (void)hal;
    if (slot >= HAL_FLASH_SLOTS || index >= HAL_FLASH_WORDS || !supply_is_good())
        return false;
    return flash_program(SLOT_0 + slot * HAL_FLASH_WORDS + index, value);
}

bool hal_flash_erase(hal_t *hal, uint32_t slot) {
    (void)hal;
    if (slot >= HAL_FLASH_SLOTS || !supply_is_good())
        return false;
    watchdog_set(WATCHDOG_RELOAD_LONG);
    can_deaf(true);
    const bool done = flash_erase(FIRST_SECTOR + slot);
    can_deaf(false);
    watchdog_set(WATCHDOG_RELOAD);
    return done;
}

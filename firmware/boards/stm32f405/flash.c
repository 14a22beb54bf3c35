/* flash.c: the two slots for what is saved, sectors 1 and 2 of the flash (RM0090, chapter 3; data sheet, 5.3.12).
 *
 *   word      16 us, at most 100 us    32 bits at once, which needs 2.7 V: no voltage detector may complain
 *   sector    250 ms, at most 500 ms
 *
 * The program lies in the same flash, and whoever fetches from it while it is busy stands still until it is not
 * (RM0090, 3.5.1 and 3.6): that is main at its next fetch, and each interrupt at its vector. Nothing lies in RAM to go
 * on meanwhile: what it could do is nothing that cannot wait, and code in RAM would be what guards.c forbids. So the
 * watchdog, whose 500 ms may be 340 ms, is not fed during an erasure but given 2 s before it, which are 1.4 s at least.
 * It goes on counting, and ends an erasure that never comes to its end.
 *
 * The flash is unlocked for one word or one erasure. The caches may hold what an erasure has made untrue, and a word as
 * it was to be rather than as it is (RM0090, 3.5.2): they are emptied, which is allowed only while they are off.
 */

#include "boards/stm32f405/stm32f405.h"

#define SLOT_0 ((volatile uint32_t *)0x08004000u) /* Sector 1; sector 2 follows. */
#define KEY_1  0x45670123u
#define KEY_2  0xCDEF89ABu
#define ERRORS (FLASH_SR_WRPERR | FLASH_SR_PGAERR | FLASH_SR_PGPERR | FLASH_SR_PGSERR)
/* Tries of waiting for a word, 1 ms, and for an erasure, 0.9 s, at 168 MHz, should the processor not stand still. */
#define WORD_TRIES  28000u
#define ERASE_TRIES 25000000u

/* Returns whether the flash is unlocked, idle, and without an error of an operation before. */
static bool unlock(void) {
    if ((PWR->CSR & PWR_CSR_PVDO) != 0 || !wait_for(&FLASH->SR, FLASH_SR_BSY, 0, WORD_TRIES))
        return false;
    if ((FLASH->CR & FLASH_CR_LOCK) != 0) {
        FLASH->KEYR = KEY_1;
        FLASH->KEYR = KEY_2;
    }
    FLASH->SR = ERRORS; /* A one clears. */
    return (FLASH->CR & FLASH_CR_LOCK) == 0;
}

/* Empties both caches, and switches them on again as they were. */
static void empty_caches(void) {
    const uint32_t settings = FLASH->ACR, off = settings & ~(FLASH_ACR_ICEN | FLASH_ACR_DCEN);
    FLASH->ACR = off;
    FLASH->ACR = off | FLASH_ACR_ICRST | FLASH_ACR_DCRST;
    FLASH->ACR = off;
    FLASH->ACR = settings;
}

/* Waits for the end of an operation, and locks the flash. Returns whether it went well. */
static bool finish(uint32_t tries) {
    memory_barrier();
    const bool ended = wait_for(&FLASH->SR, FLASH_SR_BSY, 0, tries);
    const uint32_t errors = FLASH->SR & ERRORS;
    FLASH->SR = errors;
    FLASH->CR = FLASH_CR_LOCK;
    empty_caches();
    return ended && errors == 0;
}

const uint32_t *hal_flash_slot(const hal_t *hal, uint32_t slot) {
    (void)hal;
    return (const uint32_t *)SLOT_0 + slot * HAL_FLASH_WORDS;
}

bool hal_flash_program(hal_t *hal, uint32_t slot, uint32_t index, uint32_t value) {
    (void)hal;
    if (slot >= HAL_FLASH_SLOTS || index >= HAL_FLASH_WORDS || !unlock())
        return false;
    FLASH->CR = FLASH_CR_PSIZE_32 | FLASH_CR_PG;
    SLOT_0[slot * HAL_FLASH_WORDS + index] = value;
    return finish(WORD_TRIES);
}

bool hal_flash_erase(hal_t *hal, uint32_t slot) {
    (void)hal;
    if (slot >= HAL_FLASH_SLOTS || !unlock())
        return false;
    watchdog_set(WATCHDOG_RELOAD_LONG);
    FLASH->CR = FLASH_CR_PSIZE_32 | FLASH_CR_SER | FLASH_CR_SNB_1 * (1u + slot);
    FLASH->CR |= FLASH_CR_STRT;
    const bool done = finish(ERASE_TRIES);
    watchdog_set(WATCHDOG_RELOAD);
    return done;
}

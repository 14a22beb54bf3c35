/* flash_operation.c: a word or a sector of the flash (RM0090, chapter 3; data sheet, 5.3.12). The boot loader has it,
 * too.
 *
 *   word      16 us, at most 100 us    32 bits at once, which needs 2.7 V
 *   sector    of 16 kB 250 ms, at most 500 ms; of 128 kB 1 s, at most 2 s
 *
 * The flash is unlocked for one word or one erasure. The caches may hold what an erasure has made untrue, and a word as
 * it was to be rather than as it is (RM0090, 3.5.2): they are emptied, which is allowed only while they are off.
 */

#include "boards/stm32f405/stm32f405.h"

#define KEY_1  0x45670123u
#define KEY_2  0xCDEF89ABu
#define ERRORS (FLASH_SR_WRPERR | FLASH_SR_PGAERR | FLASH_SR_PGPERR | FLASH_SR_PGSERR)
/* Tries of waiting for a word, 1 ms, and for an erasure, 3 s, at 168 MHz, should the processor not stand still. */
#define WORD_TRIES  28000u
#define ERASE_TRIES 84000000u

/* Returns whether the flash is unlocked, idle, and without an error of an operation before. */
static bool unlock(void) {
    if (!wait_for(&FLASH->SR, FLASH_SR_BSY, 0, WORD_TRIES))
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

bool flash_program(volatile uint32_t *place, uint32_t value) {
    if (!unlock())
        return false;
    FLASH->CR = FLASH_CR_PSIZE_32 | FLASH_CR_PG;
    *place = value;
    return finish(WORD_TRIES);
}

bool flash_erase(uint32_t sector) {
    if (!unlock())
        return false;
    FLASH->CR = FLASH_CR_PSIZE_32 | FLASH_CR_SER | FLASH_CR_SNB_1 * sector;
    FLASH->CR |= FLASH_CR_STRT;
    return finish(ERASE_TRIES);
}

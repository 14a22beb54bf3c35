/* random.c: the generator of true random numbers (RM0090, chapter 24). It runs on the 48 MHz that the PLL makes beside
 * the core's clock (clock.c), so it has no number on a board whose PLL does not lock.
 *
 * As the manual asks, the first number behind the start is only compared with the next one, and each with the one
 * before it: two that are equal fail. A clock error (CEIS) voids nothing that was generated before it; it is cleared,
 * and the numbers come when the clock is right again (CECS is 0). Behind a seed error (SEIS) no number is used, and the
 * generator is started anew. All waits have a bound: no number is told rather than a bad one.
 *
 * It is asked a few times a day, and is off meanwhile.
 */

#include "boards/stm32f405/stm32f405.h"

#define STARTS 3u
/* Tries of waiting for a number, 70 us at 168 MHz; it takes 40 periods of the generator's clock, 0.8 us. */
#define NUMBER_TRIES 2000u
#define COMPARED     3u /* Numbers behind a start: the first is compared only, two are told. */

/* Waits for the next number. Returns false if there is none, or one that must not be used. */
static bool next_number(uint32_t *number) {
    for (uint32_t i = 0; i < NUMBER_TRIES; i++) {
        const uint32_t status = RNG->SR;
        if ((status & (RNG_SR_SEIS | RNG_SR_SECS)) != 0)
            return false;
        if ((status & RNG_SR_CEIS) != 0)
            RNG->SR = RNG_SR_SEIS; /* A zero clears, a one leaves as it is: CEIS alone is cleared. */
        if ((status & RNG_SR_DRDY) != 0) {
            *number = RNG->DR;
            return (RNG->SR & (RNG_SR_SEIS | RNG_SR_SECS)) == 0;
        }
    }
    return false;
}

/* Starts the generator anew, and takes two numbers. */
static bool two_numbers(uint64_t *both) {
    uint32_t numbers[COMPARED];
    RNG->CR = 0;
    RNG->SR = 0;
    RNG->CR = RNG_CR_RNGEN;
    for (uint32_t i = 0; i < COMPARED; i++) {
        if (!next_number(&numbers[i]) || (i > 0 && numbers[i] == numbers[i - 1]))
            return false;
    }
    *both = (uint64_t)numbers[1] << 32 | numbers[2];
    return true;
}

bool hal_random(hal_t *hal, uint64_t *number) {
    (void)hal;
    RCC->AHB2ENR |= RCC_AHB2ENR_RNGEN;
    (void)RCC->AHB2ENR; /* A peripheral answers two cycles after its clock is on (ES0182). */
    bool taken = false;
    for (uint32_t i = 0; i < STARTS && !taken; i++)
        taken = two_numbers(number);
    RNG->CR = 0;
    RCC->AHB2ENR &= ~RCC_AHB2ENR_RNGEN;
    return taken;
}

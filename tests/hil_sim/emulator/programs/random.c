/* Draws random numbers as RM0090 24.3.1 tells: with the interrupt, after a look at RNG_SR, the first not to be used.
 * At 0x2001F800 it notes how it was reset and what the interrupt's pending bit was at the start, how often RNG_SR
 * showed a seed error, how many numbers came, and the numbers from the second on. After 10 ms it resets itself once,
 * with a number waiting that nobody took. */
#include "runtime.h"

#define NOTES       ((volatile uint32_t *)0x2001F800u)
#define RCC_CR      REGISTER(0x40023800u)
#define RCC_PLLCFGR REGISTER(0x40023804u)
#define RCC_AHB2ENR REGISTER(0x40023834u)
#define RCC_CSR     REGISTER(0x40023874u)
#define VTOR        REGISTER(0xE000ED08u)
#define ISER2       REGISTER(0xE000E108u)
#define ICER2       REGISTER(0xE000E188u)
#define ISPR2       REGISTER(0xE000E208u)
#define RNG_CR      REGISTER(0x50060800u)
#define RNG_SR      REGISTER(0x50060804u)
#define RNG_DR      REGISTER(0x50060808u)
#define POSITION    80u
#define NUMBERS     16u

static void *table[16 + POSITION + 1] __attribute__((aligned(512)));
extern void *const vectors[20];
static volatile uint32_t ticks;

void systick_handler(void) {
    ticks++;
}

static void random_handler(void) {
    const uint32_t status = RNG_SR;
    if ((status & 0x40u) != 0) {
        NOTES[2]++;
        RNG_SR = 0x3Fu;
        RNG_CR = 0x8u;
        RNG_CR = 0xCu;
        NOTES[3] = 0;
    } else if ((status & 1u) != 0) {
        const uint32_t number = RNG_DR;
        if (NOTES[3] > 0) {
            NOTES[3 + NOTES[3]] = number;
        }
        if (NOTES[3]++ == NUMBERS) {
            ICER2 = 1u << (POSITION - 64u);
        }
    }
}

int main(void) {
    NOTES[0] = RCC_CSR & 0xFE000000u;
    NOTES[1] = ISPR2;
    NOTES[2] = NOTES[3] = 0;
    RCC_CSR = 1u << 24;
    for (unsigned i = 0; i < 16; i++) {
        table[i] = vectors[i];
    }
    table[16 + POSITION] = (void *)random_handler;
    VTOR = (uint32_t)table;
    RCC_PLLCFGR = 0x20000000u | 7u << 24 | 336u << 6 | 16u; /* 16 MHz / 16 * 336 / 7: 48 MHz. */
    RCC_CR |= 1u << 24;
    while ((RCC_CR & 1u << 25) == 0) {
    }
    RCC_AHB2ENR |= 1u << 6;
    (void)RCC_AHB2ENR;
    ISER2 = 1u << (POSITION - 64u);
    RNG_CR = 0xCu;
    SYSTICK_RELOAD = 15999;
    SYSTICK_COUNT = 0;
    SYSTICK_CONTROL = 7;
    while (ticks < 10) {
        __asm volatile("wfi");
    }
    if ((NOTES[0] & 1u << 27) != 0) {
        AIRCR = 0x05FA0004u;
    }
    for (;;) {
        __asm volatile("wfi");
    }
}

/* Starts both watchdogs and feeds them each millisecond or so. The page says what DBGMCU_APB1_FZ gets. At 0x2001F800 it
 * notes how it was reset, how many turns it made since, and what DBGMCU_APB1_FZ was. */
#include "runtime.h"

#define NOTES    ((volatile uint32_t *)0x2001F800u)
#define PAGE     REGISTER(0x080E0000u)
#define APB1_FZ  REGISTER(0xE0042008u)
#define RCC_CSR  REGISTER(0x40023874u)
#define APB1ENR  REGISTER(0x40023840u)
#define IWDG_KEY REGISTER(0x40003000u)
#define WWDG_CR  REGISTER(0x40002C00u)
#define WWDG_CFR REGISTER(0x40002C04u)

int main(void) {
    NOTES[0] = RCC_CSR & 0xFE000000u;
    NOTES[1] = 0;
    NOTES[2] = APB1_FZ;
    RCC_CSR = 1u << 24;
    APB1_FZ = PAGE;
    APB1ENR |= 1u << 11;
    (void)APB1ENR;
    IWDG_KEY = 0xCCCCu; /* 512 ms at 32 kHz. */
    WWDG_CFR = 0x1FFu;  /* At 16 MHz, divided by 4096 and 8: 131 ms for 64 counts. */
    WWDG_CR = 0xFFu;
    for (;;) {
        for (volatile uint32_t i = 0; i < 2000; i++) {
        }
        WWDG_CR = 0x7Fu;
        IWDG_KEY = 0xAAAAu;
        NOTES[1]++;
    }
}

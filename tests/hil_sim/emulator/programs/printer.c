/* Prints on USART1 at reset clock by polling (RM0090, 30.6), without any code of the firmware. */
#include "runtime.h"

int main(void) {
    REGISTER(0x40023830u) |= 1u << 1; /* RCC_AHB1ENR: GPIOB */
    REGISTER(0x40023844u) |= 1u << 4; /* RCC_APB2ENR: USART1 */
    (void)REGISTER(0x40023844u);
    REGISTER(0x40020420u) = (REGISTER(0x40020420u) & ~(0xFu << 24)) | 7u << 24; /* GPIOB_AFRL: PB6 is AF7 */
    REGISTER(0x40020400u) = (REGISTER(0x40020400u) & ~(3u << 12)) | 2u << 12;   /* GPIOB_MODER: alternate */
    REGISTER(0x40011008u) = 139;                                                /* BRR: 115,200 */
    REGISTER(0x4001100Cu) = 1u << 13 | 1u << 3;                                 /* CR1: UE, TE */
    for (const char *text = "hello"; *text != '\0'; text++) {
        while ((REGISTER(0x40011000u) & 1u << 7) == 0) {
        }
        REGISTER(0x40011004u) = (uint8_t)*text;
    }
    while ((REGISTER(0x40011000u) & 1u << 6) == 0) {
    }
#ifdef CRASH
    __asm volatile("udf #0");
#endif
    return 0;
}

/* interrupts.c: what every file with an interrupt handler needs, below all of them. */

#include "boards/stm32f405/stm32f405.h"

hal_t board;

void interrupt_enable(unsigned irq, unsigned priority) {
    NVIC->IPR[irq] = (uint8_t)(priority << 4);
    NVIC->ISER[irq / 32] = 1u << (irq % 32);
}

/* alarms.c: the two things that may fail below the processor while it runs, and what is done at once.
 *
 *   crystal   The clock security system notices within a few microseconds that the crystal stopped; the hardware then
 *             goes on at 16 MHz from the internal oscillator, with the PLL off, and raises the non-maskable interrupt.
 *             The bridges go off, and the PLL is started anew from the internal oscillator: from then on the board is
 *             one whose crystal never started (HAL_CLOCK_INTERNAL). The chips of that third of a millisecond are too
 *             long. If the PLL does not lock either, the board restarts.
 *   supply    The voltage detector notices that the supply falls to 2.75 to 2.92 V (data sheet DS8626, table 19, PLS
 * 5), a little more than the 2.7 V that the processor needs at 168 MHz. The bridges go off, and the dip is counted. The
 * brown-out reset (level 3 of the option bytes, set by make flash) strikes at 2.75 to 2.88 V, on some chips first;
 * without it this alarm is all there is.
 *
 * Both may come in the middle of any handler, as the currents' takes too long to wait for. They touch the bridges and
 * the clocks only; bridge_trip() leaves what the application is to hear to a handler of the drive's priority.
 */

#include "boards/stm32f405/stm32f405.h"

#define EXTI_PVD (1u << 16) /* The line of the voltage detector. */

void alarms_start(const hal_t *hal) {
    RCC->APB1ENR |= RCC_APB1ENR_PWREN;
    EXTI->RTSR |= EXTI_PVD; /* The detector's output rises when the supply falls. */
    EXTI->IMR |= EXTI_PVD;
    interrupt_enable(IRQ_PVD, PRIORITY_OFF);
    /* A peripheral answers a few cycles after its clock is on (ES0182): reading it back and the lines above take
     * longer. */
    (void)RCC->APB1ENR;
    PWR->CR |= PWR_CR_PLS_2V7 | PWR_CR_PVDE;
    if (hal->clock == HAL_CLOCK_CRYSTAL)
        RCC->CR |= RCC_CR_CSSON;
}

void NMI_Handler(void) {
    bridge_trip(HAL_FAULT_CLOCK);
    if ((RCC->CIR & RCC_CIR_CSSF) == 0)
        return;              /* It has no other source on this chip. */
    RCC->CIR = RCC_CIR_CSSC; /* No other interrupt of the clocks is enabled there. */
    if (!clock_fall_back(&board))
        hal_reset(&board);
}

void PVD_Handler(void) {
    if ((EXTI->PR & EXTI_PVD) != 0) {
        EXTI->PR = EXTI_PVD;
        board.counters.supply_dips++;
        bridge_trip(HAL_FAULT_SUPPLY);
    }
}

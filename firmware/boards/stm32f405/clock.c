/* clock.c: the clock tree and everything that is time.
 *
 *   PLL in    2 MHz: crystal 12 MHz / 6 (pyboard v1.1), or internal oscillator 16 MHz / 8
 *   PLL       336 MHz, x 168
 *   48 MHz    / 7: the generator of random numbers (random.c)
 *   core      168 MHz, / 2: core, AHB, chip timer TIM1 (APB2 timers run at twice APB2)
 *   APB2      84 MHz: converters at 84 / 4 = 21 MHz
 *   APB1      42 MHz: CAN, DAC, USART3; TIM2 at 84 MHz
 * If the PLL does not lock either, everything runs at the 16 MHz the chip starts with, undivided. A crystal that dies
 * later is noticed by the clock security system (alarms.c). Voltage scale 1, needed at 168 MHz, is this chip's reset
 * value.
 *
 * The flash is read ahead but on the first silicon, revision A, where reading ahead fails (ES0182). That
 * revision tells the device id of another family (ES0182), so only a known id counts as a later one.
 */

#include "boards/stm32f405/stm32f405.h"

/* Tries of waiting for the crystal, 20 ms at 16 MHz; a crystal takes 2 ms (data sheet, table 37). */
#define CRYSTAL_TRIES 50000u
#define SWITCH_TRIES  10000u /* Tries of waiting for a switch, 4 ms; the PLL takes 0.3 ms. */
/* What DBGMCU_IDCODE tells (RM0090, 38.6.1). */
#define DEVICE_MASK      0xFFFu
#define DEVICE_F405      0x413u
#define REVISION_A       0x1000u
#define TICKS_PER_SECOND 100u /* Wake-ups of hal_wait() a second before the chip engine runs. */

/* Returns the flash's settings for 168 MHz. */
static uint32_t flash_settings(void) {
    const uint32_t id = DBG->DBGMCU_IDCODE;
    const bool reads_ahead = (id & DEVICE_MASK) == DEVICE_F405 && id >> 16 != REVISION_A;
    return FLASH_ACR_LATENCY_5 | FLASH_ACR_ICEN | FLASH_ACR_DCEN | (reads_ahead ? FLASH_ACR_PRFTEN : 0u);
}

/* Starts the PLL from the crystal or from the internal oscillator, and switches to it. Returns whether it locked. */
static bool run_on_pll(bool crystal) {
    const uint32_t divide = crystal ? 6u : 8u, multiply = 168u, usb = 7u;
    const uint32_t reserved = RCC->PLLCFGR & 0xF0000000u; /* They must keep their reset value. */
    RCC->PLLCFGR = reserved | divide | multiply << 6 | usb << 24 | (crystal ? RCC_PLLCFGR_PLLSRC : 0u);
    RCC->CR |= RCC_CR_PLLON;
    if (!wait_for(&RCC->CR, RCC_CR_PLLRDY, RCC_CR_PLLRDY, SWITCH_TRIES)) {
        RCC->CR &= ~RCC_CR_PLLON;
        return false;
    }

    FLASH->ACR = flash_settings();
    if (!wait_for(&FLASH->ACR, 7u, FLASH_ACR_LATENCY_5, SWITCH_TRIES))
        return false;
    RCC->CFGR |= RCC_CFGR_PPRE1_DIV4 | RCC_CFGR_PPRE2_DIV2; /* This comes before the switch: no bus may run too fast. */
    RCC->CFGR |= RCC_CFGR_SW1;
    if (!wait_for(&RCC->CFGR, RCC_CFGR_SWS0 | RCC_CFGR_SWS1, RCC_CFGR_SWS1, SWITCH_TRIES)) {
        RCC->CFGR &= ~(RCC_CFGR_SW1 | RCC_CFGR_PPRE1_DIV4 | RCC_CFGR_PPRE2_DIV2);
        return false;
    }
    return true;
}

hal_clock_t clock_start(void) {
    RCC->CR |= RCC_CR_HSEON;
    const bool crystal = wait_for(&RCC->CR, RCC_CR_HSERDY, RCC_CR_HSERDY, CRYSTAL_TRIES);
    if (!crystal)
        RCC->CR &= ~RCC_CR_HSEON;
    if (!run_on_pll(crystal))
        return HAL_CLOCK_SLOW;
    return crystal ? HAL_CLOCK_CRYSTAL : HAL_CLOCK_INTERNAL;
}

/* The hardware has switched the crystal and its PLL off (RM0090, 7.2.7). */
bool clock_fall_back(hal_t *hal) {
    hal->clock = HAL_CLOCK_INTERNAL;
    return run_on_pll(false);
}

void clock_start_tick(hal_clock_t clock) {
    const bool slow = clock == HAL_CLOCK_SLOW;
    TIM2->PSC = (slow ? SLOW_HZ : HAL_TICKS_PER_SECOND / 2u) / 1000000u - 1u;
    TIM2->ARR = 0xFFFFFFFFu;
    TIM2->EGR = TIM_EGR_UG; /* The update loads the prescaler. */
    TIM2->CR1 = TIM_CR1_CEN;

    SYSTICK->LOAD = (slow ? SLOW_HZ : HAL_TICKS_PER_SECOND) / TICKS_PER_SECOND - 1u;
    SYSTICK->VAL = 0;
    SYSTICK->CTRL = SYSTICK_CTRL_CLKSOURCE | SYSTICK_CTRL_TICKINT | SYSTICK_CTRL_ENABLE;
}

void SysTick_Handler(void) {
    board.woken = true;
}

hal_clock_t hal_clock(const hal_t *hal) {
    return hal->clock;
}

/* The counter and its extension to 64 bits are one reading: nobody may come between. */
uint64_t hal_microseconds(hal_t *hal) {
    const uint32_t primask = interrupts_off();
    const uint32_t now = TIM2->CNT;
    if (now < hal->time_low)
        hal->time_high++;
    hal->time_low = now;
    const uint64_t time = (uint64_t)hal->time_high << 32 | now;
    interrupts_restore(primask);
    return time;
}

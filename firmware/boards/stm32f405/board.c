/* board.c: board_start(), and those functions of hal.h that are not about chips, converters, links or time. */

#include "boards/board.h"

#include <string.h>

#include "boards/stm32f405/stm32f405.h"

#define PARAMETER_PAGE ((const uint8_t *)0x080E0000u) /* The last sector of the flash. */
/* Tries of waiting for the watchdog: 3 ms at 168 MHz; its registers take five of its 31 us cycles. */
#define WATCHDOG_TRIES 100000u

enum { MODE_OUTPUT = 1, MODE_ALTERNATE = 2, MODE_ANALOG = 3 };
enum { PULL_NONE = 0, PULL_UP = 1, PULL_DOWN = 2 };
enum { SPEED_HIGH = 2 };
/* Alternate functions of the pins, by peripheral (data sheet, table 9). */
enum { TIM1_FUNCTION = 1, TIM3_FUNCTION = 2, TIM8_FUNCTION = 3, USART3_FUNCTION = 7, CAN1_FUNCTION = 9 };

static void change(volatile uint32_t *address, uint32_t mask, uint32_t value) {
    *address = (*address & ~mask) | value;
}

static void pin_mode(GPIO_registers *port, unsigned pin, uint32_t mode, uint32_t pull) {
    change(&port->PUPDR, 3u << (2 * pin), pull << (2 * pin));
    change(&port->MODER, 3u << (2 * pin), mode << (2 * pin));
}

static void pin_alternate(GPIO_registers *port, unsigned pin, uint32_t function, uint32_t pull) {
    change(pin < 8 ? &port->AFRL : &port->AFRH, 15u << (4 * (pin & 7u)), function << (4 * (pin & 7u)));
    change(&port->OSPEEDR, 3u << (2 * pin), (uint32_t)SPEED_HIGH << (2 * pin));
    pin_mode(port, pin, MODE_ALTERNATE, pull);
}

/* Sets up all pins but those that a timer drives. What a pin is for is in pinout.md. */
static void pins_start(void) {
    for (unsigned pin = 0; pin <= 5; pin++)
        pin_mode(GPIOA, pin, MODE_ANALOG, PULL_NONE);
    for (unsigned pin = 0; pin <= 4; pin++)
        pin_mode(GPIOC, pin, MODE_ANALOG, PULL_NONE);
    pin_alternate(GPIOA, 6, TIM8_FUNCTION, PULL_UP);
    pin_alternate(GPIOB, 12, TIM1_FUNCTION, PULL_UP);
    pin_alternate(GPIOC, 6, TIM8_FUNCTION, PULL_DOWN); /* It is quiet without a sync wire. */
    pin_alternate(GPIOB, 8, CAN1_FUNCTION, PULL_UP);   /* The pull-up is recessive without a transceiver. */
    pin_alternate(GPIOB, 9, CAN1_FUNCTION, PULL_NONE);
    pin_alternate(GPIOB, 10, USART3_FUNCTION, PULL_NONE);
    pin_alternate(GPIOB, 11, USART3_FUNCTION, PULL_UP);
    GPIOB->BSRR = 1u << (4 + 16); /* The LED is off before its pin is an output. */
    pin_mode(GPIOB, 4, MODE_OUTPUT, PULL_NONE);
}

/* Gives the timers their outputs, which are low by then. */
static void output_pins_start(void) {
    pin_alternate(GPIOA, 7, TIM3_FUNCTION, PULL_NONE);
    pin_alternate(GPIOB, 0, TIM8_FUNCTION, PULL_NONE);
    pin_alternate(GPIOB, 1, TIM8_FUNCTION, PULL_NONE);
    for (unsigned pin = 13; pin <= 15; pin++)
        pin_alternate(GPIOB, pin, TIM1_FUNCTION, PULL_NONE);
}

static void set_watchdog(uint32_t prescaler, uint32_t reload) {
    IWDG->KR = IWDG_KR_KEY_UNLOCK;
    IWDG->PR = prescaler;
    IWDG->RLR = reload;
    wait_for(&IWDG->SR, IWDG_SR_PVU | IWDG_SR_RVU, 0, WATCHDOG_TRIES);
    IWDG->KR = IWDG_KR_KEY_RELOAD;
}

void watchdog_set(uint32_t reload) {
    set_watchdog(IWDG_PR_PR_DIV16, reload);
}

void watchdog_set_slow(uint32_t reload) {
    set_watchdog(IWDG_PR_PR_DIV64, reload);
}

/* Starts the watchdog with 500 ms at the nominal 32 kHz of its oscillator, which may run at 17 to 47 kHz. */
static void watchdog_start(void) {
    IWDG->KR = IWDG_KR_KEY_START;
    watchdog_set(WATCHDOG_RELOAD);
}

hal_t *board_start(void) {
    hal_t *hal = &board;
    hal->whole = (RCC->CR & RCC_CR_HSIRDY) != 0; /* The processor runs on it. */
    reset_start(hal);
    guards_start();
    hal->clock = clock_start();

    RCC->AHB1ENR |= RCC_AHB1ENR_GPIOAEN | RCC_AHB1ENR_GPIOBEN | RCC_AHB1ENR_GPIOCEN | RCC_AHB1ENR_DMA1EN |
                    RCC_AHB1ENR_DMA2EN;
    RCC->APB1ENR |= RCC_APB1ENR_TIM2EN | RCC_APB1ENR_TIM3EN | RCC_APB1ENR_TIM4EN | RCC_APB1ENR_TIM7EN |
                    RCC_APB1ENR_USART3EN | RCC_APB1ENR_CAN1EN | RCC_APB1ENR_DACEN;
    RCC->APB2ENR |= RCC_APB2ENR_TIM1EN | RCC_APB2ENR_TIM8EN | RCC_APB2ENR_ADC1EN | RCC_APB2ENR_ADC2EN |
                    RCC_APB2ENR_ADC3EN;
    (void)RCC->APB2ENR; /* A peripheral answers two cycles after its clock is on (ES0182). */

    watchdog_start();
    pins_start();
    bridge_start();
    sync_wire_start();
    output_pins_start();
    /* The outputs are unbuffered, since the buffer does not reach 0 V. The trigger is chosen now and switched on by the
     * chip engine: it must not change while a channel is on. */
    DAC->CR = DAC_CR_EN1 | DAC_CR_BOFF1 | DAC_CR_TSEL1_TIM8 | DAC_CR_EN2 | DAC_CR_BOFF2 | DAC_CR_TSEL2_TIM8;
    clock_start_tick(hal->clock);
    alarms_start(hal);
    serial_start(hal);
    SCB->SHPR3 = (uint32_t)PRIORITY_TICK << 28 | (uint32_t)PRIORITY_NORMAL << 20; /* SysTick and PendSV. */
    return hal;
}

void hal_links_start(hal_t *hal, uint32_t can_bit_s, uint32_t serial_baud) {
    serial_open(hal, serial_baud);
    can_start(hal, can_bit_s);
}

void hal_led(hal_t *hal, bool on) {
    (void)hal;
    GPIOB->BSRR = on ? 1u << 4 : 1u << (4 + 16);
}

/* No interrupt may come between, since one of them switches the bridges on. */
void hal_reset(hal_t *hal) {
    (void)interrupts_off();
    hal_drive_enable(hal, false);
    memory_barrier();
    SCB->AIRCR = SCB_AIRCR_SYSRESETREQ;
    memory_barrier();
    for (;;)
        ; /* The reset comes within a few cycles. */
}

void hal_counters(const hal_t *hal, hal_counters_t *counters) {
    *counters = hal->counters;
}

void hal_unique_id(const hal_t *hal, uint8_t id[HAL_UNIQUE_ID_BYTES]) {
    for (unsigned i = 0; i < HAL_UNIQUE_ID_BYTES; i++)
        id[i] = hal->whole ? (uint8_t)(UNIQUE_ID[i / 4] >> (8 * (i % 4))) : 0u;
}

const uint8_t *hal_parameter_page(const hal_t *hal) {
    (void)hal;
    return PARAMETER_PAGE;
}

void hal_watchdog_kick(hal_t *hal) {
    IWDG->KR = IWDG_KR_KEY_RELOAD;
    reset_note_uptime(hal);
}

/* With interrupts off, one that comes between the look at woken and WFI still ends WFI; it is served when they are on
 * again. Interrupts that set nothing, such as the coil current's, do not return to main. */
void hal_wait(hal_t *hal) {
    for (;;) {
        __asm volatile("cpsid i" ::: "memory");
        const bool woken = hal->woken;
        hal->woken = false;
        if (!woken)
            __asm volatile("dsb\n\twfi" ::: "memory");
        __asm volatile("cpsie i\n\tisb" ::: "memory");
        if (woken)
            return;
    }
}

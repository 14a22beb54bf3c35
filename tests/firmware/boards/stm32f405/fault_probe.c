/* The beacon's or the anchor's application, whose first run stops something of the board after a while: the last six
 * bytes of the parameter page say when (us, 32 bits), what it is, and which of its kind. */

#include <string.h>

#include "boards/board.h"
#include "boards/stm32f405/stm32f405.h"

#ifdef ANCHOR
#include "apps/anchor.h"
static anchor_t application;
static onboard_t onboard BOARD_CORE_MEMORY;
static tracking_t tracking BOARD_CORE_MEMORY;
#define START(anchor, hal) anchor_start(anchor, &onboard, &tracking, hal)
#define STEP               anchor_step
#else
#include "apps/beacon.h"
static beacon_t application;
#define START beacon_start
#define STEP  beacon_step
#endif

enum {
    NOTHING = 0,
    HANG_MAIN = 1,
    HANG_INTERRUPT = 2,
    MASK_INTERRUPT = 3,
    STOP_TIMER = 4,
    STOP_STREAM = 5,
    STOP_ADC = 6,
    STOP_BURSTS = 7,
    HANG_MASKED = 8,
    HANG_ALWAYS = 9 /* In each run, as soon as the bridges are on. */
};

#define VECTORS (16u + IRQ_COUNT)

#define AHEAD_US 10000u /* Main is woken more often than that, and waits for the very moment. */

static uint32_t vectors[128] __attribute__((aligned(512)));
volatile uint32_t injected; /* What was there to stop; 0: nothing. */

static void hang(void) {
    for (;;) {
    }
}

/* Lets a handler hang, and has it called. */
static void hang_interrupt(uint32_t irq) {
    injected = NVIC->ISER[irq / 32] >> (irq % 32) & 1u;
    if (injected == 0)
        return;
    const uint32_t *old = (const uint32_t *)SCB->VTOR;
    for (uint32_t i = 0; i < VECTORS; i++)
        vectors[i] = old[i];
    vectors[16u + irq] = (uint32_t)hang;
    SCB->VTOR = (uint32_t)vectors;
    __asm volatile("dsb\n\tisb" ::: "memory");
    NVIC->ISPR[irq / 32] = 1u << (irq % 32);
}

static void stop(uint32_t kind, uint32_t which) {
    static TIM_registers *const timers[] = {0, TIM1, TIM2, TIM3, TIM4, 0, 0, 0, TIM8};
    static ADC_registers *const converters[] = {0, ADC1, ADC2, ADC3};
    DMA_stream_registers *stream = which < 16u ? &DMA1->S[which & 7u] : &DMA2->S[which & 7u];
    switch (kind) {
    case HANG_MAIN:
        injected = 1;
        hang();
        break;
    case HANG_MASKED:
        injected = 1;
        (void)interrupts_off();
        hang();
        break;
    case HANG_INTERRUPT:
        hang_interrupt(which);
        break;
    case MASK_INTERRUPT:
        injected = NVIC->ISER[which / 32] >> (which % 32) & 1u;
        NVIC->ICER[which / 32] = 1u << (which % 32);
        break;
    case STOP_TIMER:
        injected = timers[which]->CR1 & TIM_CR1_CEN;
        timers[which]->CR1 &= ~TIM_CR1_CEN;
        break;
    case STOP_STREAM:
        injected = stream->CR & DMA_S0CR_EN;
        stream->CR &= ~DMA_S0CR_EN;
        break;
    case STOP_ADC:
        injected = converters[which]->CR2 & ADC_CR2_ADON;
        converters[which]->CR2 &= ~ADC_CR2_ADON;
        break;
    case STOP_BURSTS: /* The currents go on. */
        injected = converters[which]->CR2 & ADC_CR2_EXTEN_RISING;
        converters[which]->CR2 &= ~ADC_CR2_EXTEN_RISING;
        break;
    default:
        break;
    }
}

int main(void) {
    hal_t *hal = board_start();
    const uint8_t *what = hal_parameter_page(hal) + HAL_PARAMETER_PAGE_BYTES - 2;
    uint32_t inject_us;
    memcpy(&inject_us, what - sizeof inject_us, sizeof inject_us);
    START(&application, hal);
    bool armed = hal_last_reset(hal)->cause == HAL_RESET_POWER_ON;
    for (;;) {
        STEP(&application);
        hal_wait(hal);
        if (what[0] == HANG_ALWAYS && (GPIOB->IDR >> 15 & 1u) != 0)
            hang();
        if (armed && hal_microseconds(hal) + AHEAD_US >= inject_us) {
            armed = false;
            while (hal_microseconds(hal) < inject_us) {
            }
            hal_led(hal, true);
            hal_led(hal, false); /* Its fall tells when. */
            stop(what[0], what[1]);
        }
    }
}

/* bridge.c: the outputs to the bridges: what they are when nothing drives them, who may switch them on, and who
 * switches them off.
 *
 * All of them are complementary outputs of TIM1 and TIM8, without their main outputs. Such an output follows its
 * channel's compare while MOE of its timer is set. Without MOE it is driven low (OSSI = 1, OISxN = 0), from board_start
 * on whatever becomes of the rest. PB15, the bridges' own enable, is a channel that is always active, so it is MOE.
 *
 *   who switches off            how                                             when
 *   the drivers                 their fault wire is the break input of both     at once, in hardware, without a clock
 *   the chip engine, standing   TIM7, restarted by each coil current, ends      two chips behind the last current
 *   nobody, planning            coil currents restart TIM7 no more              a block and two chips behind the plan
 *   a processor that serves     the fuse, which no coil current moves on, is    two chips and a half behind the last
 *   no interrupt                a break of TIM1                                 current, in hardware
 *   the crystal, stopping       the clock security system is a break, too       at once, in hardware
 *   hal_drive_enable(), crash   MOE is cleared                                  at once
 * MOE cannot be set while a break input is low, nor can the break's flag be cleared (RM0090, 17.4.18): the fault is a
 * level. Its interrupt would therefore come for ever: it is armed when the chip engine starts, tells once, also with
 * the bridges off, and is armed again when they are enabled again.
 *
 * The fuse. In the middle of each chip DMA2 stream 7 brings a half-word of a ring to EGR of TIM1: 0, which does
 * nothing, or BG, which is a break. Each coil current puts BG two places ahead of what the stream has fetched, and 0
 * where it was before. So a processor that hangs with all interrupts masked, or in the handler of TIM7, or that a
 * debugger has halted, loses the bridges to the second or third transfer from then on, without an instruction. A break
 * of TIM1 alone is the fuse's; the fault wire breaks TIM8, too.
 *
 *   a coil current in chip c   the stream has written   has fetched   now set to 0    now set to BG
 *   behind the middle          that of chip c           c + 1         c + 2           c + 3
 * The current of chip c + 1 comes in time if its handler runs before the middle of chip c + 2, as it must anyway
 * (ADC_Handler).
 *
 * The modes and BDTR are locked (LOCK = 3) until reset: no wild write takes the break away.
 *
 * fault() is called at PRIORITY_DRIVE, also for TIM7, whose interrupt has a higher one, because a coil current's
 * handler that hangs must not keep it from the bridges: it switches them off and leaves the call to TIM1's break
 * interrupt.
 */

#include "boards/stm32f405/stm32f405.h"

/* BKP = 0: a low break input breaks. AOE = 0: only software sets MOE. */
#define BDTR_OFF (TIM_BDTR_LOCK_3 | TIM_BDTR_OSSI | TIM_BDTR_BKE)
#define BDTR_ON  (BDTR_OFF | TIM_BDTR_MOE)

/* Flags of a timer's SR that are cleared by 0 and kept by 1. */
#define SR_KEPT 0xFFu

#define WATCH_TICKS (2u * HAL_CHIP_TICKS_MAX) /* Two of the longest chips. */

void bridge_start(void) {
    TIM1->CCMR1_Output = TIM_CCMR1_OC1M_PWM1 | TIM_CCMR1_OC1PE | TIM_CCMR1_OC2M_PWM1 | TIM_CCMR1_OC2PE;
    TIM1->CCMR2_Output = TIM_CCMR2_OC3M_ACTIVE | TIM_CCMR2_OC4M_PWM1;
    TIM1->CCER = TIM_CCER_CC1NE | TIM_CCER_CC2NE | TIM_CCER_CC3NE;
    TIM1->BDTR = BDTR_OFF;
    /* The capture of the sync wire, channel 1, is 48 ns behind the edge, free of shorter spikes. */
    TIM8->CCMR1_Output = TIM_CCMR1_CC1S_TI1 | TIM_CCMR1_IC1F_8_SAMPLES | TIM_CCMR1_OC2M_PWM1 | TIM_CCMR1_OC2PE;
    TIM8->CCMR2_Output = TIM_CCMR2_OC3M_PWM1 | TIM_CCMR2_OC3PE | TIM_CCMR2_OC4M_PWM1;
    TIM8->CCER = TIM_CCER_CC1E | TIM_CCER_CC2NE | TIM_CCER_CC3NE;
    TIM8->BDTR = BDTR_OFF;

    TIM7->ARR = WATCH_TICKS / 2u - 1u; /* It counts 84 MHz. */
    TIM7->CR1 = TIM_CR1_OPM | TIM_CR1_URS;
    TIM7->DIER = TIM_DIER_UIE;
    interrupt_enable(IRQ_TIM7, PRIORITY_OFF);
    interrupt_enable(IRQ_TIM1_BRK_TIM9, PRIORITY_DRIVE);
    interrupt_enable(IRQ_TIM8_BRK_TIM12, PRIORITY_DRIVE);
}

static void bridge_off(void) {
    board.enabled = false;
    TIM1->BDTR = BDTR_OFF;
    TIM8->BDTR = BDTR_OFF;
}

static bool bridge_is_on(void) {
    return (TIM1->BDTR & TIM8->BDTR & TIM_BDTR_MOE) != 0;
}

bool bridge_lost(void) {
    return board.enabled && !bridge_is_on();
}

void bridge_trip(hal_fault_t cause) {
    bridge_off();
    __atomic_fetch_or(&board.faults, 1u << cause, __ATOMIC_RELAXED);
    NVIC->ISPR[IRQ_TIM1_BRK_TIM9 / 32u] = 1u << IRQ_TIM1_BRK_TIM9 % 32u;
}

/* A flag cannot be cleared while its input is low. Both are armed before either may tell. */
void bridge_arm(void) {
    const uint32_t primask = interrupts_off();
    TIM1->SR = SR_KEPT & ~TIM_SR_BIF;
    TIM8->SR = SR_KEPT & ~TIM_SR_BIF;
    TIM1->DIER |= TIM_DIER_BIE;
    TIM8->DIER |= TIM_DIER_BIE;
    interrupts_restore(primask);
}

/* All of the ring is 0 until the first coil current. */
void bridge_fuse_start(const hal_t *hal) {
    DMA_stream_registers *stream = &DMA2->S[7];
    DMA2->HIFCR = DMA_HIFCR_STREAM7;
    stream->PAR = (uint32_t)&TIM1->EGR;
    stream->M0AR = (uint32_t)hal->fuse;
    stream->NDTR = RING_CHIPS;
    stream->CR = DMA_S0CR_CHSEL_7 | DMA_S0CR_DIR_TO_PERIPHERAL | DMA_S0CR_CIRC | DMA_S0CR_MINC | DMA_S0CR_PSIZE_16 |
                 DMA_S0CR_MSIZE_16 | DMA_S0CR_PL_HIGH;
    stream->CR |= DMA_S0CR_EN;
    TIM8->DIER |= TIM_DIER_CC4DE;
}

/* What is written next has been fetched already. */
static void fuse_move(hal_t *hal) {
    const uint32_t fetched = RING_CHIPS - DMA2->S[7].NDTR; /* NDTR is 62 to 1. */
    const uint32_t next = fetched + 1u < RING_CHIPS ? fetched + 1u : 0u;
    hal->fuse[next] = 0;
    hal->fuse[next + 1u < RING_CHIPS ? next + 1u : 0u] = TIM_EGR_BG;
}

void bridge_watch(void) {
    TIM7->CNT = 0;
    TIM7->CR1 = TIM_CR1_OPM | TIM_CR1_URS | TIM_CR1_CEN;
    fuse_move(&board);
}

void TIM7_Handler(void) {
    const bool ended = (TIM7->SR & TIM_SR_UIF) != 0;
    TIM7->SR = 0;
    if (ended && bridge_is_on())
        bridge_trip(HAL_FAULT_STALE);
}

/* Returns who has broken the outputs, as a bit of faults. A fuse that ends with the bridges off is nobody's affair. */
static uint32_t broken(void) {
    if ((TIM8->SR & TIM_SR_BIF) != 0 || hal_drive_fault(&board))
        return 1u << HAL_FAULT_DRIVER;
    if (board.enabled && (TIM1->SR & TIM_SR_BIF) != 0)
        return 1u << HAL_FAULT_STALE;
    TIM1->SR = SR_KEPT & ~TIM_SR_BIF;
    return 0;
}

/* Serves a break of either timer, and what bridge_trip() left. A break that comes with another fault is part of it: the
 * crystal's end is one. */
void TIM1_BRK_TIM9_Handler(void) {
    uint32_t faults = __atomic_exchange_n(&board.faults, 0u, __ATOMIC_RELAXED);
    if (faults == 0 && (TIM1->DIER & TIM_DIER_BIE) != 0)
        faults = broken();
    if (faults == 0)
        return;
    bridge_off();
    TIM1->DIER &= ~TIM_DIER_BIE;
    TIM8->DIER &= ~TIM_DIER_BIE;
    for (uint32_t cause = 0; faults >> cause != 0; cause++) {
        if ((faults >> cause & 1u) != 0 && board.events.fault != NULL)
            board.events.fault(board.events.context, (hal_fault_t)cause);
    }
    board.woken = true;
}

void TIM8_BRK_TIM12_Handler(void) {
    TIM1_BRK_TIM9_Handler();
}

bool hal_drive_fault(const hal_t *hal) {
    (void)hal;
    return (GPIOB->IDR & 1u << 12) == 0 || (GPIOA->IDR & 1u << 6) == 0;
}

bool hal_drive_enable(hal_t *hal, bool enable) {
    bool on = false;
    const uint32_t primask = interrupts_off();
    if (enable && hal_role_drives(hal->role) && (TIM1->CR1 & TIM_CR1_CEN) != 0 && !hal_drive_fault(hal)) {
        bridge_arm();
        bridge_watch();
        TIM1->BDTR = BDTR_ON;
        TIM8->BDTR = BDTR_ON;
        on = bridge_is_on();
        hal->enabled = on;
    }
    if (!on)
        bridge_off();
    interrupts_restore(primask);
    return on == enable;
}

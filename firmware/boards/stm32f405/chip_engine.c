/* chip_engine.c: TIM1, TIM8, three DMA streams and the DAC execute the chips; the CPU writes two blocks ahead into
 * rings.
 *
 * TIM1 counts 168 MHz ticks from 0 to ARR; an update event ends each chip. TIM8 is reset by each update (TRGO of TIM1,
 * ITR0 of TIM8), passes the event on to the DAC (which TIM1 does not reach), and starts the conversion of coil
 * currents by its compare 2. In chip c:
 *
 *   count        event        what happens                                                            transfers
 *   0 (update)   TIM1_UP      DMA2 stream 5: words[(c - 1) mod 62] -> GPIOC BSRR, the edges of chip c   c
 *                             the preload of ARR, written in chip c - 1, becomes the period of c
 *   0 (reset)    TIM8 TRGO    the DAC's outputs take what its data register holds: the set-points of c
 *                             then DMA1 stream 5: set_points[(c - 1) mod 62] -> DHR12RD, for c + 1      c
 *   8000 (CC4)   TIM1_CH4     DMA2 stream 4: periods[c mod 62] -> preload of ARR, for chip c + 1        c + 1
 *   CC1          converters   burst of 8 (sensor, anchor)
 *   TIM8 CC2     converters   one conversion of the coil currents (beacon, anchor)
 *   any (CC3)    capture      edge of the sync wire, its count kept in CCR3
 *   ARR          update       chip c ends
 * The last column has the stream's transfers so far, behind that event.
 *
 * So chip c's word and period lie at the same index, (c - 1) mod 62: transfer number k (from 0) of either stream is
 * for chip k + 1. Its set-points lie one before, at (c - 2) mod 62: transfer k is for chip k + 2. Chip 0 is nobody's
 * transfer, nor are the set-points of chip 1: hal_chips_start() writes them itself, then starts the counters.
 *
 * A stream fetches its next entry as soon as it has written the one before (RM0090, 10.3.14, direct mode): an entry
 * must be there a chip early.
 *
 *   chips      index     word fetched        period fetched   set-point fetched (index less 1)   by the plan of
 *   0          (61)      by the CPU before the start                                             block 0
 *   1..30      0..29     start of chip c-1   in chip c-2      start of chip c-2                  block 0
 *   31..61     30..60    start of chip c-1   in chip c-2      start of chip c-2                  block 1
 *   62         61        start of chip 61    in chip 60       start of chip 60                   block 2
 *   63..92     0..29     start of chip c-1   in chip c-2      start of chip c-2                  block 2
 * The first entry of each stream is fetched when it is switched on. Block 2 is planned from the start of chip 31 on.
 *
 * DMA2 stream 5 has done 31 transfers at the start of chip 31 (half) and 62 at that of chip 62 (complete): its
 * interrupts are the block boundaries. The interrupt at the start of block b plans block b + 1, whose first set-points
 * are fetched at the start of the last chip but one of block b: there are 29 chips (2.83 ms) to write it; later is
 * counted. It writes over entries that were fetched for block b - 1 and before.
 *
 * Where are we? Stream 5's counter is ambiguous for the few cycles between an update and its transfer, stream 4's
 * around count 8000: chip_now() looks at the count and asks the other one. A position in the ring (0..61) becomes an
 * absolute chip by the running block as the block interrupt knows it: that interrupt may be late by less than a block,
 * so a position in the other half of the ring is the next block's.
 */

#include "boards/stm32f405/stm32f405.h"

#define PIN_SET(pin)   (1u << (pin))
#define PIN_RESET(pin) (1u << ((pin) + 16))

/* The words of a bridge's inputs, by hal_drive_t; a drive that does not exist is off. */
#define BRIDGE(first, second)                                                                                          \
    {                                                                                                                  \
        PIN_RESET(first) | PIN_RESET(second), PIN_SET(first) | PIN_RESET(second), PIN_RESET(first) | PIN_SET(second),  \
            PIN_RESET(first) | PIN_RESET(second)                                                                       \
    }
static const uint32_t bridge_words[HAL_CHANNELS][4] = {BRIDGE(6, 7), BRIDGE(4, 5)};

static uint32_t set_point(uint16_t count) {
    return count > 4095u ? 4095u : count;
}

/* Writes chip i of the plan into entry index of the rings. */
static inline void write_chip(hal_t *hal, uint32_t i, uint32_t index) {
    const hal_plan_t *plan = &hal->plan;
    uint32_t period = plan->period_ticks[i];
    if (period < HAL_CHIP_TICKS_MIN)
        period = HAL_CHIP_TICKS_MIN;
    if (period > HAL_CHIP_TICKS_MAX)
        period = HAL_CHIP_TICKS_MAX;
    const uint32_t drive = plan->drive[i];
    const uint32_t sync = (drive & HAL_PLAN_SYNC_OUT) != 0u ? PIN_SET(8) : PIN_RESET(8);
    hal->words[index] = bridge_words[0][drive & 3u] | bridge_words[1][drive >> HAL_DRIVE_BITS & 3u] | sync;
    hal->periods[index] = period - 1u;
    hal->set_points[index > 0u ? index - 1u : RING_CHIPS - 1u] = set_point(plan->set_point[0][i]) |
                                                                 set_point(plan->set_point[1][i]) << 16;
}

/* Asks for the block's plan and writes it into the rings. */
static void plan_block(hal_t *hal, uint32_t block) {
    hal->events.plan(hal->events.context, block, &hal->plan);
    const uint32_t second = (block & 1u) != 0 ? HAL_BLOCK_CHIPS : 0u; /* The entry of the second chip. */
    write_chip(hal, 0, (second + RING_CHIPS - 1u) % RING_CHIPS);
    for (uint32_t i = 1; i < HAL_BLOCK_CHIPS; i++)
        write_chip(hal, i, second + i - 1u);
    memory_barrier();
}

static void stream_start(DMA_stream_registers *stream, volatile uint32_t *target, const uint32_t *source,
                         uint32_t flags) {
    stream->PAR = (uint32_t)target;
    stream->M0AR = (uint32_t)source;
    stream->NDTR = RING_CHIPS;
    stream->CR = flags | DMA_S0CR_DIR_TO_PERIPHERAL | DMA_S0CR_CIRC | DMA_S0CR_MINC | DMA_S0CR_PSIZE_32 |
                 DMA_S0CR_MSIZE_32;
    stream->CR |= DMA_S0CR_EN;
}

/* Puts TIM8 and the DAC behind TIM1, which stands still and must not make an update event until it is started. */
static void drive_start(const hal_t *hal) {
    TIM1->CR2 = TIM_CR2_MMS_UPDATE;
    TIM8->CR2 = TIM_CR2_MMS_UPDATE;
    TIM8->SMCR = TIM_SMCR_SMS_RESET; /* The trigger is ITR0 (TS 0), which is TIM1. */

    DAC->DHR12RD = hal->set_points[RING_CHIPS - 2u]; /* For chip 0: without a trigger the outputs follow at once. */
    DAC->CR |= DAC_CR_TEN1 | DAC_CR_TEN2 | DAC_CR_DMAEN1;
    DAC->DHR12RD = hal->set_points[RING_CHIPS - 1u]; /* For chip 1. */
    DMA1->HIFCR = DMA_HIFCR_STREAM5;
    stream_start(&DMA1->S[5], &DAC->DHR12RD, hal->set_points, DMA_S0CR_CHSEL_7 | DMA_S0CR_PL_VERY_HIGH);
}

void hal_chips_start(hal_t *hal, hal_role_t role, const hal_events_t *events) {
    if (hal->clock == HAL_CLOCK_SLOW)
        return;
    hal->role = role;
    hal->events = *events;
    hal->sampling = true;
    plan_block(hal, 0);
    const uint32_t word = hal->words[RING_CHIPS - 1u], period = hal->periods[RING_CHIPS - 1u];
    plan_block(hal, 1);

    TIM1->ARR = period;
    TIM1->CCR4 = CHIP_RELOAD_TICKS;
    /* The capture is 48 ns behind the edge, free of shorter spikes. */
    TIM1->CCMR2_Output = TIM_CCMR2_CC3S_TI3 | TIM_CCMR2_IC3F_8_SAMPLES;
    TIM1->CCER = TIM_CCER_CC3E;
    TIM1->CR1 = TIM_CR1_ARPE;
    converters_start(hal);  /* It sets up CC1 and TIM8's CC2. */
    TIM1->EGR = TIM_EGR_UG; /* The preloads become shadows. */
    TIM1->SR = 0;

    DMA2->HIFCR = DMA_HIFCR_STREAM4 | DMA_HIFCR_STREAM5;
    stream_start(&DMA2->S[5], &GPIOC->BSRR, hal->words,
                 DMA_S0CR_CHSEL_6 | DMA_S0CR_PL_VERY_HIGH | DMA_S0CR_HTIE | DMA_S0CR_TCIE);
    stream_start(&DMA2->S[4], &TIM1->ARR, hal->periods, DMA_S0CR_CHSEL_6 | DMA_S0CR_PL_HIGH);
    TIM1->DIER = TIM_DIER_UDE | TIM_DIER_CC4DE | TIM_DIER_CC3IE;
    interrupt_enable(IRQ_DMA2_STREAM5, PRIORITY_NORMAL);
    interrupt_enable(IRQ_TIM1_CC, PRIORITY_NORMAL);
    interrupt_enable(IRQ_ADC, PRIORITY_DRIVE);
    const bool drives = hal_role_drives(role);
    if (drives) {
        drive_start(hal);
        /* The drivers' fault input counts also if it is active already. */
        EXTI->FTSR |= 1u << 10;
        EXTI->IMR |= 1u << 10;
        interrupt_enable(IRQ_EXTI15_10, PRIORITY_DRIVE);
        if ((GPIOC->IDR & 1u << 10) == 0)
            EXTI->SWIER = 1u << 10;
    }

    const uint32_t primask = interrupts_off(); /* The word and the counters start together. */
    if (drives)
        TIM8->CR1 = TIM_CR1_CEN;
    GPIOC->BSRR = word | PIN_RESET(12); /* PC12 drives the LED to the supply: low is on. */
    TIM1->CR1 = TIM_CR1_ARPE | TIM_CR1_CEN;
    interrupts_restore(primask);
}

/* A block boundary has come. The flags of stream 5 alternate: half at the start of odd blocks, complete at that of
 * even ones. A plan that was not written two chips before its block, or when the next boundary's flag is up already,
 * came too late. */
void DMA2_Stream5_Handler(void) {
    hal_t *hal = &board;
    for (uint32_t flag; ((flag = (hal->block & 1u) != 0 ? DMA_HISR_TCIF5 : DMA_HISR_HTIF5) & DMA2->HISR) != 0;) {
        DMA2->HIFCR = flag;
        const uint32_t finished = hal->block;
        hal->block = finished + 1u;
        hal->first_chip += HAL_BLOCK_CHIPS;
        converters_block(hal, finished, chip_now(hal));
        if (hal_role_samples(hal->role)) {
            hal->events.samples(hal->events.context, finished, (const hal_samples_t *)&hal->samples[finished & 1u]);
        }
        plan_block(hal, finished + 2u);
        const bool overtaken = (DMA2->HISR & (DMA_HISR_TCIF5 | DMA_HISR_HTIF5)) != 0;
        if (overtaken || chip_now(hal).chip - hal->first_chip >= HAL_BLOCK_CHIPS - 2u)
            hal->counters.late_blocks++;
    }
    hal->woken = true;
}

/* Returns the absolute chip of a position 0..61 in the ring, in the running block or the one behind it. first_chip is
 * odd in odd blocks. */
static uint32_t absolute_chip(uint32_t first_chip, uint32_t position) {
    if ((first_chip & 1u) == 0)
        return first_chip + position;
    return position < HAL_BLOCK_CHIPS ? first_chip + HAL_BLOCK_CHIPS + position
                                      : first_chip - HAL_BLOCK_CHIPS + position;
}

/* Returns the transfers of a stream, modulo 62. */
static uint32_t transfers(const DMA_stream_registers *stream) {
    const uint32_t done = RING_CHIPS - stream->NDTR;
    return done == RING_CHIPS ? 0u : done;
}

/* Two passes are enough: if a chip ended between the readings, none will end so soon again. */
chip_time_t chip_now(const hal_t *hal) {
    uint32_t ticks = 0, position = 0;
    for (int pass = 0; pass < 2; pass++) {
        ticks = TIM1->CNT;
        position = transfers(ticks < CHIP_RELOAD_TICKS / 2u ? &DMA2->S[4] : &DMA2->S[5]);
        if (TIM1->CNT >= ticks)
            break;
    }
    return (chip_time_t){.chip = absolute_chip(hal->first_chip, position), .ticks = ticks};
}

/* An edge whose count is beyond the present one came in the chip before. That is right if this interrupt is late by
 * less than a chip. */
void TIM1_CC_Handler(void) {
    const uint32_t edge = TIM1->CCR3; /* Reading it clears the flag. */
    const chip_time_t now = chip_now(&board);
    board.events.sync(board.events.context, edge > now.ticks ? now.chip - 1u : now.chip, (uint16_t)edge);
    board.woken = true;
}

/* The coil currents of chip c are converted behind count 8000: stream 4 has done c + 1 transfers, and does no more
 * before count 8000 of chip c + 1. That is right if this interrupt is late by less than half a chip; no look at the
 * count is needed. */
void ADC_Handler(void) {
    uint16_t count[HAL_CHANNELS];
    if (!converters_take(&board, count))
        return;
    const uint32_t done = transfers(&DMA2->S[4]);
    const uint32_t chip = absolute_chip(board.first_chip, done == 0 ? RING_CHIPS - 1u : done - 1u);
    board.events.current(board.events.context, chip, count);
}

void EXTI15_10_Handler(void) {
    GPIOC->BSRR = PIN_RESET(9);
    EXTI->PR = 1u << 10;
    board.events.fault(board.events.context, HAL_FAULT_DRIVER);
    board.woken = true;
}

bool hal_drive_fault(const hal_t *hal) {
    (void)hal;
    return (GPIOC->IDR & 1u << 10) == 0;
}

bool hal_drive_enable(hal_t *hal, bool enable) {
    const bool on = enable && !hal_drive_fault(hal);
    GPIOC->BSRR = on ? PIN_SET(9) : PIN_RESET(9);
    return on == enable;
}

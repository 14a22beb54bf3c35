/* chip_engine.c: timers, DMA streams and the DAC execute the chips; the CPU writes two blocks ahead into rings.
 *
 * TIM1 counts 168 MHz ticks from 0 to ARR; an update event ends each chip. TIM8 (168 MHz), TIM3 and TIM4 (84 MHz) are
 * reset by each chip's start. What leaves at a chip's edge does so by a compare with preload: the levels of chip c wait
 * in the preload registers during chip c - 1 and take effect in hardware at its end, whatever the bus or the CPU does
 * then.
 *
 *   timer   is                                 its channels
 *   TIM1    the chip                           1N, 2N: bridge inputs of channel 0; 3N: enable; 4: its trigger output
 *   TIM8    a slave at the same clock          1: capture of the sync wire; 2N, 3N: bridge inputs of channel 1;
 *                                              4: its trigger output, which takes the set-points into the DAC
 *   TIM3    a slave of which nothing has       1: starts the burst, or the currents behind the edge (converters.c);
 *           a main output enable               2: sync wire out
 *   TIM4    the same, which ends twice a chip  1: starts the coil currents each time (converters.c)
 * An advanced timer's outputs, also those that start a converter, end with its MOE, and so does nothing else: what must
 * go on with the bridges off is on TIM3 and TIM4. The trigger outputs are compare levels, thousands of ticks wide, and
 * no update events, which last one tick: a slave at half the clock must not miss one.
 *
 * A level is a compare of 0 (low) or 0xFFFF (high, beyond any count). In chip c:
 *
 *   count        event        what happens                                                           transfers
 *   0 (update)   TIM1         the preloads of ARR, CCR1 and CCR2 become period and levels of c
 *   0 (reset)    TIM8_UP      the preloads of CCR2 and CCR3 become levels of c
 *                             then DMA2 stream 1: edges_8[(c - 1) mod 62] -> preloads, for c + 1        c
 *   0 (reset)    TIM3_UP      the preload of CCR2 becomes the level of c
 *                             then DMA1 stream 2: sync_levels[(c - 1) mod 62] -> preload, for c + 1     c
 *   0            TIM8 TRGO    the DAC's outputs take what its data register holds: the set-points of c
 *                             then DMA1 stream 5: set_points[(c - 1) mod 62] -> DHR12RD, for c + 1      c
 *   8000 (CC4)   TIM1_CC4     DMA2 stream 4: edges[c mod 62] -> preloads of TIM1, for c + 1             c + 1
 *   8000 (CC4)   TIM8_CC4     DMA2 stream 7: fuse[c mod 62] -> EGR of TIM1 (bridge.c)                   c + 1
 *   TIM3 CC1     converters   burst of 8 (sensor, anchor), or the coil currents behind the edge (beacon)
 *   TIM4 CC1     converters   the coil currents, amid the chip and before its end (beacon, anchor)
 *   any          TIM8_CC1     edge of the sync wire, its count kept in CCR1
 *   ARR          update       chip c ends
 * The last column has the stream's transfers (bursts of 4 or 2 for TIM1 and TIM8) so far, behind that event.
 *
 * So chip c's period and levels of TIM1 lie at index (c - 1) mod 62: transfer number k (from 0) of stream 4 is for chip
 * k + 1. All else lies one before, at (c - 2) mod 62: transfer k is for chip k + 2. What is nobody's transfer, chip 0
 * and of the slaves chip 1, hal_chips_start() writes itself, then starts the counters.
 *
 * A stream fetches its next word as soon as it has written the one before (RM0090, 10.3.14, direct mode): the first
 * word of an entry must be there two chips early.
 *
 *   chips      index in edges    first fetched        index elsewhere   first fetched      by the plan of
 *   0          (61)              by the CPU           (60)              by the CPU         block 0
 *   1          0                 at the start         (61)              by the CPU         block 0
 *   2..30      1..29             middle of chip c-2   0..28             start of chip c-2  block 0
 *   31..61     30..60            middle of chip c-2   29..59            start of chip c-2  block 1
 *   62         61                middle of chip c-2   60                start of chip c-2  block 2
 *   63..92     0..29             middle of chip c-2   61, 0..28         start of chip c-2  block 2
 * Block 2 is planned from the start of chip 31 on.
 *
 * DMA2 stream 1 has done 31 transfers at the start of chip 31 (half) and 62 at that of chip 62 (complete): its
 * interrupts are the block boundaries. The interrupt at the start of block b plans block b + 1, whose first entry is
 * fetched at the start of the last chip but one of block b: there are 29 chips (2.83 ms) to write it; later is
 * counted. It writes over entries that were fetched for block b - 1 and before.
 *
 * A ring whose plan nobody renews goes round with old edges. The coil currents' interrupt, which a block interrupt that
 * hangs does not stop, counts the chips since the start of the block in which the last plan was made. Two blocks were
 * planned then; a third, which repeats the first, is counted as late; behind it the bridges go off (bridge_watch).
 *
 * Where are we? TIM8 knows the tick, and the transfers of stream 4 the chip, but for the few ticks around the middle:
 * chip_now() reads both. A position in the ring (0..61) becomes an absolute chip by the running block as the block
 * interrupt knows it: that interrupt may be late by less than a block, so a position in the other half of the ring is
 * the next block's. The edge of the sync wire and the frames of CAN are stamped at a priority above the block
 * interrupt, which may take many chips; what follows from them is done at its own.
 */

#include "boards/stm32f405/stm32f405.h"

#define LEVEL_LOW  0u
#define LEVEL_HIGH 0xFFFFu /* It is beyond any count. */

/* How long after the middle of a chip its transfers may not be done, and two readings may take, ticks. */
#define MIDDLE_SETTLED 100u

static uint32_t set_point(uint16_t count) {
    return count > 4095u ? 4095u : count;
}

static uint16_t level(bool high) {
    return high ? LEVEL_HIGH : LEVEL_LOW;
}

/* Returns the position in a ring before another. */
static uint32_t before(uint32_t position) {
    return position > 0u ? position - 1u : RING_CHIPS - 1u;
}

/* Writes chip i of the plan into entry index of the edges, and the one before of the other rings. A drive that does
 * not exist is off. */
static inline void write_chip(hal_t *hal, uint32_t i, uint32_t index) {
    const hal_plan_t *plan = &hal->plan;
    uint32_t period = plan->period_ticks[i];
    if (period < HAL_CHIP_TICKS_MIN)
        period = HAL_CHIP_TICKS_MIN;
    if (period > HAL_CHIP_TICKS_MAX)
        period = HAL_CHIP_TICKS_MAX;
    const uint32_t drive = plan->drive[i];
    const uint32_t first = drive & 3u, second = drive >> HAL_DRIVE_BITS & 3u;
    hal->edges[index].reload = (uint16_t)(period - 1u);
    hal->edges[index].inputs[0] = level(first == HAL_DRIVE_POSITIVE);
    hal->edges[index].inputs[1] = level(first == HAL_DRIVE_NEGATIVE);
    const uint32_t earlier = before(index);
    hal->edges_8[earlier].inputs[0] = level(second == HAL_DRIVE_POSITIVE);
    hal->edges_8[earlier].inputs[1] = level(second == HAL_DRIVE_NEGATIVE);
    hal->sync_levels[earlier] = level((drive & HAL_PLAN_SYNC_OUT) != 0u);
    hal->set_points[earlier] = set_point(plan->set_point[0][i]) | set_point(plan->set_point[1][i]) << 16;
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

#define HALF_WORDS (DMA_S0CR_PSIZE_16 | DMA_S0CR_MSIZE_16)
#define WORDS      (DMA_S0CR_PSIZE_32 | DMA_S0CR_MSIZE_32)

/* Starts a stream that brings the items of a ring to a peripheral for ever. */
static void stream_start(DMA_stream_registers *stream, volatile uint32_t *target, const void *ring, uint32_t items,
                         uint32_t flags) {
    stream->PAR = (uint32_t)target;
    stream->M0AR = (uint32_t)ring;
    stream->NDTR = items;
    stream->CR = flags | DMA_S0CR_DIR_TO_PERIPHERAL | DMA_S0CR_CIRC | DMA_S0CR_MINC | DMA_S0CR_PL_VERY_HIGH;
    stream->CR |= DMA_S0CR_EN;
}

static void streams_start(const hal_t *hal) {
    DMA2->LIFCR = DMA_LIFCR_STREAM1;
    DMA2->HIFCR = DMA_HIFCR_STREAM4;
    DMA1->LIFCR = DMA_LIFCR_STREAM2;
    DMA1->HIFCR = DMA_HIFCR_STREAM5;
    TIM1->DCR = TIM_DCR_DBA_ARR | TIM_DCR_DBL_4;
    TIM8->DCR = TIM_DCR_DBA_CCR2 | TIM_DCR_DBL_2;
    stream_start(&DMA2->S[4], &TIM1->DMAR, hal->edges, RING_CHIPS * EDGE_ITEMS, DMA_S0CR_CHSEL_6 | HALF_WORDS);
    stream_start(&DMA2->S[1], &TIM8->DMAR, hal->edges_8, RING_CHIPS * EDGE_8_ITEMS,
                 DMA_S0CR_CHSEL_7 | HALF_WORDS | DMA_S0CR_HTIE | DMA_S0CR_TCIE);
    stream_start(&DMA1->S[2], &TIM3->CCR2, hal->sync_levels, RING_CHIPS, DMA_S0CR_CHSEL_5 | HALF_WORDS);
    stream_start(&DMA1->S[5], &DAC->DHR12RD, hal->set_points, RING_CHIPS, DMA_S0CR_CHSEL_7 | WORDS);
    TIM1->DIER |= TIM_DIER_CC4DE;
}

/* Puts an entry of the rings, of those that are for two chips ahead, into the preloads. */
static void preload_slaves(const hal_t *hal, uint32_t index) {
    TIM8->CCR2 = hal->edges_8[index].inputs[0];
    TIM8->CCR3 = hal->edges_8[index].inputs[1];
    TIM3->CCR2 = hal->sync_levels[index];
    DAC->DHR12RD = hal->set_points[index];
}

/* Sets up what bridge_start() has not. The slaves' trigger is ITR0 (TS 0), which is TIM1. A compare level that rises
 * here is a trigger, too: nobody must listen yet. */
static void timers_start(void) {
    TIM1->CR1 = TIM_CR1_ARPE;
    TIM1->CR2 = TIM_CR2_MMS_OC4REF;
    TIM1->CCR4 = MIDDLE_TICKS;
    TIM8->CR2 = TIM_CR2_MMS_OC4REF;
    TIM8->CCR4 = MIDDLE_TICKS;
    TIM8->ARR = 0xFFFFu;
    TIM8->SMCR = TIM_SMCR_SMS_RESET;
    TIM3->ARR = 0xFFFFu;
    TIM3->SMCR = TIM_SMCR_SMS_RESET;
    TIM4->SMCR = TIM_SMCR_SMS_RESET;
}

/* The sync wire is driven, low, from board_start() on. */
void sync_wire_start(void) {
    TIM3->CCMR1_Output = TIM_CCMR1_OC1M_PWM2 | TIM_CCMR1_OC2M_PWM1 | TIM_CCMR1_OC2PE;
    TIM3->CCER = TIM_CCER_CC2E;
}

/* Starts the counters together, to a few ticks in chip 0. The slaves' levels of chip 0 appear now and not before: one
 * is the sync wire. Their requests are on only behind that, which is an update, too. */
static void counters_start(hal_t *hal) {
    const uint32_t primask = interrupts_off();
    hal_led(hal, true);
    TIM1->CR1 = TIM_CR1_ARPE | TIM_CR1_CEN;
    TIM3->EGR = TIM_EGR_UG;
    TIM3->CR1 = TIM_CR1_CEN;
    TIM4->CR1 = TIM_CR1_CEN;
    TIM8->EGR = TIM_EGR_UG;
    TIM8->CR1 = TIM_CR1_CEN;
    TIM3->SR = 0;
    TIM8->SR = 0;
    TIM3->DIER |= TIM_DIER_UDE;
    TIM8->DIER |= TIM_DIER_UDE | TIM_DIER_CC1IE;
    preload_slaves(hal, RING_CHIPS - 1u); /* For chip 1. */
    interrupts_restore(primask);
}

void hal_chips_start(hal_t *hal, hal_role_t role, const hal_events_t *events) {
    if (hal->clock == HAL_CLOCK_SLOW)
        return;
    hal->role = role;
    hal->events = *events;
    plan_block(hal, 0);
    timers_start();
    converters_start(hal);
    TIM1->ARR = hal->edges[RING_CHIPS - 1u].reload;
    TIM1->CCR1 = hal->edges[RING_CHIPS - 1u].inputs[0];
    TIM1->CCR2 = hal->edges[RING_CHIPS - 1u].inputs[1];
    preload_slaves(hal, RING_CHIPS - 2u);
    TIM1->EGR = TIM_EGR_UG; /* The preloads become shadows, for chip 0. */
    TIM1->SR = 0;
    /* Without a trigger the DAC's outputs have followed at once. */
    DAC->CR |= DAC_CR_TEN1 | DAC_CR_TEN2 | DAC_CR_DMAEN1;
    plan_block(hal, 1);
    streams_start(hal);
    if (hal_role_drives(role)) {
        bridge_fuse_start(hal);
        bridge_arm();
    }

    interrupt_enable(IRQ_DMA2_STREAM1, PRIORITY_NORMAL);
    interrupt_enable(IRQ_TIM8_CC, PRIORITY_STAMP);
    interrupt_enable(IRQ_ADC, PRIORITY_DRIVE);
    counters_start(hal);
}

/* A block boundary has come. The flags of stream 1 alternate: half at the start of odd blocks, complete at that of
 * even ones. A plan that was not written two chips before its block, or when the next boundary's flag is up already,
 * came too late. */
void DMA2_Stream1_Handler(void) {
    hal_t *hal = &board;
    for (uint32_t flag; ((flag = (hal->block & 1u) != 0 ? DMA_LISR_TCIF1 : DMA_LISR_HTIF1) & DMA2->LISR) != 0;) {
        DMA2->LIFCR = flag;
        const uint32_t finished = hal->block;
        hal->block = finished + 1u;
        hal->first_chip += HAL_BLOCK_CHIPS;
        converters_block(hal, finished, chip_now());
        if (hal_role_samples(hal->role)) {
            hal->events.samples(hal->events.context, finished, (const hal_samples_t *)&hal->samples[finished & 1u]);
        }
        plan_block(hal, finished + 2u);
        const bool overtaken = (DMA2->LISR & (DMA_LISR_TCIF1 | DMA_LISR_HTIF1)) != 0;
        const uint32_t passed = chip_now().chip - hal->first_chip;
        if (overtaken || passed >= HAL_BLOCK_CHIPS - 2u)
            hal->counters.late_blocks++;
        hal->chips_since_plan = passed;
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

/* Returns the transfers of a stream, modulo 62, each of so many items; one that is not over does not count. */
static uint32_t transfers(const DMA_stream_registers *stream, uint32_t items) {
    return (RING_CHIPS - (stream->NDTR + items - 1u) / items) % RING_CHIPS;
}

/* In the ticks behind the middle it waits, at most MIDDLE_SETTLED, until the transfer is over for certain; what it
 * tells is the time before it waited, since it is a stamp. Interrupts are off, since between the readings there must
 * not be more time than that. */
chip_time_t chip_now(void) {
    uint32_t middles, ticks;
    const uint32_t primask = interrupts_off();
    const uint32_t called = TIM8->CNT;
    do {
        middles = transfers(&DMA2->S[4], EDGE_ITEMS);
        ticks = TIM8->CNT;
    } while (ticks - MIDDLE_TICKS < MIDDLE_SETTLED);
    interrupts_restore(primask);
    const uint32_t position = ticks < MIDDLE_TICKS ? middles : before(middles);
    const bool waited = called - MIDDLE_TICKS < MIDDLE_SETTLED;
    return (chip_time_t){.chip = absolute_chip(board.first_chip, position), .ticks = waited ? called : ticks};
}

/* An edge whose count is beyond the present one came in the chip before. That is right if this interrupt is late by
 * less than a chip: only stamps of CAN frames and interrupts_off() hold it up. */
void TIM8_CC_Handler(void) {
    const uint32_t edge = TIM8->CCR1; /* Reading it clears the flag. */
    const chip_time_t now = chip_now();
    const uint32_t put = board.sync_put;
    if (put - __atomic_load_n(&board.sync_taken, __ATOMIC_ACQUIRE) == SYNC_STAMPS)
        return;
    board.sync_stamps[put % SYNC_STAMPS] = (chip_time_t){edge > now.ticks ? now.chip - 1u : now.chip, edge};
    __atomic_store_n(&board.sync_put, put + 1u, __ATOMIC_RELEASE);
    SCB->ICSR = SCB_ICSR_PENDSVSET;
}

/* Hands over the stamped edges of the sync wire, at the block interrupt's priority. */
void PendSV_Handler(void) {
    for (uint32_t taken = board.sync_taken; taken != __atomic_load_n(&board.sync_put, __ATOMIC_ACQUIRE);) {
        const chip_time_t edge = board.sync_stamps[taken % SYNC_STAMPS];
        __atomic_store_n(&board.sync_taken, ++taken, __ATOMIC_RELEASE);
        board.events.sync(board.events.context, edge.chip, (uint16_t)edge.ticks);
    }
    board.woken = true;
}

/* Returns whether a stream of the slaves has brought what is for the chip at a position. If the interrupt that asks
 * comes late, the next chip's may be there, too. */
static bool in_step(const DMA_stream_registers *stream, uint32_t items, uint32_t position) {
    const uint32_t done = transfers(stream, items);
    return done == position || before(done) == position;
}

/* The coil currents of chip c are converted behind its middle, when stream 4 has done c + 1 transfers, until the next
 * chip's. That is right if this interrupt is late by less than half a chip. The bridges stay on for two more chips if
 * the streams that bring their levels, set-points, sync wire and fuse move together, somebody plans what they bring,
 * and a beacon's currents behind the edge come, too: TIM3 starts them, whose stream goes on where it stands. Where a
 * break was first, its interrupt comes next, and tells why there is no current. */
static void take_currents(const uint16_t count[HAL_CHANNELS]) {
    const uint32_t position = before(transfers(&DMA2->S[4], EDGE_ITEMS));
    const bool planned = board.chips_since_plan < RING_CHIPS + HAL_BLOCK_CHIPS;
    const bool edge = board.edge_taken || hal_role_samples(board.role);
    board.edge_taken = false;
    board.chips_since_plan += planned ? 1u : 0u;
    if (planned && edge && in_step(&DMA2->S[1], EDGE_8_ITEMS, position) && in_step(&DMA1->S[5], 1u, position) &&
        in_step(&DMA1->S[2], 1u, position) && in_step(&DMA2->S[7], 1u, position))
        bridge_watch();
    if (!bridge_lost())
        board.events.current(board.events.context, absolute_chip(board.first_chip, position), count);
}

/* The converters have something: what is injected, or what lies behind an edge. If both are there, this is late, and
 * the currents of the chip before are the older ones. */
void ADC_Handler(void) {
    uint16_t count[HAL_CHANNELS];
    const look_t look = converters_take(&board, count);
    if (look == LOOK_END) {
        take_currents(count);
    } else if (look == LOOK_MIDDLE && !bridge_lost()) {
        board.events.middle(board.events.context, chip_now().chip, count);
    }
    if (converters_take_edge(&board, count)) {
        board.edge_taken = true;
        if (!bridge_lost())
            board.events.edge(board.events.context, chip_now().chip, count);
        converters_behind_edge(&board);
    }
}

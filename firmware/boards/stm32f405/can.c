/* can.c: CAN1 on PB8 and PB9, 29-bit data frames only.
 *
 * Bit timing; CiA asks for a sample point of about 75 to 87.5 %. Below 1 Mbit/s the quanta are as short as they can be,
 * since stamps of received frames scatter by one.
 *   clock    rate               divided by   quanta              sample point   quantum
 *   42 MHz   1 Mbit/s               3        14 = 1 + 10 + 3     78.6 %          71 ns
 *            500, 250, 125 k     4, 8, 16    21 = 1 + 16 + 4     81.0 %          95, 190, 381 ns
 *   16 MHz   all              1, 2, 4, 8     16 = 1 + 12 + 3     81.3 %
 *
 * Stamped frames (hal.h) come through FIFO 1, alone there, so that its interrupt tells of no others. That interrupt
 * and the mailboxes' have a priority above all that takes long, and first of all look at the chip timer; only each
 * other, the sync wire's stamp and interrupts_off() (at most 40 instructions) hold them up. FIFO 0 has three frames,
 * the shortest of which take 67 us each: its interrupt must not wait for the block interrupt, which takes longer.
 *
 * The controller leaves the bus on 256 errors and comes back by itself (ABOM). It joins the bus when it has seen 11
 * recessive bits. Nobody waits for that: without a bus, hal_can_send() returns false and the rest of the board runs.
 */

#include "boards/board.h"
#include "boards/stm32f405/stm32f405.h"

/* Received frames that may wait for main: at 1 Mbit/s 8.5 ms of the shortest, 14 ms of those with 8 bytes. */
#define RECEIVE_BUFFER 128u
#define STAMPS         8u /* Stamped frames that may wait (hal.h). */

#define MODE_TRIES 10000u /* Tries of waiting for the controller to change its mode. */
/* No DMA touches it. */
static struct {
    /* How early receivers stamp a frame. It is valid for its transmitter at the end of the last bit of its end of
     * frame, for receivers at that of the last but one (Bosch, CAN 2.0, part B, 5; ISO 11898-1). They take the bus's
     * edges up to a quantum late, half of one in the mean. */
    uint32_t early_ticks;
    volatile uint32_t put, taken; /* Frames since reset: put in by the interrupt, taken by main. */
    bool off;                     /* The controller is off the bus. */
    hal_frame_t frames[RECEIVE_BUFFER];
    hal_frame_t mailbox[3];          /* The frame that was handed to each mailbox. */
    uint32_t stamp_put, stamp_taken; /* Stamps since reset, from the stamping interrupts to plan. */
    hal_stamp_t stamps[STAMPS];
    uint32_t stamped_put, stamped_taken; /* Frames since reset that were received there, to main. */
    hal_frame_t stamped[STAMPS];
} can BOARD_CORE_MEMORY;

typedef struct {
    uint32_t divide;         /* Clocks of a quantum. */
    uint32_t before, behind; /* Quanta of segments 1 and 2; the bit may be changed by the latter. */
} bit_timing_t;

static bit_timing_t bit_timing(hal_clock_t clock, uint32_t bit_s) {
    const uint32_t slower = 1000000u / bit_s;
    if (clock == HAL_CLOCK_SLOW)
        return (bit_timing_t){slower, 12u, 3u};
    return slower == 1u ? (bit_timing_t){3u, 10u, 3u} : (bit_timing_t){2u * slower, 16u, 4u};
}

void can_start(const hal_t *hal, uint32_t bit_s) {
    const bit_timing_t timing = bit_timing(hal->clock, bit_s);
    const uint32_t quantum_ticks = 4u * timing.divide;
    can.early_ticks = HAL_TICKS_PER_SECOND / bit_s - quantum_ticks / 2u;
    /* SLEEP 0 and INRQ 1 bring it out of sleep into initialisation. Frames leave in the order of requests (TXFP). */
    const uint32_t mode = CAN_MCR_ABOM | CAN_MCR_TXFP;
    CAN1->MCR = mode | CAN_MCR_INRQ;
    if (!wait_for(&CAN1->MSR, CAN_MSR_INAK, CAN_MSR_INAK, MODE_TRIES))
        return;
    CAN1->BTR = (timing.behind - 1u) << 24 | (timing.behind - 1u) << 20 | (timing.before - 1u) << 16 |
                (timing.divide - 1u);

    /* The filters have 32 bits with mask and take extended frames that are not remote: 0 and 1 the stamped types, to
     * FIFO 1; 2 any, to FIFO 0. The lower number goes first. */
    CAN1->FMR |= CAN_FMR_FINIT;
    CAN1->FA1R &= ~7u;
    CAN1->FM1R &= ~7u;
    CAN1->FS1R |= 7u;
    CAN1->FFA1R = (CAN1->FFA1R & ~7u) | 3u;
    CAN1->F0R1 = HAL_CAN_STAMP_0 << 3 | CAN_TI0R_IDE;
    CAN1->F0R2 = HAL_CAN_TYPE_MASK << 3 | CAN_TI0R_IDE | CAN_TI0R_RTR;
    CAN1->F1R1 = HAL_CAN_STAMP_1 << 3 | CAN_TI0R_IDE;
    CAN1->F1R2 = HAL_CAN_TYPE_MASK << 3 | CAN_TI0R_IDE | CAN_TI0R_RTR;
    CAN1->F2R1 = CAN_TI0R_IDE;
    CAN1->F2R2 = CAN_TI0R_IDE | CAN_TI0R_RTR;
    CAN1->FA1R |= 7u;
    CAN1->FMR &= ~CAN_FMR_FINIT;

    CAN1->ESR = CAN_ESR_LEC; /* The code 7 says that there was none yet. */
    CAN1->IER = CAN_IER_TMEIE | CAN_IER_FMPIE0 | CAN_IER_FMPIE1 | CAN_IER_BOFIE | CAN_IER_LECIE | CAN_IER_ERRIE;
    CAN1->MCR = mode;
    interrupt_enable(IRQ_CAN1_TX, PRIORITY_STAMP);
    interrupt_enable(IRQ_CAN1_RX1, PRIORITY_STAMP);
    interrupt_enable(IRQ_CAN1_RX0, PRIORITY_DRIVE);
    interrupt_enable(IRQ_CAN1_SCE, PRIORITY_NORMAL);
}

void can_deaf(bool deaf) {
    if (deaf)
        CAN1->FMR |= CAN_FMR_FINIT; /* Nothing is received meanwhile (RM0090, CAN_FMR). */
    else
        CAN1->FMR &= ~CAN_FMR_FINIT;
}

bool hal_can_send(hal_t *hal, const hal_frame_t *frame) {
    (void)hal;
    const uint32_t status = CAN1->TSR;
    if ((status & (CAN_TSR_TME0 | CAN_TSR_TME1 | CAN_TSR_TME2)) == 0 || (CAN1->MSR & CAN_MSR_INAK) != 0 ||
        frame->length > 8)
        return false;
    const uint32_t number = (status & CAN_TSR_CODE) >> 24;
    can.mailbox[number] = *frame;
    memory_barrier();
    CAN_mailbox_registers *mailbox = &CAN1->T[number];
    const uint8_t *d = frame->data;
    mailbox->TDTR = frame->length;
    mailbox->TDLR = (uint32_t)d[0] | (uint32_t)d[1] << 8 | (uint32_t)d[2] << 16 | (uint32_t)d[3] << 24;
    mailbox->TDHR = (uint32_t)d[4] | (uint32_t)d[5] << 8 | (uint32_t)d[6] << 16 | (uint32_t)d[7] << 24;
    mailbox->TIR = frame->id << 3 | CAN_TI0R_IDE | CAN_TI0R_TXRQ;
    return true;
}

static void stamp(const hal_frame_t *frame, bool sent, chip_time_t now) {
    const uint32_t put = can.stamp_put;
    if ((TIM1->CR1 & TIM_CR1_CEN) == 0 || put - __atomic_load_n(&can.stamp_taken, __ATOMIC_ACQUIRE) == STAMPS)
        return;
    can.stamps[put % STAMPS] = (hal_stamp_t){.frame = *frame, .sent = sent, .chip = now.chip, .ticks = now.ticks};
    __atomic_store_n(&can.stamp_put, put + 1u, __ATOMIC_RELEASE);
}

bool hal_can_stamp(hal_t *hal, hal_stamp_t *stamp) {
    (void)hal;
    const uint32_t taken = can.stamp_taken;
    if (taken == __atomic_load_n(&can.stamp_put, __ATOMIC_ACQUIRE))
        return false;
    *stamp = can.stamps[taken % STAMPS];
    __atomic_store_n(&can.stamp_taken, taken + 1u, __ATOMIC_RELEASE);
    return true;
}

/* A mailbox has become free, and main may have more. When two have before this looks, nobody knows when the first
 * ended. */
void CAN1_TX_Handler(void) {
    const chip_time_t now = chip_now();
    const uint32_t status = CAN1->TSR, ended = status & (CAN_TSR_RQCP0 | CAN_TSR_RQCP1 | CAN_TSR_RQCP2);
    CAN1->TSR = ended;
    const hal_frame_t *frame = &can.mailbox[ended == CAN_TSR_RQCP0 ? 0 : ended == CAN_TSR_RQCP1 ? 1 : 2];
    const bool one = ended == CAN_TSR_RQCP0 || ended == CAN_TSR_RQCP1 || ended == CAN_TSR_RQCP2;
    const bool sent = (status & ended << 1) != 0; /* TXOK lies beside RQCP. */
    if (one && sent && hal_can_stamped(frame->id))
        stamp(frame, true, now);
    board.woken = true;
}

static void copy_frame(hal_frame_t *frame, uint32_t identifier, uint32_t control, uint32_t low, uint32_t high) {
    const uint32_t length = control & 15u;
    frame->id = identifier >> 3;
    frame->length = (uint8_t)(length > 8 ? 8 : length);
    for (unsigned i = 0; i < 4; i++) {
        frame->data[i] = (uint8_t)(low >> (8 * i));
        frame->data[4 + i] = (uint8_t)(high >> (8 * i));
    }
}

/* A stamped frame has come. When a second one is there before this looks, nobody knows when the first ended. */
void CAN1_RX1_Handler(void) {
    chip_time_t now = chip_now();
    const uint32_t status = CAN1->RF1R;
    if ((status & CAN_RF1R_RFOM1) != 0 || (status & CAN_RF1R_FMP1) == 0)
        return; /* The last release is still on its way. */
    hal_frame_t frame;
    copy_frame(&frame, CAN1->RI1R, CAN1->RDT1R, CAN1->RDL1R, CAN1->RDH1R);
    now.ticks += can.early_ticks;
    if ((status & CAN_RF1R_FMP1) == 1)
        stamp(&frame, false, now);
    const uint32_t put = can.stamped_put;
    if (put - __atomic_load_n(&can.stamped_taken, __ATOMIC_ACQUIRE) < STAMPS) {
        can.stamped[put % STAMPS] = frame;
        __atomic_store_n(&can.stamped_put, put + 1u, __ATOMIC_RELEASE);
    } else {
        board.counters.can_overruns++;
    }
    if ((status & CAN_RF1R_FOVR1) != 0)
        board.counters.can_overruns++;
    CAN1->RF1R = CAN_RF1R_RFOM1 | (status & CAN_RF1R_FOVR1);
    board.woken = true;
}

/* Takes one frame an interrupt; the request stays up while there are more. */
void CAN1_RX0_Handler(void) {
    const uint32_t status = CAN1->RF0R;
    if ((status & CAN_RF0R_RFOM0) != 0 || (status & CAN_RF0R_FMP0) == 0)
        return; /* The last release is still on its way. */
    if (can.put - can.taken < RECEIVE_BUFFER) {
        hal_frame_t *frame = &can.frames[can.put % RECEIVE_BUFFER];
        copy_frame(frame, CAN1->RI0R, CAN1->RDT0R, CAN1->RDL0R, CAN1->RDH0R);
        can.put++;
    } else {
        board.counters.can_overruns++;
    }
    if ((status & CAN_RF0R_FOVR0) != 0)
        board.counters.can_overruns++;
    CAN1->RF0R = CAN_RF0R_RFOM0 | (status & CAN_RF0R_FOVR0);
    board.woken = true;
}

bool hal_can_receive(hal_t *hal, hal_frame_t *frame) {
    (void)hal;
    const uint32_t taken = can.stamped_taken;
    if (taken != __atomic_load_n(&can.stamped_put, __ATOMIC_ACQUIRE)) {
        *frame = can.stamped[taken % STAMPS];
        __atomic_store_n(&can.stamped_taken, taken + 1u, __ATOMIC_RELEASE);
        return true;
    }
    if (can.put == can.taken)
        return false;
    *frame = can.frames[can.taken % RECEIVE_BUFFER];
    can.taken++;
    return true;
}

/* There was an error frame, or the controller left the bus. That is no reason to wake main. */
void CAN1_SCE_Handler(void) {
    const uint32_t status = CAN1->ESR, code = status & CAN_ESR_LEC;
    if (code != 0 && code != CAN_ESR_LEC)
        board.counters.can_errors++;
    const bool off = (status & CAN_ESR_BOFF) != 0;
    if (off && !can.off)
        board.counters.can_errors++;
    can.off = off;
    CAN1->ESR = CAN_ESR_LEC;
    CAN1->MSR = CAN_MSR_ERRI;
}

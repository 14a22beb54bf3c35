/* can.c: CAN1 at 1 Mbit/s on PB8 and PB9, 29-bit data frames only.
 *
 * A bit at 42 MHz: 3 x 14 quanta, 1 + 10 + 3, sample point 78.6 %. At 16 MHz: 1 x 16 quanta, 1 + 12 + 3, 81.3 %. CiA asks for about 75 to 87.5 %.
 * Leaves the bus on 256 errors and comes back by itself (ABOM). The controller joins the bus when it has seen 11 recessive bits; nobody waits for
 * that: without a bus, hal_can_send() says false and the rest of the board runs.
 */

#include "stm32f405.h"

#define MODE_TRIES 10000u
#define BIT_TIMING(divide, before, behind, jump) (((jump)-1u) << 24 | ((behind)-1u) << 20 | ((before)-1u) << 16 | ((divide)-1u))

void can_start(const hal_t *hal) {
    /* Out of sleep and into initialisation: SLEEP 0, INRQ 1. Frames leave in the order of requests (TXFP). */
    const uint32_t mode = CAN_MCR_ABOM | CAN_MCR_TXFP;
    CAN1->MCR = mode | CAN_MCR_INRQ;
    if (!wait_for(&CAN1->MSR, CAN_MSR_INAK, CAN_MSR_INAK, MODE_TRIES)) return;
    CAN1->BTR = hal->clock == HAL_CLOCK_SLOW ? BIT_TIMING(1u, 12u, 3u, 3u) : BIT_TIMING(3u, 10u, 3u, 3u);

    /* Filter 0, 32 bits with mask, to FIFO 0: extended and no remote frame, any identifier. */
    CAN1->FMR |= CAN_FMR_FINIT;
    CAN1->FA1R &= ~1u;
    CAN1->FM1R &= ~1u;
    CAN1->FS1R |= 1u;
    CAN1->FFA1R &= ~1u;
    CAN1->F0R1 = CAN_TI0R_IDE;
    CAN1->F0R2 = CAN_TI0R_IDE | CAN_TI0R_RTR;
    CAN1->FA1R |= 1u;
    CAN1->FMR &= ~CAN_FMR_FINIT;

    CAN1->ESR = CAN_ESR_LEC; /* 7: none yet. */
    CAN1->IER = CAN_IER_TMEIE | CAN_IER_FMPIE0 | CAN_IER_BOFIE | CAN_IER_LECIE | CAN_IER_ERRIE;
    CAN1->MCR = mode;
    interrupt_enable(IRQ_CAN1_TX, PRIORITY_NORMAL);
    interrupt_enable(IRQ_CAN1_RX0, PRIORITY_NORMAL);
    interrupt_enable(IRQ_CAN1_SCE, PRIORITY_NORMAL);
}

bool hal_can_send(hal_t *hal, const hal_frame_t *frame) {
    (void)hal;
    const uint32_t status = CAN1->TSR;
    if ((status & (CAN_TSR_TME0 | CAN_TSR_TME1 | CAN_TSR_TME2)) == 0 || (CAN1->MSR & CAN_MSR_INAK) != 0 || frame->length > 8) return false;
    CAN_mailbox_registers *mailbox = &CAN1->T[(status & CAN_TSR_CODE) >> 24];
    const uint8_t *d = frame->data;
    mailbox->TDTR = frame->length;
    mailbox->TDLR = (uint32_t)d[0] | (uint32_t)d[1] << 8 | (uint32_t)d[2] << 16 | (uint32_t)d[3] << 24;
    mailbox->TDHR = (uint32_t)d[4] | (uint32_t)d[5] << 8 | (uint32_t)d[6] << 16 | (uint32_t)d[7] << 24;
    mailbox->TIR = frame->id << 3 | CAN_TI0R_IDE | CAN_TI0R_TXRQ;
    return true;
}

/* A mailbox became free: main may have more. */
void CAN1_TX_Handler(void) {
    CAN1->TSR = CAN_TSR_RQCP0 | CAN_TSR_RQCP1 | CAN_TSR_RQCP2;
    board.woken = true;
}

/* One frame an interrupt; the request stays up while there are more. */
void CAN1_RX0_Handler(void) {
    const uint32_t status = CAN1->RF0R;
    if ((status & CAN_RF0R_RFOM0) != 0 || (status & CAN_RF0R_FMP0) == 0) return; /* The last release is still on its way. */
    if (board.can_put - board.can_taken < CAN_RECEIVE_BUFFER) {
        hal_frame_t *frame = &board.can_frames[board.can_put % CAN_RECEIVE_BUFFER];
        const uint32_t length = CAN1->RDT0R & 15u, low = CAN1->RDL0R, high = CAN1->RDH0R;
        frame->id = CAN1->RI0R >> 3;
        frame->length = (uint8_t)(length > 8 ? 8 : length);
        for (unsigned i = 0; i < 4; i++) {
            frame->data[i] = (uint8_t)(low >> (8 * i));
            frame->data[4 + i] = (uint8_t)(high >> (8 * i));
        }
        board.can_put++;
    } else {
        board.counters.can_overruns++;
    }
    if ((status & CAN_RF0R_FOVR0) != 0) board.counters.can_overruns++;
    CAN1->RF0R = CAN_RF0R_RFOM0 | (status & CAN_RF0R_FOVR0);
    board.woken = true;
}

bool hal_can_receive(hal_t *hal, hal_frame_t *frame) {
    if (hal->can_put == hal->can_taken) return false;
    *frame = hal->can_frames[hal->can_taken % CAN_RECEIVE_BUFFER];
    hal->can_taken++;
    return true;
}

/* An error frame, or off the bus. Not a reason to wake main. */
void CAN1_SCE_Handler(void) {
    const uint32_t status = CAN1->ESR, code = status & CAN_ESR_LEC;
    if (code != 0 && code != CAN_ESR_LEC) board.counters.can_errors++;
    const bool off = (status & CAN_ESR_BOFF) != 0;
    if (off && !board.can_off) board.counters.can_errors++;
    board.can_off = off;
    CAN1->ESR = CAN_ESR_LEC;
    CAN1->MSR = CAN_MSR_ERRI;
}

/* serial.c: USART1 at 2,000,000 baud on PB6 and PB7, DMA both ways.
 *
 * Out, main fills a ring; stream 7 sends the longest piece in one run, and its interrupt starts the next. In, stream 2
 * fills a ring for ever, and main takes what is there at each wake; the end of a burst (line idle) wakes main at once.
 * All positions count bytes since reset (32 bits, wrapping), so that full and empty differ and losses show.
 */

#include <string.h>

#include "boards/stm32f405/stm32f405.h"

/* Tries of waiting for a byte to leave, which takes 5 us, 840 cycles: ten times that, at about 6 cycles a try, and
 * more. */
#define BYTE_TRIES 10000u

static uint32_t smaller(uint32_t a, uint32_t b) {
    return a < b ? a : b;
}

void serial_start(hal_t *hal) {
    /* With the PLL it is 84 MHz / (16 x 2.625), without 16 MHz / (8 x 1), which needs 8-fold oversampling. Both are
     * exact. */
    const bool slow = hal->clock == HAL_CLOCK_SLOW;
    USART1->BRR = slow ? 0x10u : 0x2Au;
    USART1->CR3 = USART_CR3_DMAR | USART_CR3_DMAT | USART_CR3_EIE;
    const uint32_t enable = (slow ? USART_CR1_OVER8 : 0u) | USART_CR1_UE | USART_CR1_TE | USART_CR1_RE;
    USART1->CR1 = enable;

    DMA_stream_registers *in = &DMA2->S[2];
    DMA2->LIFCR = DMA_LIFCR_STREAM2;
    in->PAR = (uint32_t)&USART1->DR;
    in->M0AR = (uint32_t)hal->receive;
    in->NDTR = SERIAL_RECEIVE_BUFFER;
    in->CR = DMA_S0CR_CHSEL_4 | DMA_S0CR_PL_MEDIUM | DMA_S0CR_MINC | DMA_S0CR_CIRC | DMA_S0CR_TCIE;
    in->CR |= DMA_S0CR_EN;

    DMA2->S[7].PAR = (uint32_t)&USART1->DR;

    USART1->CR1 = enable | USART_CR1_IDLEIE;
    interrupt_enable(IRQ_USART1, PRIORITY_NORMAL);
    interrupt_enable(IRQ_DMA2_STREAM2, PRIORITY_NORMAL);
    interrupt_enable(IRQ_DMA2_STREAM7, PRIORITY_NORMAL);
}

/* ---- Out ---- */

/* Sends the longest piece that lies in one run. The stream is off, and its interrupt cannot come between. */
static void send_piece(hal_t *hal) {
    const uint32_t position = hal->sent % HAL_SERIAL_BUFFER;
    hal->sending = smaller(hal->written - hal->sent, HAL_SERIAL_BUFFER - position);
    if (hal->sending == 0)
        return;
    DMA_stream_registers *out = &DMA2->S[7];
    DMA2->HIFCR = DMA_HIFCR_STREAM7;
    out->M0AR = (uint32_t)&hal->transmit[position];
    out->NDTR = hal->sending;
    out->CR = DMA_S0CR_CHSEL_4 | DMA_S0CR_MINC | DMA_S0CR_DIR_TO_PERIPHERAL | DMA_S0CR_TCIE | DMA_S0CR_TEIE;
    memory_barrier();
    out->CR |= DMA_S0CR_EN;
}

/* A flag that was just cleared may still raise its interrupt once: both handlers look first. */
void DMA2_Stream7_Handler(void) {
    if ((DMA2->HISR & (DMA_HISR_TCIF7 | DMA_HISR_TEIF7)) == 0)
        return;
    DMA2->HIFCR = DMA_HIFCR_STREAM7;
    board.sent += board.sending;
    send_piece(&board);
    board.woken = true;
}

bool hal_serial_write(hal_t *hal, const uint8_t *bytes, size_t count) {
    if (count > HAL_SERIAL_BUFFER - (hal->written - hal->sent))
        return false;
    const uint32_t position = hal->written % HAL_SERIAL_BUFFER;
    const uint32_t head = smaller((uint32_t)count, HAL_SERIAL_BUFFER - position);
    memcpy(&hal->transmit[position], bytes, head);
    memcpy(hal->transmit, bytes + head, count - head);

    const uint32_t primask = interrupts_off();
    hal->written += (uint32_t)count;
    if (hal->sending == 0)
        send_piece(hal);
    interrupts_restore(primask);
    return true;
}

/* DMA pauses while its request is masked, and goes on where it was. */
void hal_serial_write_polled(hal_t *hal, const uint8_t *bytes, size_t count) {
    (void)hal;
    USART1->CR3 &= ~USART_CR3_DMAT;
    for (size_t i = 0; i < count; i++) {
        wait_for(&USART1->SR, USART_SR_TXE, USART_SR_TXE, BYTE_TRIES);
        USART1->DR = bytes[i];
    }
    wait_for(&USART1->SR, USART_SR_TXE, USART_SR_TXE, BYTE_TRIES);
    USART1->CR3 |= USART_CR3_DMAT;
}

/* ---- In ---- */

void DMA2_Stream2_Handler(void) {
    if ((DMA2->LISR & DMA_LISR_TCIF2) == 0)
        return;
    DMA2->LIFCR = DMA_LIFCR_STREAM2;
    board.receive_wraps++;
    board.woken = true;
}

/* The line is idle, or there was a receive error. The flags go by reading SR and then DR; a byte that waits is left to
 * DMA, whose read of DR clears them as well. */
void USART1_Handler(void) {
    const uint32_t status = USART1->SR;
    if ((status & USART_SR_RXNE) == 0)
        (void)USART1->DR;
    if ((status & USART_SR_ORE) != 0)
        board.counters.serial_overruns++;
    board.woken = true;
}

/* Returns the bytes since reset that arrived. A wrap whose interrupt is still pending counts. */
static uint32_t received(const hal_t *hal) {
    const uint32_t primask = interrupts_off();
    uint32_t left = DMA2->S[2].NDTR;
    uint32_t wraps = hal->receive_wraps;
    if ((DMA2->LISR & DMA_LISR_TCIF2) != 0) {
        wraps++;
        left = DMA2->S[2].NDTR;
    }
    interrupts_restore(primask);
    return wraps * SERIAL_RECEIVE_BUFFER + SERIAL_RECEIVE_BUFFER - left;
}

size_t hal_serial_read(hal_t *hal, uint8_t *bytes, size_t capacity) {
    if ((DMA2->S[2].CR & DMA_S0CR_EN) == 0)
        return 0; /* Nothing receives. */
    const uint32_t waiting = received(hal) - hal->taken;
    if (waiting > SERIAL_RECEIVE_BUFFER) { /* It was overwritten: start afresh with what comes now. */
        const uint32_t primask = interrupts_off();
        hal->counters.serial_overruns += waiting;
        interrupts_restore(primask);
        hal->taken += waiting;
        return 0;
    }
    const uint32_t count = smaller(waiting, (uint32_t)capacity);
    for (uint32_t i = 0; i < count; i++)
        bytes[i] = hal->receive[(hal->taken + i) % SERIAL_RECEIVE_BUFFER];
    hal->taken += count;
    return count;
}

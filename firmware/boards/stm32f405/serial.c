/* serial.c: USART3 on PB10 and PB11, DMA1 both ways.
 *
 * The bit is a whole number of the bus's clocks, at least 8 (OVER8). Error of the rate, in 1/1000:
 *   baud      2,000,000   921,600   460,800   115,200
 *   42 MHz        0         -9.3      +1.6      -1.1
 *   16 MHz        0        +21.2      -7.9      -0.8
 * Without the PLL, at 16 MHz, 921,600 baud may be too far off for the other end.
 *
 * Out, main fills a ring; stream 3 sends the longest piece in one run, and its interrupt starts the next. In, stream 1
 * fills a ring for ever, and main takes what is there at each wake: at least once a block, and when half of the ring is
 * full. The USART itself interrupts nobody. Its flags of an idle line and of errors go by reading SR and then DR, and
 * whoever reads DR may take a byte away from DMA that came between the two: here only DMA reads it.
 * All positions count bytes since reset (32 bits, wrapping), so that full and empty differ and losses show.
 */

#include <string.h>

#include "boards/stm32f405/stm32f405.h"

/* Tries of waiting for a byte to leave, which takes 87 us at 115,200 baud, 14,600 cycles: four times that, at about 6
 * cycles a try. */
#define BYTE_TRIES 10000u

static uint32_t smaller(uint32_t a, uint32_t b) {
    return a < b ? a : b;
}

static void set_rate(const hal_t *hal, uint32_t baud) {
    const uint32_t clock = hal->clock == HAL_CLOCK_SLOW ? SLOW_HZ : HAL_TICKS_PER_SECOND / 4u;
    const uint32_t eighths = (clock + baud / 2u) / baud; /* USARTDIV in units of 1/8 (OVER8). */
    USART3->BRR = eighths / 8u << 4 | eighths % 8u;
}

void serial_start(const hal_t *hal) {
    set_rate(hal, HAL_SERIAL_BAUD);
    USART3->CR1 = USART_CR1_OVER8 | USART_CR1_UE | USART_CR1_TE;
}

void serial_open(hal_t *hal, uint32_t baud) {
    hal->transmit_room = hal_serial_room(baud);
    set_rate(hal, baud);
    USART3->CR3 = USART_CR3_DMAR | USART_CR3_DMAT;
    USART3->CR1 |= USART_CR1_RE;

    DMA_stream_registers *in = &DMA1->S[1];
    DMA1->LIFCR = DMA_LIFCR_STREAM1;
    in->PAR = (uint32_t)&USART3->DR;
    in->M0AR = (uint32_t)hal->receive;
    in->NDTR = SERIAL_RECEIVE_BUFFER;
    in->CR = DMA_S0CR_CHSEL_4 | DMA_S0CR_PL_MEDIUM | DMA_S0CR_MINC | DMA_S0CR_CIRC | DMA_S0CR_HTIE | DMA_S0CR_TCIE;
    in->CR |= DMA_S0CR_EN;

    DMA1->S[3].PAR = (uint32_t)&USART3->DR;

    interrupt_enable(IRQ_DMA1_STREAM1, PRIORITY_NORMAL);
    interrupt_enable(IRQ_DMA1_STREAM3, PRIORITY_NORMAL);
}

/* ---- Out ---- */

/* Sends the longest piece that lies in one run. The stream is off, and its interrupt cannot come between. */
static void send_piece(hal_t *hal) {
    const uint32_t position = hal->sent % HAL_SERIAL_BUFFER;
    hal->sending = smaller(hal->written - hal->sent, HAL_SERIAL_BUFFER - position);
    if (hal->sending == 0)
        return;
    DMA_stream_registers *out = &DMA1->S[3];
    DMA1->LIFCR = DMA_LIFCR_STREAM3;
    out->M0AR = (uint32_t)&hal->transmit[position];
    out->NDTR = hal->sending;
    out->CR = DMA_S0CR_CHSEL_4 | DMA_S0CR_MINC | DMA_S0CR_DIR_TO_PERIPHERAL | DMA_S0CR_TCIE | DMA_S0CR_TEIE;
    memory_barrier();
    out->CR |= DMA_S0CR_EN;
}

/* A flag that was just cleared may still raise its interrupt once: both handlers look first. */
void DMA1_Stream3_Handler(void) {
    if ((DMA1->LISR & (DMA_LISR_TCIF3 | DMA_LISR_TEIF3)) == 0)
        return;
    DMA1->LIFCR = DMA_LIFCR_STREAM3;
    board.sent += board.sending;
    send_piece(&board);
    board.woken = true;
}

bool hal_serial_write(hal_t *hal, const uint8_t *bytes, size_t count) {
    if (hal->written - hal->sent + (uint32_t)count > hal->transmit_room)
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

uint32_t hal_serial_waiting(const hal_t *hal) {
    return hal->written - hal->sent;
}

/* DMA pauses while its request is masked, and goes on where it was. */
void hal_serial_write_polled(hal_t *hal, const uint8_t *bytes, size_t count) {
    (void)hal;
    USART3->CR3 &= ~USART_CR3_DMAT;
    for (size_t i = 0; i < count; i++) {
        wait_for(&USART3->SR, USART_SR_TXE, USART_SR_TXE, BYTE_TRIES);
        USART3->DR = bytes[i];
    }
    wait_for(&USART3->SR, USART_SR_TXE, USART_SR_TXE, BYTE_TRIES);
    USART3->CR3 |= USART_CR3_DMAT;
}

/* ---- In ---- */

void DMA1_Stream1_Handler(void) {
    const uint32_t flags = DMA1->LISR & (DMA_LISR_HTIF1 | DMA_LISR_TCIF1);
    if (flags == 0)
        return;
    DMA1->LIFCR = flags;
    board.receive_wraps += (flags & DMA_LISR_TCIF1) != 0 ? 1u : 0u;
    board.woken = true;
}

/* Counts an overrun once. Its flag stays up until DMA reads the next byte behind this reading of SR. */
static void look_for_overrun(hal_t *hal) {
    const bool overrun = (USART3->SR & USART_SR_ORE) != 0;
    if (overrun && !hal->receive_overrun)
        hal->counters.serial_overruns++;
    hal->receive_overrun = overrun;
}

/* Returns the bytes since reset that arrived. A wrap whose interrupt is still pending counts. */
static uint32_t received(const hal_t *hal) {
    const uint32_t primask = interrupts_off();
    uint32_t left = DMA1->S[1].NDTR;
    uint32_t wraps = hal->receive_wraps;
    if ((DMA1->LISR & DMA_LISR_TCIF1) != 0) {
        wraps++;
        left = DMA1->S[1].NDTR;
    }
    interrupts_restore(primask);
    return wraps * SERIAL_RECEIVE_BUFFER + SERIAL_RECEIVE_BUFFER - left;
}

size_t hal_serial_read(hal_t *hal, uint8_t *bytes, size_t capacity) {
    if ((DMA1->S[1].CR & DMA_S0CR_EN) == 0)
        return 0; /* Nothing receives. */
    look_for_overrun(hal);
    const uint32_t waiting = received(hal) - hal->taken;
    if (waiting > SERIAL_RECEIVE_BUFFER) { /* It was overwritten: start afresh with what comes now. */
        hal->counters.serial_overruns += waiting;
        hal->taken += waiting;
        return 0;
    }
    const uint32_t count = smaller(waiting, (uint32_t)capacity);
    for (uint32_t i = 0; i < count; i++)
        bytes[i] = hal->receive[(hal->taken + i) % SERIAL_RECEIVE_BUFFER];
    hal->taken += count;
    return count;
}

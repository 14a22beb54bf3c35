/* usart.c: USART1, 2, 3, 6 and UART4, 5 in asynchronous mode (RM0090 chapter 30).
 *
 * Bytes take their frame time at the rate that BRR sets; they leave only if a pin is in the transmitter's alternate
 * function, and arrive likewise. IDLE is known only when the next byte can no longer have begun within the idle frame,
 * so it comes one frame late. Using what is not modelled is a violation: synchronous, half-duplex, smartcard, IrDA and
 * LIN modes, hardware flow control, mute, break.
 */
#include "emulator/peripherals/model.h"
#include "emulator/peripherals/outside.h"

#include <math.h>

enum { SR = 0x00, DR = 0x04, BRR = 0x08, CR1 = 0x0C, CR2 = 0x10, CR3 = 0x14, GTPR = 0x18 };
#define PE    1u
#define FE    2u
#define NF    4u
#define ORE   8u
#define IDLE  0x10u
#define RXNE  0x20u
#define TC    0x40u
#define TXE   0x80u
#define OVER8 0x8000u
#define UE    0x2000u
#define M     0x1000u
#define PCE   0x400u
#define TE    8u
#define RE    4u
#define RWU   2u
#define SBK   1u
#define DMAT  0x80u
#define DMAR  0x40u
/* Largest mismatch of the two ends' bit rates (RM0090 30.3.5, at a 10-bit frame), and the tolerance to the given
 * rate. */
#define RATE_TOLERANCE 0.03

static const register_layout_t usart_registers[] = {
    {"SR", SR, 0x000000C0, 0x3FF, ACCESS_RC_W0}, {"DR", DR, 0, 0x1FF, ACCESS_RW},    {"BRR", BRR, 0, 0xFFFF, ACCESS_RW},
    {"CR1", CR1, 0, 0xBFFF, ACCESS_RW},          {"CR2", CR2, 0, 0x7F6F, ACCESS_RW}, {"CR3", CR3, 0, 0xFFF, ACCESS_RW},
    {"GTPR", GTPR, 0, 0xFFFF, ACCESS_RW},
};
static const register_layout_t uart_registers[] = {
    {"SR", SR, 0x000000C0, 0x1FF, ACCESS_RC_W0}, {"DR", DR, 0, 0x1FF, ACCESS_RW},    {"BRR", BRR, 0, 0xFFFF, ACCESS_RW},
    {"CR1", CR1, 0, 0xBFFF, ACCESS_RW},          {"CR2", CR2, 0, 0x706F, ACCESS_RW}, {"CR3", CR3, 0, 0x8CF, ACCESS_RW},
};

typedef struct {
    const char *name;
    uint32_t base;
    bus_t bus;
    unsigned number, irq, alternate;
    dma_source_t receive, transmit;
    uint8_t tx[3], rx[3]; /* Pins; the last is repeated where there are fewer. */
} usart_description_t;

#define PIN(port, pin) (uint8_t)((port - 'A') * 16 + pin)
static const usart_description_t what[USART_COUNT] = {
    {"USART1",
     0x40011000,
     BUS_APB2,
     1,
     37,
     7,
     DMA_USART1_RX,
     DMA_USART1_TX,
     {PIN('A', 9), PIN('B', 6), PIN('B', 6)},
     {PIN('A', 10), PIN('B', 7), PIN('B', 7)}},
    {"USART2",
     0x40004400,
     BUS_APB1,
     2,
     38,
     7,
     DMA_USART2_RX,
     DMA_USART2_TX,
     {PIN('A', 2), PIN('D', 5), PIN('D', 5)},
     {PIN('A', 3), PIN('D', 6), PIN('D', 6)}},
    {"USART3",
     0x40004800,
     BUS_APB1,
     3,
     39,
     7,
     DMA_USART3_RX,
     DMA_USART3_TX,
     {PIN('B', 10), PIN('C', 10), PIN('D', 8)},
     {PIN('B', 11), PIN('C', 11), PIN('D', 9)}},
    {"UART4",
     0x40004C00,
     BUS_APB1,
     4,
     52,
     8,
     DMA_UART4_RX,
     DMA_UART4_TX,
     {PIN('A', 0), PIN('C', 10), PIN('C', 10)},
     {PIN('A', 1), PIN('C', 11), PIN('C', 11)}},
    {"UART5",
     0x40005000,
     BUS_APB1,
     5,
     53,
     8,
     DMA_UART5_RX,
     DMA_UART5_TX,
     {PIN('C', 12), PIN('C', 12), PIN('C', 12)},
     {PIN('D', 2), PIN('D', 2), PIN('D', 2)}},
    {"USART6",
     0x40011400,
     BUS_APB2,
     6,
     71,
     8,
     DMA_USART6_RX,
     DMA_USART6_TX,
     {PIN('C', 6), PIN('G', 14), PIN('G', 14)},
     {PIN('C', 7), PIN('G', 9), PIN('G', 9)}},
};

struct usart {
    model_t model;
    const usart_description_t *what;
    bool shifting, held; /* A frame is on its way; the data register holds the next. */
    uint8_t shift, hold;
    bool status_read; /* SR was read: the next access to DR clears flags. */
    uint32_t seen;    /* The flags that were read. */
    uint16_t received;
    machine_event_t sent, idle;
};

static bool on(const usart_t *u, uint32_t bits) {
    return (reg(&u->model, CR1) & bits) == bits;
}

static bool pin_connected(const usart_t *u, const uint8_t pins[3]) {
    for (unsigned i = 0; i < 3; i++) {
        if (chip_pin_is_alternate(u->model.chip, pins[i], u->what->alternate)) {
            return true;
        }
    }
    return false;
}

static double baud(const usart_t *u) {
    const clock_domain_t *const bus = u->what->bus == BUS_APB2 ? &u->model.chip->pclk2 : &u->model.chip->pclk1;
    const uint32_t brr = reg(&u->model, BRR);
    const bool over8 = on(u, OVER8);
    const uint32_t sixteenths = over8 ? (brr >> 4) * 8 + (brr & 7u) : brr; /* USARTDIV in units of 1/16, or of 1/8 */
    return sixteenths == 0 ? 0 : bus->hz / sixteenths;
}

static double frame_bits(const usart_t *u) {
    static const double stops[4] = {1, 0.5, 2, 1.5};
    return 1 + (on(u, M) ? 9 : 8) + stops[field(reg(&u->model, CR2), 12, 2)];
}

static void signals(usart_t *u) {
    chip_t *const chip = u->model.chip;
    const uint32_t sr = reg(&u->model, SR), cr1 = reg(&u->model, CR1), cr3 = reg(&u->model, CR3);
    const bool errors = (cr3 & 1u) != 0 && (cr3 & DMAR) != 0 && (sr & (FE | ORE | NF)) != 0;
    const bool level = (cr1 & UE) != 0 && (((cr1 & 0x100u) && (sr & PE)) || ((cr1 & 0x80u) && (sr & TXE)) ||
                                           ((cr1 & 0x40u) && (sr & TC)) || ((cr1 & 0x20u) && (sr & (RXNE | ORE))) ||
                                           ((cr1 & 0x10u) && (sr & IDLE)) || errors);
    machine_irq(chip->machine, u->what->irq, level);
    dma_line(chip, u->what->receive, (cr3 & DMAR) && (sr & RXNE) && (cr1 & UE));
    dma_line(chip, u->what->transmit, (cr3 & DMAT) && (sr & TXE) && (cr1 & UE) && (cr1 & TE));
}

/* ---- Sending ---- */

static void send(usart_t *u, uint8_t byte, int64_t time_ps) {
    const double rate = baud(u);
    u->shift = byte;
    u->shifting = true;
    u->model.value[SR / 4] &= ~TC;
    machine_schedule(u->model.machine, &u->sent, time_ps + llround(frame_bits(u) * 1e12 / rate));
}

static void byte_sent(void *context, int64_t time_ps) {
    usart_t *const u = context;
    const board_edge_t *const edge = u->model.chip->edge;
    if (!pin_connected(u, u->what->tx)) {
        machine_violation(u->model.machine,
                          "%s: a byte was sent, but no pin is in its alternate function %u: it is lost",
                          model_name(&u->model), u->what->alternate);
    } else if (edge->uart_out) {
        edge->uart_out(edge->context, u->what->number, u->shift, time_ps);
    }
    u->shifting = false;
    if (u->held) {
        u->held = false;
        send(u, u->hold, time_ps);
        u->model.value[SR / 4] |= TXE;
    } else {
        u->model.value[SR / 4] |= TC;
    }
    signals(u);
}

static void write_data(usart_t *u, uint32_t value) {
    uint32_t *const sr = &u->model.value[SR / 4];
    if (!on(u, UE | TE)) {
        machine_violation(u->model.machine, "%s_DR: written while UE or TE is 0", model_name(&u->model));
        return;
    }
    if (baud(u) == 0 || (on(u, OVER8) && (reg(&u->model, BRR) & 8u) != 0) || reg(&u->model, BRR) < 16) {
        machine_violation(u->model.machine, "%s_BRR: 0x%04X is no legal divider", model_name(&u->model),
                          (unsigned)reg(&u->model, BRR));
        return;
    }
    if (u->status_read) {
        *sr &= ~TC;
    }
    if (u->held) {
        machine_violation(u->model.machine, "%s_DR: written while TXE is 0: the byte before is lost",
                          model_name(&u->model));
    }
    if (u->shifting) {
        u->held = true;
        u->hold = (uint8_t)value;
        *sr &= ~TXE;
    } else {
        send(u, (uint8_t)value, machine_now(u->model.machine)); /* TXE stays: the shift register took it at once. */
    }
    signals(u);
}

/* ---- Receiving ---- */

static void idle_line(void *context, int64_t time_ps) {
    usart_t *const u = context;
    (void)time_ps;
    u->model.value[SR / 4] |= IDLE;
    signals(u);
}

void usart_byte_in(machine_t *machine, unsigned uart, uint8_t byte, uint32_t rate, int64_t time_ps) {
    chip_t *const chip = chip_of(machine);
    if (uart < 1 || uart > USART_COUNT) {
        machine_violation(machine, "USART: there is no serial port %u", uart);
        return;
    }
    usart_t *const u = chip->usart[uart - 1];
    const double own = baud(u);
    if (!u->model.clocked || !on(u, UE | RE) || own == 0 || !pin_connected(u, u->what->rx)) {
        return; /* Nobody listens. */
    }
    uint32_t *const sr = &u->model.value[SR / 4];
    machine_schedule(machine, &u->idle, time_ps + llround(2 * frame_bits(u) * 1e12 / own));
    if (*sr & RXNE) {
        *sr |= ORE;
        machine_violation(machine, "%s: overrun, byte 0x%02X was lost (ORE)", model_name(&u->model), byte);
        signals(u);
        return;
    }
    if (fabs(rate / own - 1) > RATE_TOLERANCE) {
        *sr |= FE;
    }
    u->received = byte;
    *sr |= RXNE;
    signals(u);
}

/* ---- Registers ---- */

static uint32_t get(model_t *model, uint32_t offset) {
    usart_t *const u = (usart_t *)model;
    uint32_t *const sr = &model->value[SR / 4];
    if (offset == SR) {
        u->status_read = true;
        u->seen = *sr;
        return *sr;
    }
    if (offset == DR) {
        *sr &= ~RXNE;
        if (u->status_read) {
            *sr &= ~(u->seen & (PE | FE | NF | ORE | IDLE));
        }
        u->status_read = false;
        signals(u);
        return u->received;
    }
    return reg(model, offset);
}

static void check(usart_t *u, uint32_t offset, uint32_t value) {
    const char *missing = NULL;
    if (offset == CR1 && (value & (M | PCE | RWU | SBK | 0x800u)) != 0) {
        missing = "9-bit frames, parity, mute and break";
    } else if (offset == CR2 && (value & 0x4F6Fu) != 0) {
        missing = "LIN, the clock output and addresses";
    } else if (offset == CR3 && (value & 0x73Eu) != 0) {
        missing = "half-duplex, IrDA, smartcard and hardware flow control";
    }
    if (missing != NULL) {
        model_missing(&u->model, missing);
    }
    if (offset == CR1 && !(value & UE) && (u->shifting || u->held)) {
        machine_violation(u->model.machine, "%s_CR1: UE cleared while a frame is on its way (wait for TC)",
                          model_name(&u->model));
    }
    if (offset == BRR && (u->shifting || u->held)) {
        machine_violation(u->model.machine, "%s_BRR: changed while a frame is on its way", model_name(&u->model));
    }
    if (offset == CR1 && ((reg(&u->model, CR1) ^ value) & OVER8) != 0 && (reg(&u->model, CR1) & UE) != 0) {
        machine_violation(u->model.machine, "%s_CR1: OVER8 may change only while UE is 0", model_name(&u->model));
    }
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    usart_t *const u = (usart_t *)model;
    switch (offset) {
    case SR:
        model->value[SR / 4] &= value | ~(RXNE | TC | 0x300u);
        break;
    case DR:
        write_data(u, value);
        u->status_read = false;
        return;
    default: {
        check(u, offset, value);
        const bool begins = offset == CR1 && (value & (UE | TE)) == (UE | TE) && !on(u, UE | TE);
        model->value[offset / 4] = value;
        if (begins && !u->shifting) {
            model->value[SR / 4] |= TXE | TC;
        }
        if (offset == CR1 && !on(u, UE | RE)) {
            machine_cancel(model->machine, &u->idle);
        }
        break;
    }
    }
    signals(u);
}

static void restart(model_t *model) {
    usart_t *const u = (usart_t *)model;
    machine_cancel(model->machine, &u->sent);
    machine_cancel(model->machine, &u->idle);
    u->shifting = u->held = u->status_read = false;
    u->received = 0;
    model->value[SR / 4] = TXE | TC;
    signals(u);
}

void usart_create(chip_t *chip) {
    struct storage {
        usart_t usart[USART_COUNT];
        model_description_t description[USART_COUNT];
    } *const storage = chip_allocate(chip, sizeof *storage);
    for (unsigned i = 0; i < USART_COUNT; i++) {
        usart_t *const u = &storage->usart[i];
        const bool full = what[i].number != 4 && what[i].number != 5;
        chip->usart[i] = u;
        u->what = &what[i];
        machine_event_init(&u->sent, byte_sent, u);
        machine_event_init(&u->idle, idle_line, u);
        storage->description[i] = (model_description_t){
            .name = what[i].name,
            .base = what[i].base,
            .size = 0x400,
            .bus = what[i].bus,
            .read_widths = WIDTH_ANY,
            .write_widths = WIDTH_ANY,
            .registers = full ? usart_registers : uart_registers,
            .register_count = full ? sizeof usart_registers / sizeof usart_registers[0]
                                   : sizeof uart_registers / sizeof uart_registers[0],
            .get = get,
            .set = set,
            .restart = restart};
        model_attach(chip, &u->model, &storage->description[i]);
    }
}

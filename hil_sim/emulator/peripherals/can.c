/* can.c: bxCAN (RM0090 chapter 32). CAN1 is on the network; CAN2's registers are there, its pins lead nowhere.
 *
 * A request goes to the edge, and the network answers when the frame is through (can_frame_sent). By identifier (TXFP 0) every waiting mailbox is handed over and the network
 * arbitrates; in order of request (TXFP 1) one at a time. The network runs at 1 Mbit/s: a controller that is off by more than 0.5 % hears errors only.
 * A received frame is stored, and its interrupt requested, at the first time quantum of this controller's own clock at or after the moment at which it is valid: a
 * controller synchronises to the bus in whole quanta, so time stamps of receivers jitter by up to one. The sender's own end is not rounded.
 * A frame without acknowledge counts 8 transmit errors up to 128 (error passive): so a lone node never goes bus-off.
 * Not there, and loud: time-triggered mode. Time stamps read 0.
 */
#include "can_filter.h"
#include "model.h"

#include <math.h>
#include <string.h>

enum { MCR = 0x00, MSR = 0x04, TSR = 0x08, RF0R = 0x0C, RF1R = 0x10, IER = 0x14, ESR = 0x18, BTR = 0x1C, TI0R = 0x180, RI0R = 0x1B0, FMR = 0x200, FM1R = 0x204, FS1R = 0x20C, FFA1R = 0x214,
       FA1R = 0x21C, F0R1 = 0x240 };
#define INRQ 1u
#define SLEEP 2u
#define TXFP 4u
#define RFLM 8u
#define NART 0x10u
#define AWUM 0x20u
#define TTCM 0x80u
#define MASTER_RESET 0x8000u
#define INAK 1u
#define SLAK 2u
#define ERRI 4u
#define WKUI 8u
#define SLAKI 0x10u
#define LBKM 0x40000000u
#define SILM 0x80000000u
#define NETWORK_HZ 1e6
#define RATE_TOLERANCE 0.005
#define ERROR_FRAME_BITS 23 /* Flag, delimiter, intermission, suspended transmission of an error-passive node rounded. */

#define MAILBOX(n) \
    {"TI" #n "R", TI0R + 16 * n, 0, 0xFFFFFFFF, ACCESS_RW}, {"TDT" #n "R", TI0R + 16 * n + 4, 0, 0xFFFF010F, ACCESS_RW}, {"TDL" #n "R", TI0R + 16 * n + 8, 0, 0xFFFFFFFF, ACCESS_RW}, {"TDH" #n "R", TI0R + 16 * n + 12, 0, 0xFFFFFFFF, ACCESS_RW}
#define FIFO(n) \
    {"RI" #n "R", RI0R + 16 * n, 0, 0xFFFFFFFE, ACCESS_RO}, {"RDT" #n "R", RI0R + 16 * n + 4, 0, 0xFFFFFF0F, ACCESS_RO}, {"RDL" #n "R", RI0R + 16 * n + 8, 0, 0xFFFFFFFF, ACCESS_RO}, {"RDH" #n "R", RI0R + 16 * n + 12, 0, 0xFFFFFFFF, ACCESS_RO}
#define BANK(n) {"F" #n "R1", F0R1 + 8 * n, 0, 0xFFFFFFFF, ACCESS_RW}, {"F" #n "R2", F0R1 + 8 * n + 4, 0, 0xFFFFFFFF, ACCESS_RW}
#define CONTROL_REGISTERS                                                                                                                                     \
    {"MCR", MCR, 0x00010002, 0x000180FF, ACCESS_RW}, {"MSR", MSR, 0x00000C02, 0x00000F1F, ACCESS_RW}, {"TSR", TSR, 0x1C000000, 0xFF8F8F8F, ACCESS_RW},          \
    {"RF0R", RF0R, 0, 0x3B, ACCESS_RW}, {"RF1R", RF1R, 0, 0x3B, ACCESS_RW}, {"IER", IER, 0, 0x00038F7F, ACCESS_RW}, {"ESR", ESR, 0, 0xFFFF0077, ACCESS_RW},     \
    {"BTR", BTR, 0x01230000, 0xC37F03FF, ACCESS_RW}, MAILBOX(0), MAILBOX(1), MAILBOX(2), FIFO(0), FIFO(1)
static const register_layout_t registers[] = {
    CONTROL_REGISTERS,
    {"FMR", FMR, 0x2A1C0E01, 0x00003F01, ACCESS_RW}, {"FM1R", FM1R, 0, 0x0FFFFFFF, ACCESS_RW}, {"FS1R", FS1R, 0, 0x0FFFFFFF, ACCESS_RW}, {"FFA1R", FFA1R, 0, 0x0FFFFFFF, ACCESS_RW},
    {"FA1R", FA1R, 0, 0x0FFFFFFF, ACCESS_RW},
    BANK(0), BANK(1), BANK(2), BANK(3), BANK(4), BANK(5), BANK(6), BANK(7), BANK(8), BANK(9), BANK(10), BANK(11), BANK(12), BANK(13), BANK(14), BANK(15), BANK(16), BANK(17),
    BANK(18), BANK(19), BANK(20), BANK(21), BANK(22), BANK(23), BANK(24), BANK(25), BANK(26), BANK(27),
};
static const register_layout_t registers2[] = {CONTROL_REGISTERS};

typedef struct {
    can_t *can;
    unsigned number;
    bool pending, submitted;
    uint64_t order;
    machine_event_t retry;
} mailbox_t;

typedef struct {
    uint32_t word[4]; /* RIxR, RDTxR, RDLxR, RDHxR. */
} received_t;

struct can {
    model_t model;
    unsigned number; /* 0: CAN1 */
    mailbox_t mailbox[3];
    received_t fifo[2][3];
    uint64_t orders;
    board_frame_t arriving;
    machine_event_t mode, arrival; /* arrival: of the frame in arriving. */
};

static uint32_t *value(can_t *c, uint32_t offset) { return &c->model.value[offset / 4]; }

static double bit_rate(const can_t *c, bool nominal)
{
    const uint32_t btr = reg(&c->model, BTR);
    const clock_domain_t *const clock = &c->model.chip->pclk1;
    return (nominal ? clock->nominal_hz : clock->hz) / ((field(btr, 0, 10) + 1) * (3 + field(btr, 16, 4) + field(btr, 20, 3)));
}

static bool rate_fits(const can_t *c) { return fabs(bit_rate(c, false) / NETWORK_HZ - 1) <= RATE_TOLERANCE; }
static bool running(const can_t *c) { return c->model.clocked && (reg(&c->model, MSR) & (INAK | SLAK)) == 0; }

static bool pin(const can_t *c, bool transmit)
{
    static const uint8_t pins[2][2][4] = {{{11, 24, 48, 137}, {21, 28, 21, 28}},   /* RX: PA11, PB8, PD0, PI9; PB5, PB12 */
                                          {{12, 25, 49, 125}, {22, 29, 22, 29}}}; /* TX: PA12, PB9, PD1, PH13; PB6, PB13 */
    for (unsigned i = 0; i < 4; i++) {
        if (chip_pin_is_alternate(c->model.chip, pins[transmit][c->number][i], 9)) {
            return true;
        }
    }
    return false;
}

static void interrupts(can_t *c)
{
    static const uint8_t lines[2][4] = {{19, 20, 21, 22}, {63, 64, 65, 66}};
    const uint32_t ier = reg(&c->model, IER), tsr = reg(&c->model, TSR), msr = reg(&c->model, MSR);
    machine_t *const machine = c->model.machine;
    machine_irq(machine, lines[c->number][0], (ier & 1u) != 0 && (tsr & 0x010101u) != 0);
    for (unsigned f = 0; f < 2; f++) {
        const uint32_t rf = reg(&c->model, RF0R + 4 * f), enable = ier >> (1 + 3 * f);
        machine_irq(machine, lines[c->number][1 + f], ((enable & 1u) && (rf & 3u)) || ((enable & 2u) && (rf & 8u)) || ((enable & 4u) && (rf & 0x10u)));
    }
    machine_irq(machine, lines[c->number][3], ((ier & 0x8000u) && (msr & ERRI)) || ((ier & 0x10000u) && (msr & WKUI)) || ((ier & 0x20000u) && (msr & SLAKI)));
}

/* ---- Errors ---- */

static void errors(can_t *c, unsigned code)
{
    uint32_t *const esr = value(c, ESR);
    const unsigned transmit = field(*esr, 16, 8), receive = field(*esr, 24, 8);
    const uint32_t old = *esr;
    const unsigned worst = transmit > receive ? transmit : receive;
    *esr = (*esr & 0xFFFF0000u) | code << 4 | (worst >= 96 ? 1u : 0) | (worst >= 128 ? 2u : 0);
    const uint32_t ier = reg(&c->model, IER), risen = *esr & ~old;
    if (((ier & 0x100u) && (risen & 1u)) || ((ier & 0x200u) && (risen & 2u)) || ((ier & 0x800u) && code != 0)) {
        *value(c, MSR) |= ERRI;
    }
}

static void count_transmit(can_t *c, int step)
{
    int count = (int)field(reg(&c->model, ESR), 16, 8) + step;
    count = count < 0 ? 0 : count > 128 ? 128 : count;
    *value(c, ESR) = (reg(&c->model, ESR) & ~0x00FF0000u) | (uint32_t)count << 16;
}

static void count_receive(can_t *c, int step)
{
    int count = (int)field(reg(&c->model, ESR), 24, 8) + step;
    count = count < 0 ? 0 : count > 128 ? 128 : count;
    *value(c, ESR) = (reg(&c->model, ESR) & ~0xFF000000u) | (uint32_t)count << 24;
}

/* ---- Receiving ---- */

static void show_fifo(can_t *c, unsigned f) { memcpy(value(c, RI0R + 16 * f), c->fifo[f][0].word, sizeof c->fifo[f][0].word); }

static void store(can_t *c, unsigned f, unsigned index, const board_frame_t *frame)
{
    uint32_t *const rf = value(c, RF0R + 4 * f);
    unsigned count = *rf & 3u;
    received_t r = {.word = {frame->extended ? frame->id << 3 | 4u : frame->id << 21, (uint32_t)frame->length | index << 8, 0, 0}};
    r.word[0] |= frame->remote ? 2u : 0;
    memcpy(&r.word[2], frame->data, 8);
    if (count == 3) {
        machine_violation(c->model.machine, "%s: FIFO %u overrun, a frame was lost (FOVR)", model_name(&c->model), f);
        *rf |= 0x10u;
        if ((reg(&c->model, MCR) & RFLM) == 0) {
            c->fifo[f][2] = r;
        }
    } else {
        c->fifo[f][count] = r;
        *rf = (*rf & ~3u) | ++count;
        *rf |= count == 3 ? 8u : 0;
    }
    show_fifo(c, f);
}

static void accept(can_t *c, const board_frame_t *frame)
{
    const model_t *const shared = &c->model.chip->can[0]->model; /* CAN1 has the filters of both. */
    if (reg(shared, FMR) & 1u) {
        return; /* Filters being initialised: nothing is received. */
    }
    const unsigned split = field(reg(shared, FMR), 8, 6);
    can_filters_t filters = {.mode = reg(shared, FM1R), .scale = reg(shared, FS1R), .fifo = reg(shared, FFA1R), .active = reg(shared, FA1R),
                             .first = c->number == 0 ? 0 : split, .end = c->number == 0 ? split : 28};
    filters.end = filters.end > 28 ? 28 : filters.end;
    memcpy(filters.bank, &shared->value[F0R1 / 4], sizeof filters.bank);
    unsigned f = 0, index = 0;
    if (can_filter_match(&filters, frame, &f, &index)) {
        store(c, f, index, frame);
    }
}

/* The frame that is arriving is there. */
static void arrived(void *context, int64_t time_ps)
{
    can_t *const c = context;
    (void)time_ps;
    if (!running(c)) {
        return;
    }
    count_receive(c, -1);
    errors(c, 0);
    accept(c, &c->arriving);
    interrupts(c);
}

static int64_t next_quantum(const can_t *c, int64_t time_ps)
{
    const clock_domain_t *const clock = &c->model.chip->pclk1;
    const int64_t quantum = (int64_t)field(reg(&c->model, BTR), 0, 10) + 1;
    int64_t tick = clock_tick(clock, time_ps - 1) + 1;
    tick += (quantum - tick % quantum) % quantum;
    return clock_time(clock, tick);
}

void can_frame_in(machine_t *machine, const board_frame_t *frame, int64_t time_ps)
{
    can_t *const c = chip_of(machine)->can[0];
    if (!c->model.clocked || !pin(c, false)) {
        return;
    }
    if (reg(&c->model, MSR) & SLAK) {
        *value(c, MSR) |= WKUI;
        if (reg(&c->model, MCR) & AWUM) {
            *value(c, MCR) &= ~SLEEP;
            *value(c, MSR) &= ~SLAK;
        }
    } else if (running(c) && (reg(&c->model, BTR) & LBKM) == 0) {
        if (c->arrival.heap_index >= 0) {
            machine_violation(machine, "%s: two frames are on the bus within one time quantum", model_name(&c->model));
        } else if (rate_fits(c)) {
            c->arriving = *frame;
            machine_schedule(machine, &c->arrival, next_quantum(c, time_ps));
        } else {
            count_receive(c, 1);
            errors(c, 1);
        }
    }
    interrupts(c);
}

/* ---- Sending ---- */

static board_frame_t frame_of(can_t *c, unsigned n)
{
    const uint32_t *const m = value(c, TI0R + 16 * n);
    const unsigned length = m[1] & 15u;
    board_frame_t frame = {.extended = (m[0] & 4u) != 0, .remote = (m[0] & 2u) != 0, .length = (uint8_t)(length > 8 ? 8 : length)};
    frame.id = frame.extended ? m[0] >> 3 : m[0] >> 21;
    memcpy(frame.data, &m[2], 8);
    memset(frame.data + frame.length, 0, (size_t)(8 - frame.length));
    return frame;
}

static void finish(can_t *c, unsigned n, uint32_t result)
{
    mailbox_t *const m = &c->mailbox[n];
    machine_cancel(c->model.machine, &m->retry);
    m->pending = m->submitted = false;
    *value(c, TI0R + 16 * n) &= ~1u;
    *value(c, TSR) |= (1u | result) << (8 * n) | 1u << (26 + n);
}

static void submit(can_t *c, int64_t time_ps)
{
    const board_edge_t *const edge = c->model.chip->edge;
    const uint32_t btr = reg(&c->model, BTR);
    if (!running(c) || ((btr & SILM) && !(btr & LBKM))) {
        return;
    }
    const bool in_order = (reg(&c->model, MCR) & TXFP) != 0 || (btr & LBKM) != 0;
    for (unsigned turn = 0; turn < 3; turn++) {
        mailbox_t *first = NULL;
        bool busy = false;
        for (unsigned n = 0; n < 3; n++) {
            mailbox_t *const m = &c->mailbox[n];
            busy = busy || m->submitted;
            if (m->pending && !m->submitted && (first == NULL || m->order < first->order)) {
                first = m;
            }
        }
        if (first == NULL || (busy && in_order)) {
            return;
        }
        const board_frame_t frame = frame_of(c, first->number);
        first->submitted = true;
        if (btr & LBKM) {
            const unsigned bits = (frame.extended ? 67u : 47u) + 8u * frame.length; /* Without stuffing. */
            machine_schedule(c->model.machine, &first->retry, time_ps + llround(bits * 1e12 / bit_rate(c, false)));
        } else if (!pin(c, true)) {
            machine_violation(c->model.machine, "%s: a frame waits, but no pin is in the transmitter's alternate function 9", model_name(&c->model));
        } else if (!rate_fits(c)) {
            machine_schedule(c->model.machine, &first->retry, time_ps + llround(ERROR_FRAME_BITS * 1e12 / NETWORK_HZ)); /* Nobody understands it. */
            count_transmit(c, 8);
            errors(c, 5);
        } else if (edge->can_request && c->number == 0) {
            edge->can_request(edge->context, first->number, &frame, time_ps);
        }
    }
}

/* The end of a looped frame, or time to try again. */
static void retry(void *context, int64_t time_ps)
{
    mailbox_t *const m = context;
    can_t *const c = m->can;
    if (reg(&c->model, BTR) & LBKM) {
        const board_frame_t frame = frame_of(c, m->number);
        finish(c, m->number, 2u);
        accept(c, &frame);
    } else {
        m->submitted = false;
    }
    submit(c, time_ps);
    interrupts(c);
}

void can_frame_sent(machine_t *machine, unsigned mailbox, bool ok, int64_t time_ps)
{
    can_t *const c = chip_of(machine)->can[0];
    if (mailbox > 2 || !c->mailbox[mailbox].submitted) {
        return; /* Withdrawn meanwhile. */
    }
    count_transmit(c, ok ? -1 : 8);
    errors(c, ok ? 0 : 3);
    if (ok) {
        finish(c, mailbox, 2u);
    } else if (reg(&c->model, MCR) & NART) {
        finish(c, mailbox, 8u);
    } else {
        machine_schedule(machine, &c->mailbox[mailbox].retry, time_ps + llround(ERROR_FRAME_BITS * 1e12 / NETWORK_HZ));
    }
    submit(c, time_ps);
    interrupts(c);
}

static void withdraw(can_t *c, unsigned n, int64_t time_ps)
{
    const board_edge_t *const edge = c->model.chip->edge;
    if (c->mailbox[n].pending) {
        if (c->mailbox[n].submitted && edge->can_abort && c->number == 0) {
            edge->can_abort(edge->context, n, time_ps);
        }
        finish(c, n, 0);
    }
}

static void write_mailbox(can_t *c, uint32_t offset, uint32_t word)
{
    const unsigned n = (offset - TI0R) / 16;
    mailbox_t *const m = &c->mailbox[n];
    if (m->pending) {
        machine_violation(c->model.machine, "%s: transmit mailbox %u written while it is not empty (TME%u)", model_name(&c->model), n, n);
        return;
    }
    if (offset % 16 == 4 && ((word & 15u) > 8 || (word & 0x100u) != 0)) {
        machine_violation(c->model.machine, "%s_TDT%uR: 0x%08X: DLC above 8, or TGT without time-triggered mode", model_name(&c->model), n, (unsigned)word);
    }
    *value(c, offset) = word;
    if (offset % 16 == 0 && (word & 1u)) {
        m->pending = true;
        m->order = c->orders++;
        *value(c, TSR) &= ~(0xFu << (8 * n) | 1u << (26 + n));
        submit(c, machine_now(c->model.machine));
    }
}

/* ---- Modes ---- */

static void check_timing(can_t *c)
{
    const uint32_t btr = reg(&c->model, BTR);
    const unsigned quanta = 3 + field(btr, 16, 4) + field(btr, 20, 3);
    if (quanta < 8 || quanta > 25 || field(btr, 24, 2) > field(btr, 20, 3)) {
        machine_violation(c->model.machine, "%s_BTR: 0x%08X makes %u quanta a bit (8 to 25), or SJW is longer than segment 2", model_name(&c->model), (unsigned)btr, quanta);
    }
    if ((btr & LBKM) == 0 && fabs(bit_rate(c, true) / NETWORK_HZ - 1) > 1e-4) {
        machine_violation(c->model.machine, "%s_BTR: 0x%08X makes %.0f bit/s, the network runs at %.0f", model_name(&c->model), (unsigned)btr, bit_rate(c, true), NETWORK_HZ);
    }
}

/* The acknowledge of what MCR asks for is due. */
static void mode_reached(void *context, int64_t time_ps)
{
    can_t *const c = context;
    uint32_t *const msr = value(c, MSR);
    const uint32_t mcr = reg(&c->model, MCR), old = *msr;
    *msr &= ~(INAK | SLAK);
    *msr |= mcr & INRQ ? INAK : mcr & SLEEP ? SLAK : 0;
    if ((*msr & ~old & SLAK) != 0 && (reg(&c->model, IER) & 0x20000u)) {
        *msr |= SLAKI;
    }
    submit(c, time_ps);
    interrupts(c);
}

static void write_control(can_t *c, uint32_t word)
{
    machine_t *const machine = c->model.machine;
    const int64_t now = machine_now(machine);
    const uint32_t old = reg(&c->model, MCR);
    if (word & MASTER_RESET) {
        model_reset(&c->model);
        return;
    }
    if (word & TTCM) {
        model_missing(&c->model, "time-triggered mode");
    }
    *value(c, MCR) = word;
    if (((old ^ word) & (INRQ | SLEEP)) == 0) {
        return;
    }
    int64_t wait = 4 * (int64_t)c->model.chip->pclk1.period_ps;
    if ((word & (INRQ | SLEEP)) == 0) { /* To normal mode: after 11 recessive bits. */
        machine_cancel(machine, &c->mode);
        if ((reg(&c->model, BTR) & LBKM) == 0 && !pin(c, false)) {
            machine_violation(machine, "%s: normal mode asked for, but no pin is in the receiver's alternate function 9: it never synchronises", model_name(&c->model));
            return;
        }
        if (c->number == 1) {
            model_missing(&c->model, "a network on CAN2");
        }
        check_timing(c);
        wait = llround(11 * 1e12 / bit_rate(c, false));
    }
    machine_schedule(machine, &c->mode, now + wait);
}

/* ---- Registers ---- */

static void release(can_t *c, unsigned f, uint32_t word)
{
    uint32_t *const rf = value(c, RF0R + 4 * f);
    *rf &= ~(word & 0x18u);
    if ((word & 0x20u) && (*rf & 3u) != 0) {
        *rf = (*rf & ~3u) | ((*rf & 3u) - 1);
        *rf &= ~8u;
        c->fifo[f][0] = c->fifo[f][1];
        c->fifo[f][1] = c->fifo[f][2];
        show_fifo(c, f);
    }
}

static void write_filter(can_t *c, uint32_t offset, uint32_t word)
{
    const bool initialising = (reg(&c->model, FMR) & 1u) != 0;
    const bool layout = offset == FM1R || offset == FS1R || offset == FFA1R;
    const bool busy_bank = offset >= F0R1 && (reg(&c->model, FA1R) >> (offset - F0R1) / 8 & 1u) != 0;
    if (!initialising && (layout || busy_bank)) {
        machine_violation(c->model.machine, "%s: filter register 0x%03X written outside filter initialisation (FINIT)%s", model_name(&c->model), (unsigned)offset,
                          busy_bank ? " while its bank is active" : "");
        return;
    }
    *value(c, offset) = word;
}

static void set(model_t *model, uint32_t offset, uint32_t word)
{
    can_t *const c = (can_t *)model;
    switch (offset) {
    case MCR: write_control(c, word); break;
    case MSR: *value(c, MSR) &= ~(word & (ERRI | WKUI | SLAKI)); break;
    case TSR:
        for (unsigned n = 0; n < 3; n++) {
            if (word >> (8 * n) & 1u) {
                *value(c, TSR) &= ~(0xFu << (8 * n));
            }
            if (word >> (8 * n) & 0x80u) {
                withdraw(c, n, machine_now(model->machine));
            }
        }
        submit(c, machine_now(model->machine));
        break;
    case RF0R: release(c, 0, word); break;
    case RF1R: release(c, 1, word); break;
    case ESR: *value(c, ESR) = (reg(model, ESR) & ~0x70u) | (word & 0x70u); break;
    case BTR:
        if ((reg(model, MSR) & INAK) == 0) {
            machine_violation(model->machine, "%s_BTR: written outside initialisation mode (INAK)", model_name(model));
            break;
        }
        *value(c, BTR) = word;
        break;
    case IER: *value(c, IER) = word; break;
    default:
        if (offset >= FMR) {
            write_filter(c, offset, word);
        } else {
            write_mailbox(c, offset, word);
        }
        break;
    }
    interrupts(c);
}

/* CODE: the next free mailbox, or the one of lowest priority. LOW: pending and lowest, when more than one waits. */
static uint32_t status(const can_t *c)
{
    const uint32_t tsr = reg(&c->model, TSR) & 0x1CFFFFFFu;
    unsigned lowest = 3, waiting = 0, free = 3;
    for (unsigned n = 0; n < 3; n++) {
        if (!c->mailbox[n].pending) {
            free = free == 3 ? n : free;
            continue;
        }
        waiting++;
        const bool in_order = (reg(&c->model, MCR) & TXFP) != 0;
        const uint32_t id = reg(&c->model, TI0R + 16 * n);
        if (lowest == 3 || (in_order ? c->mailbox[n].order > c->mailbox[lowest].order : id >= reg(&c->model, TI0R + 16 * lowest))) {
            lowest = n;
        }
    }
    return (tsr & ~0x03000000u) | (free < 3 ? free : lowest) << 24 | (waiting > 1 ? 1u << (29 + lowest) : 0);
}

static uint32_t get(model_t *model, uint32_t offset)
{
    can_t *const c = (can_t *)model;
    switch (offset) {
    case TSR: return status(c);
    default: return reg(model, offset);
    }
}

static void restart(model_t *model)
{
    can_t *const c = (can_t *)model;
    const board_edge_t *const edge = model->chip->edge;
    machine_cancel(model->machine, &c->mode);
    machine_cancel(model->machine, &c->arrival);
    for (unsigned n = 0; n < 3; n++) {
        mailbox_t *const m = &c->mailbox[n];
        if (m->submitted && edge->can_abort && c->number == 0 && m->retry.heap_index < 0) {
            edge->can_abort(edge->context, n, machine_now(model->machine));
        }
        machine_cancel(model->machine, &m->retry);
        m->pending = m->submitted = false;
    }
    memset(c->fifo, 0, sizeof c->fifo);
    interrupts(c);
}

void can_create(chip_t *chip)
{
    static const model_description_t descriptions[2] = {
        {.name = "CAN1", .base = 0x40006400, .size = 0x400, .bus = BUS_APB1, .read_widths = WIDTH_32, .write_widths = WIDTH_32, .registers = registers,
         .register_count = sizeof registers / sizeof registers[0], .get = get, .set = set, .restart = restart},
        {.name = "CAN2", .base = 0x40006800, .size = 0x400, .bus = BUS_APB1, .read_widths = WIDTH_32, .write_widths = WIDTH_32, .registers = registers2,
         .register_count = sizeof registers2 / sizeof registers2[0], .get = get, .set = set, .restart = restart},
    };
    for (unsigned i = 0; i < 2; i++) {
        can_t *const c = chip_allocate(chip, sizeof *c);
        chip->can[i] = c;
        c->number = i;
        machine_event_init(&c->mode, mode_reached, c);
        machine_event_init(&c->arrival, arrived, c);
        for (unsigned n = 0; n < 3; n++) {
            c->mailbox[n].can = c;
            c->mailbox[n].number = n;
            machine_event_init(&c->mailbox[n].retry, retry, &c->mailbox[n]);
        }
        model_attach(chip, &c->model, &descriptions[i]);
    }
}

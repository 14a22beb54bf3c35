/* can_transmit.c: mailboxes.
 *
 * A request goes to the edge, and the network answers when the frame is through (can_frame_sent). By identifier (TXFP
 * 0) every waiting mailbox is handed over and the network arbitrates; in order of request (TXFP 1) one at a time. A
 * frame without acknowledge counts 8 transmit errors up to 128 (error passive): so a lone node never goes bus-off. A
 * bit error goes on to 256, bus-off, where requests wait for the controller's return.
 */
#include "emulator/peripherals/can.h"
#include "emulator/peripherals/outside.h"

#include <math.h>
#include <string.h>

enum { FORM_ERROR = 2, BIT_ERROR = 4, SUSPENDED_BITS = 8 }; /* LEC: form, recessive bit. */
#define ERROR_FRAME_BITS                                                                                               \
    23 /* Flag, delimiter, intermission, suspended transmission of an error-passive node rounded. */

static board_frame_t frame_of(can_t *c, unsigned n) {
    const uint32_t *const m = can_value(c, TI0R + 16 * n);
    const unsigned length = m[1] & 15u;
    board_frame_t frame = {
        .extended = (m[0] & 4u) != 0, .remote = (m[0] & 2u) != 0, .length = (uint8_t)(length > 8 ? 8 : length)};
    frame.id = frame.extended ? m[0] >> 3 : m[0] >> 21;
    memcpy(frame.data, &m[2], 8);
    memset(frame.data + frame.length, 0, (size_t)(8 - frame.length));
    return frame;
}

static void finish(can_t *c, unsigned n, uint32_t result) {
    mailbox_t *const m = &c->mailbox[n];
    machine_cancel(c->model.machine, &m->retry);
    m->pending = m->submitted = false;
    *can_value(c, TI0R + 16 * n) &= ~1u;
    *can_value(c, TSR) |= (1u | result) << (8 * n) | 1u << (26 + n);
}

void can_submit(can_t *c, int64_t time_ps) {
    const board_edge_t *const edge = c->model.chip->edge;
    const uint32_t btr = reg(&c->model, BTR);
    if (!can_running(c) || ((btr & SILM) && !(btr & LBKM))) {
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
            machine_schedule(c->model.machine, &first->retry, time_ps + llround(bits * 1e12 / can_bit_rate(c, false)));
        } else if (!can_has_pin(c, true)) {
            machine_violation(c->model.machine,
                              "%s: a frame waits, but no pin is in the transmitter's alternate function 9",
                              model_name(&c->model));
        } else if (!can_rate_fits(c)) {
            machine_schedule(c->model.machine, &first->retry,
                             time_ps + llround(ERROR_FRAME_BITS * 1e12 / c->network_hz)); /* Nobody understands it. */
            can_transmit_failed(c, true); /* Never off the bus: a choice that keeps the model simple. */
            can_errors(c, 5);
        } else if (edge->can_request && c->number == 0) {
            edge->can_request(edge->context, first->number, &frame, time_ps);
        }
    }
}

/* The end of a looped frame, or time to try again. */
static void retry(void *context, int64_t time_ps) {
    mailbox_t *const m = context;
    can_t *const c = m->can;
    if (reg(&c->model, BTR) & LBKM) {
        const board_frame_t frame = frame_of(c, m->number);
        finish(c, m->number, 2u);
        can_accept(c, &frame);
    } else {
        m->submitted = false;
    }
    can_submit(c, time_ps);
    can_interrupts(c);
}

void can_frame_sent(machine_t *machine, unsigned mailbox, bool ok, int64_t time_ps) {
    can_t *const c = chip_of(machine)->can[0];
    if (mailbox > 2 || !c->mailbox[mailbox].submitted) {
        return; /* Withdrawn meanwhile. */
    }
    if (ok) {
        can_transmit_succeeded(c);
    } else {
        can_transmit_failed(c, true);
    }
    can_errors(c, ok ? 0 : 3);
    if (ok) {
        finish(c, mailbox, 2u);
    } else if (reg(&c->model, MCR) & NART) {
        finish(c, mailbox, 8u);
    } else {
        machine_schedule(machine, &c->mailbox[mailbox].retry,
                         time_ps + llround(ERROR_FRAME_BITS * 1e12 / c->network_hz));
    }
    can_submit(c, time_ps);
    can_interrupts(c);
}

/* RM0090 32.7.6: every node saw the error. A sender tries again after the interframe space, an error-passive one eight
 * bits later. */
void can_error_in(machine_t *machine, unsigned mailbox, int64_t time_ps) {
    can_t *const c = chip_of(machine)->can[0];
    if (mailbox >= BOARD_CAN_LISTENS) {
        if (can_running(c) && can_has_pin(c, false) && (reg(&c->model, BTR) & LBKM) == 0) {
            can_receive_failed(c);
            can_errors(c, FORM_ERROR);
            can_interrupts(c);
        }
        return;
    }
    if (!c->mailbox[mailbox].submitted) {
        return; /* Withdrawn meanwhile. */
    }
    const bool passive = c->transmit_errors >= 128;
    can_transmit_failed(c, false);
    can_errors(c, BIT_ERROR);
    if ((reg(&c->model, MCR) & NART) != 0) {
        finish(c, mailbox, 8u);
    } else if (!c->bus_off) {
        machine_schedule(machine, &c->mailbox[mailbox].retry,
                         time_ps + (passive ? llround(SUSPENDED_BITS * 1e12 / c->network_hz) : 0));
    }
    can_submit(c, time_ps);
    can_interrupts(c);
}

/* The network has the frame. Whether it is on the bus by now only the network knows, which does not tell. */
static bool handed_over(const mailbox_t *m) {
    return m->submitted && m->can->number == 0 && m->retry.heap_index < 0;
}

static void take_back(const mailbox_t *m, int64_t time_ps) {
    const board_edge_t *const edge = m->can->model.chip->edge;
    if (handed_over(m) && edge->can_abort) {
        edge->can_abort(edge->context, m->number, time_ps);
    }
}

void can_check_idle(const can_t *c, const char *what, unsigned first, unsigned last) {
    for (unsigned n = first; n <= last; n++) {
        if (handed_over(&c->mailbox[n])) {
            machine_violation(c->model.machine,
                              "%s: %s while the frame of mailbox %u may be on the bus: it would wait for the frame's "
                              "end, and this model does not know whether it has begun",
                              model_name(&c->model), what, n);
        }
    }
}

void can_leave_bus(can_t *c, int64_t time_ps) {
    for (unsigned n = 0; n < 3; n++) {
        mailbox_t *const m = &c->mailbox[n];
        take_back(m, time_ps);
        machine_cancel(c->model.machine, &m->retry);
        m->submitted = false;
    }
}

void can_withdraw(can_t *c, unsigned n, int64_t time_ps) {
    if (c->mailbox[n].pending) {
        can_check_idle(c, "abort asked for (ABRQ)", n, n);
        take_back(&c->mailbox[n], time_ps);
        finish(c, n, 0);
    }
}

void can_write_mailbox(can_t *c, uint32_t offset, uint32_t word) {
    const unsigned n = (offset - TI0R) / 16;
    mailbox_t *const m = &c->mailbox[n];
    if (m->pending) {
        machine_violation(c->model.machine, "%s: transmit mailbox %u written while it is not empty (TME%u)",
                          model_name(&c->model), n, n);
        return;
    }
    if (offset % 16 == 4 && ((word & 15u) > 8 || (word & 0x100u) != 0)) {
        machine_violation(c->model.machine, "%s_TDT%uR: 0x%08X: DLC above 8, or TGT without time-triggered mode",
                          model_name(&c->model), n, (unsigned)word);
    }
    *can_value(c, offset) = word;
    if (offset % 16 == 0 && (word & 1u)) {
        m->pending = true;
        m->order = c->orders++;
        *can_value(c, TSR) &= ~(0xFu << (8 * n) | 1u << (26 + n));
        can_submit(c, machine_now(c->model.machine));
    }
}

/* CODE: the next free mailbox, or the one of lowest priority. LOW: pending and lowest, when more than one waits. */
uint32_t can_transmit_status(const can_t *c) {
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
        if (lowest == 3 ||
            (in_order ? c->mailbox[n].order > c->mailbox[lowest].order : id >= reg(&c->model, TI0R + 16 * lowest))) {
            lowest = n;
        }
    }
    return (tsr & ~0x03000000u) | (free < 3 ? free : lowest) << 24 | (waiting > 1 ? 1u << (29 + lowest) : 0);
}

void can_transmit_init(can_t *c) {
    for (unsigned n = 0; n < 3; n++) {
        c->mailbox[n].can = c;
        c->mailbox[n].number = n;
        machine_event_init(&c->mailbox[n].retry, retry, &c->mailbox[n]);
    }
}

void can_transmit_restart(can_t *c) {
    for (unsigned n = 0; n < 3; n++) {
        mailbox_t *const m = &c->mailbox[n];
        take_back(m, machine_now(c->model.machine));
        machine_cancel(c->model.machine, &m->retry);
        m->pending = m->submitted = false;
    }
}

/* can_receive.c: the frame that arrives, the FIFOs.
 *
 * A frame is stored, and its interrupt requested, at the first time quantum of this controller's own clock at or after
 * the moment at which it is valid: a controller synchronises to the bus in whole quanta, so time stamps of receivers
 * jitter by up to one. Time stamps of the controller (RDTxR) read 0.
 */
#include "emulator/peripherals/can.h"
#include "emulator/peripherals/can_filter.h"
#include "emulator/peripherals/outside.h"

#include <math.h>
#include <string.h>

/* Bits until 11 recessive ones have passed: a frame is valid when seven of them have. */
#define REST_OF_FRAME 4

static void show_fifo(can_t *c, unsigned f) {
    memcpy(can_value(c, RI0R + 16 * f), c->fifo[f][0].word, sizeof c->fifo[f][0].word);
}

static void store(can_t *c, unsigned f, unsigned index, const board_frame_t *frame) {
    uint32_t *const rf = can_value(c, RF0R + 4 * f);
    unsigned count = *rf & 3u;
    received_t r = {
        .word = {frame->extended ? frame->id << 3 | 4u : frame->id << 21, (uint32_t)frame->length | index << 8, 0, 0}};
    if (frame->remote) { /* Its length is not shown (RM0090 32.9.3). */
        r.word[0] |= 2u;
        r.word[1] = index << 8;
    }
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

void can_accept(can_t *c, const board_frame_t *frame) {
    const model_t *const shared = &c->model.chip->can[0]->model; /* CAN1 has the filters of both. */
    if (reg(shared, FMR) & 1u) {
        return; /* Filters being initialised: nothing is received. */
    }
    const unsigned split = field(reg(shared, FMR), 8, 6);
    can_filters_t filters = {.mode = reg(shared, FM1R),
                             .scale = reg(shared, FS1R),
                             .fifo = reg(shared, FFA1R),
                             .active = reg(shared, FA1R),
                             .first = c->number == 0 ? 0 : split,
                             .end = c->number == 0 ? split : 28};
    filters.end = filters.end > 28 ? 28 : filters.end;
    memcpy(filters.bank, &shared->value[F0R1 / 4], sizeof filters.bank);
    unsigned f = 0, index = 0;
    if (can_filter_match(&filters, frame, &f, &index)) {
        store(c, f, index, frame);
    }
}

void can_release(can_t *c, unsigned f, uint32_t word) {
    uint32_t *const rf = can_value(c, RF0R + 4 * f);
    *rf &= ~(word & 0x18u);
    if ((word & 0x20u) && (*rf & 3u) != 0) {
        *rf = (*rf & ~3u) | ((*rf & 3u) - 1);
        c->fifo[f][0] = c->fifo[f][1];
        c->fifo[f][1] = c->fifo[f][2];
        show_fifo(c, f);
    }
}

/* The frame that is arriving is there. */
static void arrived(void *context, int64_t time_ps) {
    can_t *const c = context;
    (void)time_ps;
    if (!can_running(c)) {
        return;
    }
    can_receive_succeeded(c);
    can_errors(c, 0);
    can_accept(c, &c->arriving);
    can_interrupts(c);
}

static int64_t next_quantum(const can_t *c, int64_t time_ps) {
    const clock_domain_t *const clock = &c->model.chip->pclk1;
    const int64_t quantum = (int64_t)field(reg(&c->model, BTR), 0, 10) + 1;
    int64_t tick = clock_tick(clock, time_ps - 1) + 1;
    tick += (quantum - tick % quantum) % quantum;
    return clock_time(clock, tick);
}

void can_frame_in(machine_t *machine, const board_frame_t *frame, int64_t time_ps) {
    can_t *const c = chip_of(machine)->can[0];
    if (!c->model.clocked || !can_has_pin(c, false)) {
        return;
    }
    if (reg(&c->model, MSR) & SLAK) {
        *can_value(c, MSR) |= WKUI;
        if ((reg(&c->model, MCR) & (AWUM | SLEEP)) == (AWUM | SLEEP)) {
            *can_value(c, MCR) &= ~SLEEP;
            machine_schedule(machine, &c->mode, time_ps + llround(REST_OF_FRAME * 1e12 / can_bit_rate(c, false)));
        }
    } else if (can_running(c) && (reg(&c->model, BTR) & LBKM) == 0) {
        if (c->arrival.heap_index >= 0) {
            machine_violation(machine, "%s: two frames are on the bus within one time quantum", model_name(&c->model));
        } else if (can_rate_fits(c)) {
            c->arriving = *frame;
            machine_schedule(machine, &c->arrival, next_quantum(c, time_ps));
        } else {
            can_receive_failed(c);
            can_errors(c, 1);
        }
    }
    can_interrupts(c);
}

void can_receive_init(can_t *c) {
    machine_event_init(&c->arrival, arrived, c);
}

void can_receive_restart(can_t *c) {
    machine_cancel(c->model.machine, &c->arrival);
    memset(c->fifo, 0, sizeof c->fifo);
}

/* dma_arbiter.c: whose request a controller serves, and when; the request lines (RM0090 10.3.3 to 10.3.5).
 *
 * A controller moves one item at a time. While it is busy requests wait; then the one of the highest priority (PL) is
 * next, of equal ones that of the lowest stream. An item that meets an idle controller is moved at once, and the time
 * that it takes follows: on silicon it would have its effect at that time's end.
 *
 * The time is that of AN4031 (revision 3, tables 4 and 5), in AHB cycles. At the peripheral: arbitration 1, address 1;
 * the bus matrix 1, but DMA1 to APB1 and DMA2 to APB2 go past it; the access itself, 1 on AHB, 2 of the bus's own
 * clocks and 1 for its synchronisation on APB. In direct mode 4 for the item's access to memory, which else hides
 * behind the FIFO. The core's and the other controller's accesses do not slow it down.
 */
#include "emulator/peripherals/dma.h"

#define PORT_CYCLES   2u
#define MATRIX_CYCLES 1u
#define ACCESS_CYCLES 1u /* The access itself on AHB, the synchronisation on APB. */
#define APB_CLOCKS    2
#define MEMORY_CYCLES 4u
#define STUCK_TURNS   64 /* Items of one request that nothing lowers. */

int64_t dma_item_time(const dma_stream_t *s) {
    const chip_t *const chip = s->dma->model.chip;
    const uint32_t address = s->value[SPAR / 4];
    const bool apb1 = address >= 0x40000000u && address < 0x40010000u;
    const bool apb2 = address >= 0x40010000u && address < 0x40020000u;
    const bool past_matrix = s->dma->number == 0 ? apb1 : apb2;
    const double clocks_ps = apb1   ? APB_CLOCKS * chip->pclk1.period_ps
                             : apb2 ? APB_CLOCKS * chip->pclk2.period_ps
                                    : 0.0;
    const unsigned cycles = PORT_CYCLES + (past_matrix ? 0 : MATRIX_CYCLES) + ACCESS_CYCLES +
                            (s->direct ? MEMORY_CYCLES : 0);
    return (int64_t)(clocks_ps + cycles * chip->hclk.period_ps);
}

/* The line that asks for the stream, DMA_NONE if none does. */
static dma_source_t request_of(const dma_stream_t *s) {
    const dma_lines_t *const lines = &s->dma->model.chip->lines;
    for (unsigned i = 0; s->enabled && s->cell != NULL && i < 3; i++) {
        const dma_source_t source = s->cell->source[i];
        if (source != DMA_NONE && lines->high[source] && lines->stream[source] == s) {
            return source;
        }
    }
    return DMA_NONE;
}

static dma_stream_t *choose(dma_t *dma) {
    dma_stream_t *best = NULL;
    for (unsigned i = 0; i < 8; i++) {
        dma_stream_t *const s = &dma->stream[i];
        if (request_of(s) != DMA_NONE &&
            (best == NULL || field(s->value[SCR / 4], 16, 2) > field(best->value[SCR / 4], 16, 2))) {
            best = s;
        }
    }
    return best;
}

static void serve(dma_stream_t *s, dma_source_t source) {
    chip_t *const chip = s->dma->model.chip;
    if (s->turns++ == STUCK_TURNS) {
        machine_violation(chip->machine,
                          "%s stream %u: its request stays high whatever it transfers; does PAR 0x%08X belong to it?",
                          dma_name(s), s->number, (unsigned)s->value[SPAR / 4]);
        dma_disable(s);
        return;
    }
    if (chip->lines.pulse[source]) {
        chip->lines.high[source] = false;
        s->turns = 0;
    }
    s->dma->serving = true;
    chip->lines.served = source;
    dma_transfer(s, source);
    chip->lines.served = DMA_NONE;
    s->dma->serving = false;
    s->dma->busy_until_ps = machine_now(chip->machine) + s->item_ps;
}

/* Serve a stream that asks, or let it wait. alone: no other stream asked when it did, so that only what the item brings
 * about can be next. */
static void arbitrate(dma_t *dma, dma_stream_t *s, bool alone) {
    machine_t *const machine = dma->model.machine;
    if (machine_now(machine) >= dma->busy_until_ps) {
        dma->asked = false;
        serve(s, request_of(s));
        if (alone && !dma->asked && request_of(s) == DMA_NONE) {
            return;
        }
        if (choose(dma) == NULL) {
            return;
        }
    }
    dma->waiting = true;
    machine_schedule(machine, &dma->next, dma->busy_until_ps);
}

static void item_done(void *context, int64_t time_ps) {
    dma_t *const dma = context;
    (void)time_ps;
    dma->waiting = false;
    dma_stream_t *const s = choose(dma);
    if (s != NULL) {
        arbitrate(dma, s, false);
    }
}

void dma_serve(chip_t *chip, dma_source_t source) {
    dma_stream_t *const s = chip->lines.stream[source];
    if (s == NULL || !chip->lines.high[source]) {
        return;
    }
    if (s->dma->serving) {
        s->dma->asked = true;
    } else if (!s->dma->waiting) {
        arbitrate(s->dma, s, true);
    }
}

void dma_arbiter_init(dma_t *dma) {
    machine_event_init(&dma->next, item_done, dma);
}

void dma_arbiter_restart(dma_t *dma) {
    machine_cancel(dma->model.machine, &dma->next);
    dma->waiting = false;
    dma->busy_until_ps = 0;
}

/* ---- Request lines ---- */

void dma_line(chip_t *chip, dma_source_t source, bool level) {
    chip->lines.pulse[source] = false;
    if (chip->lines.high[source] != level) {
        chip->lines.high[source] = level;
        if (level) {
            dma_serve(chip, source);
        } else if (chip->lines.stream[source] != NULL) {
            chip->lines.stream[source]->turns = 0;
        }
    }
}

void dma_line_pulse(chip_t *chip, dma_source_t source) {
    chip->lines.pulse[source] = true;
    chip->lines.high[source] = true;
    dma_serve(chip, source);
}

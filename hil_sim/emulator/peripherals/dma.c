/* dma.c: the two DMA controllers (RM0090 chapter 10).
 *
 * A transfer takes no time: it happens at the moment of its request, so streams never wait for each other and priorities (PL) have no effect. On silicon it takes some ten AHB
 * cycles. Memory-to-memory transfers end as a whole, 8 AHB cycles an item after EN.
 */
#include "dma.h"

#include <string.h>

enum { LISR = 0x00, HISR = 0x04, LIFCR = 0x08, HIFCR = 0x0C, STREAM0 = 0x10, STREAM_SIZE = 0x18 };
enum { SCR = 0x00, SNDTR = 0x04, SPAR = 0x08, SM0AR = 0x0C, SM1AR = 0x10, SFCR = 0x14 };
enum { FEIF = 1, DMEIF = 4, TEIF = 8, HTIF = 16, TCIF = 32 };
enum { PERIPHERAL_TO_MEMORY, MEMORY_TO_PERIPHERAL, MEMORY_TO_MEMORY };
#define EN 1u
#define CIRC (1u << 8)
#define PINC (1u << 9)
#define MINC (1u << 10)
#define PINCOS (1u << 15)
#define DBM (1u << 18)
#define CT (1u << 19)
/* What may change while EN is set: EN itself, the interrupt enables and CIRC. */
#define UNPROTECTED (0x1Fu | CIRC)
#define FLAG_BITS 0x0F7D0F7Du
#define MEMORY_CYCLES 8

#define STREAM_REGISTERS(n)                                                                                                                                  \
    {"S" #n "CR", STREAM0 + n * STREAM_SIZE + SCR, 0, 0x0FEFFFFF, ACCESS_RW}, {"S" #n "NDTR", STREAM0 + n * STREAM_SIZE + SNDTR, 0, 0xFFFF, ACCESS_RW},           \
    {"S" #n "PAR", STREAM0 + n * STREAM_SIZE + SPAR, 0, 0xFFFFFFFF, ACCESS_RW}, {"S" #n "M0AR", STREAM0 + n * STREAM_SIZE + SM0AR, 0, 0xFFFFFFFF, ACCESS_RW},     \
    {"S" #n "M1AR", STREAM0 + n * STREAM_SIZE + SM1AR, 0, 0xFFFFFFFF, ACCESS_RW}, {"S" #n "FCR", STREAM0 + n * STREAM_SIZE + SFCR, 0x21, 0xBF, ACCESS_RW}

static const register_layout_t registers[] = {
    {"LISR", LISR, 0, FLAG_BITS, ACCESS_RO}, {"HISR", HISR, 0, FLAG_BITS, ACCESS_RO}, {"LIFCR", LIFCR, 0, FLAG_BITS, ACCESS_WO}, {"HIFCR", HIFCR, 0, FLAG_BITS, ACCESS_WO},
    STREAM_REGISTERS(0), STREAM_REGISTERS(1), STREAM_REGISTERS(2), STREAM_REGISTERS(3), STREAM_REGISTERS(4), STREAM_REGISTERS(5), STREAM_REGISTERS(6), STREAM_REGISTERS(7),
};

typedef struct dma_stream {
    dma_t *dma;
    uint32_t *value; /* The stream's six registers. */
    unsigned number, irq;
    bool enabled, busy, line;
    const dma_cell_t *cell;
    /* Latched when EN is set. */
    unsigned direction, psize, msize, burst; /* Bytes; burst: of one memory burst. */
    bool direct;
    unsigned threshold;
    uint32_t reload, peripheral_step;
    /* Moving. */
    uint32_t peripheral_offset, memory_offset, memory_left; /* Bytes. */
    bool memory_target;                                     /* Buffer that the memory side works on. */
    uint8_t fifo[16];
    unsigned fifo_count;
    machine_event_t done;
} dma_stream_t;

struct dma {
    model_t model;
    unsigned number; /* 0: DMA1 */
    dma_stream_t stream[8];
};

static const char *name(const dma_stream_t *s) { return model_name(&s->dma->model); }

static unsigned flag_shift(unsigned stream)
{
    static const uint8_t shifts[4] = {0, 6, 16, 22};
    return shifts[stream % 4];
}

static uint32_t flags(const dma_stream_t *s) { return s->dma->model.value[s->number / 4] >> flag_shift(s->number) & 0x3Du; }

static void interrupt(dma_stream_t *s)
{
    const uint32_t cr = s->value[SCR / 4], f = flags(s);
    /* DMEIE, TEIE, HTIE, TCIE are bits 1 to 4; their flags bits 2 to 5. */
    const bool level = ((cr << 1) & f & 0x3Cu) != 0 || ((s->value[SFCR / 4] & 0x80u) && (f & FEIF));
    if (level != s->line) {
        s->line = level;
        machine_irq(s->dma->model.machine, s->irq, level);
    }
}

static void raise(dma_stream_t *s, uint32_t flag)
{
    s->dma->model.value[s->number / 4] |= flag << flag_shift(s->number);
    interrupt(s);
}

static void disable(dma_stream_t *s)
{
    chip_t *const chip = s->dma->model.chip;
    s->value[SCR / 4] &= ~EN;
    s->enabled = false;
    machine_cancel(chip->machine, &s->done);
    if (s->direction != MEMORY_TO_MEMORY && s->cell != NULL) {
        for (unsigned i = 0; i < 3; i++) {
            if (chip->lines.stream[s->cell->source[i]] == s) {
                chip->lines.stream[s->cell->source[i]] = NULL;
            }
        }
    }
}

static void bus_error(dma_stream_t *s, const char *what, uint32_t address)
{
    machine_violation(s->dma->model.machine, "%s stream %u: bus error at the %s 0x%08X", name(s), s->number, what, (unsigned)address);
    disable(s);
    raise(s, TEIF);
}

static bool memory_access(dma_stream_t *s, bool write, unsigned width, uint32_t *value)
{
    const uint32_t address = s->value[(s->memory_target ? SM1AR : SM0AR) / 4] + s->memory_offset;
    machine_t *const machine = s->dma->model.machine;
    if (address >> 24 == 0x10u || !(write ? machine_bus_write(machine, address, width, *value) : machine_bus_read(machine, address, width, value))) {
        bus_error(s, address >> 24 == 0x10u ? "CCM, which no DMA reaches:" : "memory address", address);
        return false;
    }
    if (s->value[SCR / 4] & MINC) {
        s->memory_offset += width;
    }
    s->memory_left -= width;
    return true;
}

static bool peripheral_access(dma_stream_t *s, bool write, uint32_t *value)
{
    const uint32_t address = s->value[SPAR / 4] + s->peripheral_offset;
    machine_t *const machine = s->dma->model.machine;
    if (!(write ? machine_bus_write(machine, address, s->psize, *value) : machine_bus_read(machine, address, s->psize, value))) {
        bus_error(s, "peripheral address", address);
        return false;
    }
    s->peripheral_offset += s->peripheral_step;
    return true;
}

static void memory_wrap(dma_stream_t *s)
{
    s->memory_offset = 0;
    s->memory_left = s->reload * s->psize;
    if (s->value[SCR / 4] & DBM) {
        s->memory_target = !s->memory_target;
    }
}

/* Memory to FIFO: as much as fits, in whole bursts. In direct mode the FIFO holds one item. */
static void fill(dma_stream_t *s)
{
    const unsigned capacity = s->direct ? s->psize : 16u;
    while (s->enabled && s->fifo_count + s->burst <= capacity) {
        if (s->memory_left == 0) {
            if ((s->value[SCR / 4] & (CIRC | DBM)) == 0) {
                return;
            }
            memory_wrap(s);
        }
        for (unsigned done = 0; done < s->burst && s->memory_left != 0; done += s->msize) {
            uint32_t value = 0;
            if (!memory_access(s, false, s->msize, &value)) {
                return;
            }
            memcpy(s->fifo + s->fifo_count, &value, s->msize);
            s->fifo_count += s->msize;
        }
    }
}

static void drain(dma_stream_t *s)
{
    unsigned at = 0;
    while (at < s->fifo_count && s->enabled) {
        uint32_t value = 0;
        const unsigned left = s->fifo_count - at, width = left < s->msize ? s->psize : s->msize; /* The end of an odd block goes in smaller items. */
        memcpy(&value, s->fifo + at, width);
        if (!memory_access(s, true, width, &value)) {
            return;
        }
        at += width;
    }
    s->fifo_count = 0;
}

static void count(dma_stream_t *s, dma_source_t source)
{
    uint32_t left = s->value[SNDTR / 4] - 1;
    s->value[SNDTR / 4] = left;
    if (left == s->reload / 2 && left != 0) {
        raise(s, HTIF);
    }
    if (left != 0) {
        return;
    }
    s->peripheral_offset = 0;
    adc_last_transfer(s->dma->model.chip, source);
    if (s->value[SCR / 4] & (CIRC | DBM)) {
        s->value[SNDTR / 4] = s->reload;
        if (s->value[SCR / 4] & DBM) {
            s->value[SCR / 4] ^= CT;
        }
        if (s->direction == PERIPHERAL_TO_MEMORY) {
            memory_wrap(s);
        }
    } else {
        disable(s);
    }
    raise(s, TCIF);
}

static void transfer(dma_stream_t *s, dma_source_t source)
{
    uint32_t value = 0;
    if (s->direction == PERIPHERAL_TO_MEMORY) {
        if (!peripheral_access(s, false, &value)) {
            return;
        }
        if (s->direct) {
            if (!memory_access(s, true, s->psize, &value)) {
                return;
            }
        } else {
            memcpy(s->fifo + s->fifo_count, &value, s->psize);
            s->fifo_count += s->psize;
            if (s->fifo_count >= s->threshold || s->value[SNDTR / 4] == 1) {
                drain(s);
            }
        }
    } else {
        memcpy(&value, s->fifo, s->psize);
        if (s->fifo_count < s->psize || !peripheral_access(s, true, &value)) {
            return;
        }
        s->fifo_count -= s->psize;
        memmove(s->fifo, s->fifo + s->psize, s->fifo_count);
        if (s->direct || 16u - s->fifo_count >= s->threshold) {
            fill(s);
        }
    }
    if (s->enabled) {
        count(s, source);
    }
}

static void serve(chip_t *chip, dma_source_t source)
{
    dma_stream_t *const s = chip->lines.stream[source];
    if (s == NULL || s->busy) {
        return;
    }
    s->busy = true;
    for (unsigned turns = 0; s->enabled && chip->lines.high[source]; turns++) {
        if (turns == 64) { /* A line that no transfer lowers. */
            machine_violation(chip->machine, "%s stream %u: its request stays high whatever it transfers; does PAR 0x%08X belong to it?", name(s), s->number,
                              (unsigned)s->value[SPAR / 4]);
            disable(s);
            break;
        }
        if (chip->lines.pulse[source]) {
            chip->lines.high[source] = false;
        }
        transfer(s, source);
    }
    s->busy = false;
}

void dma_line(chip_t *chip, dma_source_t source, bool level)
{
    chip->lines.pulse[source] = false;
    if (chip->lines.high[source] != level) {
        chip->lines.high[source] = level;
        if (level) {
            serve(chip, source);
        }
    }
}

void dma_line_pulse(chip_t *chip, dma_source_t source)
{
    chip->lines.pulse[source] = true;
    chip->lines.high[source] = true;
    serve(chip, source);
}

static void copy_memory(void *context, int64_t time_ps)
{
    dma_stream_t *const s = context;
    (void)time_ps;
    while (s->enabled) {
        uint32_t value = 0;
        if (!peripheral_access(s, false, &value)) {
            return;
        }
        memcpy(s->fifo + s->fifo_count, &value, s->psize);
        s->fifo_count += s->psize;
        if (s->fifo_count >= s->threshold || s->value[SNDTR / 4] == 1) {
            drain(s);
        }
        if (s->enabled) {
            count(s, DMA_NONE);
        }
    }
}

/* Is the configuration one that RM0090 allows? Says so if not. */
static bool legal(const dma_stream_t *s)
{
    machine_t *const machine = s->dma->model.machine;
    const uint32_t cr = s->value[SCR / 4];
    const char *wrong = NULL;
    if (flags(s) != 0) {
        wrong = "EN set while event flags are still set";
    } else if (field(cr, 6, 2) == 3 || field(cr, 11, 2) == 3 || field(cr, 13, 2) == 3) {
        wrong = "DIR, PSIZE or MSIZE has the reserved value 3";
    } else if (cr & 1u << 5) {
        wrong = "PFCTRL set, but only SDIO can control the flow";
    } else if (s->value[SNDTR / 4] == 0) {
        wrong = "EN set with NDTR 0";
    } else if (s->direction == MEMORY_TO_MEMORY && (s->dma->number == 0 || s->direct || (cr & (CIRC | DBM)) != 0)) {
        wrong = "memory-to-memory needs DMA2, the FIFO and a single buffer";
    } else if (s->value[SPAR / 4] % s->psize != 0 || s->value[SM0AR / 4] % s->msize != 0 || ((cr & DBM) && s->value[SM1AR / 4] % s->msize != 0)) {
        wrong = "an address is not aligned to its item size";
    } else if (s->psize < s->msize && s->value[SNDTR / 4] * s->psize % s->msize != 0) {
        wrong = "NDTR is not a multiple of MSIZE / PSIZE";
    } else if (!s->direct && (cr & (CIRC | DBM)) != 0 && s->value[SNDTR / 4] * s->psize % s->burst != 0) {
        wrong = "circular: the buffer is not a multiple of the memory burst";
    }
    if (wrong != NULL) {
        machine_violation(machine, "%s stream %u: %s (SxCR 0x%08X, NDTR %u)", name(s), s->number, wrong, (unsigned)cr, (unsigned)s->value[SNDTR / 4]);
    }
    return wrong == NULL;
}

/* DMA1's peripheral port ends at the APB1 bridge; the ports of DMA2 and the memory ports reach all but CCM. */
static bool reachable(dma_stream_t *s)
{
    const uint32_t peripheral = s->value[SPAR / 4];
    if (s->dma->number == 0 && (peripheral < 0x40000000u || peripheral >= 0x40008000u)) {
        bus_error(s, "peripheral address outside APB1, all that DMA1 reaches:", peripheral);
        return false;
    }
    return true;
}

static void enable(dma_stream_t *s)
{
    chip_t *const chip = s->dma->model.chip;
    const uint32_t cr = s->value[SCR / 4], fcr = s->value[SFCR / 4];
    s->direction = field(cr, 6, 2);
    s->direct = (fcr & 4u) == 0;
    s->psize = 1u << field(cr, 11, 2);
    s->msize = s->direct ? s->psize : 1u << field(cr, 13, 2);
    if (!legal(s)) {
        s->value[SCR / 4] &= ~EN;
        return;
    }
    static const uint8_t beats[4] = {1, 4, 8, 16};
    s->burst = s->direct ? s->msize : beats[field(cr, 23, 2)] * s->msize;
    s->threshold = s->direct ? s->psize : 4 * (field(fcr, 0, 2) + 1);
    s->enabled = true;
    if (!s->direct && (s->burst > s->threshold || s->threshold % s->burst != 0 || beats[field(cr, 21, 2)] * s->psize > 16)) {
        machine_violation(chip->machine, "%s stream %u: a memory burst of %u bytes does not fit the FIFO threshold of %u (RM0090 table 48)", name(s), s->number, s->burst, s->threshold);
        disable(s);
        raise(s, FEIF);
        return;
    }
    s->reload = s->value[SNDTR / 4];
    s->peripheral_step = (cr & PINC) == 0 ? 0 : (cr & PINCOS) ? 4 : s->psize;
    s->peripheral_offset = s->memory_offset = 0;
    s->memory_left = s->reload * s->psize;
    s->memory_target = (cr & DBM) && (cr & CT);
    s->fifo_count = 0;
    if (!reachable(s)) {
        return;
    }
    if (s->direction == MEMORY_TO_MEMORY) {
        machine_schedule(chip->machine, &s->done, machine_now(chip->machine) + (int64_t)(s->reload * MEMORY_CYCLES * chip->hclk.period_ps));
        return;
    }
    s->cell = dma_cell(s->dma->number, field(cr, 25, 3), s->number);
    if (s->cell->source[0] == DMA_NONE || s->cell->source[0] == DMA_OTHER) {
        machine_violation(chip->machine, "%s stream %u: CHSEL %u selects %s", name(s), s->number, field(cr, 25, 3),
                          s->cell->source[0] == DMA_NONE ? "no request line" : "a peripheral that has no model");
    }
    if (s->direction == MEMORY_TO_PERIPHERAL) {
        fill(s); /* Preloaded as soon as EN is set. */
    }
    for (unsigned i = 0; i < 3 && s->cell->source[i] != DMA_NONE; i++) {
        dma_stream_t **const listener = &chip->lines.stream[s->cell->source[i]];
        if (*listener != NULL) {
            machine_violation(chip->machine, "%s stream %u: its request line is already served by %s stream %u", name(s), s->number, name(*listener), (*listener)->number);
        }
        *listener = s;
    }
    for (unsigned i = 0; i < 3 && s->cell->source[i] != DMA_NONE; i++) {
        serve(chip, s->cell->source[i]);
    }
}

static void write_control(dma_stream_t *s, uint32_t value)
{
    uint32_t *const cr = &s->value[SCR / 4];
    if (s->enabled) {
        if (((*cr ^ value) & ~UNPROTECTED) != 0) {
            machine_violation(s->dma->model.machine, "%s_S%uCR: protected bits 0x%08X changed while EN is set", name(s), s->number, (unsigned)((*cr ^ value) & ~UNPROTECTED));
        }
        *cr = (*cr & ~UNPROTECTED) | (value & UNPROTECTED);
        if ((value & EN) == 0) {
            if (s->direction != MEMORY_TO_PERIPHERAL) {
                drain(s);
            }
            disable(s);
            raise(s, TCIF); /* RM0090 10.3.14: so ends a stream that software disables. */
        }
    } else {
        *cr = value;
        if (value & EN) {
            enable(s);
        }
    }
    interrupt(s);
}

static void write_stream(dma_stream_t *s, uint32_t offset, uint32_t value)
{
    const uint32_t cr = s->value[SCR / 4];
    if (offset == SCR) {
        write_control(s, value);
        return;
    }
    if (offset == SFCR) {
        if (s->enabled && ((s->value[SFCR / 4] ^ value) & 7u) != 0) {
            machine_violation(s->dma->model.machine, "%s_S%uFCR: DMDIS or FTH changed while EN is set", name(s), s->number);
            return;
        }
        s->value[SFCR / 4] = value & 0x87u;
        interrupt(s);
        return;
    }
    const bool idle_buffer = (cr & DBM) && offset == ((cr & CT) ? SM0AR : SM1AR);
    if (s->enabled && !idle_buffer) {
        machine_violation(s->dma->model.machine, "%s stream %u: %s written while EN is set", name(s), s->number,
                          offset == SNDTR ? "NDTR" : offset == SPAR ? "PAR" : offset == SM0AR ? "M0AR" : "M1AR");
        return;
    }
    s->value[offset / 4] = value;
}

static uint32_t get(model_t *model, uint32_t offset)
{
    if (offset < STREAM0) {
        return offset <= HISR ? reg(model, offset) : 0;
    }
    const dma_stream_t *const s = &((dma_t *)model)->stream[(offset - STREAM0) / STREAM_SIZE];
    if ((offset - STREAM0) % STREAM_SIZE == SFCR) { /* FS: empty, full, or the quarter. */
        const unsigned n = s->direct ? 0 : s->fifo_count;
        const uint32_t level = n == 0 ? 4 : n == 16 ? 5 : n / 4;
        return (s->value[SFCR / 4] & 0x87u) | level << 3;
    }
    return reg(model, offset);
}

static void set(model_t *model, uint32_t offset, uint32_t value)
{
    dma_t *const dma = (dma_t *)model;
    if (offset == LIFCR || offset == HIFCR) {
        const unsigned half = (offset - LIFCR) / 4;
        model->value[half] &= ~value;
        for (unsigned i = 4 * half; i < 4 * half + 4; i++) {
            interrupt(&dma->stream[i]);
        }
        return;
    }
    write_stream(&dma->stream[(offset - STREAM0) / STREAM_SIZE], (offset - STREAM0) % STREAM_SIZE, value);
}

static void restart(model_t *model)
{
    dma_t *const dma = (dma_t *)model;
    for (unsigned i = 0; i < 8; i++) {
        dma_stream_t *const s = &dma->stream[i];
        disable(s);
        s->fifo_count = 0;
        s->direct = true;
        interrupt(s);
        s->line = false;
    }
}

void dma_create(chip_t *chip)
{
    static const model_description_t descriptions[2] = {
        {.name = "DMA1", .base = 0x40026000, .size = 0x400, .bus = BUS_AHB, .read_widths = WIDTH_32, .write_widths = WIDTH_32, .registers = registers,
         .register_count = sizeof registers / sizeof registers[0], .get = get, .set = set, .restart = restart},
        {.name = "DMA2", .base = 0x40026400, .size = 0x400, .bus = BUS_AHB, .read_widths = WIDTH_32, .write_widths = WIDTH_32, .registers = registers,
         .register_count = sizeof registers / sizeof registers[0], .get = get, .set = set, .restart = restart},
    };
    static const uint8_t irq[2][8] = {{11, 12, 13, 14, 15, 16, 17, 47}, {56, 57, 58, 59, 60, 68, 69, 70}};
    for (unsigned i = 0; i < 2; i++) {
        dma_t *const dma = chip_allocate(chip, sizeof *dma);
        chip->dma[i] = dma;
        dma->number = i;
        for (unsigned n = 0; n < 8; n++) {
            dma_stream_t *const s = &dma->stream[n];
            s->dma = dma;
            s->number = n;
            s->irq = irq[i][n];
            s->value = &dma->model.value[(STREAM0 + n * STREAM_SIZE) / 4];
            machine_event_init(&s->done, copy_memory, s);
        }
        model_attach(chip, &dma->model, &descriptions[i]);
    }
}

/* ---- machine.h ---- */

void dma_request_pulse(machine_t *machine, const char *source)
{
    const dma_source_t line = dma_source(source);
    if (line == DMA_NONE) {
        machine_violation(machine, "DMA: there is no request line %s", source);
        return;
    }
    dma_line_pulse(chip_of(machine), line);
}

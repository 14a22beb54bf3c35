/* dma.c: the two DMA controllers (RM0090 chapter 10): registers, flags, what a stream may be set to (see dma.h). */
#include "emulator/peripherals/dma.h"

/* What may change while EN is set: EN itself, the interrupt enables and CIRC. */
#define UNPROTECTED   (0x1Fu | CIRC)
#define FLAG_BITS     0x0F7D0F7Du
#define MSIZE         (3u << 13)
#define BURSTS        (15u << 21) /* MBURST and PBURST. */
#define MEMORY_CYCLES 8           /* AHB cycles for an item from memory to memory. */

#define STREAM_REGISTERS(n)                                                                                            \
    {"S" #n "CR", STREAM0 + n * STREAM_SIZE + SCR, 0, 0x0FEFFFFF, ACCESS_RW},                                          \
        {"S" #n "NDTR", STREAM0 + n * STREAM_SIZE + SNDTR, 0, 0xFFFF, ACCESS_RW},                                      \
        {"S" #n "PAR", STREAM0 + n * STREAM_SIZE + SPAR, 0, 0xFFFFFFFF, ACCESS_RW},                                    \
        {"S" #n "M0AR", STREAM0 + n * STREAM_SIZE + SM0AR, 0, 0xFFFFFFFF, ACCESS_RW},                                  \
        {"S" #n "M1AR", STREAM0 + n * STREAM_SIZE + SM1AR, 0, 0xFFFFFFFF, ACCESS_RW}, {                                \
        "S" #n "FCR", STREAM0 + n *STREAM_SIZE + SFCR, 0x21, 0xBF, ACCESS_RW                                           \
    }

static const register_layout_t registers[] = {
    {"LISR", LISR, 0, FLAG_BITS, ACCESS_RO},
    {"HISR", HISR, 0, FLAG_BITS, ACCESS_RO},
    {"LIFCR", LIFCR, 0, FLAG_BITS, ACCESS_WO},
    {"HIFCR", HIFCR, 0, FLAG_BITS, ACCESS_WO},
    STREAM_REGISTERS(0),
    STREAM_REGISTERS(1),
    STREAM_REGISTERS(2),
    STREAM_REGISTERS(3),
    STREAM_REGISTERS(4),
    STREAM_REGISTERS(5),
    STREAM_REGISTERS(6),
    STREAM_REGISTERS(7),
};

const char *dma_name(const dma_stream_t *s) {
    return model_name(&s->dma->model);
}

static unsigned flag_shift(unsigned stream) {
    static const uint8_t shifts[4] = {0, 6, 16, 22};
    return shifts[stream % 4];
}

static uint32_t dma_flags(const dma_stream_t *s) {
    return s->dma->model.value[s->number / 4] >> flag_shift(s->number) & 0x3Du;
}

/* After a change of flags or enables. */
static void interrupt(dma_stream_t *s) {
    const uint32_t cr = s->value[SCR / 4], f = dma_flags(s);
    /* DMEIE, TEIE, HTIE, TCIE are bits 1 to 4; their flags bits 2 to 5. */
    const bool level = ((cr << 1) & f & 0x3Cu) != 0 || ((s->value[SFCR / 4] & 0x80u) && (f & FEIF));
    if (level != s->line) {
        s->line = level;
        machine_irq(s->dma->model.machine, s->irq, level);
    }
}

void dma_raise(dma_stream_t *s, uint32_t flag) {
    s->dma->model.value[s->number / 4] |= flag << flag_shift(s->number);
    interrupt(s);
}

/* Is the configuration one that RM0090 allows? Says so if not. */
static bool legal(const dma_stream_t *s) {
    machine_t *const machine = s->dma->model.machine;
    const uint32_t cr = s->value[SCR / 4];
    const char *wrong = NULL;
    if (dma_flags(s) != 0) {
        wrong = "EN set while event flags are still set";
    } else if (field(cr, 6, 2) == 3 || field(cr, 11, 2) == 3 || field(cr, 13, 2) == 3) {
        wrong = "DIR, PSIZE or MSIZE has the reserved value 3";
    } else if (cr & 1u << 5) {
        wrong = "PFCTRL set, but only SDIO can control the flow";
    } else if (s->value[SNDTR / 4] == 0) {
        wrong = "EN set with NDTR 0";
    } else if (s->direction == MEMORY_TO_MEMORY && (s->dma->number == 0 || s->direct || (cr & (CIRC | DBM)) != 0)) {
        wrong = "memory-to-memory needs DMA2, the FIFO and a single buffer";
    } else if (s->value[SPAR / 4] % s->psize != 0 || s->value[SM0AR / 4] % s->msize != 0 ||
               ((cr & DBM) && s->value[SM1AR / 4] % s->msize != 0)) {
        wrong = "an address is not aligned to its item size";
    } else if (s->psize < s->msize && s->value[SNDTR / 4] * s->psize % s->msize != 0) {
        wrong = "NDTR is not a multiple of MSIZE / PSIZE";
    } else if (!s->direct && (cr & (CIRC | DBM)) != 0 && s->value[SNDTR / 4] * s->psize % s->burst != 0) {
        wrong = "circular: the buffer is not a multiple of the memory burst";
    }
    if (wrong != NULL) {
        machine_violation(machine, "%s stream %u: %s (SxCR 0x%08X, NDTR %u)", dma_name(s), s->number, wrong,
                          (unsigned)cr, (unsigned)s->value[SNDTR / 4]);
    }
    return wrong == NULL;
}

/* DMA1's peripheral port ends at the APB1 bridge; the ports of DMA2 and the memory ports reach all but CCM. */
static bool reachable(dma_stream_t *s) {
    const uint32_t peripheral = s->value[SPAR / 4];
    if (s->dma->number == 0 && (peripheral < 0x40000000u || peripheral >= 0x40008000u)) {
        dma_bus_error(s, "peripheral address outside APB1, all that DMA1 reaches:", peripheral);
        return false;
    }
    return true;
}

/* Which bus a stream's peripheral is on. Memories do not count: they are only read or written again. */
typedef enum { ON_MEMORY, ON_APB, ON_AHB } port_bus_t;
static port_bus_t port_bus(const dma_stream_t *s) {
    const uint32_t address = s->value[SPAR / 4];
    const bool memory = address < 0x40000000u || (address >= 0x60000000u && address < 0xA0000000u);
    return memory ? ON_MEMORY : address < 0x40020000u ? ON_APB : ON_AHB;
}

/* ES0182, "DMA2 data corruption when managing AHB and APB peripherals in a concurrent way". ST limits it to AHB
 * peripherals with a FIFO; boards have shown it on GPIO as well, so all of them count. */
static void check_erratum(const dma_stream_t *s) {
    const port_bus_t mine = port_bus(s);
    for (unsigned i = 0; i < 8 && s->dma->number == 1 && mine != ON_MEMORY; i++) {
        const dma_stream_t *const other = &s->dma->stream[i];
        if (other != s && other->enabled && port_bus(other) != ON_MEMORY && port_bus(other) != mine) {
            machine_violation(s->dma->model.machine,
                              "DMA2 stream %u serves the %s peripheral 0x%08X while stream %u serves the %s peripheral "
                              "0x%08X: concurrent transfers to both buses can corrupt data (errata ES0182)",
                              s->number, mine == ON_AHB ? "AHB" : "APB", (unsigned)s->value[SPAR / 4], other->number,
                              mine == ON_AHB ? "APB" : "AHB", (unsigned)other->value[SPAR / 4]);
        }
    }
}

/* Listen to the request lines that CHSEL selects, and serve those that are high. */
static void connect(dma_stream_t *s) {
    chip_t *const chip = s->dma->model.chip;
    const uint32_t cr = s->value[SCR / 4];
    s->cell = dma_cell(s->dma->number, field(cr, 25, 3), s->number);
    if (s->cell->source[0] == DMA_NONE || s->cell->source[0] == DMA_OTHER) {
        machine_violation(chip->machine, "%s stream %u: CHSEL %u selects %s", dma_name(s), s->number, field(cr, 25, 3),
                          s->cell->source[0] == DMA_NONE ? "no request line" : "a peripheral that has no model");
    }
    if (s->direction == MEMORY_TO_PERIPHERAL) {
        dma_fill(s); /* Preloaded as soon as EN is set. */
    }
    for (unsigned i = 0; i < 3 && s->cell->source[i] != DMA_NONE; i++) {
        dma_stream_t **const listener = &chip->lines.stream[s->cell->source[i]];
        if (*listener != NULL) {
            machine_violation(chip->machine, "%s stream %u: its request line is already served by %s stream %u",
                              dma_name(s), s->number, dma_name(*listener), (*listener)->number);
        }
        *listener = s;
    }
    for (unsigned i = 0; i < 3 && s->cell->source[i] != DMA_NONE; i++) {
        dma_serve(chip, s->cell->source[i]);
    }
}

/* What the hardware forces when EN is set (RM0090 10.5.5, 10.5.6): direct mode has one width and single transfers,
 * double buffers are circular, and a stream that had ended counts from what was programmed again. */
static void force(dma_stream_t *s) {
    uint32_t *const cr = &s->value[SCR / 4];
    if (s->direct) {
        *cr = (*cr & ~(MSIZE | PINCOS | BURSTS)) | field(*cr, 11, 2) << 13;
    }
    if (*cr & DBM) {
        *cr |= CIRC;
    }
    if (s->value[SNDTR / 4] == 0) {
        s->value[SNDTR / 4] = s->programmed;
    }
}

static void enable(dma_stream_t *s) {
    chip_t *const chip = s->dma->model.chip;
    const uint32_t fcr = s->value[SFCR / 4];
    s->direct = (fcr & 4u) == 0;
    force(s);
    const uint32_t cr = s->value[SCR / 4];
    s->direction = field(cr, 6, 2);
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
    if (!s->direct &&
        (s->burst > s->threshold || s->threshold % s->burst != 0 || beats[field(cr, 21, 2)] * s->psize > 16)) {
        machine_violation(
            chip->machine,
            "%s stream %u: a memory burst of %u bytes does not fit the FIFO threshold of %u (RM0090 table 48)",
            dma_name(s), s->number, s->burst, s->threshold);
        dma_disable(s);
        dma_raise(s, FEIF);
        return;
    }
    s->reload = s->value[SNDTR / 4];
    s->item_ps = dma_item_time(s);
    s->turns = 0;
    s->peripheral_step = (cr & PINC) == 0 ? 0 : (cr & PINCOS) ? 4 : s->psize;
    s->peripheral_offset = s->memory_offset = 0;
    s->memory_left = s->reload * s->psize;
    s->memory_target = (cr & DBM) && (cr & CT);
    s->fifo_count = 0;
    if (!reachable(s)) {
        return;
    }
    check_erratum(s);
    if (s->direction == MEMORY_TO_MEMORY) {
        machine_schedule(chip->machine, &s->done,
                         machine_now(chip->machine) + (int64_t)(s->reload * MEMORY_CYCLES * chip->hclk.period_ps));
        return;
    }
    connect(s);
}

static void write_control(dma_stream_t *s, uint32_t value) {
    uint32_t *const cr = &s->value[SCR / 4];
    if (s->enabled) {
        if (((*cr ^ value) & ~UNPROTECTED) != 0) {
            machine_violation(s->dma->model.machine, "%s_S%uCR: protected bits 0x%08X changed while EN is set",
                              dma_name(s), s->number, (unsigned)((*cr ^ value) & ~UNPROTECTED));
        }
        *cr = (*cr & ~UNPROTECTED) | (value & UNPROTECTED);
        if ((value & EN) == 0) {
            if (s->direction != MEMORY_TO_PERIPHERAL) {
                dma_drain(s);
            }
            dma_disable(s);
            dma_raise(s, TCIF); /* RM0090 10.3.14: so ends a stream that software disables. */
        }
    } else {
        *cr = value;
        if (value & EN) {
            enable(s);
        }
    }
    interrupt(s);
}

static void write_stream(dma_stream_t *s, uint32_t offset, uint32_t value) {
    const uint32_t cr = s->value[SCR / 4];
    if (offset == SCR) {
        write_control(s, value);
        return;
    }
    if (offset == SFCR) {
        if (s->enabled && ((s->value[SFCR / 4] ^ value) & 7u) != 0) {
            machine_violation(s->dma->model.machine, "%s_S%uFCR: DMDIS or FTH changed while EN is set", dma_name(s),
                              s->number);
            return;
        }
        s->value[SFCR / 4] = value & 0x87u;
        interrupt(s);
        return;
    }
    const bool idle_buffer = (cr & DBM) && offset == ((cr & CT) ? SM0AR : SM1AR);
    if (s->enabled && !idle_buffer) {
        machine_violation(s->dma->model.machine, "%s stream %u: %s written while EN is set", dma_name(s), s->number,
                          offset == SNDTR   ? "NDTR"
                          : offset == SPAR  ? "PAR"
                          : offset == SM0AR ? "M0AR"
                                            : "M1AR");
        if ((cr & DBM) && (offset == SM0AR || offset == SM1AR)) { /* RM0090 10.3.9: the target in use. */
            dma_disable(s);
            dma_raise(s, TEIF);
        }
        return;
    }
    s->value[offset / 4] = value;
    if (offset == SNDTR) {
        s->programmed = value;
    }
}

static uint32_t get(model_t *model, uint32_t offset) {
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

static void set(model_t *model, uint32_t offset, uint32_t value) {
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

static void restart(model_t *model) {
    dma_t *const dma = (dma_t *)model;
    dma_arbiter_restart(dma);
    for (unsigned i = 0; i < 8; i++) {
        dma_stream_t *const s = &dma->stream[i];
        dma_disable(s);
        s->fifo_count = 0;
        s->programmed = 0;
        s->direct = true;
        interrupt(s);
        s->line = false;
    }
}

void dma_create(chip_t *chip) {
    static const model_description_t descriptions[2] = {
        {.name = "DMA1",
         .base = 0x40026000,
         .size = 0x400,
         .bus = BUS_AHB,
         .read_widths = WIDTH_32,
         .write_widths = WIDTH_32,
         .registers = registers,
         .register_count = sizeof registers / sizeof registers[0],
         .get = get,
         .set = set,
         .restart = restart},
        {.name = "DMA2",
         .base = 0x40026400,
         .size = 0x400,
         .bus = BUS_AHB,
         .read_widths = WIDTH_32,
         .write_widths = WIDTH_32,
         .registers = registers,
         .register_count = sizeof registers / sizeof registers[0],
         .get = get,
         .set = set,
         .restart = restart},
    };
    static const uint8_t irq[2][8] = {{11, 12, 13, 14, 15, 16, 17, 47}, {56, 57, 58, 59, 60, 68, 69, 70}};
    for (unsigned i = 0; i < 2; i++) {
        dma_t *const dma = chip_allocate(chip, sizeof *dma);
        chip->dma[i] = dma;
        dma->number = i;
        dma_arbiter_init(dma);
        for (unsigned n = 0; n < 8; n++) {
            dma_stream_t *const s = &dma->stream[n];
            s->dma = dma;
            s->number = n;
            s->irq = irq[i][n];
            s->value = &dma->model.value[(STREAM0 + n * STREAM_SIZE) / 4];
            dma_stream_init(s);
        }
        model_attach(chip, &dma->model, &descriptions[i]);
    }
}

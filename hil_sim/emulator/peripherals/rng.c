/* rng.c: the random number generator (RM0090 24.4), deterministic: a xorshift sequence that starts from the chip's
 * unique id. A word is ready 40 cycles of the 48 MHz clock after the one before was read. Its clock is PLLQ; that it
 * runs at all is checked as "the PLL is ready". */
#include "emulator/peripherals/model.h"

enum { CR = 0x00, SR = 0x04, DR = 0x08 };
#define RNGEN   4u
#define IE      8u
#define WORD_PS (40 * 1000000 / 48)

static const register_layout_t registers[] = {
    {"CR", CR, 0, 0xC, ACCESS_RW}, {"SR", SR, 0, 0x67, ACCESS_RC_W0}, {"DR", DR, 0, 0xFFFFFFFF, ACCESS_RO}};

typedef struct {
    model_t model;
    uint32_t state;
    machine_event_t ready;
} rng_t;

static void interrupt(rng_t *r) {
    machine_irq(r->model.machine, 80, (reg(&r->model, CR) & IE) != 0 && (reg(&r->model, SR) & 0x61u) != 0);
}

static void word_ready(void *context, int64_t time_ps) {
    rng_t *const r = context;
    (void)time_ps;
    r->state ^= r->state << 13;
    r->state ^= r->state >> 17;
    r->state ^= r->state << 5;
    r->model.value[DR / 4] = r->state;
    r->model.value[SR / 4] |= 1u;
    interrupt(r);
}

static void next(rng_t *r) {
    machine_schedule(r->model.machine, &r->ready, machine_now(r->model.machine) + WORD_PS);
}

static uint32_t get(model_t *model, uint32_t offset) {
    rng_t *const r = (rng_t *)model;
    if (offset == DR) {
        if ((reg(model, SR) & 1u) == 0) {
            machine_violation(model->machine, "RNG_DR: read while DRDY is 0");
            return 0;
        }
        model->value[SR / 4] &= ~1u;
        interrupt(r);
        if (reg(model, CR) & RNGEN) {
            next(r);
        }
    }
    return reg(model, offset);
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    rng_t *const r = (rng_t *)model;
    if (offset == CR) {
        const uint32_t old = reg(model, CR);
        model->value[CR / 4] = value;
        if ((value & ~old & RNGEN) != 0) {
            if (!rcc_pll_ready(model->chip)) {
                machine_violation(model->machine, "RNG_CR: RNGEN set, but the PLL, its clock, is not ready");
                return;
            }
            next(r);
        } else if ((value & RNGEN) == 0) {
            machine_cancel(model->machine, &r->ready);
        }
    } else {
        model->value[SR / 4] &= value | ~0x60u;
    }
    interrupt(r);
}

static void restart(model_t *model) {
    rng_t *const r = (rng_t *)model;
    machine_cancel(model->machine, &r->ready);
    r->state = 0x9E3779B9u;
    for (unsigned i = 0; i < sizeof model->chip->config->unique_id; i++) {
        r->state = (r->state ^ model->chip->config->unique_id[i]) * 16777619u;
    }
    r->state |= 1u;
    interrupt(r);
}

void rng_create(chip_t *chip) {
    static const model_description_t description = {.name = "RNG",
                                                    .base = 0x50060800,
                                                    .size = 0x400,
                                                    .bus = BUS_AHB,
                                                    .read_widths = WIDTH_32,
                                                    .write_widths = WIDTH_32,
                                                    .registers = registers,
                                                    .register_count = 3,
                                                    .get = get,
                                                    .set = set,
                                                    .restart = restart};
    rng_t *const rng = chip_allocate(chip, sizeof *rng);
    machine_event_init(&rng->ready, word_ready, rng);
    model_attach(chip, &rng->model, &description);
}

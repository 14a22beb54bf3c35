/* rng.c: the random number generator (RM0090 24).
 *
 * A number is ready 40 periods of PLL48CLK after RNGEN was set, or after the number before was read; no number is made
 * while one waits. It follows the configuration's memory_seed, the unique id and the time at which it becomes ready: no
 * board and no reset has the numbers of another, and each run has the same.
 *
 * Setting RNGEN switches both detectors on (24.3.1). The clock's sees that PLL48CLK does not run, or is slower than
 * HCLK / 16: it makes no number then. The seed's sees more than 64 equal bits; a bit is taken to last one period. A
 * noise source that sticks (rng_noise_in) delivers the number before again until it is seen: the manual has the program
 * compare each number with the one before. Clearing RNGEN ends SECS and CECS, as the detectors are off, but not SEIS,
 * CEIS and DRDY, which only a write and a read do.
 *
 * Refused are PLL48CLK above 48 MHz (7.3.2), with which no number is made, and three ways to read RNG_DR: while DRDY is
 * 0; before RNG_SR has shown DRDY of this number ("must check", 24.4.3); after RNG_SR has shown a seed error, until
 * RNGEN was cleared and set ("must not be used", 24.3.2). */
#include "emulator/peripherals/model.h"
#include "emulator/peripherals/outside.h"

#include <math.h>

enum { CR = 0x00, SR = 0x04, DR = 0x08 };
#define RNGEN           4u
#define IE              8u
#define DRDY            1u
#define CECS            2u
#define SECS            4u
#define CEIS            (CECS << 4)
#define SEIS            (SECS << 4)
#define WORD_PERIODS    40.0
#define STUCK_PERIODS   65.0 /* More than 64 equal bits. */
#define SLOWEST_OF_HCLK 16.0

static const register_layout_t registers[] = {
    {"CR", CR, 0, 0xC, ACCESS_RW}, {"SR", SR, 0, 0x67, ACCESS_RC_W0}, {"DR", DR, 0, 0xFFFFFFFF, ACCESS_RO}};

typedef struct {
    model_t model;
    uint64_t seed;
    bool stuck;                 /* The noise source delivers equal bits. */
    bool too_fast;              /* PLL48CLK is above its limit: that has been told. */
    double hz;                  /* PLL48CLK; 0: it does not run. */
    uint32_t shown;             /* What RNG_SR has shown: DRDY since a number was read, SEIS since RNGEN was set. */
    machine_event_t word, seen; /* A number is ready; the detector sees that the noise source sticks. */
} rng_t;

static void interrupt(rng_t *r) {
    machine_irq(r->model.machine, 80,
                (reg(&r->model, CR) & IE) != 0 && (reg(&r->model, SR) & (DRDY | CEIS | SEIS)) != 0);
}

/* What a detector says; its flag for the interrupt rises with it, and stays. */
static void detect(rng_t *r, uint32_t status, bool error) {
    uint32_t *const sr = &r->model.value[SR / 4];
    if (!error) {
        *sr &= ~status;
    } else if ((*sr & status) == 0) {
        *sr |= status | status << 4;
    }
}

/* Let an event wait for its periods of the clock, of which those count that have passed at another frequency. */
static void await(rng_t *r, machine_event_t *event, bool wanted, double periods, double old_hz) {
    machine_t *const machine = r->model.machine;
    const int64_t now = machine_now(machine);
    if (!wanted) {
        machine_cancel(machine, event);
    } else if (event->heap_index < 0) {
        machine_schedule(machine, event, now + (int64_t)ceil(periods * 1e12 / r->hz));
    } else if (r->hz != old_hz) {
        machine_schedule(machine, event, now + (int64_t)ceil((double)(event->time_ps - now) * old_hz / r->hz));
    }
}

/* Registers, clocks or the noise source have changed. Without its clock from RCC all stands still. */
static void follow(rng_t *r) {
    const chip_t *const chip = r->model.chip;
    const bool on = (reg(&r->model, CR) & RNGEN) != 0;
    const double old_hz = r->hz, nominal_hz = rcc_pll48_hz(chip, true);
    r->hz = rcc_pll48_hz(chip, false);
    const bool too_fast = r->model.clocked && on && nominal_hz > PLL48_MOST_HZ;
    if (too_fast && !r->too_fast) {
        machine_violation(chip->machine, "RNG_CR: RNGEN is set while PLLQ makes PLL48CLK %.0f Hz, above 48 MHz",
                          nominal_hz);
    }
    r->too_fast = too_fast;
    if (r->model.clocked) {
        detect(r, CECS, on && r->hz < chip->hclk.hz / SLOWEST_OF_HCLK);
        detect(r, SECS, on && r->stuck && (reg(&r->model, SR) & SECS) != 0);
        interrupt(r);
    }
    const uint32_t sr = reg(&r->model, SR);
    const bool runs = r->model.clocked && on && !too_fast && (sr & CECS) == 0;
    await(r, &r->word, runs && (sr & (DRDY | SECS)) == 0, WORD_PERIODS, old_hz);
    await(r, &r->seen, runs && r->stuck && (sr & SECS) == 0, STUCK_PERIODS, old_hz);
}

static void word_ready(void *context, int64_t time_ps) {
    rng_t *const r = context;
    uint64_t state = r->seed ^ (uint64_t)time_ps;
    if (!r->stuck) {
        r->model.value[DR / 4] = (uint32_t)(machine_random(&state) >> 32);
    }
    r->model.value[SR / 4] |= DRDY;
    interrupt(r);
}

static void stuck_seen(void *context, int64_t time_ps) {
    rng_t *const r = context;
    (void)time_ps;
    detect(r, SECS, true);
    follow(r);
}

static uint32_t read_number(rng_t *r) {
    machine_t *const machine = r->model.machine;
    if ((reg(&r->model, SR) & DRDY) == 0) {
        machine_violation(machine, "RNG_DR: read while DRDY is 0");
        return 0;
    }
    if ((r->shown & SEIS) != 0) {
        machine_violation(machine, "RNG_DR: read although RNG_SR has shown a seed error, and RNGEN was not cleared and "
                                   "set since then: the number must not be used");
    } else if ((r->shown & DRDY) == 0) {
        machine_violation(machine, "RNG_DR: read before RNG_SR has shown DRDY of this number");
    }
    r->model.value[SR / 4] &= ~DRDY;
    r->shown &= ~DRDY;
    follow(r);
    return reg(&r->model, DR);
}

static uint32_t get(model_t *model, uint32_t offset) {
    rng_t *const r = (rng_t *)model;
    if (offset == DR) {
        return read_number(r);
    }
    if (offset == SR) {
        r->shown |= reg(model, SR) & (DRDY | SEIS);
    }
    return reg(model, offset);
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    rng_t *const r = (rng_t *)model;
    if (offset == CR) {
        if ((value & ~reg(model, CR) & RNGEN) != 0) {
            r->shown = 0;
        }
        model->value[CR / 4] = value;
    } else {
        model->value[SR / 4] &= value | ~(CEIS | SEIS);
    }
    follow(r);
}

static void restart(model_t *model) {
    rng_t *const r = (rng_t *)model;
    r->shown = 0;
    follow(r);
    interrupt(r);
}

static void clocks_changed(chip_t *chip) {
    follow((rng_t *)chip_model(chip, "RNG"));
}

void rng_noise_in(machine_t *machine, bool alive) {
    rng_t *const r = (rng_t *)chip_model(chip_of(machine), "RNG");
    r->stuck = !alive;
    follow(r);
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
    machine_event_init(&rng->word, word_ready, rng);
    machine_event_init(&rng->seen, stuck_seen, rng);
    rng->seed = chip->config->memory_seed;
    for (unsigned i = 0; i < sizeof chip->config->unique_id; i++) {
        rng->seed = machine_random(&rng->seed) ^ chip->config->unique_id[i];
    }
    model_attach(chip, &rng->model, &description);
    chip->signals.clocks_changed = clocks_changed;
}

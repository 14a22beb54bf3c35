/* rcc.c: reset and clock control (RM0090 chapter 7, F405/407): registers, oscillators, reset flags (see rcc.h). */
#include "emulator/peripherals/rcc.h"

/* Typical start-up and lock times of the data sheet. */
#define HSI_START_PS   2200000
#define HSE_START_PS   2000000000
#define PLL_LOCK_PS    100000000
#define LSI_START_PS   15000000
#define DRIFT_PS       10000000000 /* The crystal's drift is followed in steps of this length. */
#define CSSF           (1u << 7)
#define PINRSTF        (1u << 26)
#define PORRSTF        (1u << 27)
#define POWER_ON_FLAGS 0x0E000000u /* BORRSTF, PINRSTF, PORRSTF. */

static const register_layout_t registers[] = {
    {"CR", CR, 0x00000083, 0x0F0FFFFB, ACCESS_RW},
    {"PLLCFGR", PLLCFGR, 0x24003010, 0x0F437FFF, ACCESS_RW},
    {"CFGR", CFGR, 0, 0xFFFFFCFF, ACCESS_RW},
    {"CIR", CIR, 0, 0x00BF3F3F, ACCESS_RW},
    {"AHB1RSTR", 0x10, 0, 0x226011FF, ACCESS_RW},
    {"AHB2RSTR", 0x14, 0, 0x000000F1, ACCESS_RW},
    {"AHB3RSTR", 0x18, 0, 0x00000001, ACCESS_RW},
    {"APB1RSTR", 0x20, 0, 0x36FEC9FF, ACCESS_RW},
    {"APB2RSTR", 0x24, 0, 0x00075933, ACCESS_RW},
    {"AHB1ENR", 0x30, 0x00100000, 0x7E7411FF, ACCESS_RW},
    {"AHB2ENR", 0x34, 0, 0x000000F1, ACCESS_RW},
    {"AHB3ENR", 0x38, 0, 0x00000001, ACCESS_RW},
    {"APB1ENR", 0x40, 0, 0x36FEC9FF, ACCESS_RW},
    {"APB2ENR", 0x44, 0, 0x00075F33, ACCESS_RW},
    {"AHB1LPENR", 0x50, 0x7E6791FF, 0x7E6791FF, ACCESS_RW},
    {"AHB2LPENR", 0x54, 0x000000F1, 0x000000F1, ACCESS_RW},
    {"AHB3LPENR", 0x58, 0x00000001, 0x00000001, ACCESS_RW},
    {"APB1LPENR", 0x60, 0x36FEC9FF, 0x36FEC9FF, ACCESS_RW},
    {"APB2LPENR", 0x64, 0x00075F33, 0x00075F33, ACCESS_RW},
    {"BDCR", BDCR, 0, 0x00018307, ACCESS_RW},
    {"CSR", CSR, 0x0E000000, 0xFF000003, ACCESS_RW},
    {"SSCGR", SSCGR, 0, 0xCFFFFFFF, ACCESS_RW},
    {"PLLI2SCFGR", PLLI2SCFGR, 0x20003000, 0x70007FC0, ACCESS_RW},
};

static rcc_t *self(model_t *model) {
    return (rcc_t *)model;
}

static void interrupts(rcc_t *rcc) {
    const uint32_t cir = reg(&rcc->model, CIR);
    machine_irq(rcc->model.machine, 5, (cir & cir >> 8 & 0x3F) != 0);
}

static void flag(rcc_t *rcc, unsigned bit) {
    rcc->model.value[CIR / 4] |= 1u << bit;
    interrupts(rcc);
}

/* SW becomes SWS as soon as the chosen clock is ready. */
static void try_switch(rcc_t *rcc) {
    static const uint32_t ready[3] = {HSIRDY, HSERDY, PLLRDY};
    uint32_t *const cfgr = &rcc->model.value[CFGR / 4];
    const unsigned wanted = *cfgr & 3u;
    if (wanted < 3 && field(*cfgr, 2, 2) != wanted && (reg(&rcc->model, CR) & ready[wanted]) != 0) {
        *cfgr = (*cfgr & ~0xCu) | wanted << 2;
        rcc_update_clocks(rcc);
    }
}

static void pll_start(rcc_t *rcc) {
    const uint32_t cr = reg(&rcc->model, CR), c = reg(&rcc->model, PLLCFGR);
    const bool hse = (c >> 22 & 1u) != 0;
    if ((cr & (hse ? HSERDY : HSIRDY)) == 0) {
        machine_violation(rcc->model.machine, "RCC_CR: PLLON while its source %s is not ready", hse ? "HSE" : "HSI");
        return;
    }
    const unsigned m = field(c, 0, 6), n = field(c, 6, 9), q = field(c, 24, 4);
    const double input = m < 2 ? 0 : rcc_pll_input(rcc, true) / m;
    if (m < 2 || n < 50 || n > 432 || q < 2) {
        machine_violation(rcc->model.machine, "RCC_PLLCFGR: PLLM %u, PLLN %u, PLLQ %u: not in 2..63, 50..432, 2..15", m,
                          n, q);
    } else if (input < 0.95e6 || input > 2.1e6 || input * n < 100e6 || input * n > 432e6) {
        machine_violation(rcc->model.machine,
                          "RCC_PLLCFGR: VCO input %.0f Hz (0.95 to 2.1 MHz), output %.0f Hz (100 to 432 MHz)", input,
                          input * n);
    } else if (input * n / q > PLL48_MOST_HZ && (reg(&rcc->model, 0x34) & 0xC0u) != 0) {
        machine_violation(rcc->model.machine, "RCC_PLLCFGR: PLLQ makes %.0f Hz, above 48 MHz", input * n / q);
    }
    machine_schedule(rcc->model.machine, &rcc->pll, machine_now(rcc->model.machine) + PLL_LOCK_PS);
}

/* RM0090 7.2.7: the clock security system. Everything that the crystal drives falls back to the internal oscillator. */
static void crystal_lost(rcc_t *rcc) {
    chip_t *const chip = rcc->model.chip;
    uint32_t *const cr = &rcc->model.value[CR / 4], *const cfgr = &rcc->model.value[CFGR / 4];
    const unsigned used = field(*cfgr, 2, 2);
    const bool pll_on_hse = (reg(&rcc->model, PLLCFGR) >> 22 & 1u) != 0;
    *cr &= ~(HSEON | HSERDY);
    if (used == 1 || (used == 2 && pll_on_hse)) {
        if (used == 2) {
            *cr &= ~(PLLON | PLLRDY);
            machine_cancel(chip->machine, &rcc->pll);
        }
        *cr |= HSION | HSIRDY; /* Its start-up of 2 us is left out. */
        *cfgr &= ~0xFu;
        rcc_update_clocks(rcc);
    }
    rcc->model.value[CIR / 4] |= CSSF;
    machine_nmi(chip->machine, true);
    if (chip->signals.clock_failed != NULL) {
        chip->signals.clock_failed(chip);
    }
}

/* The crystal is watched once it was ready. */
static bool loss_is_seen(const rcc_t *rcc) {
    const uint32_t watched = CSSON | HSERDY;
    return rcc->crystal_stopped && (reg(&rcc->model, CR) & watched) == watched;
}

void rcc_crystal_in(machine_t *machine, bool alive) {
    rcc_t *const rcc = chip_of(machine)->rcc;
    const uint32_t cr = reg(&rcc->model, CR);
    if (rcc->crystal_stopped == !alive) {
        return;
    }
    rcc->crystal_stopped = !alive;
    if (!alive) {
        machine_cancel(machine, &rcc->hse);
    } else if ((cr & HSEON) != 0 && (cr & HSERDY) == 0 && !rcc->model.chip->config->crystal_dead) {
        machine_schedule(machine, &rcc->hse, machine_now(machine) + HSE_START_PS);
    }
    if (loss_is_seen(rcc)) {
        crystal_lost(rcc);
    } else {
        rcc_update_clocks(rcc);
    }
}

static void write_cr(rcc_t *rcc, uint32_t value) {
    machine_t *const machine = rcc->model.machine;
    const emulator_config_t *const config = rcc->model.chip->config;
    const int64_t now = machine_now(machine);
    uint32_t *const cr = &rcc->model.value[CR / 4];
    const uint32_t old = *cr, ready = HSIRDY | HSERDY | PLLRDY | PLLI2SRDY;
    const unsigned used = field(reg(&rcc->model, CFGR), 2, 2);
    const bool pll_on_hse = (reg(&rcc->model, PLLCFGR) >> 22 & 1u) != 0;
    /* Hardware keeps a clock that the system uses. */
    if (!(value & HSION) && (used == 0 || (used == 2 && !pll_on_hse))) {
        machine_violation(machine, "RCC_CR: HSION cleared while HSI drives the system clock");
        value |= HSION;
    }
    if (!(value & HSEON) && (used == 1 || (used == 2 && pll_on_hse))) {
        machine_violation(machine, "RCC_CR: HSEON cleared while HSE drives the system clock");
        value |= HSEON;
    }
    if (!(value & PLLON) && used == 2) {
        machine_violation(machine, "RCC_CR: PLLON cleared while the PLL is the system clock");
        value |= PLLON;
    }
    if (((value ^ old) & HSEBYP) != 0 && (old & HSEON) != 0) {
        machine_violation(machine, "RCC_CR: HSEBYP changed while HSE is on");
        value ^= HSEBYP;
    }
    *cr = (value & ~(ready | 0xFF00u)) | (old & (ready | 0xFF00u));
    if ((value & HSION) && !(old & HSION)) {
        machine_schedule(machine, &rcc->hsi, now + HSI_START_PS);
    } else if (!(value & HSION)) {
        machine_cancel(machine, &rcc->hsi);
        *cr &= ~HSIRDY;
    }
    if ((value & HSEON) && !(old & HSEON)) {
        if (value & HSEBYP) {
            machine_violation(machine, "RCC_CR: HSEBYP set, but the board has a crystal: no clock arrives");
        } else if (!config->crystal_dead && !rcc->crystal_stopped) {
            machine_schedule(machine, &rcc->hse, now + HSE_START_PS);
        }
    } else if (!(value & HSEON)) {
        machine_cancel(machine, &rcc->hse);
        *cr &= ~HSERDY;
    }
    if ((value & PLLON) && !(old & PLLON)) {
        pll_start(rcc);
    } else if (!(value & PLLON)) {
        machine_cancel(machine, &rcc->pll);
        *cr &= ~PLLRDY;
        rcc_tell_clocks(rcc->model.chip);
    }
    if ((value & PLLI2SON) && !(old & PLLI2SON)) {
        machine_schedule(machine, &rcc->plli2s, now + PLL_LOCK_PS);
    } else if (!(value & PLLI2SON)) {
        machine_cancel(machine, &rcc->plli2s);
        *cr &= ~PLLI2SRDY;
    }
    if (loss_is_seen(rcc)) {
        crystal_lost(rcc);
    }
}

static void write_csr(rcc_t *rcc, uint32_t value) {
    uint32_t *const csr = &rcc->model.value[CSR / 4];
    if (value & 1u << 24) { /* RMVF */
        *csr &= ~0xFE000000u;
        rcc->reset_flags = 0;
    }
    *csr = (*csr & ~1u) | (value & 1u);
    if ((value & 1u) && !(*csr & 2u)) {
        machine_schedule(rcc->model.machine, &rcc->lsi, machine_now(rcc->model.machine) + LSI_START_PS);
    } else if (!(value & 1u) && !rcc->lsi_forced) {
        machine_cancel(rcc->model.machine, &rcc->lsi);
        *csr &= ~2u;
    }
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    rcc_t *const rcc = self(model);
    const uint32_t old = reg(model, offset);
    switch (offset) {
    case CR:
        write_cr(rcc, value);
        return;
    case PLLCFGR:
        if ((reg(model, CR) & PLLON) != 0 && value != old) {
            machine_violation(model->machine, "RCC_PLLCFGR: written while the PLL is on");
            return;
        }
        break;
    case CFGR:
        if ((value & 3u) == 3u) {
            machine_violation(model->machine, "RCC_CFGR: SW = 3 is not allowed");
            return;
        }
        model->value[CFGR / 4] = (value & ~0xCu) | (old & 0xCu);
        rcc_update_clocks(rcc);
        try_switch(rcc);
        return;
    case CIR:
        model->value[CIR / 4] = (value & 0x3F00u) | (old & 0xBFu & ~(value >> 16));
        machine_nmi(model->machine, (reg(model, CIR) & CSSF) != 0);
        interrupts(rcc);
        return;
    case BDCR:
        if (value & 0x18005u) {
            model_missing(model, "the backup domain (RCC_BDCR: LSE, RTC)");
        }
        return;
    case CSR:
        write_csr(rcc, value);
        return;
    case SSCGR:
        if (value >> 31) {
            model_missing(model, "spread spectrum");
        }
        break;
    case PLLI2SCFGR:
        break;
    default:
        if (offset >= AHB1RSTR && offset <= APB2RSTR) {
            rcc_write_reset(rcc, offset, value);
        } else if (offset >= AHB1ENR && offset <= APB2ENR) {
            rcc_write_enable(rcc, offset, value);
        } else if (value != old) {
            model_missing(model, "clocks that stop in sleep (xxxLPENR other than after reset)");
        }
        return;
    }
    model->value[offset / 4] = value;
}

static void hsi_ready(void *context, int64_t time_ps) {
    rcc_t *const rcc = context;
    (void)time_ps;
    rcc->model.value[CR / 4] |= HSIRDY;
    flag(rcc, 2);
    try_switch(rcc);
}

static void hse_ready(void *context, int64_t time_ps) {
    rcc_t *const rcc = context;
    (void)time_ps;
    rcc->model.value[CR / 4] |= HSERDY;
    flag(rcc, 3);
    try_switch(rcc);
}

static void pll_ready(void *context, int64_t time_ps) {
    rcc_t *const rcc = context;
    (void)time_ps;
    rcc->model.value[CR / 4] |= PLLRDY;
    flag(rcc, 4);
    try_switch(rcc);
    rcc_tell_clocks(rcc->model.chip);
}

static void plli2s_ready(void *context, int64_t time_ps) {
    rcc_t *const rcc = context;
    (void)time_ps;
    rcc->model.value[CR / 4] |= PLLI2SRDY;
    flag(rcc, 5);
}

static void lsi_ready(void *context, int64_t time_ps) {
    rcc_t *const rcc = context;
    (void)time_ps;
    rcc->model.value[CSR / 4] |= 2u;
    flag(rcc, 0);
}

static void drift(void *context, int64_t time_ps) {
    rcc_t *const rcc = context;
    machine_schedule(rcc->model.machine, &rcc->drift, time_ps + DRIFT_PS);
    rcc_trim_clocks(rcc);
}

void rcc_force_lsi(chip_t *chip) {
    chip->rcc->lsi_forced = true;
    chip->rcc->model.value[CSR / 4] |= 2u;
}

static void restart(model_t *model) {
    rcc_t *const rcc = self(model);
    chip_t *const chip = model->chip;
    machine_event_t *const events[] = {&rcc->hsi, &rcc->hse, &rcc->pll, &rcc->plli2s, &rcc->lsi};
    for (unsigned i = 0; i < sizeof events / sizeof events[0]; i++) {
        machine_cancel(chip->machine, events[i]);
    }
    /* Every reset drives the NRST pin; flags stay until RMVF. */
    const uint32_t causes = machine_reset_flags(chip->machine);
    if (!rcc->powered_on || (causes & PORRSTF) != 0) {
        rcc->reset_flags = POWER_ON_FLAGS;
    } else {
        rcc->reset_flags |= PINRSTF | causes;
    }
    rcc->powered_on = true;
    rcc->lsi_forced = false;
    model->value[CSR / 4] = rcc->reset_flags;
    rcc_close_gates(rcc);
    rcc_update_clocks(rcc);
    if (rcc_drifts(chip->config) && rcc->drift.heap_index < 0) {
        machine_schedule(chip->machine, &rcc->drift, (machine_now(chip->machine) / DRIFT_PS + 1) * DRIFT_PS);
    }
}

void rcc_create(chip_t *chip) {
    static const model_description_t description = {.name = "RCC",
                                                    .base = 0x40023800,
                                                    .size = 0x400,
                                                    .bus = BUS_CORE,
                                                    .read_widths = WIDTH_ANY,
                                                    .write_widths = WIDTH_ANY,
                                                    .registers = registers,
                                                    .register_count = sizeof registers / sizeof registers[0],
                                                    .set = set,
                                                    .restart = restart};
    rcc_t *const rcc = chip_allocate(chip, sizeof *rcc);
    chip->rcc = rcc;
    machine_event_init(&rcc->hsi, hsi_ready, rcc);
    machine_event_init(&rcc->hse, hse_ready, rcc);
    machine_event_init(&rcc->pll, pll_ready, rcc);
    machine_event_init(&rcc->plli2s, plli2s_ready, rcc);
    machine_event_init(&rcc->lsi, lsi_ready, rcc);
    machine_event_init(&rcc->drift, drift, rcc);
    model_attach(chip, &rcc->model, &description);
}

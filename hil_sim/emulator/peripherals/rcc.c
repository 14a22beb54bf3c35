/* rcc.c: reset and clock control (RM0090 chapter 7, F405/407). Limits: data sheet DS8626 table 14 and 5.3.9 ff. at
 * 3.3 V. */
#include "emulator/peripherals/model.h"

#include <string.h>

#define PICOSECONDS 1e12
#define HSI_HZ      16e6
#define HSE_HZ      8e6
#define LSI_HZ      32e3
/* Typical start-up and lock times of the data sheet. */
#define HSI_START_PS 2200000
#define HSE_START_PS 2000000000
#define PLL_LOCK_PS  100000000
#define LSI_START_PS 15000000

enum {
    CR = 0x00,
    PLLCFGR = 0x04,
    CFGR = 0x08,
    CIR = 0x0C,
    AHB1RSTR = 0x10,
    APB2RSTR = 0x24,
    AHB1ENR = 0x30,
    APB2ENR = 0x44,
    AHB1LPENR = 0x50,
    APB2LPENR = 0x64,
    BDCR = 0x70,
    CSR = 0x74,
    SSCGR = 0x80,
    PLLI2SCFGR = 0x84
};
#define HSION        1u
#define HSIRDY       2u
#define HSEON        (1u << 16)
#define HSERDY       (1u << 17)
#define HSEBYP       (1u << 18)
#define PLLON        (1u << 24)
#define PLLRDY       (1u << 25)
#define PLLI2SON     (1u << 26)
#define PLLI2SRDY    (1u << 27)
#define CCMDATARAMEN (1u << 20) /* AHB1ENR */

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

/* Which enable bit (and reset bit at the same place, 0x20 below) belongs to which model. ADC: three enables, one
 * reset (bit 8). */
static const struct {
    const char *name;
    uint16_t enable;
    uint8_t bit;
} gates[] = {
    {"GPIOA", 0x30, 0},  {"GPIOB", 0x30, 1},  {"GPIOC", 0x30, 2}, {"GPIOD", 0x30, 3},   {"GPIOE", 0x30, 4},
    {"GPIOF", 0x30, 5},  {"GPIOG", 0x30, 6},  {"GPIOH", 0x30, 7}, {"GPIOI", 0x30, 8},   {"CRC", 0x30, 12},
    {"DMA1", 0x30, 21},  {"DMA2", 0x30, 22},  {"RNG", 0x34, 6},   {"TIM2", 0x40, 0},    {"TIM3", 0x40, 1},
    {"TIM4", 0x40, 2},   {"TIM5", 0x40, 3},   {"TIM6", 0x40, 4},  {"TIM7", 0x40, 5},    {"TIM12", 0x40, 6},
    {"TIM13", 0x40, 7},  {"TIM14", 0x40, 8},  {"WWDG", 0x40, 11}, {"USART2", 0x40, 17}, {"USART3", 0x40, 18},
    {"UART4", 0x40, 19}, {"UART5", 0x40, 20}, {"CAN1", 0x40, 25}, {"CAN2", 0x40, 26},   {"PWR", 0x40, 28},
    {"DAC", 0x40, 29},   {"TIM1", 0x44, 0},   {"TIM8", 0x44, 1},  {"USART1", 0x44, 4},  {"USART6", 0x44, 5},
    {"ADC1", 0x44, 8},   {"ADC2", 0x44, 9},   {"ADC3", 0x44, 10}, {"SYSCFG", 0x44, 14}, {"TIM9", 0x44, 16},
    {"TIM10", 0x44, 17}, {"TIM11", 0x44, 18},
};
enum { GATES = sizeof gates / sizeof gates[0] };

struct rcc {
    model_t model;
    machine_event_t hsi, hse, pll, plli2s, lsi;
    uint32_t reset_flags;
    bool powered_on;
    bool lsi_forced; /* By the independent watchdog. */
    model_t *gated[GATES];
};

static rcc_t *self(model_t *model) {
    return (rcc_t *)model;
}

static unsigned ahb_divider(uint32_t cfgr) {
    static const uint16_t dividers[16] = {1, 1, 1, 1, 1, 1, 1, 1, 2, 4, 8, 16, 64, 128, 256, 512};
    return dividers[field(cfgr, 4, 4)];
}

static unsigned apb_divider(uint32_t bits) {
    return bits < 4 ? 1u : 2u << (bits - 4u);
}

static double pll_input(const rcc_t *rcc, bool nominal) {
    const emulator_config_t *const config = rcc->model.chip->config;
    const bool hse = (reg(&rcc->model, PLLCFGR) >> 22 & 1u) != 0;
    const double error = nominal ? 0 : 1e-6 * (hse ? config->crystal_ppm : config->internal_ppm);
    return (hse ? HSE_HZ : HSI_HZ) * (1 + error);
}

static double pll_output(const rcc_t *rcc, bool nominal) {
    const uint32_t c = reg(&rcc->model, PLLCFGR);
    const unsigned m = field(c, 0, 6), n = field(c, 6, 9), p = 2 * (field(c, 16, 2) + 1);
    return pll_input(rcc, nominal) * n / (m == 0 ? 1 : m) / p;
}

static double system_clock(const rcc_t *rcc, bool nominal) {
    const emulator_config_t *const config = rcc->model.chip->config;
    switch (field(reg(&rcc->model, CFGR), 2, 2)) {
    case 1:
        return HSE_HZ * (nominal ? 1 : 1 + 1e-6 * config->crystal_ppm);
    case 2:
        return pll_output(rcc, nominal);
    default:
        return HSI_HZ * (nominal ? 1 : 1 + 1e-6 * config->internal_ppm);
    }
}

static void domain_set(clock_domain_t *domain, int64_t now, double hz, double nominal) {
    if (domain->hz == hz) {
        return;
    }
    domain->anchor_tick = domain->period_ps > 0 ? clock_tick(domain, now) : 0;
    domain->anchor_ps = now;
    domain->hz = hz;
    domain->nominal_hz = nominal;
    domain->period_ps = PICOSECONDS / hz;
}

void rcc_check_limits(chip_t *chip) {
    const double hz = chip->hclk.nominal_hz;
    const unsigned needed = (unsigned)((hz - 1.0) / 30e6);
    if (flash_wait_states(chip) < needed) {
        machine_violation(chip->machine,
                          "FLASH_ACR: LATENCY %u is too few wait states for HCLK %.0f Hz at 3.3 V, which needs %u",
                          flash_wait_states(chip), hz, needed);
    }
    if (hz > (pwr_scale(chip) == 1 ? 168e6 : 144e6)) {
        machine_violation(chip->machine, "RCC: HCLK %.0f Hz is above the limit of regulator scale %u", hz,
                          pwr_scale(chip));
    }
    if (chip->pclk1.nominal_hz > 42e6) {
        machine_violation(chip->machine, "RCC_CFGR: PPRE1 makes PCLK1 %.0f Hz, above 42 MHz", chip->pclk1.nominal_hz);
    }
    if (chip->pclk2.nominal_hz > 84e6) {
        machine_violation(chip->machine, "RCC_CFGR: PPRE2 makes PCLK2 %.0f Hz, above 84 MHz", chip->pclk2.nominal_hz);
    }
}

static void update_clocks(rcc_t *rcc) {
    chip_t *const chip = rcc->model.chip;
    const uint32_t cfgr = reg(&rcc->model, CFGR);
    const unsigned ahb = ahb_divider(cfgr), apb1 = apb_divider(field(cfgr, 10, 3)),
                   apb2 = apb_divider(field(cfgr, 13, 3));
    const double hclk = system_clock(rcc, false) / ahb, nominal = system_clock(rcc, true) / ahb;
    const int64_t now = machine_now(chip->machine);
    if (chip->hclk.hz == hclk && chip->pclk1.hz == hclk / apb1 && chip->pclk2.hz == hclk / apb2) {
        return;
    }
    tim_before_change(chip);
    domain_set(&chip->hclk, now, hclk, nominal);
    domain_set(&chip->pclk1, now, hclk / apb1, nominal / apb1);
    domain_set(&chip->pclk2, now, hclk / apb2, nominal / apb2);
    domain_set(&chip->timer1, now, hclk / apb1 * (apb1 == 1 ? 1 : 2), nominal / apb1 * (apb1 == 1 ? 1 : 2));
    domain_set(&chip->timer2, now, hclk / apb2 * (apb2 == 1 ? 1 : 2), nominal / apb2 * (apb2 == 1 ? 1 : 2));
    machine_set_core_clock(chip->machine, hclk);
    rcc_check_limits(chip);
    tim_after_change(chip);
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
        update_clocks(rcc);
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
    const double input = m < 2 ? 0 : pll_input(rcc, true) / m;
    if (m < 2 || n < 50 || n > 432 || q < 2) {
        machine_violation(rcc->model.machine, "RCC_PLLCFGR: PLLM %u, PLLN %u, PLLQ %u: not in 2..63, 50..432, 2..15", m,
                          n, q);
    } else if (input < 0.95e6 || input > 2.1e6 || input * n < 100e6 || input * n > 432e6) {
        machine_violation(rcc->model.machine,
                          "RCC_PLLCFGR: VCO input %.0f Hz (0.95 to 2.1 MHz), output %.0f Hz (100 to 432 MHz)", input,
                          input * n);
    } else if (input * n / q > 48.0001e6 && (reg(&rcc->model, 0x34) & 0xC0u) != 0) {
        machine_violation(rcc->model.machine, "RCC_PLLCFGR: PLLQ makes %.0f Hz, above 48 MHz", input * n / q);
    }
    machine_schedule(rcc->model.machine, &rcc->pll, machine_now(rcc->model.machine) + PLL_LOCK_PS);
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
        } else if (!config->crystal_dead) {
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
    }
    if ((value & PLLI2SON) && !(old & PLLI2SON)) {
        machine_schedule(machine, &rcc->plli2s, now + PLL_LOCK_PS);
    } else if (!(value & PLLI2SON)) {
        machine_cancel(machine, &rcc->plli2s);
        *cr &= ~PLLI2SRDY;
    }
}

static void write_enable(rcc_t *rcc, uint32_t offset, uint32_t value) {
    chip_t *const chip = rcc->model.chip;
    const clock_domain_t *const bus = offset == 0x40 ? &chip->pclk1 : offset == 0x44 ? &chip->pclk2 : &chip->hclk;
    /* ES0182 2.1.6: two AHB cycles, or one and the AHB-to-APB ratio. The access itself is not later than one
     * instruction after the write. */
    const double cycles = offset < 0x40 ? 2 : 1 + chip->hclk.hz / bus->hz;
    const int64_t settled = machine_now(chip->machine) + (int64_t)(cycles * chip->hclk.period_ps);
    rcc->model.value[offset / 4] = value;
    if (offset == AHB1ENR && (value & CCMDATARAMEN) == 0) {
        model_missing(&rcc->model, "the core-coupled memory's clock switched off (CCMDATARAMEN 0)");
    }
    for (unsigned i = 0; i < GATES; i++) {
        if (gates[i].enable == offset && rcc->gated[i] != NULL) {
            model_clock(rcc->gated[i], (value >> gates[i].bit & 1u) != 0, settled);
        }
    }
    if (offset == 0x44) {
        model_t *const common = chip_model(chip, "C_ADC");
        if (common != NULL) {
            model_clock(common, (value & 0x700u) != 0, settled);
        }
    }
}

static void write_reset(rcc_t *rcc, uint32_t offset, uint32_t value) {
    const uint32_t changed = value ^ reg(&rcc->model, offset);
    rcc->model.value[offset / 4] = value;
    for (unsigned i = 0; i < GATES; i++) {
        const bool adc = gates[i].enable == 0x44 && gates[i].bit >= 8 && gates[i].bit <= 10;
        const unsigned bit = adc ? 8u : gates[i].bit;
        if (gates[i].enable != offset + 0x20 || rcc->gated[i] == NULL || (changed >> bit & 1u) == 0) {
            continue;
        }
        rcc->gated[i]->in_reset = (value >> bit & 1u) != 0;
        if (rcc->gated[i]->in_reset) {
            model_reset(rcc->gated[i]);
            if (adc && gates[i].bit == 8) {
                model_reset(chip_model(rcc->model.chip, "C_ADC"));
            }
        }
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
        update_clocks(rcc);
        try_switch(rcc);
        return;
    case CIR:
        model->value[CIR / 4] = (value & 0x3F00u) | (old & 0xBFu & ~(value >> 16));
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
            write_reset(rcc, offset, value);
        } else if (offset >= AHB1ENR && offset <= APB2ENR) {
            write_enable(rcc, offset, value);
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

void rcc_force_lsi(chip_t *chip) {
    chip->rcc->lsi_forced = true;
    chip->rcc->model.value[CSR / 4] |= 2u;
}

bool rcc_pll_ready(const chip_t *chip) {
    return (reg(&chip->rcc->model, CR) & PLLRDY) != 0;
}

double rcc_lsi_hz(const chip_t *chip) {
    return LSI_HZ * (1 + 1e-6 * chip->config->internal_ppm);
}

static void restart(model_t *model) {
    rcc_t *const rcc = self(model);
    chip_t *const chip = model->chip;
    machine_event_t *const events[] = {&rcc->hsi, &rcc->hse, &rcc->pll, &rcc->plli2s, &rcc->lsi};
    for (unsigned i = 0; i < sizeof events / sizeof events[0]; i++) {
        machine_cancel(chip->machine, events[i]);
    }
    /* Every reset drives the NRST pin; flags stay until RMVF. */
    rcc->reset_flags |= rcc->powered_on ? 1u << 26 | machine_reset_flags(chip->machine) : 0x0E000000u;
    rcc->powered_on = true;
    rcc->lsi_forced = false;
    model->value[CSR / 4] = rcc->reset_flags;
    for (unsigned i = 0; i < GATES; i++) {
        rcc->gated[i] = chip_model(chip, gates[i].name);
        if (rcc->gated[i] != NULL) {
            rcc->gated[i]->clocked = rcc->gated[i]->in_reset = rcc->gated[i]->settling = false;
        }
    }
    model_t *const common = chip_model(chip, "C_ADC");
    if (common != NULL) {
        common->clocked = false;
    }
    update_clocks(rcc);
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
    model_attach(chip, &rcc->model, &description);
}

/* ---- machine.h ---- */

bool rcc_enabled(const machine_t *machine, const char *name) {
    const model_t *const model = chip_model(chip_of(machine), name);
    return model != NULL && model->clocked;
}

double rcc_bus_clock(const machine_t *machine, const char *name) {
    const chip_t *const chip = chip_of(machine);
    const model_t *const model = chip_model(chip, name);
    if (model == NULL) {
        return 0;
    }
    switch (model->description->bus) {
    case BUS_APB1:
        return chip->pclk1.hz;
    case BUS_APB2:
        return chip->pclk2.hz;
    default:
        return chip->hclk.hz;
    }
}

double rcc_timer_clock(const machine_t *machine, const char *name) {
    const chip_t *const chip = chip_of(machine);
    const model_t *const model = chip_model(chip, name);
    if (model == NULL) {
        return 0;
    }
    return model->description->bus == BUS_APB2 ? chip->timer2.hz : chip->timer1.hz;
}

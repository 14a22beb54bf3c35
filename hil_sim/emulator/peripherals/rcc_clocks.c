/* rcc_clocks.c: frequencies (see rcc.h). Limits: data sheet DS8626 table 14 and 5.3.9 ff. at 3.3 V. */
#include "emulator/peripherals/rcc.h"

#include <math.h>

#define PICOSECONDS  1e12
#define HSI_HZ       16e6
#define HSE_HZ       12e6
#define LSI_HZ       32e3
#define DRIFT_STEP_S 0.01 /* As DRIFT_PS of rcc.c: the middle of a step stands for the whole. */

/* A PLL whose input stopped runs on at its oscillator's lower end: on an STM32F407 about a twentieth of 168 MHz. A core
 * on a crystal that stopped stands still; 1 Hz keeps its time finite. */
#define FREE_RUNNING 20.0
#define STANDSTILL   1.0

/* What the limits depend on, in the registers of FLASH and PWR. */
enum { FLASH_ACR = 0x00, PWR_CR = 0x00 };
#define PWR_VOS (1u << 14)

static unsigned ahb_divider(uint32_t cfgr) {
    static const uint16_t dividers[16] = {1, 1, 1, 1, 1, 1, 1, 1, 2, 4, 8, 16, 64, 128, 256, 512};
    return dividers[field(cfgr, 4, 4)];
}

static unsigned apb_divider(uint32_t bits) {
    return bits < 4 ? 1u : 2u << (bits - 4u);
}

bool rcc_drifts(const emulator_config_t *config) {
    return config->crystal_ppm_per_s != 0 || config->crystal_ppm_per_K * config->temperature_K_per_s != 0;
}

static double crystal_ppm(const rcc_t *rcc) {
    const emulator_config_t *const config = rcc->model.chip->config;
    if (!rcc_drifts(config)) {
        return config->crystal_ppm;
    }
    const double time_s = (double)machine_now(rcc->model.machine) / PICOSECONDS;
    const double middle_s = (floor(time_s / DRIFT_STEP_S + 1e-6) + 0.5) * DRIFT_STEP_S;
    return config->crystal_ppm +
           middle_s * (config->crystal_ppm_per_s + config->crystal_ppm_per_K * config->temperature_K_per_s);
}

double chip_temperature_degc(const chip_t *chip) {
    const double time_s = (double)machine_now(chip->machine) / PICOSECONDS;
    return chip->config->temperature_degc + chip->config->temperature_K_per_s * time_s;
}

double rcc_pll_input(const rcc_t *rcc, bool nominal) {
    const bool hse = (reg(&rcc->model, PLLCFGR) >> 22 & 1u) != 0;
    const double error = nominal ? 0 : 1e-6 * (hse ? crystal_ppm(rcc) : rcc->model.chip->config->internal_ppm);
    const double input = (hse ? HSE_HZ : HSI_HZ) * (1 + error);
    return hse && rcc->crystal_stopped && !nominal ? input / FREE_RUNNING : input;
}

static double pll_oscillator(const rcc_t *rcc, bool nominal) {
    const uint32_t c = reg(&rcc->model, PLLCFGR);
    const unsigned m = field(c, 0, 6), n = field(c, 6, 9);
    return rcc_pll_input(rcc, nominal) * n / (m == 0 ? 1 : m);
}

static double pll_output(const rcc_t *rcc, bool nominal) {
    const unsigned p = 2 * (field(reg(&rcc->model, PLLCFGR), 16, 2) + 1);
    return pll_oscillator(rcc, nominal) / p;
}

double rcc_pll48_hz(const chip_t *chip, bool nominal) {
    const rcc_t *const rcc = chip->rcc;
    const unsigned q = field(reg(&rcc->model, PLLCFGR), 24, 4);
    return (reg(&rcc->model, CR) & PLLRDY) == 0 || q == 0 ? 0 : pll_oscillator(rcc, nominal) / q;
}

static double system_clock(const rcc_t *rcc, bool nominal) {
    const emulator_config_t *const config = rcc->model.chip->config;
    switch (field(reg(&rcc->model, CFGR), 2, 2)) {
    case 1:
        return nominal ? HSE_HZ : rcc->crystal_stopped ? STANDSTILL : HSE_HZ * (1 + 1e-6 * crystal_ppm(rcc));
    case 2:
        return pll_output(rcc, nominal);
    default:
        return HSI_HZ * (nominal ? 1 : 1 + 1e-6 * config->internal_ppm);
    }
}

/* A switched clock starts anew with the switch; one that is only trimmed goes on from the present tick's start. */
static void domain_set(clock_domain_t *domain, int64_t now, double hz, double nominal, bool trim) {
    if (domain->hz == hz) {
        return;
    }
    const int64_t tick = domain->period_ps > 0 ? clock_tick(domain, now) : 0;
    domain->anchor_ps = trim ? clock_time(domain, tick) : now;
    domain->anchor_tick = tick;
    domain->hz = hz;
    domain->nominal_hz = nominal;
    domain->period_ps = PICOSECONDS / hz;
}

void rcc_check_limits(chip_t *chip) {
    const double hz = chip->hclk.nominal_hz;
    const unsigned wait_states = reg(chip->flash, FLASH_ACR) & 7u;
    const unsigned scale = (reg(chip->pwr, PWR_CR) & PWR_VOS) != 0 ? 1 : 2;
    /* RM0090 table 10: how fast the flash is at a supply. */
    const double supply = chip->supply_V;
    const double step = supply >= 2.7 ? 30e6 : supply >= 2.4 ? 24e6 : supply >= 2.1 ? 22e6 : 20e6;
    const unsigned needed = (unsigned)((hz - 1.0) / step);
    if (wait_states < needed) {
        machine_violation(chip->machine,
                          "FLASH_ACR: LATENCY %u is too few wait states for HCLK %.0f Hz at %.2f V, which needs %u",
                          wait_states, hz, supply, needed);
    }
    if (hz > (scale == 1 ? 168e6 : 144e6)) {
        machine_violation(chip->machine, "RCC: HCLK %.0f Hz is above the limit of regulator scale %u", hz, scale);
    }
    if (chip->pclk1.nominal_hz > 42e6) {
        machine_violation(chip->machine, "RCC_CFGR: PPRE1 makes PCLK1 %.0f Hz, above 42 MHz", chip->pclk1.nominal_hz);
    }
    if (chip->pclk2.nominal_hz > 84e6) {
        machine_violation(chip->machine, "RCC_CFGR: PPRE2 makes PCLK2 %.0f Hz, above 84 MHz", chip->pclk2.nominal_hz);
    }
}

static void set_clocks(rcc_t *rcc, bool trim) {
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
    domain_set(&chip->hclk, now, hclk, nominal, trim);
    domain_set(&chip->pclk1, now, hclk / apb1, nominal / apb1, trim);
    domain_set(&chip->pclk2, now, hclk / apb2, nominal / apb2, trim);
    domain_set(&chip->timer1, now, hclk / apb1 * (apb1 == 1 ? 1 : 2), nominal / apb1 * (apb1 == 1 ? 1 : 2), trim);
    domain_set(&chip->timer2, now, hclk / apb2 * (apb2 == 1 ? 1 : 2), nominal / apb2 * (apb2 == 1 ? 1 : 2), trim);
    machine_set_core_clock(chip->machine, hclk);
    rcc_check_limits(chip);
    tim_after_change(chip);
}

void rcc_tell_clocks(chip_t *chip) {
    if (chip->signals.clocks_changed != NULL) {
        chip->signals.clocks_changed(chip);
    }
}

void rcc_update_clocks(rcc_t *rcc) {
    set_clocks(rcc, false);
    rcc_tell_clocks(rcc->model.chip);
}

void rcc_trim_clocks(rcc_t *rcc) {
    set_clocks(rcc, true);
}

double rcc_lsi_hz(const chip_t *chip) {
    return LSI_HZ * (1 + 1e-6 * chip->config->internal_ppm);
}

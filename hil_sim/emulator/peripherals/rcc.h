/* rcc.h: between the parts of the model of reset and clock control (RM0090 chapter 7).
 *
 *     rcc.c         registers, oscillators, reset flags
 *     rcc_clocks.c  frequencies, from the registers, and their limits
 *     rcc_gates.c   the peripherals' clock enables and resets
 */
#ifndef GOLDFIELD_RCC_H
#define GOLDFIELD_RCC_H

#include "emulator/peripherals/model.h"

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
#define CSSON        (1u << 19)
#define PLLON        (1u << 24)
#define PLLRDY       (1u << 25)
#define PLLI2SON     (1u << 26)
#define PLLI2SRDY    (1u << 27)
#define CCMDATARAMEN (1u << 20) /* AHB1ENR */

enum { RCC_GATES = 42 }; /* Models that RCC gates. */

struct rcc {
    model_t model;
    machine_event_t hsi, hse, pll, plli2s, lsi; /* Their oscillator becomes ready. */
    uint32_t reset_flags;
    bool powered_on;
    bool crystal_stopped;  /* It oscillated, or would have. */
    machine_event_t drift; /* Time to follow the crystal's drift. */
    bool lsi_forced;       /* The independent watchdog keeps its oscillator on. */
    model_t *gated[RCC_GATES];
};

/* rcc_clocks.c */
/* Input of the PLL in Hz; nominal: with perfect oscillators. */
double rcc_pll_input(const rcc_t *rcc, bool nominal);
/* Work out the domains, the core's clock and the limits anew, as the system clock, the PLL or a divider has changed. */
void rcc_update_clocks(rcc_t *rcc);
/* Tell the model that listens to changes of clocks. */
void rcc_tell_clocks(chip_t *chip);
/* The crystal's frequency moved by parts in a million: the same, but every clock keeps its phase. */
void rcc_trim_clocks(rcc_t *rcc);
/* Whether the crystal's frequency changes with time. */
bool rcc_drifts(const emulator_config_t *config);

/* rcc_gates.c */
void rcc_write_enable(rcc_t *rcc, uint32_t offset, uint32_t value);
void rcc_write_reset(rcc_t *rcc, uint32_t offset, uint32_t value);
void rcc_close_gates(rcc_t *rcc); /* A reset: every gated clock is off. */

#endif

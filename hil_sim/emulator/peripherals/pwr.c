/* pwr.c: power control (RM0090 5.4, F405/407): regulator scale, backup-domain lock, voltage detector, and the resets
 * that a low supply causes. Stop and standby are not there.
 *
 * Thresholds are the typical ones of the data sheet DS8626 (revision 9, table 19), of which a chip may differ by 0.1 V:
 * BOR level 3 2.83 V falling, 2.92 V rising; level 2 2.50, 2.59; level 1 2.19, 2.29; off: power-down reset at 1.68,
 * power-on at 1.72. Below those the memories are lost.
 * The level in force is the one that the option bytes had at the last reset. */
#include "emulator/peripherals/model.h"
#include "emulator/peripherals/outside.h"

enum { CR = 0x00, CSR = 0x04 };
#define PVDE       0x10u
#define PVDO       4u
#define NOMINAL_V  3.3
#define POWER_DOWN 1.68
#define POWER_ON   1.72
#define BOR_OFF    3u
#define BORRSTF    (1u << 25)
#define PORRSTF    (1u << 27)

enum { DETECTOR_LINE = 16 }; /* EXTI has the detector there. */

static const register_layout_t registers[] = {
    {"CR", CR, 0x00004000, 0x000043FF, ACCESS_RW},
    {"CSR", CSR, 0x00000000, 0x0000430F, ACCESS_RW},
};

typedef struct {
    model_t model;
    bool held, power_lost; /* In reset by the supply; it fell so low that memories forget. */
    bool low;              /* PVDO */
} pwr_t;

/* Below the first it resets, from the second on it starts. */
static void reset_thresholds(const chip_t *chip, double *falling, double *rising) {
    static const double levels[3][2] = {{2.83, 2.92}, {2.50, 2.59}, {2.19, 2.29}}; /* BOR_LEV 0 is level 3. */
    const unsigned level = flash_brown_out_level(chip);
    *falling = level == BOR_OFF ? POWER_DOWN : levels[level][0];
    *rising = level == BOR_OFF ? POWER_ON : levels[level][1];
}

static void watch_reset(pwr_t *pwr) {
    chip_t *const chip = pwr->model.chip;
    double falling, rising;
    reset_thresholds(chip, &falling, &rising);
    pwr->power_lost = pwr->power_lost || pwr->model.chip->supply_V < POWER_DOWN;
    if (!pwr->held && pwr->model.chip->supply_V < falling) {
        pwr->held = true;
        flash_supply_lost(chip);
        machine_hold_in_reset(chip->machine);
    } else if (pwr->held && pwr->model.chip->supply_V >= rising) {
        pwr->held = false;
        if (pwr->power_lost) {
            machine_forget_memories(chip->machine);
        }
        machine_release_reset(chip->machine, BORRSTF | (pwr->power_lost ? PORRSTF : 0));
        pwr->power_lost = false;
    }
}

/* The programmable voltage detector: typical thresholds, falling and rising, by PLS. */
static void watch_voltage(pwr_t *pwr) {
    static const double levels[8][2] = {{2.04, 2.14}, {2.19, 2.30}, {2.35, 2.45}, {2.51, 2.60},
                                        {2.66, 2.76}, {2.84, 2.93}, {2.93, 3.03}, {3.03, 3.14}};
    const uint32_t cr = reg(&pwr->model, CR);
    const double *const level = levels[field(cr, 5, 3)];
    const bool low = (cr & PVDE) != 0 && pwr->model.chip->supply_V < level[pwr->low ? 1 : 0];
    if (low != pwr->low) {
        pwr->low = low;
        exti_line(pwr->model.chip, DETECTOR_LINE, low, machine_now(pwr->model.machine));
    }
}

static void supply(chip_t *chip, double volts) {
    pwr_t *const pwr = (pwr_t *)chip->pwr;
    chip->supply_V = volts;
    watch_reset(pwr);
    watch_voltage(pwr);
    flash_supply_changed(pwr->model.chip);
    if (!pwr->held) {
        rcc_check_limits(pwr->model.chip);
    }
}

void pwr_supply_in(machine_t *machine, double volts) {
    supply(chip_of(machine), volts);
}

static uint32_t get(model_t *model, uint32_t offset) {
    /* VOSRDY: the regulator settles before the PLL locks. */
    return offset == CSR ? reg(model, CSR) | 1u << 14 | (((const pwr_t *)model)->low ? PVDO : 0) : reg(model, offset);
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    if (offset == CSR) {
        if (value & 0x300u) {
            model_missing(model, "wake-up pin and backup regulator (PWR_CSR)");
        }
        return;
    }
    if (value & 3u) {
        model_missing(model, "low-power modes (PWR_CR)");
    }
    model->value[CR / 4] = value & ~0xCu;
    watch_voltage((pwr_t *)model);
    rcc_check_limits(model->chip);
}

static void restart(model_t *model) {
    ((pwr_t *)model)->low = false;
}

void pwr_create(chip_t *chip) {
    static const model_description_t description = {.name = "PWR",
                                                    .base = 0x40007000,
                                                    .size = 0x400,
                                                    .bus = BUS_APB1,
                                                    .read_widths = WIDTH_16 | WIDTH_32,
                                                    .write_widths = WIDTH_16 | WIDTH_32,
                                                    .registers = registers,
                                                    .register_count = 2,
                                                    .get = get,
                                                    .set = set,
                                                    .restart = restart};
    pwr_t *const pwr = chip_allocate(chip, sizeof *pwr);
    chip->supply_V = NOMINAL_V;
    chip->pwr = &pwr->model;
    chip->signals.supply = supply;
    model_attach(chip, &pwr->model, &description);
}

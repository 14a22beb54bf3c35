/* pwr.c: power control (RM0090 5.4, F405/407): regulator scale and the backup-domain lock. Stop and standby are not
 * there. */
#include "emulator/peripherals/model.h"

enum { CR = 0x00, CSR = 0x04 };

static const register_layout_t registers[] = {
    {"CR", CR, 0x00004000, 0x000043FF, ACCESS_RW},
    {"CSR", CSR, 0x00000000, 0x0000430F, ACCESS_RW},
};

static uint32_t get(model_t *model, uint32_t offset) {
    /* VOSRDY: the regulator settles before the PLL locks. */
    return offset == CSR ? reg(model, CSR) | 1u << 14 : reg(model, offset);
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    if (offset == CSR) {
        if (value & 0x300u) {
            model_missing(model, "wake-up pin and backup regulator (PWR_CSR)");
        }
        return;
    }
    if (value & 0x1Fu & ~0xCu) {
        model_missing(model, "low-power modes and the voltage detector (PWR_CR)");
    }
    model->value[CR / 4] = value & ~0xCu;
    rcc_check_limits(model->chip);
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
                                                    .set = set};
    chip->pwr = chip_allocate(chip, sizeof *chip->pwr);
    model_attach(chip, chip->pwr, &description);
}

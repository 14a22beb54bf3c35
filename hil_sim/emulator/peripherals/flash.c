/* flash.c: flash interface (RM0090 3.9, F405/407): wait states, caches and the locks. Programming and erasing are
 * not there. */
#include "emulator/peripherals/model.h"

enum { ACR = 0x00, KEYR = 0x04, OPTKEYR = 0x08, SR = 0x0C, CR = 0x10, OPTCR = 0x14 };

static const register_layout_t registers[] = {
    {"ACR", ACR, 0, 0x00001F07, ACCESS_RW},         {"KEYR", KEYR, 0, 0xFFFFFFFF, ACCESS_WO},
    {"OPTKEYR", OPTKEYR, 0, 0xFFFFFFFF, ACCESS_WO}, {"SR", SR, 0, 0x000100F3, ACCESS_RW},
    {"CR", CR, 0x80000000, 0x8301037F, ACCESS_RW},  {"OPTCR", OPTCR, 0x0FFFAAED, 0x0FFFFFEF, ACCESS_RW},
};

typedef struct {
    model_t model;
    unsigned keys;  /* Correct keys of the unlock sequence so far. */
    bool key_error; /* Locked until reset. */
} flash_t;

static void write_key(flash_t *flash, uint32_t value) {
    static const uint32_t keys[2] = {0x45670123u, 0xCDEF89ABu};
    if (flash->key_error || flash->keys > 1 || value != keys[flash->keys]) {
        machine_violation(flash->model.machine,
                          "FLASH_KEYR: 0x%08X is not the next key of the sequence: FLASH_CR is locked until reset",
                          (unsigned)value);
        flash->key_error = true;
        flash->model.value[CR / 4] |= 1u << 31;
        return;
    }
    if (++flash->keys == 2) {
        flash->model.value[CR / 4] &= ~(1u << 31);
    }
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    flash_t *const flash = (flash_t *)model;
    switch (offset) {
    case ACR:
        if ((value & 0x1800u) != 0 && (reg(model, ACR) & value & 0x600u) != 0) {
            machine_violation(model->machine, "FLASH_ACR: a cache may be reset only while it is disabled");
        }
        model->value[ACR / 4] = value;
        machine_set_flash_access(model->machine, value);
        rcc_check_limits(model->chip);
        return;
    case KEYR:
        write_key(flash, value);
        return;
    case CR:
        if (reg(model, CR) >> 31) {
            machine_violation(model->machine, "FLASH_CR: written 0x%08X while locked", (unsigned)value);
            return;
        }
        if (value & 0x0001FFFFu) {
            model_missing(model, "programming and erasing");
        }
        if (value >> 31) {
            flash->keys = 0;
        }
        model->value[CR / 4] = value & 0x83000300u;
        return;
    case SR:
        model->value[SR / 4] &= ~value;
        return;
    default:
        model_missing(model, "option bytes");
        return;
    }
}

static void restart(model_t *model) {
    machine_set_flash_access(model->machine, 0);
    ((flash_t *)model)->keys = 0;
    ((flash_t *)model)->key_error = false;
}

void flash_create(chip_t *chip) {
    static const model_description_t description = {.name = "FLASH",
                                                    .base = 0x40023C00,
                                                    .size = 0x400,
                                                    .bus = BUS_CORE,
                                                    .read_widths = WIDTH_ANY,
                                                    .write_widths = WIDTH_ANY,
                                                    .registers = registers,
                                                    .register_count = sizeof registers / sizeof registers[0],
                                                    .set = set,
                                                    .restart = restart};
    flash_t *const flash = chip_allocate(chip, sizeof *flash);
    chip->flash = &flash->model;
    model_attach(chip, &flash->model, &description);
}

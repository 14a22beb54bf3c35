/* flash.c: flash interface (RM0090 3.9, F405/407): wait states, caches, the locks and the option bytes. Programming and
 * erasing are not there.
 *
 * Option bytes are what OPTCR says when OPTSTRT is set; they are programmed after 20 ms, and in force from the next
 * reset on. Their image at 0x1FFFC000 is not there. */
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
    unsigned option_keys;
    uint32_t options; /* The option bytes as OPTCR shows them, lock and start bit 0. */
    machine_event_t programmed;
} flash_t;

#define OPTLOCK      1u
#define OPTSTRT      2u
#define OPTION_BITS  0x0FFFFFECu
#define FACTORY      0x0FFFAAECu
#define BUSY         (1u << 16)
#define PREFETCH     0x100u
#define REVISION_A   0x1000u
#define PROGRAM_PS   20000000000
#define PROTECTION_2 0xCCu

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

/* ---- Option bytes ---- */

static void write_option_key(flash_t *flash, uint32_t value) {
    static const uint32_t keys[2] = {0x08192A3Bu, 0x4C5D6E7Fu};
    if (flash->option_keys > 1 || value != keys[flash->option_keys]) {
        machine_violation(
            flash->model.machine,
            "FLASH_OPTKEYR: 0x%08X is not the next key of the sequence: FLASH_OPTCR is locked until reset",
            (unsigned)value);
        flash->option_keys = 3;
        flash->model.value[OPTCR / 4] |= OPTLOCK;
    } else if (++flash->option_keys == 2) {
        flash->model.value[OPTCR / 4] &= ~OPTLOCK;
    }
}

static void options_programmed(void *context, int64_t time_ps) {
    flash_t *const flash = context;
    (void)time_ps;
    flash->options = reg(&flash->model, OPTCR) & OPTION_BITS;
    flash->model.value[OPTCR / 4] &= ~OPTSTRT;
    flash->model.value[SR / 4] &= ~BUSY;
}

static void write_options(flash_t *flash, uint32_t value) {
    machine_t *const machine = flash->model.machine;
    if ((reg(&flash->model, OPTCR) & OPTLOCK) != 0 || (reg(&flash->model, SR) & BUSY) != 0) {
        machine_violation(machine, "FLASH_OPTCR: written 0x%08X while %s", (unsigned)value,
                          (reg(&flash->model, OPTCR) & OPTLOCK) != 0 ? "locked" : "the flash is busy");
        return;
    }
    if ((value >> 8 & 0xFFu) == PROTECTION_2) {
        machine_violation(machine, "FLASH_OPTCR: read protection level 2, which no chip comes back from");
        return;
    }
    flash->model.value[OPTCR / 4] = value;
    if ((value & OPTLOCK) != 0) {
        flash->option_keys = 0;
    }
    if ((value & OPTSTRT) != 0) {
        flash->model.value[SR / 4] |= BUSY;
        machine_schedule(machine, &flash->programmed, machine_now(machine) + PROGRAM_PS);
    }
}

unsigned flash_brown_out_level(const chip_t *chip) {
    return field(((const flash_t *)chip->flash)->options, 2, 2);
}

bool flash_hardware_watchdog(const chip_t *chip) {
    return field(((const flash_t *)chip->flash)->options, 5, 1) == 0;
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    flash_t *const flash = (flash_t *)model;
    switch (offset) {
    case ACR:
        if ((value & 0x1800u) != 0 && (reg(model, ACR) & value & 0x600u) != 0) {
            machine_violation(model->machine, "FLASH_ACR: a cache may be reset only while it is disabled");
        }
        if ((value & PREFETCH) != 0 && model->chip->config->revision == REVISION_A) {
            machine_violation(model->machine, "FLASH_ACR: prefetch on silicon revision A, which does not support it "
                                              "(ES0182 2.1.1)");
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
    case OPTKEYR:
        write_option_key(flash, value);
        return;
    default:
        write_options(flash, value);
        return;
    }
}

static void restart(model_t *model) {
    machine_set_flash_access(model->machine, 0);
    flash_t *const flash = (flash_t *)model;
    flash->keys = flash->option_keys = 0;
    flash->key_error = false;
    machine_cancel(model->machine, &flash->programmed);
    model->value[OPTCR / 4] = flash->options | OPTLOCK;
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
    flash->options = chip->config->option_bytes != 0 ? chip->config->option_bytes & OPTION_BITS : FACTORY;
    machine_event_init(&flash->programmed, options_programmed, flash);
    model_attach(chip, &flash->model, &description);
}

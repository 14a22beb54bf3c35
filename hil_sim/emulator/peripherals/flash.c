/* flash.c: the registers of the flash interface: wait states, caches, locks and option bytes.
 *
 * Option bytes are what OPTCR says when OPTSTRT is set; they are programmed after 20 ms, and in force from the next
 * reset on. Their image at 0x1FFFC000 is not there.
 *
 * What was erased while a cache was on may still be in the cache: a load, or a fetch, from there is a violation until
 * that cache is reset. Only words that were programmed since may be loaded, as the data cache follows those. */
#include "emulator/peripherals/flash.h"

static const register_layout_t registers[] = {
    {"ACR", FLASH_ACR, 0, 0x00001F07, ACCESS_RW},         {"KEYR", FLASH_KEYR, 0, 0xFFFFFFFF, ACCESS_WO},
    {"OPTKEYR", FLASH_OPTKEYR, 0, 0xFFFFFFFF, ACCESS_WO}, {"SR", FLASH_SR, 0, 0x000100F3, ACCESS_RW},
    {"CR", FLASH_CR, 0x80000000, 0x8301037F, ACCESS_RW},  {"OPTCR", FLASH_OPTCR, 0x0FFFAAED, 0x0FFFFFEF, ACCESS_RW},
};

#define FACTORY      0x0FFFAAECu
#define PREFETCH     0x100u
#define CODE_CACHE   0x200u
#define DATA_CACHE   0x400u
#define CODE_RESET   0x800u
#define DATA_RESET   0x1000u
#define REVISION_A   0x1000u
#define OPTIONS_PS   20000000000
#define PROTECTION_2 0xCCu
#define SR_CLEARED   0xF3u
#define START_ALONE  (FLASH_PG | FLASH_SER | FLASH_MER | 0x378u) /* With SNB and PSIZE. */

enum { INTERRUPT = 4, SMALL_PIECE = 0x4000 };

/* ---- Locks ---- */

static void write_key(flash_t *flash, uint32_t value) {
    static const uint32_t keys[2] = {0x45670123u, 0xCDEF89ABu};
    if (flash->key_error || flash->keys > 1 || value != keys[flash->keys]) {
        machine_bus_error(flash->model.machine,
                          "FLASH_KEYR: 0x%08X is not the next key of the sequence: FLASH_CR is locked until reset",
                          (unsigned)value);
        flash->key_error = true;
        flash->model.value[FLASH_CR / 4] |= FLASH_LOCK;
        return;
    }
    if (++flash->keys == 2) {
        flash->model.value[FLASH_CR / 4] &= ~FLASH_LOCK;
    }
}

static void write_option_key(flash_t *flash, uint32_t value) {
    static const uint32_t keys[2] = {0x08192A3Bu, 0x4C5D6E7Fu};
    if (flash->option_keys > 1 || value != keys[flash->option_keys]) {
        machine_bus_error(
            flash->model.machine,
            "FLASH_OPTKEYR: 0x%08X is not the next key of the sequence: FLASH_OPTCR is locked until reset",
            (unsigned)value);
        flash->option_keys = 3;
        flash->model.value[FLASH_OPTCR / 4] |= FLASH_OPTLOCK;
    } else if (++flash->option_keys == 2) {
        flash->model.value[FLASH_OPTCR / 4] &= ~FLASH_OPTLOCK;
    }
}

/* ---- Option bytes ---- */

static void write_options(flash_t *flash, uint32_t value) {
    machine_t *const machine = flash->model.machine;
    if ((reg(&flash->model, FLASH_OPTCR) & FLASH_OPTLOCK) != 0 || flash->work != FLASH_IDLE) {
        machine_violation(machine, "FLASH_OPTCR: written 0x%08X while %s", (unsigned)value,
                          (reg(&flash->model, FLASH_OPTCR) & FLASH_OPTLOCK) != 0 ? "locked" : "the flash is busy");
        return;
    }
    if ((value >> 8 & 0xFFu) == PROTECTION_2) {
        machine_violation(machine, "FLASH_OPTCR: read protection level 2, which no chip comes back from");
        return;
    }
    flash->model.value[FLASH_OPTCR / 4] = value;
    if ((value & FLASH_OPTLOCK) != 0) {
        flash->option_keys = 0;
    }
    if ((value & FLASH_OPTSTRT) != 0) {
        flash_busy_for(flash, FLASH_PROGRAMS_OPTIONS, OPTIONS_PS);
    }
}

unsigned flash_brown_out_level(const chip_t *chip) {
    return field(((const flash_t *)chip->flash)->options, 2, 2);
}

bool flash_hardware_watchdog(const chip_t *chip) {
    return field(((const flash_t *)chip->flash)->options, 5, 1) == 0;
}

bool flash_sectors_protected(const flash_t *flash, uint32_t sectors) {
    return (~field(flash->options, 16, FLASH_SECTORS) & sectors) != 0;
}

/* ---- Caches ---- */

static uint64_t pieces(uint32_t sectors) {
    uint64_t result = 0;
    for (unsigned sector = 0; sector < FLASH_SECTORS; sector++) {
        const unsigned first = flash_sector_begin(sector) / SMALL_PIECE;
        const unsigned count = flash_sector_begin(sector + 1u) / SMALL_PIECE - first;
        result |= (sectors >> sector & 1u) != 0 ? ((UINT64_C(1) << count) - 1u) << first : 0;
    }
    return result;
}

void flash_watch(flash_t *flash) {
    machine_flash_watch(flash->model.machine, pieces(flash->stale_data), pieces(flash->stale_code));
}

void flash_stale_access(void *context, uint32_t offset, unsigned width, bool fetch) {
    flash_t *const flash = context;
    const uint32_t sector = 1u << flash_sector_of(offset);
    const bool rewritten = (flash->rewritten[offset / 32] >> offset / 4 % 8 & 1u) != 0;
    if (!fetch && !rewritten && (flash->stale_data & sector) != 0) {
        machine_violation(
            flash->model.machine,
            "flash: %u-byte load at 0x%05X, which was erased while the data cache was on: it may get what "
            "was there before, until DCRST has reset the cache",
            width, (unsigned)offset);
    } else if (fetch && (flash->stale_code & sector) != 0) {
        machine_violation(
            flash->model.machine,
            "flash: fetch at 0x%05X, which was erased while the instruction cache was on: it may get what "
            "was there before, until ICRST has reset the cache",
            (unsigned)offset);
        flash->stale_code &= ~sector; /* Once is enough: the program goes on there. */
        flash_watch(flash);
    }
}

static void write_access(model_t *model, uint32_t value) {
    flash_t *const flash = (flash_t *)model;
    const uint32_t enabled = reg(model, FLASH_ACR) & value;
    if (((value & CODE_RESET) != 0 && (enabled & CODE_CACHE) != 0) ||
        ((value & DATA_RESET) != 0 && (enabled & DATA_CACHE) != 0)) {
        machine_violation(model->machine, "FLASH_ACR: a cache may be reset only while it is disabled");
    }
    if ((value & PREFETCH) != 0 && model->chip->config->revision == REVISION_A) {
        machine_violation(model->machine, "FLASH_ACR: prefetch on silicon revision A, which does not support it "
                                          "(ES0182 2.1.1)");
    }
    if ((value & (CODE_RESET | CODE_CACHE)) == CODE_RESET) {
        flash->code_cached = false;
        flash->stale_code = 0;
    }
    if ((value & (DATA_RESET | DATA_CACHE)) == DATA_RESET) {
        flash->data_cached = false;
        flash->stale_data = 0;
    }
    flash->code_cached = flash->code_cached || (value & CODE_CACHE) != 0;
    flash->data_cached = flash->data_cached || (value & DATA_CACHE) != 0;
    flash_watch(flash);
    model->value[FLASH_ACR / 4] = value;
    machine_set_flash_access(model->machine, value);
    rcc_check_limits(model->chip);
}

/* ---- Control and status ---- */

void flash_interrupt_line(flash_t *flash) {
    const uint32_t sr = reg(&flash->model, FLASH_SR), cr = reg(&flash->model, FLASH_CR);
    machine_irq(flash->model.machine, INTERRUPT,
                ((sr & FLASH_EOP) != 0 && (cr & FLASH_EOPIE) != 0) ||
                    ((sr & FLASH_OPERR) != 0 && (cr & FLASH_ERRIE) != 0));
}

void flash_error(flash_t *flash, uint32_t flags) {
    const bool told = (reg(&flash->model, FLASH_CR) & FLASH_ERRIE) != 0;
    flash->model.value[FLASH_SR / 4] |= flags | (told ? FLASH_OPERR : 0);
    flash_interrupt_line(flash);
}

static void write_control(flash_t *flash, uint32_t value) {
    machine_t *const machine = flash->model.machine;
    const uint32_t before = reg(&flash->model, FLASH_CR);
    if ((before & FLASH_LOCK) != 0 || flash->work != FLASH_IDLE) {
        machine_violation(machine, "FLASH_CR: written 0x%08X while %s", (unsigned)value,
                          (before & FLASH_LOCK) != 0 ? "locked" : "the flash is busy");
        return;
    }
    if ((value & FLASH_LOCK) != 0) {
        flash->keys = 0;
    }
    flash->model.value[FLASH_CR / 4] = value;
    flash_interrupt_line(flash);
    if ((value & FLASH_STRT) == 0) {
        return;
    }
    if (((value ^ before) & (START_ALONE | FLASH_LOCK)) != 0) {
        flash->model.value[FLASH_CR / 4] &= ~FLASH_STRT;
        machine_violation(machine,
                          "FLASH_CR: STRT is set together with a change of what it starts (0x%08X after 0x%08X)",
                          (unsigned)value, (unsigned)before);
        return;
    }
    flash_start(flash);
}

static void set(model_t *model, uint32_t offset, uint32_t value) {
    flash_t *const flash = (flash_t *)model;
    switch (offset) {
    case FLASH_ACR:
        write_access(model, value);
        return;
    case FLASH_KEYR:
        write_key(flash, value);
        return;
    case FLASH_CR:
        write_control(flash, value);
        return;
    case FLASH_SR:
        model->value[FLASH_SR / 4] &= ~(value & SR_CLEARED);
        flash_interrupt_line(flash);
        return;
    case FLASH_OPTKEYR:
        write_option_key(flash, value);
        return;
    default:
        write_options(flash, value);
        return;
    }
}

/* ---- Life ---- */

/* The registers have their reset values already. */
static void restart(model_t *model) {
    flash_t *const flash = (flash_t *)model;
    machine_set_flash_access(model->machine, 0);
    flash_break_off(flash);
    flash_cells_boot(&flash->cells, model->chip->config->memory_seed);
    flash->keys = flash->option_keys = 0;
    flash->key_error = false;
    flash->code_cached = flash->data_cached = false;
    flash->stale_code = flash->stale_data = 0;
    flash_watch(flash);
    model->value[FLASH_OPTCR / 4] = flash->options | FLASH_OPTLOCK;
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
    flash->options = chip->config->option_bytes != 0 ? chip->config->option_bytes & FLASH_OPTION_BITS : FACTORY;
    flash_operation_create(flash, chip);
    model_attach(chip, &flash->model, &description);
}

#include "emulator/peripherals/flash.h"
#include "emulator/peripherals/outside.h"

#include <string.h>

#define MILLISECOND        1000000000
#define PROGRAM_TYPICAL_PS 16000000
#define PROGRAM_LARGEST_PS 100000000
#define LOWEST_HZ          1e6 /* HCLK while something is programmed or erased. */
#define HIGHEST_V          3.6
#define NOMINAL_V          3.3

enum { ROW = 16, KINDS = 4, WIDEST = 3 };

/* Milliseconds by kind of sector and PSIZE, typical and largest (DS8626, revision 9, table 40). */
enum { SMALL, MIDDLE, LARGE, ALL };
static const int16_t erase_ms[KINDS][WIDEST][2] = {
    {{400, 800}, {300, 600}, {250, 500}},
    {{1200, 2400}, {700, 1400}, {550, 1100}},
    {{2000, 4000}, {1300, 2600}, {1000, 2000}},
    {{16000, 32000}, {11000, 22000}, {8000, 16000}},
};
#define ALL_SECTORS 0xFFFu

static unsigned program_size(const flash_t *flash) {
    return field(reg(&flash->model, FLASH_CR), 8, 2);
}

/* A random state of a step: what is drawn from it follows the seed, the chip, the step, and a cut's id. */
static uint64_t step_random(const flash_t *flash, uint64_t id) {
    const emulator_config_t *const config = flash->model.chip->config;
    uint64_t state = config->memory_seed ^ id << 32 ^ flash->steps;
    for (unsigned i = 0; i < sizeof config->unique_id; i++) {
        state = machine_random(&state) ^ config->unique_id[i];
    }
    return machine_random(&state);
}

static int64_t spread(const flash_t *flash, int64_t typical, int64_t largest) {
    if (flash->model.chip->config->memory_seed == 0) {
        return typical;
    }
    uint64_t state = step_random(flash, 0);
    const double u = (double)(machine_random(&state) >> 11) * 0x1p-53;
    return typical + (int64_t)((double)(largest - typical) * (u * u * u * u));
}

/* ---- What may start ---- */

static double lowest_supply(unsigned size) {
    return size == 0 ? 1.8 : size == 1 ? 2.1 : 2.7; /* RM0090 table 7. */
}

static bool supply_fits(const flash_t *flash) {
    const double volts = flash->model.chip->supply_V;
    return volts >= lowest_supply(program_size(flash)) && volts <= HIGHEST_V;
}

/* What holds for every operation; what names it. */
static bool conditions_hold(flash_t *flash, const char *what) {
    machine_t *const machine = flash->model.machine;
    const unsigned size = program_size(flash);
    if (size >= WIDEST) {
        machine_violation(machine, "FLASH_CR: %s with PSIZE 3, x64, which needs an external Vpp", what);
        return false;
    }
    if (!supply_fits(flash)) {
        machine_violation(machine,
                          "FLASH_CR: %s with PSIZE %u, x%u, at %.2f V, for which %.1f to 3.6 V are needed: what it "
                          "leaves may not last",
                          what, size, 8u << size, flash->model.chip->supply_V, lowest_supply(size));
        return false;
    }
    if (flash->model.chip->hclk.nominal_hz < LOWEST_HZ) {
        machine_violation(machine, "FLASH_CR: %s while HCLK is %.0f Hz, below 1 MHz", what,
                          flash->model.chip->hclk.nominal_hz);
        return false;
    }
    return true;
}

static bool refuse_protected(flash_t *flash, uint32_t sectors, const char *what) {
    if (!flash_sectors_protected(flash, sectors)) {
        return false;
    }
    flash_error(flash, FLASH_WRPERR);
    machine_violation(flash->model.machine, "FLASH_CR: %s of a sector that the option bytes protect (nWRP 0x%03X)",
                      what, (unsigned)field(flash->options, 16, FLASH_SECTORS));
    return true;
}

/* ---- How it goes ---- */

void flash_busy_for(flash_t *flash, flash_work_t work, int64_t duration_ps) {
    machine_t *const machine = flash->model.machine;
    flash->work = work;
    flash->begin_ps = machine_now(machine);
    flash->end_ps = flash->begin_ps + duration_ps;
    flash->model.value[FLASH_SR / 4] |= FLASH_BSY;
    machine_flash_busy(machine, true);
    machine_schedule(machine, &flash->end, flash->end_ps);
}

static void begin_step(flash_t *flash, flash_work_t work, int64_t typical, int64_t largest) {
    flash->steps++;
    flash_busy_for(flash, work, spread(flash, typical, largest));
    if (flash->steps == flash->cut.step) {
        const double until = flash->cut.fraction * (double)(flash->end_ps - flash->begin_ps);
        machine_schedule(flash->model.machine, &flash->cut_event, flash->begin_ps + (int64_t)until);
    }
}

static void not_busy(flash_t *flash) {
    flash->work = FLASH_IDLE;
    flash->model.value[FLASH_SR / 4] &= ~FLASH_BSY;
    flash->model.value[FLASH_CR / 4] &= ~FLASH_STRT;
    machine_cancel(flash->model.machine, &flash->end);
    machine_flash_busy(flash->model.machine, false);
}

/* The cells get what the operation does in its time, or in a share of it. */
static void change_cells(flash_t *flash, double done, uint64_t id) {
    const uint64_t random = step_random(flash, id);
    if (flash->work == FLASH_PROGRAMS) {
        flash_cells_program(&flash->cells, flash->offset, flash->value, flash->width, done, random);
        flash->rewritten[flash->offset / 32] |= (uint8_t)(1u << flash->offset / 4 % 8);
        return;
    }
    for (unsigned sector = 0; sector < FLASH_SECTORS; sector++) {
        if ((flash->sectors >> sector & 1u) != 0) {
            flash_cells_erase(&flash->cells, sector, done, random + sector);
            const uint32_t begin = flash_sector_begin(sector), end = flash_sector_begin(sector + 1);
            memset(flash->rewritten + begin / 32, 0, (end - begin) / 32);
        }
    }
    flash->stale_code |= flash->code_cached ? flash->sectors : 0;
    flash->stale_data |= flash->data_cached ? flash->sectors : 0;
    flash_watch(flash);
}

static void ended(void *context, int64_t time_ps) {
    flash_t *const flash = context;
    (void)time_ps;
    if (flash->work == FLASH_PROGRAMS_OPTIONS) {
        flash->options = reg(&flash->model, FLASH_OPTCR) & FLASH_OPTION_BITS;
        flash->model.value[FLASH_OPTCR / 4] &= ~FLASH_OPTSTRT;
        not_busy(flash);
        return;
    }
    change_cells(flash, 1.0, 0);
    not_busy(flash);
    if ((reg(&flash->model, FLASH_CR) & FLASH_EOPIE) != 0) {
        flash->model.value[FLASH_SR / 4] |= FLASH_EOP;
        flash_interrupt_line(flash);
    }
}

void flash_break_off(flash_t *flash) {
    machine_t *const machine = flash->model.machine;
    if (flash->work == FLASH_PROGRAMS_OPTIONS) {
        machine_violation(machine,
                          "FLASH_OPTCR: a reset while option bytes are programmed: nobody knows what they hold");
    } else if (flash->work != FLASH_IDLE) {
        const double done = (double)(machine_now(machine) - flash->begin_ps) /
                            (double)(flash->end_ps - flash->begin_ps);
        change_cells(flash, done < 1.0 ? done : 1.0, flash->steps == flash->cut.step ? flash->cut.id : 0);
    }
    not_busy(flash);
}

/* ---- The core's stores and STRT ---- */

static void store(void *context, uint32_t offset, uint32_t value, unsigned width) {
    flash_t *const flash = context;
    machine_t *const machine = flash->model.machine;
    const uint32_t cr = reg(&flash->model, FLASH_CR);
    const unsigned size = program_size(flash);
    if (flash->work != FLASH_IDLE) {
        machine_violation(machine, "flash: %u-byte store at 0x%05X while it is busy", width, (unsigned)offset);
    } else if ((cr & (FLASH_LOCK | FLASH_PG | FLASH_SER | FLASH_MER)) != FLASH_PG) {
        flash_error(flash, FLASH_PGSERR);
        machine_violation(machine, "flash: %u-byte store at 0x%05X %s", width, (unsigned)offset,
                          (cr & FLASH_LOCK) != 0 ? "while FLASH_CR is locked"
                          : (cr & FLASH_PG) != 0 ? "while FLASH_CR asks for an erase, too"
                                                 : "while FLASH_CR does not set PG");
    } else if (offset % ROW + width > ROW) {
        flash_error(flash, FLASH_PGAERR);
        machine_violation(machine, "flash: %u-byte store at 0x%05X crosses the end of a row of 128 bits", width,
                          (unsigned)offset);
    } else if (width != 1u << size || offset % width != 0) {
        flash_error(flash, FLASH_PGPERR);
        machine_violation(machine, "flash: %u-byte store at 0x%05X, %s", width, (unsigned)offset,
                          offset % width != 0 ? "which is not aligned" : "which is not what PSIZE says");
    } else if (!refuse_protected(flash, 1u << flash_sector_of(offset), "programming") &&
               conditions_hold(flash, "programming")) {
        flash->offset = offset;
        flash->value = value;
        flash->width = width;
        begin_step(flash, FLASH_PROGRAMS, PROGRAM_TYPICAL_PS, PROGRAM_LARGEST_PS);
    }
}

void flash_start(flash_t *flash) {
    machine_t *const machine = flash->model.machine;
    const uint32_t cr = reg(&flash->model, FLASH_CR), asked = cr & (FLASH_PG | FLASH_SER | FLASH_MER);
    const unsigned sector = field(cr, 3, 4);
    flash->model.value[FLASH_CR / 4] &= ~FLASH_STRT;
    if (asked != FLASH_SER && asked != FLASH_MER) {
        machine_violation(machine, "FLASH_CR: STRT while PG, SER and MER are 0x%X: one of SER and MER starts an erase",
                          (unsigned)asked);
        return;
    }
    if (asked == FLASH_SER && sector >= FLASH_SECTORS) {
        machine_violation(machine, "FLASH_CR: STRT for sector %u of 0 to 11", sector);
        return;
    }
    const uint32_t sectors = asked == FLASH_MER ? ALL_SECTORS : 1u << sector;
    if (refuse_protected(flash, sectors, "an erase") || !conditions_hold(flash, "an erase")) {
        return;
    }
    const unsigned kind = asked == FLASH_MER ? (unsigned)ALL
                          : sector < 4       ? (unsigned)SMALL
                          : sector == 4      ? (unsigned)MIDDLE
                                             : (unsigned)LARGE;
    const int16_t *const ms = erase_ms[kind][program_size(flash)];
    flash->sectors = sectors;
    flash->model.value[FLASH_CR / 4] |= FLASH_STRT;
    begin_step(flash, FLASH_ERASES, ms[0] * (int64_t)MILLISECOND, ms[1] * (int64_t)MILLISECOND);
}

/* ---- The supply ---- */

static void cut_now(void *context, int64_t time_ps) {
    flash_t *const flash = context;
    if (flash->cut.off_ps > 0) {
        machine_schedule(flash->model.machine, &flash->restored_event, time_ps + flash->cut.off_ps);
    }
    flash->model.chip->signals.supply(flash->model.chip, 0.0);
}

static void restored(void *context, int64_t time_ps) {
    chip_t *const chip = ((flash_t *)context)->model.chip;
    (void)time_ps;
    chip->signals.supply(chip, NOMINAL_V);
}

void flash_supply_changed(chip_t *chip) {
    flash_t *const flash = (flash_t *)chip->flash;
    if (flash->work != FLASH_IDLE && flash->work != FLASH_PROGRAMS_OPTIONS && !supply_fits(flash)) {
        machine_violation(chip->machine,
                          "flash: the supply is %.2f V during an operation with PSIZE %u: what it leaves may not last",
                          chip->supply_V, program_size(flash));
    }
}

void flash_supply_lost(chip_t *chip) {
    flash_break_off((flash_t *)chip->flash);
}

void flash_cut_in(machine_t *machine, uint64_t step, double fraction, uint64_t id, int64_t off_ps) {
    flash_t *const flash = (flash_t *)chip_of(machine)->flash;
    flash->cut = (flash_cut_t){
        .step = step == 0 ? 0 : flash->steps + step, .fraction = fraction, .id = id, .off_ps = off_ps};
}

uint64_t flash_steps_out(const machine_t *machine) {
    return ((const flash_t *)chip_of(machine)->flash)->steps;
}

void flash_cells_out(machine_t *machine, uint8_t *bytes) {
    const flash_t *const flash = (const flash_t *)chip_of(machine)->flash;
    memcpy(bytes, flash->cells.bytes, MACHINE_FLASH_SIZE);
    memcpy(bytes + MACHINE_FLASH_SIZE, flash->cells.weak, MACHINE_FLASH_SIZE);
}

void flash_end_in(machine_t *machine) {
    flash_break_off((flash_t *)chip_of(machine)->flash);
}

void flash_cells_in(machine_t *machine, const uint8_t *bytes) {
    flash_t *const flash = (flash_t *)chip_of(machine)->flash;
    memcpy(flash->cells.bytes, bytes, MACHINE_FLASH_SIZE);
    memcpy(flash->cells.weak, bytes + MACHINE_FLASH_SIZE, MACHINE_FLASH_SIZE);
    flash->cells.any_weak = true; /* flash_cells_boot() looks for them. */
    machine_flash_changed(machine, 0, MACHINE_FLASH_SIZE);
}

/* ---- Life ---- */

void flash_operation_create(flash_t *flash, chip_t *chip) {
    machine_event_init(&flash->end, ended, flash);
    machine_event_init(&flash->cut_event, cut_now, flash);
    machine_event_init(&flash->restored_event, restored, flash);
    flash_cells_create(&flash->cells, chip->machine, chip_allocate(chip, MACHINE_FLASH_SIZE));
    machine_flash_controller(chip->machine,
                             &(flash_controller_t){.store = store, .watched = flash_stale_access, .context = flash});
}

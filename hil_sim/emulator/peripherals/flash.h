/* flash.h: between the parts of the flash's model (RM0090 chapter 3, F405/407; data sheet DS8626, 5.3.12).
 *
 *     flash.c            registers, locks, option bytes, caches
 *     flash_operation.c  programming and erasing: what starts, how long it takes, how it ends or is cut off
 *     flash_cells.c      sectors and cells: what is in them afterwards
 *
 * One bank of 1 MB. An operation changes the cells when it ends, as nobody can read them before: the core waits, and
 * the read of a bus master is a violation. Each begins with its number, a step. A reset or a loss of the supply in a
 * step leaves a mix (flash_cells.h).
 *
 * What an operation takes is the data sheet's typical time, or longer, up to its largest: without
 * emulator_config_t.memory_seed always the typical one; else typical + (largest - typical) u^4, where u is even between
 * 0 and 1 and follows the seed, the unique id and the step.
 *
 * Not there: double words (they need Vpp), the one-time area, read protection, and the bus that waits when something is
 * stored or FLASH_CR is written while the flash is busy: that is a violation, and nothing is stored or written. */
#ifndef GOLDFIELD_FLASH_H
#define GOLDFIELD_FLASH_H

#include "emulator/peripherals/flash_cells.h"
#include "emulator/peripherals/model.h"

enum {
    FLASH_ACR = 0x00,
    FLASH_KEYR = 0x04,
    FLASH_OPTKEYR = 0x08,
    FLASH_SR = 0x0C,
    FLASH_CR = 0x10,
    FLASH_OPTCR = 0x14
};
/* FLASH_SR */
#define FLASH_EOP    1u
#define FLASH_OPERR  2u
#define FLASH_WRPERR 0x10u
#define FLASH_PGAERR 0x20u
#define FLASH_PGPERR 0x40u
#define FLASH_PGSERR 0x80u
#define FLASH_BSY    (1u << 16)
/* FLASH_CR */
#define FLASH_PG    1u
#define FLASH_SER   2u
#define FLASH_MER   4u
#define FLASH_STRT  (1u << 16)
#define FLASH_EOPIE (1u << 24)
#define FLASH_ERRIE (1u << 25)
#define FLASH_LOCK  (1u << 31)
/* FLASH_OPTCR */
#define FLASH_OPTLOCK     1u
#define FLASH_OPTSTRT     2u
#define FLASH_OPTION_BITS 0x0FFFFFECu

typedef enum { FLASH_IDLE, FLASH_PROGRAMS, FLASH_ERASES, FLASH_PROGRAMS_OPTIONS } flash_work_t;

/* The supply is cut in a step. */
typedef struct {
    uint64_t step;   /* 0: in none. */
    double fraction; /* When, in the step's time. */
    uint64_t id;     /* It decides, too, what is left in the cells. */
    int64_t off_ps;  /* How long it is away; 0: for good. */
} flash_cut_t;

typedef struct {
    model_t model;
    unsigned keys;  /* Correct keys of the unlock sequence so far. */
    bool key_error; /* Locked until reset. */
    unsigned option_keys;
    uint32_t options; /* The option bytes as OPTCR shows them, lock and start bit 0. */

    flash_work_t work;
    uint32_t offset, value; /* What is programmed: where, */
    unsigned width;         /* and how many bytes. */
    uint32_t sectors;       /* What is erased, by bits. */
    int64_t begin_ps, end_ps;
    machine_event_t end;
    uint64_t steps; /* Programs and erases begun so far. */

    flash_cut_t cut;
    machine_event_t cut_event, restored_event;
    flash_cells_t cells;

    /* Since they were last reset, the caches have been on; and sectors were erased meanwhile, which they may hold. */
    bool code_cached, data_cached;
    uint32_t stale_code, stale_data;
    /* Words of stale sectors that were programmed since, which the data cache follows; by bits. */
    uint8_t rewritten[MACHINE_FLASH_SIZE / 32];
} flash_t;

/* flash.c */
void flash_error(flash_t *flash, uint32_t flags); /* Set error flags, and OPERR if they may interrupt. */
void flash_interrupt_line(flash_t *flash);
bool flash_sectors_protected(const flash_t *flash, uint32_t sectors);
void flash_watch(flash_t *flash); /* Stale sectors have changed. */
void flash_stale_access(void *context, uint32_t offset, unsigned width, bool fetch);

/* flash_operation.c */
void flash_operation_create(flash_t *flash, chip_t *chip);
void flash_start(flash_t *flash); /* STRT was set. */
void flash_busy_for(flash_t *flash, flash_work_t work, int64_t duration_ps);
/* The chip is reset, or its supply is gone: an operation ends where it is. */
void flash_break_off(flash_t *flash);

#endif

/* flash_cells.h: the cells of the flash: sectors, and what an operation leaves in them.
 *
 * flash_cells_create() once. flash_cells_program() and flash_cells_erase() with how much of the operation was done, 1
 * being all of it; flash_cells_boot() at each reset.
 *
 * What was cut off leaves a mix that the random state decides. Each bit that is programmed falls at its own moment of
 * the operation. An erase first brings bits to 0, each at its own moment of the first tenth, and then to 1, each at its
 * own moment of the rest. A bit whose moment was near is weak: it reads as either at each boot, until it is programmed
 * or erased to the end. */
#ifndef GOLDFIELD_FLASH_CELLS_H
#define GOLDFIELD_FLASH_CELLS_H

#include "emulator/machine.h"

enum { FLASH_SECTORS = 12 };

typedef struct {
    machine_t *machine;
    uint8_t *bytes; /* The content, as it reads. */
    uint8_t *weak;  /* Bits that are weak, as many bytes. */
    bool any_weak;
    uint64_t boots;
} flash_cells_t;

/* A sector's first byte, and that of the next; sector FLASH_SECTORS begins where the flash ends. */
uint32_t flash_sector_begin(unsigned sector);
unsigned flash_sector_of(uint32_t offset);

/* weak: MACHINE_FLASH_SIZE bytes of 0, which stay the caller's. */
void flash_cells_create(flash_cells_t *cells, machine_t *machine, uint8_t *weak);

/* Bits of value that are 0 become 0; the others stay. done is the share of the operation that went by, 0 to 1. */
void flash_cells_program(flash_cells_t *cells, uint32_t offset, uint32_t value, unsigned width, double done,
                         uint64_t random);
void flash_cells_erase(flash_cells_t *cells, unsigned sector, double done, uint64_t random);

/* Weak bits read as they like this time. */
void flash_cells_boot(flash_cells_t *cells, uint64_t random);

#endif

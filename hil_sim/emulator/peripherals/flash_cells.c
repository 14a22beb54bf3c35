#include "emulator/peripherals/flash_cells.h"

#include <string.h>

enum {
    PREPROGRAM = 26,   /* The first tenth of an erase, in 256ths. */
    WEAK_PROGRAM = 38, /* Weak is what was nearer to its moment than this, in 256ths of the operation: 0.15, */
    WEAK_ERASE = 5     /* 0.02. */
};

uint32_t flash_sector_begin(unsigned sector) {
    return sector < 5 ? sector * 0x4000u : (sector - 4u) * 0x20000u;
}

unsigned flash_sector_of(uint32_t offset) {
    return offset < 0x10000u ? offset / 0x4000u : offset < 0x20000u ? 4u : 4u + offset / 0x20000u;
}

void flash_cells_create(flash_cells_t *cells, machine_t *machine, uint8_t *weak) {
    *cells = (flash_cells_t){.machine = machine, .bytes = machine_flash(machine), .weak = weak};
}

/* Eight moments, of the bits of one byte, in 256ths of an operation. */
static void moments(uint64_t *random, uint8_t at[8]) {
    const uint64_t word = machine_random(random);
    memcpy(at, &word, sizeof word);
}

static bool near(int now, int moment, int span) {
    return now - moment < span && moment - now < span;
}

static void program_byte(flash_cells_t *cells, uint32_t offset, uint8_t value, int now, uint64_t *random) {
    uint8_t at[8];
    moments(random, at);
    for (unsigned bit = 0; bit < 8; bit++) {
        const uint8_t mask = (uint8_t)(1u << bit);
        const bool programmed = (cells->bytes[offset] & mask) != 0 || (cells->weak[offset] & mask) != 0;
        if ((value & mask) != 0 || !programmed) {
            continue;
        }
        if (now > at[bit]) {
            cells->bytes[offset] &= (uint8_t)~mask;
        }
        if (now < 256 && near(now, at[bit], WEAK_PROGRAM)) {
            cells->weak[offset] |= mask;
            cells->any_weak = true;
        } else if (now > at[bit]) {
            cells->weak[offset] &= (uint8_t)~mask;
        }
    }
}

void flash_cells_program(flash_cells_t *cells, uint32_t offset, uint32_t value, unsigned width, double done,
                         uint64_t random) {
    const int now = (int)(256.0 * done);
    for (unsigned i = 0; i < width; i++) {
        program_byte(cells, offset + i, (uint8_t)(value >> 8 * i), now, &random);
    }
    machine_flash_changed(cells->machine, offset, width);
}

static void erase_byte(flash_cells_t *cells, uint32_t offset, int now, uint64_t *random) {
    uint8_t at[8];
    moments(random, at);
    for (unsigned bit = 0; bit < 8; bit++) {
        const uint8_t mask = (uint8_t)(1u << bit);
        const int falls = at[bit] * PREPROGRAM / 256, rises = PREPROGRAM + at[bit] * (256 - PREPROGRAM) / 256;
        if (now > rises) {
            cells->bytes[offset] |= mask;
            cells->weak[offset] &= (uint8_t)~mask;
        } else if (now > falls) {
            cells->bytes[offset] &= (uint8_t)~mask;
        }
        if (near(now, rises, WEAK_ERASE)) {
            cells->weak[offset] |= mask;
            cells->any_weak = true;
        }
    }
}

void flash_cells_erase(flash_cells_t *cells, unsigned sector, double done, uint64_t random) {
    const uint32_t begin = flash_sector_begin(sector), end = flash_sector_begin(sector + 1u);
    if (done >= 1.0) {
        memset(cells->bytes + begin, 0xFF, end - begin);
        memset(cells->weak + begin, 0, end - begin);
    } else {
        for (uint32_t offset = begin; offset < end; offset++) {
            erase_byte(cells, offset, (int)(256.0 * done), &random);
        }
    }
    machine_flash_changed(cells->machine, begin, end - begin);
}

void flash_cells_boot(flash_cells_t *cells, uint64_t random) {
    cells->boots++;
    if (!cells->any_weak) {
        return;
    }
    random ^= cells->boots << 32;
    cells->any_weak = false;
    for (uint32_t offset = 0; offset < MACHINE_FLASH_SIZE; offset++) {
        if (cells->weak[offset] != 0) {
            const uint8_t mask = cells->weak[offset];
            cells->bytes[offset] = (uint8_t)((cells->bytes[offset] & ~mask) | (machine_random(&random) & mask));
            cells->any_weak = true;
        }
    }
    machine_flash_changed(cells->machine, 0, MACHINE_FLASH_SIZE);
}

/* cycles.h: how long instructions take: a constant, or costs by class of instruction.
 *
 * cycles_init() once, cycles_of() for each instruction, and where a table is in use cycles_bus() for each access to a
 * peripheral; cycles_flash_changed() whenever the flash's wait states, caches or content change.
 *
 * Costs by class are those of the Cortex-M4 technical reference manual (ARM DDI 0439D, table 3-1 and 7-1). What depends
 * on data or on neighbours takes a fixed, unfavourable value: a division 12 cycles, a division or root in the
 * floating-point unit 14, a load 2 (neighbouring loads are not pipelined), a barrier 4, the refill of the pipeline
 * after a taken branch 3, entry of an exception 12 and return 10, with 17 more each if a floating-point context is
 * stacked. A taken branch is seen from the addresses: behind an instruction whose condition fails inside an IT block
 * the refill is charged too.
 *
 * The flash's accelerator is a fixed approximation. With its instruction cache on, one taken branch in 8 waits for the
 * flash's wait states, straight code never; off, each taken branch waits, and straight code once a line of 16 bytes,
 * half of that with prefetch. With its data cache on one literal load in 4 waits, else each. Constants that are read
 * through a register, and reads of RAM that meet a transfer of the DMA on the bus, cost nothing more.
 *
 * A read of a peripheral waits for its bus: 1 cycle on AHB, 4 on APB2, 8 on APB1 (two cycles of a bus clock of half and
 * a quarter of the core's). Writes are buffered.
 */
#ifndef GOLDFIELD_CYCLES_H
#define GOLDFIELD_CYCLES_H

#include <stdbool.h>
#include <stdint.h>

#include "emulator/machine_internal.h"

/* Costs are counted in 2^-8 cycles. */
enum { CYCLE_SHIFT = 8, CYCLE = 1 << CYCLE_SHIFT };

typedef struct {
    uint16_t *table; /* Costs by halfword of flash, 0: not looked up yet. NULL: every instruction costs the same. */
    uint32_t instruction;   /* Cost of an instruction without a table. */
    uint32_t refill;        /* Cost of a taken branch beyond the branch itself. */
    uint32_t expected;      /* Address of the next instruction, if the last one takes no branch. */
    uint32_t line, literal; /* Waiting for the flash: a halfword of straight code, a literal load. */
} cycles_t;

/* Costs as the configuration says. Returns false if there is no memory. */
bool cycles_init(cycles_t *cycles, const emulator_config_t *config);
void cycles_free(cycles_t *cycles);

/* FLASH_ACR has this value, and what was looked up is void. */
void cycles_flash_changed(cycles_t *cycles, uint32_t acr);

/* Bytes of the flash from one offset to another have changed. */
void cycles_forget(cycles_t *cycles, uint32_t from, uint32_t to);

/* Cycles of an instruction of these two halfwords (the second counts if the instruction has 32 bits) by its class,
 * flash and refill not counted. */
unsigned cycles_of_class(uint16_t first, uint16_t second);

/* Look up the cost of the instruction at an address. */
uint32_t cycles_look_up(cycles_t *cycles, machine_t *machine, uint32_t address);

/* Cost of the instruction at an address; there must be a table. */
static inline uint32_t cycles_of(cycles_t *cycles, machine_t *machine, uint32_t address) {
    const uint32_t cost = (address & ~(FLASH_BASE | (FLASH_SIZE - 1u))) == 0
                              ? cycles->table[(address & (FLASH_SIZE - 1u)) / 2u]
                              : 0;
    return cost != 0 ? cost : cycles_look_up(cycles, machine, address);
}

/* What a peripheral access costs beyond its instruction. */
uint32_t cycles_bus(const cycles_t *cycles, uint32_t address, bool write);

/* What stacking or unstacking costs; 0 without a table. */
uint32_t cycles_exception(const cycles_t *cycles, bool entry, bool floating_point);

#endif

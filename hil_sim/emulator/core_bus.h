/* core_bus.h: the core's side of the buses: what is mapped where in Unicorn, and accesses that are not plain memory. */
#ifndef GOLDFIELD_CORE_BUS_H
#define GOLDFIELD_CORE_BUS_H

#include "emulator/processor.h"

/* Map the machine's memories, the peripheral areas and the private peripheral bus. Returns Unicorn's error. */
uc_err core_bus_map(cpu_t *cpu);

/* Note a fault of the last instruction; it is taken before the next. The instruction itself goes on, as Unicorn cannot
 * abandon it inside an access. */
void core_bus_fault(cpu_t *cpu, unsigned exception, uint32_t cfsr, uint32_t address);

/* The registers that fault_t.registers holds. */
extern const int core_bus_registers[15];

/* The access of the last instruction, which is about to happen, is not aligned, and CCR.UNALIGN_TRP is set. */
void core_bus_unaligned(cpu_t *cpu, uint32_t address, unsigned size, bool write);

/* The last instruction stores into the flash: its controller decides. */
void core_bus_flash_store(cpu_t *cpu, uint32_t address, unsigned size, uint64_t value);

/* Take back what the abandoned instruction of a fault has done. */
void core_bus_take_back(cpu_t *cpu, const fault_t *fault);

/* The same for a store that met a bus error: it went through the write buffer, unless ACTLR.DISDEFWBUF switches that
 * off, so the fault comes behind the instruction and no register tells the address. */
void core_bus_store_fault(cpu_t *cpu, uint32_t address);

#endif

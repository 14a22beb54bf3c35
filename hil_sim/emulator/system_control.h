/* system_control.h: the registers of the private peripheral bus, 0xE0000000..0xE00FFFFF: system control block, cycle
 * counter, identification, and those of nvic.h and systick.h. */
#ifndef GOLDFIELD_SYSTEM_CONTROL_H
#define GOLDFIELD_SYSTEM_CONTROL_H

#include "emulator/processor.h"

/* Every register back to its value after a system reset; SysTick stops. */
void system_control_reset(cpu_t *cpu);

/* An access by the last instruction that began. Returns false if there is no such register. */
bool system_control_read(cpu_t *cpu, uint32_t address, unsigned width, uint32_t *value);
bool system_control_write(cpu_t *cpu, uint32_t address, unsigned width, uint32_t value);

#endif

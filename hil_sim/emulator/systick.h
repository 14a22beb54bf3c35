/* systick.h: the core's own timer (ARMv7-M architecture reference manual, B3.3).
 *
 * While it runs, the count at cycle zero + k d is (reload + 1 - k) modulo (reload + 1), d being the divider: 1 for the
 * core's clock, 8 for the other. No event is made but for the count's zeros.
 */
#ifndef GOLDFIELD_SYSTICK_H
#define GOLDFIELD_SYSTICK_H

#include "emulator/processor.h"

/* Prepare the event of a timer that is all zeros. */
void systick_create(cpu_t *cpu);

/* The core's frequency changed: the next zero comes at another time. */
void systick_clock_changed(cpu_t *cpu);

/* Registers at 0xE000E010..0xE000E01F, whole words; cycle is that of the accessing instruction. Returns false if there
 * is no such register. */
bool systick_read(cpu_t *cpu, uint32_t address, uint64_t cycle, uint32_t *value);
bool systick_write(cpu_t *cpu, uint32_t address, uint64_t cycle, uint32_t value);

#endif
